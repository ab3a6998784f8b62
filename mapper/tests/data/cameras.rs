//! Camera models of other tools, written in a COLMAP text model and read back as cameras of the core.

use crate::folder::Folder;
use crate::readers::read;
use landline::geometry::Camera;
use nalgebra::Vector3;

/// Reads a model with one picture by a camera line's model and parameters.
fn camera(model: &str, params: &str) -> Result<Camera, String> {
    let folder = Folder::new();
    folder.picture("images/a.png", 640, 480);
    folder.text(
        "sparse/0/cameras.txt",
        &format!("1 {model} 640 480 {params}\n"),
    );
    folder.text("sparse/0/images.txt", "1 1 0 0 0 0 0 0 1 a.png\n\n");
    folder.text("sparse/0/points3D.txt", "");
    read(&folder.0, &[])
        .map(|dataset| dataset.images[0].camera)
        .map_err(|e| e.to_string())
}
/// Model, parameters, and the pixels of the points (0.3, -0.2, 1) and (-0.5, 0.35, 1).
/// By pycolmap 4.2.0: `pycolmap.Camera(model=..., width=640, height=480, params=...).img_from_cam(points)`.
#[rustfmt::skip]
const PROJECTED: [(&str, &str, [f64; 2], [f64; 2]); 17] = [
    ("SIMPLE_PINHOLE", "500 330 235", [480.0, 135.0], [80.0, 410.0]),
    ("PINHOLE", "500 510 330 235", [480.0, 133.0], [80.0, 413.5]),
    ("SIMPLE_RADIAL", "500 330 235 -0.08", [478.44, 136.04], [87.45, 404.785]),
    ("RADIAL", "500 330 235 -0.1 0.02", [478.1007, 136.2662], [88.61871875, 403.966896875]),
    ("OPENCV", "500 510 330 235 -0.1 0.02 0.001 -0.0015", [477.8082, 134.490424], [87.78934375, 407.928909813]),
    ("OPENCV_FISHEYE", "400 405 330 235 0.02 -0.01 0.004 -0.001", [445.431464390, 157.083761537], [149.496793283, 362.931647761]),
    ("FULL_OPENCV", "500 510 330 235 0.12 -0.05 0.0001 -8e-05 0.01 0.15 -0.02 0.005", [479.334602621, 133.455564218], [83.526452007, 410.990472167]),
    ("FOV", "500 505 330 235 0.7", [482.970790102, 131.999667998], [84.717736241, 408.414560478]),
    ("SIMPLE_RADIAL_FISHEYE", "400 330 235 0.03", [445.585128207, 157.943247862], [148.813656255, 361.830440621]),
    ("RADIAL_FISHEYE", "400 330 235 0.03 -0.01", [445.568612978, 157.954258014], [148.975570819, 361.717100426]),
    ("THIN_PRISM_FISHEYE", "400 405 330 235 0.02 -0.01 6e-05 -4e-05 0.004 -0.001 3e-05 -2e-05", [445.425679617, 157.089282863], [149.482371741, 362.945882282]),
    ("RAD_TAN_THIN_PRISM_FISHEYE", "400 405 330 235 0.02 -0.01 0.004 -0.001 0.0004 -0.0001 3e-05 -4e-05 2e-05 -1e-05 -1e-05 1e-05", [445.43758866, 157.07883523], [149.51177977, 362.9192947]),
    ("SIMPLE_DIVISION", "500 330 235 -0.15", [477.183800744, 136.877466171], [92.596549068, 401.182415652]),
    ("DIVISION", "500 505 330 235 -0.15", [477.183800744, 135.896240832], [92.596549068, 402.844239809]),
    ("SIMPLE_FISHEYE", "400 330 235", [445.171380280, 158.219079813], [150.431287573, 360.698098699]),
    ("FISHEYE", "400 405 330 235", [445.171380280, 157.259318311], [150.431287573, 362.269324933]),
    ("EUCM", "500 505 330 235 0.6 1.1", [474.027597735, 138.021417525], [105.260164435, 393.891063744]),
];

/// Models of the core are exact, others are fitted ([`landline::formats::MAX_FIT_ERROR_PX`]).
const EXACT: [&str; 10] = [
    "SIMPLE_PINHOLE",
    "PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
    "OPENCV_FISHEYE",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
    "SIMPLE_FISHEYE",
    "FISHEYE",
];

#[test]
fn every_camera_model_projects_as_colmap_does() {
    for (model, params, first, second) in PROJECTED {
        let camera = camera(model, params).unwrap_or_else(|e| panic!("{model}: {e}"));
        let tolerance = if EXACT.contains(&model) { 1e-8 } else { 0.1 };
        for (point, expected) in [([0.3, -0.2, 1.0], first), ([-0.5, 0.35, 1.0], second)] {
            let pixel = camera
                .pixel_from_cam(&Vector3::from(point))
                .expect("in front");
            let off = (pixel.x - expected[0]).hypot(pixel.y - expected[1]);
            println!("{model}: {off:.1e} px");
            assert!(off < tolerance, "{model} is off by {off} px");
        }
    }
}

#[test]
fn what_no_model_comes_near_is_refused_with_a_way_out() {
    for (model, params, expected) in [
        ("EQUIRECTANGULAR", "640 480", "panorama"),
        // Prism distortion of a tenth of the picture.
        (
            "THIN_PRISM_FISHEYE",
            "400 400 320 240 0 0 0.05 0 0 0 0.1 0.1",
            "image_undistorter",
        ),
        // Turns back before the corner.
        (
            "FULL_OPENCV",
            "300 300 320 240 -0.9 0 0 0 0.1 0 0 0",
            "folds over",
        ),
        ("TELEPATHY", "1 2 3", "TELEPATHY"),
        ("PINHOLE", "500 500 320", "takes 4 parameters, got 3"),
    ] {
        let message = camera(model, params).expect_err("refused");
        assert!(message.contains(expected), "{model}: {message}");
    }
}
