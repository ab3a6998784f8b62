//! Writes COLMAP sparse models, binary and text side by side, as COLMAP, pycolmap and everything built on them read them.

use landline::formats::colmap_model;
use landline::geometry::{CamFromWorld, Camera, CameraRecord, Pixel};
use nalgebra::Vector3;
use std::fmt::Write as _;
use std::io;
use std::path::Path;

/// The files of a model, in the order of writing.
pub const MODEL_FILES: [&str; 6] = [
    "cameras.bin",
    "images.bin",
    "points3D.bin",
    "cameras.txt",
    "images.txt",
    "points3D.txt",
];

/// A picture of a model.
#[derive(Debug, Clone, PartialEq)]
pub struct WrittenImage {
    /// As the pictures' folder knows it.
    pub name: String,
    /// Index of its camera.
    pub camera: usize,
    /// Its pose.
    pub cam_from_world: CamFromWorld,
    /// Its keypoints, corner-based, with the index of the point that each sees.
    pub keypoints: Vec<(Pixel, Option<usize>)>,
}

/// A point of a model.
#[derive(Debug, Clone, PartialEq)]
pub struct WrittenPoint {
    /// In the model's world.
    pub point_in_world: Vector3<f64>,
    /// Mean reprojection error.
    pub error_px: f64,
    /// Index of the picture, and of the keypoint in it.
    pub observations: Vec<(usize, usize)>,
}

/// Cameras, pictures and points that belong together.
#[derive(Debug, Clone, PartialEq)]
pub struct WrittenModel {
    /// Cameras.
    pub cameras: Vec<Camera>,
    /// Pictures with poses.
    pub images: Vec<WrittenImage>,
    /// Points.
    pub points: Vec<WrittenPoint>,
}

/// Ids in a file count from one.
fn id(index: usize) -> u32 {
    index as u32 + 1
}

/// Points carry no colour.
const GREY: u8 = 128;

impl WrittenModel {
    /// Writes `cameras`, `images` and `points3D`, each as `.bin` and `.txt`. The folder appears whole or not at all.
    ///
    /// # Errors
    /// When something is there already, or the disk refuses.
    pub fn write(&self, folder: &Path) -> io::Result<()> {
        let named =
            |e: io::Error| io::Error::new(e.kind(), format!("writing {}: {e}", folder.display()));
        let mut partial = folder.as_os_str().to_owned();
        partial.push(format!(".{}.partial", std::process::id()));
        let partial = Path::new(&partial);
        let outcome = (|| {
            std::fs::create_dir_all(partial)?;
            let (cameras, images, points) =
                (self.cameras_bin()?, self.images_bin(), self.points_bin());
            let texts = [self.cameras_txt(), self.images_txt(), self.points_txt()];
            let files = [cameras, images, points].into_iter();
            let files = files.chain(texts.map(String::into_bytes));
            for (name, bytes) in MODEL_FILES.iter().zip(files) {
                std::fs::write(partial.join(name), bytes)?;
            }
            // An empty folder may stand there; anything else is refused by the system.
            std::fs::rename(partial, folder)
        })();
        outcome.map_err(|e| {
            // Half a model is of no use to anybody; the first error is the one to report.
            drop(std::fs::remove_dir_all(partial));
            named(e)
        })
    }

    fn cameras_bin(&self) -> io::Result<Vec<u8>> {
        let mut out = Vec::new();
        put_u64(&mut out, self.cameras.len());
        for (i, camera) in self.cameras.iter().enumerate() {
            let model = camera.model.colmap();
            // The reader's table and the writer's are the same.
            if colmap_model(model.id).is_none() {
                return Err(io::Error::other(format!("no COLMAP camera {}", model.name)));
            }
            put_u32(&mut out, id(i));
            put_u32(&mut out, model.id);
            put_u64(&mut out, camera.width as usize);
            put_u64(&mut out, camera.height as usize);
            put_f64(&mut out, &CameraRecord::from_camera(camera).params);
        }
        Ok(out)
    }

