//! The relocalizer as JavaScript sees it.

use crate::error::{Code, from_create, from_session, js_error};
use crate::frame::{camera_from, intrinsics_of, pixel_format, pose_from};
use crate::gpu;
use crate::result::{encode, encode_explained};
use crate::{performance_now, units_name};
use landline::geometry::{CamFromWorld, Camera};
use landline::image::FrameView;
use landline::pose::Gravity;
use landline::relocalizer::{Begun, CameraSource, CreateError, LiveOptions, Observed, Relocalizer};
use landline::scene_file::{ExtractorFile, MAX_WORKING_SIDE, SceneFile, TensorFile};
use landline::session::{Session, SessionQuery, Smoothing};
use nalgebra::Vector3;
use serde::Deserialize;
use wasm_bindgen::JsValue;
use wasm_bindgen::prelude::wasm_bindgen;

/// Options that JavaScript passes as JSON; those left out keep their value.
#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub(crate) struct Options {
    smoothing: Option<String>,
    max_side: Option<f64>,
    time_budget_ms: Option<f64>,
    seed: Option<f64>,
    max_point_error_px: Option<f64>,
    max_line_error_px: Option<f64>,
}

impl Options {
    pub(crate) fn parse(json: &str) -> Result<Self, JsValue> {
        let options: Self = serde_json::from_str(json)
            .map_err(|e| js_error(Code::BadInput, &format!("options: {e}")))?;
        if let Some(side) = options.max_side
            && !((1.0..=f64::from(MAX_WORKING_SIDE)).contains(&side) && side.fract() == 0.0)
        {
            let message = format!(
                "option maxSide is {side}; it must be a whole number of pixels up to {MAX_WORKING_SIDE}"
            );
            return Err(js_error(Code::BadInput, &message));
        }
        if let Some(seed) = options.seed
            && !((0.0..9.1e15).contains(&seed) && seed.fract() == 0.0)
        {
            let message =
                format!("option seed is {seed}; it must be a whole number that is not negative");
            return Err(js_error(Code::BadInput, &message));
        }
        if let Some(name) = &options.smoothing {
            smoothing(name)?;
        }
        Ok(options)
    }

    pub(crate) fn smoothing(&self) -> Option<Smoothing> {
        self.smoothing
            .as_deref()
            .and_then(|name| smoothing(name).ok())
    }

    pub(crate) fn max_side(&self) -> Option<usize> {
        self.max_side.map(|side| side as usize)
    }

    pub(crate) fn apply(&self, to: &mut LiveOptions) {
        if let Some(budget) = self.time_budget_ms {
            to.pose.time_budget_ms = Some(budget);
        }
        if let Some(seed) = self.seed {
            to.pose.seed = seed as u64;
        }
        if let Some(error) = self.max_point_error_px {
            to.pose.max_point_error_px = error;
        }
        if let Some(error) = self.max_line_error_px {
            to.pose.max_line_error_px = error;
        }
    }

    /// Changes a session's options; nothing has changed after an error.
    pub(crate) fn change(&self, session: &mut Session) -> Result<(), JsValue> {
        let core = session.relocalizer_mut();
        let mut live = core.options().live;
        self.apply(&mut live);
        live.check().map_err(|e| from_create(&e))?;
        if let Some(side) = self.max_side() {
            core.set_max_side(side).map_err(|e| from_create(&e))?;
        }
        core.set_live(live).map_err(|e| from_create(&e))?;
        if let Some(smoothing) = self.smoothing() {
            session.set_smoothing(smoothing);
        }
        Ok(())
    }
}

pub(crate) fn out_of_order(step: &str) -> JsValue {
    js_error(Code::BadInput, &format!("no frame was {step} before"))
}

fn smoothing(name: &str) -> Result<Smoothing, JsValue> {
    match name {
        "off" => Ok(Smoothing::Off),
        "steady" => Ok(Smoothing::Steady),
        "responsive" => Ok(Smoothing::Responsive),
        other => {
            let message =
                format!("option smoothing is {other:?}; it must be off, steady or responsive");
            Err(js_error(Code::BadInput, &message))
        }
    }
}

