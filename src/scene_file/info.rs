//! Metadata of a scene file.

use super::{KIND_KEY, SceneFileError, TensorFile, Timestamp};
use crate::geometry::{Camera, CameraRecord, SceneScale, Units};
use crate::math::stats::median_in_place;
use crate::models::{ExtractorKind, Preset, RegressorConfig, Sampler};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Longest side of a working image that a scene or a caller may ask for, pixels. Choice: time and memory of a frame grow with
/// its square, and no extractor learned from larger ones; at 8192 a frame of 12 megapixels took 19 s and 785 MB in a browser.
pub const MAX_WORKING_SIDE: u32 = 2048;

/// Accuracy on pictures that were not trained on.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct HeldOut {
    /// Pictures evaluated.
    pub num_images: u64,
    /// Pictures without a pose.
    pub num_not_located: u64,
    /// Median distance of camera positions, world units; none where so many pictures have no pose that it is not finite.
    pub median_position: Option<f64>,
    /// Median angle in degrees; none as above.
    pub median_rotation_deg: Option<f64>,
    /// Share within 5 cm and 5 degrees, 0..1; none where units are arbitrary.
    pub recall_5cm_5deg: Option<f64>,
}

impl HeldOut {
    /// Of each picture's distance of positions (world units) and angle (degrees); `None` is a picture without a pose, which
    /// counts as infinitely far.
    pub fn of(errors: &[Option<(f64, f64)>], units: Units) -> Self {
        let median = |part: fn((f64, f64)) -> f64| {
            let mut values: Vec<f64> = errors
                .iter()
                .map(|e| e.map_or(f64::INFINITY, part))
                .collect();
            median_in_place(&mut values).filter(|v| v.is_finite())
        };
        let located = errors.iter().flatten();
        let num_located = located.clone().count();
        let num_within = located.filter(|(m, deg)| *m < 0.05 && *deg < 5.0).count();
        let count = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        Self {
            num_images: u64::from(count(errors.len())),
            num_not_located: u64::from(count(errors.len() - num_located)),
            median_position: median(|e| e.0),
            median_rotation_deg: median(|e| e.1),
            recall_5cm_5deg: (units == Units::Metres && !errors.is_empty())
                .then(|| f64::from(count(num_within)) / f64::from(count(errors.len()))),
        }
    }

    fn check(&self) -> Result<(), String> {
        if self.num_not_located > self.num_images {
            return Err(format!(
                "held_out: {} of {} pictures not located",
                self.num_not_located, self.num_images
            ));
        }
        let limits = [
            ("median_position", self.median_position, 1e12),
            ("median_rotation_deg", self.median_rotation_deg, 180.0),
            ("recall_5cm_5deg", self.recall_5cm_5deg, 1.0),
        ];
        for (name, value, most) in limits {
            if value.is_some_and(|v| !(0.0..=most).contains(&v)) {
                return Err(format!("held_out.{name} must be 0 to {most}"));
            }
        }
        Ok(())
    }
}

/// How the scene was taught.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct TrainingSummary {
    /// Pictures trained on.
    pub num_images: u64,
    /// Optimiser steps.
    pub num_steps: u64,
    /// Wall time in seconds.
    pub seconds: f64,
    /// Accuracy on held-out pictures, if it was measured; by training that of the networks, without landmarks.
    pub held_out: Option<HeldOut>,
    /// Where pictures and poses came from.
    pub source: String,
}

/// A scene knows so many cameras besides its first.
pub const MAX_OTHER_CAMERAS: usize = 7;

/// World units that one unit of the network may be: a room in kilometres is some thousandths, a valley in millimetres ten millions.
const SCALES: std::ops::RangeInclusive<f64> = 1e-6..=1e9;

/// Metadata of a scene file, besides the network's configuration.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneInfo {
    /// Named configuration that the network started from, if any. Informative.
    pub preset: Option<Preset>,
    /// Extractor whose descriptors the network understands.
    pub extractor: ExtractorKind,
    /// SHA-256 of the checkpoint that the extractor's weights came from, in hexadecimal.
    pub extractor_sha256: String,
    /// How descriptors are read from the extractor's map.
    pub sampler: Sampler,
    /// False for imported checkpoints, whose segments are passed to the solver half a pixel off, as in the reference.
    pub line_halfpixel: bool,
    /// From network coordinates to the world.
    pub scale: SceneScale,
    /// Unit of world lengths.
    pub units: Units,
    /// Direction of gravity in the world, a unit vector, if known.
    pub gravity: Option<Vector3<f64>>,
    /// Longest side of the working image that the scene was taught with, pixels.
    pub working_max_side: u32,
    /// Camera of the pictures that the scene was taught with, if there was one.
    pub camera: Option<Camera>,
    /// Further cameras of these pictures, at most [`MAX_OTHER_CAMERAS`].
    pub other_cameras: Vec<Camera>,
    /// How the scene was taught.
    pub training: Option<TrainingSummary>,
    /// Licence of the map, as text.
    pub licence: String,
    /// When it was made; files of the first tool versions do not say.
    pub created: Option<Timestamp>,
}

