//! From where a landmark was seen, in three bytes.
//!
//! One byte holds the direction from the landmark to the cameras (octahedral map, 16 x 16), one the half angle of the cone around
//! it and the noise of the landmark, one the nearest and the farthest camera. Angles and distances are rounded outwards.

use crate::math::elementary::{acos, exp, ln};
use nalgebra::Vector3;

/// Steps of the octahedral map along one axis.
const STEPS: f64 = 16.0;
/// One step of the cone's half angle, radians: 15 of them are 90 degrees.
const ANGLE_STEP: f64 = core::f64::consts::FRAC_PI_2 / 15.0;
/// The smallest distance that is told apart, in steps of the position grid, and the factor from one to the next.
const NEAREST: f64 = 512.0;
const DISTANCE_FACTOR: f64 = core::f64::consts::SQRT_2;
/// The smallest noise in steps of the position grid, and the factor from one to the next.
const LEAST_SIGMA: f64 = 1.0;
const SIGMA_FACTOR: f64 = 1.6;

/// Where the cameras were that saw a landmark, and how well they fix it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewCone {
    /// Unit vector from the landmark to the middle of the cameras.
    pub direction: Vector3<f64>,
    /// Half angle around it that holds all of them, radians.
    pub half_angle: f64,
    /// Distance of the nearest camera, world units.
    pub near: f64,
    /// Distance of the farthest camera.
    pub far: f64,
    /// Standard deviation of the landmark across the line of sight, world units.
    pub sigma: f64,
}

impl ViewCone {
    /// Of a landmark that these cameras saw; `None` when there is none, or one lies on the landmark.
    pub fn of(
        landmark: &Vector3<f64>,
        cameras: impl Iterator<Item = Vector3<f64>> + Clone,
        sigma: f64,
    ) -> Option<Self> {
        let mut sum = Vector3::zeros();
        let (mut near, mut far) = (f64::INFINITY, 0.0_f64);
        for camera in cameras.clone() {
            let away = camera - landmark;
            let distance = away.norm();
            near = near.min(distance);
            far = far.max(distance);
            sum += away / distance;
        }
        if !(near > 0.0 && near.is_finite() && sum.norm() > 1e-9) {
            return None;
        }
        let direction = sum.normalize();
        let least = cameras
            .map(|camera| (camera - landmark).normalize().dot(&direction))
            .fold(1.0, f64::min);
        Some(Self {
            direction,
            half_angle: acos(least.clamp(-1.0, 1.0)),
            near,
            far,
            sigma,
        })
    }

    /// The three bytes, for positions in steps of this length.
    pub fn encode(&self, step: f64) -> [u8; 3] {
        let d = self.direction / self.direction.abs().sum();
        let (mut u, mut v) = (d.x, d.y);
        if d.z < 0.0 {
            (u, v) = ((1.0 - d.y.abs()) * sign(d.x), (1.0 - d.x.abs()) * sign(d.y));
        }
        let cell = |t: f64| nibble((t + 1.0) * 0.5 * STEPS);
        let level = |value: f64, least: f64, factor: f64| ln(value / (least * step)) / ln(factor);
        let angle = nibble((self.half_angle / ANGLE_STEP).ceil());
        let sigma = nibble(level(self.sigma, LEAST_SIGMA, SIGMA_FACTOR).round());
        let near = nibble(level(self.near, NEAREST, DISTANCE_FACTOR).floor());
        let far = nibble(level(self.far, NEAREST, DISTANCE_FACTOR).ceil());
        [cell(u) << 4 | cell(v), angle << 4 | sigma, near << 4 | far]
    }

    /// What the three bytes say. The lowest `near` and the highest `far` stand for no limit, the widest angle for all around.
    pub fn decode([direction, angle_sigma, near_far]: [u8; 3], step: f64) -> Self {
        let coordinate = |n: u8| (f64::from(n) + 0.5) / STEPS * 2.0 - 1.0;
        let (u, v) = (coordinate(direction >> 4), coordinate(direction & 15));
        let z = 1.0 - u.abs() - v.abs();
        let direction = if z >= 0.0 {
            Vector3::new(u, v, z)
        } else {
            Vector3::new((1.0 - v.abs()) * sign(u), (1.0 - u.abs()) * sign(v), z)
        };
        let power = |n: u8, least: f64, factor: f64| least * step * exp(f64::from(n) * ln(factor));
        let (near, far) = (near_far >> 4, near_far & 15);
        let angle = angle_sigma >> 4;
        Self {
            direction: direction.normalize(),
            half_angle: if angle == 15 {
                core::f64::consts::PI
            } else {
                f64::from(angle) * ANGLE_STEP
            },
            near: if near == 0 {
                0.0
            } else {
                power(near, NEAREST, DISTANCE_FACTOR)
            },
            far: if far == 15 {
                f64::INFINITY
            } else {
                power(far, NEAREST, DISTANCE_FACTOR)
            },
            sigma: power(angle_sigma & 15, LEAST_SIGMA, SIGMA_FACTOR),
        }
    }
}

fn sign(x: f64) -> f64 {
    if x < 0.0 { -1.0 } else { 1.0 }
}

/// 0 to 15; a NaN becomes 0.
fn nibble(x: f64) -> u8 {
    x.clamp(0.0, 15.0) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Rng;

    #[test]
    fn what_is_stored_holds_every_camera() {
        let mut rng = Rng::from_seed(3);
        let step = 1e-4;
        for _ in 0..500 {
            let mut vector = |size: f64| Vector3::from_fn(|_, _| size * rng.normal());
            let landmark = vector(2.0);
            let middle = landmark + vector(1.0).normalize() * 1.5;
            let cameras: Vec<_> = (0..5).map(|_| middle + vector(0.3)).collect();
            let cone = ViewCone::of(&landmark, cameras.iter().copied(), 2e-3).expect("cameras");
            let stored = ViewCone::decode(cone.encode(step), step);
            let turned = acos(stored.direction.dot(&cone.direction).min(1.0));
            // Half a cell's diagonal moves a point of the octahedron by at most sqrt(6) / 16; its face is 1 / sqrt(3) away.
            assert!(turned < 18.0_f64.sqrt() / STEPS, "{turned}");
            assert!((stored.direction.norm() - 1.0).abs() < 1e-12);
            assert!((0.75..1.35).contains(&(stored.sigma / 2e-3)));
            for camera in cameras {
                let away = camera - landmark;
                let distance = away.norm();
                assert!((stored.near..=stored.far).contains(&distance));
                let angle = acos(away.dot(&stored.direction) / distance);
                assert!(angle < stored.half_angle + turned + 1e-9);
            }
        }
    }

    #[test]
    fn a_landmark_without_cameras_has_no_cone() {
        let p = Vector3::new(1.0, 2.0, 3.0);
        assert!(ViewCone::of(&p, [].into_iter(), 0.1).is_none());
        assert!(ViewCone::of(&p, [p].into_iter(), 0.1).is_none());
        let opposite = [p + Vector3::x(), p - Vector3::x()];
        assert!(ViewCone::of(&p, opposite.into_iter(), 0.1).is_none());
    }
}
