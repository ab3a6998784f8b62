//! The tracker on pictures that are formulas: every movement is known exactly.

use super::*;
use crate::geometry::{Pixel, rotation_from_vector};
use crate::image::{GrayView, PixelFormat};
use crate::math::Rng;

pub(crate) const WIDTH: usize = 320;
pub(crate) const HEIGHT: usize = 240;

/// A smooth texture without repetition: waves of many directions and lengths.
struct Texture {
    waves: Vec<[f64; 4]>,
}

impl Texture {
    fn new(seed: u64) -> Self {
        let mut rng = Rng::from_seed(seed);
        let waves = (0..30)
            .map(|i| {
                // 9 to 360 pixels a wave, and the longer the stronger, as in pictures of rooms.
                let longer = 40_f64.powf(f64::from(i) / 30.0);
                let frequency = std::f64::consts::TAU / (9.0 * longer);
                let angle = rng.range(0.0, std::f64::consts::TAU);
                [
                    frequency * angle.cos(),
                    frequency * angle.sin(),
                    rng.range(0.0, std::f64::consts::TAU),
                    4.0 * longer.powf(0.4),
                ]
            })
            .collect();
        Self { waves }
    }

    /// Grey level at a position in the texture; rarely beyond what eight bits hold, also under changed light.
    fn at(&self, u: f64, v: f64) -> f64 {
        let waves = self.waves.iter();
        128.0
            + waves
                .map(|[a, b, c, size]| size * (a * u + b * v + c).sin())
                .sum::<f64>()
                * 0.9
    }
}

/// A picture whose pixel at `p` (index coordinates) has the texture's grey level at `of(p)`.
fn picture(texture: &Texture, light: [f64; 2], of: impl Fn(f64, f64) -> [f64; 2]) -> Vec<u8> {
    let mut data = Vec::with_capacity(WIDTH * HEIGHT);
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let [u, v] = of(x as f64, y as f64);
            let gray = light[0] * texture.at(u, v) + light[1];
            data.push(gray.round().clamp(0.0, 255.0) as u8);
        }
    }
    data
}

fn grid() -> Vec<Pixel> {
    let at = |i: usize| Pixel::new(40.3 + 40.0 * (i % 7) as f64, 40.7 + 40.0 * (i / 7) as f64);
    (0..28).map(at).collect()
}

fn view(data: &[u8]) -> GrayView<'_> {
    GrayView::tight(data, WIDTH, HEIGHT)
}

/// Distances from the truth of what was found, and how many were not.
fn errors(
    first: &[u8],
    second: &[u8],
    truth: impl Fn(Pixel) -> Pixel,
    level: Level,
) -> (Vec<f64>, usize) {
    let (points, mut flow, mut flows) = (grid(), PointFlow::default(), Vec::new());
    flow.load(&view(first), &view(second), level)
        .expect("pictures");
    flow.find(&points, true, level, &mut flows);
    let mut all = Vec::new();
    for (point, flow) in points.iter().zip(&flows) {
        if let Some(flow) = flow.filter(|f| f.way_back_px < 0.7 && f.correlation > 0.75) {
            all.push(flow.pixel.distance(truth(*point)));
        }
    }
    let missing = points.len() - all.len();
    (all, missing)
}

fn worst(errors: &[f64]) -> f64 {
    errors.iter().copied().fold(0.0, f64::max)
}

/// Bilinear interpolation of waves of nine pixels is off by a few hundredths of a pixel.
const SHIFT_TOLERANCE_PX: f64 = 0.06;

#[test]
fn shifts_are_found_below_a_tenth_of_a_pixel_under_changed_light() {
    let texture = Texture::new(1);
    let first = picture(&texture, [1.0, 0.0], |x, y| [x, y]);
    // Waves of nine pixels resemble themselves: from further away than 17 px another one may be found.
    for (dx, dy) in [(0.0, 0.0), (0.25, -0.4), (3.7, 2.2), (-14.3, 9.1)] {
        for light in [[1.0, 0.0], [0.6, 40.0], [1.15, -25.0]] {
            let second = picture(&texture, light, |x, y| [x - dx, y - dy]);
            for level in Level::available() {
                let truth = |p: Pixel| Pixel::new(p.x + dx, p.y + dy);
                let (errors, missing) = errors(&first, &second, truth, level);
                assert!(missing <= 4, "{missing} missing at {dx} {dy} {light:?}");
                let worst = worst(&errors);
                assert!(
                    worst < SHIFT_TOLERANCE_PX,
                    "{worst} px at {dx} {dy} {light:?} {}",
                    level.name()
                );
            }
        }
    }
}

