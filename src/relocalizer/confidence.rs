//! How sure an answer is: the probability that it is right, as far as one frame tells.

use super::options::CameraSource;
use crate::landmarks::FoundAgain;
use crate::math::elementary::{exp, ln, logistic};
use crate::pose::PoseEstimate;

/// Nats of evidence above chance that make a pose 63 % sure, 95 % at three times as much.
const EVIDENCE_SCALE: f64 = 10.0;

/// Logit of an answer by what the second look found again: constant, and for each unit of ln(1 + number found) and of ln(share of
/// what should be seen). A regression over 211 looks: test pictures of three rooms in their own scenes; in one of these also
/// pictures of another room and enlarged ones. Right is within 25 cm. Chance finds up to 50 in a wrong room, but a twentieth of what should be seen; a
/// view with few landmarks finds a third of them and is still half a metre off.
const FOUND: [f64; 3] = [-10.8, 3.78, 1.72];

/// Factor where the camera is known from the answer's own picture alone. Matches around a wrong projection draw towards it and
/// agree with each other, so they do not tell: of 54 squeezed and cropped pictures of two rooms, without intrinsics, 45 were
/// within 25 cm, all of them with confidences above 0.98 by the rest.
/// So it is where the frame itself does not bear out its camera, the scene's or a given one: before a flat wall a longer focal length
/// from farther off shows the same. Pictures of the sample room that were zoomed by 1.25, or given a focal length 20 % off, lay up
/// to 88 cm off with nothing else to tell.
const OWN_CAMERA: f64 = 0.89;

/// A frame that tells its focal length as well as this, as a standard deviation of ln f, says itself that its camera is right: a
/// wrong one leaves few points in a plane. Of 58 test pictures of three rooms with the scene's camera 0.0006 to 0.0025;
/// of 15 sample pictures zoomed by 1.2 and 1.3 that were taken for unzoomed ones 0.0057 to 0.045.
const TOLD_FOCAL_SIGMA_LN: f64 = 0.004;

/// The confidence of an answer from the correspondences alone, 0 to 1.
fn by_evidence(estimate: &PoseEstimate) -> f64 {
    1.0 - exp(-estimate.log_evidence.max(0.0) / EVIDENCE_SCALE)
}

/// The confidence that what was found again gives, 0 to 1.
fn by_found(found: &FoundAgain) -> f64 {
    let number = f64::from(found.found_points + found.found_lines);
    let [constant, by_number, by_share] = FOUND;
    logistic(constant + by_number * ln(1.0 + number) + by_share * ln(found.share().max(1e-3)))
}

/// The confidence of an answer. `found` is what a second look found again, where the scene has landmarks to look for;
/// `camera_source` says how the intrinsics came to be known in the end; `focal_sigma_ln` how well the frame itself tells their focal
/// length.
pub(super) fn confidence(
    estimate: &PoseEstimate,
    found: Option<&FoundAgain>,
    camera_source: CameraSource,
    focal_sigma_ln: Option<f64>,
) -> f64 {
    let evidence = by_evidence(estimate);
    let sure = found.map_or(evidence, |found| evidence.min(by_found(found)));
    vouched(sure, camera_source, focal_sigma_ln)
}

/// Fewer of the last look's matches agree where a picture is stretched and no other camera was found (0.5 to 0.65). Pictures that were
/// right had 0.7 and more in three rooms, parts of pictures 0.61.
const LEAST_FITTING: f64 = 0.68;

/// What is left of a confidence where only such a share of what was matched agrees.
pub(super) fn fitting(sure: f64, share: f64) -> f64 {
    if share < LEAST_FITTING {
        OWN_CAMERA * sure
    } else {
        sure
    }
}

/// What is left of a confidence where the frame does not vouch for the camera.
fn vouched(sure: f64, camera_source: CameraSource, focal_sigma_ln: Option<f64>) -> f64 {
    let is_told = focal_sigma_ln.is_some_and(|sigma| sigma < TOLD_FOCAL_SIGMA_LN);
    match camera_source {
        // Learned of many frames.
        CameraSource::Remembered => sure,
        CameraSource::Estimated | CameraSource::Assumed => OWN_CAMERA * sure,
        _ if is_told => sure,
        _ => OWN_CAMERA * sure,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Answers of three rooms' second looks: found of visible, and whether they were within 25 cm.
    #[test]
    fn few_of_many_and_few_at_all_are_not_confident() {
        let found = |found_points: u32, visible_points: u32| FoundAgain {
            found_points,
            visible_points,
            ..FoundAgain::default()
        };
        for (n, of) in [(205, 1750), (311, 2300), (110, 1100)] {
            assert!(by_found(&found(n, of)) > 0.95, "{n} of {of}");
        }
        // 4.9 m, 0.44 m, 0.59 m off, and three rooms that are others.
        for (n, of) in [
            (35, 539),
            (39, 251),
            (20, 57),
            (21, 408),
            (47, 1096),
            (30, 921),
        ] {
            assert!(by_found(&found(n, of)) < 0.6, "{n} of {of}");
        }
        assert!(by_found(&FoundAgain::default()) < 1e-6);
    }

    #[test]
    fn matches_that_do_not_agree_are_not_confident() {
        assert!(fitting(1.0, 0.72) > 0.99);
        assert!(fitting(1.0, 0.6) < 0.9);
    }

    #[test]
    fn a_frame_that_tells_its_focal_length_vouches_for_the_scenes_camera() {
        assert!(vouched(1.0, CameraSource::Scene, Some(0.0015)) > 0.99);
        for sigma in [Some(0.0057), Some(f64::NAN), None] {
            assert!(vouched(1.0, CameraSource::Scene, sigma) < 0.9, "{sigma:?}");
        }
        // So for a given one: before a flat wall nobody sees that it is wrong.
        assert!(vouched(1.0, CameraSource::Given, Some(0.0015)) > 0.99);
        assert!(vouched(1.0, CameraSource::Given, Some(0.0057)) < 0.9);
        assert!(vouched(1.0, CameraSource::Remembered, None) > 0.99);
        // What was solved from the frame itself agrees with it in any case.
        assert!(vouched(1.0, CameraSource::Estimated, Some(0.001)) < 0.9);
    }
}