/// Where intrinsics come from, by the code that `engine.ts` has for it.
pub(crate) fn camera_source(code: u8) -> CameraSource {
    match code {
        1 => CameraSource::Track,
        2 => CameraSource::Exif,
        _ => CameraSource::Given,
    }
}

/// [`SessionQuery`] of a frame that is under way.
#[derive(Debug)]
pub(crate) struct OwnedQuery {
    pub(crate) camera: Option<Camera>,
    pub(crate) camera_source: CameraSource,
    pub(crate) camera_name: String,
    pub(crate) timestamp_ms: f64,
    pub(crate) tracking: bool,
    pub(crate) gravity: Option<Gravity>,
    pub(crate) prior: Option<CamFromWorld>,
}

impl OwnedQuery {
    pub(crate) fn borrow(&self) -> SessionQuery<'_> {
        SessionQuery {
            camera: self.camera,
            camera_source: self.camera_source,
            camera_name: &self.camera_name,
            timestamp_ms: self.timestamp_ms,
            tracking: self.tracking,
            gravity: self.gravity,
            prior: self.prior,
        }
    }
}

/// Finds cameras in one scene. A frame takes `begin`, `observe` and `solve`; the next may be begun before the last of them,
/// so that a device works while the pose is solved.
#[wasm_bindgen]
#[derive(Debug)]
pub struct RawRelocalizer {
    session: Session,
    info: String,
    frame: Vec<u8>,
    begun: Option<(Begun, OwnedQuery)>,
    observed: Option<(Observed, OwnedQuery)>,
    result: Vec<f64>,
    /// Why the networks did not start on the GPU, if they did not.
    backend_reason: Option<String>,
}

#[wasm_bindgen]
impl RawRelocalizer {
    /// Builds the networks from the bytes of the two files.
    ///
    /// # Errors
    /// A JavaScript `Error` with a `code`.
    pub async fn create(
        extractor: Vec<u8>,
        scene: Vec<u8>,
        device: String,
        options: String,
    ) -> Result<RawRelocalizer, JsValue> {
        let options = Options::parse(&options)?;
        let device = gpu::device(&device).ok_or_else(|| {
            let message = format!("device {device:?} is unknown; it must be auto, webgpu or cpu");
            js_error(Code::BadInput, &message)
        })?;
        // wasm memory never shrinks, so what is alive at once decides how much the page keeps: the bytes go as soon as
        // they are read, and the weights are copied only for a device.
        let scene_file =
            SceneFile::from_bytes(&scene).map_err(|e| from_create(&CreateError::Scene(e)))?;
        let info = scene_card(&scene_file, &scene)?;
        drop(scene);
        let extractor_file = ExtractorFile::from_bytes(&extractor)
            .map_err(|e| from_create(&CreateError::Extractor(e)))?;
        drop(extractor);
        let ruled_out = gpu::ruled_out(device);
        let for_device = ruled_out
            .is_none()
            .then(|| (scene_file.clone(), extractor_file.clone()));
        let mut core = Relocalizer::new(scene_file, extractor_file, |to| {
            to.front_end.max_side = options.max_side().unwrap_or(to.front_end.max_side);
            options.apply(&mut to.live);
        })
        .map_err(|e| from_create(&e))?;
        let backend_reason = match for_device {
            Some((scene, extractor)) => core
                .place(device, &scene, &extractor, Some(gpu::timer()))
                .await
                .err()
                .map(|error| error.to_string()),
            None => ruled_out,
        };
        let mut session = Session::new(core);
        session.set_smoothing(options.smoothing().unwrap_or_default());
        Ok(Self {
            session,
            info,
            frame: Vec::new(),
            begun: None,
            observed: None,
            result: Vec::new(),
            backend_reason,
        })
    }