impl SceneInfo {
    /// Metadata with nothing known but the extractor.
    pub fn new(extractor: ExtractorKind, extractor_sha256: impl Into<String>) -> Self {
        Self {
            preset: None,
            extractor,
            extractor_sha256: extractor_sha256.into(),
            sampler: extractor.default_sampler(),
            line_halfpixel: true,
            scale: SceneScale::default(),
            units: Units::default(),
            gravity: None,
            working_max_side: 640,
            camera: None,
            other_cameras: Vec::new(),
            training: None,
            licence: String::new(),
            created: None,
        }
    }

    /// World units that are taken for a metre in thresholds; see [`SceneScale::nominal_metre`].
    pub fn nominal_metre(&self) -> f64 {
        self.scale.nominal_metre(self.units)
    }

    /// The cameras of the teaching pictures, scaled to pictures of this size, where the shape is theirs.
    pub fn cameras_for(&self, width: u32, height: u32) -> impl Iterator<Item = Camera> + '_ {
        let all = self.camera.iter().chain(&self.other_cameras);
        all.filter_map(move |camera| camera.for_size(width, height))
    }

    pub(super) fn to_metadata(
        &self,
        config: &RegressorConfig,
        version: u32,
    ) -> Result<BTreeMap<String, String>, SceneFileError> {
        let mut out: BTreeMap<String, String> = BTreeMap::new();
        let mut put = |key: &str, value: String| out.insert(key.to_owned(), value);
        put(KIND_KEY, "scene".to_owned());
        put("format", version.to_string());
        put("variant", config.variant().name().to_owned());
        put("config", text("config", config)?);
        if let Some(preset) = self.preset {
            put("preset", preset.name().to_owned());
        }
        put("extractor", self.extractor.name().to_owned());
        put("extractor_sha256", self.extractor_sha256.clone());
        put("sampler", self.sampler.name().to_owned());
        put("line_halfpixel", self.line_halfpixel.to_string());
        put("scene_centre", vector_text(&self.scale.centre));
        put("scene_scale", self.scale.scale.to_string());
        put("units", self.units.name().to_owned());
        if let Some(gravity) = &self.gravity {
            put("gravity", vector_text(gravity));
        }
        put("working_max_side", self.working_max_side.to_string());
        if let Some(camera) = &self.camera {
            let record = CameraRecord::from_camera(camera);
            put("camera", text("camera", &record)?);
        }
        if !self.other_cameras.is_empty() {
            let records: Vec<_> = (self.other_cameras.iter())
                .map(CameraRecord::from_camera)
                .collect();
            put("other_cameras", text("other_cameras", &records)?);
        }
        if let Some(training) = &self.training {
            put("training", text("training", training)?);
        }
        put("licence", self.licence.clone());
        let created = self.created.as_ref();
        put(
            "created",
            created.map_or_else(String::new, |t| t.to_string()),
        );
        Ok(out)
    }

    pub(super) fn from_file(file: &TensorFile<'_>) -> Result<Self, SceneFileError> {
        let extractor_name = file.text("extractor")?;
        let extractor = ExtractorKind::from_name(extractor_name).ok_or_else(|| {
            SceneFileError::value("extractor", extractor_name, "not a known extractor")
        })?;
        let sha256 = file.text("extractor_sha256")?;
        check_sha256("extractor_sha256", sha256)?;
        let sampler_name = file.text("sampler")?;
        let sampler = Sampler::from_name(sampler_name)
            .filter(|s| extractor.supports(*s))
            .ok_or_else(|| {
                SceneFileError::value(
                    "sampler",
                    sampler_name,
                    format!("not a sampler of {}", extractor.name()),
                )
            })?;
        let centre = vector(file, "scene_centre")?;
        let scale = number(file, "scene_scale")?;
        if !SCALES.contains(&scale) {
            let (least, most) = (SCALES.start(), SCALES.end());
            return Err(SceneFileError::value(
                "scene_scale",
                &scale.to_string(),
                format!("must be {least:e} to {most:e}"),
            ));
        }
        let units = parse(file, "units", |t| {
            Units::from_name(t).ok_or_else(|| "expected `m` or `arbitrary`".to_owned())
        })?;
        let gravity = match file.metadata().get("gravity") {
            None => None,
            Some(text) => {
                let g = vector(file, "gravity")?;
                if (g.norm() - 1.0).abs() > 1e-3 {
                    return Err(SceneFileError::value(
                        "gravity",
                        text,
                        "must be a unit vector",
                    ));
                }
                Some(g)
            }
        };
        let line_halfpixel = parse(file, "line_halfpixel", |t| {
            t.parse::<bool>().map_err(|e| e.to_string())
        })?;
        let working_max_side = parse(file, "working_max_side", |t| {
            t.parse::<u32>()
                .map_err(|e| e.to_string())
                .and_then(|n| match n {
                    16..=MAX_WORKING_SIDE => Ok(n),
                    _ => Err(format!("must be 16 to {MAX_WORKING_SIDE} pixels")),
                })
        })?;
        let camera = match file.metadata().get("camera") {
            None => None,
            Some(_) => Some(parse(file, "camera", |t| {
                let record: CameraRecord = serde_json::from_str(t).map_err(|e| e.to_string())?;
                camera_from_record(&record)
            })?),
        };
        let other_cameras = match file.metadata().get("other_cameras") {
            None => Vec::new(),
            Some(_) => parse(file, "other_cameras", |t| {
                let records: Vec<CameraRecord> =
                    serde_json::from_str(t).map_err(|e| e.to_string())?;
                if records.len() > MAX_OTHER_CAMERAS {
                    return Err(format!("must be at most {MAX_OTHER_CAMERAS}"));
                }
                records.iter().map(camera_from_record).collect()
            })?,
        };
        let training = match file.metadata().get("training") {
            None => None,
            Some(_) => Some(parse(file, "training", |t| {
                let summary: TrainingSummary =
                    serde_json::from_str(t).map_err(|e| e.to_string())?;
                summary.held_out.map_or(Ok(()), |h| h.check())?;
                if !(0.0..=1e12).contains(&summary.seconds) {
                    return Err("seconds must be 0 to 1e12".to_owned());
                }
                Ok(summary)
            })?),
        };
        // The key is required; the first tool versions wrote it without a value.
        let created = parse(file, "created", |t| match t {
            "" => Ok(None),
            _ => Timestamp::parse(t).map(Some).map_err(|e| e.to_string()),
        })?;
        let preset = match file.metadata().get("preset") {
            None => None,
            Some(name) => Preset::ALL.into_iter().find(|p| p.name() == name),
        };
        Ok(Self {
            preset,
            extractor,
            extractor_sha256: sha256.to_owned(),
            sampler,
            line_halfpixel,
            scale: SceneScale { centre, scale },
            units,
            gravity,
            working_max_side,
            camera,
            other_cameras,
            training,
            licence: file.metadata().get("licence").cloned().unwrap_or_default(),
            created,
        })
    }
}

