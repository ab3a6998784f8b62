//! Training pictures as flat rows: descriptors, cameras, observations and targets, in centred world coordinates (the
//! scene's centre subtracted, metres as the losses have them).

use super::loss::ObservationRows;
use crate::labels::Labelled;
use landline::geometry::SceneScale;
use landline::math::Rng;
use landline::reconstruction::Reconstruction;
use nalgebra::Vector3;

/// Which features.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// Keypoints.
    Points,
    /// Segments.
    Segments,
}

struct CameraRow {
    rotation: [f32; 9],
    translation: [f32; 3],
    focal_px: f32,
    first_row: usize,
    num_rows: usize,
}

/// All rows of one kind.
pub struct Buffer<'a> {
    kind: Kind,
    input_len: usize,
    images: Vec<Labelled<'a>>,
    cameras: Vec<CameraRow>,
    /// Image of each row.
    image_of_row: Vec<u32>,
    /// Observed ray or line of each row.
    observed: Vec<f32>,
    /// Centred target of each row; zeros without one.
    targets: Vec<f32>,
    /// Track of each row, -1 without one.
    tracks: Vec<i32>,
}

/// Rows of a batch, on the host.
#[derive(Debug, Clone, Default)]
pub struct Batch {
    /// Network inputs, row after row.
    pub inputs: Vec<f32>,
    /// Centred targets in metres: 3 or 6 a row.
    pub targets: Vec<f32>,
    /// 1 where there is a target.
    pub has_target: Vec<f32>,
    /// 0 for rows that only fill up an image.
    pub is_real: Vec<f32>,
    /// Cameras and observations.
    pub observations: ObservationRows,
}

impl Batch {
    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.has_target.len()
    }
}

impl<'a> Buffer<'a> {
    /// All rows of these pictures of a map. Features whose ray cannot be computed are left out, and pictures without a pose.
    pub fn new(
        kind: Kind,
        map: &Reconstruction,
        images: impl IntoIterator<Item = Labelled<'a>>,
        scale: &SceneScale,
    ) -> Self {
        let descriptor = map.descriptor_channels();
        let mut buffer = Self {
            kind,
            input_len: match kind {
                Kind::Points => descriptor,
                Kind::Segments => descriptor * map.tokens(),
            },
            images: Vec::new(),
            cameras: Vec::new(),
            image_of_row: Vec::new(),
            observed: Vec::new(),
            targets: Vec::new(),
            tracks: Vec::new(),
        };
        for image in images {
            buffer.push(map, image, scale);
        }
        buffer
    }

    fn push(&mut self, map: &Reconstruction, image: Labelled<'a>, scale: &SceneScale) {
        let camera = &image.view.camera;
        let Some(cam_from_world) = image.view.cam_from_world else {
            return;
        };
        let (fx, fy) = camera.focal_px();
        let metre = scale.nominal_metre(map.units);
        let centred = cam_from_world.transform_point(&scale.centre) / metre;
        let mut rotation = [0.0; 9];
        for (i, v) in rotation.iter_mut().enumerate() {
            *v = cam_from_world.rotation[(i / 3, i % 3)] as f32;
        }
        let first_row = self.image_of_row.len();
        let image_idx = self.images.len() as u32;
        let nothing = [f32::NAN; 3];
        let ray = |p| {
            let b = camera.bearing_from_pixel(p)?;
            (b.z > 1e-3).then(|| Vector3::new(b.x / b.z, b.y / b.z, 1.0))
        };
        match self.kind {
            Kind::Points => {
                let keypoints = &image.features.keypoints;
                for (keypoint, target) in keypoints.iter().zip(&image.targets.points) {
                    let seen =
                        ray(keypoint.pixel).map_or(nothing, |r| [r.x as f32, r.y as f32, 1.0]);
                    self.observed.extend(&seen[..2]);
                    let track = target.and_then(|t| map.points.get(t as usize).map(|p| (t, p)));
                    let point = track.map_or(Vector3::zeros(), |(_, p)| {
                        (p.point_in_world - scale.centre) / metre
                    });
                    self.targets.extend(point.iter().map(|v| *v as f32));
                    let usable = track.filter(|_| seen[0].is_finite());
                    self.tracks.push(usable.map_or(-1, |(t, _)| t as i32));
                }
            }
            Kind::Segments => {
                let segments = &image.features.segments;
                for (segment, target) in segments.iter().zip(&image.targets.segments) {
                    let line = ray(segment.start).zip(ray(segment.end)).and_then(|(a, b)| {
                        let n = a.cross(&b);
                        let length = n.x.hypot(n.y);
                        (length > 1e-12).then(|| n / length)
                    });
                    let seen = line.map_or(nothing, |n| [n.x as f32, n.y as f32, n.z as f32]);
                    self.observed.extend(seen);
                    let ends = target.and_then(|t| map.segment_target_ends(t));
                    for i in 0..2 {
                        let end = ends.map_or(Vector3::zeros(), |e| (e[i] - scale.centre) / metre);
                        self.targets.extend(end.iter().map(|v| *v as f32));
                    }
                    let usable = target.filter(|_| seen[0].is_finite() && ends.is_some());
                    self.tracks.push(usable.map_or(-1, |t| t.track as i32));
                }
            }
        }
        let num_rows = self.tracks.len() - first_row;
        self.image_of_row
            .extend(core::iter::repeat_n(image_idx, num_rows));
        self.cameras.push(CameraRow {
            rotation,
            translation: [centred.x as f32, centred.y as f32, centred.z as f32],
            focal_px: (0.5 * (fx + fy)) as f32,
            first_row,
            num_rows,
        });
        self.images.push(image);
    }

