//! Synthetic pose problems: a camera in a room, points and lines with noise, outliers and confidences.

use landline::geometry::{CamFromWorld, Camera, Pixel, rotation_from_vector};
use landline::math::Rng;
use landline::pose::{LineCorrespondence, PointCorrespondence};
use nalgebra::Vector3;

/// What a problem is made of.
#[derive(Debug, Clone, Copy)]
pub struct PoseSceneParams {
    /// Point correspondences.
    pub num_points: usize,
    /// Line correspondences.
    pub num_lines: usize,
    /// Share of inliers.
    pub inlier_share: f64,
    /// Standard deviation of pixels.
    pub sigma_px: f64,
    /// Standard deviation of world coordinates.
    pub sigma_m: f64,
    /// Everything on one plane that faces the camera.
    pub is_fronto_parallel: bool,
}

impl Default for PoseSceneParams {
    fn default() -> Self {
        Self {
            num_points: 200,
            num_lines: 50,
            inlier_share: 0.5,
            sigma_px: 0.7,
            sigma_m: 0.0,
            is_fronto_parallel: false,
        }
    }
}

/// A problem with its truth.
#[derive(Debug, Clone)]
pub struct PoseScene {
    /// 640x480, focal length 525 px.
    pub camera: Camera,
    /// The truth. Gravity is the world's +y.
    pub cam_from_world: CamFromWorld,
    /// Points.
    pub points: Vec<PointCorrespondence>,
    /// Lines.
    pub lines: Vec<LineCorrespondence>,
}

/// Makes a problem; the same seed gives the same one.
#[must_use]
pub fn pose_scene(params: &PoseSceneParams, seed: u64) -> PoseScene {
    let mut rng = Rng::from_seed(seed);
    let camera = Camera::centered(640, 480, 525.0);
    let tilt = Vector3::new(rng.range(-0.3, 0.3), 0.0, rng.range(-0.1, 0.1));
    let yaw = Vector3::new(0.0, rng.range(-3.0, 3.0), 0.0);
    let rotation = rotation_from_vector(&tilt) * rotation_from_vector(&yaw);
    let center = Vector3::new(
        rng.range(-2.0, 2.0),
        rng.range(-0.5, 0.5),
        rng.range(-2.0, 2.0),
    );
    let cam_from_world = CamFromWorld::new(rotation, -(rotation * center));
    let world_from_cam = cam_from_world.inverse();
    let focal = camera.focal_px().0;
    let in_world = |p: Pixel, depth: f64| {
        let z = Vector3::new((p.x - 320.0) / focal, (p.y - 240.0) / focal, 1.0) * depth;
        world_from_cam.transform_point(&z)
    };
    let depth = |rng: &mut Rng| {
        if params.is_fronto_parallel {
            3.0
        } else {
            rng.range(1.0, 6.0)
        }
    };
    let pixel = |rng: &mut Rng| Pixel::new(rng.range(5.0, 635.0), rng.range(5.0, 475.0));
    let noisy = |rng: &mut Rng, p: Pixel| {
        Pixel::new(
            p.x + params.sigma_px * rng.normal(),
            p.y + params.sigma_px * rng.normal(),
        )
    };
    let shift = |rng: &mut Rng| Vector3::from_fn(|_, _| params.sigma_m * rng.normal());
    let room = |rng: &mut Rng| center + Vector3::from_fn(|_, _| rng.range(-4.0, 4.0));
    let confidence = |rng: &mut Rng, is_inlier: bool| {
        let u = rng.uniform();
        let c = if is_inlier {
            1.0 - 0.6 * u * u
        } else {
            0.1 + 0.7 * u * u
        };
        c as f32
    };
    let num_inliers = |n: usize| (params.inlier_share * n as f64).round() as usize;
    let mut points = Vec::new();
    for i in 0..params.num_points {
        let is_inlier = i < num_inliers(params.num_points);
        let p = pixel(&mut rng);
        let truth = in_world(p, depth(&mut rng)) + shift(&mut rng);
        let outlier = room(&mut rng);
        points.push(PointCorrespondence {
            pixel: noisy(&mut rng, p),
            point_in_world: if is_inlier { truth } else { outlier },
            confidence: confidence(&mut rng, is_inlier),
            sigma_m: 0.0,
            sigma_px: 0.0,
        });
    }
    let mut lines = Vec::new();
    while lines.len() < params.num_lines {
        let is_inlier = lines.len() < num_inliers(params.num_lines);
        let (a, b) = (pixel(&mut rng), pixel(&mut rng));
        if a.distance(b) < 60.0 {
            continue;
        }
        let start = in_world(a, depth(&mut rng)) + shift(&mut rng);
        let end = in_world(b, depth(&mut rng)) + shift(&mut rng);
        let (u, v) = (room(&mut rng), room(&mut rng));
        lines.push(LineCorrespondence {
            start: noisy(&mut rng, a),
            end: noisy(&mut rng, b),
            start_in_world: if is_inlier { start } else { u },
            end_in_world: if is_inlier { end } else { v },
            confidence: confidence(&mut rng, is_inlier),
            sigma_m: 0.0,
            sigma_px: 0.0,
        });
    }
    PoseScene {
        camera,
        cam_from_world,
        points,
        lines,
    }
}
