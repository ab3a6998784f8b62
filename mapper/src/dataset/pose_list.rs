//! Text lists: `name qw qx qy qz tx ty tz [f [confidence]]` (camera from world, as pseudo ground truth of 7-Scenes, hloc
//! results and ACE0 write them), `name` + 16 numbers (4x4 row-major), and hloc query lists `name MODEL w h params...`.

use super::args::{PoseDirection, QuaternionOrder};
use super::camera::expressed;
use super::cameras::{CameraSource, model_at, query_line};
use super::pictures::Pictures;
use super::pose_check::{PoseProblem, block_and_translation, rigid_from_quaternion};
use super::text::{Line, TextFile};
use super::{Dataset, DatasetError, DatasetImage, Split};
use landline::geometry::{CamFromWorld, CameraRecord};
use nalgebra::Vector3;
use std::path::Path;

/// ACE0 advises to ignore poses below this confidence (its inlier count).
const MIN_ACE0_CONFIDENCE: f64 = 1000.0;

/// The layouts that a list may have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ListKind {
    /// Quaternion, translation, and this many more numbers: focal length, confidence.
    Quaternion(usize),
    /// 4x4 matrix.
    Matrix,
    /// Camera only.
    Query,
}

/// Recognises a list by its first line.
pub(super) fn sniff(path: &Path) -> Option<ListKind> {
    let file = TextFile::read(path).ok()?;
    let first = file.lines().next()?;
    let fields = first.fields();
    let numbers = fields
        .iter()
        .rev()
        .take_while(|f| f.parse::<f64>().is_ok())
        .count();
    let is_query = model_at(&fields).is_some_and(|at| fields.len() > at + 3);
    // A name may hold spaces, or be a number itself.
    let numbers = numbers.min(fields.len().saturating_sub(1));
    match (is_query, numbers) {
        (true, _) => Some(ListKind::Query),
        (_, 7) => Some(ListKind::Quaternion(0)),
        (_, 8) => Some(ListKind::Quaternion(1)),
        (_, 9) => Some(ListKind::Quaternion(2)),
        (_, 16) => Some(ListKind::Matrix),
        _ => None,
    }
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
    let file = TextFile::read(path)?;
    let mut dataset = Dataset::empty(match kind {
        ListKind::Quaternion(_) => "pose list (quaternions)",
        ListKind::Matrix => "pose list (4x4 matrices)",
        ListKind::Query => "query list",
    });
    dataset.sources.push(path.to_owned());
    // Lists of matrices are written by SLAM and capture tools as world from camera, lists of quaternions by
    // structure-from-motion tools as camera from world.
    let direction = direction.unwrap_or(match kind {
        ListKind::Matrix => PoseDirection::WorldFromCam,
        _ => PoseDirection::CamFromWorld,
    });
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

/// What a line says.
struct Entry {
    name: String,
    /// Its pose, or why it cannot be used; none in a query list.
    cam_from_world: Option<Result<CamFromWorld, String>>,
    focal: Option<f64>,
    camera: Option<CameraRecord>,
}

fn entry(
    line: &Line<'_>,
    kind: ListKind,
    direction: PoseDirection,
    quaternions: QuaternionOrder,
) -> Result<Entry, DatasetError> {
    let posed = |name, pose: Result<CamFromWorld, PoseProblem>, focal| Entry {
        name,
        cam_from_world: Some(pose.map_err(|problem| format!("pose: {problem}"))),
        focal,
        camera: None,
    };
    Ok(match kind {
        ListKind::Quaternion(more) => {
            let (name, v) = line.name_and_numbers(7 + more)?;
            let pose = rigid_from_quaternion::<(), ()>(
                quaternions.wxyz([v[0], v[1], v[2], v[3]]),
                Vector3::new(v[4], v[5], v[6]),
            )
            .and_then(|pose| direction.cam_from_world(&pose.rotation, pose.translation));
            let focal = v.get(7).copied();
            let mut entry = posed(name, pose, focal);
            if v.get(8).is_some_and(|c| !(*c >= MIN_ACE0_CONFIDENCE)) {
                entry.cam_from_world = Some(Err("confidence of the pose is below 1000".to_owned()));
            } else if focal.is_some_and(|f| !f.is_finite()) {
                entry.cam_from_world = Some(Err("focal length is not finite".to_owned()));
            }
            entry
        }
        ListKind::Matrix => {
            let (name, v) = line.name_and_numbers(16)?;
            let (block, translation) = block_and_translation(&v);
            posed(name, direction.cam_from_world(&block, translation), None)
        }
        ListKind::Query => {
            let (name, record) = query_line(line)?;
            Entry {
                name,
                cam_from_world: None,
                focal: None,
                camera: Some(record),
            }
        }
    })
}
