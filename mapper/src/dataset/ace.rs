//! Folders of DSAC* and ACE: `train|test/{rgb,poses,calibration}`, one file a picture in each.
//!
//! Their own readers match the three by sort order, so that one lost file gives every later picture its neighbour's pose.
//! Here the names decide; order counts only where names have nothing in common.

use super::cameras::of_this_size;
use super::pictures::list_files;
use super::seven_scenes::pose_of;
use super::text::read_text;
use super::{Dataset, DatasetError, DatasetImage, Split};
use landline::formats::expressed;
use landline::geometry::{Camera, CameraRecord};
use landline::scene_file::Units;
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

/// Whether a folder has this layout.
pub(super) fn is_ace(root: &Path) -> bool {
    root.join("train/rgb").is_dir() && root.join("train/poses").is_dir()
}

/// Reads the folders. Their poses are world from camera, of the colour camera.
pub(super) fn read(root: &Path) -> Result<Dataset, DatasetError> {
    let mut dataset = Dataset::empty("DSAC*/ACE folders");
    dataset.units = Units::Metres;
    dataset.sources.push(root.to_owned());
    for (folder, split) in [("train", Split::Train), ("test", Split::Test)] {
        let base = root.join(folder);
        if !base.is_dir() {
            continue;
        }
        let files = [
            list_files(&base.join("rgb"))?,
            list_files(&base.join("poses"))?,
            list_files(&base.join("calibration"))?,
        ];
        for entry in matched(&base, files, &mut dataset)? {
            let file_name = file_name(&entry.picture);
            let name = format!("{folder}/rgb/{file_name}");
            let (Some(pose), Some(calibration)) = (entry.pose, entry.calibration) else {
                dataset.drop_image(name, "no pose or no calibration of the picture's name");
                continue;
            };
            let world_from_cam = match pose_of(&pose)? {
                Ok(t) => t,
                Err(problem) => {
                    dataset.drop_image(name, format!("pose: {problem}"));
                    continue;
                }
            };
            let size = match crate::picture::size(&entry.picture) {
                Ok(size) => size,
                Err(e) => {
                    dataset.drop_image(name, format!("picture cannot be read: {}", e.short()));
                    continue;
                }
            };
            if size.quarter_turns != 0 {
                let as_stored = camera(&calibration, size.stored)?;
                dataset.note_stored(&name, Some(as_stored));
            }
            let (camera, note) = of_this_size(camera(&calibration, size.upright)?);
            dataset.note_once(note);
            dataset.images.push(DatasetImage {
                name,
                path: entry.picture,
                camera,
                cam_from_world: Some(world_from_cam.inverse()),
                split,
            });
        }
    }
    Ok(dataset)
}

/// A calibration is one focal length, or a 3x3 matrix.
fn camera(path: &Path, size: (u32, u32)) -> Result<Camera, DatasetError> {
    let file = read_text(path)?;
    let mut v = Vec::new();
    for line in file.lines() {
        v.extend(line.finite(&line.fields())?);
    }
    let (w, h) = (f64::from(size.0), f64::from(size.1));
    let params = match *v.as_slice() {
        [f] => vec![f, f, 0.5 * w, 0.5 * h],
        [fx, _, cx, _, fy, cy, ..] if v.len() == 9 => vec![fx, fy, cx, cy],
        _ => {
            return Err(DatasetError::missing(
                path,
                format!(
                    "expected one focal length or a 3x3 matrix, found {} numbers",
                    v.len()
                ),
            ));
        }
    };
    expressed(&CameraRecord {
        model: "PINHOLE".to_owned(),
        width: size.0,
        height: size.1,
        params,
    })
    .map_err(|e| DatasetError::missing(path, e))
}

/// Files of one picture.
struct Entry {
    picture: PathBuf,
    pose: Option<PathBuf>,
    calibration: Option<PathBuf>,
}

fn file_name(path: &Path) -> String {
    path.file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
}

/// The name without its ending.
fn stem(name: &str) -> String {
    name.rsplit_once('.')
        .map_or(name, |(stem, _)| stem)
        .to_owned()
}

