//! The localised keyframe: its picture, and the points and lines of the world that are looked for in later ones.

use super::TrackerOptions;
use super::edge::{self, Piece};
use super::patch::{Affine, IDENTITY, Template};
use super::pyramid::Pyramid;
use crate::geometry::{CamFromWorld, Camera, Pixel};
use crate::pose::{LineCorrespondence, PointCorrespondence};
use crate::simd::Level;
use core::cmp::Ordering;
use nalgebra::{Matrix6, Vector3};

/// From a point to its neighbours that tell how the picture around it is distorted, in pixels.
const NEIGHBOUR_PX: f64 = 4.0;
/// Points that are kept for every one that is looked for: while the camera turns away, those of the part that both pictures show
/// take the places of those that have left.
const RESERVE: usize = 3;
/// Cells of the picture that share the points among them, along its longer and its shorter side.
const CELLS: (usize, usize) = (10, 8);

/// Position in index coordinates of the working picture.
pub(super) fn index_coordinates(pixel: Pixel) -> [f32; 2] {
    [(pixel.x - 0.5) as f32, (pixel.y - 0.5) as f32]
}

/// The inverse of [`index_coordinates`].
pub(super) fn pixel_at([x, y]: [f32; 2]) -> Pixel {
    Pixel::from_index_coordinates(f64::from(x), f64::from(y))
}

/// A point of the world with its look.
#[derive(Debug, Default)]
pub(super) struct TrackedPoint {
    /// Lies exactly on the ray of its pixel in the reference.
    pub(super) in_world: Vector3<f64>,
    /// One pixel position to the right and one below, as deep as the point itself.
    neighbours_in_world: [Vector3<f64>; 2],
    center: [f32; 2],
    pub(super) template: Template,
    /// Whether the template can be used as it was made last.
    is_made: bool,
}

/// A segment of the world with its step of grey levels.
#[derive(Debug, Clone, Copy)]
pub(super) struct TrackedLine {
    pub(super) ends_in_world: [Vector3<f64>; 2],
    pub(super) strength: f32,
}

/// A candidate of the selection.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    source: usize,
    cell: usize,
    /// How well it can be tracked.
    worth: f32,
}

/// Cell by cell, the best of each first.
fn in_cell_by_worth(a: &Candidate, b: &Candidate) -> Ordering {
    let by_worth = a.cell.cmp(&b.cell).then(b.worth.total_cmp(&a.worth));
    by_worth.then(a.source.cmp(&b.source))
}

/// The keyframe.
#[derive(Debug, Default)]
pub(super) struct Reference {
    pub(super) pyramid: Pyramid,
    pub(super) cam_from_world: Option<CamFromWorld>,
    pub(super) covariance: Matrix6<f64>,
    /// Of the working picture.
    pub(super) camera: Option<Camera>,
    /// The first `num_points` are in use; the rest keep their memory.
    points: Vec<TrackedPoint>,
    num_points: usize,
    num_checked: usize,
    pub(super) lines: Vec<TrackedLine>,
    candidates: Vec<Candidate>,
    taken: Vec<usize>,
}

