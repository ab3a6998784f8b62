//! Segments of LSD 1.6 on real pictures, against ours.

use landline::geometry::Segment2;
use landline::image::GrayImage;
use landline::lsd::{LsdParams, LsdScratch, detect};
use landline_testkit::{check_lsd_fingerprints, shared_data};
use std::path::{Path, PathBuf};

/// Golden rows: x1 y1 x2 y2 width p -log10(NFA), first pixel's centre at (0, 0).
type Row = [f64; 7];

fn goldens(dir: &Path) -> Vec<(PathBuf, Vec<Row>)> {
    let mut pictures: Vec<PathBuf> = std::fs::read_dir(dir)
        .expect("a readable folder")
        .map(|entry| entry.expect("a readable entry").path())
        .filter(|path| path.extension().is_some_and(|e| e == "png"))
        .collect();
    pictures.sort();
    pictures
        .into_iter()
        .map(|picture| {
            let text = std::fs::read_to_string(picture.with_extension("json")).expect("a golden");
            let value: serde_json::Value = serde_json::from_str(&text).expect("JSON");
            let rows = value["segments"]
                .as_array()
                .or(value.as_array())
                .expect("rows");
            let rows = rows
                .iter()
                .map(|row| core::array::from_fn(|i| row[i].as_f64().expect("a number")))
                .collect();
            (picture, rows)
        })
        .collect()
}

fn read_gray(path: &Path) -> GrayImage {
    let picture = image::open(path).expect("a picture").into_luma8();
    GrayImage {
        width: picture.width() as usize,
        height: picture.height() as usize,
        data: picture.into_raw(),
    }
}

fn row(s: &Segment2) -> Row {
    [
        s.start.x - 0.5,
        s.start.y - 0.5,
        s.end.x - 0.5,
        s.end.y - 0.5,
        s.width_px,
        s.precision,
        s.neg_log10_nfa,
    ]
}

/// Both end points within `px` and the same value within 1e-3.
fn same(a: &Row, b: &Row, px: f64) -> bool {
    (0..4).all(|i| (a[i] - b[i]).abs() < px) && (a[6] - b[6]).abs() < 1e-3
}

/// Length of the longest common subsequence, which is what "same order" leaves.
fn common_in_order(a: &[Row], b: &[Row], px: f64) -> usize {
    let mut best = vec![0; b.len() + 1];
    for x in a {
        let mut diagonal = 0;
        for (j, y) in b.iter().enumerate() {
            let above = best[j + 1];
            best[j + 1] = if same(x, y, px) {
                diagonal + 1
            } else {
                above.max(best[j])
            };
            diagonal = above;
        }
    }
    best[b.len()]
}

#[test]
fn segments_of_the_published_program_in_its_order() {
    let Some(dir) = shared_data("data/golden/lsd") else {
        return;
    };
    let mut scratch = LsdScratch::default();
    let (mut all, mut all_same) = (0, 0);
    for (picture, golden) in goldens(&dir) {
        let gray = read_gray(&picture);
        let ours: Vec<Row> = detect(&gray.view(), &LsdParams::default(), &mut scratch)
            .expect("a good picture")
            .iter()
            .map(row)
            .collect();
        let (near, tight) = (
            common_in_order(&golden, &ours, 0.05),
            common_in_order(&golden, &ours, 1e-3),
        );
        let name = picture.file_stem().unwrap_or_default().to_string_lossy();
        println!(
            "{name}: golden {}, ours {}, within 0.05 px {near}, within 1e-3 px {tight}",
            golden.len(),
            ours.len()
        );
        assert!(near * 100 >= golden.len() * 99, "{name}");
        assert!(near * 100 >= ours.len() * 99, "{name}");
        all += golden.len();
        all_same += tight;
    }
    println!("{all_same} of {all} within 1e-3 px");
    assert!(all_same * 1000 >= all * 995);
}

#[test]
fn segments_have_the_listed_bits() {
    let mut scratch = LsdScratch::default();
    check_lsd_fingerprints(|picture| {
        detect(&picture.view(), &LsdParams::default(), &mut scratch)
            .expect("a good picture")
            .iter()
            .flat_map(Segment2::to_numbers)
            .collect()
    });
}
