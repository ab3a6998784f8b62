//! `transforms.json` of nerfstudio and instant-ngp: world from camera, OpenGL camera axes (y up, z backward).
//!
//! `applied_transform` and `applied_scale`, by which nerfstudio turned and scaled the world, are undone, so that the scene
//! keeps the coordinates of its source. Nerfstudio's pixels are corner-based, as ours.

use super::cameras::of_this_size;
use super::pictures::Pictures;
use super::split::KnownNames;
use super::text::read_text;
use super::{Dataset, DatasetError, DatasetImage, Split};
use landline::formats::{expressed, rigid_from_matrix};
use landline::geometry::{Camera, CameraAxes, CameraRecord, WorldFromCam};
use nalgebra::{Matrix3, Matrix4};
use serde_json::Value;
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// The file itself, or the one of that name in a folder.
pub(super) fn file_of(path: &Path) -> PathBuf {
    if path.is_dir() {
        path.join("transforms.json")
    } else {
        path.to_owned()
    }
}

/// Whether a path is such a file or a folder with one.
pub(super) fn is_transforms(path: &Path) -> bool {
    let file = file_of(path);
    file.is_file() && file.extension().is_some_and(|e| e == "json")
}

/// Reads the file; with `own_split` its lists of test and training pictures count.
pub(super) fn read(
    path: &Path,
    pictures: &Pictures,
    own_split: bool,
) -> Result<Dataset, DatasetError> {
    let file = read_text(path)?;
    let root: Value = serde_json::from_str(&without_nan(file.content()))
        .map_err(|e| DatasetError::parse(path, format!("line {}", e.line()), e))?;
    let frames = root
        .get("frames")
        .and_then(Value::as_array)
        .ok_or_else(|| DatasetError::missing(path, "it has no list `frames`"))?;
    let mut dataset = Dataset::empty("transforms.json");
    dataset.camera_axes = CameraAxes::OPENGL;
    dataset.sources.push(path.to_owned());
    let applied = Applied::read(&root, path)?;
    dataset.notes.extend(applied.note());
    if frames.iter().any(|f| f.get("mask_path").is_some()) {
        dataset.notes.push("masks are not used".to_owned());
    }
    for (position, frame) in frames.iter().enumerate() {
        let Some(name) = frame.get("file_path").and_then(Value::as_str) else {
            return Err(DatasetError::parse(
                path,
                format!("frame {position}"),
                "it has no `file_path`",
            ));
        };
        let Some(transform) = frame.get("transform_matrix").and_then(matrix) else {
            dataset.drop_image(name, "no 4x4 `transform_matrix` of finite numbers");
            continue;
        };
        let placed = applied.undone(&transform);
        let block: Matrix3<f64> =
            placed.fixed_view::<3, 3>(0, 0) * dataset.camera_axes.ours_from_file.transpose();
        let translation = placed.fixed_view::<3, 1>(0, 3).into_owned();
        let world_from_cam: WorldFromCam = match rigid_from_matrix(&block, translation) {
            Ok(t) => t,
            Err(problem) => {
                dataset.drop_image(name, format!("pose: {problem}"));
                continue;
            }
        };
        let Some(found) = pictures.find(name, &mut dataset) else {
            continue;
        };
        let mut camera = match camera_of(&root, frame, found.size) {
            Ok(camera) => camera,
            Err(reason) => {
                dataset.drop_image(found.name, reason);
                continue;
            }
        };
        let states_size = ["w", "h"]
            .iter()
            .any(|key| frame.get(key).or_else(|| root.get(key)).is_some());
        if !states_size {
            if let Some(stored) = found.stored {
                let as_stored = camera_of(&root, frame, stored).ok();
                dataset.note_stored(&found.name, as_stored);
            }
            let (scaled, note) = of_this_size(camera);
            camera = scaled;
            dataset.note_once(note);
        }
        dataset.images.push(DatasetImage {
            split: Split::Train,
            name: found.name,
            path: found.path,
            camera,
            cam_from_world: Some(world_from_cam.inverse()),
        });
    }
    if own_split {
        apply_own_split(&root, path, &mut dataset)?;
    }
    Ok(dataset)
}

