//! Whether the intrinsics fit what was found: pictures that were zoomed, cropped or squeezed look like pictures from elsewhere.
//!
//! Pose, focal length, aspect and principal point are solved together from the matched points, by Levenberg-Marquardt with a
//! Student-t loss and weak priors around the given camera. Of the subsets of these the one counts that explains most for its
//! size, if each of its values differs clearly and by more than its standard deviation allows. Distortion stays. No allocation
//! after warm-up.

use crate::geometry::{CamFromWorld, Camera, Pixel, PixelMap, rotation_from_vector};
use crate::math::elementary::{exp, ln};
use crate::math::least_squares::{Damping, LeastSquares, Normal, minimize};
use crate::pose::PointCorrespondence;
use nalgebra::{Matrix3, SVector, Vector2, Vector3};

/// Unknowns: rotation, translation, then [`Change`].
const NUM_UNKNOWNS: usize = 10;
const NUM_POSE: usize = 6;
const NUM_INTRINSICS: usize = NUM_UNKNOWNS - NUM_POSE;

/// Fewer points say nothing about a camera.
const MIN_POINTS: usize = 40;

/// Standard deviations before anything was seen, of [`Change::values`].
const PRIOR_SIGMA: [f64; NUM_INTRINSICS] = [0.3, 0.2, 0.15, 0.15];

/// Smaller changes of focal length, aspect and principal point are not worth another look.
const LEAST_CHANGE: [f64; 3] = [0.03, 0.03, 0.02];

/// Once a camera is known to be wrong, changes are followed down to this share of these.
const DOUBTED: f64 = 0.2;

/// A change is believed when it is so many standard deviations long.
const LEAST_SIGMAS: f64 = 4.0;

/// Another camera has to explain the points better by so many nats for each of its parameters that differ.
const LEAST_GAIN: f64 = 8.0;

/// What may differ, alone and together: focal length, aspect, principal point. (A radial term beside them explained drawn matches
/// of zoomed pictures wrongly.)
const SUBSETS: [[bool; NUM_INTRINSICS]; 6] = [
    [true, false, false, false],
    [false, true, false, false],
    [true, true, false, false],
    [false, false, true, true],
    [true, false, true, true],
    [true, true, true, true],
];

/// Degrees of freedom of the Student-t.
const TAIL: f64 = 4.0;

/// How another camera differs from the given one.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Change {
    /// ln of the focal length's factor, ln of the factor on fy alone, shift of the principal point in longer sides.
    values: [f64; NUM_INTRINSICS],
}

impl Change {
    fn apply(&self, camera: &Camera) -> Camera {
        let [ln_focal, ln_aspect, x, y] = self.values;
        let side = f64::from(camera.width.max(camera.height));
        let mut shift = PixelMap::<(), ()>::from_scale(1.0, 1.0);
        (shift.offset_x, shift.offset_y) = (x * side, y * side);
        let focals = [exp(ln_focal), exp(ln_focal + ln_aspect)];
        Camera {
            width: camera.width,
            height: camera.height,
            ..camera.with_focals_scaled(focals).resized(&shift)
        }
    }
}

/// A camera that fits the matches better than the given one, with the pose that goes with it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SolvedCamera {
    /// Intrinsics.
    pub camera: Camera,
    /// Pose.
    pub cam_from_world: CamFromWorld,
}

/// A matched point without distortion.
#[derive(Debug, Clone, Copy)]
struct Match {
    pixel: Vector2<f64>,
    point_in_world: Vector3<f64>,
}

/// Buffers of the check.
#[derive(Debug, Default)]
pub(super) struct CameraCheck {
    matches: Vec<Match>,
}

#[derive(Debug, Clone, Copy)]
struct State {
    rotation: Matrix3<f64>,
    translation: Vector3<f64>,
    change: Change,
}

struct Problem<'a> {
    matches: &'a [Match],
    focal: (f64, f64),
    center: Pixel,
    side: f64,
    variance: f64,
    is_free: [bool; NUM_INTRINSICS],
}

impl State {
    fn of(cam_from_world: &CamFromWorld) -> Self {
        Self {
            rotation: cam_from_world.rotation,
            translation: cam_from_world.translation,
            change: Change::default(),
        }
    }
}

