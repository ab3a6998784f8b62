//! Lists of poses and of cameras: which picture each line is of, and its camera.

use super::cameras::CameraSource;
use super::pictures::Pictures;
use super::text::read_text;
use super::{Dataset, DatasetError, DatasetImage, Split};
use landline::formats::list::{ListKind, entry, sniff};
use landline::formats::{PoseDirection, QuaternionOrder, expressed};
use std::path::Path;

/// What kind of list a file is, if it is one.
pub(super) fn kind_of(path: &Path) -> Option<ListKind> {
    sniff(&read_text(path).ok()?)
}

/// Reads a list of poses.
pub(super) fn read(
    path: &Path,
    kind: ListKind,
    pictures: &Pictures,
    cameras: &CameraSource,
    direction: Option<PoseDirection>,
    quaternions: QuaternionOrder,
) -> Result<Dataset, DatasetError> {
    let file = read_text(path)?;
    let mut dataset = Dataset::empty(match kind {
        ListKind::Quaternion(_) => "pose list (quaternions)",
        ListKind::Matrix => "pose list (4x4 matrices)",
        ListKind::Query => "query list",
    });
    dataset.sources.push(path.to_owned());
    let direction = direction.unwrap_or(kind.usual_direction());
    if kind != ListKind::Query {
        dataset.notes.push(format!(
            "poses read as {direction} (--pose-direction to change)"
        ));
    }
    for line in file.lines() {
        let entry = entry(&line, kind, direction, quaternions)?;
        let name = entry.name;
        let cam_from_world = match entry.cam_from_world.transpose() {
            Ok(transform) => transform,
            Err(reason) => {
                dataset.drop_image(name, reason);
                continue;
            }
        };
        let Some(found) = pictures.find(&name, &mut dataset) else {
            continue;
        };
        let camera = match &entry.camera {
            Some(record) => expressed(record).map_err(|e| line.error(e))?,
            None => match cameras.camera(&found.name, found.size, entry.focal) {
                Some(camera) => camera.map_err(|e| line.error(e))?,
                None => {
                    return Err(DatasetError::missing(
                        path,
                        "the list has no focal length; give --camera MODEL,w,h,params, --cameras LIST, or a K.txt \
                         beside the list",
                    ));
                }
            },
        };
        if entry.camera.is_none() {
            if entry.focal.is_none() {
                dataset.note_once(cameras.k_note(found.size));
            }
            let as_stored = cameras.camera_of_stored(&found, entry.focal);
            dataset.note_stored(&found.name, as_stored);
        }
        dataset.images.push(DatasetImage {
            name: found.name,
            path: found.path,
            camera,
            cam_from_world,
            split: if kind == ListKind::Query {
                Split::Test
            } else {
                Split::Train
            },
        });
    }
    Ok(dataset)
}