/// `train_filenames`, `val_filenames`, `test_filenames`: what is in no list of a file that has a list of training pictures
/// is not used; pictures for validation test where there are no others.
fn apply_own_split(root: &Value, path: &Path, dataset: &mut Dataset) -> Result<(), DatasetError> {
    let known = KnownNames::new(dataset);
    let listed = |key: &str| -> Result<Option<HashSet<usize>>, DatasetError> {
        let Some(list) = root.get(key).and_then(Value::as_array) else {
            return Ok(None);
        };
        let names: Vec<String> = list
            .iter()
            .filter_map(|v| v.as_str().map(str::to_owned))
            .collect();
        known.positions(path, &names).map(Some)
    };
    let train = listed("train_filenames")?;
    // Tools write an empty list where there are no test pictures.
    let test = listed("test_filenames")?.filter(|t| !t.is_empty());
    let validation = listed("val_filenames")?.filter(|v| !v.is_empty());
    let (tests, held_back) = match (test, validation) {
        (Some(test), validation) => (test, validation.unwrap_or_default()),
        (None, Some(validation)) => (validation, HashSet::new()),
        (None, None) if train.is_some() => Default::default(),
        (None, None) => return Ok(()),
    };
    for (position, image) in dataset.images.iter_mut().enumerate() {
        image.split = if tests.contains(&position) {
            Split::Test
        } else if held_back.contains(&position)
            || train.as_ref().is_some_and(|t| !t.contains(&position))
        {
            Split::Unused
        } else {
            Split::Train
        };
    }
    dataset.notes.push(
        "split of the file's own lists (train_filenames, val_filenames, test_filenames)".to_owned(),
    );
    Ok(())
}

/// JSON as Python writes it: `NaN` and `Infinity` outside of texts become `null`, which is no number either.
fn without_nan(json: &str) -> String {
    let mut out = String::with_capacity(json.len());
    let mut rest = json;
    while let Some(at) = rest.find(['"', 'N', 'I', '-']) {
        let (before, from) = rest.split_at(at);
        out.push_str(before);
        rest = if let Some(inside) = from.strip_prefix('"') {
            let mut is_escaped = false;
            let end = inside
                .find(|c| {
                    let is_end = c == '"' && !is_escaped;
                    is_escaped = c == '\\' && !is_escaped;
                    is_end
                })
                .map_or(from.len(), |end| end + 2);
            let (text, after) = from.split_at(end);
            out.push_str(text);
            after
        } else if let Some(after) = ["NaN", "Infinity", "-Infinity", "-NaN"]
            .iter()
            .find_map(|token| from.strip_prefix(token))
        {
            out.push_str("null");
            after
        } else {
            let (one, after) = from.split_at(1);
            out.push_str(one);
            after
        };
    }
    out.push_str(rest);
    out
}

/// What nerfstudio did to the source's world: x' = s (A x + a), with `applied_transform` [A a] and `applied_scale` s.
struct Applied {
    /// World of the source from that of the file; its block may be scaled.
    source_from_file: Matrix4<f64>,
    has_transform: bool,
    /// Size in the file by size in the source.
    scale: f64,
}

impl Applied {
    fn read(root: &Value, path: &Path) -> Result<Self, DatasetError> {
        let missing = |what: String| DatasetError::missing(path, what);
        let scale = match root.get("applied_scale") {
            None | Some(Value::Null) => 1.0,
            Some(value) => value
                .as_f64()
                .filter(|s| *s > 0.0 && s.is_finite())
                .ok_or_else(|| {
                    missing(format!("`applied_scale` is {value}, not a positive number"))
                })?,
        };
        let (file_from_source, has_transform) = match root.get("applied_transform") {
            None | Some(Value::Null) => (Matrix4::identity(), false),
            Some(value) => (
                matrix(value)
                    .ok_or_else(|| missing("`applied_transform` is no 3x4 matrix".to_owned()))?,
                true,
            ),
        };
        let mut file_from_source = file_from_source;
        file_from_source
            .fixed_view_mut::<3, 4>(0, 0)
            .scale_mut(scale);
        let scale = file_from_source
            .fixed_view::<3, 3>(0, 0)
            .determinant()
            .cbrt();
        let source_from_file = file_from_source
            .try_inverse()
            .filter(|m| scale > 0.0 && m.iter().all(|v| v.is_finite()))
            .ok_or_else(|| {
                missing(
                    "`applied_transform` with `applied_scale` cannot be undone: its determinant is not positive"
                        .to_owned(),
                )
            })?;
        Ok(Self {
            source_from_file,
            has_transform,
            scale,
        })
    }

