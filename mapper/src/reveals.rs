//! What a scene file tells a stranger: a drawing of the place as the file has it, and words about the rest.
//!
//! In: a scene file. Out: text, and an SVG with the place from above and from the side; nothing is guessed beyond what the file
//! holds, so a stranger with time sees at least this.

use crate::export::{Map, scene_map};
use landline::landmarks::LandmarkTable;
use landline::scene_file::SceneFile;
use nalgebra::{Matrix3, Vector3};
use std::fmt::Write as _;

/// Numbers that the drawing and the words are made of.
#[derive(Debug, Clone, PartialEq)]
pub struct Revealed {
    /// Points and segments in the world: the networks' and the landmarks'.
    pub map: Map,
    /// Length, width and height of what holds all but a hundredth of the points on either side, longest first; world units.
    pub extent: [f64; 3],
    /// Numbers of every point's and segment's descriptor, where the networks carry some.
    pub descriptor_numbers: [usize; 2],
    /// Whether these numbers are signs only.
    pub are_signs: bool,
    /// Bits of every landmark's code, where there are some.
    pub code_bits: usize,
}

/// Takes a scene apart.
pub fn revealed(scene: &SceneFile) -> Revealed {
    let mut map = scene_map(scene);
    if let Some(table) = &scene.landmarks {
        let world = |p: &[u16; 3]| table.grid.decode(*p);
        map.points.extend(table.point_positions.iter().map(world));
        let ends = |l: &[[u16; 3]; 2]| [world(&l[0]), world(&l[1])];
        map.segments.extend(table.line_positions.iter().map(ends));
    }
    let axes = axes(&map, scene.info.gravity);
    let mut extent: [f64; 3] = core::array::from_fn(|i| {
        let mut along: Vec<f64> = all_points(&map).map(|p| axes.column(i).dot(p)).collect();
        along.sort_by(f64::total_cmp);
        let cut = along.len() / 100;
        match (along.get(cut), along.iter().rev().nth(cut)) {
            (Some(low), Some(high)) => high - low,
            _ => 0.0,
        }
    });
    extent.sort_by(|a, b| b.total_cmp(a));
    let width = |name: &str| {
        let tensor = scene.weights.get(name);
        tensor
            .and_then(|t| t.shape().last().copied())
            .unwrap_or_default()
    };
    Revealed {
        extent,
        descriptor_numbers: [width("point.anchor.keys"), width("line.anchor.keys")],
        are_signs: scene.weights.get("point.anchor.keys").is_some_and(|keys| {
            let numbers = keys.to_f32();
            let rows = numbers.chunks(width("point.anchor.keys").max(1));
            rows.into_iter()
                .all(|row| row.iter().all(|v| v.abs() == row[0].abs()))
        }),
        code_bits: scene
            .landmarks
            .as_ref()
            .map_or(0, |_: &LandmarkTable| u64::BITS as usize),
        map,
    }
}

fn all_points(map: &Map) -> impl Iterator<Item = &Vector3<f64>> {
    map.points.iter().chain(map.segments.iter().flatten())
}

/// Two axes of the floor and the one that stands on it: from gravity, else the direction in which the place is thinnest.
fn axes(map: &Map, gravity: Option<Vector3<f64>>) -> Matrix3<f64> {
    let count = all_points(map).count().max(1) as f64;
    let centre: Vector3<f64> = all_points(map).sum::<Vector3<f64>>() / count;
    let spread: Matrix3<f64> = all_points(map)
        .map(|p| (p - centre) * (p - centre).transpose())
        .sum();
    let eigen = spread.symmetric_eigen();
    let thinnest = eigen.eigenvalues.imin();
    let up = gravity.map_or_else(
        || eigen.eigenvectors.column(thinnest).into_owned(),
        |g| -g.normalize(),
    );
    let longest = eigen.eigenvectors.column(eigen.eigenvalues.imax());
    let along = longest - up * up.dot(&longest);
    // A tower is longest upwards; any direction of its floor will do.
    let along = if along.norm() > 1e-6 {
        along.normalize()
    } else {
        up.cross(&Vector3::new(up.y, up.z, -up.x)).normalize()
    };
    Matrix3::from_columns(&[along, up.cross(&along), up])
}

/// Directions in which a floor plan's farthest points are looked for: so many corners it has at most.
const CORNERS: usize = 16;
/// One point in so many may lie outside of a floor plan on each side: wrong ones, and what is seen through doors.
const OUTSIDE: usize = 50;

