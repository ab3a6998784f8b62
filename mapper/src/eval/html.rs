//! The report as a page of its own: figures, plots, the worst pictures.

use super::report::Subject;
use super::run::{Evaluation, ImageResult, STAGES};
use super::{RECALLS, plots};
use crate::html::{self, escaped, number};
use crate::units::Ruler;
use std::fmt::Write as _;
use std::io;

/// How many of the worst pictures are listed.
const NUM_WORST: usize = 10;

/// The page. `failures` are pictures beside it and what they show.
///
/// # Errors
/// When a plot cannot be drawn.
pub(super) fn page(
    evaluation: &Evaluation,
    subject: &Subject,
    failures: &[(String, String)],
) -> io::Result<String> {
    let scene = escaped(&subject.scene);
    let mut out = html::head(&format!("Evaluation of {scene}"));
    // Writing to a string cannot fail.
    let _ = writeln!(
        out,
        "<p class=\"quiet\">{size} kB &middot; {num} test pictures &middot; {data}</p>",
        size = number(subject.num_bytes as f64 / 1e3, 0),
        num = evaluation.images.len(),
        data = escaped(&subject.data),
    );
    let ruler = Ruler::of(evaluation.units);
    accuracy(&mut out, evaluation, &ruler);
    let distribution = plots::error_distribution;
    let _ = writeln!(
        out,
        "<h2>Errors</h2>\n<div class=\"plots\">\n{}\n{}\n{}\n</div>",
        distribution(
            evaluation,
            &format!("position error, {}", ruler.symbol),
            &|e| ruler.factor * e.position,
            (1e-3 * ruler.factor, ruler.factor)
        )?,
        distribution(
            evaluation,
            "rotation error, degrees",
            &|e| e.rotation_deg,
            (0.03, 30.0)
        )?,
        plots::error_over_pictures(evaluation)?,
    );
    let _ = writeln!(
        out,
        "<p class=\"quiet\">The line in the lower plot is {} {}. A picture without a pose sits on the upper edge.</p>\n\
         <h2>Camera positions</h2>\n<div class=\"plots\">\n{}\n</div>",
        ruler.threshold(0.05),
        ruler.symbol,
        plots::trajectory(evaluation)?
    );
    stages(&mut out, evaluation);
    worst(&mut out, evaluation, &ruler);
    if !failures.is_empty() {
        out.push_str("<h2>Failures</h2>\n<div class=\"fails\">\n");
        for (file, what) in failures {
            let _ = writeln!(
                out,
                "<figure><a href=\"{file}\"><img src=\"{file}\" alt=\"\" loading=\"lazy\"></a><figcaption>{what}\
                 </figcaption></figure>",
                file = escaped(file),
                what = escaped(what)
            );
        }
        out.push_str("</div>\n");
    }
    out.push_str("</html>\n");
    Ok(out)
}

fn accuracy(out: &mut String, evaluation: &Evaluation, ruler: &Ruler) {
    let symbol = ruler.symbol;
    let [a, b, c] = RECALLS.map(|(m, deg)| format!("{} {symbol} / {deg}&deg;", ruler.threshold(m)));
    let _ = writeln!(
        out,
        "<h2>Accuracy</h2>\n<table><tr><th>method<th>located<th>median {symbol}<th>median deg<th>within {a}<th>{b}<th>{c}\
         <th>points<th>lines</tr>",
    );
    for (i, (name, s)) in evaluation.methods.iter().enumerate() {
        let [a, b, c] =
            RECALLS.map(|(m, _)| number(100.0 * s.recall_at(m).unwrap_or(f64::NAN), 1) + " %");
        let _ = writeln!(
            out,
            "<tr{}><td>{}<td>{} of {}<td>{}<td>{}<td>{a}<td>{b}<td>{c}<td>{}<td>{}</tr>",
            if i == 0 { " class=\"main\"" } else { "" },
            escaped(name),
            s.num_located,
            s.num_images,
            number(ruler.factor * s.median_position, ruler.digits),
            number(s.median_rotation_deg, 3),
            number(s.median_point_inliers, 0),
            number(s.median_line_inliers, 0),
        );
    }
    out.push_str(
        "</table>\n<p class=\"quiet\">Points and lines: medians of what agrees with the pose. All methods use the same \
         features and the same solver.",
    );
    if evaluation.num_seeds > 1 {
        let _ = write!(out, " {} solver seeds are pooled.", evaluation.num_seeds);
    }
    out.push_str("</p>\n");
    if let Some(comparison) = &evaluation.comparison {
        let _ = writeln!(
            out,
            "<p>{}. <span class=\"quiet\">In brackets: 95 % of 2,000 resamples of the pictures.</span></p>",
            escaped(&comparison.text(ruler))
        );
    }
    if let Some(lines) = &evaluation.lines {
        let _ = writeln!(out, "<p>{}.</p>", escaped(&lines.text(ruler)));
    }
}

fn stages(out: &mut String, evaluation: &Evaluation) {
    out.push_str("<h2>Time of a picture</h2>\n<table><tr><th>stage<th>median ms<th></tr>\n");
    let all = evaluation.median_ms[STAGES.len() - 1].max(1e-9);
    for (stage, ms) in STAGES.iter().zip(evaluation.median_ms) {
        let _ = writeln!(
            out,
            "<tr><td>{stage}<td>{}<td style=\"text-align:left\"><span class=\"bar\" style=\"width:{:.0}px\"></span></tr>",
            number(ms, 1),
            300.0 * (ms / all).clamp(0.0, 1.0)
        );
    }
    out.push_str("</table>\n");
}

fn worst(out: &mut String, evaluation: &Evaluation, ruler: &Ruler) {
    let error = |image: &ImageResult| image.methods.first().and_then(|m| m.error);
    let mut order: Vec<&ImageResult> = evaluation.images.iter().collect();
    order.sort_by(|a, b| {
        let far = |i: &ImageResult| error(i).map_or(f64::INFINITY, |e| e.position);
        far(b).total_cmp(&far(a))
    });
    let _ = writeln!(
        out,
        "<h2>Worst pictures</h2>\n<table><tr><th>picture<th>{}<th>deg<th>points<th>lines<th>reason</tr>",
        ruler.symbol
    );
    for image in order.iter().take(NUM_WORST) {
        let Some(m) = image.methods.first() else {
            continue;
        };
        let part = |f: fn(&super::PoseError) -> f64| error(image).as_ref().map_or(f64::NAN, f);
        let _ = writeln!(
            out,
            "<tr><td>{}<td>{}<td>{}<td>{}<td>{}<td>{}</tr>",
            escaped(&image.name),
            number(ruler.factor * part(|e| e.position), ruler.digits),
            number(part(|e| e.rotation_deg), 3),
            m.inliers.0,
            m.inliers.1,
            escaped(m.reason.as_deref().unwrap_or(""))
        );
    }
    out.push_str("</table>\n");
}
