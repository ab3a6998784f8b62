//! Where the pictures are taken: a walk for teaching, other places for asking.

use super::noise::Dice;
use super::{Room, noise};
use landline::geometry::{CamFromWorld, Camera, Pixel};
use nalgebra::{Matrix3, Vector3};

/// A camera at a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// Intrinsics.
    pub camera: Camera,
    /// Exact.
    pub cam_from_world: CamFromWorld,
}

/// Views of a person who walks through the room twice and looks around, in the order of the walk.
pub fn training_views(room: &Room, seed: u64, count: usize, width: u32, height: u32) -> Vec<View> {
    let [w, d] = shares_of_sample(room);
    let mut views = Vec::with_capacity(count);
    for i in 0..count {
        let u = i as f64 / count as f64;
        let wave = |k: f64, row: u64| {
            2.0 * noise::value(k * u, 0.5, seed.wrapping_mul(31).wrapping_add(row)) - 1.0
        };
        // Three rounds: outwards from the middle, across the room, along the walls.
        let round = (3.0 * u).floor();
        let angle = core::f64::consts::TAU * (3.0 * u - round) + 0.4 * wave(24.0, 1);
        let (radius, turn) = match round as u32 {
            0 => (0.75, 0.0),
            1 => (1.35, core::f64::consts::PI),
            _ => (1.15, 0.5 * core::f64::consts::PI),
        };
        let radius = radius + 0.25 * wave(30.0, 2);
        let eye = Vector3::new(
            w * (3.0 + 1.35 * radius * angle.cos()),
            d * (2.45 + radius * angle.sin()),
            1.5 + 0.22 * wave(20.0, 3),
        );
        let yaw = angle + turn + 0.35 * wave(36.0, 4);
        let pitch = -0.10 + 0.22 * wave(28.0, 5);
        let roll = 0.06 * wave(26.0, 6);
        views.push(look(room, width, height, eye, yaw, pitch, roll));
    }
    views
}

/// Views from random places and in random directions; none is taken from the walk of [`training_views`].
pub fn query_views(room: &Room, seed: u64, count: usize, width: u32, height: u32) -> Vec<View> {
    let [w, d] = shares_of_sample(room);
    let least = 1.1 * w.min(d).min(1.0);
    let mut dice = Dice::new(seed ^ 0x0A5C);
    let mut views = Vec::with_capacity(count);
    while views.len() < count {
        // One round, so that every wall is asked for.
        let around = core::f64::consts::TAU * (views.len() as f64 + dice.unit()) / count as f64;
        let eye = Vector3::new(
            w * dice.range(1.5, 4.5),
            d * dice.range(1.4, 3.6),
            dice.range(1.2, 1.75),
        );
        let (pitch, roll) = (dice.range(-0.35, 0.12), dice.range(-0.10, 0.10));
        let view = look(room, width, height, eye, around, pitch, roll);
        if clearance(room, &view) > least {
            views.push(view);
        }
    }
    views
}

/// Width and depth of a room beside those of the sample room.
fn shares_of_sample(room: &Room) -> [f64; 2] {
    [0, 1].map(|axis| room.size_m[axis] / Room::SIZE_M[axis])
}

/// How a camera that is carried through the room looks around.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Look {
    /// Left and right and up and down, now fast, now slowly.
    Around,
    /// Along the way round, which is a turn without end.
    Ahead,
}

/// Views of a camera that is carried through the room at walking speed (about a metre a second) and turns at up to 60 degrees a
/// second, at an even rate of pictures.
pub fn video_views(
    room: &Room,
    seed: u64,
    fps: f64,
    seconds: f64,
    (width, height): (u32, u32),
    direction: Look,
) -> Vec<View> {
    let phase = Dice::new(seed ^ 0x71DE).range(0.0, core::f64::consts::TAU);
    let count = (fps * seconds).round() as usize;
    let views = (0..count).map(|i| {
        let t = i as f64 / fps;
        // An oval of 1.1 by 0.9 metres in seven seconds.
        let walked = phase + core::f64::consts::TAU * t / 7.0;
        let eye = Vector3::new(
            3.0 + 1.1 * walked.cos(),
            2.45 + 0.9 * walked.sin(),
            // Steps, two a second.
            1.5 + 0.02 * (core::f64::consts::TAU * 2.0 * t).sin(),
        );
        let yaw = match direction {
            // At most 43 and 17 degrees a second together.
            Look::Around => phase + 0.75 * t.sin() + 0.12 * (2.4 * t).sin(),
            // At most 51 and 9.
            Look::Ahead => walked + 0.4 + 0.11 * (1.4 * t).sin(),
        };
        let pitch = -0.08 + 0.09 * (1.1 * t + 1.0).sin();
        let roll = 0.04 * (1.7 * t).sin();
        look(room, width, height, eye, yaw, pitch, roll)
    });
    views.collect()
}

/// Least distance to what is seen at nine pixels.
fn clearance(room: &Room, view: &View) -> f64 {
    let center = view.cam_from_world.center_in_world();
    let mut least = f64::INFINITY;
    for i in 1..4 {
        for j in 1..4 {
            let pixel = Pixel::new(
                f64::from(view.camera.width) * f64::from(i) / 4.0,
                f64::from(view.camera.height) * f64::from(j) / 4.0,
            );
            if let Some(p) = room.point_at(&view.camera, &view.cam_from_world, pixel) {
                least = least.min((p - center).norm());
            }
        }
    }
    least
}

fn look(
    room: &Room,
    width: u32,
    height: u32,
    eye: Vector3<f64>,
    yaw: f64,
    pitch: f64,
    roll: f64,
) -> View {
    let forward = Vector3::new(
        yaw.cos() * pitch.cos(),
        yaw.sin() * pitch.cos(),
        pitch.sin(),
    );
    let level = forward.cross(&Vector3::z()).normalize();
    let down = forward.cross(&level);
    let right = roll.cos() * level + roll.sin() * down;
    let down = forward.cross(&right);
    let rotation = Matrix3::from_rows(&[right.transpose(), down.transpose(), forward.transpose()]);
    let view = View {
        camera: Camera::centered(width, height, 0.82 * f64::from(width)),
        cam_from_world: CamFromWorld::new(rotation, -(rotation * eye)),
    };
    debug_assert!(clearance(room, &view) > 0.0);
    view
}
