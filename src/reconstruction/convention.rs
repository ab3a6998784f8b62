//! Are the poses what they are said to be? Matches that no pose had a say in are tested against the epipolar geometry of
//! the poses as given, and of the usual mistakes; what agrees must also lie in front of both cameras.

use super::PosedView;
use super::matching::{MutualMatcher, epipolar_distance, essential};
use super::triangulate::Ray;
use crate::geometry::{CamFromWorld, CameraAxes, Rigid};
use crate::math::parallel;
use crate::math::stats::median_in_place;
use nalgebra::{Matrix3, Vector2};

/// A way to misread poses, or what belongs to them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Misreading {
    /// They map the camera into the world.
    WorldFromCam,
    /// Their cameras have other axes.
    Axes {
        /// Those, by ours.
        axes: CameraAxes,
        /// And they map the camera into the world.
        is_inverted: bool,
    },
    /// Their quaternions have the real part at the other end.
    Quaternions {
        /// It is the last number.
        is_real_last: bool,
        /// And they map the camera into the world, or the other way round.
        is_inverted: bool,
    },
    /// Camera and world have y up and are left-handed, as in Unity: rotations are proper, and yet the world is mirrored.
    LeftHanded,
    /// The same, world from camera.
    WorldFromLeftHandedCam,
    /// The pictures are mirrored left to right, as selfie cameras store them.
    MirroredPictures,
    /// The focal lengths are those of another lens or another size of the pictures.
    Focal {
        /// Of the right one by the given one.
        factor: f64,
    },
    /// Each pose is of the picture so many places further in the list.
    Shifted {
        /// Places.
        by: isize,
    },
}

impl std::fmt::Display for Misreading {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        const DIRECTION: &str = "world from camera, not camera from world (or the other way round)";
        match self {
            Self::WorldFromCam => f.write_str(DIRECTION),
            Self::Axes { axes, is_inverted } => {
                if *is_inverted {
                    write!(f, "{DIRECTION}; and ")?;
                }
                write!(f, "of cameras whose x, y and z axes point {}", axes.words())?;
                if *axes == CameraAxes::OPENGL {
                    f.write_str(" (OpenGL axes)")?;
                }
                Ok(())
            }
            Self::Quaternions {
                is_real_last,
                is_inverted,
            } => {
                if *is_inverted {
                    write!(f, "{DIRECTION}; and ")?;
                }
                f.write_str(if *is_real_last {
                    "of quaternions x y z w, with the real part last"
                } else {
                    "of quaternions w x y z, with the real part first"
                })
            }
            Self::LeftHanded => f.write_str(
                "mirrored: poses of a left-handed world with y up, as Unity has it; change the sign of y in world and camera \
                 (negate the second row and the second column of the rotation and the second number of the translation)",
            ),
            Self::WorldFromLeftHandedCam => f.write_str(
                "mirrored and world from camera: poses of a left-handed world with y up, as Unity has it; change the sign of \
                 y in world and camera (negate the second row and the second column of the rotation and the second number \
                 of the translation)",
            ),
            Self::MirroredPictures => f.write_str(
                "of pictures that are not mirrored, but these are, left to right, as selfie cameras store them; mirror the \
                 pictures back",
            ),
            Self::Focal { factor } => write!(
                f,
                "of a camera whose focal length is about {factor:.2} times the given one: intrinsics of another lens, or of \
                 pictures of another size"
            ),
            Self::Shifted { by } => write!(
                f,
                "those of the picture {} each one in the list: pictures and poses are shifted against each other",
                if *by > 0 { "before" } else { "after" }
            ),
        }
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

/// Pairs that have to be there before poses are refused.
const ENOUGH_PAIRS: usize = 5;

impl ConventionCheck {
    /// Below this share poses say less of the matches than chance and a rough guess would: nothing good comes of them.
    pub const REFUSED_BELOW: f64 = 0.12;
    /// Poses that pictures were really taken at explain more than this share as a rule.
    pub const USUAL: f64 = 0.4;

    /// The misreading, when it explains the matches far better than the poses as given.
    pub fn misreading(&self) -> Option<Misreading> {
        let (misreading, share) = self.best_other;
        (self.num_pairs >= ENOUGH_PAIRS && share >= 0.3 && self.as_given < 0.5 * share)
            .then_some(misreading)
    }

