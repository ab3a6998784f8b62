//! Finds out what a path is and reads it.

use super::camera::CameraRecord;
use super::pose_list::{self, CameraSource, ListKind};
use super::split::{self, IndexRange};
use super::{Dataset, DatasetError, colmap, indoor6, limap, seven_scenes, transforms, tum};
use crate::picture;
use landline::geometry::{CamFromWorld, Camera, PixelMap};
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

/// Which data, and how to read it.
#[derive(Debug, Clone, clap::Args)]
pub struct DataArgs {
    /// Data set: a folder, a pose list, or a transforms.json.
    pub data: PathBuf,
    /// Format; found out by itself when not given.
    #[arg(long, value_enum)]
    pub format: Option<Format>,
    /// Folder of the pictures, when it is not beside the poses.
    #[arg(long, value_name = "DIR")]
    pub pictures: Option<PathBuf>,
    /// File with the poses, when the folder has several or others are wanted; relative to the data set.
    #[arg(long, value_name = "FILE")]
    pub poses: Option<PathBuf>,
    /// What the poses of a list map.
    #[arg(long, value_enum)]
    pub pose_direction: Option<PoseDirection>,
    /// One camera for all pictures: MODEL,width,height,parameters in COLMAP's order.
    #[arg(long, value_name = "MODEL,W,H,...", value_parser = parse_camera)]
    pub camera: Option<CameraRecord>,
    /// Cameras by picture: a list `name MODEL width height parameters...`.
    #[arg(long, value_name = "FILE")]
    pub cameras: Option<PathBuf>,
    /// Folder of a LIMAP line map, or of any detector's segments in its layout.
    #[arg(long, value_name = "DIR")]
    pub lines: Option<PathBuf>,
    /// Pictures that teach, as positions in the sorted list (0-799, 0-99,160-).
    #[arg(long, value_name = "RANGE")]
    pub train: Option<IndexRange>,
    /// Pictures that test.
    #[arg(long, value_name = "RANGE")]
    pub test: Option<IndexRange>,
}

/// The formats that are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Format {
    /// COLMAP sparse model, binary or text.
    Colmap,
    /// transforms.json of nerfstudio or instant-ngp.
    Transforms,
    /// 7-Scenes as shipped.
    SevenScenes,
    /// Folders `train|test/{rgb,poses,calibration}` of DSAC* and ACE.
    Ace,
    /// Indoor-6.
    Indoor6,
    /// TUM RGB-D.
    Tum,
    /// `name qw qx qy qz tx ty tz [f]`, or `name` and 16 numbers.
    PoseList,
    /// `name MODEL width height parameters...`: cameras without poses.
    QueryList,
}

/// What a pose of a file maps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum PoseDirection {
    /// World points into camera space (COLMAP).
    CamFromWorld,
    /// Camera points into the world; its translation is the camera's position.
    WorldFromCam,
}

impl std::fmt::Display for PoseDirection {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::CamFromWorld => "camera from world",
            Self::WorldFromCam => "world from camera",
        })
    }
}

/// A camera from the command line: MODEL,width,height,parameters.
///
/// # Errors
/// In words, for clap.
pub fn parse_camera(text: &str) -> Result<CameraRecord, String> {
    let fields: Vec<&str> = text.split(',').map(str::trim).collect();
    let (&[model, width, height], params) = fields
        .split_first_chunk::<3>()
        .ok_or("expected MODEL,width,height,parameters")?;
    let number = |s: &str| s.parse::<f64>().map_err(|_| format!("`{s}` is no number"));
    let side = |s: &str| {
        s.parse::<u32>()
            .map_err(|_| format!("`{s}` is no size in pixels"))
    };
    let record = CameraRecord {
        model: model.to_ascii_uppercase(),
        width: side(width)?,
        height: side(height)?,
        params: params.iter().map(|p| number(p)).collect::<Result<_, _>>()?,
    };
    record.to_camera().map_err(|e| e.to_string())?;
    Ok(record)
}

/// Reads a data set and checks what every format has in common.
///
/// # Errors
/// When the data is of no known format, a file of it is damaged, or no usable picture is left.
pub fn open(args: &DataArgs) -> Result<Dataset, DatasetError> {
    let data = &args.data;
    let meta = std::fs::metadata(data).map_err(DatasetError::io(data))?;
    let root = if meta.is_dir() {
        data.clone()
    } else {
        data.parent().map(Path::to_owned).unwrap_or_default()
    };
    let mut cameras = CameraSource {
        given: args.camera.clone(),
        ..CameraSource::default()
    };
    if let Some(path) = &args.cameras {
        cameras.read_cameras(path)?;
    }
    let pictures = Pictures::new(&root, args.pictures.as_deref())?;

    let mut dataset = match args
        .format
        .or_else(|| find_format(args, &root, meta.is_dir()))
    {
        Some(Format::Colmap) => {
            let model = colmap::find_model(&root).ok_or_else(|| {
                DatasetError::missing(&root, "no images.bin or images.txt here or under sparse/")
            })?;
            colmap::read(&model, &pictures)?
        }
        Some(Format::Transforms) => {
            let path = if meta.is_dir() {
                root.join("transforms.json")
            } else {
                data.clone()
            };
            transforms::read(&path, &pictures)?
        }
        Some(Format::SevenScenes) => seven_scenes::read_original(&root, &pictures, &cameras)?,
        Some(Format::Ace) => seven_scenes::read_ace(&root)?,
        Some(Format::Indoor6) => indoor6::read(&root, &pictures)?,
        Some(Format::Tum) => tum::read(&root, &pictures, &cameras)?,
        Some(Format::PoseList | Format::QueryList) | None => {
            let (list, kind, note) = find_list(args, &root, meta.is_dir())?;
            let k = list.with_file_name("K.txt");
            if cameras.given.is_none() && k.is_file() {
                cameras.read_k(&k)?;
            }
            let mut dataset =
                pose_list::read(&list, kind, &pictures, &cameras, args.pose_direction)?;
            dataset.notes.extend(note);
            seven_scenes::apply_split_files(&root, &mut dataset)?;
            dataset
        }
    };
    finish(&mut dataset, args)?;
    Ok(dataset)
}

