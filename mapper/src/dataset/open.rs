//! Finds out what a path is and reads it.

use super::args::{DataArgs, Format, PoseCamera};
use super::cameras::CameraSource;
use super::finish::finish;
use super::pictures::{MISSING, Pictures, list_files};
use super::pose_list;
use super::{Dataset, DatasetError, ace, colmap, indoor6, seven_scenes, split, transforms, tum};
use crate::picture;
use landline::formats::list::{ListKind, rank};
use landline::geometry::{CamFromWorld, CameraAxes};
use std::path::{Path, PathBuf};

/// What a reader gets.
struct Source<'a> {
    args: &'a DataArgs,
    /// The folder that was given, or that of the file.
    root: &'a Path,
    pictures: &'a Pictures,
    cameras: CameraSource,
}

/// One format: how a path of it looks, and what reads it.
struct Reader {
    format: Format,
    recognises: fn(&Path) -> bool,
    read: fn(Source<'_>) -> Result<Dataset, DatasetError>,
}

/// All formats, in the order in which they are tried; the first that recognises the path reads it.
const READERS: &[Reader] = &[
    Reader {
        format: Format::Colmap,
        recognises: |path| colmap::find_model(path).is_some(),
        read: read_colmap,
    },
    Reader {
        format: Format::Transforms,
        recognises: transforms::is_transforms,
        read: |s| {
            let own_split = !s.args.chooses_split();
            transforms::read(&transforms::file_of(&s.args.data), s.pictures, own_split)
        },
    },
    Reader {
        format: Format::SevenScenes,
        recognises: seven_scenes::is_original,
        read: |s| {
            let poses_of = s.args.poses_of.unwrap_or(PoseCamera::Depth);
            seven_scenes::read_original(s.root, s.pictures, &s.cameras, poses_of)
        },
    },
    Reader {
        format: Format::Ace,
        recognises: ace::is_ace,
        read: |s| ace::read(s.root),
    },
    Reader {
        format: Format::Indoor6,
        recognises: indoor6::is_indoor6,
        read: |s| indoor6::read(s.root, s.pictures),
    },
    Reader {
        format: Format::Tum,
        recognises: tum::is_tum,
        read: |s| tum::read(s.root, s.pictures, &s.cameras),
    },
    Reader {
        format: Format::QueryList,
        // A query list has no poses: it is read where it is named or forced.
        recognises: |_| false,
        read: read_list,
    },
    Reader {
        format: Format::PoseList,
        // The last one: it says what was looked for in vain.
        recognises: |_| true,
        read: read_list,
    },
];

/// Whether there is something to read poses from: false for a folder with pictures in it in which no format and no list of
/// poses is found.
pub fn has_poses(args: &DataArgs) -> bool {
    let data = &args.data;
    let is_named = args.format.is_some() || args.poses.is_some() || args.cameras.is_some();
    if is_named || !data.is_dir() {
        return true;
    }
    let recognises = |r: &Reader| r.format != Format::PoseList && (r.recognises)(data);
    // What cannot be listed is an error that reading it tells.
    let Ok(files) = list_files(data) else {
        return true;
    };
    let has_pictures = files.iter().any(|p| picture::is_called_picture(p));
    let is_list = |p: &PathBuf| {
        p.extension().is_some_and(|e| e.eq_ignore_ascii_case("txt"))
            && pose_list::kind_of(p).is_some()
    };
    !has_pictures || READERS.iter().any(recognises) || files.iter().any(is_list)
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
    let mut cameras = CameraSource::new(args.camera.clone());
    if let Some(path) = &args.cameras {
        cameras.read_cameras(path)?;
    }
    let pictures = Pictures::new(&root, args.pictures.as_deref())?;
    let is_meant = |reader: &&Reader| match (args.format, &args.poses) {
        (Some(format), _) => reader.format == format,
        // Poses that are named outrank what lies about.
        (None, Some(_)) => reader.format == Format::PoseList,
        (None, None) => (reader.recognises)(data),
    };
    let reader = READERS
        .iter()
        .find(is_meant)
        .ok_or_else(|| DatasetError::UnknownFormat {
            path: data.clone(),
            what: "no format recognises it".to_owned(),
        })?;
    check_meant(args, reader.format)?;
    let mut dataset = (reader.read)(Source {
        args,
        root: &root,
        pictures: &pictures,
        cameras,
    })?;
    let num_missing = dataset.dropped.iter().filter(|d| d.reason == MISSING);
    if num_missing.count() > 0 {
        dataset.notes.push(format!(
            "pictures were looked for in {} and below; --pictures DIR names another folder",
            pictures.folders()
        ));
    }
    apply_axes(&mut dataset, args.camera_axes);
    dataset.trust_poses = args.trust_poses;
    finish(&mut dataset, args)?;
    Ok(dataset)
}

/// Refuses options that would change nothing in this format.
fn check_meant(args: &DataArgs, format: Format) -> Result<(), DatasetError> {
    let is_list = matches!(format, Format::PoseList | Format::QueryList);
    let wrong = if args.poses_of.is_some() && format != Format::SevenScenes {
        "--poses-of is for 7-Scenes folders"
    } else if args.quaternions.is_some() && !is_list && format != Format::Colmap {
        "--quaternions is for pose lists and COLMAP models"
    } else if args.pose_direction.is_some() && !is_list {
        "--pose-direction is for pose lists"
    } else {
        return Ok(());
    };
    Err(DatasetError::missing(
        &args.data,
        format!("{wrong}, and this is read as {format:?} (--format reads it as another)"),
    ))
}

/// Poses of cameras with other axes than the format's own.
fn apply_axes(dataset: &mut Dataset, axes: Option<CameraAxes>) {
    let Some(axes) = axes else { return };
    let turn = axes.ours_from_file * dataset.camera_axes.ours_from_file.transpose();
    for image in &mut dataset.images {
        image.cam_from_world = image
            .cam_from_world
            .map(|t| CamFromWorld::new(turn * t.rotation, turn * t.translation));
    }
    dataset.camera_axes = axes;
    dataset
        .notes
        .push(format!("camera axes of the file: {axes}"));
}

fn read_colmap(source: Source<'_>) -> Result<Dataset, DatasetError> {
    let root = source.root;
    let model = colmap::find_model(root).ok_or_else(|| {
        DatasetError::missing(root, "no images.bin or images.txt here or under sparse/")
    })?;
    let mut dataset = colmap::read(
        &model.folder,
        source.pictures,
        source.args.quaternions.unwrap_or_default(),
    )?;
    dataset.notes.extend(model.note);
    if !source.args.chooses_split() {
        split::apply_lists_beside(&[&model.folder, root], &mut dataset)?;
    }
    Ok(dataset)
}

fn read_list(mut source: Source<'_>) -> Result<Dataset, DatasetError> {
    let (list, kind, note) = find_list(&source)?;
    let k = list.with_file_name("K.txt");
    if source.cameras.given.is_none() && k.is_file() {
        source.cameras.read_k(&k)?;
    }
    let mut dataset = pose_list::read(
        &list,
        kind,
        source.pictures,
        &source.cameras,
        source.args.pose_direction,
        source.args.quaternions.unwrap_or_default(),
    )?;
    dataset.notes.extend(note);
    seven_scenes::apply_split_files(source.root, &mut dataset)?;
    Ok(dataset)
}

/// A file that is no list of poses.
fn no_list(path: &Path) -> DatasetError {
    if picture::is_called_picture(path) {
        return DatasetError::OnePicture(path.to_owned());
    }
    if picture::is_video(path) {
        return DatasetError::NoPoses {
            path: path.to_owned(),
            what: "a video".to_owned(),
            // As `landline poses` calls the frames that it takes.
            pictures: PathBuf::from("DIR.frames-3"),
        };
    }
    DatasetError::UnknownFormat {
        path: path.to_owned(),
        what: "its first line is neither a pose nor a query".to_owned(),
    }
}

/// A folder in which no format is found.
fn nothing_known(folder: &Path) -> DatasetError {
    let listed = match picture::listed(folder) {
        Ok(listed) => listed,
        Err(e) => return DatasetError::io(folder)(e),
    };
    if !listed.pictures.is_empty() {
        return DatasetError::NoPoses {
            path: folder.to_owned(),
            what: picture::counted(listed.pictures.len(), "picture"),
            pictures: folder.to_owned(),
        };
    }
    DatasetError::UnknownFormat {
        path: folder.to_owned(),
        what: format!(
            "no model, no transforms.json and no pose list in it, and {}",
            listed.instead()
        ),
    }
}

/// The pose list of a folder, what kind it is, and a remark when there was a choice.
fn find_list(source: &Source<'_>) -> Result<(PathBuf, ListKind, Option<String>), DatasetError> {
    let Source { args, root, .. } = source;
    let forced = match args.format {
        Some(Format::QueryList) => Some(ListKind::Query),
        _ => None,
    };
    let named = match (&args.poses, source.args.data.is_dir()) {
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
        let kind = forced
            .or_else(|| pose_list::kind_of(&path))
            .ok_or_else(|| no_list(&path))?;
        return Ok((path, kind, None));
    }
    let mut lists: Vec<(PathBuf, ListKind)> = list_files(root)?
        .into_iter()
        .filter(|p| p.extension().is_some_and(|e| e == "txt"))
        .filter_map(|p| pose_list::kind_of(&p).map(|kind| (p, kind)))
        .filter(|(_, kind)| *kind != ListKind::Query || args.format == Some(Format::QueryList))
        .collect();
    lists.sort_by_key(|(p, _)| rank(&p.to_string_lossy()));
    let mut lists = lists.into_iter();
    let Some((path, kind)) = lists.next() else {
        return Err(nothing_known(&args.data));
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
