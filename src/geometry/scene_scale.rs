//! Centre and scale between a network's coordinates and the world.

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
    /// A world point from network coordinates.
    pub fn world_from_network(&self, p: Vector3<f64>) -> Vector3<f64> {
        self.centre + self.scale * p
    }

    /// Network coordinates of a world point.
    pub fn network_from_world(&self, p: Vector3<f64>) -> Vector3<f64> {
        (p - self.centre) / self.scale
    }
}