#[test]
fn another_picture_is_not_found() {
    let first = picture(&Texture::new(1), [1.0, 0.0], |x, y| [x, y]);
    let second = picture(&Texture::new(2), [1.0, 0.0], |x, y| [x, y]);
    let (errors, _) = errors(&first, &second, |p| p, Level::Portable);
    assert!(errors.len() <= 2, "{} of 28 found by chance", errors.len());
}

#[test]
fn walls_and_borders_are_refused() {
    let flat = vec![100; WIDTH * HEIGHT];
    let (errors, missing) = errors(&flat, &flat, |p| p, Level::Portable);
    assert!(errors.is_empty() && missing == 28);
    // An edge shows shifts across it only.
    let mut edge = flat;
    for row in edge.chunks_exact_mut(WIDTH) {
        row[160..].fill(180);
    }
    let (mut flow, mut flows) = (PointFlow::default(), Vec::new());
    flow.load(&view(&edge), &view(&edge), Level::Portable)
        .expect("pictures");
    let points = [Pixel::new(160.0, 120.0), Pixel::new(4.0, 4.0)];
    flow.find(&points, true, Level::Portable, &mut flows);
    assert_eq!(flows, [None, None]);
}

/// A textured wall at z = 4 and a board in front of it at z = 2.5, seen by a camera of 320 pixels' focal length.
pub(crate) struct Scene {
    wall: Texture,
    board: Texture,
    pub(crate) camera: Camera,
}

impl Scene {
    pub(crate) fn new() -> Self {
        Self {
            wall: Texture::new(5),
            board: Texture::new(6),
            camera: Camera::centered(WIDTH as u32, HEIGHT as u32, 320.0),
        }
    }

    fn hit(&self, cam_from_world: &CamFromWorld, pixel: Pixel) -> (Vector3<f64>, bool) {
        let world_from_cam = cam_from_world.inverse();
        let origin = world_from_cam.translation;
        let bearing = self.camera.bearing_from_pixel(pixel).expect("a pinhole");
        let ray = world_from_cam.rotation * bearing;
        let at = |z: f64| origin + ray * ((z - origin.z) / ray.z);
        let board = at(2.5);
        if board.x.abs() < 0.55 && board.y.abs() < 0.4 {
            (board, true)
        } else {
            (at(4.0), false)
        }
    }

    pub(crate) fn render(&self, cam_from_world: &CamFromWorld) -> Vec<u8> {
        let mut data = Vec::with_capacity(WIDTH * HEIGHT);
        for y in 0..HEIGHT {
            for x in 0..WIDTH {
                let pixel = Pixel::from_index_coordinates(x as f64, y as f64);
                let (p, is_board) = self.hit(cam_from_world, pixel);
                let (texture, scale) = if is_board {
                    (&self.board, 128.0)
                } else {
                    (&self.wall, 80.0)
                };
                data.push(
                    texture
                        .at(scale * p.x, scale * p.y)
                        .round()
                        .clamp(0.0, 255.0) as u8,
                );
            }
        }
        data
    }

    /// Points as a localisation gives them, deep by `depth_error` too much.
    pub(crate) fn points(
        &self,
        cam_from_world: &CamFromWorld,
        depth_error: f64,
    ) -> Vec<PointCorrespondence> {
        let center = cam_from_world.center_in_world();
        let mut points = Vec::new();
        for y in (20..230).step_by(16) {
            for x in (20..310).step_by(16) {
                let pixel = Pixel::new(f64::from(x), f64::from(y));
                let (p, _) = self.hit(cam_from_world, pixel);
                points.push(PointCorrespondence {
                    pixel,
                    point_in_world: center + (p - center) * (1.0 + depth_error),
                    confidence: 0.8,
                    sigma_m: 0.0,
                    sigma_px: 0.0,
                });
            }
        }
        points
    }
}

pub(crate) fn pose_at(t: f64) -> CamFromWorld {
    let turn = rotation_from_vector(&Vector3::new(0.05 * t, 0.12 * t, 0.2 * t));
    let center = Vector3::new(0.25 * t, -0.1 * t, 0.3 * t);
    CamFromWorld::new(turn, -(turn * center))
}