    fn images_bin(&self) -> Vec<u8> {
        let mut out = Vec::new();
        put_u64(&mut out, self.images.len());
        for (i, image) in self.images.iter().enumerate() {
            put_u32(&mut out, id(i));
            put_f64(&mut out, &image.cam_from_world.quaternion_wxyz());
            put_f64(&mut out, image.cam_from_world.translation.as_slice());
            put_u32(&mut out, id(image.camera));
            out.extend(image.name.bytes().filter(|b| *b != 0));
            out.push(0);
            put_u64(&mut out, image.keypoints.len());
            for (pixel, point) in &image.keypoints {
                put_f64(&mut out, &[pixel.x, pixel.y]);
                let point = point.map_or(u64::MAX, |p| u64::from(id(p)));
                out.extend(point.to_le_bytes());
            }
        }
        out
    }

    fn points_bin(&self) -> Vec<u8> {
        let mut out = Vec::new();
        put_u64(&mut out, self.points.len());
        for (i, point) in self.points.iter().enumerate() {
            put_u64(&mut out, id(i) as usize);
            put_f64(&mut out, point.point_in_world.as_slice());
            out.extend([GREY; 3]);
            put_f64(&mut out, &[point.error_px]);
            put_u64(&mut out, point.observations.len());
            for (image, keypoint) in &point.observations {
                put_u32(&mut out, id(*image));
                put_u32(&mut out, *keypoint as u32);
            }
        }
        out
    }

    fn cameras_txt(&self) -> String {
        let mut out = "# CAMERA_ID MODEL WIDTH HEIGHT PARAMS...\n".to_owned();
        for (i, camera) in self.cameras.iter().enumerate() {
            let record = CameraRecord::from_camera(camera);
            let params = joined(&record.params);
            let (model, w, h) = (&record.model, record.width, record.height);
            line(&mut out, format_args!("{} {model} {w} {h} {params}", id(i)));
        }
        out
    }

    fn images_txt(&self) -> String {
        let mut out = "# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME\n\
                       # X Y POINT3D_ID, repeatedly\n"
            .to_owned();
        for (i, image) in self.images.iter().enumerate() {
            let (q, t) = (
                joined(&image.cam_from_world.quaternion_wxyz()),
                joined(image.cam_from_world.translation.as_slice()),
            );
            let (camera, name) = (id(image.camera), &image.name);
            line(&mut out, format_args!("{} {q} {t} {camera} {name}", id(i)));
            let seen: Vec<String> = image
                .keypoints
                .iter()
                .map(|(pixel, point)| {
                    let point = point.map_or(-1, |p| i64::from(id(p)));
                    format!("{} {} {point}", pixel.x, pixel.y)
                })
                .collect();
            line(&mut out, format_args!("{}", seen.join(" ")));
        }
        out
    }

    fn points_txt(&self) -> String {
        let mut out =
            "# POINT3D_ID X Y Z R G B ERROR, IMAGE_ID POINT2D_IDX repeatedly\n".to_owned();
        for (i, point) in self.points.iter().enumerate() {
            let place = joined(point.point_in_world.as_slice());
            let track: Vec<String> = point
                .observations
                .iter()
                .map(|(image, keypoint)| format!("{} {keypoint}", id(*image)))
                .collect();
            let (error, track) = (point.error_px, track.join(" "));
            line(
                &mut out,
                format_args!("{} {place} {GREY} {GREY} {GREY} {error} {track}", id(i)),
            );
        }
        out
    }
}

fn put_u32(out: &mut Vec<u8>, value: u32) {
    out.extend(value.to_le_bytes());
}

fn put_u64(out: &mut Vec<u8>, value: usize) {
    out.extend((value as u64).to_le_bytes());
}

fn put_f64(out: &mut Vec<u8>, values: &[f64]) {
    out.extend(values.iter().flat_map(|v| v.to_le_bytes()));
}

fn joined(values: &[f64]) -> String {
    let words: Vec<String> = values.iter().map(ToString::to_string).collect();
    words.join(" ")
}

fn line(out: &mut String, text: std::fmt::Arguments<'_>) {
    // Writing into a string does not fail.
    let _ = writeln!(out, "{text}");
}
