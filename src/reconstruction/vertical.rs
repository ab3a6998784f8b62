//! Which way is up, told by the segments of upright things.
//!
//! * **In and out**: posed pictures with their segments; the direction of up in their world, or why it is not told.
//! * **Method**: people hold a camera upright in the mean, which tells up to some tens of degrees. The plane through a camera and
//!   an upright edge contains the vertical, so its normal is square to it (Hartley and Zisserman, Multiple View Geometry, 8.6):
//!   among directions near the mean, each from two such planes, the one that most lines of the pictures agree with is taken,
//!   fitted again to them, and held against the best one elsewhere.
//! * **Invariants**: the same pictures give the same direction, of unit length.

use super::view::PosedView;
use crate::math::Rng;
use nalgebra::{Matrix3, Vector3};

/// Shorter segments say too little of a direction, in pixels.
const MIN_LENGTH_PX: f64 = 25.0;
/// Longer ones count no more, so that one long edge does not speak for the room.
const MAX_LENGTH_PX: f64 = 150.0;
/// Up lies this near to the mean of what the pictures call up, as a sine: 30 degrees.
const MAX_TILT_SIN: f64 = 0.5;
/// A segment belongs to a direction within this, as a sine: one degree.
const NEAR_SIN: f64 = 0.0175;
/// Pictures that are turned all ways have no mean: length of the mean of their ups, 1 where all agree.
const MIN_AGREEING: f64 = 0.6;
/// Fewer segments near the direction prove nothing.
const MIN_SEGMENTS: usize = 30;
/// A direction is taken where it has so many times the weight of the best one farther than [`APART_SIN`] from it.
const MIN_LEAD: f64 = 1.5;
/// Directions farther apart than this are two, as a sine: five degrees.
const APART_SIN: f64 = 0.087;
/// Directions that are tried.
const MAX_TRIALS: usize = 1_000;
/// Segments that a direction is tried on; the fit takes all.
const MAX_TRIED: usize = 4_000;
/// Rounds of the fit.
const ROUNDS: usize = 10;

/// The vertical of a world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Vertical {
    /// Where up is, of unit length.
    pub up_in_world: Vector3<f64>,
    /// Root mean square angle of the planes through camera and segment from it, in radians: how far single edges are off. The
    /// direction itself is better, by how much depends on how plumb the room's edges are.
    pub scatter_rad: f64,
    /// Segments that agree, within a degree.
    pub num_segments: usize,
    /// Pictures that have some of them.
    pub num_views: usize,
}

/// Why no vertical is told.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum NoVertical {
    /// The pictures do not agree on what is up, as those of a camera that looks down or is turned on its side do.
    #[error(
        "the camera was turned all ways, so that nothing says which of the room's directions is up"
    )]
    TurnedAllWays,
    /// Too few segments agree.
    #[error("{found} segments of the pictures agree on a vertical, {MIN_SEGMENTS} are needed")]
    FewSegments {
        /// Those that agree with the best direction.
        found: usize,
    },
    /// Another direction is nearly as good.
    #[error(
        "two directions {apart_deg:.0} degrees apart explain the segments nearly alike: the best one has {lead:.2} times the other's \
         weight, {MIN_LEAD} are needed"
    )]
    Undecided {
        /// Between both.
        apart_deg: f64,
        /// Weight of the best direction by that of the other.
        lead: f64,
    },
}

/// The plane through a camera and a segment.
#[derive(Debug, Clone, Copy)]
struct Plane {
    /// Of unit length, in the world.
    normal: Vector3<f64>,
    weight: f64,
    view: usize,
}

impl Plane {
    /// How much it agrees with a direction of unit length.
    fn agreement(&self, direction: &Vector3<f64>) -> f64 {
        let off = self.normal.dot(direction) / NEAR_SIN;
        self.weight * (1.0 - off * off).max(0.0)
    }
}

