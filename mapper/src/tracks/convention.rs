//! Are the poses what they are said to be? Matches that no pose had a say in are tested against the epipolar geometry of
//! the poses as given, and of the usual mistakes.

use super::View;
use super::matching::{epipolar_distance, essential, mutual_neighbours};
use landline::geometry::{CamFromWorld, Rigid};
use landline::math::stats::median_in_place;
use nalgebra::Matrix3;
use rayon::prelude::*;

/// A way to misread poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Misreading {
    /// They map the camera into the world.
    WorldFromCam,
    /// Their cameras have y up and z backward.
    OpenGlAxes,
    /// Both.
    WorldFromOpenGlCam,
}

impl std::fmt::Display for Misreading {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::WorldFromCam => {
                "world from camera, not camera from world (or the other way round); use the other --pose-direction"
            }
            Self::OpenGlAxes => {
                "poses of cameras with OpenGL axes (y up, z backward); negate the second and third row of rotation and \
                 translation, or write a transforms.json, which has these axes"
            }
            Self::WorldFromOpenGlCam => {
                "world from camera with OpenGL axes (y up, z backward), as a transforms.json has them; write one, or \
                 invert the poses and negate the second and third row"
            }
        })
    }
}

/// What the matches say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConventionCheck {
    /// Median over pairs of the share of matches that agree with the poses as given.
    pub as_given: f64,
    /// The misreading that agrees best, and its share.
    pub best_other: (Misreading, f64),
    /// Pairs that had enough matches to say anything.
    pub num_pairs: usize,
}

impl ConventionCheck {
    /// The misreading, when it explains the matches far better than the poses as given.
    pub fn misreading(&self) -> Option<Misreading> {
        let (misreading, share) = self.best_other;
        (self.num_pairs >= 5 && share >= 0.3 && self.as_given < 0.5 * share).then_some(misreading)
    }
}

/// Fewer matches than this say nothing about a pair.
const MIN_MATCHES: usize = 30;
const MAX_EPIPOLAR_PX: f64 = 3.0;

/// Tests up to `num_pairs` pairs of pictures that follow each other at a distance in the list.
pub fn check_convention(
    views: &[View],
    num_pairs: usize,
    min_cosine: f32,
) -> Option<ConventionCheck> {
    let n = views.len();
    let step = (2 * n).div_ceil(num_pairs).max(1);
    let pairs: Vec<(usize, usize)> = (0..n)
        .step_by(step)
        .flat_map(|i| [3, 10].map(|gap| (i, i + gap.min(n / 2).max(1))))
        .filter(|(_, j)| *j < n)
        .collect();
    let candidates: [(Option<Misreading>, fn(&CamFromWorld) -> CamFromWorld); 4] = [
        (None, |t| *t),
        (Some(Misreading::WorldFromCam), inverted),
        (Some(Misreading::OpenGlAxes), flipped),
        (Some(Misreading::WorldFromOpenGlCam), |t| {
            flipped(&inverted(t))
        }),
    ];
    let shares: Vec<[f64; 4]> = pairs
        .par_iter()
        .filter_map(|&(i, j)| {
            let (a, b) = (&views[i], &views[j]);
            let matches = mutual_neighbours(&a.descriptors_dn, &b.descriptors_dn, min_cosine);
            if matches.len() < MIN_MATCHES {
                return None;
            }
            let limit = MAX_EPIPOLAR_PX / (0.5 * (a.focal_px + b.focal_px));
            Some(candidates.map(|(_, read)| {
                let e = essential(&read(&a.cam_from_world), &read(&b.cam_from_world));
                let agree = matches
                    .iter()
                    .filter(|(k, l, _)| {
                        match (a.planar.get(*k as usize), b.planar.get(*l as usize)) {
                            (Some(p), Some(q)) => {
                                epipolar_distance(&e, &p.push(1.0), &q.push(1.0)) <= limit
                            }
                            _ => false,
                        }
                    })
                    .count();
                agree as f64 / matches.len() as f64
            }))
        })
        .collect();
    let median = |k: usize| median_in_place(&mut shares.iter().map(|s| s[k]).collect::<Vec<f64>>());
    let as_given = median(0)?;
    let mut best_other = (Misreading::WorldFromCam, 0.0);
    for (k, (misreading, _)) in candidates.iter().enumerate() {
        if let (Some(misreading), Some(share)) = (misreading, median(k)) {
            if share > best_other.1 {
                best_other = (*misreading, share);
            }
        }
    }
    Some(ConventionCheck {
        as_given,
        best_other,
        num_pairs: shares.len(),
    })
}

fn inverted(t: &CamFromWorld) -> CamFromWorld {
    let inverse = t.inverse();
    Rigid::new(inverse.rotation, inverse.translation)
}

fn flipped(t: &CamFromWorld) -> CamFromWorld {
    let flip = Matrix3::from_diagonal(&[1.0, -1.0, -1.0].into());
    Rigid::new(flip * t.rotation, flip * t.translation)
}
