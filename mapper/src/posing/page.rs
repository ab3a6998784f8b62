//! The report of a reconstruction as a page of its own: where the camera was, what is there, what was left out and why.

use super::plots::{self, Axes};
use crate::html::{escaped, head, number};
use landline::features::FeatureSet;
use landline::reconstruction::motion::{Component, Motion};
use std::fmt::Write as _;
use std::io;

/// Rejected loops that are listed.
const MAX_LOOPS: usize = 30;
/// Cells along each side of a picture for its coverage.
const CELLS: usize = 8;

/// What is told.
pub(super) struct Subject<'a> {
    /// Names of the pictures.
    pub(super) names: &'a [&'a str],
    pub(super) features: &'a [FeatureSet],
    /// Name and reason.
    pub(super) unreadable: &'a [(String, String)],
    pub(super) motion: &'a Motion,
    /// Sentences about what may be wrong with it.
    pub(super) doubts: &'a [String],
    /// `m` where lengths are known.
    pub(super) unit: &'a str,
}

/// The page. Without a component there is nothing to tell.
///
/// # Errors
/// When a plot cannot be drawn.
pub(super) fn page(subject: &Subject<'_>) -> io::Result<String> {
    let Some(largest) = subject.motion.components.first() else {
        return Err(io::Error::other("a report without a model"));
    };
    let mut out = head("Poses from pictures");
    let num = subject.names.len();
    // Writing to a string cannot fail.
    let _ = writeln!(
        out,
        "<p class=\"quiet\">{} of {num} pictures have a pose &middot; {} points &middot; reprojection {} px (rms) &middot; \
         the way of the camera is {} long</p>",
        largest.num_registered(),
        largest.points.len(),
        number(largest.rms_px, 2),
        length(way(largest), subject.unit),
    );
    let axes = Axes::of(largest);
    let _ = writeln!(
        out,
        "<h2>The camera and the points</h2>\n<div class=\"plots\">\n<figure>{}<figcaption>From above</figcaption></figure>\n\
         <figure>{}<figcaption>From the side</figcaption></figure>\n</div>\n<p class=\"quiet\">Blue: where the camera was, in \
         order, and where it looked; green: the first picture. A way with a jump, or walls that stand twice, are wrong although \
         the figures look good: film that part again. Up is what was up in the pictures in the mean.</p>",
        plots::view(largest, &axes, true)?,
        plots::view(largest, &axes, false)?,
    );
    let (num_seen, covered) = coverage(subject, largest);
    let (poorest, share) = least(&covered);
    let _ = writeln!(
        out,
        "<h2>What each picture sees</h2>\n<div class=\"plots\">\n{}\n</div>\n<p class=\"quiet\">Orange: without a pose. Points of \
         the model cover {} % of a picture in the median; the least, {} %, that of {}.</p>",
        plots::seen(largest, &num_seen)?,
        number(100.0 * median(&covered), 0),
        number(100.0 * share, 0),
        escaped(poorest.map_or("", |i| subject.names[i])),
    );
    left_out(&mut out, subject);
    cameras(&mut out, subject, largest);
    pieces(&mut out, subject);
    out.push_str("</html>\n");
    Ok(out)
}

fn length(value: f64, unit: &str) -> String {
    if unit.is_empty() {
        format!("{} units of unknown length", number(value, 2))
    } else {
        format!("{} {unit}", number(value, 2))
    }
}

/// Length of the way between the cameras.
fn way(component: &Component) -> f64 {
    let centers: Vec<_> = component
        .cam_from_world
        .iter()
        .flatten()
        .map(|p| p.center_in_world())
        .collect();
    centers.windows(2).map(|w| (w[1] - w[0]).norm()).sum()
}

/// Points that each picture sees, and which share of its cells has one.
fn coverage(subject: &Subject<'_>, component: &Component) -> (Vec<usize>, Vec<Option<f64>>) {
    let num = subject.names.len();
    let mut seen = vec![0; num];
    let mut cells = vec![[false; CELLS * CELLS]; num];
    for o in component.points.iter().flat_map(|p| &p.observations) {
        let i = o.view as usize;
        seen[i] += 1;
        let camera = &component.cameras[subject.motion.camera_of[i]];
        let pixel = subject.features[i].keypoints[o.feature as usize].pixel;
        let cell = |v: f64, size: u32| {
            let at = CELLS as f64 * v / f64::from(size);
            (at.max(0.0) as usize).min(CELLS - 1)
        };
        cells[i][CELLS * cell(pixel.y, camera.height) + cell(pixel.x, camera.width)] = true;
    }
    let covered = cells
        .iter()
        .zip(&component.cam_from_world)
        .map(|(cells, pose)| {
            let full = cells.iter().filter(|c| **c).count();
            pose.map(|_| full as f64 / (CELLS * CELLS) as f64)
        })
        .collect();
    (seen, covered)
}