/// Finds the vertical.
///
/// # Errors
/// [`NoVertical`]: the pictures do not tell it.
pub fn vertical(views: &[PosedView<'_>]) -> Result<Vertical, NoVertical> {
    let ups = views.iter().map(|v| v.cam_from_world.up_in_world());
    let mean: Vector3<f64> = ups.sum::<Vector3<f64>>() / views.len().max(1) as f64;
    if !(mean.norm() >= MIN_AGREEING) {
        return Err(NoVertical::TurnedAllWays);
    }
    let rough = mean.normalize();
    let planes = planes(views, &rough);
    let tried: Vec<&Plane> = planes
        .iter()
        .step_by(planes.len().div_ceil(MAX_TRIED).max(1))
        .collect();
    let weight = |d: &Vector3<f64>| -> f64 { tried.iter().map(|p| p.agreement(d)).sum() };
    let trials = trials(&tried, &rough);
    let weighed: Vec<_> = trials.iter().map(|d| (weight(d), *d)).collect();
    let by_weight = |a: &(f64, Vector3<f64>), b: &(f64, Vector3<f64>)| a.0.total_cmp(&b.0);
    let Some((_, first)) = weighed.iter().copied().max_by(by_weight) else {
        return Err(NoVertical::FewSegments { found: 0 });
    };
    let up = fitted(&planes, first);
    let best = weight(&up);
    let other = weighed
        .into_iter()
        .filter(|(_, d)| d.cross(&up).norm() > APART_SIN)
        .max_by(by_weight);
    let found = vertical_of(&planes, up);
    if found.num_segments < MIN_SEGMENTS {
        return Err(NoVertical::FewSegments {
            found: found.num_segments,
        });
    }
    if let Some((other, direction)) = other
        && best < MIN_LEAD * other
    {
        return Err(NoVertical::Undecided {
            apart_deg: libm::asin(direction.cross(&up).norm().min(1.0)).to_degrees(),
            lead: best / other,
        });
    }
    Ok(found)
}

/// Of the segments that may be upright.
fn planes(views: &[PosedView<'_>], rough: &Vector3<f64>) -> Vec<Plane> {
    let mut planes = Vec::new();
    for (view, posed) in views.iter().enumerate() {
        let world_from_cam = posed.cam_from_world.rotation.transpose();
        for [start, end] in &posed.segment_ends {
            let length_px = (end - start).norm() * posed.focal_px;
            let normal = world_from_cam * start.push(1.0).cross(&end.push(1.0));
            // Not a number where the camera model has no bearing.
            if !(length_px >= MIN_LENGTH_PX && normal.norm() > 0.0) {
                continue;
            }
            let normal = normal.normalize();
            if normal.dot(rough).abs() < MAX_TILT_SIN {
                planes.push(Plane {
                    normal,
                    weight: length_px.min(MAX_LENGTH_PX),
                    view,
                });
            }
        }
    }
    planes
}

/// Directions that two planes have in common, near the rough one.
fn trials(planes: &[&Plane], rough: &Vector3<f64>) -> Vec<Vector3<f64>> {
    let mut trials = Vec::new();
    if planes.len() < 2 {
        return trials;
    }
    let mut rng = Rng::from_seed(0);
    for _ in 0..8 * MAX_TRIALS {
        if trials.len() == MAX_TRIALS {
            break;
        }
        let mut any = || planes[rng.below(planes.len() as u32) as usize].normal;
        let common = any().cross(&any());
        // Planes nearly alike have no line in common that is known well.
        if !(common.norm() > 0.2) {
            continue;
        }
        let common = common.normalize();
        let up = towards(common, rough);
        if up.cross(rough).norm() < MAX_TILT_SIN {
            trials.push(up);
        }
    }
    trials
}

/// The direction most nearly square to the normals that agree with it.
fn fitted(planes: &[Plane], start: Vector3<f64>) -> Vector3<f64> {
    let mut up = start;
    for _ in 0..ROUNDS {
        let mut gram = Matrix3::zeros();
        for plane in planes {
            gram += plane.normal * plane.normal.transpose() * plane.agreement(&up);
        }
        let eigen = gram.symmetric_eigen();
        let next = eigen.eigenvectors.column(eigen.eigenvalues.imin());
        if !(next.norm() > 0.5) {
            break;
        }
        up = towards(next.into_owned(), &up);
    }
    up
}

/// A direction, or its opposite where that is nearer to the other.
fn towards(direction: Vector3<f64>, other: &Vector3<f64>) -> Vector3<f64> {
    if direction.dot(other) < 0.0 {
        -direction
    } else {
        direction
    }
}

fn vertical_of(planes: &[Plane], up: Vector3<f64>) -> Vertical {
    let near = planes.iter().filter(|p| p.normal.dot(&up).abs() < NEAR_SIN);
    let (mut sum_sq, mut num_segments) = (0.0, 0);
    let mut views: Vec<usize> = Vec::new();
    for plane in near {
        sum_sq += plane.normal.dot(&up).powi(2);
        num_segments += 1;
        if views.last() != Some(&plane.view) {
            views.push(plane.view);
        }
    }
    Vertical {
        up_in_world: up,
        scatter_rad: (sum_sq / num_segments.max(1) as f64).sqrt(),
        num_segments,
        num_views: views.len(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::FeatureSet;
    use crate::geometry::{CamFromWorld, Camera, Pixel, Segment2, rotation_from_vector};

    fn segment(start: Pixel, end: Pixel) -> Segment2 {
        Segment2::from_numbers([start.x, start.y, end.x, end.y, 1.0, 0.1, 10.0])
    }

    /// Pictures from a circle, with segments between points of the world.
    struct World {
        camera: Camera,
        poses: Vec<CamFromWorld>,
        features: Vec<FeatureSet>,
    }

    impl World {
        /// `tilt` turns the whole world; each picture is rolled by up to ten degrees.
        fn new(tilt: Vector3<f64>, segments: &[[Vector3<f64>; 2]], seed: u64) -> Self {
            let camera = Camera::centered(640, 480, 500.0);
            let mut rng = Rng::from_seed(seed);
            let tilt = rotation_from_vector(&tilt);
            let (mut poses, mut features) = (Vec::new(), Vec::new());
            for i in 0..12 {
                let around = rotation_from_vector(&(Vector3::y() * (0.5 * f64::from(i))));
                let rolled = rotation_from_vector(&Vector3::new(
                    0.1 * rng.normal(),
                    0.0,
                    0.1 * rng.normal(),
                ));
                let rotation = rolled * around;
                let pose = CamFromWorld::new(rotation, Vector3::new(0.0, 0.0, 0.0));
                let see = |p: &Vector3<f64>| {
                    let pixel = camera.pixel_from_cam(&pose.transform_point(p))?;
                    let inside =
                        pixel.x > 0.0 && pixel.x < 640.0 && pixel.y > 0.0 && pixel.y < 480.0;
                    inside.then_some(pixel)
                };
                let mut set = FeatureSet::default();
                for [a, b] in segments {
                    let (Some(mut a), Some(mut b)) = (see(a), see(b)) else {
                        continue;
                    };
                    for v in [&mut a.x, &mut a.y, &mut b.x, &mut b.y] {
                        *v += 0.3 * rng.normal();
                    }
                    set.segments.push(segment(a, b));
                }
                features.push(set);
                poses.push(CamFromWorld::new(
                    rotation * tilt.transpose(),
                    Vector3::zeros(),
                ));
            }
            Self {
                camera,
                poses,
                features,
            }
        }

        fn vertical(&self) -> Result<Vertical, NoVertical> {
            let posed = self.poses.iter().zip(&self.features);
            let views: Vec<PosedView<'_>> = posed
                .map(|(pose, set)| PosedView::new(self.camera, *pose, set))
                .collect();
            vertical(&views)
        }
    }

    /// Edges on a circle around the cameras; y points down.
    fn edges(count: usize, along: impl Fn(&mut Rng) -> Vector3<f64>) -> Vec<[Vector3<f64>; 2]> {
        let mut rng = Rng::from_seed(3);
        (0..count)
            .map(|_| {
                let angle = rng.range(0.0, core::f64::consts::TAU);
                let at = Vector3::new(
                    3.0 * libm::sin(angle),
                    rng.range(-0.7, 0.7),
                    3.0 * libm::cos(angle),
                );
                let half = 0.35 * along(&mut rng).normalize();
                [at - half, at + half]
            })
            .collect()
    }

    fn any(rng: &mut Rng) -> Vector3<f64> {
        Vector3::new(rng.normal(), rng.normal(), rng.normal())
    }

    #[test]
    fn upright_edges_among_others_tell_up_to_a_tenth_of_a_degree() {
        let mut all = edges(120, |_| Vector3::y());
        all.extend(edges(240, any));
        for tilt in [Vector3::zeros(), Vector3::new(0.2, 0.4, -0.1)] {
            let found = World::new(tilt, &all, 5).vertical().expect("told");
            let truth = rotation_from_vector(&tilt) * -Vector3::y();
            let off = libm::asin(found.up_in_world.cross(&truth).norm()).to_degrees();
            assert!(
                found.up_in_world.dot(&truth) > 0.9 && off < 0.1,
                "{off} degrees"
            );
            assert!(off.to_radians() < found.scatter_rad, "{found:?}, {off}");
            assert!(
                found.num_segments > 100 && found.num_views == 12,
                "{found:?}"
            );
        }
    }

    #[test]
    fn edges_of_all_directions_and_of_two_tell_nothing() {
        let found = World::new(Vector3::zeros(), &edges(300, any), 5).vertical();
        assert!(found.is_err(), "{found:?}");
        let lean = |degrees: f64| {
            move |_: &mut Rng| Vector3::new(libm::sin(degrees.to_radians()), 1.0, 0.0)
        };
        let mut two = edges(120, lean(12.0));
        two.extend(edges(120, lean(-12.0)));
        match World::new(Vector3::zeros(), &two, 5).vertical() {
            Err(NoVertical::Undecided { apart_deg, .. }) => {
                assert!((apart_deg - 24.0).abs() < 2.0, "{apart_deg}");
            }
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn without_segments_or_a_camera_that_is_held_upright_the_reason_is_said() {
        let none = World::new(Vector3::zeros(), &[], 5);
        assert_eq!(none.vertical(), Err(NoVertical::FewSegments { found: 0 }));
        let mut turned = World::new(Vector3::zeros(), &edges(120, |_| Vector3::y()), 5);
        for (i, pose) in turned.poses.iter_mut().enumerate() {
            let quarter = Vector3::z() * (core::f64::consts::FRAC_PI_2 * i as f64);
            pose.rotation = rotation_from_vector(&quarter) * pose.rotation;
        }
        assert_eq!(turned.vertical(), Err(NoVertical::TurnedAllWays));
    }
}
