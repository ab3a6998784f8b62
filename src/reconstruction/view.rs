//! A picture as a reconstruction sees it, and the same with its pose and its features on the plane z = 1.

use super::triangulate::Ray;
use crate::features::FeatureSet;
use crate::geometry::{CamFromWorld, Camera, Pixel};
use nalgebra::{Vector2, Vector3};

/// A picture: its camera, its features, and its pose where that is known.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// As the data set calls it.
    pub name: String,
    /// Of the picture that the features were taken from.
    pub camera: Camera,
    /// `None` until the picture is registered.
    pub cam_from_world: Option<CamFromWorld>,
    /// In pixels of [`Self::camera`].
    pub features: FeatureSet,
}

impl View {
    /// The view with its rays worked out; `None` without a pose.
    pub fn posed(&self) -> Option<PosedView<'_>> {
        Some(PosedView::new(
            self.camera,
            self.cam_from_world?,
            &self.features,
        ))
    }
}

/// A picture with a pose, its features on the plane z = 1 of camera space. Descriptors are borrowed.
#[derive(Debug, Clone)]
pub struct PosedView<'a> {
    /// What the picture shows.
    pub features: &'a FeatureSet,
    /// Of the picture.
    pub camera: Camera,
    /// Of the picture.
    pub cam_from_world: CamFromWorld,
    /// Where the camera is.
    pub center_in_world: Vector3<f64>,
    /// Mean focal length: turns distances on the plane into pixels.
    pub focal_px: f64,
    /// Each keypoint on the plane z = 1; NaN where the camera model has no bearing.
    pub planar: Vec<Vector2<f64>>,
    /// Ends of each segment on the plane z = 1.
    pub segment_ends: Vec<[Vector2<f64>; 2]>,
}

/// Beyond this angle from the axis a bearing has no useful place on the plane: tan(80 deg).
const MAX_PLANAR: f64 = 5.67;

impl<'a> PosedView<'a> {
    /// Works out the rays of a picture.
    pub fn new(camera: Camera, cam_from_world: CamFromWorld, features: &'a FeatureSet) -> Self {
        let (fx, fy) = camera.focal_px();
        let planar = |pixel: Pixel| planar_from_pixel(&camera, pixel);
        Self {
            features,
            camera,
            cam_from_world,
            center_in_world: cam_from_world.center_in_world(),
            focal_px: 0.5 * (fx + fy),
            planar: features.keypoints.iter().map(|k| planar(k.pixel)).collect(),
            segment_ends: features
                .segments
                .iter()
                .map(|s| [planar(s.start), planar(s.end)])
                .collect(),
        }
    }

    /// A world point on the plane z = 1 of this camera; `None` behind it.
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

/// A pixel on the plane z = 1 of camera space; NaN where the camera model has no bearing there or it is too oblique.
pub fn planar_from_pixel(camera: &Camera, pixel: Pixel) -> Vector2<f64> {
    match camera.bearing_from_pixel(pixel) {
        Some(b) if b.z > 0.0 && b.xy().norm() <= MAX_PLANAR * b.z => b.xy() / b.z,
        _ => Vector2::repeat(f64::NAN),
    }
}
