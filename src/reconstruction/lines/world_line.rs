//! Infinite lines in the world: from planes through segments, projected into views, measured against segments.

use super::super::{LineTrack, PosedView};
use nalgebra::{Matrix3, Vector2, Vector3};

/// An infinite line in the world.
#[derive(Debug, Clone, Copy)]
pub(super) struct WorldLine {
    pub(super) point: Vector3<f64>,
    pub(super) direction: Vector3<f64>,
}

impl WorldLine {
    /// Where two planes cut each other, with the sine of their angle.
    pub(super) fn from_planes(a: &SegmentPlane, b: &SegmentPlane) -> Option<(Self, f64)> {
        let cross = a.normal.cross(&b.normal);
        let sin = cross.norm();
        if !(sin > 1e-9) {
            return None;
        }
        let direction = cross / sin;
        // The point of both planes that is nearest to the middle of the two cameras.
        let middle = 0.5 * (a.center + b.center);
        let rows = Matrix3::from_rows(&[
            a.normal.transpose(),
            b.normal.transpose(),
            direction.transpose(),
        ]);
        let right = Vector3::new(
            a.normal.dot(&a.center),
            b.normal.dot(&b.center),
            direction.dot(&middle),
        );
        let point = rows.lu().solve(&right)?;
        Some((Self { point, direction }, sin))
    }

    /// The place on this line nearest to a ray, as a distance along the direction.
    pub(super) fn nearest_to_ray(&self, origin: &Vector3<f64>, ray: &Vector3<f64>) -> Option<f64> {
        let between = origin - self.point;
        let cos = self.direction.dot(ray);
        let det = 1.0 - cos * cos;
        if !(det > 1e-9) {
            return None;
        }
        Some((between.dot(&self.direction) - cos * between.dot(ray)) / det)
    }
}

/// The plane through a camera and a segment that it sees.
#[derive(Debug, Clone, Copy)]
pub(super) struct SegmentPlane {
    pub(super) center: Vector3<f64>,
    pub(super) normal: Vector3<f64>,
}

pub(super) fn segment_plane(view: &PosedView<'_>, segment: usize) -> Option<SegmentPlane> {
    let ends = view.segment_ends.get(segment)?;
    let a = view.ray_through(&ends[0]);
    let b = view.ray_through(&ends[1]);
    let normal = a.direction.cross(&b.direction).try_normalize(1e-9)?;
    Some(SegmentPlane {
        center: view.center_in_world,
        normal,
    })
}

/// Whether the line lies in front of a view, at a believable depth, where the segment is.
pub(super) fn lies_in_front(
    view: &PosedView<'_>,
    line: &WorldLine,
    ends: &[Vector2<f64>; 2],
    depth: f64,
) -> bool {
    ends.iter().all(|end| {
        let ray = view.ray_through(end);
        line.nearest_to_ray(&ray.origin, &ray.direction)
            .map(|s| line.point + s * line.direction)
            .is_some_and(|p| {
                let z = view.cam_from_world.transform_point(&p).z;
                z > 0.05 * depth && z < 10.0 * depth
            })
    })
}

/// Largest distance in pixels of a segment's ends from the projected line; infinite when the line is not in view.
pub(super) fn line_error_px(view: &PosedView<'_>, segment: usize, line: &WorldLine) -> f64 {
    let Some(ends) = view.segment_ends.get(segment) else {
        return f64::INFINITY;
    };
    let Some(image_line) = project(view, line) else {
        return f64::INFINITY;
    };
    ends.iter()
        .map(|p| image_line.dot(&p.push(1.0)).abs() * view.focal_px)
        .fold(0.0, f64::max)
}

/// The line on the plane z = 1, with a unit normal.
pub(super) fn project(view: &PosedView<'_>, line: &WorldLine) -> Option<Vector3<f64>> {
    let p = view.cam_from_world.transform_point(&line.point);
    let d = view.cam_from_world.rotation * line.direction;
    let normal = p.cross(&d);
    let norm = normal.xy().norm();
    (norm > 1e-12).then(|| normal / norm)
}

/// Range along the line that a segment covers.
pub(super) fn covered(
    view: &PosedView<'_>,
    segment: usize,
    line: &WorldLine,
) -> Option<(f64, f64)> {
    let ends = view.segment_ends.get(segment)?;
    let mut range = [0.0; 2];
    for (value, end) in range.iter_mut().zip(ends) {
        let ray = view.ray_through(end);
        *value = line.nearest_to_ray(&ray.origin, &ray.direction)?;
        let z = view
            .cam_from_world
            .transform_point(&(line.point + *value * line.direction))
            .z;
        if !(z > 0.0) {
            return None;
        }
    }
    Some((range[0].min(range[1]), range[0].max(range[1])))
}

pub(super) fn line_of(track: &LineTrack) -> Option<WorldLine> {
    line_through(&track.start_in_world, &track.end_in_world)
}

pub(super) fn line_through(start: &Vector3<f64>, end: &Vector3<f64>) -> Option<WorldLine> {
    let direction = (end - start).try_normalize(1e-9)?;
    Some(WorldLine {
        point: *start,
        direction,
    })
}
