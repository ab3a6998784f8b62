//! Where the pictures come from.

use anyhow::{Context, Result};
use landline::geometry::{CamFromWorld, Camera, Pixel};
use landline_mapper::dataset::DatasetImage;
use landline_mapper::picture;
use landline_testkit::room::{Look, RenderOptions, Room, video_views};
use nalgebra::Vector3;
use std::path::Path;

/// One picture of a video.
#[derive(Debug, Clone)]
pub(crate) struct Picture {
    /// Name of its file.
    pub(crate) name: String,
    /// Rows of three bytes a pixel.
    pub(crate) rgb: Vec<u8>,
    /// Its camera.
    pub(crate) camera: Camera,
    /// True pose, where it is known.
    pub(crate) cam_from_world: Option<CamFromWorld>,
    /// World points behind some pixels, where they are known exactly.
    pub(crate) marks: Vec<Vector3<f64>>,
}

/// Pictures in the order of their taking.
#[derive(Debug, Clone, Default)]
pub(crate) struct Video {
    /// All of them.
    pub(crate) pictures: Vec<Picture>,
}

impl Video {
    /// Reads pictures of a data set.
    ///
    /// # Errors
    /// When a picture cannot be read.
    pub(crate) fn of_images(images: &[&DatasetImage]) -> Result<Self> {
        let mut pictures = Vec::with_capacity(images.len());
        for image in images {
            pictures.push(Picture {
                name: image.name.clone(),
                rgb: picture::read(&image.path)?.into_rgb8().into_raw(),
                camera: image.camera,
                cam_from_world: image.cam_from_world,
                marks: Vec::new(),
            });
        }
        Ok(Self { pictures })
    }

    /// A line for each picture with a true pose: its name, quaternion and translation, camera from world.
    pub(crate) fn pose_list(&self) -> String {
        let posed = |p: &Picture| Some((p.name.clone(), p.cam_from_world?));
        let line = |(name, pose): (String, CamFromWorld)| {
            let [w, x, y, z] = pose.quaternion_wxyz();
            let t = pose.translation;
            format!("{name} {w} {x} {y} {z} {} {} {}\n", t.x, t.y, t.z)
        };
        self.pictures.iter().filter_map(posed).map(line).collect()
    }

    /// The same picture again and again with fresh sensor noise of a standard deviation in grey levels.
    #[must_use]
    pub(crate) fn still(&self, frame: usize, count: usize, noise_levels: f64) -> Self {
        let mut rng = landline::math::Rng::from_seed(frame as u64);
        let first = &self.pictures[frame];
        let noisy = |_| Picture {
            rgb: first
                .rgb
                .iter()
                .map(|v| {
                    (f64::from(*v) + noise_levels * rng.normal())
                        .round()
                        .clamp(0.0, 255.0) as u8
                })
                .collect(),
            ..first.clone()
        };
        Self {
            pictures: (0..count).map(noisy).collect(),
        }
    }
}

/// Marks of a rendered frame, across and down.
const GRID: (u32, u32) = (6, 5);

/// A walk through the rendered room, kept in a folder once it is made.
///
/// # Errors
/// When the folder cannot be read or written.
pub(crate) fn rendered(
    seed: u64,
    look: Look,
    fps: f64,
    seconds: f64,
    folder: &Path,
    mut done: impl FnMut(),
) -> Result<Video> {
    std::fs::create_dir_all(folder).with_context(|| format!("making {}", folder.display()))?;
    let room = Room::new(seed);
    let views = video_views(&room, seed, fps, seconds, (640, 480), look);
    let mut pictures = Vec::with_capacity(views.len());
    for (i, view) in views.iter().enumerate() {
        let name = format!("{look:?}-{seed}-{fps}-{i:04}.png").to_lowercase();
        let path = folder.join(&name);
        let rgb = if path.exists() {
            picture::read(&path)?.into_rgb8().into_raw()
        } else {
            let options = RenderOptions {
                supersampling: 2,
                noise_levels: 2.0,
                seed: i as u64,
                ..RenderOptions::default()
            };
            let rgb = room
                .render(&view.camera, &view.cam_from_world, &options)
                .rgb;
            let (width, height) = (view.camera.width, view.camera.height);
            let image = image::RgbImage::from_raw(width, height, rgb.clone())
                .context("the picture has its size")?;
            picture::write_png(&image, &path)?;
            rgb
        };
        let cell = |i: u32, n: u32, len: u32| f64::from(len) * (f64::from(i) + 0.5) / f64::from(n);
        let marks = (0..GRID.0 * GRID.1)
            .filter_map(|k| {
                let x = cell(k % GRID.0, GRID.0, view.camera.width);
                let y = cell(k / GRID.0, GRID.1, view.camera.height);
                room.point_at(&view.camera, &view.cam_from_world, Pixel::new(x, y))
            })
            .collect();
        pictures.push(Picture {
            name,
            rgb,
            camera: view.camera,
            cam_from_world: Some(view.cam_from_world),
            marks,
        });
        done();
    }
    Ok(Video { pictures })
}
