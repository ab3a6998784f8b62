//! Reprojection residuals and their derivatives.
//!
//! Perturbation on the left: R <- exp([w]x) R, t <- exp([w]x) t + v, f <- f exp(phi); columns are (w, v, phi).
//! Points: (predicted - observed) in pixels. Lines: signed distances in pixels of the two observed ends to the projected line.
//! A point moves by w x Z + v; the viewing plane Z1 x Z2 moves by w x (Z1 x Z2) + v x (Z2 - Z1).

use super::problem::{LineItem, MIN_DEPTH, Model, PointItem};
use nalgebra::{Vector2, Vector3};

/// Derivative of one residual: rotation, translation, ln focal.
pub(super) type Row = [f64; 7];

/// Two residuals of one correspondence.
#[derive(Debug, Clone, Copy)]
pub(super) struct Residual {
    pub(super) r: [f64; 2],
    /// For points the depth twice, for lines the depths of the two world ends.
    pub(super) depth: [f64; 2],
}

impl Residual {
    pub(super) fn squared(&self) -> f64 {
        self.r[0] * self.r[0] + self.r[1] * self.r[1]
    }

    /// Squared inverse depth that scales the noise of the world coordinates (mean over the two ends).
    pub(super) fn inverse_depth_sq(&self) -> f64 {
        let [a, b] = self.depth;
        0.5 * (1.0 / (a * a) + 1.0 / (b * b))
    }
}

fn row(g: &Vector3<f64>, moved: &Vector3<f64>, plane: &Vector3<f64>, focal: f64) -> Row {
    // g . (w x moved) = w . (moved x g), and g . (v x plane) = v . (plane x g)
    let a = moved.cross(g);
    let b = plane.cross(g);
    [a.x, a.y, a.z, b.x, b.y, b.z, focal]
}

/// `None` when the point is behind the camera.
#[inline]
pub(super) fn point(
    fx: f64,
    fy: f64,
    model: &Model,
    item: &PointItem,
) -> Option<(Residual, Vector3<f64>, Vector2<f64>)> {
    let z = model.rotation * item.x + model.translation;
    if !(z.z > MIN_DEPTH) {
        return None;
    }
    let inverse = 1.0 / z.z;
    let u = Vector2::new(
        fx * model.focal * z.x * inverse,
        fy * model.focal * z.y * inverse,
    );
    let residual = Residual {
        r: [u.x - item.uv.x, u.y - item.uv.y],
        depth: [z.z, z.z],
    };
    Some((residual, z, u))
}

/// Rows that belong to [`point`].
#[inline]
pub(super) fn point_rows(
    fx: f64,
    fy: f64,
    model: &Model,
    z: &Vector3<f64>,
    u: &Vector2<f64>,
) -> [Row; 2] {
    let inverse = 1.0 / z.z;
    let g = [
        Vector3::new(fx * model.focal * inverse, 0.0, -u.x * inverse),
        Vector3::new(0.0, fy * model.focal * inverse, -u.y * inverse),
    ];
    core::array::from_fn(|k| {
        let a = z.cross(&g[k]);
        [a.x, a.y, a.z, g[k].x, g[k].y, g[k].z, u[k]]
    })
}

/// What the derivative of a line residual needs besides the residual.
#[derive(Debug, Clone, Copy)]
pub(super) struct LineState {
    z1: Vector3<f64>,
    z2: Vector3<f64>,
    /// Plane normal in camera space and image line in pixels, both unnormalised.
    plane: Vector3<f64>,
    line: Vector3<f64>,
    length: f64,
}

/// `None` when an end is behind the camera or the line projects into a point.
#[inline]
pub(super) fn line(
    fx: f64,
    fy: f64,
    model: &Model,
    item: &LineItem,
) -> Option<(Residual, LineState)> {
    let z1 = model.rotation * item.x1 + model.translation;
    let z2 = model.rotation * item.x2 + model.translation;
    if !(z1.z > MIN_DEPTH && z2.z > MIN_DEPTH) {
        return None;
    }
    let plane = z1.cross(&z2);
    let image = Vector3::new(
        plane.x / (fx * model.focal),
        plane.y / (fy * model.focal),
        plane.z,
    );
    let length = (image.x * image.x + image.y * image.y).sqrt();
    if !(length > 0.0) {
        return None;
    }
    let distance = |q: &Vector2<f64>| (image.x * q.x + image.y * q.y + image.z) / length;
    let residual = Residual {
        r: [distance(&item.a), distance(&item.b)],
        depth: [z1.z, z2.z],
    };
    Some((
        residual,
        LineState {
            z1,
            z2,
            plane,
            line: image,
            length,
        },
    ))
}

