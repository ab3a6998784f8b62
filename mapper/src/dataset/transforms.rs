//! `transforms.json` of nerfstudio and instant-ngp: world from camera, OpenGL camera axes (y up, z backward).
//!
//! `applied_transform`, by which nerfstudio turned the world, is undone, so that the scene keeps the coordinates of its
//! source. Nerfstudio's pixels are corner-based, as ours.

use super::camera::expressed;
use super::pictures::Pictures;
use super::pose_check::rigid_from_matrix;
use super::{Dataset, DatasetError, DatasetImage, Split};
use landline::geometry::{CameraRecord, WorldFromCam};
use nalgebra::{Matrix3, Matrix4};
use serde_json::Value;
use std::collections::HashSet;
use std::path::Path;

/// Reads the file.
pub(super) fn read(path: &Path, pictures: &Pictures) -> Result<Dataset, DatasetError> {
    let bytes = std::fs::read(path).map_err(DatasetError::io(path))?;
    let root: Value = serde_json::from_slice(&bytes)
        .map_err(|e| DatasetError::parse(path, format!("line {}", e.line()), e))?;
    let frames = root
        .get("frames")
        .and_then(Value::as_array)
        .ok_or_else(|| DatasetError::missing(path, "it has no list `frames`"))?;
    let mut dataset = Dataset::empty("transforms.json");
    dataset.sources.push(path.to_owned());
    let undo = match root.get("applied_transform") {
        None => Matrix4::identity(),
        Some(value) => {
            let applied = matrix(value).ok_or_else(|| {
                DatasetError::missing(path, "`applied_transform` is no 3x4 matrix")
            })?;
            dataset
                .notes
                .push("applied_transform undone: coordinates are those of the source".to_owned());
            applied.try_inverse().ok_or_else(|| {
                DatasetError::missing(path, "`applied_transform` cannot be inverted")
            })?
        }
    };
    let listed = |key: &str| -> HashSet<&str> {
        root.get(key)
            .and_then(Value::as_array)
            .into_iter()
            .flatten()
            .filter_map(Value::as_str)
            .collect()
    };
    let tests = listed("test_filenames");
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
        let name = name.trim_start_matches("./");
        let Some(transform) = frame.get("transform_matrix").and_then(matrix) else {
            dataset.drop_image(name, "no 4x4 `transform_matrix` of finite numbers");
            continue;
        };
        let placed = undo * transform;
        // OpenGL camera axes to ours: y and z change sign.
        let block: Matrix3<f64> =
            placed.fixed_view::<3, 3>(0, 0) * Matrix3::from_diagonal(&[1.0, -1.0, -1.0].into());
        let translation = placed.fixed_view::<3, 1>(0, 3).into_owned();
        let world_from_cam: WorldFromCam = match rigid_from_matrix(&block, translation) {
            Ok(t) => t,
            Err(problem) => {
                dataset.drop_image(name, format!("pose: {problem}"));
                continue;
            }
        };
        let Some((name, file, size)) = pictures.find_with_extension(name, &mut dataset) else {
            continue;
        };
        let record = match camera(&root, frame, size) {
            Ok(record) => record,
            Err(reason) => {
                dataset.drop_image(name, reason);
                continue;
            }
        };
        let camera = match expressed(&record) {
            Ok(camera) => camera,
            Err(reason) => {
                dataset.drop_image(name, reason.to_string());
                continue;
            }
        };
        dataset.images.push(DatasetImage {
            split: if tests.contains(name.as_str()) {
                Split::Test
            } else {
                Split::Train
            },
            name,
            path: file,
            camera,
            cam_from_world: Some(world_from_cam.inverse()),
        });
    }
    Ok(dataset)
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

/// Intrinsics of a frame; each value may stand in the frame or at the top.
fn camera(root: &Value, frame: &Value, size: (u32, u32)) -> Result<CameraRecord, String> {
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
