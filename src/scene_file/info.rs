//! Metadata of a scene file.

use super::{KIND_KEY, SceneFileError, TensorFile};
use crate::geometry::{Camera, CameraRecord, SceneScale};
use crate::models::{ExtractorKind, Preset, RegressorConfig, Sampler};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Unit of world lengths.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Units {
    /// Metres.
    #[default]
    Metres,
    /// Unknown, as in a reconstruction without a known distance.
    Arbitrary,
}

/// Accuracy on pictures that were not trained on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct HeldOut {
    /// Pictures evaluated.
    pub num_images: u64,
    /// Pictures without a pose.
    pub num_not_located: u64,
    /// Median distance of camera positions, world units.
    pub median_position: f64,
    /// Median angle in degrees.
    pub median_rotation_deg: f64,
    /// Share within 5 cm and 5 degrees, 0..1; 0 where units are arbitrary.
    pub recall_5cm_5deg: f64,
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
    /// Accuracy on held-out pictures, if it was measured.
    pub held_out: Option<HeldOut>,
    /// Where pictures and poses came from.
    pub source: String,
}

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
    /// How the scene was taught.
    pub training: Option<TrainingSummary>,
    /// Licence of the map, as text.
    pub licence: String,
    /// Creation date, ISO 8601.
    pub created: String,
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
            training: None,
            licence: String::new(),
            created: String::new(),
        }
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
        put(
            "units",
            match self.units {
                Units::Metres => "m",
                Units::Arbitrary => "arbitrary",
            }
            .to_owned(),
        );
        if let Some(gravity) = &self.gravity {
            put("gravity", vector_text(gravity));
        }
        put("working_max_side", self.working_max_side.to_string());
        if let Some(camera) = &self.camera {
            let record = CameraRecord::from_camera(camera);
            put("camera", text("camera", &record)?);
        }
        if let Some(training) = &self.training {
            put("training", text("training", training)?);
        }
        put("licence", self.licence.clone());
        put("created", self.created.clone());
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
        if scale <= 0.0 {
            return Err(SceneFileError::value(
                "scene_scale",
                &scale.to_string(),
                "must be positive",
            ));
        }
        let units = match file.text("units")? {
            "m" => Units::Metres,
            "arbitrary" => Units::Arbitrary,
            other => {
                return Err(SceneFileError::value(
                    "units",
                    other,
                    "expected `m` or `arbitrary`",
                ));
            }
        };
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
                    16..=8192 => Ok(n),
                    _ => Err("must be 16 to 8192 pixels".to_owned()),
                })
        })?;
        let camera = match file.metadata().get("camera") {
            None => None,
            Some(_) => Some(parse(file, "camera", |t| {
                let record: CameraRecord = serde_json::from_str(t).map_err(|e| e.to_string())?;
                record.to_camera().map_err(|e| e.to_string())
            })?),
        };
        let training = match file.metadata().get("training") {
            None => None,
            Some(_) => Some(parse(file, "training", |t| {
                serde_json::from_str(t).map_err(|e| e.to_string())
            })?),
        };
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
            training,
            licence: file.metadata().get("licence").cloned().unwrap_or_default(),
            created: file.metadata().get("created").cloned().unwrap_or_default(),
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
