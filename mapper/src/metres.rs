//! Metres for poses that were found from pictures alone: from a distance that was measured, or from positions that are known.

use landline::geometry::Similarity;
use landline::math::stats::median_in_place;
use landline::reconstruction::motion::Component;
use nalgebra::Vector3;
use std::path::{Path, PathBuf};

/// What says how long one unit of length is.
#[derive(Debug, Clone, PartialEq)]
pub enum Metres {
    /// Two pictures and how far apart they were taken, in metres.
    Distance(Distance),
    /// Where pictures were taken, in metres, and the file that says so.
    Positions(PathBuf, Vec<(String, Vector3<f64>)>),
}

/// Two pictures and how far apart they were taken.
#[derive(Debug, Clone, PartialEq)]
pub struct Distance {
    /// Name of a picture.
    pub from: String,
    /// Name of another picture.
    pub to: String,
    /// In metres.
    pub metres: f64,
}

/// Why poses do not get metres.
#[derive(Debug, thiserror::Error)]
pub enum MetresError {
    /// The operating system refused.
    #[error("cannot read {path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A line of the file is not a position.
    #[error("{path}, line {line}: {what}; expected `name x y z` in metres")]
    Line {
        /// The file.
        path: PathBuf,
        /// From 1.
        line: usize,
        /// What is wrong.
        what: String,
    },
    /// A picture of the distance has no pose.
    #[error("--scale-from: {name} {what}")]
    Picture {
        /// As it was given.
        name: String,
        /// What is wrong with it.
        what: String,
    },
    /// The two pictures say nothing about lengths.
    #[error(
        "--scale-from: {from} and {to} were taken {share:.1} % of the camera's way apart, too near each other to say how long \
         that is: measure between two places that are far apart"
    )]
    TooNear {
        /// A picture.
        from: String,
        /// Another.
        to: String,
        /// Their distance in the model, in per cent of its extent.
        share: f64,
    },
    /// Positions of other names.
    #[error(
        "none of the names in {path} is a picture's: it says `{theirs}`, and the pictures are called as `{ours}` is, with their \
         endings"
    )]
    NoneKnown {
        /// The file.
        path: PathBuf,
        /// Its first name.
        theirs: String,
        /// The first picture's name.
        ours: String,
    },
    /// Too few positions.
    #[error(
        "{path} has positions of {found} of the pictures that were placed, or they lie in one line: three at least are needed \
         that do not"
    )]
    TooFew {
        /// The file.
        path: PathBuf,
        /// Placed pictures that it names.
        found: usize,
    },
    /// Positions and model have different shapes.
    #[error(
        "{path} contradicts the pictures: after the best fit positions are off by {off:.2} m (median), their extent is \
         {extent:.2} m; look at names and units, and whether the pictures were placed rightly"
    )]
    Contradiction {
        /// The file.
        path: PathBuf,
        /// In metres.
        off: f64,
        /// In metres.
        extent: f64,
    },
}

/// Two pictures nearer than this share of the extent of all do not give a scale.
const MIN_SHARE: f64 = 0.02;
/// Positions that are off by this share of their extent, in the median, are of something else.
pub const MAX_OFF: f64 = 0.1;
/// Positions off by so many times the median do not count.
const STRAY: f64 = 3.0;

/// `NAME,NAME,METRES`.
///
/// # Errors
/// In words.
pub fn parse_distance(text: &str) -> Result<Distance, String> {
    let fields: Vec<&str> = text.split(',').map(str::trim).collect();
    let [from, to, metres] = fields.as_slice() else {
        return Err(
            "expected NAME,NAME,METRES: two pictures and how far apart they were taken".to_owned(),
        );
    };
    let number: f64 = metres
        .parse()
        .map_err(|_| format!("`{metres}` is no number"))?;
    if !(number.is_finite() && number > 0.0) {
        return Err(format!("a distance of {metres} m: expected more than zero"));
    }
    if from == to {
        return Err(format!("{from} twice: expected two pictures"));
    }
    Ok(Distance {
        from: (*from).to_owned(),
        to: (*to).to_owned(),
        metres: number,
    })
}

