//! Pictures as large as features know them. What agrees and what does not is a matter of the extractor's pixels: of a picture that
//! is larger than its working image, one of those is many of the picture's.

use crate::dataset::Dataset;
use landline::features::FeatureSet;
use landline::geometry::{Camera, PixelMap};
use landline::image::working_size;

/// From a picture to itself with the longest side at most so long, or back.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shrink {
    factor: f64,
    working: (u32, u32),
    sensor: (u32, u32),
}

impl Shrink {
    /// Of the pictures of a camera.
    pub fn of(camera: &Camera, max_side: usize) -> Self {
        let (width, height) = (camera.width, camera.height);
        let working = working_size(width as usize, height as usize, max_side);
        Self {
            factor: (max_side as f64 / f64::from(width.max(height).max(1))).min(1.0),
            working: (working.0 as u32, working.1 as u32),
            sensor: (width, height),
        }
    }

    /// Whether it changes anything.
    pub fn is_needed(&self) -> bool {
        self.factor < 1.0
    }

    /// Pixels of the picture for one of the shrunk one.
    pub fn sensor_px(&self) -> f64 {
        1.0 / self.factor
    }

    /// The camera of the shrunk picture.
    pub fn camera(&self, camera: &Camera) -> Camera {
        self.sized(camera, self.factor, self.working)
    }

    /// The camera of the picture from that of the shrunk one.
    pub fn camera_back(&self, camera: &Camera) -> Camera {
        self.sized(camera, self.sensor_px(), self.sensor)
    }

    fn sized(&self, camera: &Camera, factor: f64, (width, height): (u32, u32)) -> Camera {
        if !self.is_needed() {
            return *camera;
        }
        Camera {
            width,
            height,
            ..camera.resized(&map(factor))
        }
    }

    /// Takes features to the shrunk picture.
    pub fn features(&self, features: &mut FeatureSet) {
        if self.is_needed() {
            features.map_pixels(&map(self.factor));
        }
    }

    /// Takes features back to the picture.
    pub fn features_back(&self, features: &mut FeatureSet) {
        if self.is_needed() {
            features.map_pixels(&map(self.sensor_px()));
        }
    }
}

fn map(factor: f64) -> PixelMap<(), ()> {
    PixelMap::from_scale(factor, factor)
}

/// A data set with shrunk pictures: cameras and the pixels of its points; `None` where they are small already. Segments that came
/// with it stay as they are: the extractor takes them in pixels of the picture.
pub fn shrunk(dataset: &Dataset, max_side: usize) -> Option<Dataset> {
    let all: Vec<Shrink> = dataset
        .images
        .iter()
        .map(|image| Shrink::of(&image.camera, max_side))
        .collect();
    if !all.iter().any(Shrink::is_needed) {
        return None;
    }
    let mut small = dataset.clone();
    for (image, shrink) in small.images.iter_mut().zip(&all) {
        image.camera = shrink.camera(&image.camera);
    }
    for point in &mut small.points {
        for (image, pixel) in &mut point.observations {
            if let Some(shrink) = all.get(*image) {
                *pixel = map(shrink.factor).apply(*pixel);
            }
        }
    }
    Some(small)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_goes_there_and_back_and_a_small_one_nowhere() {
        let large = Camera::centered(4032, 3024, 3000.0);
        let shrink = Shrink::of(&large, 640);
        let small = shrink.camera(&large);
        assert_eq!((small.width, small.height), (640, 480));
        assert!((small.focal_px().0 - 3000.0 / 6.3).abs() < 1e-9);
        let back = shrink.camera_back(&small);
        assert_eq!((back.width, back.height), (4032, 3024));
        assert!((back.focal_px().0 - 3000.0).abs() < 1e-9);
        let own = Camera::centered(640, 427, 500.0);
        let none = Shrink::of(&own, 640);
        assert!(!none.is_needed());
        assert_eq!(none.camera(&own), own);
    }
}