    /// Whether the poses contradict the pictures, whatever the reason.
    pub fn is_refused(&self) -> bool {
        self.num_pairs >= ENOUGH_PAIRS && self.as_given < Self::REFUSED_BELOW
    }
}

/// Another way to read a set of poses.
struct Reading {
    misreading: Misreading,
    /// Turns a pose as it was read into the pose that it would be.
    read: Box<dyn Fn(&CamFromWorld) -> CamFromWorld + Sync>,
    focal: f64,
    shift: isize,
}

/// Focal lengths that are tried, by the given one.
const FOCALS: [f64; 12] = [
    0.4, 0.5, 0.58, 0.67, 0.77, 0.87, 1.15, 1.3, 1.5, 1.75, 2.0, 2.5,
];

/// The usual mistakes; of equally good ones the first is named.
fn readings() -> Vec<Reading> {
    let mut all: Vec<Reading> = Vec::new();
    let mut pose = |misreading, read: Box<dyn Fn(&CamFromWorld) -> CamFromWorld + Sync>| {
        all.push(Reading {
            misreading,
            read,
            focal: 1.0,
            shift: 0,
        });
    };
    pose(Misreading::WorldFromCam, Box::new(inverted));
    for is_inverted in [false, true] {
        for axes in CameraAxes::all().filter(|axes| *axes != CameraAxes::OPENCV) {
            let turn = move |t: &CamFromWorld| {
                let turn = axes.ours_from_file;
                CamFromWorld::new(turn * t.rotation, turn * t.translation)
            };
            let misreading = Misreading::Axes { axes, is_inverted };
            if is_inverted {
                pose(misreading, Box::new(move |t| turn(&inverted(t))));
            } else {
                pose(misreading, Box::new(turn));
            }
        }
    }
    for is_real_last in [true, false] {
        let other = move |t: &CamFromWorld| reordered(t, is_real_last);
        let of = |is_inverted| Misreading::Quaternions {
            is_real_last,
            is_inverted,
        };
        pose(of(false), Box::new(other));
        // The file's own numbers are of the inverse.
        pose(of(false), Box::new(move |t| inverted(&other(&inverted(t)))));
        pose(of(true), Box::new(move |t| inverted(&other(t))));
        pose(of(true), Box::new(move |t| other(&inverted(t))));
    }
    pose(Misreading::LeftHanded, Box::new(|t| mirrored(t, 1)));
    pose(
        Misreading::WorldFromLeftHandedCam,
        Box::new(|t| mirrored(&inverted(t), 1)),
    );
    // A picture mirrored left to right is what a camera sees of a world mirrored in x.
    pose(Misreading::MirroredPictures, Box::new(|t| mirrored(t, 0)));
    let as_it_is = || Box::new(|t: &CamFromWorld| *t);
    all.extend(FOCALS.map(|factor| Reading {
        misreading: Misreading::Focal { factor },
        read: as_it_is(),
        focal: factor,
        shift: 0,
    }));
    all.extend([-1, 1].map(|by| Reading {
        misreading: Misreading::Shifted { by },
        read: as_it_is(),
        focal: 1.0,
        shift: by,
    }));
    all
}

/// Fewer matches than this say nothing about a pair.
const MIN_MATCHES: usize = 30;
const MAX_EPIPOLAR_PX: f64 = 3.0;

/// Up to so many pairs of pictures that follow each other at a distance in the list.
fn some_pairs(num_views: usize, num_pairs: usize) -> Vec<(usize, usize)> {
    let step = (2 * num_views).div_ceil(num_pairs).max(1);
    (0..num_views)
        .step_by(step)
        .flat_map(|i| [3, 10].map(|gap| (i, i + gap.min(num_views / 2).max(1))))
        .filter(|(_, j)| *j < num_views)
        .collect()
}

/// Tests up to `num_pairs` pairs of pictures that follow each other at a distance in the list.
pub fn check_convention(
    views: &[PosedView<'_>],
    num_pairs: usize,
    min_cosine: f32,
) -> Option<ConventionCheck> {
    let pairs = some_pairs(views.len(), num_pairs);
    let readings = readings();
    // Of a view's neighbour, for poses that are shifted.
    let pose_at = |i: usize, shift: isize| {
        let at = i.checked_add_signed(shift)?;
        views.get(at).map(|view| view.cam_from_world)
    };
    let shares: Vec<(f64, Vec<Option<f64>>)> =
        parallel::map_with(pairs.len(), MutualMatcher::default, |matcher, pair| {
            let (i, j) = pairs[pair];
            let (a, b) = (&views[i], &views[j]);
            let matches = matches_of(matcher, a, b, min_cosine)?;
            let poses = [a.cam_from_world, b.cam_from_world];
            let as_given = share([a, b], &matches, poses, 1.0);
            let others = readings.iter().map(|reading| {
                let poses = [pose_at(i, reading.shift)?, pose_at(j, reading.shift)?];
                let poses = poses.each_ref().map(|t| (reading.read)(t));
                Some(share([a, b], &matches, poses, reading.focal))
            });
            Some((as_given, others.collect()))
        })
        .into_iter()
        .flatten()
        .collect();
    let as_given = median_in_place(&mut shares.iter().map(|s| s.0).collect::<Vec<f64>>())?;
    let mut best_other = (Misreading::WorldFromCam, 0.0);
    for (k, reading) in readings.iter().enumerate() {
        let mut of_pairs: Vec<f64> = shares.iter().filter_map(|s| s.1[k]).collect();
        if let Some(share) = median_in_place(&mut of_pairs)
            && share > best_other.1
        {
            best_other = (reading.misreading, share);
        }
    }
    Some(ConventionCheck {
        as_given,
        best_other,
        num_pairs: shares.len(),
    })
}

/// Median share of matches that agree with the poses, over pairs of near pictures of which one is meant.
pub fn agreement(
    views: &[PosedView<'_>],
    is_meant: impl Fn(usize) -> bool,
    num_pairs: usize,
    min_cosine: f32,
) -> Option<f64> {
    let all: Vec<(usize, usize)> = (0..views.len())
        .flat_map(|i| [1, 2, 5].map(|gap| (i, i + gap)))
        .filter(|(i, j)| *j < views.len() && (is_meant(*i) || is_meant(*j)))
        .collect();
    let step = all.len().div_ceil(num_pairs.max(1)).max(1);
    let pairs: Vec<(usize, usize)> = all.into_iter().step_by(step).collect();
    let mut shares: Vec<f64> =
        parallel::map_with(pairs.len(), MutualMatcher::default, |matcher, pair| {
            let (i, j) = pairs[pair];
            let (a, b) = (&views[i], &views[j]);
            let matches = matches_of(matcher, a, b, min_cosine)?;
            let poses = [a.cam_from_world, b.cam_from_world];
            Some(share([a, b], &matches, poses, 1.0))
        })
        .into_iter()
        .flatten()
        .collect();
    median_in_place(&mut shares)
}

/// Matches of two views, if they are enough.
fn matches_of(
    matcher: &mut MutualMatcher,
    a: &PosedView<'_>,
    b: &PosedView<'_>,
    min_cosine: f32,
) -> Option<Vec<(u32, u32, f32)>> {
    matcher.set_first(a.features);
    let matches: Vec<_> = matcher.matches(b.features, min_cosine).collect();
    (matches.len() >= MIN_MATCHES).then_some(matches)
}

/// Share of matches that agree with two poses, if focal lengths are so many times what they are said to be.
fn share(
    [a, b]: [&PosedView<'_>; 2],
    matches: &[(u32, u32, f32)],
    [pose_a, pose_b]: [CamFromWorld; 2],
    focal: f64,
) -> f64 {
    let limit = MAX_EPIPOLAR_PX / (0.5 * focal * (a.focal_px + b.focal_px));
    let e = essential(&pose_a, &pose_b);
    let agree = matches.iter().filter(|(k, l, _)| {
        match (a.planar.get(*k as usize), b.planar.get(*l as usize)) {
            (Some(p), Some(q)) => {
                let (p, q) = (p / focal, q / focal);
                epipolar_distance(&e, &p.push(1.0), &q.push(1.0)) <= limit
                    && is_in_front([(&pose_a, &p), (&pose_b, &q)])
            }
            _ => false,
        }
    });
    agree.count() as f64 / matches.len() as f64
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

/// The rotation of the same four numbers in the other order.
fn reordered(t: &CamFromWorld, is_real_last: bool) -> CamFromWorld {
    let [a, b, c, d] = t.quaternion_wxyz();
    let wxyz = if is_real_last {
        [d, a, b, c]
    } else {
        [b, c, d, a]
    };
    CamFromWorld::from_quaternion_wxyz(wxyz, t.translation)
}

/// Changes the sign of an axis of camera and world.
fn mirrored(t: &CamFromWorld, axis: usize) -> CamFromWorld {
    let mut mirror = Matrix3::identity();
    mirror[(axis, axis)] = -1.0;
    Rigid::new(mirror * t.rotation * mirror, mirror * t.translation)
}
