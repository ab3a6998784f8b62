//! A place of many rooms as JavaScript sees it.

use crate::error::{Code, from_create, from_session, js_error};
use crate::frame::{camera_from, pixel_format};
use crate::relocalizer::{Options, OwnedQuery, camera_source, gravity_from, out_of_order};
use crate::result::encode;
use crate::{performance_now, units_name};
use landline::image::FrameView;
use landline::place::{Place, PlaceError, PlaceIndex, PlaceManifest, PlaceOptions, PlaceReport};
use landline::relocalizer::CreateError;
use landline::scene_file::{ExtractorFile, SceneFile, SceneFileError};
use wasm_bindgen::JsValue;
use wasm_bindgen::prelude::wasm_bindgen;

/// Finds cameras in a place of many rooms. JavaScript brings the scenes that are wanted, and resumes. The networks run on the
/// CPU.
#[wasm_bindgen]
#[derive(Debug)]
pub struct RawPlace {
    place: Place,
    frame: Vec<u8>,
    query: Option<OwnedQuery>,
    result: Vec<f64>,
}

#[wasm_bindgen]
impl RawPlace {
    /// From the bytes of the extractor, of the manifest and of its index; `max_bytes` bounds the scenes that are held.
    ///
    /// # Errors
    /// A JavaScript `Error` with a `code`.
    pub fn create(
        extractor: Vec<u8>,
        manifest: &str,
        index: &[u8],
        max_bytes: f64,
        options: &str,
    ) -> Result<RawPlace, JsValue> {
        let options = Options::parse(options)?;
        let extractor_file = ExtractorFile::from_bytes(&extractor)
            .map_err(|e| from_create(&CreateError::Extractor(e)))?;
        drop(extractor);
        let manifest = PlaceManifest::from_json(manifest).map_err(|e| from_place(&e))?;
        let index = PlaceIndex::from_bytes(index).map_err(|e| from_place(&e))?;
        let usual = PlaceOptions::default();
        let bounds = PlaceOptions {
            max_bytes: if max_bytes > 0.0 {
                max_bytes as usize
            } else {
                usual.max_bytes
            },
            ..usual
        };
        let mut place = Place::new(manifest, index, extractor_file, bounds, |to| {
            to.front_end.max_side = options.max_side().unwrap_or(to.front_end.max_side);
            options.apply(&mut to.live);
        })
        .map_err(|e| from_place(&e))?;
        place
            .session_mut()
            .set_smoothing(options.smoothing().unwrap_or_default());
        Ok(Self {
            place,
            frame: Vec::new(),
            query: None,
            result: Vec::new(),
        })
    }

    /// Makes room for a frame; its address in the engine's memory, valid until the next call.
    #[wasm_bindgen(js_name = frameBuffer)]
    pub fn frame_buffer(&mut self, len: usize) -> usize {
        self.frame.resize(len, 0);
        self.frame.as_mut_ptr() as usize
    }

