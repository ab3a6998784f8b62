//! Loss curves as an SVG picture, drawn from the log.

use crate::plot::{Area, Drawn, GRID, legend, svg};
use crate::units::Ruler;
use plotters::coord::ranged1d::ValueFormatter;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use std::io;

const COLORS: [RGBColor; 2] = [RGBColor(31, 111, 180), RGBColor(200, 85, 61)];
const SIZE: (u32, u32) = (840, 520);

/// Columns of the log with a panel each: position, title, factor.
fn columns(ruler: &Ruler) -> [(usize, String, f64); 4] {
    let Ruler { factor, symbol, .. } = ruler;
    [
        (3, format!("scene distance, {symbol}"), *factor),
        (4, "reprojection, px (clamped)".to_owned(), 1.0),
        (5, "reliability, cross-entropy".to_owned(), 1.0),
        (
            9,
            format!("held-out pose, {symbol} (mean, clamped)"),
            *factor,
        ),
    ]
}

/// Curves of the log's columns, lengths as the ruler tells them: one panel for each, branches in different colours, values on a logarithmic axis.
///
/// # Errors
///
/// When plotting fails.
pub fn plot(log: &str, ruler: &Ruler) -> io::Result<String> {
    let rows: Vec<Vec<&str>> = log
        .lines()
        .skip(1)
        .map(|line| line.split(',').collect())
        .filter(|fields: &Vec<&str>| fields.len() >= 10)
        .collect();
    let mut branches: Vec<&str> = Vec::new();
    for row in &rows {
        if !branches.contains(&row[0]) {
            branches.push(row[0]);
        }
    }
    svg(SIZE, |area| {
        for (panel, (column, title, factor)) in area.split_evenly((2, 2)).iter().zip(columns(ruler))
        {
            let curves: Vec<(&str, Vec<(f64, f64)>)> = branches
                .iter()
                .map(|branch| (*branch, curve(&rows, branch, column, factor)))
                .collect();
            draw_panel(panel, &title, &curves)?;
        }
        Ok(())
    })
}

/// Steps and values of a branch; rows without a value are left out.
fn curve(rows: &[Vec<&str>], branch: &str, column: usize, factor: f64) -> Vec<(f64, f64)> {
    rows.iter()
        .filter(|row| row[0] == branch)
        .filter_map(|row| {
            let value: f64 = row[column].parse().ok()?;
            Some((row[1].parse().ok()?, (factor * value).max(1e-6)))
        })
        .collect()
}

fn draw_panel(panel: &Area<'_>, title: &str, curves: &[(&str, Vec<(f64, f64)>)]) -> Drawn {
    let all = || curves.iter().flat_map(|(_, points)| points);
    let last = all().map(|p| p.0).fold(1.0, f64::max);
    let low = all().map(|p| p.1).fold(f64::INFINITY, f64::min);
    let high = all().map(|p| p.1).fold(0.0, f64::max);
    // A little air around the curves, and some range where there is no curve.
    let (low, high) = if low <= high {
        (0.9 * low, 1.1 * high)
    } else {
        (0.1, 1.0)
    };
    let mut builder = ChartBuilder::on(panel);
    builder
        .margin(10)
        .x_label_area_size(36)
        .y_label_area_size(52);
    // A logarithmic axis of less than a decade has hardly a number on it.
    if high > 10.0 * low {
        let chart = builder.build_cartesian_2d(0.0..last, (low..high).log_scale())?;
        draw_curves(chart, title, curves)
    } else {
        let chart = builder.build_cartesian_2d(0.0..last, low..high)?;
        draw_curves(chart, title, curves)
    }
}

fn draw_curves<'a, 'b: 'a, Y>(
    mut chart: ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, Y>>,
    title: &str,
    curves: &[(&str, Vec<(f64, f64)>)],
) -> Drawn
where
    Y: Ranged<ValueType = f64> + ValueFormatter<f64>,
{
    chart
        .configure_mesh()
        .x_desc("steps")
        .y_desc(title)
        .light_line_style(GRID)
        .bold_line_style(GRID)
        .x_label_formatter(&|v| format!("{v:.0}"))
        .y_label_formatter(&|v| {
            let text = format!("{v:.3}");
            text.trim_end_matches('0').trim_end_matches('.').to_owned()
        })
        .draw()?;
    for (i, (branch, points)) in curves.iter().enumerate() {
        let color = COLORS[i % COLORS.len()];
        chart
            .draw_series(LineSeries::new(points.clone(), color.stroke_width(2)))?
            .label(*branch)
            .legend(move |(x, y)| {
                PathElement::new(vec![(x, y), (x + 18, y)], color.stroke_width(2))
            });
    }
    legend(&mut chart, SeriesLabelPosition::UpperRight)
}

#[cfg(test)]
mod tests {
    use super::*;
    use landline::scene_file::Units;

    #[test]
    fn draws_a_line_for_each_branch_and_survives_an_empty_log() {
        let log = "branch,step,total,scene_m,reprojection_px,reliability,gradient,rate,seconds,held_out_m\n\
                   keypoints,10,1,0.1,5,0.6,1,0.1,1,0.02\nkeypoints,20,1,0.05,4,0.5,1,0.1,2,\n\
                   segments,10,1,0.2,5,0.6,1,0.1,3,\n";
        let picture = plot(log, &Ruler::of(Units::Metres)).expect("plot");
        // A curve and a name in each of four panels; no held-out pose of the segments.
        assert_eq!(picture.matches("#1F6FB4").count(), 8);
        assert_eq!(picture.matches("#C8553D").count(), 7);
        for name in ["keypoints", "segments", "scene distance, cm"] {
            assert!(picture.contains(name), "{name}");
        }
        assert!(!picture.contains("NaN"));
        let unknown = plot(log, &Ruler::of(Units::Arbitrary)).expect("plot");
        assert!(unknown.contains("scene distance, units") && !unknown.contains("cm"));
        let empty = plot("branch\n", &Ruler::of(Units::Metres)).expect("empty plot");
        assert!(empty.ends_with("</svg>\n"));
    }
}
