//! The line segment detector gives the same bits on every target: fingerprints of its output, one list for all.

use crate::skip;
use landline::image::GrayImage;
use std::fmt::Write as _;

/// Name and PNG of the reference pictures; empty where they are missing.
const PICTURES: &[(&str, &[u8])] = include!(concat!(env!("OUT_DIR"), "/lsd_pictures.rs"));
/// Name, number of segments and fingerprint, one picture a line.
const FINGERPRINTS: &str = include_str!("../../tests/goldens/lsd_fingerprints.txt");

/// A picture made of integers alone: tilted bands with noise, so that every step of the detector runs.
fn bands(seed: u32) -> GrayImage {
    let (width, height) = (320, 240);
    let mut noise = seed;
    let data = (0..width * height)
        .map(|i| {
            let (x, y) = (i % width, i / width);
            noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let band = (x * (3 + seed as usize) + y * 5) / 211 + (y * 7 + 300 * 7 - x) / 389;
            (40 + band * 53 % 150) as u8 + (noise >> 27) as u8
        })
        .collect();
    GrayImage {
        data,
        width,
        height,
    }
}

/// FNV-1a over the bits.
fn fingerprint(values: &[f64]) -> u64 {
    values
        .iter()
        .flat_map(|v| v.to_bits().to_le_bytes())
        .fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
        })
}

/// Runs `detect`, which gives seven numbers a segment, on synthetic and reference pictures and compares the bits with
/// the list in `tests/goldens`. The list was made by the native build; the other targets must reproduce it.
///
/// # Panics
/// When a picture differs from the list; the message holds the list as it would be.
pub fn check_lsd_fingerprints(mut detect: impl FnMut(&GrayImage) -> Vec<f64>) {
    let mut found = String::new();
    let mut check = |name: &str, picture: &GrayImage| {
        let values = detect(picture);
        assert_eq!(values.len() % 7, 0, "{name}");
        writeln!(
            found,
            "{name} {} {:016x}",
            values.len() / 7,
            fingerprint(&values)
        )
        .expect("a string takes all");
    };
    for seed in 1..=4 {
        check(&format!("bands_{seed}"), &bands(seed));
    }
    if PICTURES.is_empty() {
        skip(
            "reference data not here: ../shared/data/golden/lsd (synthetic pictures were compared)",
        );
    }
    for (name, png) in PICTURES {
        let picture = image::load_from_memory(png).expect("a PNG").into_luma8();
        let picture = GrayImage {
            width: picture.width() as usize,
            height: picture.height() as usize,
            data: picture.into_raw(),
        };
        check(name, &picture);
    }
    let different: Vec<&str> = found
        .lines()
        .filter(|line| !FINGERPRINTS.lines().any(|known| known == *line))
        .collect();
    assert!(
        different.is_empty(),
        "not as listed:\n{}\nthe whole list as found:\n{found}",
        different.join("\n")
    );
}