fn median(shares: &[Option<f64>]) -> f64 {
    let mut all: Vec<f64> = shares.iter().flatten().copied().collect();
    landline::math::stats::median_in_place(&mut all).unwrap_or(f64::NAN)
}

/// The picture with the least, and how much.
fn least(shares: &[Option<f64>]) -> (Option<usize>, f64) {
    let known = shares
        .iter()
        .enumerate()
        .filter_map(|(i, s)| Some((i, (*s)?)));
    known
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .map_or((None, f64::NAN), |(i, s)| (Some(i), s))
}

fn left_out(out: &mut String, subject: &Subject<'_>) {
    let without = subject.motion.without_pose();
    if without.is_empty() && subject.unreadable.is_empty() {
        out.push_str("<h2>Left out</h2>\n<p>Nothing: every picture has a pose.</p>\n");
        return;
    }
    out.push_str("<h2>Left out</h2>\n<table><tr><th>picture<th style=\"text-align:left\">why, and what helps</tr>\n");
    let row = |name: &str, why: &str| {
        format!(
            "<tr><td>{}<td style=\"text-align:left\">{}</tr>\n",
            escaped(name),
            escaped(why)
        )
    };
    for (i, reason) in without {
        out.push_str(&row(subject.names[i], reason.message()));
    }
    for (name, reason) in subject.unreadable {
        out.push_str(&row(name, reason));
    }
    out.push_str("</table>\n");
}

fn cameras(out: &mut String, subject: &Subject<'_>, largest: &Component) {
    out.push_str(
        "<h2>Cameras</h2>\n<table><tr><th>pictures<th>size<th>focal length, px<th>&plusmn;<th>field of view<th>radial term</tr>\n",
    );
    for (g, camera) in largest.cameras.iter().enumerate() {
        let num = subject
            .motion
            .camera_of
            .iter()
            .filter(|of| **of == g)
            .count();
        let (f, _) = camera.focal_px();
        let field = 2.0 * (0.5 * f64::from(camera.width) / f).atan().to_degrees();
        let sigma = match largest.focal_sigma_ln.get(g).copied().flatten() {
            Some(sigma) => format!("{} px", number(sigma * f, 1)),
            None => "as given".to_owned(),
        };
        let radial = match camera.model {
            landline::geometry::CameraModel::SimpleRadial { k, .. } => number(k, 3),
            _ => number(f64::NAN, 0),
        };
        let _ = writeln!(
            out,
            "<tr><td>{num}<td>{} x {}<td>{}<td>{sigma}<td>{}&deg;<td>{radial}</tr>",
            camera.width,
            camera.height,
            number(f, 1),
            number(field, 1),
        );
    }
    out.push_str(
        "</table>\n<p class=\"quiet\">&plusmn; is one standard deviation if the pictures are of one lens at one zoom; pictures of one size \
         share a camera.</p>\n",
    );
}

fn pieces(out: &mut String, subject: &Subject<'_>) {
    let motion = subject.motion;
    let counts = &motion.num_pairs;
    out.push_str(
        "<h2>Pieces</h2>\n<table><tr><th>piece<th>pictures<th>points<th>reprojection, px</tr>\n",
    );
    for (i, component) in motion.components.iter().enumerate() {
        let _ = writeln!(
            out,
            "<tr{}><td>{}<td>{}<td>{}<td>{}</tr>",
            if i == 0 { " class=\"main\"" } else { "" },
            if i == 0 { "written" } else { "not written" },
            component.num_registered(),
            component.points.len(),
            number(component.rms_px, 2),
        );
    }
    let _ = writeln!(
        out,
        "</table>\n<p>{} pairs of pictures had matches, {} of them one geometry: {} of them in depth, {} before one plane, {} only turned.</p>",
        counts.matched, counts.verified, counts.general, counts.planar, counts.turned
    );
    for doubt in subject.doubts {
        let _ = writeln!(out, "<p><b>{}</b></p>", escaped(doubt));
    }
    let loops = &motion.rejected_loops;
    if loops.is_empty() {
        return;
    }
    let _ = writeln!(
        out,
        "<h2>Loops that were not believed</h2>\n<p>{} pairs of pictures far apart in time look alike, and their neighbours contradict \
         it: often two things of the same make.</p>\n<table><tr><th>picture<th>and</tr>",
        loops.len()
    );
    for (a, b) in loops.iter().take(MAX_LOOPS) {
        let name = |i: &u32| escaped(subject.names[*i as usize]);
        let _ = writeln!(out, "<tr><td>{}<td>{}</tr>", name(a), name(b));
    }
    out.push_str("</table>\n");
    if loops.len() > MAX_LOOPS {
        let _ = writeln!(
            out,
            "<p class=\"quiet\">and {} more</p>",
            loops.len() - MAX_LOOPS
        );
    }
}
