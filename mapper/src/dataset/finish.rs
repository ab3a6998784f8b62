//! What every format has in common: pictures are there and fit their cameras, names are unique, the split is applied.

use super::open::DataArgs;
use super::{Dataset, DatasetError, limap, split, world};
use crate::picture;
use landline::geometry::{CamFromWorld, Camera, PixelMap};
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
    let mut changes: Vec<(f64, u8)> = Vec::new();
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
            Ok(size) => match fit_to_picture(&mut image.camera, &mut image.cam_from_world, &size) {
                Ok(Fit { scale, turns, note }) => {
                    changes.push((scale, turns));
                    if let Some(note) = note.filter(|n| !dataset.notes.contains(n)) {
                        dataset.notes.push(note);
                    }
                }
                Err(reason) => {
                    dataset.drop_image(image.name, reason);
                    continue;
                }
            },
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
                let (scale, turns) = changes.get(position)?;
                // Scaled and turned pictures are rare; a model's pixels are only used as they are.
                (*turns == 0).then(|| {
                    (
                        position,
                        landline::geometry::Pixel::new(pixel.x * scale, pixel.y * scale),
                    )
                })
            })
            .collect();
    }
    dataset.points.retain(|p| p.observations.len() >= 2);
    if dataset.images.is_empty() {
        let mut counts: Vec<(String, usize)> = Vec::new();
        for d in &dataset.dropped {
            match counts.iter_mut().find(|(reason, _)| *reason == d.reason) {
                Some((_, n)) => *n += 1,
                None => counts.push((d.reason.clone(), 1)),
            }
        }
        let what = counts
            .iter()
            .map(|(reason, n)| format!("{n} x {reason}"))
            .collect::<Vec<_>>()
            .join("; ");
        return Err(DatasetError::NoPictures {
            path: args.data.clone(),
            what: if what.is_empty() {
                "the list is empty".to_owned()
            } else {
                what
            },
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

/// The upright picture, and the one whose size the camera states.
enum Upright {}
enum Stated {}

/// What was done so that a camera fits its picture.
struct Fit {
    /// Picture size by camera size.
    scale: f64,
    /// Clockwise quarter turns.
    turns: u8,
    /// For the table.
    note: Option<String>,
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
    let is_turned = size.stored != size.upright || size.quarter_turns != 0;
    if size.is_mirrored {
        return Err("EXIF says that the picture is mirrored".to_owned());
    }
    if is_turned && (camera.width, camera.height) == size.stored {
        for _ in 0..size.quarter_turns {
            let (turned, turn) = camera.turned_clockwise();
            *camera = turned;
            *cam_from_world =
                cam_from_world.map(|t| CamFromWorld::new(turn * t.rotation, turn * t.translation));
        }
        return Ok(Fit {
            scale: 1.0,
            turns: size.quarter_turns,
            note: Some(
                "EXIF-rotated pictures: turned upright, their cameras and poses with them"
                    .to_owned(),
            ),
        });
    }
    if (camera.width, camera.height) == size.upright {
        return Ok(Fit {
            scale: 1.0,
            turns: 0,
            note: None,
        });
    }
    let (sx, sy) = (
        f64::from(size.upright.0) / f64::from(camera.width),
        f64::from(size.upright.1) / f64::from(camera.height),
    );
    // A picture that was shrunk afterwards keeps its content, up to the rounding of one pixel.
    if (sx / sy - 1.0).abs() * f64::from(size.upright.0.max(size.upright.1)) <= 1.0 {
        let map: PixelMap<Upright, Stated> = PixelMap::from_scale(sx, sy);
        *camera = camera.resized(&map);
        return Ok(Fit {
            scale: sx,
            turns: 0,
            note: Some(format!(
                "pictures are {sx:.4} times the size that their cameras state: cameras scaled"
            )),
        });
    }
    Err("picture and camera differ in aspect".to_owned())
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
        assert!(note.note.is_some());
        let after = turned
            .pixel_from_cam(&turned_pose.expect("kept").transform_point(&point))
            .expect("in front");
        assert!((after.x - (480.0 - before.y)).abs() < 1e-9);
        assert!((after.y - before.x).abs() < 1e-9);
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
