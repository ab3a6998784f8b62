//! Poses of files become rigid transforms or a problem with a name.

use crate::geometry::{CamFromWorld, Rigid, WorldFromCam};
use nalgebra::{Matrix3, Vector3};

/// Largest deviation from an orthonormal matrix that is repaired. 7-Scenes' poses are scaled by about 0.9999; files with
/// three decimals deviate by 1e-3; a scale of 1 % or more means something else than rounding.
const MAX_DEVIATION: f64 = 1e-2;

/// The Earth in micrometres; beyond it a position holds no millimetres of anything.
const MAX_DISTANCE: f64 = 1e13;

/// Why a matrix is no pose.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PoseProblem {
    /// NaN, infinite, or all zero.
    #[error("its numbers are not finite or all zero")]
    NotFinite,
    /// So far away that nothing can be computed there.
    #[error("its position is {distance:.1e} from the origin; subtract an offset from all poses")]
    TooFar {
        /// Length of the translation.
        distance: f64,
    },
    /// Determinant -1.
    #[error(
        "its rotation is mirrored (determinant {determinant:.3}): an axis is flipped, which no camera can do; check \
         the axes with which the file was written"
    )]
    Mirrored {
        /// Of the 3x3 block.
        determinant: f64,
    },
    /// Scaled or sheared.
    #[error(
        "its 3x3 block is no rotation: it deviates from the nearest one by {deviation:.3} (scale {scale:.3}); a \
         similarity has to be taken apart before"
    )]
    NotRigid {
        /// Largest element of the difference.
        deviation: f64,
        /// Cube root of the determinant.
        scale: f64,
    },
}

/// The rigid transform nearest to a 3x3 block and a translation.
///
/// # Errors
/// When the block is mirrored, scaled, sheared or not finite.
pub fn rigid_from_matrix<To, From>(
    block: &Matrix3<f64>,
    translation: Vector3<f64>,
) -> Result<Rigid<To, From>, PoseProblem> {
    if !block
        .iter()
        .chain(translation.iter())
        .all(|v| v.is_finite())
    {
        return Err(PoseProblem::NotFinite);
    }
    let determinant = block.determinant();
    // Of numbers near the largest one it is not finite.
    if determinant == 0.0 || !determinant.is_finite() {
        return Err(PoseProblem::NotFinite);
    }
    if determinant < 0.0 {
        return Err(PoseProblem::Mirrored { determinant });
    }
    let svd = block.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return Err(PoseProblem::NotFinite);
    };
    let rotation = u * v_t;
    let deviation = (block - rotation).abs().max();
    if !(deviation <= MAX_DEVIATION) {
        return Err(PoseProblem::NotRigid {
            deviation,
            scale: determinant.cbrt(),
        });
    }
    check_distance(&translation)?;
    Ok(Rigid::new(rotation, translation))
}

/// The rigid transform of a quaternion w, x, y, z, which must have about unit length, and a translation.
///
/// # Errors
/// When the quaternion is not finite or far from unit length.
pub fn rigid_from_quaternion<To, From>(
    wxyz: [f64; 4],
    translation: Vector3<f64>,
) -> Result<Rigid<To, From>, PoseProblem> {
    let norm = wxyz.iter().map(|v| v * v).sum::<f64>().sqrt();
    if !norm.is_finite() || norm == 0.0 || !translation.iter().all(|v| v.is_finite()) {
        return Err(PoseProblem::NotFinite);
    }
    if !((norm - 1.0).abs() <= MAX_DEVIATION) {
        return Err(PoseProblem::NotRigid {
            deviation: (norm - 1.0).abs(),
            scale: norm,
        });
    }
    check_distance(&translation)?;
    Ok(Rigid::from_quaternion_wxyz(wxyz, translation))
}

fn check_distance(translation: &Vector3<f64>) -> Result<(), PoseProblem> {
    let distance = translation.norm();
    if distance <= MAX_DISTANCE {
        Ok(())
    } else {
        Err(PoseProblem::TooFar { distance })
    }
}

