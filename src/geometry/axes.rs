//! Axes of the camera of a file: where its x, y and z point.

use nalgebra::{Matrix3, Vector3};
use std::str::FromStr;

/// Directions of the three axes of a camera, as turns of ours (right, down, forward).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraAxes {
    /// Takes the file's camera space to ours; its columns are where the file's axes point.
    pub ours_from_file: Matrix3<f64>,
}

/// Words for the directions, and where they point in our camera space.
const WORDS: [(&str, [f64; 3]); 6] = [
    ("right", [1.0, 0.0, 0.0]),
    ("left", [-1.0, 0.0, 0.0]),
    ("down", [0.0, 1.0, 0.0]),
    ("up", [0.0, -1.0, 0.0]),
    ("forward", [0.0, 0.0, 1.0]),
    ("back", [0.0, 0.0, -1.0]),
];

/// Names by which axes are known.
const NAMES: [(&str, &str); 4] = [
    ("opencv", "right-down-forward"),
    ("opengl", "right-up-back"),
    ("ros", "forward-left-up"),
    ("ned", "forward-right-down"),
];

impl CameraAxes {
    /// Ours: x right, y down, z forward.
    pub const OPENCV: Self = Self {
        ours_from_file: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
    };
    /// x right, y up, z back.
    pub const OPENGL: Self = Self {
        ours_from_file: Matrix3::new(1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0),
    };
}

impl CameraAxes {
    /// All that a camera can have: the 24 turns of ours.
    pub fn all() -> impl Iterator<Item = Self> {
        let direction = |i: usize| Vector3::from(WORDS[i].1);
        (0..6).flat_map(move |x| {
            (0..6)
                .filter(move |y| y / 2 != x / 2)
                .map(move |y| (direction(x), direction(y)))
                .map(|(x, y)| Self {
                    ours_from_file: Matrix3::from_columns(&[x, y, x.cross(&y)]),
                })
        })
    }

    /// Where x, y and z point.
    pub fn words(&self) -> String {
        let word = |column: Vector3<f64>| {
            let known = WORDS.iter().find(|(_, at)| column == Vector3::from(*at));
            known.map_or("?", |(word, _)| *word)
        };
        let words: [&str; 3] =
            core::array::from_fn(|i| word(self.ours_from_file.column(i).into_owned()));
        words.join("-")
    }
}

impl FromStr for CameraAxes {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let lower = text.to_ascii_lowercase();
        let words = NAMES
            .iter()
            .find(|(name, _)| *name == lower)
            .map_or(lower.as_str(), |(_, words)| words);
        let columns: Vec<Vector3<f64>> = words
            .split('-')
            .filter_map(|word| WORDS.iter().find(|(w, _)| *w == word))
            .map(|(_, direction)| Vector3::from(*direction))
            .collect();
        let known = "opencv (right-down-forward), opengl (right-up-back), ros (forward-left-up), ned \
                     (forward-right-down), or three such words for x, y and z";
        let [x, y, z] = columns.as_slice() else {
            return Err(format!("`{text}` names no axes; give {known}"));
        };
        let ours_from_file = Matrix3::from_columns(&[*x, *y, *z]);
        match ours_from_file.determinant() {
            d if d > 0.0 => Ok(Self { ours_from_file }),
            d if d < 0.0 => Err(format!(
                "`{text}` is left-handed, as no camera can be; give {known}"
            )),
            _ => Err(format!("`{text}` names one direction twice; give {known}")),
        }
    }
}

impl std::fmt::Display for CameraAxes {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let words = self.words();
        f.write_str(
            NAMES
                .iter()
                .find(|(_, w)| *w == words)
                .map_or(words.as_str(), |(name, _)| name),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_and_names_say_where_axes_point() {
        assert_eq!("opencv".parse(), Ok(CameraAxes::OPENCV));
        assert_eq!("right-up-back".parse(), Ok(CameraAxes::OPENGL));
        let ros: CameraAxes = "ros".parse().expect("known");
        // A point one metre ahead and two to the left of a robot's camera.
        let point = ros.ours_from_file * Vector3::new(1.0, 2.0, 0.0);
        assert_eq!(point, Vector3::new(-2.0, 0.0, 1.0));
        assert_eq!(ros.to_string(), "ros");
        let turned: CameraAxes = "down-left-forward".parse().expect("a quarter turn");
        assert_eq!(turned.to_string(), "down-left-forward");
        let all: Vec<CameraAxes> = CameraAxes::all().collect();
        assert_eq!(all.len(), 24);
        for axes in &all {
            assert_eq!(axes.words().parse(), Ok(*axes));
            assert_eq!(all.iter().filter(|other| *other == axes).count(), 1);
        }
        for wrong in [
            "right-up-forward",
            "right-right-up",
            "x-y-z",
            "right-up",
            "",
        ] {
            assert!(wrong.parse::<CameraAxes>().is_err(), "{wrong}");
        }
    }
}