/// What files of one picture have in common, from strict to loose.
const KEYS: [fn(&str) -> String; 3] = [
    stem,
    // seq-01-frame-000000.color.png, .pose.txt, .calibration.txt
    |name| {
        let stem = stem(name);
        let kinds = [
            "color",
            "rgb",
            "image",
            "pose",
            "poses",
            "calibration",
            "calib",
        ];
        let kind = stem.rfind(['.', '-', '_']).filter(|at| {
            let last = stem[at + 1..].to_ascii_lowercase();
            kinds.contains(&last.as_str())
        });
        kind.map_or(stem.clone(), |at| stem[..at].to_owned())
    },
    // image_0001.png, pose_0001.txt
    |name| {
        let stem = stem(name);
        let numbers: Vec<&str> = stem
            .split(|c: char| !c.is_ascii_digit())
            .filter(|n| !n.is_empty())
            .collect();
        numbers.join("-")
    },
];

/// Brings pictures, poses and calibrations together.
fn matched(
    base: &Path,
    files: [Vec<PathBuf>; 3],
    dataset: &mut Dataset,
) -> Result<Vec<Entry>, DatasetError> {
    let names = files
        .each_ref()
        .map(|list| list.iter().map(|p| file_name(p)).collect::<Vec<_>>());
    // The key under which most pictures have all three; of equals the strictest.
    let best = KEYS
        .iter()
        .filter_map(|key| {
            let positions = names.each_ref().map(|names| positions(names, *key));
            let [Some(pictures), Some(poses), Some(calibrations)] = positions else {
                return None;
            };
            let num_whole = pictures
                .keys()
                .filter(|k| poses.contains_key(*k) && calibrations.contains_key(*k))
                .count();
            Some((num_whole, *key, poses, calibrations))
        })
        .reduce(|best, other| if other.0 > best.0 { other } else { best })
        .filter(|(num_whole, ..)| 2 * num_whole >= names[0].len().min(names[1].len()).max(1));
    let [pictures, poses, calibrations] = files;
    let Some((num_whole, key, pose_of, calibration_of)) = best else {
        if pictures.len() == poses.len() && pictures.len() == calibrations.len() {
            if !pictures.is_empty() {
                dataset.notes.push(format!(
                    "{}: names of pictures, poses and calibrations have nothing in common: matched by order",
                    base.display()
                ));
            }
            return Ok(pictures
                .into_iter()
                .zip(poses)
                .zip(calibrations)
                .map(|((picture, pose), calibration)| Entry {
                    picture,
                    pose: Some(pose),
                    calibration: Some(calibration),
                })
                .collect());
        }
        return Err(DatasetError::missing(
            base,
            format!(
                "{} pictures, {} poses and {} calibrations, whose names have nothing in common (rgb/{}, poses/{}); give \
                 files of one picture the same name",
                pictures.len(),
                poses.len(),
                calibrations.len(),
                names[0].first().map_or("", String::as_str),
                names[1].first().map_or("", String::as_str),
            ),
        ));
    };
    let known: HashSet<String> = names[0].iter().map(|n| key(n)).collect();
    let lonely: Vec<&String> = names[1]
        .iter()
        .filter(|n| !known.contains(&key(n)))
        .collect();
    if let Some(first) = lonely.first() {
        dataset.notes.push(format!(
            "{}: {} poses have no picture of their name ({first}{})",
            base.display(),
            lonely.len(),
            if lonely.len() > 1 { ", ..." } else { "" }
        ));
    }
    if num_whole < pictures.len() {
        dataset.notes.push(format!(
            "{}: pictures, poses and calibrations differ in number: matched by name",
            base.display()
        ));
    }
    Ok(pictures
        .into_iter()
        .zip(&names[0])
        .map(|(picture, name)| Entry {
            picture,
            pose: pose_of.get(&key(name)).map(|at| poses[*at].clone()),
            calibration: calibration_of
                .get(&key(name))
                .map(|at| calibrations[*at].clone()),
        })
        .collect())
}

/// Files by key; `None` when a key is of several.
fn positions(names: &[String], key: fn(&str) -> String) -> Option<HashMap<String, usize>> {
    let found: HashMap<String, usize> = names
        .iter()
        .enumerate()
        .map(|(at, name)| (key(name), at))
        .collect();
    (found.len() == names.len()).then_some(found)
}
