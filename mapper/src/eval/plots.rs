//! Plots of an evaluation, as SVG.

use super::run::{Evaluation, ImageResult};
use super::{PoseError, RECALLS};
use crate::plot::{GRID, legend, svg};
use crate::units::Ruler;
use nalgebra::Vector3;
use plotters::prelude::*;
use std::io;

/// Colours of the methods: both, points, lines, baseline.
const COLORS: [RGBColor; 4] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(110, 110, 110),
];
const TRUTH: RGBColor = RGBColor(150, 155, 160);
const SIZE: (u32, u32) = (560, 340);

fn color(method: usize) -> RGBColor {
    COLORS[method.min(COLORS.len() - 1)]
}

/// Which of the four colours a column has: a scene without lines has its own row and the baseline only.
fn color_of_column(evaluation: &Evaluation, column: usize) -> RGBColor {
    let is_baseline = evaluation.methods[column].0.starts_with("nearest");
    color(if is_baseline {
        COLORS.len() - 1
    } else {
        column
    })
}

/// Share of pictures with an error below, over the error on a logarithmic axis: positions as the ruler tells them, or
/// rotations in degrees.
pub(super) fn error_distribution(
    evaluation: &Evaluation,
    title: &str,
    part: &dyn Fn(&PoseError) -> f64,
    range: (f64, f64),
) -> io::Result<String> {
    svg(SIZE, |area| {
        let mut chart = ChartBuilder::on(area)
            .margin(12)
            .x_label_area_size(38)
            .y_label_area_size(46)
            .build_cartesian_2d((range.0..range.1).log_scale(), 0.0..100.0)?;
        chart
            .configure_mesh()
            .x_desc(title)
            .y_desc("% of pictures below")
            .light_line_style(GRID)
            .bold_line_style(GRID)
            .x_label_formatter(&|v| format!("{v}"))
            .y_label_formatter(&|v| format!("{v:.0}"))
            .draw()?;
        for (column, (name, _)) in evaluation.methods.iter().enumerate() {
            let all: Vec<Option<PoseError>> = evaluation
                .images
                .iter()
                .flat_map(ImageResult::all_seeds)
                .filter_map(|m| m.get(column).map(|m| m.error))
                .collect();
            let mut errors: Vec<f64> = all.iter().flatten().map(part).collect();
            errors.sort_by(f64::total_cmp);
            let step = 100.0 / all.len().max(1) as f64;
            let mut path = vec![(range.0, 0.0)];
            for (i, e) in errors.iter().enumerate() {
                let e = e.clamp(range.0, range.1);
                path.push((e, step * i as f64));
                path.push((e, step * (i + 1) as f64));
            }
            path.push((range.1, step * errors.len() as f64));
            let color = color_of_column(evaluation, column);
            chart
                .draw_series(LineSeries::new(path, color.stroke_width(2)))?
                .label(name)
                .legend(move |(x, y)| {
                    PathElement::new(vec![(x, y), (x + 18, y)], color.stroke_width(2))
                });
        }
        legend(&mut chart, SeriesLabelPosition::UpperLeft)
    })
}

/// Position error of the scene and of the baseline, picture by picture.
pub(super) fn error_over_pictures(evaluation: &Evaluation) -> io::Result<String> {
    let ruler = Ruler::of(evaluation.units);
    let range = (5e-4 * ruler.factor, 2.0 * ruler.factor);
    let middle = 0.05 * ruler.factor;
    let num = evaluation.images.len();
    svg((2 * SIZE.0 + 12, SIZE.1), |area| {
        let mut chart = ChartBuilder::on(area)
            .margin(12)
            .x_label_area_size(38)
            .y_label_area_size(46)
            .build_cartesian_2d(0.0..num.max(1) as f64, (range.0..range.1).log_scale())?;
        chart
            .configure_mesh()
            .x_desc("test picture")
            .y_desc(format!("position error, {}", ruler.symbol))
            .light_line_style(GRID)
            .bold_line_style(GRID)
            .x_label_formatter(&|v| format!("{v:.0}"))
            .y_label_formatter(&|v| format!("{v}"))
            .draw()?;
        chart.draw_series(LineSeries::new(
            [(0.0, middle), (num as f64, middle)],
            BLACK.mix(0.35),
        ))?;
        // The baseline below the scene's own results.
        for column in [evaluation.methods.len().saturating_sub(1), 0] {
            let Some((name, _)) = evaluation.methods.get(column) else {
                continue;
            };
            let color = color_of_column(evaluation, column);
            let places: Vec<(f64, f64)> = evaluation
                .images
                .iter()
                .enumerate()
                .filter_map(|(i, image)| {
                    // A picture without a pose sits on the upper edge.
                    let error = image.methods.get(column)?.error;
                    let far = error.map_or(range.1, |e| ruler.factor * e.position);
                    Some((i as f64 + 0.5, far.clamp(range.0, range.1)))
                })
                .collect();
            chart.draw_series(LineSeries::new(places.clone(), color.mix(0.45)))?;
            chart
                .draw_series(places.iter().map(|p| Circle::new(*p, 3, color.filled())))?
                .label(name)
                .legend(move |(x, y)| Circle::new((x + 9, y), 4, color.filled()));
        }
        legend(&mut chart, SeriesLabelPosition::UpperLeft)
    })
}