impl Reference {
    /// Takes what a localisation found in a frame. Pixels are those of the working picture.
    #[allow(
        clippy::too_many_arguments,
        reason = "one answer, whose parts its caller has apart"
    )]
    pub(super) fn fill(
        &mut self,
        pyramid: &Pyramid,
        camera: &Camera,
        cam_from_world: &CamFromWorld,
        covariance: &Matrix6<f64>,
        points: &[PointCorrespondence],
        lines: &[LineCorrespondence],
        options: &TrackerOptions,
    ) {
        self.pyramid.copy_from(pyramid);
        self.camera = Some(*camera);
        self.cam_from_world = Some(*cam_from_world);
        self.covariance = *covariance;
        self.select(points, RESERVE * options.max_points);
        (self.num_points, self.num_checked) = (0, 0);
        for i in 0..self.taken.len() {
            let point = &points[self.taken[i]];
            // Templates of the reserve are made when they are needed.
            let vectors = (i < options.max_points).then_some(options.kernels);
            self.add_point(point, camera, cam_from_world, vectors);
        }
        self.lines.clear();
        for line in lines {
            if self.lines.len() < options.max_lines {
                self.add_line(line, camera, cam_from_world);
            }
        }
    }

    pub(super) fn points(&mut self) -> (&mut [TrackedPoint], &Pyramid) {
        (&mut self.points[..self.num_points], &self.pyramid)
    }

    /// Points, those of the reserve among them.
    pub(super) fn num_points(&self) -> usize {
        self.num_points
    }

    /// Points that have a template for certain.
    pub(super) fn num_checked(&self) -> usize {
        self.num_checked
    }

    pub(super) fn worlds(&self) -> impl Iterator<Item = &Vector3<f64>> {
        self.points[..self.num_points].iter().map(|p| &p.in_world)
    }

    /// Chooses points with much structure, spread over the picture: round after round the best of each cell.
    fn select(&mut self, points: &[PointCorrespondence], max: usize) {
        let image = self.pyramid.level(0).view();
        let (across, down) = if image.width >= image.height {
            CELLS
        } else {
            (CELLS.1, CELLS.0)
        };
        self.candidates.clear();
        for (source, point) in points.iter().enumerate() {
            let [x, y] = index_coordinates(point.pixel);
            let inside = x >= 12.0
                && y >= 12.0
                && x < image.width as f32 - 13.0
                && y < image.height as f32 - 13.0;
            if !inside {
                continue;
            }
            let cell =
                (y as usize * down / image.height) * across + x as usize * across / image.width;
            let worth = structure(&self.pyramid, [x, y]) * point.confidence.max(0.05);
            if worth > 0.0 {
                self.candidates.push(Candidate {
                    source,
                    cell,
                    worth,
                });
            }
        }
        self.candidates.sort_unstable_by(in_cell_by_worth);
        // The rank within its cell decides, then the worth.
        let mut rank = 0;
        let mut last_cell = usize::MAX;
        for candidate in &mut self.candidates {
            rank = if candidate.cell == last_cell {
                rank + 1
            } else {
                0
            };
            last_cell = candidate.cell;
            candidate.cell = rank;
        }
        self.candidates.sort_unstable_by(in_cell_by_worth);
        self.taken.clear();
        self.taken
            .extend(self.candidates.iter().take(max).map(|c| c.source));
    }

    fn add_point(
        &mut self,
        point: &PointCorrespondence,
        camera: &Camera,
        cam_from_world: &CamFromWorld,
        vectors: Option<Level>,
    ) {
        let depth = cam_from_world.transform_point(&point.point_in_world).z;
        // On whole pixels the template needs no interpolation; which point of the surface is tracked does not matter.
        let snapped = Pixel::new(libm::round(point.pixel.x), libm::round(point.pixel.y));
        let world_from_cam = cam_from_world.inverse();
        let at = |pixel: Pixel| -> Option<Vector3<f64>> {
            let bearing = camera.bearing_from_pixel(pixel)?;
            (bearing.z > 0.05 && depth > 0.0)
                .then(|| world_from_cam.transform_point(&(bearing * (depth / bearing.z))))
        };
        let right = Pixel::new(snapped.x + NEIGHBOUR_PX, snapped.y);
        let below = Pixel::new(snapped.x, snapped.y + NEIGHBOUR_PX);
        let (Some(in_world), Some(right), Some(below)) = (at(snapped), at(right), at(below)) else {
            return;
        };
        if self.points.len() == self.num_points {
            self.points.push(TrackedPoint::default());
        }
        let slot = &mut self.points[self.num_points];
        slot.in_world = in_world;
        slot.neighbours_in_world = [right, below];
        slot.center = index_coordinates(snapped);
        slot.is_made = false;
        if let Some(vectors) = vectors {
            slot.is_made = slot
                .template
                .make(&self.pyramid, slot.center, IDENTITY, vectors);
            if !slot.is_made {
                return;
            }
            self.num_checked += 1;
        }
        self.num_points += 1;
    }

    fn add_line(
        &mut self,
        line: &LineCorrespondence,
        camera: &Camera,
        cam_from_world: &CamFromWorld,
    ) {
        let near = Piece {
            start: index_coordinates(line.start),
            end: index_coordinates(line.end),
        };
        let Some((found, strength)) = edge::find(&self.pyramid.level(0).view(), &near, None) else {
            return;
        };
        let world_from_cam = cam_from_world.inverse();
        // The plane through the camera and the edge; the ends move into it along their own depth.
        let through = |p: [f32; 2]| camera.bearing_from_pixel(pixel_at(p));
        let (Some(a), Some(b)) = (through(found.start), through(found.end)) else {
            return;
        };
        let normal = a.cross(&b);
        let size = normal.x * normal.x + normal.y * normal.y;
        if !(size > 0.0) {
            return;
        }
        let anchored = [line.start_in_world, line.end_in_world].map(|end| {
            let p = cam_from_world.transform_point(&end);
            // Shortest way at the same depth.
            let off = normal.dot(&p) / size;
            let moved = Vector3::new(p.x - off * normal.x, p.y - off * normal.y, p.z);
            (p.z > 0.0).then(|| world_from_cam.transform_point(&moved))
        });
        if let [Some(start), Some(end)] = anchored {
            self.lines.push(TrackedLine {
                ends_in_world: [start, end],
                strength,
            });
        }
    }
}

