//! Centre and scale between a network's coordinates and the world.

use crate::math::stats::median_in_place;
use nalgebra::Vector3;

/// Undoes the normalisation of network coordinates: `world = centre + scale * network`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneScale {
    /// World position of the network's origin.
    pub centre: Vector3<f64>,
    /// World length of one network unit; positive.
    pub scale: f64,
}

impl Default for SceneScale {
    fn default() -> Self {
        Self {
            centre: Vector3::zeros(),
            scale: 1.0,
        }
    }
}

impl SceneScale {
    /// Median and a robust scale of points, the same along all axes; the default when there are none.
    pub fn of(points: impl Iterator<Item = Vector3<f64>>) -> Self {
        let points: Vec<_> = points.collect();
        let axis = |i: usize| {
            let mut values: Vec<f64> = points.iter().map(|p| p[i]).collect();
            median_in_place(&mut values).unwrap_or(0.0)
        };
        let centre = Vector3::new(axis(0), axis(1), axis(2));
        let mut distances: Vec<f64> = points.iter().map(|p| (p - centre).norm()).collect();
        let scale = median_in_place(&mut distances).filter(|s| *s > 1e-6);
        Self {
            centre,
            scale: scale.unwrap_or(1.0),
        }
    }

    /// A world point from network coordinates.
    pub fn world_from_network(&self, p: Vector3<f64>) -> Vector3<f64> {
        self.centre + self.scale * p
    }

    /// Network coordinates of a world point.
    pub fn network_from_world(&self, p: Vector3<f64>) -> Vector3<f64> {
        (p - self.centre) / self.scale
    }
}
