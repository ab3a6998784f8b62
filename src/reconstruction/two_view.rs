//! What two pictures without poses say about each other: which matches agree, how the camera moved, and what kind of pair it is.
//!
//! The label decides what a pair may do: *general* pairs start a reconstruction and vote on the focal length; *planar* ones
//! grow it; pairs that only turned do neither and triangulate nothing.

use super::planes::{Fundamental, Homography, PlacePair, Turn};
use super::relative::{RelativePose, choose_by_cheirality, refine_pose, sampson_sq};
use super::robust::{RobustOptions, RobustProblem, inliers_of, search};
use crate::geometry::{Cam, Rigid};
use crate::math::{Rng, stats};
use nalgebra::{Matrix3, Vector2, Vector3};

/// How two pictures are compared.
#[derive(Debug, Clone, PartialEq)]
pub struct TwoViewParams {
    /// Largest distance from the epipolar line (Sampson) or from the transferred place.
    pub max_error_px: f64,
    /// Fewer agreeing matches are chance.
    pub min_inliers: usize,
    /// Least share of agreeing matches.
    pub min_inlier_share: f64,
    /// Minimal samples at most.
    pub max_iterations: usize,
    /// A model of less freedom explains a pair when it explains this share of what the epipolar geometry explains.
    pub simpler_share: f64,
    /// Median angle between rays below which a pair has only turned.
    pub min_parallax_deg: f64,
}

impl Default for TwoViewParams {
    fn default() -> Self {
        Self {
            max_error_px: 2.5,
            min_inliers: 20,
            min_inlier_share: 0.1,
            max_iterations: 1_500,
            simpler_share: 0.85,
            min_parallax_deg: 1.0,
        }
    }
}

/// What kind of pair it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TwoViewKind {
    /// Depth and movement.
    General,
    /// One plane explains the matches; the movement may be mirrored at it.
    Planar,
    /// A turn about the camera's centre explains the matches.
    RotationOnly,
}

/// Two pictures that show the same thing.
#[derive(Debug, Clone, PartialEq)]
pub struct TwoView {
    /// Label.
    pub kind: TwoViewKind,
    /// Movement from the first camera to the second; the translation has unit length and means nothing for a turn.
    pub b_from_a: Rigid<Cam, Cam>,
    /// Positions in the list of matches that agree, ascending.
    pub inliers: Vec<usize>,
    /// Median angle between the rays of an agreeing match.
    pub parallax_rad: f64,
}

/// Essential matrix from places on the plane z = 1.
struct Essential<'a>(&'a [PlacePair]);

/// An essential matrix, with its pose once that is known.
#[derive(Clone)]
struct EssentialModel {
    matrix: Matrix3<f64>,
    pose: Option<RelativePose>,
}

impl RobustProblem for Essential<'_> {
    type Model = EssentialModel;
    const SAMPLE: usize = 5;

    fn num_items(&self) -> usize {
        self.0.len()
    }

    fn solve(&self, sample: &[usize], out: &mut Vec<EssentialModel>) {
        let mut a = [Vector3::zeros(); 5];
        let mut b = [Vector3::zeros(); 5];
        for (k, i) in sample.iter().enumerate() {
            (a[k], b[k]) = (self.0[*i].0.normalize(), self.0[*i].1.normalize());
        }
        let mut found = Vec::with_capacity(10);
        super::five_point::five_point(&a, &b, &mut found);
        out.extend(
            found
                .into_iter()
                .map(|matrix| EssentialModel { matrix, pose: None }),
        );
    }

    fn error_sq(&self, model: &EssentialModel, item: usize) -> f64 {
        let (a, b) = &self.0[item];
        sampson_sq(&model.matrix, a, b)
    }

    fn refine(&self, model: &EssentialModel, inliers: &[usize]) -> Option<EssentialModel> {
        let pairs = inliers.iter().map(|i| self.0[*i]);
        let start = match model.pose {
            Some(pose) => pose,
            None => choose_by_cheirality(&model.matrix, pairs.clone())?.0,
        };
        let worst = inliers
            .iter()
            .map(|i| self.error_sq(model, *i))
            .fold(0.0, f64::max);
        let pose = refine_pose(&start, pairs, worst.max(1e-16), 4)?;
        Some(EssentialModel {
            matrix: pose.essential(),
            pose: Some(pose),
        })
    }
}

fn places(a: &[Vector2<f64>], b: &[Vector2<f64>], matches: &[(u32, u32)]) -> Vec<PlacePair> {
    // A keypoint without a bearing is NaN: its error is never below a limit.
    let place = |p: &[Vector2<f64>], i: u32| {
        p.get(i as usize)
            .copied()
            .unwrap_or(Vector2::repeat(f64::NAN))
            .push(1.0)
    };
    matches
        .iter()
        .map(|(i, j)| (place(a, *i), place(b, *j)))
        .collect()
}

