//! What the lengths and the directions of a data set's world mean: its unit, its scale, which way is up.

use super::args::{DataArgs, Up};
use super::{Dataset, DatasetError};
use landline::geometry::{CamFromWorld, Units};

use nalgebra::Vector3;
use std::path::Path;

/// Smallest and largest metres for one unit of length: from a thousandth of a millimetre to a thousand kilometres.
const SCALES: std::ops::RangeInclusive<f64> = 1e-6..=1e6;

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
        dataset.units = units;
    }
    if let Some(scale) = args.scale {
        check_scale(&args.data, scale)?;
        rescale(dataset, scale);
        dataset.units = Units::Metres;
    }
    match args.up {
        Some(Up::Direction(up)) => dataset.gravity = Some(gravity_from_up(&args.data, up)?),
        Some(Up::Segments) => dataset.is_up_asked = true,
        None => {}
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
    use landline::geometry::Camera;

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

    fn applied(change: impl FnOnce(&mut DataArgs)) -> Result<Dataset, DatasetError> {
        let mut args = DataArgs::of("some/folder".into());
        change(&mut args);
        let mut dataset = dataset();
        apply(&mut dataset, &args).map(|()| dataset)
    }

    #[test]
    fn a_known_scale_makes_metres_and_keeps_what_the_pictures_show() {
        let (before, after) = (
            dataset(),
            applied(|a| a.scale = Some(0.25)).expect("a scale"),
        );
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
        let said = applied(|a| a.units = Some(Units::Metres)).expect("units");
        assert_eq!(said.units, Units::Metres);
        assert_eq!(said.images, before.images);
    }

    #[test]
    fn scales_and_directions_that_mean_nothing_are_refused_by_file_option_and_value() {
        let scale = |value| ("--scale", Some(value), None);
        let up = |value| ("--up", None, Some(value));
        for ((option, scale, up), shown) in [
            (scale(0.0), "0e0"),
            (scale(f64::NAN), "NaN"),
            (scale(1e300), "1e300"),
            (scale(-1.0), "-1e0"),
            (scale(f64::INFINITY), "inf"),
            (up([0.0; 3]), "0,0,0"),
            (up([f64::NAN, 0.0, 1.0]), "NaN,0,1"),
            (up([0.0, f64::INFINITY, 0.0]), "0,inf,0"),
        ] {
            let error = applied(|a| (a.scale, a.up) = (scale, up.map(Up::Direction)))
                .expect_err("means nothing");
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
    }

    #[test]
    fn gravity_is_the_opposite_of_up_however_long_that_is() {
        for up in [[0.0, 1.0, 0.0], [0.0, 1e300, 0.0], [0.0, 1e-300, 0.0]] {
            let gravity = gravity_from_up(Path::new("x"), up).expect("a direction");
            assert_eq!(gravity, Vector3::new(0.0, -1.0, 0.0));
        }
        let tilted = applied(|a| a.up = Some(Up::Direction([0.0, -3.0, 4.0])))
            .expect("a direction")
            .gravity;
        assert!((tilted.expect("given") - Vector3::new(0.0, 0.6, -0.8)).norm() < 1e-15);
    }
}
