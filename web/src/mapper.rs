//! The mapper as JavaScript sees it: frames in, a scene file out.

use crate::error::{Code, js_error};
use crate::frame::{camera_from, pixel_format, pose_from};
use crate::units_name;
use js_sys::{Function, Promise};
use landline::front_end::{FrontEnd, FrontEndError, FrontEndOptions};
use landline::geometry::{CamFromWorld, Camera, Pixel, WorkingFromSensor};
use landline::image::FrameView;
use landline::mapping::{
    Advice, Exposure, Film, FilmError, FilmMap, FilmParams, FrameCamera, FrameInfo, KeyframeParams,
    KnownDistance, NotKept, Origin, SceneRequest, Verdict,
};
use landline::reconstruction::motion::{LeftOut, MotionError};
use landline::reconstruction::{Observer, Pause, Stage};
use landline::scene_file::{ExtractorFile, Precision, Timestamp};
use nalgebra::Vector3;
use serde::Deserialize;
use serde_json::{Value, json};
use wasm_bindgen::prelude::wasm_bindgen;
use wasm_bindgen::{JsCast as _, JsValue};
use wasm_bindgen_futures::JsFuture;

/// Options of a mapper, as JSON; those left out have their usual value.
#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
struct Options {
    max_side: Option<usize>,
    max_keyframes: Option<usize>,
}

/// What a scene is to say, as JSON.
#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
struct Request {
    #[serde(default)]
    name: String,
    #[serde(default)]
    licence: String,
    created: Option<String>,
    scale: Option<Scale>,
    up: Option<[f64; 3]>,
}

/// A distance that somebody measured.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct Scale {
    from: End,
    to: End,
    metres: f64,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct End {
    keyframe: usize,
    x: f64,
    y: f64,
}

impl End {
    fn numbers(self) -> (usize, Pixel) {
        (self.keyframe, Pixel::new(self.x, self.y))
    }
}

fn bad_input(message: &str) -> JsValue {
    js_error(Code::BadInput, message)
}

fn parse<'de, T: Deserialize<'de>>(json: &'de str) -> Result<T, JsValue> {
    serde_json::from_str(json).map_err(|e| bad_input(&format!("options: {e}")))
}

fn from_film(error: &FilmError) -> JsValue {
    let code = match error {
        FilmError::TooFew { .. } | FilmError::Motion(MotionError::TooFew(_)) => {
            Code::NotEnoughPictures
        }
        FilmError::SomePoses { .. } => Code::BadInput,
        FilmError::Stopped => Code::Aborted,
        _ => Code::NoModel,
    };
    js_error(code, &error.to_string())
}

fn from_front_end(error: &FrontEndError) -> JsValue {
    let code = match error {
        FrontEndError::Extractor(_) | FrontEndError::Segments(_) => Code::EngineDefect,
        _ => Code::BadInput,
    };
    js_error(code, &error.to_string())
}

/// Tells JavaScript and listens to it.
struct JsObserver<'a> {
    tell: &'a Function,
    pause: &'a Function,
}

impl Observer for JsObserver<'_> {
    fn tell(&mut self, stage: Stage, done: usize, total: usize) -> bool {
        // Matching is the first half of the points, triangulation the second.
        let (done, total) = match stage {
            Stage::PosedMatch => (done, 2 * total),
            Stage::Points => (total + done, 2 * total),
            _ => (done, total),
        };
        let (name, done, total) = (stage_name(stage), done as f64, total as f64);
        let answer = self
            .tell
            .call3(&JsValue::NULL, &name.into(), &done.into(), &total.into());
        // A caller that throws wants no more.
        answer.is_ok_and(|stop| !stop.is_truthy())
    }

    fn pause(&mut self) -> Option<Pause> {
        let promise = self.pause.call0(&JsValue::NULL).ok()?;
        let promise = promise.dyn_into::<Promise>().ok()?;
        Some(Box::pin(async move {
            // Whether it was kept or broken, the pause is over.
            let _ = JsFuture::from(promise).await;
        }))
    }
}

/// The stages of `web/ts/mapper/types.ts`.
fn stage_name(stage: Stage) -> &'static str {
    match stage {
        Stage::Match => "pairs",
        Stage::Verify => "matching",
        Stage::Grow => "poses",
        Stage::Adjust => "refine",
        Stage::PosedMatch | Stage::Points => "points",
        Stage::Lines => "lines",
        Stage::Landmarks => "landmarks",
    }
}