/// Corners of the floor plan, counter-clockwise seen from above, on the height of most points: what holds nearly all points.
/// Empty where there are too few. Without gravity above is where y shrinks, as in a world that begins with a camera.
pub fn outline(map: &Map, gravity: Option<Vector3<f64>>) -> Vec<Vector3<f64>> {
    let axes = axes(map, gravity);
    let axes = match gravity {
        None if axes.column(2).y > 0.0 => Matrix3::from_columns(&[
            axes.column(0).into_owned(),
            -axes.column(1),
            -axes.column(2),
        ]),
        _ => axes,
    };
    let flat: Vec<Vector3<f64>> = all_points(map).map(|p| axes.transpose() * p).collect();
    if flat.len() < OUTSIDE {
        return Vec::new();
    }
    let middle = |mut values: Vec<f64>| {
        let half = values.len() / 2;
        *values.select_nth_unstable_by(half, f64::total_cmp).1
    };
    let height = middle(flat.iter().map(|p| p.z).collect());
    let directions: Vec<(f64, f64)> = (0..CORNERS)
        .map(|k| (core::f64::consts::TAU * k as f64 / CORNERS as f64).sin_cos())
        .collect();
    let along = |p: &Vector3<f64>, (sin, cos): (f64, f64)| cos * p.x + sin * p.y;
    let limits: Vec<f64> = directions
        .iter()
        .map(|direction| {
            let mut far: Vec<f64> = flat.iter().map(|p| along(p, *direction)).collect();
            let at = far.len() - 1 - far.len() / OUTSIDE;
            *far.select_nth_unstable_by(at, f64::total_cmp).1
        })
        .collect();
    let is_inside = |p: &&Vector3<f64>| {
        let mut sides = directions.iter().zip(&limits);
        sides.all(|(direction, limit)| along(p, *direction) <= *limit)
    };
    let kept: Vec<&Vector3<f64>> = flat.iter().filter(is_inside).collect();
    let mut corners: Vec<Vector3<f64>> = Vec::with_capacity(CORNERS);
    for direction in &directions {
        let far = |p: &&&Vector3<f64>| along(p, *direction);
        let farthest = kept.iter().max_by(|a, b| far(a).total_cmp(&far(b)));
        let corner = farthest.map(|p| axes * Vector3::new(p.x, p.y, height));
        corners.extend(corner.filter(|c| !corners.contains(c)));
    }
    if corners.len() < 3 {
        corners.clear();
    }
    corners
}

/// What the file tells, a line each.
pub fn words(scene: &SceneFile, revealed: &Revealed) -> Vec<String> {
    let info = &scene.info;
    let unit = info.units.symbol();
    let [length, width, height] = revealed.extent;
    let mut out = vec![format!(
        "the place itself: {} points and {} segments, {length:.2} x {width:.2} x {height:.2} {unit} (the drawing shows them)",
        revealed.map.points.len(),
        revealed.map.segments.len()
    )];
    match revealed.descriptor_numbers {
        [0, 0] => out.push(
            "no descriptors as such: the place is in the weights of a network, which answers what it was taught".to_owned(),
        ),
        [points, lines] if revealed.are_signs => out.push(format!(
            "descriptors of {points} signs for points and {lines} for segments: one bit a number, less to compute a picture from, not \
             nothing"
        )),
        [points, lines] => out.push(format!(
            "descriptors of {points} numbers for points and {lines} for segments: from such, pictures of what surrounds each point \
             have been computed that people recognise (Pittaluga et al., CVPR 2019)"
        )),
    }
    if revealed.code_bits > 0 {
        out.push(format!(
            "codes of {} bits for landmarks: less than a descriptor, but still what each point looks like",
            revealed.code_bits
        ));
    }
    if scene.landmarks.is_some() {
        out.push("from which sides each landmark was seen, so where the camera went".to_owned());
    }
    for camera in info.camera.iter().chain(&info.other_cameras) {
        out.push(format!(
            "a camera: {} of {}x{} pixels, with its focal length",
            camera.model.name(),
            camera.width,
            camera.height
        ));
    }
    if let Some(training) = &info.training {
        let source = if training.source.is_empty() {
            String::new()
        } else {
            format!(", source {:?}", training.source)
        };
        out.push(format!(
            "{} pictures were used{source}",
            training.num_images
        ));
    }
    if let Some(created) = &info.created {
        out.push(format!("when it was made: {created}"));
    }
    out.push("no pictures, no colours, no positions of single pictures".to_owned());
    out
}

/// Side of a panel of the drawing, pixels.
const PANEL: f64 = 480.0;
const MARGIN: f64 = 12.0;