/// Camera positions seen along the axis in which they differ least: the truth as a line, estimates in the colour of their
/// error.
pub(super) fn trajectory(evaluation: &Evaluation) -> io::Result<String> {
    const NAMES: [&str; 3] = ["x", "y", "z"];
    let truth: Vec<Vector3<f64>> = evaluation
        .images
        .iter()
        .map(|i| i.truth.center_in_world())
        .collect();
    let (low, high) = truth.iter().fold(
        (Vector3::repeat(f64::MAX), Vector3::repeat(f64::MIN)),
        |(low, high), c| (low.inf(c), high.sup(c)),
    );
    let extent = high - low;
    let (across, up) = match extent.imin() {
        0 => (1, 2),
        1 => (0, 2),
        _ => (0, 1),
    };
    // One scale for both axes, with a margin.
    let size = (620u32, 460u32);
    let aspect = f64::from(size.0 - 82) / f64::from(size.1 - 62);
    let half = (0.55 * extent[up].max(extent[across] / aspect)).max(0.05);
    let middle = 0.5 * (low + high);
    let x_range = middle[across] - half * aspect..middle[across] + half * aspect;
    let y_range = middle[up] - half..middle[up] + half;
    svg(size, |area| {
        let mut chart = ChartBuilder::on(area)
            .margin(12)
            .x_label_area_size(38)
            .y_label_area_size(58)
            .build_cartesian_2d(x_range, y_range)?;
        chart
            .configure_mesh()
            .x_desc(format!("{} in the world", NAMES[across]))
            .y_desc(format!("{} in the world", NAMES[up]))
            .light_line_style(GRID)
            .bold_line_style(GRID)
            .x_label_formatter(&|v| format!("{v:.2}"))
            .y_label_formatter(&|v| format!("{v:.2}"))
            .draw()?;
        let flat = |c: &Vector3<f64>| (c[across], c[up]);
        chart
            .draw_series(LineSeries::new(
                truth.iter().map(flat),
                TRUTH.stroke_width(2),
            ))?
            .label("truth")
            .legend(|(x, y)| PathElement::new(vec![(x, y), (x + 18, y)], TRUTH.stroke_width(2)));
        let ruler = Ruler::of(evaluation.units);
        let [a, b, c] = RECALLS.map(|(m, _)| m);
        let told = |m: f64| ruler.threshold(m);
        let symbol = ruler.symbol;
        let classes: [(String, f64, f64, RGBColor); 4] = [
            (
                format!("below {} {symbol}", told(a)),
                0.0,
                a,
                RGBColor(0, 158, 115),
            ),
            (
                format!("{} to {} {symbol}", told(a), told(b)),
                a,
                b,
                RGBColor(0, 114, 178),
            ),
            (
                format!("{} to {} {symbol}", told(b), told(c)),
                b,
                c,
                RGBColor(230, 159, 0),
            ),
            (
                format!("{} {symbol} and more", told(c)),
                c,
                f64::INFINITY,
                RGBColor(204, 50, 40),
            ),
        ];
        for (name, from, to, color) in classes {
            let places: Vec<(f64, f64)> = evaluation
                .images
                .iter()
                .filter_map(|image| {
                    let error = image.methods.first()?.error?.position;
                    let center = image.cam_from_world?.center_in_world();
                    (from..to).contains(&error).then(|| flat(&center))
                })
                .collect();
            if places.is_empty() {
                continue;
            }
            chart
                .draw_series(places.iter().map(|p| Circle::new(*p, 3, color.filled())))?
                .label(name)
                .legend(move |(x, y)| Circle::new((x + 9, y), 4, color.filled()));
        }
        legend(&mut chart, SeriesLabelPosition::LowerRight)
    })
}