pub(crate) fn frame(data: &[u8]) -> FrameView<'_> {
    FrameView {
        bytes: data,
        width: WIDTH as u32,
        height: HEIGHT as u32,
        stride: WIDTH,
        format: PixelFormat::Luma8,
    }
}

fn portable() -> Tracker {
    Tracker::new(TrackerOptions {
        kernels: Level::Portable,
        ..TrackerOptions::default()
    })
}

/// Follows the scene for a second of movement; the largest errors of position and rotation (radians).
fn follow(tracker: &mut Tracker, depth_error: f64) -> (f64, f64) {
    let scene = Scene::new();
    let first = pose_at(0.0);
    let number = tracker.push(&frame(&scene.render(&first))).expect("frame");
    let points = scene.points(&first, depth_error);
    tracker
        .refer(
            number,
            &scene.camera,
            &first,
            &Matrix6::identity().scale(1e-8),
            points.into_iter(),
            std::iter::empty(),
        )
        .expect("enough points");
    let (mut position, mut rotation) = (0.0_f64, 0.0_f64);
    let mut expected = first;
    for k in 1..=15 {
        let truth = pose_at(f64::from(k) / 15.0);
        let number = tracker.push(&frame(&scene.render(&truth))).expect("frame");
        let tracked = tracker.track(number, &expected).expect("in view");
        let (m, rad) = tracked.cam_from_world.error_to(&truth);
        (position, rotation) = (position.max(m), rotation.max(rad));
        expected = tracked.cam_from_world;
        assert!(tracked.num_points[2] > 40);
        assert!(tracked.median_error_px < 0.3);
        let variances = tracked.covariance.diagonal();
        assert!(variances.iter().all(|v| *v > 0.0 && *v < 1e-2));
    }
    (position, rotation)
}

#[test]
fn a_camera_is_followed_through_turns_and_steps() {
    let (position, rotation) = follow(&mut portable(), 0.0);
    assert!(position < 0.004, "{position} m after 0.4 m");
    assert!(rotation < 0.001, "{rotation} rad after 0.24 rad");
}

#[test]
fn wrong_depths_cost_their_share_of_the_movement() {
    // Two percent of depth on every point: a scene that is too large by as much, so 0.4 m of movement are off by 8 mm.
    let (position, rotation) = follow(&mut portable(), 0.02);
    assert!(position > 0.006 && position < 0.011, "{position} m");
    assert!(rotation < 0.001, "{rotation} rad");
}

#[test]
fn the_same_frames_give_the_same_poses() {
    let once = follow(&mut portable(), 0.01);
    let mut tracker = portable();
    assert_eq!(once, follow(&mut tracker, 0.01));
    // And again with buffers that have seen other things.
    assert_eq!(once, follow(&mut tracker, 0.01));
}

#[test]
fn losses_have_their_reasons() {
    let scene = Scene::new();
    let mut tracker = portable();
    let pose = pose_at(0.0);
    let picture = scene.render(&pose);
    let number = tracker.push(&frame(&picture)).expect("frame");
    assert_eq!(
        tracker.track(number, &pose).err(),
        Some(TrackLoss::NoReference)
    );
    let refer = |tracker: &mut Tracker, number: u64, count: usize| {
        let points = scene.points(&pose, 0.0).into_iter().take(count);
        let covariance = Matrix6::identity().scale(1e-6);
        tracker.refer(
            number,
            &scene.camera,
            &pose,
            &covariance,
            points,
            std::iter::empty(),
        )
    };
    assert_eq!(
        refer(&mut tracker, number + 1, 300),
        Err(TrackLoss::NoFrame)
    );
    assert_eq!(refer(&mut tracker, number, 5), Err(TrackLoss::FewFound));
    assert_eq!(refer(&mut tracker, number, 300), Ok(()));
    assert!(tracker.track(number, &pose).is_ok());
    // A hand over the lens.
    let dark = vec![20; WIDTH * HEIGHT];
    let number = tracker.push(&frame(&dark)).expect("frame");
    assert_eq!(
        tracker.track(number, &pose).err(),
        Some(TrackLoss::FewFound)
    );
    // Turned away by a right angle.
    let away = CamFromWorld::new(
        rotation_from_vector(&Vector3::new(0.0, 1.57, 0.0)),
        Vector3::zeros(),
    );
    assert_eq!(
        tracker.track(number, &away).err(),
        Some(TrackLoss::OutOfView)
    );
    // Half the width.
    let half = FrameView {
        bytes: &dark[..WIDTH / 2 * HEIGHT],
        width: WIDTH as u32 / 2,
        stride: WIDTH / 2,
        ..frame(&dark)
    };
    let number = tracker.push(&half).expect("frame");
    assert_eq!(
        tracker.track(number, &pose).err(),
        Some(TrackLoss::NoReference)
    );
    assert_eq!(refer(&mut tracker, number, 300), Err(TrackLoss::Resized));
}