/// Checks that a text is a SHA-256 in lower-case hexadecimal.
pub(super) fn check_sha256(key: &'static str, text: &str) -> Result<(), SceneFileError> {
    let hex = |b: u8| b.is_ascii_digit() || (b'a'..=b'f').contains(&b);
    if text.len() == 64 && text.bytes().all(hex) {
        Ok(())
    } else {
        Err(SceneFileError::value(
            key,
            text,
            "expected 64 lower-case hexadecimal digits",
        ))
    }
}

fn camera_from_record(record: &CameraRecord) -> Result<Camera, String> {
    let camera = record.to_camera().map_err(|e| e.to_string())?;
    camera.check_plausible().map_err(|e| e.to_string())?;
    Ok(camera)
}

/// JSON text, straight from the value so that an f32 keeps its short form.
fn text(key: &'static str, value: &impl Serialize) -> Result<String, SceneFileError> {
    serde_json::to_string(value).map_err(|e| SceneFileError::value(key, "", e))
}

pub(super) fn vector_text(v: &Vector3<f64>) -> String {
    serde_json::json!([v.x, v.y, v.z]).to_string()
}

pub(super) fn parse<T>(
    file: &TensorFile<'_>,
    key: &'static str,
    read: impl Fn(&str) -> Result<T, String>,
) -> Result<T, SceneFileError> {
    let text = file.text(key)?;
    read(text).map_err(|reason| SceneFileError::value(key, text, reason))
}

pub(super) fn number(file: &TensorFile<'_>, key: &'static str) -> Result<f64, SceneFileError> {
    parse(file, key, |t| {
        t.parse::<f64>()
            .map_err(|e| e.to_string())
            .and_then(|x| finite(x, 1e12))
    })
}

pub(super) fn vector(
    file: &TensorFile<'_>,
    key: &'static str,
) -> Result<Vector3<f64>, SceneFileError> {
    parse(file, key, |t| {
        let v: [f64; 3] = serde_json::from_str(t).map_err(|e| e.to_string())?;
        for x in v {
            finite(x, 1e12)?;
        }
        Ok(Vector3::from(v))
    })
}

fn finite(x: f64, limit: f64) -> Result<f64, String> {
    if x.abs() <= limit {
        Ok(x)
    } else {
        Err(format!("must be a finite number of at most {limit:e}"))
    }
}
