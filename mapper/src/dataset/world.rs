//! What the lengths and the directions of a data set's world mean: its unit, its scale, which way is up.

use super::args::DataArgs;
use super::{Dataset, DatasetError};
use landline::geometry::CamFromWorld;
use landline::scene_file::Units;
use nalgebra::Vector3;
use std::path::Path;

/// Units on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum UnitsArg {
    /// One unit of length is one metre.
    Metres,
    /// Nobody knows how long one unit of length is.
    Arbitrary,
}

impl From<UnitsArg> for Units {
    fn from(arg: UnitsArg) -> Self {
        match arg {
            UnitsArg::Metres => Self::Metres,
            UnitsArg::Arbitrary => Self::Arbitrary,
        }
    }
}

/// Smallest and largest metres for one unit of length: from a thousandth of a millimetre to a thousand kilometres.
const SCALES: std::ops::RangeInclusive<f64> = 1e-6..=1e6;

/// Three numbers, `X,Y,Z`.
///
/// # Errors
/// In words, for clap.
pub fn parse_vector(text: &str) -> Result<[f64; 3], String> {
    let numbers: Vec<f64> = text
        .split(',')
        .map(|field| {
            let field = field.trim();
            field.parse().map_err(|_| format!("`{field}` is no number"))
        })
        .collect::<Result<_, String>>()?;
    numbers
        .try_into()
        .map_err(|_| "expected X,Y,Z: three numbers with commas between them".to_owned())
}

/// Refuses a scale that no data set has; `path` is of what it is for.
///
/// # Errors
/// [`DatasetError::Option`].
pub fn check_scale(path: &Path, scale: f64) -> Result<(), DatasetError> {
    if SCALES.contains(&scale) {
        return Ok(());
    }
    Err(DatasetError::Option {
        path: path.to_owned(),
        option: "--scale",
        value: format!("{scale:e}"),
        reason: "expected metres for one unit of length, 1e-6 to 1e6",
    })
}

/// The direction of gravity where `up` points up.
///
/// # Errors
/// [`DatasetError::Option`] for a vector without a direction.
pub fn gravity_from_up(path: &Path, up: [f64; 3]) -> Result<Vector3<f64>, DatasetError> {
    let vector = Vector3::from(up);
    // The largest part first, so that neither very long nor very short vectors lose their squares.
    let most = vector.amax();
    if !(most > 0.0 && vector.iter().all(|v| v.is_finite())) {
        return Err(DatasetError::Option {
            path: path.to_owned(),
            option: "--up",
            value: format!("{},{},{}", up[0], up[1], up[2]),
            reason: "expected a direction: finite numbers, not all of them zero",
        });
    }
    // Subtracted from zero, a zero stays one without a sign.
    Ok(Vector3::zeros() - (vector / most).normalize())
}

/// Applies what the user says about the world to what the reader delivered.
pub(super) fn apply(dataset: &mut Dataset, args: &DataArgs) -> Result<(), DatasetError> {
    if let Some(units) = args.units {
        dataset.units = units.into();
    }
    if let Some(scale) = args.scale {
        check_scale(&args.data, scale)?;
        rescale(dataset, scale);
        dataset.units = Units::Metres;
    }
    if let Some(up) = args.up {
        dataset.gravity = Some(gravity_from_up(&args.data, up)?);
    }
    Ok(())
}

fn rescale(dataset: &mut Dataset, scale: f64) {
    for image in &mut dataset.images {
        image.cam_from_world = image
            .cam_from_world
            .map(|t| CamFromWorld::new(t.rotation, scale * t.translation));
    }
    for point in &mut dataset.points {
        point.point_in_world *= scale;
    }
    for line in &mut dataset.lines {
        line.start_in_world *= scale;
        line.end_in_world *= scale;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::{DatasetImage, ModelPoint, Split};
    use clap::Parser as _;
    use landline::geometry::Camera;

    #[derive(clap::Parser)]
    struct Line {
        #[command(flatten)]
        data: DataArgs,
    }

    fn dataset() -> Dataset {
        let mut dataset = Dataset::empty("test");
        dataset.images.push(DatasetImage {
            name: "a".to_owned(),
            path: "a.png".into(),
            camera: Camera::centered(640, 480, 500.0),
            cam_from_world: Some(CamFromWorld::from_quaternion_wxyz(
                [0.9, 0.1, 0.2, -0.1],
                Vector3::new(1.0, 2.0, 3.0),
            )),
            split: Split::Train,
        });
        dataset.points.push(ModelPoint {
            point_in_world: Vector3::new(4.0, -5.0, 6.0),
            observations: Vec::new(),
        });
        dataset
    }

    fn applied(words: &[&str]) -> Result<Dataset, DatasetError> {
        let line = Line::try_parse_from([&["test", "some/folder"], words].concat())
            .expect("a command line");
        let mut dataset = dataset();
        apply(&mut dataset, &line.data).map(|()| dataset)
    }

    #[test]
    fn a_known_scale_makes_metres_and_keeps_what_the_pictures_show() {
        let (before, after) = (dataset(), applied(&["--scale", "0.25"]).expect("a scale"));
        assert_eq!(
            (before.units, after.units),
            (Units::Arbitrary, Units::Metres)
        );
        let seen = |d: &Dataset| {
            let image = &d.images[0];
            let in_cam = image
                .cam_from_world
                .expect("posed")
                .transform_point(&d.points[0].point_in_world);
            (in_cam.norm(), in_cam.normalize())
        };
        let ((far, direction), (near, same)) = (seen(&before), seen(&after));
        assert!((near - 0.25 * far).abs() < 1e-12);
        assert!((direction - same).norm() < 1e-12);
        let said = applied(&["--units", "metres"]).expect("a word");
        assert_eq!(said.units, Units::Metres);
        assert_eq!(said.images, before.images);
    }

    #[test]
    fn scales_and_directions_that_mean_nothing_are_refused_by_file_option_and_value() {
        for (option, value, shown) in [
            ("--scale", "0", "0e0"),
            ("--scale", "NaN", "NaN"),
            ("--scale", "1e300", "1e300"),
            ("--scale", "-1", "-1e0"),
            ("--scale", "inf", "inf"),
            ("--up", "0,0,0", "0,0,0"),
            ("--up", "NaN,0,1", "NaN,0,1"),
            ("--up", "0,inf,0", "0,inf,0"),
        ] {
            let word = format!("{option}={value}");
            let error = applied(&[&word]).expect_err("means nothing");
            let DatasetError::Option {
                option: o,
                value: v,
                ..
            } = &error
            else {
                panic!("{error}");
            };
            assert_eq!((*o, v.as_str()), (option, shown));
            assert!(error.to_string().starts_with("some/folder: "), "{error}");
        }
        for words in [
            &["--units", "feet"][..],
            &["--up", "0,1"],
            &["--up", "a,b,c"],
            &["--units", "metres", "--scale", "2"],
        ] {
            assert!(
                Line::try_parse_from([&["test", "x"], words].concat()).is_err(),
                "{words:?}"
            );
        }
    }

    #[test]
    fn gravity_is_the_opposite_of_up_however_long_that_is() {
        for up in [[0.0, 1.0, 0.0], [0.0, 1e300, 0.0], [0.0, 1e-300, 0.0]] {
            let gravity = gravity_from_up(Path::new("x"), up).expect("a direction");
            assert_eq!(gravity, Vector3::new(0.0, -1.0, 0.0));
        }
        let tilted = applied(&["--up=0,-3,4"]).expect("a direction").gravity;
        assert!((tilted.expect("given") - Vector3::new(0.0, 0.6, -0.8)).norm() < 1e-15);
    }
}
