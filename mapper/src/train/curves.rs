//! Loss curves as an SVG picture, drawn from the log.

use std::fmt::Write as _;

/// Curves of the log's columns: one panel for each, branches in different colours, values on a logarithmic axis.
pub fn svg(log: &str) -> String {
    const COLUMNS: [(usize, &str, f64); 4] = [
        (3, "scene distance, cm", 100.0),
        (4, "reprojection, px (clamped)", 1.0),
        (5, "reliability, cross-entropy", 1.0),
        (9, "held-out pose, cm (mean, clamped)", 100.0),
    ];
    const COLORS: [&str; 2] = ["#1f6fb4", "#c8553d"];
    let (width, height, margin) = (420.0, 240.0, 46.0);
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
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{}\" height=\"{}\" font-family=\"sans-serif\" font-size=\"11\">\n<rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n",
        2.0 * width,
        2.0 * height
    );
    // Writing to a string cannot fail.
    for (panel, (column, title, factor)) in COLUMNS.into_iter().enumerate() {
        let (x0, y0) = ((panel % 2) as f64 * width, (panel / 2) as f64 * height);
        let points = |branch: &str| -> Vec<(f64, f64)> {
            rows.iter()
                .filter(|row| row[0] == branch)
                .filter_map(|row| {
                    let value: f64 = row[column].parse().ok()?;
                    Some((row[1].parse().ok()?, (factor * value).max(1e-6)))
                })
                .collect()
        };
        let all: Vec<(f64, f64)> = branches.iter().flat_map(|b| points(b)).collect();
        let fold = |f: fn(f64, f64) -> f64, start: f64, pick: fn(&(f64, f64)) -> f64| {
            all.iter().map(pick).fold(start, f)
        };
        let last = fold(f64::max, 1.0, |p| p.0);
        let low = fold(f64::min, f64::INFINITY, |p| p.1).log10();
        let high = fold(f64::max, f64::NEG_INFINITY, |p| p.1).log10();
        let (low, high) = if low < high { (low, high) } else { (-1.0, 1.0) };
        let x = |step: f64| x0 + margin + step / last * (width - margin - 14.0);
        let y =
            |v: f64| y0 + height - 26.0 - (v.log10() - low) / (high - low) * (height - 26.0 - 30.0);
        let _ = writeln!(
            out,
            "<text x=\"{:.1}\" y=\"{:.1}\" font-weight=\"bold\">{title}</text>",
            x0 + margin,
            y0 + 18.0
        );
        for tick in 0..=4 {
            let value = 10f64.powf(low + (high - low) * f64::from(tick) / 4.0);
            let _ = writeln!(
                out,
                "<line x1=\"{:.1}\" x2=\"{:.1}\" y1=\"{:.1}\" y2=\"{:.1}\" stroke=\"#dddddd\"/><text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{value:.3}</text>",
                x(0.0),
                x(last),
                y(value),
                y(value),
                x(0.0) - 4.0,
                y(value) + 4.0
            );
        }
        let _ = writeln!(
            out,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{last} steps</text>",
            x(last),
            y0 + height - 10.0
        );
        for (i, branch) in branches.iter().enumerate() {
            let path: String = points(branch)
                .iter()
                .map(|(s, v)| format!("{:.1},{:.1} ", x(*s), y(*v)))
                .collect();
            let color = COLORS[i % COLORS.len()];
            let _ = writeln!(
                out,
                "<polyline fill=\"none\" stroke=\"{color}\" stroke-width=\"1.5\" points=\"{path}\"/>"
            );
            if panel == 0 {
                let _ = writeln!(
                    out,
                    "<text x=\"{:.1}\" y=\"{:.1}\" fill=\"{color}\" text-anchor=\"end\">{branch}</text>",
                    width - 16.0,
                    18.0 + 14.0 * i as f64
                );
            }
        }
    }
    out.push_str("</svg>\n");
    out
}

#[cfg(test)]
mod tests {
    #[test]
    fn draws_a_line_for_each_branch_and_survives_an_empty_log() {
        let log = "branch,step,total,scene_m,reprojection_px,reliability,gradient,rate,seconds,held_out_m\n\
                   keypoints,10,1,0.1,5,0.6,1,0.1,1,0.02\nkeypoints,20,1,0.05,4,0.5,1,0.1,2,\n\
                   segments,10,1,0.2,5,0.6,1,0.1,3,\n";
        let picture = super::svg(log);
        assert_eq!(picture.matches("<polyline").count(), 8);
        assert!(!picture.contains("NaN"));
        assert!(super::svg("branch\n").ends_with("</svg>\n"));
    }
}
