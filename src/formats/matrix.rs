//! One 4x4 matrix in a file, as 7-Scenes and others have beside each picture.

use super::rigid::{PoseProblem, block_and_translation, rigid_from_matrix};
use super::{FormatError, TextFile};
use crate::geometry::{CamFromWorld, WorldFromCam};
use nalgebra::{Matrix3, Vector3};

/// World from camera of such a file, or why its matrix is none: some sets write lost poses as inf or nan, which is a dropped
/// picture and no broken file.
///
/// # Errors
/// When it does not hold sixteen numbers.
pub fn matrix(file: &TextFile) -> Result<Result<WorldFromCam, PoseProblem>, FormatError> {
    let mut numbers = Vec::with_capacity(16);
    for line in file.lines() {
        numbers.extend(line.numbers(&line.fields())?);
    }
    if numbers.len() != 16 {
        return Err(FormatError::whole(
            file.name(),
            format!("expected a 4x4 matrix, found {} numbers", numbers.len()),
        ));
    }
    let (block, translation) = block_and_translation(&numbers);
    Ok(rigid_from_matrix(&block, translation))
}

/// The pose of 7-Scenes' colour camera from that of its depth camera, whose poses the files hold as shipped. The transform was
/// recovered by comparing them with published registered ones (deviation at most 0.2 mm).
pub fn of_color_camera(of_depth_camera: &CamFromWorld) -> CamFromWorld {
    let block = Matrix3::new(
        0.999965, 0.002676, -0.007903, -0.002741, 0.999963, -0.008150, 0.007881, 0.008172, 0.999936,
    );
    let translation = Vector3::new(-0.025519, 0.000129, 0.001937);
    let color_from_depth: CamFromWorld =
        rigid_from_matrix(&block, translation).expect("a rotation but for its six decimals");
    CamFromWorld::new(
        color_from_depth.rotation * of_depth_camera.rotation,
        color_from_depth.rotation * of_depth_camera.translation + color_from_depth.translation,
    )
}