impl TrackedPoint {
    /// Where the point should be in a picture; its template is made anew when the picture around it looks too different.
    pub(super) fn expect(
        &mut self,
        reference: &Pyramid,
        camera: &Camera,
        cam_from_world: &CamFromWorld,
        max_warp: f32,
        vectors: Level,
    ) -> Option<[f32; 2]> {
        let project = |p: &Vector3<f64>| camera.pixel_from_cam(&cam_from_world.transform_point(p));
        let at = project(&self.in_world)?;
        let [right, below] = [
            project(&self.neighbours_in_world[0])?,
            project(&self.neighbours_in_world[1])?,
        ];
        let column = |p: Pixel| [(p.x - at.x) / NEIGHBOUR_PX, (p.y - at.y) / NEIGHBOUR_PX];
        let ([xx, yx], [xy, yy]) = (column(right), column(below));
        let determinant = xx * yy - xy * yx;
        // Twice as near or as far as in the reference, or seen edgewise, a patch is not the same any more.
        if !(determinant > 0.2 && determinant < 5.0) {
            return None;
        }
        let affine: Affine = [yy, -xy, -yx, xx].map(|v| (v / determinant) as f32);
        if !self.is_made || self.template.warped_by(&affine) > max_warp {
            self.is_made = self.template.make(reference, self.center, affine, vectors);
        }
        self.is_made.then(|| index_coordinates(at))
    }
}

/// Sum of the smaller eigenvalue of the gradients around a position: cheap, for the choice of points.
fn structure(pyramid: &Pyramid, [x, y]: [f32; 2]) -> f32 {
    let image = pyramid.level(0).view();
    let (column, row) = (x as usize, y as usize);
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for v in row - 6..row + 7 {
        for u in column - 6..column + 7 {
            let at = |u: usize, v: usize| f32::from(image.data[v * image.stride + u]);
            let across = at(u + 1, v) - at(u - 1, v);
            let down = at(u, v + 1) - at(u, v - 1);
            xx += across * across;
            xy += across * down;
            yy += down * down;
        }
    }
    let half = 0.5 * (xx - yy);
    (0.5 * (xx + yy) - (half * half + xy * xy).sqrt())
        .max(0.0)
        .sqrt()
}
