//! The losses, row by row, in burn tensors. Coordinates enter in metres (nominal ones where the unit is unknown) and in the data
//! set's world.
//!
//! Reprojection is measured in normalised image coordinates times the focal length, so that every camera model that can
//! turn a pixel into a ray is served, distorted ones too.

use burn::tensor::{Device, Int, Tensor, TensorData, activation};

/// Depths outside are not used for reprojection: ACE's limits, in metres.
pub const DEPTH_RANGE_M: [f32; 2] = [0.1, 1000.0];
/// Reprojection errors beyond are not used.
pub const MAX_ERROR_PX: f32 = 1000.0;
/// Keeps the root differentiable at zero; a micrometre.
const ROOT_GUARD: f32 = 1e-12;

/// Cameras and observations of the rows of a batch.
pub struct Observations {
    /// Rows of the rotation, each `[rows, 3]`.
    pub rotation: [Tensor<2>; 3],
    /// `[rows, 3]`.
    pub translation: Tensor<2>,
    /// `[rows, 1]`.
    pub focal_px: Tensor<2>,
    /// Points: `[rows, 2]`, the observed ray at depth one. Segments: `[rows, 3]`, the observed line there,
    /// `a x + b y + c = 0` with `a^2 + b^2 = 1`.
    pub observed: Tensor<2>,
}

/// Flat rows as they come from the buffer.
#[derive(Debug, Clone, Default)]
pub struct ObservationRows {
    /// 9 a row.
    pub rotation: Vec<f32>,
    /// 3 a row.
    pub translation: Vec<f32>,
    /// 1 a row.
    pub focal_px: Vec<f32>,
    /// 2 or 3 a row.
    pub observed: Vec<f32>,
}

impl ObservationRows {
    /// On a device.
    pub fn to_device(&self, device: &Device) -> Observations {
        let rows = self.focal_px.len();
        let axis = |i: usize| {
            let data: Vec<f32> = self
                .rotation
                .chunks_exact(9)
                .flat_map(|r| [r[3 * i], r[3 * i + 1], r[3 * i + 2]])
                .collect();
            Tensor::from_data(TensorData::new(data, [rows, 3]), device)
        };
        let width = self.observed.len() / rows.max(1);
        Observations {
            rotation: [axis(0), axis(1), axis(2)],
            translation: Tensor::from_data(
                TensorData::new(self.translation.clone(), [rows, 3]),
                device,
            ),
            focal_px: Tensor::from_data(TensorData::new(self.focal_px.clone(), [rows, 1]), device),
            observed: Tensor::from_data(
                TensorData::new(self.observed.clone(), [rows, width]),
                device,
            ),
        }
    }
}

/// Euclidean distance of each row to its target, over all columns: `[rows, 1]` in the columns' unit.
pub fn distance(prediction: Tensor<2>, target: Tensor<2>) -> Tensor<2> {
    (prediction - target)
        .square()
        .sum_dim(1)
        .add_scalar(ROOT_GUARD)
        .sqrt()
}

/// Point in camera space, as its three columns.
fn in_camera(point: &Tensor<2>, o: &Observations) -> [Tensor<2>; 3] {
    core::array::from_fn(|i| {
        (point.clone() * o.rotation[i].clone()).sum_dim(1) + o.translation.clone().narrow(1, i, 1)
    })
}

/// Reprojection error of points in pixels, depth in metres, and whether both are usable: three times `[rows, 1]`.
pub fn point_reprojection(point: Tensor<2>, o: &Observations) -> [Tensor<2>; 3] {
    let [x, y, z] = in_camera(&point, o);
    let inverse = z.clone().clamp_min(DEPTH_RANGE_M[0]).recip();
    let dx = x * inverse.clone() - o.observed.clone().narrow(1, 0, 1);
    let dy = y * inverse - o.observed.clone().narrow(1, 1, 1);
    let error = (dx.square() + dy.square()).add_scalar(ROOT_GUARD).sqrt() * o.focal_px.clone();
    let usable = usable(&z) * below(&error, MAX_ERROR_PX);
    [error, z, usable]
}

/// Sum of the distances in pixels of both projected ends to the observed infinite line, mean depth, usability.
pub fn segment_reprojection(ends: Tensor<2>, o: &Observations) -> [Tensor<2>; 3] {
    let side = |column: usize| {
        let [x, y, z] = in_camera(&ends.clone().narrow(1, column, 3), o);
        let inverse = z.clone().clamp_min(DEPTH_RANGE_M[0]).recip();
        let coefficient = |i: usize| o.observed.clone().narrow(1, i, 1);
        let off =
            x * inverse.clone() * coefficient(0) + y * inverse * coefficient(1) + coefficient(2);
        (off.square().add_scalar(ROOT_GUARD).sqrt(), z)
    };
    let ((a, za), (b, zb)) = (side(0), side(3));
    let error = (a + b) * o.focal_px.clone();
    let usable = usable(&za) * usable_depth(&zb) * below(&error, MAX_ERROR_PX);
    [error, (za + zb).mul_scalar(0.5), usable]
}

fn usable(z: &Tensor<2>) -> Tensor<2> {
    usable_depth(z)
}

fn usable_depth(z: &Tensor<2>) -> Tensor<2> {
    let z = z.clone().detach();
    z.clone().greater_equal_scalar(DEPTH_RANGE_M[0]).float()
        * z.lower_equal_scalar(DEPTH_RANGE_M[1]).float()
}

fn below(x: &Tensor<2>, limit: f32) -> Tensor<2> {
    x.clone().detach().lower_equal_scalar(limit).float()
}

/// `limit * tanh(x / limit)`: straight near zero, flat beyond the limit (paper, equation 5, taken element by element).
pub fn clamped(x: Tensor<2>, limit: f64) -> Tensor<2> {
    x.div_scalar(limit).tanh().mul_scalar(limit)
}

/// Binary cross-entropy of logits, stable for any size of them: `[rows, 1]`.
pub fn cross_entropy(logits: Tensor<2>, target: Tensor<2>) -> Tensor<2> {
    activation::relu(logits.clone()) - logits.clone() * target
        + logits.abs().neg().exp().add_scalar(1.0).log()
}

/// Sum of the rows with weight, and the sum of the weights (at least a tiny number, so that no rows give zero).
pub fn weighted(rows: Tensor<2>, weight: Tensor<2>) -> [Tensor<1>; 2] {
    let total = weight.clone().sum().clamp_min(1e-6);
    [(rows * weight).sum(), total]
}

/// Mean of the rows with weight; 0 when there are none.
pub fn weighted_mean(rows: Tensor<2>, weight: Tensor<2>) -> Tensor<1> {
    let [sum, total] = weighted(rows, weight);
    sum / total
}

/// A column of numbers.
pub fn column(values: &[f32], device: &Device) -> Tensor<2> {
    Tensor::from_data(TensorData::new(values.to_vec(), [values.len(), 1]), device)
}

/// Row numbers for `select`.
pub fn rows(values: &[i64], device: &Device) -> Tensor<1, Int> {
    Tensor::from_data(TensorData::new(values.to_vec(), [values.len()]), device)
}
