//! 7-Scenes folders (`seq-01/frame-000000.{color.png,pose.txt}`, `TrainSplit.txt`, `TestSplit.txt`).
//!
//! The poses as shipped are those of the depth camera ([`of_color_camera`]).

use super::args::PoseCamera;
use super::cameras::CameraSource;
use super::pictures::{FoundPicture, Pictures, list_files};
use super::text::read_text;
use super::{Dataset, DatasetError, DatasetImage, Split};
use landline::formats::{PoseProblem, matrix, of_color_camera};
use landline::geometry::WorldFromCam;
use landline::scene_file::Units;
use std::path::{Path, PathBuf};

/// Focal length of the colour camera, pixels at 640x480.
const COLOR_FOCAL_PX: f64 = 525.0;

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
    let file = read_text(path)?;
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

/// World from camera of a picture's own file, or why it is none.
pub(super) fn pose_of(path: &Path) -> Result<Result<WorldFromCam, PoseProblem>, DatasetError> {
    Ok(matrix(&read_text(path)?)?)
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
    match poses_of {
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
        }
        PoseCamera::Color => {
            dataset
                .notes
                .push("poses taken as the colour camera's own".to_owned());
        }
    }
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
            let of_file = match pose_of(&pose_file)? {
                Ok(world_from_cam) => world_from_cam.inverse(),
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
            let focal = COLOR_FOCAL_PX * f64::from(size.0) / 640.0;
            let camera = cameras
                .camera(&name, size, Some(focal))
                .ok_or_else(|| DatasetError::missing(root, "no camera"))?
                .map_err(|e| DatasetError::missing(root, e))?;
            dataset.images.push(DatasetImage {
                name,
                path,
                camera,
                cam_from_world: Some(match poses_of {
                    PoseCamera::Depth => of_color_camera(&of_file),
                    PoseCamera::Color => of_file,
                }),
                split: Split::Train,
            });
        }
    }
    apply_split_files(root, &mut dataset)?;
    Ok(dataset)
}