/// Rotation block and translation of a row-major 3x4 or 4x4 matrix.
pub fn block_and_translation(v: &[f64]) -> (Matrix3<f64>, Vector3<f64>) {
    let at = |r: usize, c: usize| v.get(4 * r + c).copied().unwrap_or(f64::NAN);
    (
        Matrix3::from_fn(at),
        Vector3::new(at(0, 3), at(1, 3), at(2, 3)),
    )
}

/// What a pose of a file maps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PoseDirection {
    /// World points into camera space (COLMAP).
    CamFromWorld,
    /// Camera points into the world; its translation is the camera's position.
    WorldFromCam,
}

impl core::fmt::Display for PoseDirection {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::CamFromWorld => "camera from world",
            Self::WorldFromCam => "world from camera",
        })
    }
}

impl PoseDirection {
    /// The transform of our convention.
    ///
    /// # Errors
    /// When it is no pose.
    pub fn cam_from_world(
        self,
        block: &Matrix3<f64>,
        translation: Vector3<f64>,
    ) -> Result<CamFromWorld, PoseProblem> {
        match self {
            Self::CamFromWorld => rigid_from_matrix(block, translation),
            Self::WorldFromCam => {
                rigid_from_matrix(block, translation).map(|t: WorldFromCam| t.inverse())
            }
        }
    }
}

/// Order of a quaternion's numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum QuaternionOrder {
    /// The real part first (COLMAP, Eigen's constructor).
    #[default]
    Wxyz,
    /// The real part last (ROS, scipy, TUM RGB-D).
    Xyzw,
}

impl QuaternionOrder {
    /// The real part first, of numbers as the file has them.
    pub fn wxyz(self, [a, b, c, d]: [f64; 4]) -> [f64; 4] {
        match self {
            Self::Wxyz => [a, b, c, d],
            Self::Xyzw => [d, a, b, c],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repairs_rounding_and_names_what_it_cannot_repair() {
        let exact = CamFromWorld::from_quaternion_wxyz([0.9, 0.1, -0.2, 0.3], Vector3::zeros());
        let t = Vector3::new(1.0, 2.0, 3.0);
        let scaled = exact.rotation * 0.9999;
        let repaired: CamFromWorld = rigid_from_matrix(&scaled, t).expect("rounding only");
        assert!((repaired.rotation - exact.rotation).abs().max() < 1e-12);

        let mut mirrored = exact.rotation;
        mirrored.column_mut(0).neg_mut();
        let problem = rigid_from_matrix::<(), ()>(&mirrored, t).expect_err("mirrored");
        assert!(matches!(problem, PoseProblem::Mirrored { .. }), "{problem}");

        let problem = rigid_from_matrix::<(), ()>(&(exact.rotation * 1.2), t).expect_err("scaled");
        assert!(
            matches!(problem, PoseProblem::NotRigid { scale, .. } if (scale - 1.2).abs() < 1e-9)
        );

        let far = Vector3::new(0.0, 1e200, 0.0);
        assert!(matches!(
            rigid_from_matrix::<(), ()>(&exact.rotation, far),
            Err(PoseProblem::TooFar { .. })
        ));
        // Comparisons with NaN are false, so each of these once passed as a rotation of NaN.
        for huge in [1e308, 1e160, -1e308, 1e-308] {
            for at in 0..9 {
                let mut block = exact.rotation;
                block[at] = huge;
                if let Ok(pose) = rigid_from_matrix::<(), ()>(&block, t) {
                    assert!(
                        pose.rotation.iter().all(|v| v.is_finite()),
                        "{huge} at {at}"
                    );
                }
            }
        }
        let nan = Matrix3::from_element(f64::NAN);
        assert_eq!(
            rigid_from_matrix::<(), ()>(&nan, t),
            Err(PoseProblem::NotFinite)
        );
        assert_eq!(
            rigid_from_quaternion::<(), ()>([0.0; 4], t),
            Err(PoseProblem::NotFinite)
        );
    }
}