/// The place from above and from the side.
pub fn drawing(revealed: &Revealed, gravity: Option<Vector3<f64>>) -> String {
    let map = &revealed.map;
    let axes = axes(map, gravity);
    let size = 2.0 * PANEL;
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {size} {PANEL}\" font-family=\"sans-serif\" font-size=\"13\">\
         <rect width=\"{size}\" height=\"{PANEL}\" fill=\"white\"/>\n"
    );
    // The drawing's x and y as axes of the world, and the words above it.
    let panels = [
        (0.0, [0, 1], "from above"),
        (PANEL, [0, 2], "from the side"),
    ];
    for (left, [i, j], title) in panels {
        let at = |p: &Vector3<f64>| [axes.column(i).dot(p), -axes.column(j).dot(p)];
        let mut low = [f64::INFINITY; 2];
        let mut high = [f64::NEG_INFINITY; 2];
        for p in all_points(map) {
            for (k, v) in at(p).into_iter().enumerate() {
                low[k] = low[k].min(v);
                high[k] = high[k].max(v);
            }
        }
        let side = (high[0] - low[0])
            .max(high[1] - low[1])
            .max(f64::MIN_POSITIVE);
        let scale = (PANEL - 2.0 * MARGIN) / side;
        let place = |p: &Vector3<f64>| {
            let [x, y] = at(p);
            [
                left + MARGIN + scale * (x - low[0]),
                MARGIN + scale * (y - low[1]),
            ]
        };
        for [a, b] in &map.segments {
            let ([x1, y1], [x2, y2]) = (place(a), place(b));
            let _ = writeln!(
                out,
                "<line x1=\"{x1:.1}\" y1=\"{y1:.1}\" x2=\"{x2:.1}\" y2=\"{y2:.1}\" stroke=\"#0a7ea4\" stroke-width=\"0.8\"/>"
            );
        }
        for p in &map.points {
            let [x, y] = place(p);
            let _ = writeln!(
                out,
                "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"0.9\" fill=\"#444\"/>"
            );
        }
        let _ = writeln!(
            out,
            "<text x=\"{}\" y=\"{}\">{title}</text>",
            left + MARGIN,
            PANEL - 4.0
        );
    }
    out.push_str("</svg>\n");
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_is_drawn_upright_and_measured() {
        // A room of 4 x 3 x 2 whose up is y.
        let mut map = Map::default();
        for i in 0..1000 {
            let part = |n: i32, k: i32| f64::from(i / k % n) / f64::from(n - 1);
            map.points.push(Vector3::new(
                4.0 * part(10, 1),
                2.0 * part(10, 10),
                3.0 * part(10, 100),
            ));
        }
        map.segments
            .push([Vector3::zeros(), Vector3::new(4.0, 0.0, 0.0)]);
        let up = axes(&map, None);
        assert!((up.column(2).y.abs() - 1.0).abs() < 1e-3, "{up}");
        let down = Vector3::new(0.0, -1.0, 0.0);
        assert!((axes(&map, Some(down)).column(2) + down).norm() < 1e-12);
        let revealed = Revealed {
            are_signs: false,
            map,
            extent: [4.0, 3.0, 2.0],
            descriptor_numbers: [64, 0],
            code_bits: 0,
        };
        let svg = drawing(&revealed, Some(down));
        assert_eq!(svg.matches("<circle").count(), 2 * 1000);
        assert_eq!(svg.matches("<line").count(), 2);
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
    }

    #[test]
    fn a_floor_plan_goes_round_the_room_counter_clockwise_and_leaves_strays_out() {
        // Four by three, seen from +z, which is up; and one point far away.
        let mut map = Map::default();
        for i in 0..400 {
            let part = |k: i32| f64::from(i / k % 20) / 19.0;
            map.points
                .push(Vector3::new(4.0 * part(1), 3.0 * part(20), 1.5));
        }
        map.points.push(Vector3::new(100.0, 50.0, 1.0));
        let down = Vector3::new(0.0, 0.0, -1.0);
        let corners = outline(&map, Some(down));
        assert!((4..=CORNERS).contains(&corners.len()), "{corners:?}");
        let next = corners.iter().cycle().skip(1);
        let area: f64 = corners
            .iter()
            .zip(next)
            .map(|(a, b)| 0.5 * (a.x * b.y - a.y * b.x))
            .sum();
        assert!((10.0..=12.0).contains(&area), "{area}");
        assert!(corners.iter().all(|c| (c.z - 1.5).abs() < 1e-9));
        // From the other side it goes round the other way.
        let below = outline(&map, Some(-down));
        let turn = (below[1] - below[0]).cross(&(below[2] - below[1]));
        assert!(turn.z < 0.0, "{below:?}");
        assert!(outline(&Map::default(), None).is_empty());
    }

    #[test]
    fn the_sample_tells_its_room() {
        let path = concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../www/scenes/sample/sample.landline"
        );
        let bytes = std::fs::read(path).expect("is there");
        let scene = SceneFile::from_bytes(&bytes).expect("right");
        let revealed = revealed(&scene);
        let landmarks = scene.landmarks.as_ref().expect("has some");
        // The anchors of the networks, and what is looked at again.
        let num_points = 2048 + landmarks.point_positions.len();
        assert_eq!(revealed.map.points.len(), num_points);
        assert_eq!(revealed.descriptor_numbers[0], 64);
        // The rendered room is some metres long and as high as a room is.
        let [length, _, height] = revealed.extent;
        assert!(
            (3.0..12.0).contains(&length) && (1.5..5.0).contains(&height),
            "{:?}",
            revealed.extent
        );
        let words = words(&scene, &revealed).join("\n");
        assert!(
            words.contains(&format!("{num_points} points")) && words.contains("64 numbers"),
            "{words}"
        );
    }

    #[test]
    fn an_empty_map_is_no_fault() {
        let revealed = Revealed {
            are_signs: false,
            map: Map::default(),
            extent: [0.0; 3],
            descriptor_numbers: [0, 0],
            code_bits: 0,
        };
        assert!(drawing(&revealed, None).ends_with("</svg>\n"));
    }
}
