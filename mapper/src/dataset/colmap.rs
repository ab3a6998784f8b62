//! COLMAP sparse models, binary or text, of versions with and without rigs and frames.
//!
//! Every version writes the full pose of each picture into `images`, rigs or not, so `rigs` and `frames` need no reading.
//! Pixels are corner-based and poses camera from world, as ours.

use super::pictures::Pictures;
use super::text::read_text;
use super::{Dataset, DatasetError, DatasetImage, ModelPoint, Split};
use landline::formats::colmap::{self, RawImage, RawPoint};
use landline::formats::{QuaternionOrder, expressed, rigid_from_quaternion};
use landline::geometry::{Camera, CameraRecord};
use nalgebra::Vector3;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

struct RawModel {
    cameras: HashMap<u32, CameraRecord>,
    images: Vec<RawImage>,
    points: Vec<RawPoint>,
}

/// The model of a workspace, and others that were not chosen.
pub(super) struct FoundModel {
    /// Its folder.
    pub(super) folder: PathBuf,
    /// For the table, when there was a choice.
    pub(super) note: Option<String>,
}

/// Number of pictures of the model in a folder; `None` when there is none.
fn num_pictures(folder: &Path) -> Option<u64> {
    use std::io::Read;
    if let Ok(mut file) = std::fs::File::open(folder.join("images.bin")) {
        let mut count = [0; 8];
        // A file too short to hold a count is one that its reader refuses with the reason.
        return Some(
            file.read_exact(&mut count)
                .map_or(0, |()| u64::from_le_bytes(count)),
        );
    }
    let path = folder.join("images.txt");
    path.is_file().then(|| {
        read_text(&path).map_or(0, |file| {
            let lines = file.all_lines().filter(|l| !l.text.starts_with('#'));
            lines.count() as u64 / 2
        })
    })
}

/// The model folder in a workspace: the folder itself, or the one under `sparse` with the most pictures.
pub(super) fn find_model(root: &Path) -> Option<FoundModel> {
    if num_pictures(root).is_some() {
        return Some(FoundModel {
            folder: root.to_owned(),
            note: None,
        });
    }
    let mut candidates = Vec::new();
    for base in [
        root.to_owned(),
        root.join("sparse"),
        root.join("colmap/sparse"),
    ] {
        candidates.push(base.clone());
        if let Ok(entries) = std::fs::read_dir(&base) {
            candidates.extend(entries.flatten().map(|e| e.path()));
        }
    }
    // `sparse` is both a base and a folder of the root.
    candidates.sort();
    candidates.dedup();
    let mut models: Vec<(u64, PathBuf)> = candidates
        .into_iter()
        .filter_map(|folder| num_pictures(&folder).map(|n| (n, folder)))
        .collect();
    // The most pictures; of equals the first by name.
    models.sort_by(|a, b| b.0.cmp(&a.0).then_with(|| a.1.cmp(&b.1)));
    let mut models = models.into_iter();
    let (count, folder) = models.next()?;
    let others: Vec<String> = models
        .map(|(n, other)| format!("{} ({n} pictures)", other.display()))
        .collect();
    let note = (!others.is_empty()).then(|| {
        format!(
            "several models: {} with {count} pictures is read, not {}; give a model's folder to choose (with --pictures DIR)",
            folder.display(),
            others.join(", ")
        )
    });
    Some(FoundModel { folder, note })
}