impl Metres {
    /// Reads a list `name x y z`; empty lines and those that begin with `#` are skipped.
    ///
    /// # Errors
    /// When the file cannot be read or a line is something else.
    pub fn read_positions(path: &Path) -> Result<Self, MetresError> {
        let text = std::fs::read_to_string(path).map_err(|source| MetresError::Io {
            path: path.to_owned(),
            source,
        })?;
        let mut positions: Vec<(String, Vector3<f64>)> = Vec::new();
        for (i, line) in text.lines().enumerate() {
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let wrong = |what: String| MetresError::Line {
                path: path.to_owned(),
                line: i + 1,
                what,
            };
            let fields: Vec<&str> = line.split_whitespace().collect();
            let [name, numbers @ ..] = fields.as_slice() else {
                continue;
            };
            if numbers.len() != 3 {
                return Err(wrong(format!("{} numbers after the name", numbers.len())));
            }
            let mut position = Vector3::zeros();
            for (value, field) in position.iter_mut().zip(numbers) {
                *value = field
                    .parse()
                    .ok()
                    .filter(|v: &f64| v.is_finite())
                    .ok_or_else(|| wrong(format!("`{field}` is no finite number")))?;
            }
            if positions.iter().any(|(known, _)| known == name) {
                return Err(wrong(format!("{name} was there before")));
            }
            positions.push(((*name).to_owned(), position));
        }
        Ok(Self::Positions(path.to_owned(), positions))
    }

    /// Refuses names that none of the pictures has, before anything expensive happens.
    ///
    /// # Errors
    /// [`MetresError::Picture`], [`MetresError::TooFew`].
    pub fn check(&self, names: &[&str]) -> Result<(), MetresError> {
        let is_there = |name: &String| names.contains(&name.as_str());
        match self {
            Self::Distance(Distance { from, to, .. }) => {
                match [from, to].into_iter().find(|name| !is_there(name)) {
                    Some(name) => Err(MetresError::Picture {
                        name: name.clone(),
                        what: match names {
                            [] => "is none of the pictures".to_owned(),
                            [first, ..] => {
                                format!("is none of the pictures, which are called as {first} is")
                            }
                        },
                    }),
                    None => Ok(()),
                }
            }
            Self::Positions(path, positions) => {
                let found = positions.iter().filter(|(name, _)| is_there(name)).count();
                if let (0, [(theirs, _), ..], [ours, ..]) = (found, positions.as_slice(), names) {
                    return Err(MetresError::NoneKnown {
                        path: path.clone(),
                        theirs: theirs.clone(),
                        ours: (*ours).to_owned(),
                    });
                }
                if found < 3 {
                    return Err(MetresError::TooFew {
                        path: path.clone(),
                        found,
                    });
                }
                Ok(())
            }
        }
    }

    /// Gives the component metres, of positions also their axes; says in a line what that rests on. `names` are those of its
    /// pictures.
    ///
    /// # Errors
    /// When what is known does not fit the component, which is left as it was.
    pub fn apply(&self, component: &mut Component, names: &[&str]) -> Result<String, MetresError> {
        self.check(names)?;
        let placed: Vec<(&str, Vector3<f64>)> = names
            .iter()
            .zip(&component.cam_from_world)
            .filter_map(|(name, pose)| Some((*name, pose.as_ref()?.center_in_world())))
            .collect();
        let (similarity, said) = match self {
            Self::Distance(distance) => from_distance(distance, &placed)?,
            Self::Positions(path, positions) => from_positions(path, positions, &placed)?,
        };
        component.transform(&similarity);
        Ok(said)
    }
}

/// The similarity that brings the second of most pairs to the first, the median of what is left of all, and how many pairs
/// fit; none where [`Similarity::fit`] has none.
pub fn robust_fit(all: &[(Vector3<f64>, Vector3<f64>)]) -> Option<(Similarity, f64, usize)> {
    let limit_floor = 1e-9 * extent(all.iter().map(|(a, _)| *a));
    let mut kept = all.to_vec();
    let mut best = None;
    // What is far off bends the first fit, and goes.
    for _ in 0..5 {
        let found = Similarity::fit(&kept)?;
        let off = |(a, b): &(Vector3<f64>, Vector3<f64>)| (a - found.transform_point(b)).norm();
        let median = median_in_place(&mut all.iter().map(off).collect::<Vec<f64>>())?;
        let limit = STRAY * median + limit_floor;
        kept = all.iter().filter(|p| off(p) <= limit).copied().collect();
        best = Some((found, median, kept.len()));
    }
    best
}