fn reason_name(reason: NotKept) -> &'static str {
    match reason {
        NotKept::TooSimilar => "too-similar",
        NotKept::TooDark => "too-dark",
        NotKept::Blurred => "blurred",
        NotKept::TooFewFeatures => "too-few-features",
        NotKept::SizeChanged => "size-changed",
        NotKept::Full => "full",
    }
}

fn advice_name(advice: Advice) -> &'static str {
    match advice {
        Advice::MoveSideways => "move-sideways",
        Advice::Slower => "slower",
        Advice::MoreLight => "more-light",
        Advice::Enough => "enough",
    }
}

fn left_out_name(reason: LeftOut) -> &'static str {
    match reason {
        LeftOut::NothingInCommon => "nothing-in-common",
        LeftOut::OnlyTurned => "only-turned",
        LeftOut::TooFewPoints => "too-few-points",
        LeftOut::NoPose => "no-pose",
        LeftOut::OtherPiece => "other-piece",
    }
}

/// Makes a scene of a film.
#[wasm_bindgen]
#[derive(Debug)]
pub struct RawMapper {
    front_end: FrontEnd,
    film: Film,
    params: KeyframeParams,
    origin: Origin,
    /// Of the keyframes, which are all of one size.
    working_from_sensor: WorkingFromSensor,
    frame: Vec<u8>,
}

#[wasm_bindgen]
impl RawMapper {
    /// Takes the bytes of the extractor's file.
    ///
    /// # Errors
    /// A JavaScript `Error` with a `code`.
    pub fn create(extractor: &[u8], options: &str) -> Result<RawMapper, JsValue> {
        let options: Options = parse(options)?;
        let file = ExtractorFile::from_bytes(extractor)
            .map_err(|e| js_error(Code::ExtractorCorrupt, &e.to_string()))?;
        let mut front_end = FrontEndOptions::new(file.kind);
        front_end.max_side = options.max_side.unwrap_or(front_end.max_side);
        let usual = KeyframeParams::default();
        let params = KeyframeParams {
            max_keyframes: options.max_keyframes.unwrap_or(usual.max_keyframes),
            ..usual
        };
        let origin = Origin::of_extractor(&file, front_end.max_side as u32);
        let front_end = FrontEnd::new(file, front_end).map_err(|e| match e {
            FrontEndError::Extractor(_) => js_error(Code::ExtractorCorrupt, &e.to_string()),
            _ => bad_input(&e.to_string()),
        })?;
        Ok(Self {
            front_end,
            film: Film::new(params.clone()),
            params,
            origin,
            working_from_sensor: WorkingFromSensor::from_scale(1.0, 1.0),
            frame: Vec::new(),
        })
    }

    /// Makes room for a frame; its address in the engine's memory, valid until the next call.
    #[wasm_bindgen(js_name = frameBuffer)]
    pub fn frame_buffer(&mut self, len: usize) -> usize {
        self.frame.resize(len, 0);
        self.frame.as_mut_ptr() as usize
    }