/// Rows that belong to [`line`].
#[inline]
pub(super) fn line_rows(
    fx: f64,
    fy: f64,
    model: &Model,
    item: &LineItem,
    residual: &Residual,
    state: &LineState,
) -> [Row; 2] {
    let edge = state.z2 - state.z1;
    let (hx, hy) = (state.line.x / state.length, state.line.y / state.length);
    core::array::from_fn(|k| {
        let q = if k == 0 { &item.a } else { &item.b };
        let r = residual.r[k];
        let inverse = 1.0 / state.length;
        // Derivative by the image line, then by the plane normal.
        let gx = (q.x - r * hx) * inverse;
        let gy = (q.y - r * hy) * inverse;
        let g = Vector3::new(gx / (fx * model.focal), gy / (fy * model.focal), inverse);
        let focal = -(gx * state.line.x + gy * state.line.y);
        row(&g, &state.plane, &edge, focal)
    })
}

/// Whether the projected segment and the observed one overlap along the observed direction.
pub(super) fn overlaps(fx: f64, fy: f64, item: &LineItem, state: &LineState, focal: f64) -> bool {
    let d = item.b - item.a;
    let along = |z: &Vector3<f64>| {
        let u = Vector2::new(fx * focal * z.x / z.z, fy * focal * z.y / z.z);
        (u - item.a).dot(&d)
    };
    let (s1, s2) = (along(&state.z1), along(&state.z2));
    s1.max(s2) > 0.0 && s1.min(s2) < d.norm_squared()
}

/// The model after a step.
pub(super) fn perturbed(model: &Model, step: &Row) -> Model {
    let turn = crate::geometry::rotation_from_vector(&Vector3::new(step[0], step[1], step[2]));
    Model {
        rotation: turn * model.rotation,
        translation: turn * model.translation + Vector3::new(step[3], step[4], step[5]),
        focal: model.focal * crate::math::elementary::exp(step[6]),
    }
}

#[cfg(test)]
mod tests {
    use super::super::problem::Belief;
    use super::*;
    use crate::math::Rng;

    #[test]
    fn jacobians_agree_with_central_differences() {
        let mut rng = Rng::from_seed(21);
        let (fx, fy) = (525.0, 510.0);
        let h = 1e-6;
        let mut vector = |size: f64| Vector3::from_fn(|_, _| size * rng.normal());
        for _ in 0..200 {
            let model = Model {
                rotation: crate::geometry::rotation_from_vector(&vector(1.0)),
                translation: vector(0.3) + Vector3::new(0.0, 0.0, 6.0),
                focal: 1.1,
            };
            let uv = |v: Vector3<f64>| Vector2::new(v.x, v.y);
            let p = PointItem {
                uv: uv(vector(150.0)),
                x: vector(1.0),
                belief: Belief::from_logit(0.0),
                sigma: 0.0,
                sigma_px: 0.0,
                source: 0,
            };
            let (x1, x2) = (vector(1.0), vector(1.0));
            let l = LineItem {
                a: uv(vector(150.0)),
                b: uv(vector(150.0)),
                x1,
                x2,
                direction: (x2 - x1).normalize(),
                length_px: 1.0,
                belief: Belief::from_logit(0.0),
                sigma: 0.0,
                sigma_px: 0.0,
                source: 0,
            };
            let (_, z, u) = point(fx, fy, &model, &p).expect("in front");
            let rows = point_rows(fx, fy, &model, &z, &u);
            let (r, state) = line(fx, fy, &model, &l).expect("in front");
            let line_j = line_rows(fx, fy, &model, &l, &r, &state);
            for c in 0..7 {
                let mut step = [0.0; 7];
                step[c] = h;
                let up = perturbed(&model, &step);
                step[c] = -h;
                let down = perturbed(&model, &step);
                let pr = |m: &Model| point(fx, fy, m, &p).expect("in front").0.r;
                let lr = |m: &Model| line(fx, fy, m, &l).expect("in front").0.r;
                for k in 0..2 {
                    let numeric = (pr(&up)[k] - pr(&down)[k]) / (2.0 * h);
                    assert!((numeric - rows[k][c]).abs() < 1e-6 * (1.0 + numeric.abs()));
                    let numeric = (lr(&up)[k] - lr(&down)[k]) / (2.0 * h);
                    assert!(
                        (numeric - line_j[k][c]).abs() < 1e-5 * (1.0 + numeric.abs()),
                        "{numeric} {}",
                        line_j[k][c]
                    );
                }
            }
        }
    }
}
