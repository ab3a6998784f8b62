//! Text lists: `name qw qx qy qz tx ty tz [f [confidence]]` (camera from world, as pseudo ground truth of 7-Scenes, hloc
//! results and ACE0 write them), `name` + 16 numbers (4x4 row-major), and hloc query lists `name MODEL w h params...`.

use super::FormatError;
use super::rigid::{
    PoseDirection, PoseProblem, QuaternionOrder, block_and_translation, rigid_from_quaternion,
};
use super::text::{Line, TextFile};
use crate::geometry::{CamFromWorld, CameraRecord};
use nalgebra::Vector3;

/// ACE0 advises to ignore poses below this confidence (its inlier count).
const MIN_ACE0_CONFIDENCE: f64 = 1000.0;

/// The layouts that a list may have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ListKind {
    /// Quaternion, translation, and this many more numbers: focal length, confidence.
    Quaternion(usize),
    /// 4x4 matrix.
    Matrix,
    /// Camera only.
    Query,
}

/// Recognises a list by its first line.
pub fn sniff(file: &TextFile) -> Option<ListKind> {
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

/// The order in which lists of a folder are taken: structure-from-motion poses are the better reference where there are
/// several.
pub fn rank(file: &str) -> (bool, String) {
    let name = file.rsplit('/').next().unwrap_or(file).to_lowercase();
    (!name.contains("sfm"), name)
}

/// What a line says.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// The picture's, as it is written.
    pub name: String,
    /// Its pose, or why it cannot be used; none in a query list.
    pub cam_from_world: Option<Result<CamFromWorld, String>>,
    /// In pixels, where the line has one.
    pub focal: Option<f64>,
    /// Of a query list.
    pub camera: Option<CameraRecord>,
}

impl ListKind {
    /// What poses map in lists of this kind by custom: matrices are written by SLAM and capture tools as world from camera,
    /// quaternions by structure-from-motion tools as camera from world.
    pub fn usual_direction(self) -> PoseDirection {
        match self {
            Self::Matrix => PoseDirection::WorldFromCam,
            _ => PoseDirection::CamFromWorld,
        }
    }
}

/// Reads a line.
///
/// # Errors
/// When it is not of this kind.
pub fn entry(
    line: &Line<'_>,
    kind: ListKind,
    direction: PoseDirection,
    quaternions: QuaternionOrder,
) -> Result<Entry, FormatError> {
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

/// Which field of a query list is the camera model: the first after the name, which may hold spaces, that looks like one.
pub fn model_at(fields: &[&str]) -> Option<usize> {
    let is_model = |model: &&str| {
        model.len() > 2
            && model
                .chars()
                .all(|c| c.is_ascii_uppercase() || c.is_ascii_digit() || c == '_')
            && model.parse::<f64>().is_err()
    };
    fields.iter().skip(1).position(is_model).map(|at| at + 1)
}

/// A line `name MODEL width height parameters...` of hloc's query lists.
///
/// # Errors
/// When it is none.
pub fn query_line(line: &Line<'_>) -> Result<(String, CameraRecord), FormatError> {
    let Some(at) = model_at(&line.fields()) else {
        return Err(line.error("expected `name MODEL width height parameters...`"));
    };
    let (name, rest) = line.split_at(at);
    let fields: Vec<&str> = rest.split_whitespace().collect();
    let (&[model, width, height], params) = fields
        .split_first_chunk::<3>()
        .ok_or_else(|| line.error("expected `name MODEL width height parameters...`"))?;
    Ok((
        name.to_owned(),
        CameraRecord {
            model: model.to_owned(),
            width: line.number(width)?,
            height: line.number(height)?,
            params: line.finite(params)?,
        },
    ))
}