    /// Takes the frame that was written into the buffer, or says why not: a `FrameVerdict` of `web/ts/mapper/types.ts` as JSON.
    /// `intrinsics` is empty or fx, fy, cx, cy; `pose` is empty or `cameraFromWorld`, row-major; `gravity` is empty or a
    /// direction in the camera.
    ///
    /// # Errors
    /// A JavaScript `Error` with a `code`; nothing was kept then.
    #[expect(
        clippy::too_many_arguments,
        reason = "flat numbers cross the border without making objects"
    )]
    #[wasm_bindgen(js_name = addFrame)]
    pub fn add_frame(
        &mut self,
        width: u32,
        height: u32,
        stride: usize,
        format: u8,
        intrinsics: &[f64],
        are_exact: bool,
        pose: &[f64],
        gravity: &[f64],
        name: String,
        is_chosen: bool,
    ) -> Result<String, JsValue> {
        let frame = FrameView {
            bytes: &self.frame,
            width,
            height,
            stride,
            format: pixel_format(format)?,
        };
        let camera = match camera_from(width, height, intrinsics)? {
            None => FrameCamera::Unknown,
            Some(camera) if are_exact => FrameCamera::Exact(camera),
            Some(camera) => FrameCamera::About(camera),
        };
        let cam_from_world = pose_from(pose)?;
        if cam_from_world.is_some() && !matches!(camera, FrameCamera::Exact(_)) {
            return Err(bad_input(
                "a frame has a pose but no intrinsics: poses are of no use without them",
            ));
        }
        let gravity_in_cam = match *gravity {
            [] => None,
            [x, y, z] => Some(Vector3::new(x, y, z)),
            _ => return Err(bad_input("gravity takes three numbers")),
        };
        let image = self
            .front_end
            .look(&frame)
            .map_err(|e| from_front_end(&e))?;
        let exposure = Exposure::of(&image);
        let working_size = (image.width as u32, image.height as u32);
        let verdict = match self.film.look((width, height), exposure, is_chosen) {
            Some(refused) => refused,
            None => {
                self.front_end
                    .run_looked_at()
                    .map_err(|e| from_front_end(&e))?;
                // What agrees and what does not is a matter of pixels as features know them: the film is of working images.
                let working = self.front_end.working_from_sensor();
                let features = self.front_end.features().clone();
                let info = FrameInfo {
                    name,
                    camera: camera.map(|camera: Camera| camera.resized(&working)),
                    cam_from_world,
                    gravity_in_cam,
                    is_chosen,
                };
                let verdict = self.film.add(working_size, features, info);
                if verdict.not_kept.is_none() {
                    self.working_from_sensor = working;
                }
                verdict
            }
        };
        Ok(self.described(verdict).to_string())
    }

    fn described(&self, verdict: Verdict) -> Value {
        let keyframes = self.film.num_keyframes();
        let mut json = match verdict.not_kept {
            None => json!({ "kept": true, "keyframe": keyframes - 1, "keyframes": keyframes }),
            Some(reason) => {
                json!({ "kept": false, "reason": reason_name(reason), "keyframes": keyframes })
            }
        };
        if let (Some(advice), Some(map)) = (verdict.advice, json.as_object_mut()) {
            map.insert("advice".to_owned(), advice_name(advice).into());
        }
        json
    }

    /// Keyframes so far.
    #[wasm_bindgen(js_name = numKeyframes)]
    #[must_use]
    pub fn num_keyframes(&self) -> usize {
        self.film.num_keyframes()
    }

    /// Forgets the film.
    pub fn clear(&mut self) {
        self.film = Film::new(self.params.clone());
    }

    /// Poses, points and lines. `tell` gets stage, done and total and returns true to stop; what `pause` returns is awaited if
    /// it is a promise.
    ///
    /// # Errors
    /// A JavaScript `Error` with a `code`; the film is as it was.
    pub async fn build(&mut self, tell: Function, pause: Function) -> Result<(), JsValue> {
        let mut observer = JsObserver {
            tell: &tell,
            pause: &pause,
        };
        let built = self.film.build(&FilmParams::default(), &mut observer).await;
        built.map(|_| ()).map_err(|e| from_film(&e))
    }

    /// The scene file of the map that [`Self::build`] made.
    ///
    /// # Errors
    /// A JavaScript `Error` with a `code`; the map is as it was.
    pub async fn write(
        &mut self,
        request: String,
        tell: Function,
        pause: Function,
    ) -> Result<Vec<u8>, JsValue> {
        let request: Request = parse(&request)?;
        if self.film.map().is_none() {
            return Err(bad_input("there is no map yet: build it first"));
        }
        if let Some(scale) = &request.scale {
            let ends = [scale.from.numbers(), scale.to.numbers()];
            let known = KnownDistance {
                ends: ends.map(|(k, at)| (k, self.working_from_sensor.apply(at))),
                metres: scale.metres,
            };
            self.film
                .set_distance(&known)
                .map_err(|e| bad_input(&format!("scale: {e}")))?;
        }
        if let Some(up) = request.up {
            let gravity = -Vector3::from(up);
            if !(gravity.norm() > 1e-9 && gravity.norm().is_finite()) {
                return Err(bad_input(&format!("up is {up:?}: expected a direction")));
            }
            self.film.set_gravity(gravity);
        }
        let created = match &request.created {
            None => None,
            Some(text) => {
                Some(Timestamp::parse(text).map_err(|e| bad_input(&format!("created: {e}")))?)
            }
        };
        let num = self.film.map().map_or(0, |map| map.posed.len());
        let origin = Origin {
            source: match request.name.as_str() {
                "" => format!("{num} pictures of a film"),
                name => format!("{name}: {num} pictures of a film"),
            },
            ..self.origin.clone()
        };
        let wanted = SceneRequest {
            anchors: None,
            lines: true,
            hold_out_every: 0,
            licence: request.licence,
            created,
            max_bytes: None,
            precision: Precision::Int8,
        };
        let mut observer = JsObserver {
            tell: &tell,
            pause: &pause,
        };
        let scene = self.film.scene(&origin, &wanted, &mut observer).await;
        let scene = scene.map_err(|e| from_film(&e))?;
        scene
            .to_bytes(wanted.precision)
            .map_err(|e| js_error(Code::NoModel, &e.to_string()))
    }

    /// The label file of the map that [`Self::build`] made: features and tracks, for training with the native tool.
    ///
    /// # Errors
    /// A JavaScript `Error` with a `code`; the map is as it was.
    pub fn labels(&mut self) -> Result<Vec<u8>, JsValue> {
        if self.film.map().is_none() {
            return Err(bad_input("there is no map yet: build it first"));
        }
        let origin = Origin {
            source: "a film".to_owned(),
            ..self.origin.clone()
        };
        self.film.labels(&origin).map_err(|e| from_film(&e))
    }

    /// What came of the film, as JSON; `null` before there is a map.
    #[must_use]
    pub fn report(&self) -> String {
        self.film
            .map()
            .map_or(Value::Null, |map| {
                report(map, self.film.num_keyframes(), &self.working_from_sensor)
            })
            .to_string()
    }

    /// `cameraFromWorld` of all keyframes, 16 numbers row-major each, NaN for those without a place.
    #[must_use]
    pub fn poses(&self) -> Vec<f64> {
        let poses = self.film.map().map_or(&[][..], |map| &map.cam_from_world);
        poses
            .iter()
            .flat_map(|pose| {
                pose.as_ref()
                    .map_or([f64::NAN; 16], CamFromWorld::to_row_major)
            })
            .collect()
    }

    /// Points of the map, three numbers each.
    #[must_use]
    pub fn points(&self) -> Vec<f32> {
        let points = self.film.map().map_or(&[][..], |map| &map.points);
        points
            .iter()
            .flat_map(|p| numbers(&p.point_in_world))
            .collect()
    }

    /// Lines of the map, six numbers each.
    #[must_use]
    pub fn lines(&self) -> Vec<f32> {
        let lines = self.film.map().map_or(&[][..], |map| &map.lines);
        let ends = lines
            .iter()
            .flat_map(|l| [l.start_in_world, l.end_in_world]);
        ends.flat_map(|p| numbers(&p)).collect()
    }
}

