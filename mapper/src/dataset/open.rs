//! Finds out what a path is and reads it.

use super::camera::expressed;
use super::finish::finish;
use super::pictures::{Pictures, list_files};
use super::pose_list::{self, CameraSource, ListKind};
use super::split::{self, IndexRange};
use super::world::{UnitsArg, parse_vector};
use super::{Dataset, DatasetError, colmap, indoor6, seven_scenes, transforms, tum};
use landline::geometry::CameraRecord;
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
    /// Names of the pictures that test, one a line; an hloc query list will do. The others teach.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["train", "test"])]
    pub test_list: Option<PathBuf>,
    /// What one unit of length of the data set is; without it, a metre where the format says so and unknown elsewhere.
    #[arg(long, value_enum)]
    pub units: Option<UnitsArg>,
    /// Metres for one unit of length: the data set's lengths are multiplied by it and are metres then.
    #[arg(
        long,
        value_name = "F",
        conflicts_with = "units",
        allow_hyphen_values = true
    )]
    pub scale: Option<f64>,
    /// Which way is up in the data set's world.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = parse_vector)]
    pub up: Option<[f64; 3]>,
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
    expressed(&record).map_err(|e| e.to_string())?;
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
            let mut dataset = colmap::read(&model, &pictures)?;
            split::apply_lists_beside(&[&model, &root], &mut dataset)?;
            dataset
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
