//! `landline inspect`: a readable card of a scene file or an extractor file, or what is wrong with it.

use crate::shown::shown;
use crate::units::accuracy;
use crate::{files, reveals};
use anyhow::{Context as _, Result};
use landline::models::{LineBranchConfig, PointBranchConfig, RegressorConfig};
use landline::scene_file::{
    ExtractorFile, SceneFile, SceneFileError, SceneInfo, TensorFile, Units,
};
use std::path::PathBuf;

/// Check a scene file or extractor file and print what it holds. Fails when the file is damaged.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The file: NAME.landline, or the weights of an extractor.
    file: PathBuf,
    /// List every tensor.
    #[arg(long)]
    tensors: bool,
    /// Print the metadata as JSON instead.
    #[arg(long)]
    json: bool,
    /// Say what the file tells a stranger about the place, and draw it: an SVG file.
    #[arg(long, value_name = "FILE.svg")]
    reveals: Option<PathBuf>,
}

/// Runs the command.
///
/// # Errors
/// When the file cannot be read or is refused; the text says why.
pub fn run(args: Args) -> Result<()> {
    let name = args.file.display().to_string();
    let bytes = std::fs::read(&args.file).with_context(|| format!("cannot read {name}"))?;
    if let Some(path) = &args.reveals {
        let scene = SceneFile::from_bytes(&bytes).with_context(|| format!("{name} is refused"))?;
        let revealed = reveals::revealed(&scene);
        println!("{} tells whoever has it:", shown(&name));
        for words in reveals::words(&scene, &revealed) {
            println!("  {}", shown(&words));
        }
        let drawing = reveals::drawing(&revealed, scene.info.gravity);
        files::write_bytes(path, drawing.as_bytes())
            .with_context(|| format!("cannot write {}", path.display()))?;
        return Ok(());
    }
    let text =
        card(&bytes, args.tensors, args.json).with_context(|| format!("{name} is refused"))?;
    if args.json {
        println!("{text}");
    } else {
        println!("{}: {} bytes\n{text}", shown(&name), group(bytes.len()));
    }
    Ok(())
}

/// The text for a file's bytes. The whole file is checked, as it is before it is used.
fn card(bytes: &[u8], tensors: bool, json: bool) -> Result<String, SceneFileError> {
    let file = TensorFile::parse(bytes)?;
    let mut out = match SceneFile::from_bytes(bytes) {
        Ok(scene) => scene_card(&scene),
        Err(SceneFileError::Kind { found, .. }) if found == "extractor" => {
            extractor_card(&ExtractorFile::from_bytes(bytes)?)
        }
        Err(error) => return Err(error),
    };
    if json {
        return Ok(serde_json::json!(file.metadata()).to_string());
    }
    line(&mut out, "weights", &storage(&file));
    line(
        &mut out,
        "checked",
        "header, metadata, every tensor present, all numbers finite",
    );
    if tensors {
        for (name, element, shape) in file.entries() {
            let shape: Vec<String> = shape.iter().map(usize::to_string).collect();
            line(
                &mut out,
                "",
                &format!("{name:<28} {element:<4} [{}]", shape.join(", ")),
            );
        }
    }
    out.pop();
    Ok(out)
}

/// How the weights are stored: numbers by element type, the row factors of 8-bit tensors not counted.
fn storage(file: &TensorFile<'_>) -> String {
    let entries = file.entries();
    let is_factor = |name: &str| {
        let base = name.strip_suffix(".scale");
        base.is_some_and(|base| {
            entries
                .iter()
                .any(|(n, element, _)| *n == base && element == "I8")
        })
    };
    let kinds = [
        ("I8", "8-bit with a factor for each row"),
        ("F16", "16-bit"),
        ("F32", "32-bit"),
    ];
    let parts: Vec<String> = kinds
        .into_iter()
        .filter_map(|(kind, words)| {
            let numbers: usize = entries
                .iter()
                .filter(|(name, element, _)| element == kind && !is_factor(name))
                .map(|(_, _, shape)| shape.iter().product::<usize>())
                .sum();
            (numbers > 0).then(|| format!("{} {words}", group(numbers)))
        })
        .collect();
    parts.join(", ")
}

fn line(out: &mut String, key: &str, value: &str) {
    out.push_str(&format!("  {key:<12} {}\n", shown(value)));
}