    /// For the table: what was done.
    fn note(&self) -> Option<String> {
        let is_scaled = (self.scale - 1.0).abs() > 1e-9;
        let what = match (self.has_transform, is_scaled) {
            (false, false) => return None,
            (true, false) => "applied_transform".to_owned(),
            (false, true) => format!("applied_scale {:.6}", self.scale),
            (true, true) => format!("applied_transform and applied_scale {:.6}", self.scale),
        };
        Some(format!(
            "{what} undone: coordinates and lengths are those of the source"
        ))
    }

    /// A camera in the world of the source: its position goes through the whole similarity, its axes turn only.
    fn undone(&self, world_from_cam: &Matrix4<f64>) -> Matrix4<f64> {
        let mut placed = self.source_from_file * world_from_cam;
        placed.fixed_view_mut::<3, 3>(0, 0).scale_mut(self.scale);
        placed
    }
}

/// A 3x4 or 4x4 list of rows of finite numbers.
fn matrix(value: &Value) -> Option<Matrix4<f64>> {
    let rows = value.as_array()?;
    if rows.len() != 3 && rows.len() != 4 {
        return None;
    }
    let mut m = Matrix4::identity();
    for (i, row) in rows.iter().enumerate() {
        let row = row.as_array().filter(|r| r.len() == 4)?;
        for (j, v) in row.iter().enumerate() {
            m[(i, j)] = v.as_f64().filter(|v| v.is_finite())?;
        }
    }
    Some(m)
}

fn camera_of(root: &Value, frame: &Value, size: (u32, u32)) -> Result<Camera, String> {
    let record = record_of(root, frame, size)?;
    expressed(&record).map_err(|e| e.to_string())
}

/// Intrinsics of a frame; each value may stand in the frame or at the top.
fn record_of(root: &Value, frame: &Value, size: (u32, u32)) -> Result<CameraRecord, String> {
    let get = |key: &str| frame.get(key).or_else(|| root.get(key));
    let number = |key: &str| get(key).and_then(Value::as_f64);
    let side = |key: &str, from_picture: u32| match number(key) {
        None => Ok(from_picture),
        Some(v) if v >= 1.0 && v <= f64::from(u32::MAX) && v.fract() == 0.0 => Ok(v as u32),
        Some(v) => Err(format!("`{key}` is {v}")),
    };
    let (width, height) = (side("w", size.0)?, side("h", size.1)?);
    let from_angle =
        |key: &str, side: u32| number(key).map(|angle| 0.5 * f64::from(side) / (0.5 * angle).tan());
    let fx = number("fl_x")
        .or_else(|| from_angle("camera_angle_x", width))
        .ok_or("neither `fl_x` nor `camera_angle_x`")?;
    let fy = number("fl_y")
        .or_else(|| from_angle("camera_angle_y", height))
        .unwrap_or(fx);
    let cx = number("cx").unwrap_or(0.5 * f64::from(width));
    let cy = number("cy").unwrap_or(0.5 * f64::from(height));
    let k = |key: &str| number(key).unwrap_or(0.0);
    let name = get("camera_model")
        .and_then(Value::as_str)
        .unwrap_or("OPENCV");
    let is_fisheye =
        name == "OPENCV_FISHEYE" || get("is_fisheye").and_then(Value::as_bool).unwrap_or(false);
    let (model, params) = match name {
        _ if is_fisheye => (
            "OPENCV_FISHEYE",
            vec![fx, fy, cx, cy, k("k1"), k("k2"), k("k3"), k("k4")],
        ),
        "OPENCV" | "PINHOLE" | "SIMPLE_PINHOLE" | "RADIAL" | "SIMPLE_RADIAL" => {
            let distortion = [k("k1"), k("k2"), k("p1"), k("p2")];
            // The fourth radial number is a polynomial's, not that of FULL_OPENCV's denominator.
            if k("k4") != 0.0 {
                return Err(format!("camera model {name} with a `k4` is not supported"));
            }
            if k("k3") != 0.0 {
                (
                    "FULL_OPENCV",
                    [
                        &[fx, fy, cx, cy],
                        &distortion[..],
                        &[k("k3"), 0.0, 0.0, 0.0],
                    ]
                    .concat(),
                )
            } else if distortion == [0.0; 4] {
                ("PINHOLE", vec![fx, fy, cx, cy])
            } else {
                ("OPENCV", [&[fx, fy, cx, cy], &distortion[..]].concat())
            }
        }
        other => return Err(format!("camera model {other} is not supported")),
    };
    Ok(CameraRecord {
        model: model.to_owned(),
        width,
        height,
        params,
    })
}
