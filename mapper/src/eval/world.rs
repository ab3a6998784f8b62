//! Whether a scene and the data it is evaluated on stand in two worlds: every answer may be right in its own, and all are wrong.

use super::ImageResult;
use crate::metres::{MAX_OFF, extent, robust_fit};
use crate::units::Ruler;
use landline::geometry::{CamFromWorld, vector_from_rotation};
use landline::math::stats::median_in_place;
use nalgebra::{Matrix3, Vector3};
use serde::Serialize;

/// Answers that are needed: a similarity has seven numbers, and a position gives three.
const MIN_ANSWERS: usize = 5;
/// Share of the pictures that have to be located surely. A scene of another place locates few.
const MIN_SHARE: f64 = 0.75;
/// The change of world has to take the errors down to this share of what they were.
const MAX_LEFT: f64 = 0.1;
/// Cameras that look farther off than this after the change, in the median, saw something else; the error that counts as
/// right.
const MAX_DEG: f64 = 10.0;

/// So many rotations are tried for the one that most agree with: each costs a look at all.
const MAX_CANDIDATES: usize = 100;

/// The change that brings answers to the data's poses.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct OtherWorld {
    /// Units of the data in one of the scene.
    pub scale: f64,
    /// Angle between the axes.
    pub turn_deg: f64,
    /// Median error of positions as they are, in the data's unit.
    pub before: f64,
    /// The same after the change.
    pub after: f64,
}

impl OtherWorld {
    /// Of evaluated pictures: none unless nearly all are located surely, and one similarity explains what is wrong with them.
    pub fn of(images: &[ImageResult], confident: f64) -> Option<Self> {
        let sure = |image: &ImageResult| {
            image.confidence.filter(|c| *c > confident)?;
            Some((image.truth, image.cam_from_world?))
        };
        let answers: Vec<_> = images.iter().filter_map(sure).collect();
        let is_enough =
            answers.len() >= MIN_ANSWERS && answers.len() as f64 >= MIN_SHARE * images.len() as f64;
        is_enough.then(|| Self::between(&answers)).flatten()
    }

    /// Of poses in the data's world and in the scene's.
    fn between(answers: &[(CamFromWorld, CamFromWorld)]) -> Option<Self> {
        let centers: Vec<_> = answers
            .iter()
            .map(|(truth, found)| (truth.center_in_world(), found.center_in_world()))
            .collect();
        let (data_from_scene, after, _) = robust_fit(&centers)?;
        let apart = |(truth, found): &(Vector3<f64>, Vector3<f64>)| (truth - found).norm();
        let before = median_in_place(&mut centers.iter().map(apart).collect::<Vec<f64>>())?;
        // Cameras along a straight way leave the turn about it open; how each camera looks does not.
        let turns: Vec<_> = answers
            .iter()
            .map(|(truth, found)| truth.rotation.transpose() * found.rotation)
            .collect();
        let (turn, spread_deg) = agreed(&turns)?;
        let limit = MAX_OFF * extent(centers.iter().map(|(truth, _)| *truth));
        let is_other =
            before > limit && after <= limit && after <= MAX_LEFT * before && spread_deg <= MAX_DEG;
        is_other.then(|| Self {
            scale: data_from_scene.scale,
            turn_deg: angle_deg(&turn),
            before,
            after,
        })
    }

    /// For people.
    pub fn text(&self, ruler: &Ruler) -> String {
        format!(
            "scene and data are in two different worlds: as they are the answers are {} off (median), after one turn of \
             {:.1} deg, a shift and a scale of {:.4} only {}. The figures say nothing of the scene then: take poses of the \
             world that it was taught in",
            ruler.text(self.before),
            self.turn_deg,
            self.scale,
            ruler.text(self.after)
        )
    }
}

/// The rotation that is nearest to the others, and its median angle to them in degrees.
fn agreed(turns: &[Matrix3<f64>]) -> Option<(Matrix3<f64>, f64)> {
    let step = turns.len().div_ceil(MAX_CANDIDATES).max(1);
    let spread = |turn: &Matrix3<f64>| {
        let mut angles: Vec<f64> = turns
            .iter()
            .map(|other| angle_deg(&(turn.transpose() * other)))
            .collect();
        Some((*turn, median_in_place(&mut angles)?))
    };
    let all = turns.iter().step_by(step).filter_map(spread);
    all.min_by(|a, b| a.1.total_cmp(&b.1))
}

fn angle_deg(turn: &Matrix3<f64>) -> f64 {
    vector_from_rotation(turn).norm().to_degrees()
}

#[cfg(test)]
mod tests {
    use super::*;
    use landline::geometry::{Similarity, rotation_from_vector};
    use landline::scene_file::Units;

    /// Cameras round a room of about four metres.
    fn truths() -> Vec<CamFromWorld> {
        let pose = |i: usize| {
            let center = Vector3::new(
                i as f64 * 0.4,
                (i * i % 7) as f64 * 0.3,
                (i % 3) as f64 * 0.2,
            );
            let rotation = rotation_from_vector(&(0.3 * center));
            CamFromWorld::new(rotation, -(rotation * center))
        };
        (0..10).map(pose).collect()
    }

    fn between(change: impl Fn(usize, &CamFromWorld) -> CamFromWorld) -> Option<OtherWorld> {
        let pair = |(i, truth): (usize, &CamFromWorld)| (*truth, change(i, truth));
        OtherWorld::between(&truths().iter().enumerate().map(pair).collect::<Vec<_>>())
    }

    #[test]
    fn answers_in_another_world_are_told_and_wrong_ones_in_the_same_are_not() {
        let scene_from_data = Similarity {
            scale: 0.4,
            rotation: rotation_from_vector(&Vector3::new(0.0, 0.0, 1.5)),
            translation: Vector3::new(3.0, -2.0, 1.0),
        };
        // One of them is wrong in its own world too: at another's place.
        let truths = truths();
        let told =
            between(|i, t| scene_from_data.transform_pose(if i == 4 { &truths[0] } else { t }));
        let told = told.expect("another world");
        assert!((told.scale - 2.5).abs() < 1e-6, "{told:?}");
        assert!(
            (told.turn_deg - 1.5_f64.to_degrees()).abs() < 1e-4,
            "{told:?}"
        );
        assert!(told.before > 1.0 && told.after < 1e-6, "{told:?}");
        let text = told.text(&Ruler::of(Units::Metres));
        assert!(text.contains("two different worlds"), "{text}");
        // Cameras that look elsewhere than the data's, each in its way, are wrong wherever they stand.
        let astray = between(|i, t| {
            let astray = rotation_from_vector(&Vector3::new(i as f64, 0.0, 0.5)) * t.rotation;
            let center = scene_from_data.transform_point(&t.center_in_world());
            CamFromWorld::new(astray, -(astray * center))
        });
        assert_eq!(astray, None);
        // Right answers, answers that are a little off all in one direction, and answers in disorder.
        assert_eq!(between(|_, t| *t), None);
        let shifted = |_: usize, t: &CamFromWorld| {
            CamFromWorld::new(t.rotation, t.translation + Vector3::new(0.02, 0.0, 0.0))
        };
        assert_eq!(between(shifted), None);
        assert_eq!(between(|i, _| truths[(i * 7 + 3) % truths.len()]), None);
    }
}
