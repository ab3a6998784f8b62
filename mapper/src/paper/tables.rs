//! The tables, in Markdown.

use super::published::{INDOOR6_METHODS, Printed, SEVEN_SCENES_METHODS, Scene, TIMED};
use super::{DataSet, Measured, Poses};
use std::fmt::Write as _;

/// Accuracy beside the published figures, what parts contribute, times; of the scenes measured so far, given by folder.
pub fn tables(set: DataSet, results: &[(String, Poses, Measured)]) -> String {
    let mut out = String::new();
    for poses in [Poses::Sfm, Poses::Shipped] {
        let rows: Vec<(&Scene, &Measured)> = set
            .scenes()
            .iter()
            .filter_map(|scene| {
                let of_scene = results
                    .iter()
                    .find(|(folder, of, _)| folder == scene.folder && *of == poses);
                of_scene.map(|(_, _, measured)| (scene, measured))
            })
            .collect();
        if !rows.is_empty() {
            accuracy(&mut out, set, poses, &rows);
            parts(&mut out, &rows);
            times(&mut out, &rows);
        }
    }
    out
}

fn cell([cm, deg, percent]: [Option<f64>; 3]) -> String {
    let number = |v: Option<f64>, digits: usize| {
        v.map_or_else(|| "-".to_owned(), |v| format!("{v:.digits$}"))
    };
    let (cm, deg) = (number(cm, 1), number(deg, 2));
    format!("{cm} / {deg} / {}", number(percent, 1))
}

fn printed(figures: &Printed) -> String {
    cell(figures.map(Some))
}

/// A header and the line below it.
fn header(out: &mut String, first: &str, columns: &[&str]) {
    let _ = writeln!(out, "| {first} | {} |", columns.join(" | "));
    let _ = writeln!(out, "| --- |{}", " --- |".repeat(columns.len()));
}

fn accuracy(out: &mut String, set: DataSet, poses: Poses, rows: &[(&Scene, &Measured)]) {
    let of = match (set, poses) {
        (DataSet::SevenScenes, Poses::Shipped) => "poses as shipped (KinectFusion)",
        (DataSet::Indoor6, Poses::Shipped) => "poses as shipped",
        (_, Poses::Sfm) => "poses from structure from motion: published figures are on other poses",
    };
    let _ = writeln!(
        out,
        "\n## {set:?}, {of}\n\nMedian cm / median degrees / percent within 5 cm and 5 degrees.\n"
    );
    let published = match (set, poses) {
        (_, Poses::Sfm) => &[][..],
        (DataSet::SevenScenes, _) => SEVEN_SCENES_METHODS,
        (DataSet::Indoor6, _) => INDOOR6_METHODS,
    };
    header(
        out,
        "scene",
        &[published, &["ours", "pictures taught, tested"]].concat(),
    );
    for (scene, measured) in rows {
        let mut cells: Vec<String> = match poses {
            Poses::Sfm => Vec::new(),
            Poses::Shipped => scene.rows.iter().map(printed).collect(),
        };
        let own = measured
            .methods
            .first()
            .map_or([None; 3], |(_, figures)| *figures);
        cells.push(cell(own));
        cells.push(format!("{}, {}", measured.num_train, measured.num_test));
        let _ = writeln!(out, "| {} | {} |", scene.title, cells.join(" | "));
    }
    for (scene, measured) in rows {
        if measured.num_test != scene.num_test {
            let _ = writeln!(
                out,
                "\n{}: {} test pictures in place of the official {}: its figures are no comparison.",
                scene.title, measured.num_test, scene.num_test
            );
        }
    }
}

fn parts(out: &mut String, rows: &[(&Scene, &Measured)]) {
    let _ = writeln!(
        out,
        "\nWhat parts contribute (\"first pose\" is without the second look):\n"
    );
    let mut names: Vec<&str> = Vec::new();
    for (_, measured) in rows {
        for (name, _) in &measured.methods {
            // How many landmarks the baseline has differs from scene to scene.
            let name = name.split(" of ").next().unwrap_or(name);
            if !names.contains(&name) {
                names.push(name);
            }
        }
    }
    header(out, "scene", &names);
    for (scene, measured) in rows {
        let of = |name: &&str| {
            let found = measured.methods.iter().find(|(n, _)| n.starts_with(*name));
            found.map_or_else(|| "-".to_owned(), |(_, figures)| cell(*figures))
        };
        let cells: Vec<String> = names.iter().map(of).collect();
        let _ = writeln!(out, "| {} | {} |", scene.title, cells.join(" | "));
    }
}