fn options(params: &TwoViewParams, limit: f64) -> RobustOptions {
    RobustOptions {
        max_error_sq: limit * limit,
        max_iterations: params.max_iterations,
        min_iterations: 30,
        confidence: 0.999,
    }
}

/// Compares two calibrated pictures: places of their keypoints on the plane z = 1, matches best first, and the mean focal
/// length, which turns pixels of error into the plane's unit. `None` when they have nothing to do with each other.
pub fn two_view(
    a: &[Vector2<f64>],
    b: &[Vector2<f64>],
    matches: &[(u32, u32)],
    focal_px: f64,
    params: &TwoViewParams,
    seed: u64,
) -> Option<TwoView> {
    if matches.len() < params.min_inliers {
        return None;
    }
    let pairs = places(a, b, matches);
    let limit = params.max_error_px / focal_px;
    let mut rng = Rng::from_seed(seed);
    let problem = Essential(&pairs);
    let found = search(&problem, &options(params, limit), &mut rng)?;
    let least = params
        .min_inliers
        .max((params.min_inlier_share * matches.len() as f64) as usize);
    if found.inliers.len() < least {
        return None;
    }
    let agreeing = || found.inliers.iter().map(|i| pairs[*i]);
    let (pose, _) = match found.model.pose {
        Some(pose) => (pose, 0),
        None => choose_by_cheirality(&found.model.matrix, agreeing())?,
    };
    // Behind either camera a match is not one, whatever its distance from the line.
    let is_parallel = |a: &Vector3<f64>, b: &Vector3<f64>| pose.parallax(a, b) < 0.003;
    let inliers: Vec<usize> = found
        .inliers
        .iter()
        .copied()
        .filter(|i| {
            let (a, b) = &pairs[*i];
            is_parallel(a, b)
                || pose
                    .depths(a, b)
                    .is_some_and(|(za, zb)| za > 0.0 && zb > 0.0)
        })
        .collect();
    if inliers.len() < least {
        return None;
    }
    let mut angles: Vec<f64> = inliers
        .iter()
        .map(|i| pose.parallax(&pairs[*i].0, &pairs[*i].1))
        .collect();
    let parallax_rad = stats::median_in_place(&mut angles)?;
    let own: Vec<PlacePair> = inliers.iter().map(|i| pairs[*i]).collect();
    let enough = (params.simpler_share * own.len() as f64) as usize;
    let simple = RobustOptions {
        max_iterations: 200,
        ..options(params, limit)
    };
    let turn = search(&Turn(&own), &simple, &mut rng);
    let turned = turn.filter(|t| {
        t.inliers.len() >= enough
            || parallax_rad < params.min_parallax_deg.to_radians()
                && t.inliers.len() * 2 > own.len()
    });
    if let Some(turn) = turned {
        return Some(TwoView {
            kind: TwoViewKind::RotationOnly,
            b_from_a: Rigid::new(turn.model, pose.translation),
            inliers,
            parallax_rad,
        });
    }
    let is_planar =
        search(&Homography(&own), &simple, &mut rng).is_some_and(|h| h.inliers.len() >= enough);
    Some(TwoView {
        kind: if is_planar {
            TwoViewKind::Planar
        } else {
            TwoViewKind::General
        },
        b_from_a: Rigid::new(pose.rotation, pose.translation),
        inliers,
        parallax_rad,
    })
}

/// The epipolar geometry of two pictures whose focal length is unknown.
#[derive(Debug, Clone, PartialEq)]
pub struct Uncalibrated {
    /// `b' F a = 0` for places as they were given.
    pub fundamental: Matrix3<f64>,
    /// Matches that agree.
    pub num_inliers: usize,
    /// Whether a homography explains them as well: then they say nothing about the focal length.
    pub is_homography: bool,
}