    /// What the scene file says about itself, as JSON.
    #[wasm_bindgen(js_name = sceneInfo)]
    #[must_use]
    pub fn scene_info(&self) -> String {
        self.info.clone()
    }

    /// What executes the networks.
    #[must_use]
    pub fn backend(&self) -> String {
        let on_gpu = self.session.relocalizer().gpu().is_some();
        if on_gpu { "webgpu" } else { "cpu" }.to_owned()
    }

    /// Why not something faster.
    #[wasm_bindgen(js_name = backendReason)]
    #[must_use]
    pub fn backend_reason(&self) -> String {
        let core = self.session.relocalizer();
        let why = core.gpu_failure().or(self.backend_reason.as_deref());
        match (why, core.gpu()) {
            (Some(why), _) => why.to_owned(),
            (None, Some(gpu)) => gpu.device().adapter_name(),
            (None, None) => String::new(),
        }
    }

    /// Makes room for a frame; its address in the engine's memory, valid until the next call.
    #[wasm_bindgen(js_name = frameBuffer)]
    pub fn frame_buffer(&mut self, len: usize) -> usize {
        self.frame.resize(len, 0);
        self.frame.as_mut_ptr() as usize
    }

    /// First step: takes the frame that was written into the buffer. `intrinsics` is empty or fx, fy, cx, cy; `gravity` is
    /// empty or a direction in the camera and its standard deviation in radians; `prior` is empty or 16 numbers, row-major.
    ///
    /// # Errors
    /// A JavaScript `Error` with a `code`.
    #[expect(
        clippy::too_many_arguments,
        reason = "flat numbers cross the border without making objects"
    )]
    pub async fn begin(
        &mut self,
        width: u32,
        height: u32,
        stride: usize,
        format: u8,
        intrinsics: Vec<f64>,
        source: u8,
        timestamp_ms: f64,
        camera_name: String,
        tracking: bool,
        gravity: Vec<f64>,
        prior: Vec<f64>,
    ) -> Result<(), JsValue> {
        self.begun = None;
        let format = pixel_format(format)?;
        let frame = FrameView {
            bytes: &self.frame,
            width,
            height,
            stride,
            format,
        };
        let query = OwnedQuery {
            camera: camera_from(width, height, &intrinsics)?,
            camera_source: camera_source(source),
            camera_name,
            timestamp_ms,
            tracking,
            gravity: self.gravity(&gravity)?,
            prior: pose_from(&prior)?,
        };
        let begun = self
            .session
            .begin(&frame, &query.borrow(), &mut performance_now)
            .await
            .map_err(|e| from_session(&e))?;
        self.begun = Some((begun, query));
        Ok(())
    }

    /// Second step: segments and networks.
    ///
    /// # Errors
    /// A JavaScript `Error` with a `code`.
    pub async fn observe(&mut self) -> Result<(), JsValue> {
        let (begun, query) = self.begun.take().ok_or_else(|| out_of_order("begun"))?;
        let observed = self
            .session
            .observe(begun, &mut performance_now)
            .await
            .map_err(|e| from_session(&e))?;
        self.observed = Some((observed, query));
        Ok(())
    }

    /// Third step: the pose, as numbers at [`Self::result_address`]. With `explain` a frame that is not located or little sure, and
    /// after which no other was begun, is tried with another focal length, in a mirror and turned by quarters, for a better reason.
    ///
    /// # Errors
    /// A JavaScript `Error` with a `code`.
    pub fn solve(&mut self, include: u32, explain: bool) -> Result<(), JsValue> {
        let (observed, query) = self
            .observed
            .take()
            .ok_or_else(|| out_of_order("observed"))?;
        let report = self
            .session
            .solve(observed, &query.borrow(), &mut performance_now)
            .map_err(|e| from_session(&e))?;
        encode(
            self.session.relocalizer(),
            &report,
            include,
            &mut self.result,
        );
        if explain {
            let report = self
                .session
                .explain(&query.borrow(), &report)
                .map_err(|e| from_session(&e))?;
            encode_explained(&report, &mut self.result);
        }
        Ok(())
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
        Options::parse(options)?.change(&mut self.session)
    }

    /// Takes over what an earlier session learned of a camera.
    ///
    /// # Errors
    /// A JavaScript `Error` with a `code`.
    #[wasm_bindgen(js_name = recallCamera)]
    pub fn recall_camera(&mut self, name: &str, focal_per_width: f64) -> Result<(), JsValue> {
        self.session
            .recall_camera(name, focal_per_width)
            .map_err(|e| from_session(&e))
    }

    /// Forgets where the camera was.
    pub fn reset(&mut self) {
        self.session.reset();
    }
}

