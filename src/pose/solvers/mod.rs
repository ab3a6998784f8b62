//! Minimal solvers: the poses that satisfy as many constraints as a pose has degrees of freedom.
//!
//! Input: unit bearings and unit normals of the planes through the camera centre and an image line, both in camera space;
//! world points, and world lines as a point and a unit direction. Output: all real solutions with positive depth of the
//! sampled points. A plane normal n of a world line satisfies `n . (R Y + t) = 0` for every Y on the line.
//! Names follow PoseLib: `pXpYll` takes X points and Y lines, a leading `u` means "upright" (gravity known).
//! Nothing allocates, nothing panics; degenerate samples give an empty list.

mod conic;
mod p1p2ll;
mod p2p1ll;
mod p3ll;
mod p3p;
mod pnplf;
mod quadrics;
mod upright;

pub use p1p2ll::p1p2ll;
pub use p2p1ll::p2p1ll;
pub use p3ll::p3ll;
pub use p3p::p3p;
pub use pnplf::{FocalPose, FocalSolutions, ImageLineCentered, pnplf};
pub use upright::{up1p1ll, up2p};

use crate::geometry::CamFromWorld;
use nalgebra::{Matrix3, Vector3};

/// World line of a minimal sample, with the plane that its image spans.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SampleLine {
    /// Unit normal, in camera space, of the plane through the camera centre and the image line.
    pub normal_in_cam: Vector3<f64>,
    /// Any point of the world line.
    pub point_in_world: Vector3<f64>,
    /// Unit direction of the world line.
    pub direction_in_world: Vector3<f64>,
}

/// The minimal solvers of the robust estimator.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SolverKind {
    /// Three points.
    P3p,
    /// Two points, one line.
    P2p1ll,
    /// One point, two lines.
    P1p2ll,
    /// Three lines.
    P3ll,
    /// Two points, gravity known.
    Up2p,
    /// One point, one line, gravity known.
    Up1p1ll,
    /// Four points or lines, focal length unknown.
    Pnplf,
}

impl SolverKind {
    /// How many there are.
    pub const COUNT: usize = 7;

    /// All of them, in the order of [`Self::index`].
    pub const ALL: [Self; Self::COUNT] = [
        Self::P3p,
        Self::P2p1ll,
        Self::P1p2ll,
        Self::P3ll,
        Self::Up2p,
        Self::Up1p1ll,
        Self::Pnplf,
    ];

    /// Position in tables.
    pub fn index(self) -> usize {
        self as usize
    }
}

/// Up to eight poses.
#[derive(Debug, Clone, Copy)]
pub struct Solutions {
    poses: [CamFromWorld; 8],
    len: usize,
}

impl Default for Solutions {
    fn default() -> Self {
        Self {
            poses: [CamFromWorld::identity(); 8],
            len: 0,
        }
    }
}

impl core::ops::Deref for Solutions {
    type Target = [CamFromWorld];

    fn deref(&self) -> &[CamFromWorld] {
        &self.poses[..self.len]
    }
}

impl Solutions {
    /// Forgets all poses.
    pub fn clear(&mut self) {
        self.len = 0;
    }

    /// Replaces every pose.
    pub fn map(&mut self, f: impl Fn(&CamFromWorld) -> CamFromWorld) {
        for pose in &mut self.poses[..self.len] {
            *pose = f(pose);
        }
    }

    /// Adds a pose unless it is not finite or the list is full.
    fn push(&mut self, rotation: Matrix3<f64>, translation: Vector3<f64>) {
        let sum = rotation.sum() + translation.sum();
        if self.len < self.poses.len() && sum.is_finite() {
            self.poses[self.len] = CamFromWorld::new(rotation, translation);
            self.len += 1;
        }
    }
}

/// Right-handed orthonormal basis whose first axis is p and whose second is normal to p and q; `None` when they are parallel.
fn frame(p: &Vector3<f64>, q: &Vector3<f64>) -> Option<Matrix3<f64>> {
    let n = p.cross(q);
    let (pp, nn) = (p.norm_squared(), n.norm_squared());
    if !(nn > 1e-24 * pp * q.norm_squared()) {
        return None;
    }
    let e = p / pp.sqrt();
    let n = n / nn.sqrt();
    Some(Matrix3::from_columns(&[e, n, e.cross(&n)]))
}

/// The rotation that takes the world pair to the camera pair (pairs with equal angle).
fn rotation_from_pairs(
    world: (&Vector3<f64>, &Vector3<f64>),
    cam: (&Vector3<f64>, &Vector3<f64>),
) -> Option<Matrix3<f64>> {
    Some(frame(cam.0, cam.1)? * frame(world.0, world.1)?.transpose())
}

/// A unit vector normal to the given unit vector.
fn any_normal(v: &Vector3<f64>) -> Vector3<f64> {
    let a = v.abs();
    let axis = if a.x <= a.y && a.x <= a.z {
        Vector3::x()
    } else if a.y <= a.z {
        Vector3::y()
    } else {
        Vector3::z()
    };
    v.cross(&axis).normalize()
}

#[cfg(test)]
mod tests;
