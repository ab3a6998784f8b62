//! Which option mends what the pictures contradict.

use landline::mapping::TrackError;
use landline::reconstruction::Misreading;

/// What follows an error's own words: empty, or begins with a semicolon.
pub(super) fn of(error: &TrackError) -> String {
    let option = match error {
        TrackError::PosesContradicted { .. } => "--trust-poses uses them as they are".to_owned(),
        TrackError::PoseConvention { misreading, .. } => match misreading {
            Misreading::WorldFromCam => DIRECTION.to_owned(),
            Misreading::Axes { axes, is_inverted } => {
                both(*is_inverted, &format!("--camera-axes {axes}"))
            }
            Misreading::Quaternions {
                is_real_last,
                is_inverted,
            } => both(
                *is_inverted,
                if *is_real_last {
                    "--quaternions xyzw"
                } else {
                    "--quaternions wxyz"
                },
            ),
            Misreading::WorldFromLeftHandedCam => {
                "then use --pose-direction world-from-cam".to_owned()
            }
            Misreading::Focal { .. } => "--camera MODEL,W,H,... states the right ones".to_owned(),
            Misreading::LeftHanded | Misreading::MirroredPictures | Misreading::Shifted { .. } => {
                return String::new();
            }
        },
        _ => return String::new(),
    };
    format!("; {option}")
}

const DIRECTION: &str = "use the other --pose-direction";

fn both(is_inverted: bool, option: &str) -> String {
    if is_inverted {
        format!("{DIRECTION} and {option}")
    } else {
        format!("use {option}")
    }
}
