//! A small place with exact labels: a box of points and segments seen from an arc.

use landline::geometry::{CamFromWorld, Camera, Pixel, Segment2};
use landline::math::Rng;
use landline_mapper::labels::{
    LabelledImage, LabelledVariant, Labels, LineTrack, Observation, PointTrack, SegmentTarget,
};
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
    let seen_by_all = |feature: usize| {
        (0..num_images as u32)
            .map(|image| Observation {
                image,
                feature: feature as u32,
            })
            .collect::<Vec<_>>()
    };
    let mut labels = Labels {
        descriptor_len: D,
        samples_per_segment: SAMPLES,
        extractor: "test".to_owned(),
        points: (0..NUM_POINTS - 1)
            .map(|i| PointTrack {
                point_in_world: points[i],
                observations: seen_by_all(i),
                descriptor: point_keys[i].clone(),
                mean_error_px: 0.5,
            })
            .collect(),
        lines: (0..NUM_LINES - 1)
            .map(|i| LineTrack {
                start_in_world: lines[i][0],
                end_in_world: lines[i][1],
                observations: seen_by_all(i),
                descriptor: line_keys[i].clone(),
                mean_error_px: 0.5,
            })
            .collect(),
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
        let image = LabelledImage {
            name: format!("{i:03}"),
            camera,
            cam_from_world,
            pixels: points.iter().map(project).collect(),
            scores: vec![1.0; NUM_POINTS],
            descriptors_nd: point_keys.iter().flat_map(|k| noisy(k, &mut rng)).collect(),
            point_targets: (0..NUM_POINTS as u32)
                .map(|t| Some(t).filter(|t| (*t as usize) < NUM_POINTS - 1))
                .collect(),
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
            segment_targets: (0..NUM_LINES as u32)
                .map(|track| {
                    Some(SegmentTarget {
                        track,
                        reversed: false,
                    })
                    .filter(|t| (t.track as usize) < NUM_LINES - 1)
                })
                .collect(),
        };
        labels.variants.push(LabelledVariant {
            of_image: i as u32,
            image: image.clone(),
        });
        labels.images.push(image);
    }
    labels
}