    /// Locates the frame that was written into the buffer, in the rooms that are at hand: JSON of the room, what is wanted, and
    /// more; the answer as numbers at [`Self::result_address`].
    ///
    /// # Errors
    /// A JavaScript `Error` with a `code`.
    #[expect(
        clippy::too_many_arguments,
        reason = "flat numbers cross the border without making objects"
    )]
    pub fn locate(
        &mut self,
        width: u32,
        height: u32,
        stride: usize,
        format: u8,
        intrinsics: &[f64],
        source: u8,
        timestamp_ms: f64,
        camera_name: String,
        tracking: bool,
        gravity: &[f64],
        include: u32,
    ) -> Result<String, JsValue> {
        self.query = None;
        let frame = FrameView {
            bytes: &self.frame,
            width,
            height,
            stride,
            format: pixel_format(format)?,
        };
        let query = OwnedQuery {
            camera: camera_from(width, height, intrinsics)?,
            camera_source: camera_source(source),
            camera_name,
            timestamp_ms,
            tracking,
            gravity: gravity_from(gravity)?,
            prior: None,
        };
        let report = self
            .place
            .locate(&frame, &query.borrow(), &mut performance_now)
            .map_err(|e| from_place(&e))?;
        self.query = Some(query);
        Ok(self.answer(&report, include))
    }

    /// Answers the last frame anew, with the rooms that have come since.
    ///
    /// # Errors
    /// A JavaScript `Error` with a `code`.
    pub fn resume(&mut self, include: u32) -> Result<String, JsValue> {
        let query = self.query.as_ref().ok_or_else(|| out_of_order("located"))?;
        let report = self
            .place
            .resume(&query.borrow(), &mut performance_now)
            .map_err(|e| from_place(&e))?
            .ok_or_else(|| out_of_order("located"))?;
        Ok(self.answer(&report, include))
    }

    /// Takes the scene of a room.
    ///
    /// # Errors
    /// A JavaScript `Error` with a `code`.
    #[wasm_bindgen(js_name = putRoom)]
    pub fn put_room(&mut self, id: &str, scene: Vec<u8>) -> Result<(), JsValue> {
        let room = self.place.manifest().position(id);
        let room =
            room.ok_or_else(|| js_error(Code::BadInput, &format!("there is no room {id:?}")))?;
        let file =
            SceneFile::from_bytes(&scene).map_err(|e| from_create(&CreateError::Scene(e)))?;
        drop(scene);
        self.place.put_room(room, file).map_err(|e| from_place(&e))
    }

    /// Bytes of the scenes at hand.
    #[wasm_bindgen(js_name = heldBytes)]
    #[must_use]
    pub fn held_bytes(&self) -> f64 {
        self.place.num_bytes() as f64
    }

    /// Address of the last result's numbers, valid until the next call.
    #[wasm_bindgen(js_name = resultAddress)]
    #[must_use]
    pub fn result_address(&self) -> usize {
        self.result.as_ptr() as usize
    }

    /// How many numbers there are.
    #[wasm_bindgen(js_name = resultLength)]
    #[must_use]
    pub fn result_length(&self) -> usize {
        self.result.len()
    }

    /// Changes options, given as JSON.
    ///
    /// # Errors
    /// A JavaScript `Error` with a `code`; nothing has changed then.
    #[wasm_bindgen(js_name = setOptions)]
    pub fn set_options(&mut self, options: &str) -> Result<(), JsValue> {
        Options::parse(options)?.change(self.place.session_mut())
    }

    /// Takes over what an earlier session learned of a camera.
    ///
    /// # Errors
    /// A JavaScript `Error` with a `code`.
    #[wasm_bindgen(js_name = recallCamera)]
    pub fn recall_camera(&mut self, name: &str, focal_per_width: f64) -> Result<(), JsValue> {
        let session = self.place.session_mut();
        let recalled = session.recall_camera(name, focal_per_width);
        recalled.map_err(|e| from_session(&e))
    }

    /// Forgets which room the camera is in.
    pub fn reset(&mut self) {
        self.place.leave();
    }
}

impl RawPlace {
    fn answer(&mut self, report: &PlaceReport, include: u32) -> String {
        let relocalizer = self.place.session().relocalizer();
        encode(relocalizer, &report.session, include, &mut self.result);
        let rooms = &self.place.manifest().rooms;
        let id = |room: usize| rooms.get(room).map(|r| r.id.as_str());
        let units = units_name(relocalizer.scene_info().units);
        let wanted: Vec<&str> = self.place.wanted().iter().filter_map(|r| id(*r)).collect();
        let prefetch: Vec<&str> = self.place.to_prefetch().filter_map(id).collect();
        serde_json::json!({
            "room": report.room.and_then(id),
            "rivals": report.rival.map(|pair| pair.map(|r| id(r).unwrap_or_default())),
            "hasEntered": report.has_entered,
            "wanted": wanted,
            "prefetch": prefetch,
            "cameraFromPlace": report.cam_from_place.map(|pose| pose.to_row_major()),
            "units": units,
        })
        .to_string()
    }
}

fn from_place(error: &PlaceError) -> JsValue {
    let code = match error {
        PlaceError::Create(error) | PlaceError::Scene { source: error, .. } => {
            return from_create(error);
        }
        PlaceError::Session(error) => return from_session(error),
        PlaceError::Version { .. } | PlaceError::Index(SceneFileError::Version { .. }) => {
            Code::SceneVersion
        }
        PlaceError::Differs { .. } => Code::SceneExtractor,
        PlaceError::NoRoom { .. } => Code::BadInput,
        _ => Code::SceneCorrupt,
    };
    js_error(code, &error.to_string())
}
