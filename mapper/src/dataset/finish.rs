//! What every format has in common: pictures are there and fit their cameras, names are unique, the split is applied.

use super::args::DataArgs;
use super::{Dataset, DatasetError, Undecided, limap, split, world};
use crate::picture;
use landline::geometry::{CamFromWorld, Camera, Pixel, PixelMap};
use std::collections::{HashMap, HashSet};

/// Checks and completes what a reader delivered.
pub(super) fn finish(dataset: &mut Dataset, args: &DataArgs) -> Result<(), DatasetError> {
    let mut sorted: Vec<_> = std::mem::take(&mut dataset.images)
        .into_iter()
        .enumerate()
        .collect();
    sorted.sort_by(|a, b| a.1.name.cmp(&b.1.name).then(a.0.cmp(&b.0)));
    let mut seen: HashSet<String> = HashSet::new();
    let mut kept = Vec::with_capacity(sorted.len());
    let mut position_of: HashMap<usize, usize> = HashMap::new();
    let mut fits: Vec<Fit> = Vec::new();
    let stored_cameras = std::mem::take(&mut dataset.stored_cameras);
    for (before, mut image) in sorted {
        if !seen.insert(image.name.clone()) {
            dataset.drop_image(image.name, "name appears twice");
            continue;
        }
        match picture::size(&image.path) {
            Err(e) => {
                dataset.drop_image(image.name, format!("picture cannot be read: {}", e.short()));
                continue;
            }
            Ok(size) => {
                let as_stored = stored_cameras
                    .get(&image.name)
                    .map(|camera| (*camera, image.cam_from_world));
                let fitted = fit_to_picture(&mut image.camera, &mut image.cam_from_world, &size)
                    .and_then(|fit| {
                        let told = image.camera.check_plausible();
                        told.map(|()| fit).map_err(|e| e.to_string())
                    });
                match fitted {
                    Ok(fit) => {
                        dataset.note_once(fit.note());
                        fits.push(fit);
                    }
                    Err(reason) => {
                        dataset.drop_image(image.name, reason);
                        continue;
                    }
                }
                if let Some((mut camera, mut cam_from_world)) = as_stored
                    && fit_to_picture(&mut camera, &mut cam_from_world, &size).is_ok()
                {
                    dataset.undecided.push(Undecided {
                        image: kept.len(),
                        camera,
                        cam_from_world,
                    });
                }
            }
        }
        position_of.insert(before, kept.len());
        kept.push(image);
    }
    dataset.images = kept;
    // Points of a model keep up with the pictures: positions after sorting, pixels of the picture as used.
    for point in &mut dataset.points {
        point.observations = point
            .observations
            .iter()
            .filter_map(|(before, pixel)| {
                let position = *position_of.get(before)?;
                Some((position, fits.get(position)?.apply(*pixel)))
            })
            .collect();
    }
    dataset.points.retain(|p| p.observations.len() >= 2);
    if dataset.images.is_empty() {
        return Err(DatasetError::NoPictures {
            path: args.data.clone(),
            what: why_none(dataset),
        });
    }
    if let Some(folder) = &args.lines {
        limap::read_into(folder, dataset)?;
    }
    world::apply(dataset, args)?;
    if let Some(list) = &args.test_list {
        return split::apply_list(list, dataset);
    }
    split::apply(dataset, args.train.as_ref(), args.test.as_ref())
}

/// What became of a data set without a usable picture: counts of the reasons with a name each, and the remarks.
fn why_none(dataset: &Dataset) -> String {
    let mut counts: Vec<(&str, &str, usize)> = Vec::new();
    for d in &dataset.dropped {
        match counts.iter_mut().find(|(reason, ..)| *reason == d.reason) {
            Some((.., n)) => *n += 1,
            None => counts.push((&d.reason, &d.name, 1)),
        }
    }
    if counts.is_empty() {
        return "the list is empty".to_owned();
    }
    let mut parts: Vec<String> = counts
        .iter()
        .map(|(reason, name, n)| match n {
            1 => format!("1 x {reason} ({name})"),
            _ => format!("{n} x {reason} ({name}, ...)"),
        })
        .collect();
    parts.extend(dataset.notes.iter().cloned());
    parts.join("; ")
}

/// The upright picture, and the one whose size the camera states.
enum Upright {}
enum Stated {}

/// What was done so that a camera fits its picture.
#[derive(Debug, Clone, Copy)]
struct Fit {
    /// Picture size by camera size, before turning.
    scale: (f64, f64),
    /// Width and height after scaling, before turning.
    size: (u32, u32),
    /// Clockwise quarter turns after scaling.
    turns: u8,
}

impl Fit {
    /// Where a pixel of the camera's picture lies in the picture as used.
    fn apply(&self, pixel: Pixel) -> Pixel {
        let mut pixel = Pixel::new(pixel.x * self.scale.0, pixel.y * self.scale.1);
        let (mut width, mut height) = (f64::from(self.size.0), f64::from(self.size.1));
        for _ in 0..self.turns {
            pixel = Pixel::new(height - pixel.y, pixel.x);
            (width, height) = (height, width);
        }
        pixel
    }

