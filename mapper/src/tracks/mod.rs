//! Tracks under known poses: image pairs by view overlap, matches, 3D points and 3D segments.
//!
//! Works on undistorted image planes: every keypoint and segment end is kept as (x / z, y / z) in camera space, and
//! errors are multiplied by the focal length, so that they read as pixels for every camera model.

mod convention;
mod import;
mod lines;
mod matching;
mod pairs;
mod points;
mod triangulate;

pub use convention::{ConventionCheck, Misreading, check_convention};
pub use import::{MAX_DISTANCE_PX, line_tracks_from_map, point_tracks_from_model};
pub use lines::{
    KnownLine, LineParams, SegmentTrack, assign_segments, build_line_tracks, line_pairs,
};
pub(crate) use lines::{line_residuals, mean_segment_descriptor};
pub use matching::{Match, MatchParams, match_pairs};
pub use pairs::{PairParams, choose_pairs, probe_depth};
pub(crate) use points::mean_descriptor;
pub use points::{PointParams, Track, build_point_tracks};
pub use triangulate::{Bundle, Ray};

use crate::feature_cache::ImageFeatures;
use landline::geometry::{CamFromWorld, Camera, Pixel};
use nalgebra::{DMatrix, Vector2, Vector3};

/// A posed picture as this module sees it.
#[derive(Debug, Clone)]
pub struct View {
    /// From the data set.
    pub camera: Camera,
    /// From the data set.
    pub cam_from_world: CamFromWorld,
    /// Where the camera is.
    pub center_in_world: Vector3<f64>,
    /// Mean focal length: turns plane distances into pixels.
    pub focal_px: f64,
    /// Each keypoint on the plane z = 1; NaN where the camera model has no bearing.
    pub planar: Vec<Vector2<f64>>,
    /// One column a keypoint, unit length.
    pub descriptors_dn: DMatrix<f32>,
    /// Ends of each segment on the plane z = 1.
    pub segment_ends: Vec<[Vector2<f64>; 2]>,
    /// `samples` columns a segment, start to end, unit length.
    pub segment_descriptors_dn: DMatrix<f32>,
}

/// Beyond this angle from the axis a bearing has no useful place on the plane: tan(80 deg).
const MAX_PLANAR: f64 = 5.67;

impl View {
    /// Prepares a picture.
    pub fn new(camera: Camera, cam_from_world: CamFromWorld, features: &ImageFeatures) -> Self {
        let (fx, fy) = camera.focal_px();
        let planar = |pixel: Pixel| planar_from_pixel(&camera, pixel);
        Self {
            camera,
            cam_from_world,
            center_in_world: cam_from_world.center_in_world(),
            focal_px: 0.5 * (fx + fy),
            planar: features.pixels.iter().map(|p| planar(*p)).collect(),
            descriptors_dn: unit_columns(&features.descriptors_nd, features.descriptor_len),
            segment_ends: features
                .segments
                .iter()
                .map(|s| [planar(s.start), planar(s.end)])
                .collect(),
            segment_descriptors_dn: unit_columns(
                &features.segment_descriptors_nsd,
                features.descriptor_len,
            ),
        }
    }

    /// The plane z = 1 of this camera, in pixels of error, for a world point; `None` behind the camera.
    pub fn planar_from_world(&self, point_in_world: &Vector3<f64>) -> Option<Vector2<f64>> {
        let p = self.cam_from_world.transform_point(point_in_world);
        (p.z > 1e-6).then(|| Vector2::new(p.x / p.z, p.y / p.z))
    }

    /// Distance in pixels between a keypoint and the projection of a world point; infinite behind the camera.
    pub fn error_px(&self, keypoint: usize, point_in_world: &Vector3<f64>) -> f64 {
        match (
            self.planar_from_world(point_in_world),
            self.planar.get(keypoint),
        ) {
            (Some(projected), Some(seen)) => {
                let error = (projected - seen).norm() * self.focal_px;
                if error.is_nan() { f64::INFINITY } else { error }
            }
            _ => f64::INFINITY,
        }
    }

    /// Whether a world point projects into the picture.
    pub fn sees(&self, point_in_world: &Vector3<f64>) -> bool {
        let p = self.cam_from_world.transform_point(point_in_world);
        self.camera.pixel_from_cam(&p).is_some_and(|q| {
            q.x >= 0.0
                && q.y >= 0.0
                && q.x <= f64::from(self.camera.width)
                && q.y <= f64::from(self.camera.height)
        })
    }

    /// Unit vector in the world through a keypoint.
    pub fn ray(&self, keypoint: usize) -> Ray {
        let planar = self
            .planar
            .get(keypoint)
            .copied()
            .unwrap_or(Vector2::repeat(f64::NAN));
        self.ray_through(&planar)
    }

    /// Ray in the world through a place on the plane.
    pub fn ray_through(&self, planar: &Vector2<f64>) -> Ray {
        let in_cam = Vector3::new(planar.x, planar.y, 1.0).normalize();
        Ray {
            origin: self.center_in_world,
            direction: self.cam_from_world.rotation.transpose() * in_cam,
        }
    }
}

fn planar_from_pixel(camera: &Camera, pixel: Pixel) -> Vector2<f64> {
    match camera.bearing_from_pixel(pixel) {
        Some(b) if b.z > 0.0 && b.xy().norm() <= MAX_PLANAR * b.z => b.xy() / b.z,
        _ => Vector2::repeat(f64::NAN),
    }
}

fn unit_columns(rows_nd: &[f32], d: usize) -> DMatrix<f32> {
    let n = rows_nd.len().checked_div(d).unwrap_or(0);
    let mut columns = DMatrix::from_column_slice(d, n, &rows_nd[..n * d]);
    for mut column in columns.column_iter_mut() {
        let norm = column.norm();
        if norm > 0.0 {
            column /= norm;
        }
    }
    columns
}