/// Diagonal of the box round points.
pub fn extent(points: impl Iterator<Item = Vector3<f64>> + Clone) -> f64 {
    let bound = |start: f64, pick: fn(f64, f64) -> f64| {
        points
            .clone()
            .fold(Vector3::repeat(start), |all, p| all.zip_map(&p, pick))
    };
    (bound(f64::MIN, f64::max) - bound(f64::MAX, f64::min)).norm()
}

fn from_distance(
    distance: &Distance,
    placed: &[(&str, Vector3<f64>)],
) -> Result<(Similarity, String), MetresError> {
    let place = |name: &String| {
        let found = placed.iter().find(|(known, _)| known == name);
        let place = found.map(|(_, place)| *place);
        place.ok_or_else(|| MetresError::Picture {
            name: name.clone(),
            what: "is not among the pictures that were placed together: name another one"
                .to_owned(),
        })
    };
    let length = (place(&distance.from)? - place(&distance.to)?).norm();
    let share = length / extent(placed.iter().map(|(_, p)| *p));
    if !(share >= MIN_SHARE) {
        return Err(MetresError::TooNear {
            from: distance.from.clone(),
            to: distance.to.clone(),
            share: 100.0 * share,
        });
    }
    let similarity = Similarity {
        scale: distance.metres / length,
        rotation: nalgebra::Matrix3::identity(),
        translation: Vector3::zeros(),
    };
    let said = format!(
        "metres           {} and {} are {} m apart",
        distance.from, distance.to, distance.metres
    );
    Ok((similarity, said))
}

fn from_positions(
    path: &Path,
    positions: &[(String, Vector3<f64>)],
    placed: &[(&str, Vector3<f64>)],
) -> Result<(Similarity, String), MetresError> {
    let of_placed = |(name, position): &(String, Vector3<f64>)| {
        let found = placed.iter().find(|(known, _)| known == name)?;
        Some((*position, found.1))
    };
    let all: Vec<(Vector3<f64>, Vector3<f64>)> = positions.iter().filter_map(of_placed).collect();
    let too_few = || MetresError::TooFew {
        path: path.to_owned(),
        found: all.len(),
    };
    let extent = extent(all.iter().map(|(a, _)| *a));
    let (found, off, num_kept) = robust_fit(&all).ok_or_else(too_few)?;
    if !(off <= MAX_OFF * extent) {
        return Err(MetresError::Contradiction {
            path: path.to_owned(),
            off,
            extent,
        });
    }
    let said = format!(
        "metres           from {} positions, off by {off:.3} m (median); {} do not fit",
        num_kept,
        all.len() - num_kept
    );
    Ok((found, said))
}

#[cfg(test)]
mod tests {
    use super::*;
    use landline::geometry::{CamFromWorld, Camera, rotation_from_vector};
    use landline::reconstruction::{Observation, PointTrack};

    const NAMES: [&str; 6] = ["a.jpg", "b.jpg", "c.jpg", "d.jpg", "e.jpg", "lost.jpg"];

    /// Where the pictures were taken; the last one has no pose.
    fn centers() -> Vec<Vector3<f64>> {
        let of = |i: usize| Vector3::new(i as f64, (i * i % 5) as f64, 0.3 * (i % 3) as f64);
        (0..5).map(of).collect()
    }

    fn component() -> Component {
        let pose = |c: &Vector3<f64>| {
            let rotation = rotation_from_vector(&(0.2 * c));
            CamFromWorld::new(rotation, -(rotation * c))
        };
        let mut cam_from_world: Vec<_> = centers().iter().map(|c| Some(pose(c))).collect();
        cam_from_world.push(None);
        let seen = vec![Observation::new(0, 0), Observation::new(1, 0)];
        Component {
            cameras: vec![Camera::centered(640, 480, 500.0)],
            focal_sigma_ln: vec![None],
            cam_from_world,
            points: vec![PointTrack::new(Vector3::new(1.0, 2.0, 5.0), seen)],
            rms_px: 1.0,
        }
    }

    fn distance(text: &str) -> Metres {
        Metres::Distance(parse_distance(text).expect("a distance"))
    }

