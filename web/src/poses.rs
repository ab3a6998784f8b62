//! Poses that lie with pictures, for pages: the native tool's readers ([`landline::formats`]), with names and bytes in and JSON out.

use crate::error::{Code, js_error};
use crate::frame::intrinsics_of;
use landline::formats::known::{GivenFile, KnownPose, known_poses};
use serde::Deserialize;
use serde_json::{Value, json};
use wasm_bindgen::JsValue;
use wasm_bindgen::prelude::wasm_bindgen;

/// What there is, as JSON.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Given {
    /// Paths of the pictures.
    pictures: Vec<String>,
    /// The other files, in the order of their bytes.
    files: Vec<FileHead>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileHead {
    path: String,
    len: usize,
}

/// Poses of pictures out of the files that lie with them, `bytes` one after another: a `KnownPoses` of
/// `web/ts/mapper/types.ts` as JSON.
///
/// # Errors
/// A JavaScript `Error` with a `code` for a request that does not fit its bytes. A file that is damaged is no error: the
/// answer says so in a note.
#[wasm_bindgen(js_name = readPoses)]
pub fn read_poses(request: &str, bytes: &[u8]) -> Result<String, JsValue> {
    let bad = |what: &str| js_error(Code::BadInput, what);
    let given: Given = serde_json::from_str(request).map_err(|e| bad(&e.to_string()))?;
    let mut files = Vec::with_capacity(given.files.len());
    let mut rest = bytes;
    for FileHead { path, len } in given.files {
        let (own, others) = rest
            .split_at_checked(len)
            .ok_or_else(|| bad("fewer bytes than the files have"))?;
        rest = others;
        files.push(GivenFile {
            path,
            bytes: own.to_vec(),
        });
    }
    let known = known_poses(&given.pictures, files);
    let poses: Vec<Value> = known
        .of_pictures
        .iter()
        .map(|pose| pose.as_ref().map_or(Value::Null, described))
        .collect();
    Ok(json!({ "source": known.source, "notes": known.notes, "poses": poses }).to_string())
}

fn described(pose: &KnownPose) -> Value {
    let mut json = json!({ "cameraFromWorld": pose.cam_from_world.to_row_major() });
    if let Some(map) = json.as_object_mut() {
        if let Some(camera) = &pose.camera {
            map.insert("intrinsics".to_owned(), intrinsics_of(camera));
        }
        if let Some(focal) = pose.focal {
            map.insert("focal".to_owned(), focal.into());
        }
    }
    json
}
