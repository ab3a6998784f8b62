//! Text lists: `name qw qx qy qz tx ty tz [f [confidence]]` (camera from world, as pseudo ground truth of 7-Scenes, hloc
//! results and ACE0 write them), `name` + 16 numbers (4x4 row-major), and hloc query lists `name MODEL w h params...`.

use super::camera::{CameraRecordError, expressed};
use super::open::PoseDirection;
use super::pictures::Pictures;
use super::pose_check::{rigid_from_matrix, rigid_from_quaternion};
use super::text::TextFile;
use super::{Dataset, DatasetError, DatasetImage, Split};
use landline::geometry::{CamFromWorld, Camera, CameraModel, CameraRecord, WorldFromCam};
use nalgebra::{Matrix3, Vector3};
use std::collections::HashMap;
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
    let is_query = fields.get(1).is_some_and(|model| {
        model.len() > 2
            && model
                .chars()
                .all(|c| c.is_ascii_uppercase() || c.is_ascii_digit() || c == '_')
            && model.parse::<f64>().is_err()
    });
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
        let (name, block, translation, focal, record) = match kind {
            ListKind::Quaternion(more) => {
                let (name, v) = line.name_and_numbers(7 + more)?;
                if v.get(8).is_some_and(|c| *c < MIN_ACE0_CONFIDENCE) {
                    dataset.drop_image(name, "confidence of the pose is below 1000");
                    continue;
                }
                let pose = rigid_from_quaternion::<(), ()>(
                    [v[0], v[1], v[2], v[3]],
                    Vector3::new(v[4], v[5], v[6]),
                );
                match pose {
                    Ok(pose) => (
                        name,
                        Some(pose.rotation),
                        pose.translation,
                        v.get(7).copied(),
                        None,
                    ),
                    Err(problem) => {
                        dataset.drop_image(name, format!("pose: {problem}"));
                        continue;
                    }
                }
            }
            ListKind::Matrix => {
                let (name, v) = line.name_and_numbers(16)?;
                let (block, translation) = block_and_translation(&v);
                (name, Some(block), translation, None, None)
            }
            ListKind::Query => {
                let record = query_line(&line)?;
                (record.0, None, Vector3::zeros(), None, Some(record.1))
            }
        };
        let Some((picture, size)) = pictures.find(&name, &mut dataset) else {
            continue;
        };
        let camera = match (&record, focal) {
            (Some(record), _) => expressed(record).map_err(|e| line.error(e))?,
            (None, focal) => match cameras.camera(&name, size, focal) {
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
        let cam_from_world = match block {
            None => None,
            Some(block) => match direction.cam_from_world(&block, translation) {
                Ok(transform) => Some(transform),
                Err(problem) => {
                    return Err(DatasetError::Pose {
                        path: path.to_owned(),
                        name,
                        problem,
                    });
                }
            },
        };
        dataset.images.push(DatasetImage {
            name,
            path: picture,
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

fn query_line(line: &super::text::Line<'_>) -> Result<(String, CameraRecord), DatasetError> {
    let fields = line.fields();
    let (&[name, model, width, height], params) = fields
        .split_first_chunk::<4>()
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

/// Rotation block and translation of a row-major 3x4 or 4x4 matrix.
pub(super) fn block_and_translation(v: &[f64]) -> (Matrix3<f64>, Vector3<f64>) {
    let at = |r: usize, c: usize| v.get(4 * r + c).copied().unwrap_or(f64::NAN);
    (
        Matrix3::from_fn(at),
        Vector3::new(at(0, 3), at(1, 3), at(2, 3)),
    )
}

impl PoseDirection {
    /// The transform of our convention.
    pub(super) fn cam_from_world(
        self,
        block: &Matrix3<f64>,
        translation: Vector3<f64>,
    ) -> Result<CamFromWorld, super::PoseProblem> {
        match self {
            Self::CamFromWorld => rigid_from_matrix(block, translation),
            Self::WorldFromCam => {
                rigid_from_matrix(block, translation).map(|t: WorldFromCam| t.inverse())
            }
        }
    }
}

/// Where cameras come from when a list has none.
#[derive(Debug, Default)]
pub(super) struct CameraSource {
    /// For all pictures.
    pub(super) given: Option<CameraRecord>,
    /// By picture name.
    pub(super) by_name: HashMap<String, CameraRecord>,
    /// fx, fy, cx, cy of a `K.txt`, its principal point already corner-based.
    pub(super) k: Option<[f64; 4]>,
}

impl CameraSource {
    /// Reads a query list for its cameras.
    pub(super) fn read_cameras(&mut self, path: &Path) -> Result<(), DatasetError> {
        let file = TextFile::read(path)?;
        for line in file.lines() {
            let (name, record) = query_line(&line)?;
            self.by_name.insert(name, record);
        }
        Ok(())
    }

    /// Reads a 3x3 matrix. Such files count pixel centres as integers (OpenCV), so half a pixel is added.
    pub(super) fn read_k(&mut self, path: &Path) -> Result<(), DatasetError> {
        let file = TextFile::read(path)?;
        let mut v = Vec::new();
        for line in file.lines() {
            v.extend(line.finite(&line.fields())?);
        }
        let &[fx, skew, cx, _, fy, cy, _, _, one] = v.as_slice() else {
            return Err(DatasetError::missing(
                path,
                format!("expected a 3x3 matrix, found {} numbers", v.len()),
            ));
        };
        if one != 1.0 || skew != 0.0 {
            return Err(DatasetError::missing(
                path,
                "this is no camera matrix of the form [fx 0 cx; 0 fy cy; 0 0 1]",
            ));
        }
        self.k = Some([fx, fy, cx + 0.5, cy + 0.5]);
        Ok(())
    }

    /// The camera of a picture of a given size; `None` when nothing is known.
    pub(super) fn camera(
        &self,
        name: &str,
        (width, height): (u32, u32),
        focal: Option<f64>,
    ) -> Option<Result<Camera, CameraRecordError>> {
        let basename = name.rsplit('/').next().unwrap_or(name);
        if let Some(record) = self
            .by_name
            .get(name)
            .or_else(|| self.by_name.get(basename))
            .or(self.given.as_ref())
        {
            return Some(expressed(record));
        }
        let camera = match (focal, self.k) {
            (Some(f), _) => Camera::centered(width, height, f),
            (None, Some([fx, fy, cx, cy])) => Camera {
                width,
                height,
                model: CameraModel::Pinhole { fx, fy, cx, cy },
            },
            (None, None) => return None,
        };
        Some(
            camera
                .validate()
                .map(|()| camera)
                .map_err(CameraRecordError::from),
        )
    }
}
