//! A small place with exact labels: a box of points and segments seen from an arc.

use landline::features::{FeatureSet, Keypoint};
use landline::geometry::{CamFromWorld, Camera, Pixel, Segment2};
use landline::math::Rng;
use landline::reconstruction::{LineTrack, Observation, PointTrack, Reconstruction, View};
use landline::scene_file::Units;
use landline_mapper::labels::{LabelledVariant, Labels, Origin};
use nalgebra::Vector3;

/// Numbers in a descriptor: XFeat's, so that a scene file takes the network.
pub(crate) const D: usize = 64;
/// Samples on a segment; what the presets take.
pub(crate) const SAMPLES: usize = 12;
const NUM_POINTS: usize = 120;
const NUM_LINES: usize = 30;

fn unit(v: Vec<f64>) -> Vec<f32> {
    let norm = v.iter().map(|x| x * x).sum::<f64>().sqrt();
    v.iter().map(|x| (x / norm) as f32).collect()
}

fn noisy(base: &[f32], rng: &mut Rng) -> Vec<f32> {
    unit(
        base.iter()
            .map(|x| f64::from(*x) + 0.03 * rng.normal())
            .collect(),
    )
}

/// Labels of `num_images` pictures; the last point and segment of each have no target. Each picture has one variant.
pub(crate) fn labels(num_images: usize) -> Labels {
    let mut rng = Rng::from_seed(3);
    let mut inside = || {
        Vector3::new(
            rng.range(-1.0, 1.0),
            rng.range(-0.8, 0.8),
            rng.range(2.0, 4.0),
        )
    };
    let points: Vec<Vector3<f64>> = (0..NUM_POINTS).map(|_| inside()).collect();
    let lines: Vec<[Vector3<f64>; 2]> = (0..NUM_LINES).map(|_| [inside(), inside()]).collect();
    let mut descriptor = || unit((0..D).map(|_| rng.normal()).collect());
    let point_keys: Vec<Vec<f32>> = (0..NUM_POINTS).map(|_| descriptor()).collect();
    let line_keys: Vec<Vec<f32>> = (0..NUM_LINES).map(|_| descriptor()).collect();
    let camera = Camera::centered(640, 480, 400.0);
    let seen_by_all = |feature: usize| -> Vec<Observation> {
        (0..num_images)
            .map(|view| Observation::new(view, feature))
            .collect()
    };
    let mut labels = Labels {
        origin: Origin {
            extractor_sha256: "0".repeat(64),
            ..Origin::default()
        },
        map: Reconstruction {
            units: Units::Metres,
            points: (0..NUM_POINTS - 1)
                .map(|i| PointTrack {
                    descriptor: point_keys[i].clone(),
                    mean_error_px: 0.5,
                    ..PointTrack::new(points[i], seen_by_all(i))
                })
                .collect(),
            lines: (0..NUM_LINES - 1)
                .map(|i| LineTrack {
                    descriptor: line_keys[i].clone(),
                    mean_error_px: 0.5,
                    ..LineTrack::new(lines[i], seen_by_all(i))
                })
                .collect(),
            ..Reconstruction::default()
        },
        ..Labels::default()
    };
    for i in 0..num_images {
        let angle = 0.3 * (i as f64 / num_images as f64 - 0.5);
        let cam_from_world = CamFromWorld::from_quaternion_wxyz(
            [(angle / 2.0).cos(), 0.0, (angle / 2.0).sin(), 0.0],
            Vector3::new(0.4 * angle, 0.02 * i as f64, 0.1),
        );
        let project = |p: &Vector3<f64>| -> Pixel {
            let in_cam = cam_from_world.transform_point(p);
            camera
                .pixel_from_cam(&in_cam)
                .expect("in front of the camera")
        };
        let features = FeatureSet {
            keypoints: points
                .iter()
                .map(|p| Keypoint {
                    pixel: project(p),
                    score: 1.0,
                })
                .collect(),
            descriptors_nd: point_keys.iter().flat_map(|k| noisy(k, &mut rng)).collect(),
            segments: lines
                .iter()
                .map(|[a, b]| Segment2 {
                    start: project(a),
                    end: project(b),
                    width_px: 2.0,
                    precision: 0.125,
                    neg_log10_nfa: 10.0,
                })
                .collect(),
            segment_descriptors_nsd: line_keys
                .iter()
                .flat_map(|k| {
                    (0..SAMPLES)
                        .flat_map(|_| noisy(k, &mut rng))
                        .collect::<Vec<_>>()
                })
                .collect(),
            descriptor_channels: D,
            tokens: SAMPLES,
        };
        labels.variants.push(LabelledVariant {
            of_view: i as u32,
            features: features.clone(),
        });
        labels.map.views.push(View {
            name: format!("{i:03}"),
            camera,
            cam_from_world: Some(cam_from_world),
            features,
        });
    }
    labels
}
