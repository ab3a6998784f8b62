//! Landmarks ready for matching: positions in the world, codes as numbers.

use super::LandmarkTable;
use super::code::{CODE_BITS, SignCode, decode};
use super::view::ViewCone;
use crate::math::elementary::cos;
use nalgebra::Vector3;

/// Margin on the cone of views in which a landmark is looked for, radians. A surface looks much alike from 30 degrees beside.
const ANGLE_MARGIN: f64 = 0.5;
/// Factor on the range of distances.
const DISTANCE_MARGIN: f64 = 1.8;

/// From where something can be seen.
#[derive(Debug, Clone, Copy)]
pub(super) struct Visibility {
    direction: Vector3<f64>,
    min_cos: f64,
    near: f64,
    far: f64,
}

impl Visibility {
    fn of(cone: &ViewCone) -> Self {
        let angle = cone.half_angle + ANGLE_MARGIN;
        Self {
            direction: cone.direction,
            min_cos: cos(angle.min(core::f64::consts::PI)),
            near: cone.near / DISTANCE_MARGIN,
            far: cone.far * DISTANCE_MARGIN,
        }
    }

    /// Whether a camera in this direction and distance from the landmark may see it.
    pub(super) fn holds(&self, to_camera: &Vector3<f64>) -> bool {
        let distance = to_camera.norm();
        distance >= self.near
            && distance <= self.far
            && to_camera.dot(&self.direction) >= self.min_cos * distance
    }
}

#[derive(Debug, Clone, Copy)]
pub(super) struct PointLandmark {
    pub(super) point_in_world: Vector3<f64>,
    pub(super) visibility: Visibility,
    pub(super) sigma: f64,
}

#[derive(Debug, Clone, Copy)]
pub(super) struct LineLandmark {
    pub(super) start_in_world: Vector3<f64>,
    pub(super) end_in_world: Vector3<f64>,
    pub(super) visibility: Visibility,
    pub(super) sigma: f64,
}

/// The landmarks of a scene, as frames are matched with them. A quarter of a kilobyte each.
#[derive(Debug, Clone)]
pub struct Landmarks {
    pub(super) points: Vec<PointLandmark>,
    pub(super) point_codes: Vec<[f32; CODE_BITS]>,
    pub(super) point_signs: Vec<u64>,
    pub(super) point_clusters: Vec<[u8; 2]>,
    pub(super) point_code: SignCode,
    pub(super) lines: Vec<LineLandmark>,
    pub(super) line_codes: Vec<[f32; CODE_BITS]>,
    pub(super) line_code: SignCode,
}

impl Landmarks {
    /// From a checked table.
    pub fn new(table: &LandmarkTable) -> Self {
        let grid = &table.grid;
        let cone = |view: &[u8; 3]| ViewCone::decode(*view, grid.step);
        let points = table.point_positions.iter().zip(&table.point_views);
        let lines = table.line_positions.iter().zip(&table.line_views);
        Self {
            points: points
                .map(|(p, view)| {
                    let cone = cone(view);
                    PointLandmark {
                        point_in_world: grid.decode(*p),
                        visibility: Visibility::of(&cone),
                        sigma: cone.sigma,
                    }
                })
                .collect(),
            point_codes: table.point_codes.iter().map(|c| decode(*c)).collect(),
            point_signs: table.point_codes.clone(),
            point_clusters: table.point_clusters.clone(),
            point_code: table.point_code.clone(),
            lines: lines
                .map(|([start, end], view)| {
                    let cone = cone(view);
                    LineLandmark {
                        start_in_world: grid.decode(*start),
                        end_in_world: grid.decode(*end),
                        visibility: Visibility::of(&cone),
                        sigma: cone.sigma,
                    }
                })
                .collect(),
            line_codes: table.line_codes.iter().map(|c| decode(*c)).collect(),
            line_code: table.line_code.clone(),
        }
    }

    /// Numbers in a descriptor.
    pub fn descriptor_channels(&self) -> usize {
        self.point_code.mean.len()
    }

    /// How many points there are.
    pub fn num_points(&self) -> usize {
        self.points.len()
    }

    /// Bytes held.
    pub fn num_bytes(&self) -> usize {
        let code = size_of::<[f32; CODE_BITS]>();
        self.points.len() * (size_of::<PointLandmark>() + code + size_of::<u64>() + 2)
            + self.lines.len() * (size_of::<LineLandmark>() + code)
    }

    /// How many lines there are.
    pub fn num_lines(&self) -> usize {
        self.lines.len()
    }
}
