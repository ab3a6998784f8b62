//! What comes with a frame, as flat numbers.

use crate::error::{Code, js_error};
use landline::geometry::{CamFromWorld, Camera, CameraModel};
use landline::image::PixelFormat;
use nalgebra::{Matrix3, Vector3};
use serde_json::{Value, json};
use wasm_bindgen::JsValue;

/// The codes of `web/ts/pixels.ts`.
pub(crate) fn pixel_format(code: u8) -> Result<PixelFormat, JsValue> {
    match code {
        0 => Ok(PixelFormat::Luma8),
        1 => Ok(PixelFormat::Rgba8),
        2 => Ok(PixelFormat::Rgb8),
        other => Err(js_error(
            Code::BadInput,
            &format!("pixel format {other} is unknown"),
        )),
    }
}

/// A camera from fx, fy, cx, cy; `None` for none of them.
pub(crate) fn camera_from(
    width: u32,
    height: u32,
    intrinsics: &[f64],
) -> Result<Option<Camera>, JsValue> {
    let model = match *intrinsics {
        [] => return Ok(None),
        [fx, fy, cx, cy] => CameraModel::Pinhole { fx, fy, cx, cy },
        _ => {
            let message = format!(
                "intrinsics have {} numbers instead of fx, fy, cx, cy",
                intrinsics.len()
            );
            return Err(js_error(Code::BadInput, &message));
        }
    };
    Ok(Some(Camera {
        width,
        height,
        model,
    }))
}

/// A pose from its row-major matrix; `None` for an empty one.
pub(crate) fn pose_from(m: &[f64]) -> Result<Option<CamFromWorld>, JsValue> {
    if m.is_empty() {
        return Ok(None);
    }
    let at = |r: usize, c: usize| m.get(4 * r + c).copied().unwrap_or(f64::NAN);
    let rotation = Matrix3::from_fn(at);
    let translation = Vector3::new(at(0, 3), at(1, 3), at(2, 3));
    let off = (rotation * rotation.transpose() - Matrix3::identity()).amax();
    if !(off < 1e-4 && rotation.determinant() > 0.0 && translation.norm().is_finite()) {
        let message = format!("the given pose is no rigid transform: its rotation is off by {off}");
        return Err(js_error(Code::BadInput, &message));
    }
    Ok(Some(CamFromWorld::new(rotation, translation)))
}

/// The `Intrinsics` of `web/ts/types.ts`, of a camera without its distortion.
pub(crate) fn intrinsics_of(camera: &Camera) -> Value {
    let (fx, fy) = camera.focal_px();
    let c = camera.principal_point();
    json!({ "fx": fx, "fy": fy, "cx": c.x, "cy": c.y, "width": camera.width, "height": camera.height })
}