/// Compares two pictures by places relative to the principal point in any common unit of the order of the picture's size;
/// `unit_px` is that unit in pixels.
pub fn uncalibrated(
    a: &[Vector2<f64>],
    b: &[Vector2<f64>],
    matches: &[(u32, u32)],
    unit_px: f64,
    params: &TwoViewParams,
    seed: u64,
) -> Option<Uncalibrated> {
    if matches.len() < params.min_inliers {
        return None;
    }
    let pairs = places(a, b, matches);
    let limit = params.max_error_px / unit_px;
    let mut rng = Rng::from_seed(seed);
    let found = search(&Fundamental(&pairs), &options(params, limit), &mut rng)?;
    if found.inliers.len() < params.min_inliers {
        return None;
    }
    let own: Vec<PlacePair> = found.inliers.iter().map(|i| pairs[*i]).collect();
    let simple = RobustOptions {
        max_iterations: 300,
        ..options(params, limit)
    };
    let is_homography = search(&Homography(&own), &simple, &mut rng).is_some_and(|h| {
        let explained = inliers_of(&Homography(&own), &h.model, limit * limit);
        explained.len() as f64 >= params.simpler_share * own.len() as f64
    });
    Some(Uncalibrated {
        fundamental: found.model,
        num_inliers: own.len(),
        is_homography,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::rotation_from_vector;

    const FOCAL: f64 = 525.0;

    /// Places in both views, and the matches.
    type Seen = (Vec<Vector2<f64>>, Vec<Vector2<f64>>, Vec<(u32, u32)>);

    fn see(
        rng: &mut Rng,
        rotation: &Matrix3<f64>,
        translation: &Vector3<f64>,
        point: impl Fn(&mut Rng) -> Vector3<f64>,
    ) -> Seen {
        let (mut a, mut b) = (Vec::new(), Vec::new());
        while a.len() < 240 {
            let p = point(rng);
            let q = rotation * p + translation;
            if q.z < 0.3 {
                continue;
            }
            let mut noise = || Vector2::new(0.7 * rng.normal(), 0.7 * rng.normal()) / FOCAL;
            a.push(p.xy() / p.z + noise());
            b.push(q.xy() / q.z + noise());
        }
        // The last third is wrong.
        for p in b.iter_mut().skip(160) {
            *p = Vector2::new(rng.range(-0.6, 0.6), rng.range(-0.45, 0.45));
        }
        (a, b, (0..240).map(|i| (i, i)).collect())
    }

    fn deep(rng: &mut Rng) -> Vector3<f64> {
        Vector3::new(rng.range(-0.6, 0.6), rng.range(-0.45, 0.45), 1.0) * rng.range(1.5, 6.0)
    }

    fn wall(rng: &mut Rng) -> Vector3<f64> {
        let (x, y) = (rng.range(-0.6, 0.6), rng.range(-0.45, 0.45));
        Vector3::new(x, y, 1.0) * (3.0 / (1.0 + 0.4 * x))
    }

    #[test]
    fn labels_are_those_of_the_movement() {
        let params = TwoViewParams::default();
        for seed in 0..20 {
            let mut rng = Rng::from_seed(seed);
            let r = rotation_from_vector(&Vector3::from_fn(|_, _| 0.08 * rng.normal()));
            let t = Vector3::new(0.4, 0.1 * rng.normal(), 0.1 * rng.normal());
            let (a, b, matches) = see(&mut rng, &r, &t, deep);
            let found = two_view(&a, &b, &matches, FOCAL, &params, seed).expect("general");
            assert_eq!(found.kind, TwoViewKind::General);
            assert!((found.b_from_a.rotation - r).norm() < 0.02);
            assert!(found.b_from_a.translation.angle(&t) < 0.05);
            let right = found.inliers.iter().filter(|i| **i < 160).count();
            assert!(right >= 150 && found.inliers.len() - right < 15);

            let (a, b, matches) = see(&mut rng, &r, &t, wall);
            let found = two_view(&a, &b, &matches, FOCAL, &params, seed).expect("planar");
            assert_eq!(found.kind, TwoViewKind::Planar);

            let (a, b, matches) = see(&mut rng, &r, &Vector3::zeros(), deep);
            let found = two_view(&a, &b, &matches, FOCAL, &params, seed).expect("turned");
            assert_eq!(found.kind, TwoViewKind::RotationOnly);
            assert!((found.b_from_a.rotation - r).norm() < 0.01);
        }
    }

    #[test]
    fn foreign_pictures_have_nothing_in_common() {
        for seed in 0..20 {
            let mut rng = Rng::from_seed(seed);
            let mut place = || Vector2::new(rng.range(-0.6, 0.6), rng.range(-0.45, 0.45));
            let a: Vec<_> = (0..120).map(|_| place()).collect();
            let b: Vec<_> = (0..120).map(|_| place()).collect();
            let matches: Vec<_> = (0..120).map(|i| (i, i)).collect();
            let params = TwoViewParams::default();
            let found = two_view(&a, &b, &matches, FOCAL, &params, seed);
            assert!(found.is_none(), "{:?}", found.map(|f| f.inliers.len()));
            assert!(two_view(&a, &b, &[], FOCAL, &params, seed).is_none());
            assert!(two_view(&a, &b, &[(500, 0); 30], FOCAL, &params, seed).is_none());
        }
    }
}