impl CameraCheck {
    /// The matches as a problem in which everything is free; `None` for too few.
    fn load(
        &mut self,
        points: &[PointCorrespondence],
        camera: &Camera,
        sigma_px: f64,
    ) -> Option<Problem<'_>> {
        let center = camera.principal_point();
        let focal = camera.focal_px();
        self.matches.clear();
        self.matches.extend(points.iter().filter_map(|p| {
            let ray = camera.bearing_from_pixel(p.pixel)?;
            (ray.z > 0.0).then(|| Match {
                pixel: Vector2::new(
                    focal.0 * ray.x / ray.z + center.x,
                    focal.1 * ray.y / ray.z + center.y,
                ),
                point_in_world: p.point_in_world,
            })
        }));
        (self.matches.len() >= MIN_POINTS).then(|| Problem {
            matches: &self.matches,
            focal,
            center,
            side: f64::from(camera.width.max(camera.height)),
            variance: sigma_px * sigma_px,
            is_free: [true; NUM_INTRINSICS],
        })
    }

    /// Standard deviation of ln f as far as the matches tell it beside the pose: large before a flat wall, where another focal length
    /// from another distance shows the same. `None` where they are too few to say.
    pub(super) fn focal_sigma_ln(
        &mut self,
        points: &[PointCorrespondence],
        camera: &Camera,
        cam_from_world: &CamFromWorld,
        sigma_px: f64,
    ) -> Option<f64> {
        let mut problem = self.load(points, camera, sigma_px)?;
        problem.is_free = SUBSETS[0];
        let normal = problem.normal(&State::of(cam_from_world));
        let covariance = masked(&normal, &SUBSETS[0]).h.cholesky()?.inverse();
        Some(covariance[(NUM_POSE, NUM_POSE)].sqrt())
    }

    /// The camera that the matches ask for; `None` where the given one fits, or where they say too little.
    /// `sigma_px` is the standard deviation of a pixel; `cam_from_world` nearly right; `is_doubted` where the camera comes from
    /// here already.
    pub(super) fn solve(
        &mut self,
        points: &[PointCorrespondence],
        camera: &Camera,
        cam_from_world: &CamFromWorld,
        sigma_px: f64,
        is_doubted: bool,
    ) -> Option<SolvedCamera> {
        let mut problem = self.load(points, camera, sigma_px)?;
        let start = State::of(cam_from_world);
        // One look at the equations tells in nearly all frames that nothing differs.
        let linear = problem.normal(&start);
        let pose_alone = linear_gain(&linear, &[false; NUM_INTRINSICS]);
        if !SUBSETS
            .iter()
            .any(|subset| linear_gain(&linear, subset) - pose_alone > LEAST_GAIN)
        {
            return None;
        }
        let least = if is_doubted { DOUBTED } else { 1.0 };
        let mut best: Option<(f64, State)> = None;
        for subset in SUBSETS {
            problem.is_free = subset;
            let (state, normal) = minimize(&mut problem, start, &Damping::default(), || false);
            let count = subset.iter().filter(|free| **free).count();
            let cost = normal.cost + LEAST_GAIN * count as f64;
            if is_clear(&state.change, &normal, &subset, least)
                && best.is_none_or(|(c, _)| cost < c)
            {
                best = Some((cost, state));
            }
        }
        let (cost, state) = best?;
        problem.is_free = [false; NUM_INTRINSICS];
        let (_, given) = minimize(&mut problem, start, &Damping::default(), || false);
        if !(cost < given.cost) {
            return None;
        }
        let camera = state.change.apply(camera);
        camera.validate().ok()?;
        Some(SolvedCamera {
            camera,
            cam_from_world: CamFromWorld::new(state.rotation, state.translation),
        })
    }
}

/// The equations without what is not free.
fn masked(normal: &Normal<NUM_UNKNOWNS>, is_free: &[bool; NUM_INTRINSICS]) -> Normal<NUM_UNKNOWNS> {
    let mut masked = *normal;
    for (i, _) in is_free.iter().enumerate().filter(|(_, free)| !**free) {
        masked.h.fill_row(NUM_POSE + i, 0.0);
        masked.h.fill_column(NUM_POSE + i, 0.0);
        masked.h[(NUM_POSE + i, NUM_POSE + i)] = 1.0;
        masked.g[NUM_POSE + i] = 0.0;
    }
    masked
}

/// By how much the cost would drop with this free beside the pose, if the equations were linear.
fn linear_gain(normal: &Normal<NUM_UNKNOWNS>, is_free: &[bool; NUM_INTRINSICS]) -> f64 {
    let normal = masked(normal, is_free);
    normal
        .step(1e-9)
        .map_or(0.0, |step| -0.5 * normal.g.dot(&step))
}

