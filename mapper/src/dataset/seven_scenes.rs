//! 7-Scenes folders (`seq-01/frame-000000.{color.png,pose.txt}`, `TrainSplit.txt`, `TestSplit.txt`).
//!
//! The poses as shipped are those of the depth camera. One fixed rigid transform takes depth to colour; it was recovered
//! by comparing shipped poses with published registered ones (deviation at most 0.2 mm).

use super::args::PoseCamera;
use super::cameras::CameraSource;
use super::pictures::{FoundPicture, Pictures, list_files};
use super::pose_check::{block_and_translation, rigid_from_matrix};
use super::text::TextFile;
use super::{Dataset, DatasetError, DatasetImage, Split};
use landline::geometry::{CamFromWorld, WorldFromCam};
use landline::scene_file::Units;
use nalgebra::{Matrix3, Vector3};
use std::path::{Path, PathBuf};

/// Focal length of the colour camera, pixels at 640x480.
const COLOR_FOCAL_PX: f64 = 525.0;

/// Colour camera from depth camera.
fn color_from_depth() -> (Matrix3<f64>, Vector3<f64>) {
    (
        Matrix3::new(
            0.999965, 0.002676, -0.007903, -0.002741, 0.999963, -0.008150, 0.007881, 0.008172,
            0.999936,
        ),
        Vector3::new(-0.025519, 0.000129, 0.001937),
    )
}

/// Whether a folder has the layout of the original set.
pub(super) fn is_original(root: &Path) -> bool {
    root.join("TrainSplit.txt").is_file() || !sequences(root).is_empty()
}

fn sequences(root: &Path) -> Vec<PathBuf> {
    let mut found: Vec<PathBuf> = std::fs::read_dir(root)
        .into_iter()
        .flatten()
        .flatten()
        .map(|e| e.path())
        .filter(|p| {
            p.is_dir()
                && p.file_name()
                    .is_some_and(|n| n.to_string_lossy().starts_with("seq-"))
        })
        .collect();
    found.sort();
    found
}

/// Sequences that a split file names: a line `sequence1` is the folder `seq-01`.
fn split_file(path: &Path) -> Result<Vec<String>, DatasetError> {
    let file = TextFile::read(path)?;
    file.lines()
        .map(|line| {
            let number: u32 = line.number(line.text.trim_start_matches("sequence"))?;
            Ok(format!("seq-{number:02}"))
        })
        .collect()
}

/// The split of a picture, from the split files beside its sequence folder.
pub(super) fn apply_split_files(root: &Path, dataset: &mut Dataset) -> Result<(), DatasetError> {
    let path = root.join("TestSplit.txt");
    if !path.is_file() {
        return Ok(());
    }
    let tests = split_file(&path)?;
    for image in &mut dataset.images {
        if tests
            .iter()
            .any(|s| image.name.split('/').any(|part| part == s))
        {
            image.split = Split::Test;
        }
    }
    Ok(())
}

pub(super) fn read_pose(path: &Path) -> Result<Vec<f64>, DatasetError> {
    let file = TextFile::read(path)?;
    let mut numbers = Vec::with_capacity(16);
    for line in file.lines() {
        for field in line.fields() {
            // Some sets write lost poses as inf or nan: that is a dropped picture, no broken file.
            numbers.push(line.number::<f64>(field)?);
        }
    }
    if numbers.len() != 16 {
        return Err(DatasetError::missing(
            path,
            format!("expected a 4x4 matrix, found {} numbers", numbers.len()),
        ));
    }
    Ok(numbers)
}

pub(super) fn pose_of(numbers: &[f64]) -> Result<WorldFromCam, super::PoseProblem> {
    let (block, translation) = block_and_translation(numbers);
    rigid_from_matrix(&block, translation)
}

/// Reads the original layout.
pub(super) fn read_original(
    root: &Path,
    pictures: &Pictures,
    cameras: &CameraSource,
    poses_of: PoseCamera,
) -> Result<Dataset, DatasetError> {
    let mut dataset = Dataset::empty("7-Scenes");
    dataset.units = Units::Metres;
    dataset.sources.push(root.to_owned());
    let (rotation, translation) = match poses_of {
        PoseCamera::Depth => {
            dataset.notes.push(
                "poses as shipped are of the depth camera: moved to the colour camera by the known transform \
                 (--poses-of color leaves it out)"
                    .to_owned(),
            );
            dataset.notes.push(
                "these poses (KinectFusion) are worse than structure-from-motion ones; --poses takes a list of those"
                    .to_owned(),
            );
            color_from_depth()
        }
        PoseCamera::Color => {
            dataset
                .notes
                .push("poses taken as the colour camera's own".to_owned());
            (Matrix3::identity(), Vector3::zeros())
        }
    };
    let color_from_depth: CamFromWorld =
        rigid_from_matrix(&rotation, translation).map_err(|problem| DatasetError::Pose {
            path: root.to_owned(),
            name: "colour from depth".to_owned(),
            problem,
        })?;
    for folder in sequences(root) {
        let sequence = folder
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        for pose_file in list_files(&folder)? {
            let file_name = pose_file
                .file_name()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned();
            let Some(stem) = file_name.strip_suffix(".pose.txt") else {
                continue;
            };
            let base = format!("{sequence}/{stem}.color");
            let world_from_depth = match pose_of(&read_pose(&pose_file)?) {
                Ok(t) => t,
                Err(problem) => {
                    dataset.drop_image(base, format!("pose: {problem}"));
                    continue;
                }
            };
            let Some(FoundPicture {
                name, path, size, ..
            }) = pictures.find(&base, &mut dataset)
            else {
                continue;
            };
            let from_world = world_from_depth.inverse();
            let focal = COLOR_FOCAL_PX * f64::from(size.0) / 640.0;
            let camera = cameras
                .camera(&name, size, Some(focal))
                .ok_or_else(|| DatasetError::missing(root, "no camera"))?
                .map_err(|e| DatasetError::missing(root, e))?;
            dataset.images.push(DatasetImage {
                name,
                path,
                camera,
                cam_from_world: Some(CamFromWorld::new(
                    color_from_depth.rotation * from_world.rotation,
                    color_from_depth.rotation * from_world.translation
                        + color_from_depth.translation,
                )),
                split: Split::Train,
            });
        }
    }
    apply_split_files(root, &mut dataset)?;
    Ok(dataset)
}
