//! Plots of a model of posed pictures, as SVG: from above, from the side, and what each picture sees.

use crate::plot::{GRID, svg};
use landline::geometry::CamFromWorld;
use landline::reconstruction::motion::Component;
use nalgebra::Vector3;
use plotters::prelude::*;
use std::io;

const POINT: RGBColor = RGBColor(120, 126, 132);
const WAY: RGBColor = RGBColor(0, 114, 178);
const FIRST: RGBColor = RGBColor(0, 158, 115);
const MISSING: RGBColor = RGBColor(213, 94, 0);
/// Points that are drawn: more make the page slow and look the same.
const MAX_POINTS: usize = 4_000;

/// Three directions of the world: two that lie level, the longer way of the camera first, and up.
pub(super) struct Axes {
    right: Vector3<f64>,
    back: Vector3<f64>,
    up: Vector3<f64>,
}

impl Axes {
    /// Up as the pictures have it in the mean: people film upright, and nothing else is known of it here.
    pub(super) fn of(component: &Component) -> Self {
        let poses: Vec<&CamFromWorld> = component.cam_from_world.iter().flatten().collect();
        let up = poses
            .iter()
            .map(|p| p.up_in_world())
            .sum::<Vector3<f64>>()
            .try_normalize(1e-9)
            .unwrap_or(-Vector3::y());
        let centers: Vec<Vector3<f64>> = poses.iter().map(|p| p.center_in_world()).collect();
        let middle = centers.iter().sum::<Vector3<f64>>() / centers.len().max(1) as f64;
        let level = |v: Vector3<f64>| v - up * up.dot(&v);
        // The direction to the centre that is farthest from the middle.
        let far = centers
            .iter()
            .map(|c| level(c - middle))
            .max_by(|a, b| a.norm().total_cmp(&b.norm()))
            .and_then(|v| v.try_normalize(1e-9));
        let right = far
            .or_else(|| up.cross(&Vector3::z()).try_normalize(1e-9))
            .unwrap_or(Vector3::x());
        Self {
            right,
            back: right.cross(&up),
            up,
        }
    }
}

/// The way of the camera and the points; from above, or from the side.
pub(super) fn view(component: &Component, axes: &Axes, from_above: bool) -> io::Result<String> {
    let flat = |p: &Vector3<f64>| {
        let y = if from_above {
            -axes.back.dot(p)
        } else {
            axes.up.dot(p)
        };
        (axes.right.dot(p), y)
    };
    let poses: Vec<(usize, &CamFromWorld)> = component
        .cam_from_world
        .iter()
        .enumerate()
        .filter_map(|(i, p)| Some((i, p.as_ref()?)))
        .collect();
    let centers: Vec<(f64, f64)> = poses
        .iter()
        .map(|(_, p)| flat(&p.center_in_world()))
        .collect();
    let every = component.points.len().div_ceil(MAX_POINTS).max(1);
    let points: Vec<(f64, f64)> = component
        .points
        .iter()
        .step_by(every)
        .map(|p| flat(&p.point_in_world))
        .collect();
    // A few points are always far away: they may not make the rest small.
    let range = |part: fn(&(f64, f64)) -> f64| {
        let mut all: Vec<f64> = points.iter().map(part).collect();
        all.sort_by(f64::total_cmp);
        let at = |share: f64| all.get((share * all.len().saturating_sub(1) as f64) as usize);
        let ends = [at(0.02), at(0.98)];
        let own = centers.iter().map(part);
        let (low, high) = ends
            .into_iter()
            .flatten()
            .copied()
            .chain(own)
            .fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(v), h.max(v)));
        if low < high {
            (low, high)
        } else {
            (low - 1.0, low + 1.0)
        }
    };
    let (x, y) = (range(|p| p.0), range(|p| p.1));
    // One scale for both axes.
    let size = (560u32, 420u32);
    let aspect = f64::from(size.0 - 24) / f64::from(size.1 - 24);
    let half = 0.55 * (y.1 - y.0).max((x.1 - x.0) / aspect);
    let (cx, cy) = (0.5 * (x.0 + x.1), 0.5 * (y.0 + y.1));
    svg(size, |area| {
        let mut chart = ChartBuilder::on(area)
            .margin(12)
            .build_cartesian_2d(cx - half * aspect..cx + half * aspect, cy - half..cy + half)?;
        let is_inside =
            |p: &&(f64, f64)| (p.0 - cx).abs() < half * aspect && (p.1 - cy).abs() < half;
        chart.draw_series(
            points
                .iter()
                .filter(is_inside)
                .map(|p| Circle::new(*p, 1, POINT.mix(0.5).filled())),
        )?;
        // Pictures that were left out interrupt the way.
        for (k, pair) in poses.windows(2).enumerate() {
            if pair[1].0 == pair[0].0 + 1 {
                let ends = [centers[k], centers[k + 1]];
                chart.draw_series(LineSeries::new(ends, WAY.stroke_width(2)))?;
            }
        }
        for ((i, pose), center) in poses.iter().zip(&centers) {
            let ahead = pose.center_in_world() + 0.08 * half * pose.rotation.row(2).transpose();
            let color = if *i == poses[0].0 { FIRST } else { WAY };
            chart.draw_series(LineSeries::new([*center, flat(&ahead)], color.mix(0.6)))?;
            let radius = if *i == poses[0].0 { 5 } else { 2 };
            chart.draw_series([Circle::new(*center, radius, color.filled())])?;
        }
        Ok(())
    })
}

/// Points that each picture sees; a picture without a pose has a mark instead.
pub(super) fn seen(component: &Component, num_seen: &[usize]) -> io::Result<String> {
    let most = num_seen.iter().copied().max().unwrap_or(0).max(1) as f64;
    let num = num_seen.len().max(1) as f64;
    svg((1132, 240), |area| {
        let mut chart = ChartBuilder::on(area)
            .margin(12)
            .x_label_area_size(38)
            .y_label_area_size(52)
            .build_cartesian_2d(0.0..num, 0.0..1.05 * most)?;
        chart
            .configure_mesh()
            .disable_x_mesh()
            .x_desc("picture")
            .y_desc("points of the model")
            .light_line_style(GRID)
            .bold_line_style(GRID)
            .x_label_formatter(&|v| format!("{v:.0}"))
            .y_label_formatter(&|v| format!("{v:.0}"))
            .draw()?;
        chart.draw_series(num_seen.iter().enumerate().map(|(i, seen)| {
            let is_posed = component.cam_from_world[i].is_some();
            let (height, color) = if is_posed {
                (*seen as f64, WAY)
            } else {
                (0.04 * most, MISSING)
            };
            let x = i as f64;
            Rectangle::new([(x + 0.1, 0.0), (x + 0.9, height)], color.mix(0.8).filled())
        }))?;
        Ok(())
    })
}