/// Whether all that is free differs clearly; the principal point as a whole.
fn is_clear(
    change: &Change,
    normal: &Normal<NUM_UNKNOWNS>,
    is_free: &[bool; NUM_INTRINSICS],
    least: f64,
) -> bool {
    let Some(covariance) = masked(normal, is_free).h.cholesky().map(|c| c.inverse()) else {
        return false;
    };
    let off = |i: usize| change.values[i].abs();
    let sigma = |i: usize| covariance[(NUM_POSE + i, NUM_POSE + i)].sqrt();
    let differs = |i: usize, off: f64, least: f64, sigma: f64| {
        !is_free[i] || (off > least && off > LEAST_SIGMAS * sigma)
    };
    let [focal, aspect, center] = LEAST_CHANGE.map(|change| least * change);
    differs(0, off(0), focal, sigma(0))
        && differs(1, off(1), aspect, sigma(1))
        && differs(2, off(2).max(off(3)), center, sigma(2).max(sigma(3)))
}

impl Problem<'_> {
    /// Point in camera space, the same on the plane at depth one, and residual in pixels; `None` behind the camera.
    fn seen(&self, at: &State, m: &Match) -> Option<(Vector3<f64>, Vector2<f64>, Vector2<f64>)> {
        let z = at.rotation * m.point_in_world + at.translation;
        if !(z.z > 0.0) {
            return None;
        }
        let (fx, fy) = self.focal_at(at);
        let [_, _, x, y] = at.change.values;
        let p = Vector2::new(z.x / z.z, z.y / z.z);
        let seen = Vector2::new(
            fx * p.x + self.center.x + x * self.side,
            fy * p.y + self.center.y + y * self.side,
        );
        Some((z, p, seen - m.pixel))
    }

    fn focal_at(&self, at: &State) -> (f64, f64) {
        let [ln_focal, ln_aspect, ..] = at.change.values;
        (
            self.focal.0 * exp(ln_focal),
            self.focal.1 * exp(ln_focal + ln_aspect),
        )
    }
}

