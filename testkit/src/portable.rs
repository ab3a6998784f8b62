//! One number over everything that must come out in the same bits natively and as wasm: elementary functions, the line
//! segment detector, the pose solver.
//!
//! `tests/native` writes it down, `tests/wasm_node` computes it again and compares. A difference means that an operation
//! was used whose last digit depends on the machine. The inputs are made here from a seed with plain arithmetic.

use landline::geometry::{CamFromWorld, Camera, Pixel};
use landline::image::GrayView;
use landline::lsd::{LsdParams, LsdScratch, detect};
use landline::math::{Rng, elementary};
use landline::pose::{LineCorrespondence, PointCorrespondence, PoseOptions, PoseScratch, estimate};
use nalgebra::Vector3;
use std::fmt::Write as _;

/// One line per part: its name, how many numbers went into it, and their digest.
///
/// # Panics
///
/// When a part does not give a result at all: then there is nothing to compare.
#[must_use]
pub fn digest() -> String {
    let mut text = String::new();
    for (name, numbers) in [
        ("elementary", elementary_functions()),
        ("segments", segments()),
        ("pose", pose()),
    ] {
        assert!(!numbers.is_empty(), "{name} gave no result");
        let mut hash = Fnv::default();
        for number in &numbers {
            hash.update(&number.to_bits().to_le_bytes());
        }
        // Writing to a string cannot fail.
        drop(write!(text, "{name} {} {:016x}; ", numbers.len(), hash.0));
    }
    text
}

/// FNV-1a, 64 bits: tiny, and good enough to tell two lists of numbers apart.
struct Fnv(u64);

impl Default for Fnv {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Fnv {
    fn update(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.0 = (self.0 ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }
}

fn elementary_functions() -> Vec<f64> {
    let mut rng = Rng::from_seed(1);
    let mut numbers = Vec::new();
    for _ in 0..2000 {
        let x = rng.range(-20.0, 20.0);
        let unit = rng.range(-1.0, 1.0);
        let positive = rng.range(1e-6, 1e6);
        numbers.extend([
            elementary::sin(x),
            elementary::cos(x),
            elementary::tan(x),
            elementary::acos(unit),
            elementary::atan(x),
            elementary::atan2(x, unit),
            elementary::exp(x),
            elementary::ln(positive),
            elementary::ln_1p(positive),
            elementary::cbrt(x),
            elementary::hypot(x, unit),
        ]);
    }
    numbers
}

/// Overlapping tilted rectangles with a little noise.
fn segments() -> Vec<f64> {
    let (width, height) = (320_usize, 240_usize);
    let mut rng = Rng::from_seed(2);
    let mut levels = vec![90.0_f64; width * height];
    for _ in 0..25 {
        let (center_x, center_y) = (rng.range(0.0, 320.0), rng.range(0.0, 240.0));
        let (half_width, half_height) = (rng.range(8.0, 60.0), rng.range(8.0, 60.0));
        let angle = rng.range(0.0, 3.0);
        let (sin, cos) = (elementary::sin(angle), elementary::cos(angle));
        let level = rng.range(20.0, 235.0);
        for (at, pixel) in levels.iter_mut().enumerate() {
            let x = (at % width) as f64 + 0.5 - center_x;
            let y = (at / width) as f64 + 0.5 - center_y;
            let is_inside =
                (cos * x + sin * y).abs() < half_width && (cos * y - sin * x).abs() < half_height;
            if is_inside {
                *pixel = level;
            }
        }
    }
    let levels: Vec<u8> = levels
        .iter()
        .map(|level| (level + rng.range(-6.0, 6.0)).clamp(0.0, 255.0) as u8)
        .collect();
    let mut scratch = LsdScratch::default();
    let view = GrayView::tight(&levels, width, height);
    let found = detect(&view, &LsdParams::default(), &mut scratch);
    found
        .unwrap_or_default()
        .iter()
        .flat_map(|segment| {
            [
                segment.start.x,
                segment.start.y,
                segment.end.x,
                segment.end.y,
                segment.width_px,
                segment.neg_log10_nfa,
            ]
        })
        .collect()
}

/// Points and lines with noise, a third of them wrong.
fn pose() -> Vec<f64> {
    let mut rng = Rng::from_seed(3);
    let camera = Camera::centered(640, 480, 520.0);
    let truth =
        CamFromWorld::from_quaternion_wxyz([0.9, 0.2, -0.3, 0.1], Vector3::new(0.3, -0.2, 0.5));
    let world_from_cam = truth.inverse();
    let mut observe = |rng: &mut Rng| -> (Pixel, Vector3<f64>) {
        let pixel = Pixel {
            x: rng.range(0.0, 640.0),
            y: rng.range(0.0, 480.0),
        };
        let bearing = camera.bearing_from_pixel(pixel).unwrap_or(Vector3::z());
        let point_in_world = world_from_cam.transform_point(&(bearing * rng.range(1.5, 6.0)));
        let is_outlier = rng.below(3) == 0;
        let noise_m = if is_outlier { 2.0 } else { 0.01 };
        let noise = Vector3::from_fn(|_, _| rng.range(-noise_m, noise_m));
        (pixel, point_in_world + noise)
    };
    let points: Vec<PointCorrespondence> = (0..150)
        .map(|_| {
            let (pixel, point_in_world) = observe(&mut rng);
            PointCorrespondence {
                pixel,
                point_in_world,
                confidence: 0.7,
                sigma_m: 0.0,
            }
        })
        .collect();
    let lines: Vec<LineCorrespondence> = (0..60)
        .map(|_| {
            let (start, start_in_world) = observe(&mut rng);
            let (end, end_in_world) = observe(&mut rng);
            LineCorrespondence {
                start,
                end,
                start_in_world,
                end_in_world,
                confidence: 0.6,
                sigma_m: 0.0,
            }
        })
        .collect();
    let mut scratch = PoseScratch::default();
    let options = PoseOptions {
        seed: 4,
        ..PoseOptions::default()
    };
    let outcome = estimate(
        &points,
        &lines,
        &camera,
        &options,
        &mut scratch,
        &mut || 0.0,
    );
    let Some(estimate) = outcome.ok().and_then(|outcome| outcome.estimate) else {
        return Vec::new();
    };
    let transform = estimate.cam_from_world;
    let mut numbers: Vec<f64> = transform.rotation.iter().copied().collect();
    numbers.extend(transform.translation.iter());
    numbers.extend(estimate.covariance.iter());
    numbers.extend([estimate.score, f64::from(estimate.num_point_inliers)]);
    numbers
}