fn times(out: &mut String, rows: &[(&Scene, &Measured)]) {
    let is_timed = rows.iter().any(|(scene, _)| !scene.timing.is_empty());
    let published = if is_timed { TIMED } else { &[][..] };
    let _ = writeln!(
        out,
        "\nForward ms / pose ms / frames a second, means; ours on this machine's CPU, the paper's on its GPU:\n"
    );
    header(
        out,
        "scene",
        &[published, &["ours", "scene file, bytes", "teaching, s"]].concat(),
    );
    for (scene, m) in rows {
        let mut cells: Vec<String> = scene
            .timing
            .iter()
            .map(|[forward, pose, fps]| format!("{forward:.1} / {pose:.1} / {fps:.1}"))
            .collect();
        let fps = 1e3 / (m.forward_ms + m.pose_ms);
        cells.push(format!("{:.1} / {:.1} / {fps:.1}", m.forward_ms, m.pose_ms));
        cells.push(m.num_bytes.to_string());
        cells.push(format!("{:.0}", m.teaching_s));
        let _ = writeln!(out, "| {} | {} |", scene.title, cells.join(" | "));
    }
}

#[cfg(test)]
mod tests {
    use super::super::published::{INDOOR6, SEVEN_SCENES};
    use super::*;

    /// Averages that the paper prints, and those of 7-Scenes recomputed from its rows.
    #[test]
    fn published_figures_are_copied_right() {
        let mean = |scenes: &[Scene], column: usize, part: usize| {
            let sum: f64 = scenes.iter().map(|s| s.rows[column][part]).sum();
            sum / scenes.len() as f64
        };
        assert!((mean(SEVEN_SCENES, 4, 2) - 78.2).abs() < 0.05);
        assert!((mean(SEVEN_SCENES, 3, 2) - 77.0).abs() < 0.05);
        // PL2Map's average of the table of times: 4.7 / 0.78 / 57.0.
        for (part, expected) in [(0, 4.7), (1, 0.78), (2, 57.0)] {
            assert!((mean(INDOOR6, 6, part) - expected).abs() < 0.06, "{part}");
        }
        // Its times: 96.9 / 18.7, and the paper's with LSD: 31.8 / 32.6.
        for (column, part, expected) in [(0, 0, 96.9), (0, 1, 18.7), (2, 0, 31.8), (2, 1, 32.6)] {
            let sum: f64 = INDOOR6.iter().map(|s| s.timing[column][part]).sum();
            assert!((sum / 6.0 - expected).abs() < 0.06, "{column} {part}");
        }
        for scenes in [SEVEN_SCENES, INDOOR6] {
            let num_methods = scenes[0].rows.len();
            assert!(scenes.iter().all(|s| s.rows.len() == num_methods));
        }
    }

    #[test]
    fn tables_say_what_is_no_comparison() {
        let measured = Measured {
            identity: String::new(),
            num_train: 800,
            num_test: 100,
            methods: vec![
                (
                    "points + lines".to_owned(),
                    [Some(0.38), Some(0.26), Some(100.0)],
                ),
                (
                    "nearest of 1234 landmarks".to_owned(),
                    [None, None, Some(12.0)],
                ),
            ],
            forward_ms: 80.0,
            pose_ms: 20.0,
            num_bytes: 400_000,
            teaching_s: 78.0,
        };
        let of = |poses| ("redkitchen".to_owned(), poses, measured.clone());
        let text = tables(DataSet::SevenScenes, &[of(Poses::Shipped), of(Poses::Sfm)]);
        let shipped = text.find("as shipped").expect("both");
        assert!(text.find("structure from motion").expect("both") < shipped);
        assert!(text.contains("| RedKitchen | 4.2 / 1.39 / 58.9 | 4.3 / 1.42 / 58.0 | 4.1 / 1.39 / 60.2 | 3.7 / 1.10 / 68.9 | 3.7 / 1.12 / 71.0 | 0.4 / 0.26 / 100.0 | 800, 100 |"));
        assert!(text.contains("100 test pictures in place of the official 5000"));
        assert!(
            text.contains("| RedKitchen | 0.4 / 0.26 / 100.0 | - / - / 12.0 |"),
            "{text}"
        );
        assert!(text.contains("80.0 / 20.0 / 10.0"));
        assert!(!text.contains("1234"));
    }
}