/// What a path looks like; `None` leaves it to the lists. Poses that are named outrank what lies about.
fn find_format(args: &DataArgs, root: &Path, is_folder: bool) -> Option<Format> {
    if args.poses.is_some() {
        return None;
    }
    if !is_folder {
        return (args.data.extension()? == "json").then_some(Format::Transforms);
    }
    if colmap::find_model(root).is_some() {
        Some(Format::Colmap)
    } else if root.join("transforms.json").is_file() {
        Some(Format::Transforms)
    } else if seven_scenes::is_original(root) {
        Some(Format::SevenScenes)
    } else if seven_scenes::is_ace(root) {
        Some(Format::Ace)
    } else if indoor6::is_indoor6(root) {
        Some(Format::Indoor6)
    } else if tum::is_tum(root) {
        Some(Format::Tum)
    } else {
        None
    }
}

/// The pose list of a folder, what kind it is, and a remark when there was a choice.
fn find_list(
    args: &DataArgs,
    root: &Path,
    is_folder: bool,
) -> Result<(PathBuf, ListKind, Option<String>), DatasetError> {
    let forced = match args.format {
        Some(Format::QueryList) => Some(ListKind::Query),
        _ => None,
    };
    let named = match (&args.poses, is_folder) {
        (Some(poses), _) => Some(if poses.is_file() {
            poses.clone()
        } else {
            root.join(poses)
        }),
        (None, false) => Some(args.data.clone()),
        (None, true) => None,
    };
    if let Some(path) = named {
        std::fs::metadata(&path).map_err(DatasetError::io(&path))?;
        let kind = forced.or_else(|| pose_list::sniff(&path)).ok_or_else(|| {
            DatasetError::UnknownFormat {
                path: path.clone(),
                what: "its first line is neither a pose nor a query".to_owned(),
            }
        })?;
        return Ok((path, kind, None));
    }
    let mut lists: Vec<(PathBuf, ListKind)> = list_files(root)?
        .into_iter()
        .filter(|p| p.extension().is_some_and(|e| e == "txt"))
        .filter_map(|p| pose_list::sniff(&p).map(|kind| (p, kind)))
        .filter(|(_, kind)| *kind != ListKind::Query || args.format == Some(Format::QueryList))
        .collect();
    // Structure-from-motion poses are the better reference where a set has several.
    lists.sort_by_key(|(p, _)| {
        let name = p
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .to_lowercase();
        (!name.contains("sfm"), name)
    });
    let mut lists = lists.into_iter();
    let Some((path, kind)) = lists.next() else {
        return Err(DatasetError::UnknownFormat {
            path: args.data.clone(),
            what: "no model, no transforms.json and no pose list in it".to_owned(),
        });
    };
    let others: Vec<String> = lists
        .map(|(p, _)| {
            p.file_name()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned()
        })
        .collect();
    let note = (!others.is_empty()).then(|| {
        format!(
            "other pose files in the folder: {} (--poses to choose)",
            others.join(", ")
        )
    });
    Ok((path, kind, note))
}

/// Files of a folder, sorted.
pub(super) fn list_files(folder: &Path) -> Result<Vec<PathBuf>, DatasetError> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(DatasetError::io(folder))? {
        let path = entry.map_err(DatasetError::io(folder))?.path();
        if path.is_file() {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}

/// Checks and completes what a reader delivered.
fn finish(dataset: &mut Dataset, args: &DataArgs) -> Result<(), DatasetError> {
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

/// Where pictures of a data set may lie.
pub(super) struct Pictures {
    folders: Vec<PathBuf>,
}

impl Pictures {
    pub(super) fn new(root: &Path, given: Option<&Path>) -> Result<Self, DatasetError> {
        let folders = match given {
            Some(folder) => {
                std::fs::metadata(folder).map_err(DatasetError::io(folder))?;
                vec![folder.to_owned()]
            }
            None => ["", "rgb", "images", "pictures", "../images", "../../images"]
                .iter()
                .map(|f| root.join(f))
                .filter(|f| f.is_dir())
                .collect(),
        };
        Ok(Self { folders })
    }

    /// As [`Self::find`], for names that may lack their extension; returns the name with it.
    pub(super) fn find_with_extension(
        &self,
        name: &str,
        dataset: &mut Dataset,
    ) -> Option<(String, PathBuf, (u32, u32))> {
        let full = ["", ".png", ".jpg", ".jpeg", ".JPG"]
            .iter()
            .map(|e| format!("{name}{e}"))
            .find(|n| self.folders.iter().any(|f| f.join(n).is_file()))
            .unwrap_or_else(|| name.to_owned());
        let (path, size) = self.find(&full, dataset)?;
        Some((full, path, size))
    }

    /// The file of a picture and its upright size. What cannot be found or read is noted as dropped.
    pub(super) fn find(&self, name: &str, dataset: &mut Dataset) -> Option<(PathBuf, (u32, u32))> {
        let Some(path) = self
            .folders
            .iter()
            .map(|f| f.join(name))
            .find(|p| p.is_file())
        else {
            dataset.drop_image(name, "picture is missing");
            return None;
        };
        match picture::size(&path) {
            Ok(size) => Some((path, size.upright)),
            Err(e) => {
                dataset.drop_image(name, format!("picture cannot be read: {}", e.short()));
                None
            }
        }
    }
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
