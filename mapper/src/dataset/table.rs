//! The import table: what was found, what was dropped and why.

use super::{Dataset, Split};
use crate::shown::shown;
use landline::math::stats::median_in_place;
use landline::scene_file::Units;
use std::fmt;

/// How many names of one reason are shown.
const NUM_EXAMPLES: usize = 3;

/// Shows a data set as a table.
pub struct ImportTable<'a>(&'a Dataset);

impl Dataset {
    /// What was found, dropped and why, for people.
    pub fn table(&self) -> ImportTable<'_> {
        ImportTable(self)
    }
}

impl fmt::Display for ImportTable<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let d = self.0;
        let row = |f: &mut fmt::Formatter<'_>, what: &str, value: String| {
            writeln!(f, "  {what:<18} {}", shown(&value))
        };
        writeln!(f, "Data set: {}", d.format)?;
        for source in &d.sources {
            row(f, "read", source.display().to_string())?;
        }
        let num_posed = d
            .images
            .iter()
            .filter(|i| i.cam_from_world.is_some())
            .count();
        row(
            f,
            "pictures",
            format!("{} usable, {num_posed} with a pose", d.images.len()),
        )?;
        let count = |split| d.of_split(split).len();
        row(
            f,
            "split",
            format!(
                "{} train, {} test, {} unused",
                count(Split::Train),
                count(Split::Test),
                count(Split::Unused)
            ),
        )?;
        let mut cameras: Vec<(String, usize)> = Vec::new();
        for image in &d.images {
            let c = &image.camera;
            let (fx, fy) = c.focal_px();
            let text = format!(
                "{} {}x{}, focal {fx:.1} {fy:.1}",
                c.model.name(),
                c.width,
                c.height
            );
            match cameras.iter_mut().find(|(t, _)| *t == text) {
                Some((_, n)) => *n += 1,
                None => cameras.push((text, 1)),
            }
        }
        for (text, n) in cameras.iter().take(NUM_EXAMPLES) {
            row(f, "camera", format!("{text} ({n} pictures)"))?;
        }
        if cameras.len() > NUM_EXAMPLES {
            row(
                f,
                "",
                format!("and {} more cameras", cameras.len() - NUM_EXAMPLES),
            )?;
        }
        let centers: Vec<_> = d
            .images
            .iter()
            .filter_map(|i| i.cam_from_world.map(|t| t.center_in_world()))
            .collect();
        if let Some(first) = centers.first() {
            let (low, high) = centers
                .iter()
                .fold((*first, *first), |(l, h), c| (l.inf(c), h.sup(c)));
            let size = high - low;
            row(
                f,
                "cameras span",
                format!("{:.2} x {:.2} x {:.2}", size.x, size.y, size.z),
            )?;
        }
        let unit = match d.units {
            Units::Metres => "metres",
            Units::Arbitrary => {
                "arbitrary (poses in metres: --units metres; pictures alone: --scale-from or --positions)"
            }
        };
        row(f, "units", unit.to_owned())?;
        if let Some(g) = d.gravity {
            row(
                f,
                "gravity",
                format!("({:.3}, {:.3}, {:.3})", g.x, g.y, g.z),
            )?;
        }
        if !d.points.is_empty() {
            let n: usize = d.points.iter().map(|p| p.observations.len()).sum();
            row(
                f,
                "model points",
                match median_reprojection_px(d) {
                    Some(px) => format!(
                        "{} ({n} observations, median reprojection {px:.2} px)",
                        d.points.len()
                    ),
                    None => format!("{} ({n} observations)", d.points.len()),
                },
            )?;
        }
        if !d.lines.is_empty() {
            row(f, "model lines", d.lines.len().to_string())?;
        }
        for note in &d.notes {
            row(f, "note", note.clone())?;
        }
        let mut reasons: Vec<(&str, Vec<&str>)> = Vec::new();
        for dropped in &d.dropped {
            match reasons.iter_mut().find(|(r, _)| *r == dropped.reason) {
                Some((_, names)) => names.push(&dropped.name),
                None => reasons.push((&dropped.reason, vec![&dropped.name])),
            }
        }
        for (reason, names) in &reasons {
            let more = if names.len() > NUM_EXAMPLES {
                ", ..."
            } else {
                ""
            };
            let shown: Vec<&str> = names.iter().copied().take(NUM_EXAMPLES).collect();
            row(
                f,
                "dropped",
                format!("{} x {reason} ({}{more})", names.len(), shown.join(", ")),
            )?;
        }
        Ok(())
    }
}

/// Median distance of a model's points from where they were seen, which holds cameras and poses to account; of up to 20,000
/// observations.
fn median_reprojection_px(d: &Dataset) -> Option<f64> {
    const MAX_POINTS: usize = 20_000;
    let step = d.points.len().div_ceil(MAX_POINTS).max(1);
    let mut errors: Vec<f64> = d
        .points
        .iter()
        .step_by(step)
        .filter_map(|point| {
            let (image, pixel) = point.observations.first()?;
            let image = d.images.get(*image)?;
            let in_cam = image.cam_from_world?.transform_point(&point.point_in_world);
            // A point behind its camera could not be farther off.
            let projected = image.camera.pixel_from_cam(&in_cam);
            Some(projected.map_or(f64::INFINITY, |p| p.distance(*pixel)))
        })
        .collect();
    median_in_place(&mut errors)
}