impl LeastSquares for Problem<'_> {
    type Parameters = State;
    type Normal = Normal<NUM_UNKNOWNS>;
    type Step = SVector<f64, NUM_UNKNOWNS>;

    fn normal(&mut self, at: &State) -> Self::Normal {
        let mut normal = Normal::default();
        let (fx, fy) = self.focal_at(at);
        let free = self.is_free.map(f64::from);
        for m in self.matches {
            let Some((z, p, r)) = self.seen(at, m) else {
                continue;
            };
            let t = 1.0 + r.norm_squared() / (TAIL * self.variance);
            let weight = (TAIL + 2.0) / (TAIL * self.variance * t);
            normal.cost += 0.5 * (TAIL + 2.0) * ln(t);
            let by_cam = [
                Vector3::new(fx, 0.0, -fx * p.x) / z.z,
                Vector3::new(0.0, fy, -fy * p.y) / z.z,
            ];
            let by_intrinsics = [
                [fx * p.x, 0.0, self.side, 0.0],
                [fy * p.y, fy * p.y, 0.0, self.side],
            ];
            for k in 0..2 {
                let (turn, shift) = (z.cross(&by_cam[k]), by_cam[k]);
                let mut row = SVector::<f64, NUM_UNKNOWNS>::zeros();
                for i in 0..3 {
                    (row[i], row[3 + i]) = (turn[i], shift[i]);
                }
                for i in 0..NUM_INTRINSICS {
                    row[NUM_POSE + i] = free[i] * by_intrinsics[k][i];
                }
                normal.add(&row, r[k], weight);
            }
        }
        for i in 0..NUM_INTRINSICS {
            if self.is_free[i] {
                let mut row = SVector::<f64, NUM_UNKNOWNS>::zeros();
                row[NUM_POSE + i] = 1.0 / PRIOR_SIGMA[i];
                let off = at.change.values[i] / PRIOR_SIGMA[i];
                normal.add(&row, off, 1.0);
                normal.cost += 0.5 * off * off;
            }
        }
        normal
    }

    fn cost(&self, normal: &Self::Normal) -> f64 {
        normal.cost
    }

    fn step(&self, normal: &Self::Normal, lambda: f64) -> Option<Self::Step> {
        normal.step(lambda)
    }

    fn step_sq(&self, step: &Self::Step) -> f64 {
        step.norm_squared()
    }

    fn moved(&self, at: &State, step: &Self::Step) -> State {
        let turn = rotation_from_vector(&Vector3::new(step[0], step[1], step[2]));
        State {
            rotation: turn * at.rotation,
            translation: turn * at.translation + Vector3::new(step[3], step[4], step[5]),
            change: Change {
                values: core::array::from_fn(|i| at.change.values[i] + step[NUM_POSE + i]),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Rng;

    /// Points of a room as another camera sees them, in a picture of 640 x 480.
    fn seen(camera: &Camera, pose: &CamFromWorld, rng: &mut Rng) -> Vec<PointCorrespondence> {
        (0..300)
            .filter_map(|i| {
                let point_in_world = Vector3::new(
                    rng.range(-2.0, 2.0),
                    rng.range(-1.5, 1.5),
                    rng.range(2.0, 5.0),
                );
                let p = camera.pixel_from_cam(&pose.transform_point(&point_in_world))?;
                // Every tenth is wrong by some pixels.
                let sigma = if i % 10 == 0 { 6.0 } else { 0.6 };
                Some(PointCorrespondence {
                    pixel: Pixel::new(p.x + sigma * rng.normal(), p.y + sigma * rng.normal()),
                    point_in_world,
                    confidence: 0.9,
                    sigma_m: 0.0,
                    sigma_px: 0.0,
                })
            })
            .collect()
    }

    #[test]
    fn what_differs_is_found_and_what_does_not_stays() {
        let mut rng = Rng::from_seed(3);
        let given = Camera::centered(640, 480, 520.0);
        let pose = CamFromWorld::new(
            rotation_from_vector(&Vector3::new(0.1, -0.2, 0.05)),
            Vector3::new(0.2, -0.1, 0.3),
        );
        let mut check = CameraCheck::default();
        for values in [
            [0.1, 0.0, 0.0, 0.0],
            [0.0, -0.2, 0.0, 0.0],
            [0.0, 0.0, -0.1, 0.05],
            [-0.1, 0.1, 0.05, 0.0],
        ] {
            let truth = Change { values }.apply(&given);
            let points = seen(&truth, &pose, &mut rng);
            let solved = check
                .solve(&points, &given, &pose, 0.7, false)
                .expect("differs");
            let (f, g) = (solved.camera.focal_px(), truth.focal_px());
            assert!((f.0 / g.0 - 1.0).abs() < 0.02, "{values:?}: {f:?} {g:?}");
            assert!((f.1 / g.1 - 1.0).abs() < 0.02, "{values:?}: {f:?} {g:?}");
            let (c, d) = (solved.camera.principal_point(), truth.principal_point());
            assert!(c.distance(d) < 10.0, "{values:?}: {c:?} {d:?}");
            if values[1] == 0.0 {
                assert_eq!(f.0, f.1);
            }
            if values[2] == 0.0 && values[3] == 0.0 {
                assert!(c.distance(given.principal_point()) < 1e-9);
            }
            let off = solved.cam_from_world.center_in_world() - pose.center_in_world();
            assert!(off.norm() < 0.08, "{values:?}: {off:?}");
        }
        let points = seen(&given, &pose, &mut rng);
        assert_eq!(check.solve(&points, &given, &pose, 0.7, false), None);
        assert_eq!(check.solve(&points[..20], &given, &pose, 0.7, false), None);
    }

    /// A wall seen from straight ahead: focal length and distance cannot be told apart, so nothing is claimed.
    #[test]
    fn a_wall_says_nothing_about_the_focal_length() {
        let mut rng = Rng::from_seed(9);
        let truth = Camera::centered(640, 480, 600.0);
        let given = Camera::centered(640, 480, 520.0);
        let pose = CamFromWorld::identity();
        let mut points = seen(&truth, &pose, &mut rng);
        for p in &mut points {
            let x = &mut p.point_in_world;
            *x *= 3.0 / x.z;
        }
        let nearer = CamFromWorld::new(Matrix3::identity(), Vector3::z() * -0.4);
        assert_eq!(
            CameraCheck::default().solve(&points, &given, &nearer, 0.7, false),
            None
        );
        let told = |points: &[PointCorrespondence]| {
            CameraCheck::default().focal_sigma_ln(points, &truth, &pose, 0.7)
        };
        let of_wall = told(&points).expect("points enough");
        assert!(of_wall > 0.02, "{of_wall}");
        let of_room = told(&seen(&truth, &pose, &mut rng)).expect("points enough");
        assert!(of_room < 0.004, "{of_room}");
        assert_eq!(told(&points[..20]), None);
    }
}
