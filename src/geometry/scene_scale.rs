//! Centre and scale between a network's coordinates and the world.

use super::Units;
use crate::math::stats::median_in_place;
use nalgebra::Vector3;

/// The usual [`SceneScale::scale`] of a room in metres: half its landmarks are nearer to its middle than this.
const USUAL_SCALE_M: f64 = 2.0;

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

    /// World units that are taken for a metre where a threshold is meant in metres: exactly one in a metric world. Where units
    /// are arbitrary, the scene is taken to be as large as a usual room.
    pub fn nominal_metre(&self, units: Units) -> f64 {
        match units {
            Units::Metres => 1.0,
            Units::Arbitrary => self.scale / USUAL_SCALE_M,
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_metre_follows_the_scale_where_units_are_arbitrary() {
        let scale = SceneScale {
            scale: 300.0,
            ..SceneScale::default()
        };
        assert_eq!(scale.nominal_metre(Units::Arbitrary), 150.0);
        assert_eq!(scale.nominal_metre(Units::Metres), 1.0);
    }
}
