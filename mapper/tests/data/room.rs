//! A synthetic room of points and lines with exact truth, as features of cameras on an arc.

use landline::features::{FeatureSet, Keypoint};
use landline::geometry::{CamFromWorld, Camera, Pixel, Segment2};
use landline::math::Rng;
use landline_mapper::dataset::{DatasetImage, Split};
use nalgebra::{Rotation3, Vector3};

const D: usize = 32;
const SAMPLES: usize = 12;
const NOISE_PX: f64 = 0.4;

pub(crate) struct Room {
    pub(crate) points: Vec<(Vector3<f64>, Vec<f32>)>,
    pub(crate) lines: Vec<([Vector3<f64>; 2], Vec<f32>)>,
    pub(crate) images: Vec<DatasetImage>,
    pub(crate) features: Vec<FeatureSet>,
    /// For each picture and segment which line it shows.
    pub(crate) segment_lines: Vec<Vec<usize>>,
}

fn unit(rng: &mut Rng) -> Vec<f32> {
    let v: Vec<f64> = (0..D).map(|_| rng.normal()).collect();
    let norm = v.iter().map(|x| x * x).sum::<f64>().sqrt();
    v.iter().map(|x| (x / norm) as f32).collect()
}

fn noisy(rng: &mut Rng, descriptor: &[f32]) -> Vec<f32> {
    let v: Vec<f32> = descriptor
        .iter()
        .map(|x| x + 0.03 * rng.normal() as f32)
        .collect();
    let norm = v.iter().map(|x| x * x).sum::<f32>().sqrt();
    v.iter().map(|x| x / norm).collect()
}

/// Cameras on an arc that look into a box of points and lines.
pub(crate) fn room(num_images: usize) -> Room {
    let mut rng = Rng::from_seed(7);
    let inside = |rng: &mut Rng| {
        Vector3::new(
            rng.range(-1.5, 1.5),
            rng.range(-1.0, 1.0),
            rng.range(1.5, 3.5),
        )
    };
    let points: Vec<_> = (0..250)
        .map(|_| (inside(&mut rng), unit(&mut rng)))
        .collect();
    let lines: Vec<_> = (0..30)
        .map(|_| {
            let a = inside(&mut rng);
            let direction = Vector3::new(rng.normal(), rng.normal(), rng.normal()).normalize();
            ([a, a + 0.6 * direction], unit(&mut rng))
        })
        .collect();
    let camera = Camera::centered(640, 480, 500.0);
    let mut images = Vec::new();
    let mut features = Vec::new();
    let mut segment_lines = Vec::new();
    for i in 0..num_images {
        let s = i as f64 / 23.0 - 0.5;
        let center = Vector3::new(1.2 * s, 0.15 * (7.0 * s).sin(), 0.3 * s * s);
        let rotation = Rotation3::from_euler_angles(0.05 * (5.0 * s).cos(), 0.35 * s, 0.04 * s);
        let r = *rotation.matrix();
        let pose = CamFromWorld::new(r, -(r * center));
        let project = |p: &Vector3<f64>| {
            camera
                .pixel_from_cam(&pose.transform_point(p))
                .filter(|q| q.x > 0.0 && q.y > 0.0 && q.x < 640.0 && q.y < 480.0)
        };
        let mut f = FeatureSet {
            descriptor_channels: D,
            tokens: SAMPLES,
            ..FeatureSet::default()
        };
        let jitter = |rng: &mut Rng, p: Pixel| {
            Pixel::new(p.x + NOISE_PX * rng.normal(), p.y + NOISE_PX * rng.normal())
        };
        for (p, descriptor) in &points {
            if let Some(pixel) = project(p) {
                f.keypoints.push(Keypoint {
                    pixel: jitter(&mut rng, pixel),
                    score: 1.0,
                });
                let d = noisy(&mut rng, descriptor);
                f.descriptors_nd.extend(d);
            }
        }
        // Keypoints of nothing in particular.
        for _ in 0..30 {
            f.keypoints.push(Keypoint {
                pixel: Pixel::new(rng.range(0.0, 640.0), rng.range(0.0, 480.0)),
                score: 0.1,
            });
            let d = unit(&mut rng);
            f.descriptors_nd.extend(d);
        }
        let mut shown = Vec::new();
        for (l, ([a, b], descriptor)) in lines.iter().enumerate() {
            // The detector stops somewhere along the line, in either direction.
            let (from, to) = (rng.range(0.0, 0.15), rng.range(0.85, 1.0));
            let (mut p, mut q) = (a + (b - a) * from, a + (b - a) * to);
            if rng.below(2) == 0 {
                std::mem::swap(&mut p, &mut q);
            }
            if let (Some(start), Some(end)) = (project(&p), project(&q)) {
                shown.push(l);
                f.segments.push(Segment2 {
                    start: jitter(&mut rng, start),
                    end: jitter(&mut rng, end),
                    width_px: 1.0,
                    precision: 0.125,
                    neg_log10_nfa: 5.0,
                });
                for _ in 0..SAMPLES {
                    let d = noisy(&mut rng, descriptor);
                    f.segment_descriptors_nsd.extend(d);
                }
            }
        }
        images.push(DatasetImage {
            name: format!("{i:03}.png"),
            path: "unused".into(),
            camera,
            cam_from_world: Some(pose),
            split: Split::Train,
        });
        features.push(f);
        segment_lines.push(shown);
    }
    Room {
        points,
        lines,
        images,
        features,
        segment_lines,
    }
}
