//! Are the poses what they are said to be? Matches that no pose had a say in are tested against the epipolar geometry of
//! the poses as given, and of the usual mistakes; what agrees must also lie in front of both cameras.

use super::PosedView;
use super::matching::{MutualMatcher, epipolar_distance, essential};
use super::triangulate::Ray;
use crate::geometry::{CamFromWorld, Rigid};
use crate::math::parallel;
use crate::math::stats::median_in_place;
use nalgebra::{Matrix3, Vector2};

/// A way to misread poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Misreading {
    /// They map the camera into the world.
    WorldFromCam,
    /// Their cameras have y up and z backward.
    OpenGlAxes,
    /// Both.
    WorldFromOpenGlCam,
    /// Camera and world have y up and are left-handed, as in Unity: rotations are proper, and yet the world is mirrored.
    LeftHanded,
    /// The same, world from camera.
    WorldFromLeftHandedCam,
    /// The pictures are mirrored left to right, as selfie cameras store them.
    MirroredPictures,
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
            Self::LeftHanded => {
                "mirrored: poses of a left-handed world with y up, as Unity has it; change the sign of y in world and camera \
                 (negate the second row and the second column of the rotation and the second number of the translation)"
            }
            Self::WorldFromLeftHandedCam => {
                "mirrored and world from camera: poses of a left-handed world with y up, as Unity has it; change the sign of \
                 y in world and camera (negate the second row and the second column of the rotation and the second number \
                 of the translation) and use --pose-direction world-from-cam"
            }
            Self::MirroredPictures => {
                "of pictures that are not mirrored, but these are, left to right, as selfie cameras store them; mirror the \
                 pictures back"
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

/// Turns a pose as it was read into the pose that it would be.
type Reading = fn(&CamFromWorld) -> CamFromWorld;

/// As given, and the mistakes.
const READINGS: [(Option<Misreading>, Reading); 7] = [
    (None, |t| *t),
    (Some(Misreading::WorldFromCam), inverted),
    (Some(Misreading::OpenGlAxes), flipped),
    (Some(Misreading::WorldFromOpenGlCam), |t| {
        flipped(&inverted(t))
    }),
    (Some(Misreading::LeftHanded), |t| mirrored(t, 1)),
    (Some(Misreading::WorldFromLeftHandedCam), |t| {
        mirrored(&inverted(t), 1)
    }),
    // A picture mirrored left to right is what a camera sees of a world mirrored in x.
    (Some(Misreading::MirroredPictures), |t| mirrored(t, 0)),
];

/// Fewer matches than this say nothing about a pair.
const MIN_MATCHES: usize = 30;
const MAX_EPIPOLAR_PX: f64 = 3.0;

/// Tests up to `num_pairs` pairs of pictures that follow each other at a distance in the list.
pub fn check_convention(
    views: &[PosedView<'_>],
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
    let shares: Vec<[f64; READINGS.len()]> =
        parallel::map_with(pairs.len(), MutualMatcher::default, |matcher, pair| {
            let (i, j) = pairs[pair];
            let (a, b) = (&views[i], &views[j]);
            matcher.set_first(a.features);
            let matches: Vec<_> = matcher.matches(b.features, min_cosine).collect();
            if matches.len() < MIN_MATCHES {
                return None;
            }
            let limit = MAX_EPIPOLAR_PX / (0.5 * (a.focal_px + b.focal_px));
            Some(READINGS.map(|(_, read)| {
                let (pose_a, pose_b) = (read(&a.cam_from_world), read(&b.cam_from_world));
                let e = essential(&pose_a, &pose_b);
                let agree = matches
                    .iter()
                    .filter(|(k, l, _)| {
                        match (a.planar.get(*k as usize), b.planar.get(*l as usize)) {
                            (Some(p), Some(q)) => {
                                epipolar_distance(&e, &p.push(1.0), &q.push(1.0)) <= limit
                                    && is_in_front([(&pose_a, p), (&pose_b, q)])
                            }
                            _ => false,
                        }
                    })
                    .count();
                agree as f64 / matches.len() as f64
            }))
        })
        .into_iter()
        .flatten()
        .collect();
    let median = |k: usize| median_in_place(&mut shares.iter().map(|s| s[k]).collect::<Vec<f64>>());
    let as_given = median(0)?;
    let mut best_other = (Misreading::WorldFromCam, 0.0);
    for (k, (misreading, _)) in READINGS.iter().enumerate() {
        if let (Some(misreading), Some(share)) = (misreading, median(k))
            && share > best_other.1
        {
            best_other = (*misreading, share);
        }
    }
    Some(ConventionCheck {
        as_given,
        best_other,
        num_pairs: shares.len(),
    })
}

/// Whether two cameras have the point that both see in front of them; yes where they see it in nearly the same direction.
/// Some mistakes have the same epipolar geometry and differ in this only.
fn is_in_front(seen: [(&CamFromWorld, &Vector2<f64>); 2]) -> bool {
    const LEAST_ANGLE_RAD: f64 = 0.01;
    let [a, b] = seen.map(|(pose, planar)| Ray {
        origin: pose.center_in_world(),
        direction: pose.rotation.transpose() * planar.push(1.0).normalize(),
    });
    a.angle_to(&b) < LEAST_ANGLE_RAD || a.midpoint(&b).is_some()
}

fn inverted(t: &CamFromWorld) -> CamFromWorld {
    let inverse = t.inverse();
    Rigid::new(inverse.rotation, inverse.translation)
}

fn flipped(t: &CamFromWorld) -> CamFromWorld {
    let flip = Matrix3::from_diagonal(&[1.0, -1.0, -1.0].into());
    Rigid::new(flip * t.rotation, flip * t.translation)
}

/// Changes the sign of an axis of camera and world.
fn mirrored(t: &CamFromWorld, axis: usize) -> CamFromWorld {
    let mut mirror = Matrix3::identity();
    mirror[(axis, axis)] = -1.0;
    Rigid::new(mirror * t.rotation * mirror, mirror * t.translation)
}