    /// For the table.
    fn note(&self) -> Option<String> {
        let turned = "EXIF-rotated pictures: turned upright, their cameras and poses with them";
        let scaled = format!(
            "pictures are {:.4} times the size that their cameras state: cameras scaled",
            self.scale.0
        );
        match (self.turns, self.scale == (1.0, 1.0)) {
            (0, true) => None,
            (_, true) => Some(turned.to_owned()),
            (0, false) => Some(scaled),
            (_, false) => Some(format!("{turned}; {scaled}")),
        }
    }
}

/// Makes camera and pose those of the upright picture.
///
/// Structure-from-motion tools work on the pixels as stored; pictures are used upright here, because descriptors do not
/// survive a quarter turn. So where the camera's size is that of the stored pixels, camera and pose are turned along.
fn fit_to_picture(
    camera: &mut Camera,
    cam_from_world: &mut Option<CamFromWorld>,
    size: &picture::Size,
) -> Result<Fit, String> {
    if size.is_mirrored {
        return Err("EXIF says that the picture is mirrored".to_owned());
    }
    let stated = (camera.width, camera.height);
    let turned = (size.quarter_turns != 0)
        .then(|| scale_to(stated, size.stored))
        .flatten()
        .map(|scale| (scale, size.stored, size.quarter_turns));
    let (scale, size, turns) = turned
        .or_else(|| scale_to(stated, size.upright).map(|scale| (scale, size.upright, 0)))
        .ok_or("picture and camera differ in aspect")?;
    if scale != (1.0, 1.0) {
        let map: PixelMap<Upright, Stated> = PixelMap::from_scale(scale.0, scale.1);
        *camera = camera.resized(&map);
    }
    for _ in 0..turns {
        let (turned, turn) = camera.turned_clockwise();
        *camera = turned;
        *cam_from_world =
            cam_from_world.map(|t| CamFromWorld::new(turn * t.rotation, turn * t.translation));
    }
    Ok(Fit { scale, size, turns })
}

/// Factors from one size to another of the same picture: a picture that was shrunk keeps its content, up to the rounding of
/// one pixel. `None` when it was cropped or turned.
fn scale_to(from: (u32, u32), to: (u32, u32)) -> Option<(f64, f64)> {
    let sx = f64::from(to.0) / f64::from(from.0);
    let sy = f64::from(to.1) / f64::from(from.1);
    ((sx / sy - 1.0).abs() * f64::from(to.0.max(to.1)) <= 1.0).then_some((sx, sy))
}

#[cfg(test)]
mod tests {
    use super::*;
    use landline::geometry::CameraModel;
    use nalgebra::Vector3;

    #[test]
    fn a_turned_picture_sees_the_same_points() {
        let camera = Camera {
            width: 640,
            height: 480,
            model: CameraModel::OpenCv {
                fx: 500.0,
                fy: 510.0,
                cx: 330.0,
                cy: 235.0,
                k1: -0.1,
                k2: 0.01,
                p1: 0.002,
                p2: -0.003,
            },
        };
        let pose =
            CamFromWorld::from_quaternion_wxyz([0.9, 0.1, 0.2, -0.1], Vector3::new(0.1, 0.2, 2.0));
        let point = Vector3::new(0.2, -0.3, 0.5);
        let before = camera
            .pixel_from_cam(&pose.transform_point(&point))
            .expect("in front");
        let size = picture::Size {
            stored: (640, 480),
            upright: (480, 640),
            quarter_turns: 1,
            is_mirrored: false,
        };
        let (mut turned, mut turned_pose) = (camera, Some(pose));
        let note = fit_to_picture(&mut turned, &mut turned_pose, &size).expect("a plain turn");
        assert!(note.note().is_some());
        assert_eq!(note.apply(before), Pixel::new(480.0 - before.y, before.x));
        let after = turned
            .pixel_from_cam(&turned_pose.expect("kept").transform_point(&point))
            .expect("in front");
        assert!((after.x - (480.0 - before.y)).abs() < 1e-9);
        assert!((after.y - before.x).abs() < 1e-9);

        // The camera of the full-size picture, whose copy was halved: scaled, then turned.
        let half = picture::Size {
            stored: (320, 240),
            upright: (240, 320),
            ..size
        };
        let (mut turned, mut turned_pose) = (camera, Some(pose));
        let fit = fit_to_picture(&mut turned, &mut turned_pose, &half).expect("scaled and turned");
        let after = turned
            .pixel_from_cam(&turned_pose.expect("kept").transform_point(&point))
            .expect("in front");
        let expected = Pixel::new(240.0 - 0.5 * before.y, 0.5 * before.x);
        assert!(after.distance(expected) < 1e-9, "{after:?}");
        assert!(fit.apply(before).distance(expected) < 1e-9);
    }

    #[test]
    fn a_shrunk_picture_scales_its_camera_and_a_cropped_one_is_refused() {
        let plain = |w, h| picture::Size {
            stored: (w, h),
            upright: (w, h),
            quarter_turns: 0,
            is_mirrored: false,
        };
        let mut camera = Camera::centered(640, 480, 500.0);
        fit_to_picture(&mut camera, &mut None, &plain(320, 240)).expect("half size");
        assert_eq!(camera, Camera::centered(320, 240, 250.0));
        let mut camera = Camera::centered(640, 480, 500.0);
        assert!(fit_to_picture(&mut camera, &mut None, &plain(640, 360)).is_err());
    }
}
