//! Pictures of a film: features are made here, so that no network has a say, and products of descriptors are exact in whatever
//! order they are summed, so that the machine's best kernels for matching may run and every one gives the same.

use landline::features::{FeatureSet, Keypoint};
use landline::geometry::{CamFromWorld, Camera, Pixel, Segment2, rotation_from_vector};
use landline::math::{Rng, elementary};
use landline::reconstruction::View;
use landline::reconstruction::motion::CameraGroup;
use nalgebra::Vector3;

const CHANNELS: u32 = 64;
const TOKENS: usize = 4;
const FOCAL_PX: f64 = 510.0;

type Point = (Vector3<f64>, Vec<f32>);

/// Something in the room, with a descriptor of plus and minus an eighth.
fn thing(rng: &mut Rng) -> Point {
    let at = Vector3::new(
        rng.range(-3.0, 3.0),
        rng.range(-1.5, 1.5),
        rng.range(2.0, 5.0),
    );
    (at, (0..CHANNELS).map(|_| sign(rng)).collect())
}

fn sign(rng: &mut Rng) -> f32 {
    if rng.below(2) == 0 { 0.125 } else { -0.125 }
}

/// Two signs of a descriptor changed.
fn seen_again(descriptor: &[f32], rng: &mut Rng) -> Vec<f32> {
    let mut row = descriptor.to_vec();
    for _ in 0..2 {
        let i = rng.below(CHANNELS) as usize;
        row[i] = -row[i];
    }
    row
}

fn pixel(pose: &CamFromWorld, at: &Vector3<f64>, rng: &mut Rng) -> Option<Pixel> {
    let p = pose.transform_point(at);
    let (x, y) = (
        FOCAL_PX * p.x / p.z + 320.0 + rng.range(-0.5, 0.5),
        FOCAL_PX * p.y / p.z + 240.0 + rng.range(-0.5, 0.5),
    );
    let is_inside = (0.0..640.0).contains(&x) && (0.0..480.0).contains(&y);
    (p.z > 0.5 && is_inside).then(|| Pixel::new(x, y))
}

fn pose(i: usize) -> CamFromWorld {
    let t = i as f64;
    let center = Vector3::new(0.2 * t - 1.0, 0.1 * elementary::sin(0.7 * t), 0.04 * t);
    let turn = Vector3::new(0.0, 0.03 * elementary::sin(0.5 * t), 0.01 * t);
    let rotation = rotation_from_vector(&turn);
    CamFromWorld::new(rotation, -(rotation * center))
}

fn picture(points: &[Point], edges: &[(Point, Vector3<f64>)], i: usize, rng: &mut Rng) -> View {
    let pose = pose(i);
    let mut features = FeatureSet {
        descriptor_channels: CHANNELS as usize,
        tokens: TOKENS,
        ..FeatureSet::default()
    };
    for (at, descriptor) in points {
        let Some(pixel) = pixel(&pose, at, rng) else {
            continue;
        };
        features.keypoints.push(Keypoint { pixel, score: 1.0 });
        features.descriptors_nd.extend(seen_again(descriptor, rng));
    }
    for ((from, descriptor), to) in edges {
        let (Some(start), Some(end)) = (pixel(&pose, from, rng), pixel(&pose, to, rng)) else {
            continue;
        };
        features.segments.push(Segment2 {
            start,
            end,
            width_px: 1.0,
            precision: 0.125,
            neg_log10_nfa: 0.0,
        });
        for _ in 0..TOKENS {
            features
                .segment_descriptors_nsd
                .extend(seen_again(descriptor, rng));
        }
    }
    View {
        name: format!("{i}"),
        camera: CameraGroup::unknown(640, 480).camera,
        cam_from_world: None,
        features,
    }
}

/// The camera of a film.
pub fn film_camera() -> Camera {
    Camera::centered(640, 480, FOCAL_PX)
}

/// Ten pictures of a film without poses, and the poses that they were taken from.
pub fn film_pictures() -> (Vec<View>, Vec<CamFromWorld>) {
    let mut rng = Rng::from_seed(6);
    let points: Vec<Point> = (0..350).map(|_| thing(&mut rng)).collect();
    let edges: Vec<(Point, Vector3<f64>)> = (0..40)
        .map(|_| {
            let (from, descriptor) = thing(&mut rng);
            let along = Vector3::from_fn(|_, _| rng.range(-0.6, 0.6));
            ((from, descriptor), from + along)
        })
        .collect();
    let views = (0..10).map(|i| picture(&points, &edges, i, &mut rng));
    (views.collect(), (0..10).map(pose).collect())
}