fn numbers(p: &Vector3<f64>) -> [f32; 3] {
    [p.x as f32, p.y as f32, p.z as f32]
}

/// In pixels of the frames, whose working images the map knows.
fn report(map: &FilmMap, num_keyframes: usize, working: &WorkingFromSensor) -> Value {
    let reason = |i: usize| map.left_out.iter().find(|(l, _)| *l == i).map(|(_, r)| *r);
    let pictures: Vec<Value> = (0..num_keyframes)
        .map(|i| match reason(i) {
            None => json!({ "keyframe": i, "registered": true }),
            Some(why) => json!({
                "keyframe": i, "registered": false, "reason": left_out_name(why), "advice": why.message(),
            }),
        })
        .collect();
    let sensor = working.inverse();
    let camera = map.main_camera().resized(&sensor);
    let (fx, fy) = camera.focal_px();
    json!({
        "pictures": pictures,
        "poses": map.source.to_string(),
        "components": map.num_components,
        "focal": 0.5 * (fx + fy),
        "width": camera.width,
        "height": camera.height,
        "units": units_name(map.units),
        "points": map.points.len(),
        "lines": map.lines.len(),
        "pairs": map.stats.pairs.len(),
        "medianReprojection": sensor.scale_x * map.median_error_px(),
        "warnings": warnings(map, num_keyframes),
        "up": map.gravity.map(|g| [-g.x, -g.y, -g.z]),
    })
}

/// What whoever filmed should know, in words. Keyframes are counted from 1, as the page shows them.
fn warnings(map: &FilmMap, num_keyframes: usize) -> Vec<String> {
    let mut words = Vec::new();
    if map.num_components > 1 {
        words.push(format!(
            "The film falls into {} pieces that could not be joined; this is the largest. Film the way from one to the other.",
            map.num_components
        ));
    }
    if let [(_, why), ..] = map.left_out.as_slice() {
        words.push(format!(
            "{} of {num_keyframes} pictures have no place in the map. The first of them: {}.",
            map.left_out.len(),
            why.message()
        ));
    }
    let name = |keyframe: usize| format!("picture {}", keyframe + 1);
    if let Some(jump) = map.jump {
        words.push(jump.message(&name(jump.before), &name(jump.after)));
    }
    if let Some(link) = map.weak_link {
        words.push(link.message(&name(link.before), &name(link.after)));
    }
    words
}