fn scene_card(scene: &SceneFile) -> String {
    let mut out = String::new();
    let SceneInfo {
        preset,
        extractor,
        extractor_sha256,
        sampler,
        line_halfpixel,
        scale,
        units,
        gravity,
        working_max_side,
        camera,
        other_cameras,
        training,
        licence,
        created,
    } = &scene.info;
    let unit = units.symbol();
    let preset = preset.map_or(String::new(), |p| format!(", preset {}", p.name()));
    line(
        &mut out,
        "scene",
        &format!(
            "variant {}{preset}, {} parameters",
            scene.config.variant().name(),
            group(scene.config.num_parameters())
        ),
    );
    for text in network_lines(&scene.config) {
        line(&mut out, "", &text);
    }
    let landmarks = match &scene.landmarks {
        None => "none: the first pose is the answer".to_owned(),
        Some(table) => format!(
            "{} points and {} lines to look again at, {} clusters of views",
            group(table.point_positions.len()),
            group(table.line_positions.len()),
            table.num_clusters
        ),
    };
    line(&mut out, "landmarks", &landmarks);
    line(
        &mut out,
        "extractor",
        &format!(
            "{}, checkpoint {}…, sampler {}",
            extractor.name(),
            &extractor_sha256[..12],
            sampler.name()
        ),
    );
    line(
        &mut out,
        "pictures",
        &format!("longest side {working_max_side} px"),
    );
    if !line_halfpixel {
        line(
            &mut out,
            "",
            "segments half a pixel off, as in the reference",
        );
    }
    let c = scale.centre;
    line(
        &mut out,
        "world",
        &format!(
            "centre ({:.3}, {:.3}, {:.3}) {unit}, {:.3} {unit} for one network unit",
            c.x, c.y, c.z, scale.scale
        ),
    );
    line(
        &mut out,
        "units",
        match units {
            Units::Metres => "metres",
            Units::Arbitrary => "arbitrary: nobody said how long one is",
        },
    );
    match gravity {
        Some(g) => line(
            &mut out,
            "gravity",
            &format!("({:.4}, {:.4}, {:.4})", g.x, g.y, g.z),
        ),
        None => line(&mut out, "gravity", "not known"),
    }
    for camera in camera.iter().chain(other_cameras) {
        let (params, num) = camera.model.params();
        let params: Vec<String> = params[..num].iter().map(|p| format!("{p:.3}")).collect();
        line(
            &mut out,
            "camera",
            &format!(
                "{} {}x{} ({})",
                camera.model.name(),
                camera.width,
                camera.height,
                params.join(", ")
            ),
        );
    }
    if let Some(t) = training {
        line(
            &mut out,
            "training",
            &format!(
                "{} pictures, {} steps, {:.0} s",
                t.num_images, t.num_steps, t.seconds
            ),
        );
        if !t.source.is_empty() {
            line(&mut out, "source", &t.source);
        }
        match &t.held_out {
            Some(h) => line(&mut out, "held out", &accuracy(h, *units)),
            None => line(&mut out, "held out", "not measured"),
        }
    }
    line(
        &mut out,
        "licence",
        if licence.is_empty() {
            "not stated"
        } else {
            licence
        },
    );
    let created = created.as_ref().map(ToString::to_string);
    line(
        &mut out,
        "created",
        created
            .as_deref()
            .unwrap_or("not stated, by one of the first versions of this tool"),
    );
    out
}

fn network_lines(config: &RegressorConfig) -> Vec<String> {
    let mut out = Vec::new();
    match config {
        RegressorConfig::V1(c) => out.push(format!(
            "joint: width {}, {} heads, {} layers, keeps points from {} and lines from {}",
            c.width, c.heads, c.num_layers, c.min_point_confidence, c.min_line_confidence
        )),
        RegressorConfig::Branches { point, line } => {
            out.push(match point {
                PointBranchConfig::Attention(c) => format!(
                    "points: width {}, {} heads, {} layers, keeps above {}",
                    c.width, c.heads, c.num_layers, c.min_confidence
                ),
                PointBranchConfig::Anchored(c) => format!("points: {} anchors", c.num_anchors),
            });
            out.push(match line {
                None => "lines: none".to_owned(),
                Some(LineBranchConfig::Attention(c)) => format!(
                    "lines: width {}, {} heads, {} layers, {} samples, keeps above {}",
                    c.width, c.heads, c.num_layers, c.tokens, c.min_confidence
                ),
                Some(LineBranchConfig::Anchored(c)) => {
                    format!("lines: {} anchors, {} samples", c.num_anchors, c.tokens)
                }
            });
        }
    }
    out
}

fn extractor_card(file: &ExtractorFile) -> String {
    let mut out = String::new();
    let parameters: usize = file
        .kind
        .tensors()
        .iter()
        .map(|t| t.shape.iter().product::<usize>())
        .sum();
    line(
        &mut out,
        "extractor",
        &format!(
            "{}, {} parameters, descriptors of {} numbers",
            file.kind.name(),
            group(parameters),
            file.kind.descriptor_channels()
        ),
    );
    line(&mut out, "checkpoint", &file.source_sha256);
    if !file.source.is_empty() {
        line(&mut out, "source", &file.source);
    }
    line(
        &mut out,
        "licence",
        if file.licence.is_empty() {
            "not stated"
        } else {
            &file.licence
        },
    );
    out
}

/// Digits in groups of three.
fn group(n: usize) -> String {
    let digits = n.to_string();
    let mut out = String::new();
    for (i, d) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(',');
        }
        out.push(d);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_are_grouped() {
        assert_eq!(group(7), "7");
        assert_eq!(group(8_282_379), "8,282,379");
        assert_eq!(group(100_000), "100,000");
    }

    #[test]
    fn damaged_files_are_refused_with_a_reason() {
        assert!(matches!(
            card(b"", false, false),
            Err(SceneFileError::Truncated { .. })
        ));
        assert!(matches!(
            card(&[0xff; 64], false, false),
            Err(SceneFileError::HeaderTooLong { .. })
        ));
    }
}