/// Bars in front of a texture that is a wall four metres away.
fn barred(texture: &Texture) -> Vec<u8> {
    let mut data = picture(texture, [0.4, 90.0], |x, y| [x, y]);
    for (i, v) in data.iter_mut().enumerate() {
        if (i % WIDTH) % 40 < 4 || (i / WIDTH) % 40 < 4 {
            *v = 20;
        }
    }
    data
}

#[test]
fn edges_alone_do_not_prove_a_pose() {
    let camera = Camera::centered(WIDTH as u32, HEIGHT as u32, 320.0);
    let on_wall = |p: Pixel| {
        let bearing = camera.bearing_from_pixel(p).expect("a pinhole");
        bearing * (4.0 / bearing.z)
    };
    let points = (0..6 * 5).map(|i| {
        let pixel = Pixel::new(
            62.5 + 40.0 * f64::from(i % 6),
            22.5 + 40.0 * f64::from(i / 6),
        );
        PointCorrespondence {
            pixel,
            point_in_world: on_wall(pixel),
            confidence: 0.8,
            sigma_m: 0.0,
            sigma_px: 0.0,
        }
    });
    // The left edges of upright bars and the lower ones of the others, between two bars.
    let lines = (0..2 * 6 * 4).map(|i| {
        let (x, y) = (
            40.0 * f64::from(1 + i / 2 % 6),
            40.0 * f64::from(1 + i / 12),
        );
        let [start, end] = if i % 2 == 0 {
            [Pixel::new(x, y + 8.0), Pixel::new(x, y + 36.0)]
        } else {
            [Pixel::new(x + 8.0, y + 4.0), Pixel::new(x + 36.0, y + 4.0)]
        };
        LineCorrespondence {
            start,
            end,
            start_in_world: on_wall(start),
            end_in_world: on_wall(end),
            confidence: 0.8,
            sigma_m: 0.0,
            sigma_px: 0.0,
        }
    });
    let (own, other) = (barred(&Texture::new(1)), barred(&Texture::new(2)));
    let mut tracker = portable();
    let number = tracker.push(&frame(&own)).expect("frame");
    let pose = CamFromWorld::identity();
    let covariance = Matrix6::identity().scale(1e-6);
    tracker
        .refer(number, &camera, &pose, &covariance, points, lines)
        .expect("enough points");
    let number = tracker.push(&frame(&own)).expect("frame");
    let tracked = tracker.track(number, &pose).expect("the same picture");
    assert!(tracked.num_lines[2] >= 20 && tracked.num_points[2] >= 20);
    // The same bars in front of another wall: all edges are there, and hardly a point.
    let number = tracker.push(&frame(&other)).expect("frame");
    assert_eq!(
        tracker.track(number, &pose).err(),
        Some(TrackLoss::FewFound)
    );
}

#[test]
fn the_covariance_of_a_joined_camera_follows_it() {
    // Against the definition: perturb the first camera, see how the second moves.
    let from = pose_at(0.3);
    let to = pose_at(-1.7);
    let joint = to * from.inverse();
    for axis in 0..6 {
        let h = 1e-6;
        let mut xi = [0.0; 6];
        xi[axis] = h;
        let turn = rotation_from_vector(&Vector3::new(xi[0], xi[1], xi[2]));
        let shift = Vector3::new(xi[3], xi[4], xi[5]);
        let moved = CamFromWorld::new(turn * from.rotation, turn * from.translation + shift);
        let second = joint * moved;
        let delta =
            crate::geometry::vector_from_rotation(&(second.rotation * to.rotation.transpose()));
        let v = second.translation - second.rotation * to.rotation.transpose() * to.translation;
        let mut one = Matrix6::zeros();
        one[(axis, axis)] = 1.0;
        let carried = carry(&one, &from, &to);
        for (i, d) in delta.iter().chain(v.iter()).enumerate() {
            assert!(
                (carried[(i, i)] - (d / h).powi(2)).abs() < 1e-4,
                "{axis} {i}"
            );
        }
    }
}