    #[test]
    fn a_distance_gives_metres() {
        let mut found = component();
        let before = found.clone();
        let apart = (centers()[0] - centers()[3]).norm();
        let said = distance("a.jpg, d.jpg, 1.80").apply(&mut found, &NAMES);
        assert!(said.expect("metres").contains("1.8 m apart"));
        let scale = 1.8 / apart;
        for (new, old) in found.cam_from_world.iter().zip(&before.cam_from_world) {
            let (Some(new), Some(old)) = (new, old) else {
                assert_eq!(new, old);
                continue;
            };
            assert!((new.center_in_world() - scale * old.center_in_world()).norm() < 1e-9);
            let point = found.points[0].point_in_world;
            let expected = scale * old.transform_point(&before.points[0].point_in_world);
            assert!((new.transform_point(&point) - expected).norm() < 1e-9);
        }
    }

    #[test]
    fn positions_give_metres_and_axes_whatever_one_of_them_says() {
        let truth = Similarity {
            scale: 0.37,
            rotation: rotation_from_vector(&Vector3::new(0.4, -1.0, 0.2)),
            translation: Vector3::new(5.0, 6.0, -7.0),
        };
        let mut positions: Vec<(String, Vector3<f64>)> = NAMES
            .iter()
            .zip(centers())
            .map(|(n, c)| ((*n).to_owned(), truth.transform_point(&c)))
            .collect();
        positions.push(("elsewhere.jpg".to_owned(), Vector3::zeros()));
        let mut found = component();
        let metres = Metres::Positions(PathBuf::from("gps.txt"), positions);
        metres.apply(&mut found, &NAMES).expect("metres");
        for (pose, c) in found.cam_from_world.iter().zip(centers()) {
            let center = pose.expect("posed").center_in_world();
            assert!((center - truth.transform_point(&c)).norm() < 1e-6);
        }
    }

    #[test]
    fn what_does_not_fit_is_refused_in_words_and_changes_nothing() {
        let refusal = |metres: Metres| {
            let mut found = component();
            let error = metres.apply(&mut found, &NAMES).expect_err("refused");
            assert_eq!(found.cam_from_world, component().cam_from_world);
            error.to_string()
        };
        assert!(refusal(distance("a.jpg,x.jpg,1")).contains("x.jpg is none of the pictures"));
        assert!(refusal(distance("lost.jpg,a.jpg,1")).contains("lost.jpg is not among"));
        let of = |places: &[Vector3<f64>]| {
            let named = NAMES.iter().zip(places).map(|(n, p)| ((*n).to_owned(), *p));
            Metres::Positions(PathBuf::from("gps.txt"), named.collect())
        };
        let without = NAMES.iter().zip(centers());
        let without = without.map(|(n, p)| (n.trim_end_matches(".jpg").to_owned(), p));
        let text = refusal(Metres::Positions(
            PathBuf::from("gps.txt"),
            without.collect(),
        ));
        assert!(text.contains("`a`") && text.contains("`a.jpg`"), "{text}");
        assert!(refusal(of(&centers()[..2])).contains("of 2 of the pictures"));
        let mut wrong = centers();
        wrong.reverse();
        wrong.swap(0, 2);
        assert!(refusal(of(&wrong)).contains("contradicts the pictures"));
        for (text, word) in [
            ("a,b", "expected NAME,NAME,METRES"),
            ("a,b,far", "`far` is no number"),
            ("a,b,-1", "more than zero"),
            ("a,a,1", "two pictures"),
        ] {
            let error = parse_distance(text).expect_err("refused");
            assert!(error.contains(word), "{error}");
        }
    }

    #[test]
    fn lists_of_positions_are_read_or_refused_by_line() {
        let folder = std::env::temp_dir().join(format!("landline-metres-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder");
        let path = folder.join("positions.txt");
        let read = |text: &str| {
            std::fs::write(&path, text).expect("written");
            Metres::read_positions(&path)
        };
        let good = read("# metres\n\na.jpg 1 2 3\n b.jpg -1e0 0 0\n").expect("a list");
        let Metres::Positions(_, positions) = good else {
            panic!("no positions");
        };
        assert_eq!(positions[1], ("b.jpg".to_owned(), -Vector3::x()));
        for (text, word) in [
            ("a.jpg 1 2 3\nb.jpg 1 2\n", "line 2: 2 numbers"),
            ("a.jpg 1 2 x\n", "`x` is no finite number"),
            ("a.jpg 1 2 NaN\n", "`NaN` is no finite number"),
            ("a.jpg 1 2 3\na.jpg 1 2 3\n", "was there before"),
        ] {
            let error = read(text).expect_err("refused").to_string();
            assert!(error.contains(word), "{error}");
        }
        std::fs::remove_dir_all(&folder).expect("removed");
    }
}