/// Reads a model.
pub(super) fn read(
    folder: &Path,
    pictures: &Pictures,
    quaternions: QuaternionOrder,
) -> Result<Dataset, DatasetError> {
    let is_binary = folder.join("images.bin").is_file();
    let raw = if is_binary {
        read_binary(folder)?
    } else {
        read_model_text(folder)?
    };
    let mut dataset = Dataset::empty(if is_binary {
        "COLMAP model (binary)"
    } else {
        "COLMAP model (text)"
    });
    dataset.sources.push(folder.to_owned());
    if ["rigs.bin", "rigs.txt"]
        .iter()
        .any(|f| folder.join(f).is_file())
    {
        dataset
            .notes
            .push("model with rigs: each picture's own pose is used".to_owned());
    }
    if raw.points.is_empty() {
        dataset.notes.push(
            "the model has no points (no points3D file, or an empty one): points are triangulated"
                .to_owned(),
        );
    }
    let mut cameras: HashMap<u32, Result<Camera, String>> = HashMap::new();
    for (id, record) in &raw.cameras {
        cameras.insert(*id, expressed(record).map_err(|e| e.to_string()));
    }
    let mut position_of: HashMap<u32, usize> = HashMap::new();
    for image in &raw.images {
        let camera = match cameras.get(&image.camera) {
            Some(Ok(camera)) => *camera,
            Some(Err(reason)) => {
                dataset.drop_image(&image.name, reason.clone());
                continue;
            }
            None => {
                return Err(DatasetError::missing(
                    folder,
                    format!(
                        "picture {} names camera {}, which the model lacks",
                        image.name, image.camera
                    ),
                ));
            }
        };
        let cam_from_world = match rigid_from_quaternion(
            quaternions.wxyz(image.quaternion),
            image.translation.into(),
        ) {
            Ok(transform) => transform,
            Err(problem) => {
                dataset.drop_image(&image.name, format!("pose: {problem}"));
                continue;
            }
        };
        let Some(found) = pictures.find(&image.name, &mut dataset) else {
            continue;
        };
        position_of.insert(image.id, dataset.images.len());
        dataset.images.push(DatasetImage {
            name: found.name,
            path: found.path,
            camera,
            cam_from_world: Some(cam_from_world),
            split: Split::Train,
        });
    }
    let by_id: HashMap<u32, &RawImage> = raw.images.iter().map(|image| (image.id, image)).collect();
    let mut num_broken = 0;
    for point in &raw.points {
        let mut observations = Vec::with_capacity(point.track.len());
        for (image, keypoint) in &point.track {
            let seen = by_id
                .get(image)
                .and_then(|i| i.keypoints.get(*keypoint as usize));
            match (seen, position_of.get(image)) {
                (Some((pixel, owner)), Some(position)) => {
                    num_broken += usize::from(*owner != Some(point.id));
                    observations.push((*position, *pixel));
                }
                (None, _) => num_broken += 1,
                // The picture was dropped.
                (Some(_), None) => {}
            }
        }
        if observations.len() >= 2 {
            dataset.points.push(ModelPoint {
                point_in_world: Vector3::from(point.position),
                observations,
            });
        }
    }
    if num_broken > 0 {
        dataset.notes.push(format!(
            "{num_broken} observations of points do not agree with the pictures' keypoints"
        ));
    }
    Ok(dataset)
}

fn read_binary(folder: &Path) -> Result<RawModel, DatasetError> {
    let load = |name: &str| {
        let path = folder.join(name);
        std::fs::read(&path)
            .map(|bytes| (path.display().to_string(), bytes))
            .map_err(DatasetError::io(&path))
    };
    let (file, bytes) = load("cameras.bin")?;
    let cameras = colmap::cameras_of_bytes(&file, &bytes)?;
    let (file, bytes) = load("images.bin")?;
    let images = colmap::images_of_bytes(&file, &bytes)?;
    // Poses do not need points: a model of known poses has none.
    let points = if folder.join("points3D.bin").exists() {
        let (file, bytes) = load("points3D.bin")?;
        colmap::points_of_bytes(&file, &bytes)?
    } else {
        Vec::new()
    };
    Ok(RawModel {
        cameras,
        images,
        points,
    })
}

fn read_model_text(folder: &Path) -> Result<RawModel, DatasetError> {
    let points = folder.join("points3D.txt");
    Ok(RawModel {
        cameras: colmap::cameras_of_text(&read_text(&folder.join("cameras.txt"))?)?,
        images: colmap::images_of_text(&read_text(&folder.join("images.txt"))?)?,
        // As in the binary model.
        points: if points.exists() {
            colmap::points_of_text(&read_text(&points)?)?
        } else {
            Vec::new()
        },
    })
}
