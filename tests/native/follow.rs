//! The follower in a whole program: what it allocates, and what sensors that lie do to it.

use landline::geometry::{CamFromWorld, Camera, CameraModel, Pixel};
use landline::image::{FrameView, PixelFormat};
use landline::pose::PointCorrespondence;
use landline::session::{Answer, FollowOptions, FollowState, Follower};
use landline::simd::Level;
use landline_testkit::allocations;
use nalgebra::{Matrix3, Matrix6, Rotation3, Vector3};

const SIZE: (u32, u32) = (320, 240);
const FOCAL_PX: f64 = 300.0;
/// A poster so far ahead that a shift of the camera by a centimetre is one of 1.5 pixels.
const DEPTH_M: f64 = 2.0;

fn camera() -> Camera {
    Camera {
        width: SIZE.0,
        height: SIZE.1,
        model: CameraModel::Pinhole {
            fx: FOCAL_PX,
            fy: FOCAL_PX,
            cx: 160.0,
            cy: 120.0,
        },
    }
}

/// The camera so far to the right, looking ahead.
fn pose(right_m: f64) -> CamFromWorld {
    CamFromWorld::new(Matrix3::identity(), Vector3::new(-right_m, 0.0, 0.0))
}

/// What it sees of the poster: waves of several directions and lengths.
fn picture(right_m: f64) -> Vec<u8> {
    let shift = right_m * FOCAL_PX / DEPTH_M;
    let at = |x: f64, y: f64| {
        let wave = |a: f64, b: f64, c: f64| (a * x + b * y + c).sin();
        let fine = wave(0.31, 0.17, 0.4) + wave(-0.23, 0.37, 2.0) + wave(0.05, -0.41, 4.1);
        let coarse = wave(0.07, 0.05, 1.0) + wave(-0.04, 0.09, 3.0) + wave(0.021, -0.013, 5.0);
        128.0 + 16.0 * fine + 24.0 * coarse
    };
    let pixels = (0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| (x, y)));
    pixels
        .map(|(x, y)| at(f64::from(x) + shift, f64::from(y)).round() as u8)
        .collect()
}

fn frame(bytes: &[u8]) -> FrameView<'_> {
    FrameView {
        bytes,
        width: SIZE.0,
        height: SIZE.1,
        stride: SIZE.0 as usize,
        format: PixelFormat::Luma8,
    }
}

/// What a relocalizer would say of the frame: points of the poster on a grid.
fn answer(number: u64, right_m: f64) -> (Answer, Vec<PointCorrespondence>) {
    let cells = (0..70).map(|i| (f64::from(i % 10), f64::from(i / 10)));
    let points = cells.map(|(column, row)| {
        let pixel = Pixel::new(30.0 + 28.0 * column, 30.0 + 28.0 * row);
        let [x, y] = [pixel.x - 160.0, pixel.y - 120.0].map(|v| v * DEPTH_M / FOCAL_PX);
        PointCorrespondence {
            pixel,
            point_in_world: Vector3::new(x + right_m, y, DEPTH_M),
            confidence: 1.0,
            sigma_m: 0.0,
            sigma_px: 0.0,
        }
    });
    let answer = Answer {
        frame: number,
        camera: camera(),
        cam_from_world: pose(right_m),
        covariance: Matrix6::identity().scale(1e-6),
    };
    (answer, points.collect())
}

fn follower() -> Follower {
    let mut options = FollowOptions::default();
    options.tracker.kernels = Level::Portable;
    Follower::new(options)
}

/// Metres that the camera is to the right in a frame: to and fro.
fn right_m(frame: usize) -> f64 {
    0.05 * (0.3 * frame as f64).sin()
}

#[test]
fn following_allocates_nothing_once_sizes_and_numbers_were_seen() {
    let pictures: Vec<Vec<u8>> = (0..24).map(|i| picture(right_m(i))).collect();
    let mut follower = follower();
    let mut warm_up = 0;
    for (i, bytes) in pictures.iter().enumerate() {
        let now_ms = 33.0 * i as f64;
        let (report, count) = allocations(|| follower.frame(&frame(bytes), now_ms, None));
        let report = report.expect("a frame that makes sense");
        // Every sixth frame is answered three frames later.
        let late = i.checked_sub(3).filter(|late| late % 6 == 0);
        // Taking an answer over may allocate: that happens a few times a second.
        if let Some(late) = late {
            let (answer, points) = answer(late as u64, right_m(late));
            follower.localized(&answer, points.into_iter(), [].into_iter());
        }
        if i % 6 == 0 {
            assert!(follower.hold(report.frame));
        }
        if i < 16 {
            warm_up += count;
            continue;
        }
        assert_eq!(report.state, FollowState::Tracking);
        assert_eq!(count, 0, "frame {i}");
    }
    assert!(warm_up > 0, "the allocator counts");
}

#[test]
fn sensors_that_lie_cost_nothing_but_their_help() {
    let mut follower = follower();
    // The sensor says that the camera turns by ten degrees from frame to frame.
    let lie = Rotation3::from_axis_angle(&Vector3::y_axis(), 10.0_f64.to_radians());
    for i in 0..10 {
        let report = follower
            .frame(
                &frame(&picture(right_m(i))),
                33.0 * i as f64,
                Some(lie.matrix()),
            )
            .expect("a frame that makes sense");
        if i == 0 {
            let (answer, points) = answer(report.frame, right_m(0));
            follower.localized(&answer, points.into_iter(), [].into_iter());
            continue;
        }
        let pose_now = report.pose.expect("tracked without the sensor's help");
        let (m, rad) = pose_now.cam_from_world.error_to(&pose(right_m(i)));
        assert!(m < 0.01 && rad < 0.004, "{m} m, {rad} rad in frame {i}");
    }
}