    /// Number of rows.
    pub fn num_rows(&self) -> usize {
        self.tracks.len()
    }

    /// Number of images.
    pub fn num_images(&self) -> usize {
        self.images.len()
    }

    /// Rows of an image.
    pub fn image_rows(&self, image: usize) -> core::ops::Range<usize> {
        let camera = &self.cameras[image];
        camera.first_row..camera.first_row + camera.num_rows
    }

    /// Numbers of a network input.
    pub fn input_len(&self) -> usize {
        self.input_len
    }

    fn target_len(&self) -> usize {
        match self.kind {
            Kind::Points => 3,
            Kind::Segments => 6,
        }
    }

    fn observed_len(&self) -> usize {
        match self.kind {
            Kind::Points => 2,
            Kind::Segments => 3,
        }
    }

    /// Network input of a row.
    pub fn input(&self, row: usize) -> &[f32] {
        let image = self.image_of_row[row] as usize;
        let at = (row - self.cameras[image].first_row) * self.input_len;
        let all = match self.kind {
            Kind::Points => &self.images[image].features.descriptors_nd,
            Kind::Segments => &self.images[image].features.segment_descriptors_nsd,
        };
        &all[at..at + self.input_len]
    }

    /// Track of a row.
    pub fn track(&self, row: usize) -> Option<usize> {
        usize::try_from(self.tracks[row]).ok()
    }

    fn put(&self, batch: &mut Batch, row: usize) {
        batch.inputs.extend_from_slice(self.input(row));
        let (t, o) = (self.target_len(), self.observed_len());
        batch
            .targets
            .extend_from_slice(&self.targets[row * t..(row + 1) * t]);
        batch
            .has_target
            .push(if self.tracks[row] >= 0 { 1.0 } else { 0.0 });
        let observed = &self.observed[row * o..(row + 1) * o];
        let is_real = observed[0].is_finite();
        batch.is_real.push(if is_real { 1.0 } else { 0.0 });
        let rows = &mut batch.observations;
        rows.observed
            .extend(observed.iter().map(|v| if is_real { *v } else { 0.0 }));
        let camera = &self.cameras[self.image_of_row[row] as usize];
        rows.rotation.extend_from_slice(&camera.rotation);
        rows.translation.extend_from_slice(&camera.translation);
        rows.focal_px.push(camera.focal_px);
    }

    fn put_filler(&self, batch: &mut Batch) {
        batch
            .inputs
            .extend(core::iter::repeat_n(0.0, self.input_len));
        batch
            .targets
            .extend(core::iter::repeat_n(0.0, self.target_len()));
        batch.has_target.push(0.0);
        batch.is_real.push(0.0);
        let rows = &mut batch.observations;
        rows.observed
            .extend(core::iter::repeat_n(0.0, self.observed_len()));
        rows.rotation
            .extend([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
        rows.translation.extend([0.0, 0.0, 1.0]);
        rows.focal_px.push(1.0);
    }

    /// These rows in this order.
    pub fn rows(&self, rows: impl IntoIterator<Item = usize>) -> Batch {
        let mut batch = Batch::default();
        for row in rows {
            self.put(&mut batch, row);
        }
        batch
    }

    /// Rows drawn from all images.
    pub fn draw_rows(&self, count: usize, rng: &mut Rng) -> Batch {
        let n = self.num_rows() as u32;
        self.rows((0..count).map(|_| rng.below(n) as usize))
    }

    /// `per_image` rows of each of `count` images drawn at random; images with fewer are filled up.
    pub fn draw_images(&self, count: usize, per_image: usize, rng: &mut Rng) -> Batch {
        let mut batch = Batch::default();
        for _ in 0..count {
            let image = rng.below(self.num_images() as u32) as usize;
            let mut rows: Vec<usize> = self.image_rows(image).collect();
            let take = per_image.min(rows.len());
            for i in 0..take {
                let j = i + rng.below((rows.len() - i) as u32) as usize;
                rows.swap(i, j);
                self.put(&mut batch, rows[i]);
            }
            for _ in take..per_image {
                self.put_filler(&mut batch);
            }
        }
        batch
    }
}

impl Batch {
    /// Adds Gaussian noise to every descriptor of `descriptor` numbers, then makes points unit again.
    pub fn disturb(&mut self, kind: Kind, descriptor: usize, sigma: f64, rng: &mut Rng) {
        if sigma <= 0.0 {
            return;
        }
        for d in self.inputs.chunks_exact_mut(descriptor) {
            let mut sum = 0.0f32;
            for v in d.iter_mut() {
                *v += (sigma * rng.normal()) as f32;
                sum += *v * *v;
            }
            if kind == Kind::Points {
                let inverse = 1.0 / sum.sqrt().max(1e-12);
                for v in d.iter_mut() {
                    *v *= inverse;
                }
            }
        }
    }
}