/// Gravity as a sensor tells it; which way it is in the world is still to be said.
pub(crate) fn gravity_from(numbers: &[f64]) -> Result<Option<Gravity>, JsValue> {
    match numbers {
        [] => Ok(None),
        &[x, y, z, sigma_rad] => {
            let in_cam = Vector3::new(x, y, z);
            if !(in_cam.norm() > 1e-6 && in_cam.norm().is_finite() && sigma_rad > 0.0) {
                let message = format!("gravity is ({x}, {y}, {z}), known to {sigma_rad} radians");
                return Err(js_error(Code::BadInput, &message));
            }
            Ok(Some(Gravity {
                in_cam,
                in_world: Vector3::zeros(),
                sigma_rad,
            }))
        }
        _ => Err(js_error(
            Code::BadInput,
            "gravity takes three numbers and a deviation",
        )),
    }
}

impl RawRelocalizer {
    /// Gravity as the solver takes it; `None` where the scene does not know its own.
    fn gravity(&self, numbers: &[f64]) -> Result<Option<Gravity>, JsValue> {
        let in_world = self.session.relocalizer().scene_info().gravity;
        let told = gravity_from(numbers)?.zip(in_world);
        Ok(told.map(|(gravity, in_world)| Gravity {
            in_world,
            ..gravity
        }))
    }
}

/// The `SceneInfo` of `web/ts/types.ts`, of a scene file and its bytes.
fn scene_card(scene: &SceneFile, bytes: &[u8]) -> Result<String, JsValue> {
    let file = TensorFile::parse(bytes).map_err(|e| from_create(&CreateError::Scene(e)))?;
    let info = &scene.info;
    let camera = info.camera.as_ref().map(intrinsics_of);
    let up = info
        .gravity
        .map(|g| serde_json::json!({ "x": -g.x, "y": -g.y, "z": -g.z }));
    let held_out = info.training.as_ref().and_then(|t| t.held_out).map(|h| {
        let mut json =
            serde_json::json!({ "pictures": h.num_images, "notLocated": h.num_not_located });
        let known = [
            ("medianPosition", h.median_position),
            ("medianRotationDeg", h.median_rotation_deg),
            ("recall5cm5deg", h.recall_5cm_5deg),
        ];
        add(
            &mut json,
            known.map(|(key, value)| (key, value.map(Into::into))),
        );
        json
    });
    let mut json = serde_json::json!({
        "variant": scene.config.variant().name(),
        "preset": info.preset.map_or("custom", |p| p.name()),
        "extractor": info.extractor.name(),
        "units": units_name(info.units),
        "licence": info.licence,
        "created": info.created.as_ref().map_or_else(String::new, ToString::to_string),
        "bytes": bytes.len(),
        "metadata": file.metadata(),
    });
    add(
        &mut json,
        [("camera", camera), ("up", up), ("heldOut", held_out)],
    );
    Ok(json.to_string())
}

/// Adds what is there to a JSON object.
fn add<const N: usize>(
    json: &mut serde_json::Value,
    fields: [(&str, Option<serde_json::Value>); N],
) {
    if let Some(map) = json.as_object_mut() {
        let known = fields
            .into_iter()
            .filter_map(|(key, v)| Some((key.to_owned(), v?)));
        map.extend(known);
    }
}
