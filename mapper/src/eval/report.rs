//! The evaluation for people (table), for programs (JSON, CSV) and for a look (pictures of failures).

use super::run::{Evaluation, STAGES};
use super::{RECALLS, THRESHOLDS, html};
use crate::files;
use crate::units::Ruler;
use serde_json::json;
use std::fmt::Write as _;
use std::io;
use std::path::Path;

/// What was evaluated.
#[derive(Debug, Clone, PartialEq)]
pub struct Subject {
    /// The scene file.
    pub scene: String,
    /// Its size.
    pub num_bytes: usize,
    /// The data set: its format and where it was read from.
    pub data: String,
}

/// The table that `landline eval` prints.
pub fn table(evaluation: &Evaluation) -> String {
    let ruler = Ruler::of(evaluation.units);
    let mut out = String::new();
    let [a, b, c] = RECALLS.map(|(m, deg)| format!("{}/{deg}", ruler.threshold(m)));
    let _ = writeln!(
        out,
        "{:26} {:>9} {:>8} {:>8} {a:>7} {b:>7} {c:>7} {:>8} {:>7}",
        "method", "located", ruler.symbol, "deg", "points", "lines"
    );
    for (name, s) in &evaluation.methods {
        let [a, b, c] = RECALLS.map(|(m, _)| {
            s.recall_at(m)
                .map_or_else(|| "-".to_owned(), |r| format!("{:.1}", 100.0 * r))
        });
        let count = |v: f64| {
            if v.is_nan() {
                "-".to_owned()
            } else {
                format!("{v:.0}")
            }
        };
        let _ = writeln!(
            out,
            "{name:26} {:>9} {:>8} {:>8.3} {a:>7} {b:>7} {c:>7} {:>8} {:>7}",
            format!("{}/{}", s.num_located, s.num_images),
            ruler.number(s.median_position),
            s.median_rotation_deg,
            count(s.median_point_inliers),
            count(s.median_line_inliers),
        );
    }
    let _ = write!(out, "median ms per picture:");
    for (stage, ms) in STAGES.iter().zip(evaluation.median_ms) {
        let _ = write!(out, " {stage} {ms:.1}");
    }
    out.push('\n');
    if evaluation.num_seeds > 1 {
        let _ = writeln!(out, "{} solver seeds pooled", evaluation.num_seeds);
    }
    if let Some(comparison) = &evaluation.comparison {
        let _ = writeln!(out, "{}", comparison.text(&ruler));
    }
    if let Some(lines) = &evaluation.lines {
        let _ = writeln!(out, "{}", lines.text(&ruler));
    }
    if evaluation.images.iter().any(|i| i.confidence.is_some()) {
        let _ = writeln!(out, "{}", evaluation.reliability.text(&ruler));
    }
    if let Some(other) = &evaluation.other_world {
        let _ = writeln!(out, "{}", other.text(&ruler));
    }
    out
}

/// Everything as JSON.
pub fn to_json(evaluation: &Evaluation, subject: &Subject) -> serde_json::Value {
    let thresholds: Vec<_> = THRESHOLDS
        .iter()
        .map(|(m, deg)| json!({ "position": m, "rotation_deg": deg }))
        .collect();
    let finite = |v: f64| if v.is_finite() { json!(v) } else { json!(null) };
    let methods: Vec<_> = evaluation
        .methods
        .iter()
        .map(|(name, s)| {
            json!({
                "name": name,
                "num_images": s.num_images,
                "num_located": s.num_located,
                "median_position": finite(s.median_position),
                "median_rotation_deg": finite(s.median_rotation_deg),
                "recalls": s.recalls,
                "median_point_inliers": finite(s.median_point_inliers),
                "median_line_inliers": finite(s.median_line_inliers),
            })
        })
        .collect();
    let stages: serde_json::Map<String, serde_json::Value> = STAGES
        .iter()
        .zip(evaluation.median_ms)
        .map(|(stage, ms)| ((*stage).to_owned(), json!(ms)))
        .collect();
    json!({
        "scene": subject.scene,
        "scene_bytes": subject.num_bytes,
        "data": subject.data,
        "units": evaluation.units.name(),
        "seeds": evaluation.num_seeds,
        "thresholds": thresholds,
        "methods": methods,
        "median_ms": stages,
        "points_and_lines_against_points": evaluation.comparison,
        "lines": evaluation.lines,
        "reliability": {
            "bins": evaluation.reliability.bins,
            "calibration_error": evaluation.reliability.calibration_error(),
            "confident_wrong": evaluation.reliability.num_confident_wrong,
        },
        "other_world": evaluation.other_world,
        "images": evaluation.images.iter().map(|image| json!({
            "name": image.name,
            "methods": image.methods,
            "other_seeds": image.other_seeds,
            "lines": image.lines,
            "found_again": image.found_again.map(|f| json!({
                "points": [f.found_points, f.visible_points],
                "lines": [f.found_lines, f.visible_lines],
            })),
            "confidence": image.confidence,
            "total_ms": image.total_ms,
        })).collect::<Vec<_>>(),
    })
}

/// One line a picture, solver seed and method.
pub fn per_image_csv(evaluation: &Evaluation) -> String {
    let mut out =
        "image,seed,method,located,position,rotation_deg,point_inliers,line_inliers,total_ms,reason\n"
            .to_owned();
    let quoted = |text: &str| {
        if text.contains([',', '"', '\n']) {
            format!("\"{}\"", text.replace('"', "\"\""))
        } else {
            text.to_owned()
        }
    };
    for image in &evaluation.images {
        for (seed, methods) in image.all_seeds().enumerate() {
            for ((name, _), m) in evaluation.methods.iter().zip(methods) {
                let number = |v: Option<f64>| v.map_or_else(String::new, |v| format!("{v:.6}"));
                let _ = writeln!(
                    out,
                    "{},{seed},{},{},{},{},{},{},{:.2},{}",
                    quoted(&image.name),
                    quoted(name),
                    u8::from(m.error.is_some()),
                    number(m.error.map(|e| e.position)),
                    number(m.error.map(|e| e.rotation_deg)),
                    m.inliers.0,
                    m.inliers.1,
                    image.total_ms,
                    quoted(m.reason.as_deref().unwrap_or("")),
                );
            }
        }
    }
    out
}

/// Writes `report.html` with its plots inside, `report.json`, `report.txt` and `per_image.csv`. `failures` are pictures in
/// the folder, relative to it, with what they show.
///
/// # Errors
/// When the disk refuses.
pub fn write_report(
    evaluation: &Evaluation,
    subject: &Subject,
    failures: &[(String, String)],
    folder: &Path,
) -> io::Result<()> {
    let json = serde_json::to_string_pretty(&to_json(evaluation, subject))?;
    let page = html::page(evaluation, subject, failures)?;
    files::write_bytes(&folder.join("report.json"), json.as_bytes())?;
    files::write_bytes(&folder.join("report.txt"), table(evaluation).as_bytes())?;
    files::write_bytes(&folder.join("report.html"), page.as_bytes())?;
    files::write_bytes(
        &folder.join("per_image.csv"),
        per_image_csv(evaluation).as_bytes(),
    )
}
