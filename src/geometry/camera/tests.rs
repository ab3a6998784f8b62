//! Round trips, Jacobians, folds, and what is refused.

use super::*;

#[test]
fn a_resized_camera_projects_to_the_resized_pixel() {
    let map: PixelMap<super::super::Working, super::super::Sensor> =
        PixelMap::from_scale(640.0 / 1279.0, 361.0 / 721.0);
    let p = Vector3::new(0.4, -0.2, 1.3);
    let (f, cx, cy, k): (f64, f64, f64, f64) = (900.0, 630.0, 365.0, 0.05);
    for model in [
        CameraModel::SimplePinhole { f, cx, cy },
        CameraModel::Pinhole {
            fx: f,
            fy: 880.0,
            cx,
            cy,
        },
        CameraModel::SimpleRadial { f, cx, cy, k },
        CameraModel::Radial {
            f,
            cx,
            cy,
            k1: k,
            k2: -0.01,
        },
        CameraModel::OpenCv {
            fx: f,
            fy: 880.0,
            cx,
            cy,
            k1: k,
            k2: 0.0,
            p1: 0.001,
            p2: 0.002,
        },
        CameraModel::OpenCvFisheye {
            fx: f,
            fy: f,
            cx,
            cy,
            k1: k,
            k2: 0.0,
            k3: 0.0,
            k4: 0.0,
        },
    ] {
        let camera = Camera {
            width: 1279,
            height: 721,
            model,
        };
        let resized = camera.resized(&map);
        assert_eq!((resized.width, resized.height), (640, 361));
        let expected = map.apply(camera.pixel_from_cam(&p).expect("in front"));
        let found = resized.pixel_from_cam(&p).expect("in front");
        assert!(found.distance(expected) < 1e-9, "{model:?}");
    }
}

fn models() -> Vec<Camera> {
    [
        ("SIMPLE_PINHOLE", vec![525.0, 320.0, 240.0]),
        ("PINHOLE", vec![525.0, 530.0, 321.0, 239.0]),
        ("SIMPLE_RADIAL", vec![525.0, 320.0, 240.0, -0.12]),
        ("RADIAL", vec![525.0, 320.0, 240.0, 0.11, -0.03]),
        (
            "OPENCV",
            vec![525.0, 515.0, 318.0, 243.0, -0.2, 0.06, 0.001, -0.002],
        ),
        (
            "OPENCV_FISHEYE",
            vec![280.0, 285.0, 320.0, 240.0, 0.03, -0.01, 0.004, -0.001],
        ),
    ]
    .into_iter()
    .map(|(name, params)| Camera {
        width: 640,
        height: 480,
        model: CameraModel::from_colmap(name, &params).expect("valid"),
    })
    .collect()
}

#[test]
fn projection_undoes_unprojection_on_a_grid() {
    for camera in models() {
        assert_eq!(camera.validate(), Ok(()));
        let c = camera.principal_point();
        for i in 0..=60 {
            for j in 0..=60 {
                let mut p = Pixel::new(640.0 * f64::from(i) / 60.0, 8.0 * f64::from(j));
                if i == 30 && j == 30 {
                    p = Pixel::new(c.x + 1e-6, c.y - 1e-6);
                }
                let bearing = camera.bearing_from_pixel(p).expect("inside the image");
                assert!((bearing.norm() - 1.0).abs() < 1e-14);
                let back = camera.pixel_from_cam(&(bearing * 3.7)).expect("in front");
                assert!(back.distance(p) < 1e-8, "{} {p:?}", camera.model.name());
            }
        }
    }
}

#[test]
fn distortion_jacobian_agrees_with_central_differences() {
    for camera in models() {
        for (x, y) in [(0.0, 0.0), (0.3, -0.2), (-0.5, 0.4)] {
            let (_, j) = camera.model.distort(Vector2::new(x, y));
            let h = 1e-6;
            let at = |x: f64, y: f64| camera.model.distort(Vector2::new(x, y)).0;
            let dx = (at(x + h, y) - at(x - h, y)) / (2.0 * h);
            let dy = (at(x, y + h) - at(x, y - h)) / (2.0 * h);
            let numeric = [dx.x, dy.x, dx.y, dy.y];
            for k in 0..4 {
                assert!((j[k] - numeric[k]).abs() < 1e-8, "{}", camera.model.name());
            }
        }
    }
}

#[test]
fn refuses_pixels_beyond_the_fold() {
    // x (1 - 0.5 x^2) has its maximum 0.544 at x = 0.816: nothing projects further out.
    let camera = Camera {
        width: 640,
        height: 480,
        model: CameraModel::SimpleRadial {
            f: 500.0,
            cx: 320.0,
            cy: 240.0,
            k: -0.5,
        },
    };
    assert!(
        camera
            .bearing_from_pixel(Pixel::new(320.0 + 250.0, 240.0))
            .is_some()
    );
    assert!(
        camera
            .bearing_from_pixel(Pixel::new(320.0 + 300.0, 240.0))
            .is_none()
    );
    assert!(
        camera
            .pixel_from_cam(&Vector3::new(0.9, 0.0, 1.0))
            .is_none()
    );
    assert!(
        camera
            .bearing_from_pixel(Pixel::new(f64::NAN, 0.0))
            .is_none()
    );
}

#[test]
fn fisheye_sees_behind_the_image_plane() {
    let camera = models()[5];
    let bearing = Vector3::new(0.98, 0.1, -0.1).normalize();
    let pixel = camera
        .pixel_from_cam(&bearing)
        .expect("95 degrees off axis");
    let back = camera.bearing_from_pixel(pixel).expect("inverts");
    assert!((back - bearing).norm() < 1e-10);
}

#[test]
fn rejects_broken_cameras() {
    assert!(matches!(
        CameraModel::from_colmap("OPENCV", &[1.0]),
        Err(CameraError::NumParameters {
            expected: 8,
            actual: 1,
            ..
        })
    ));
    assert!(matches!(
        CameraModel::from_colmap("FOV", &[1.0]),
        Err(CameraError::UnknownModel { .. })
    ));
    assert!(matches!(
        Camera::centered(640, 480, f64::NAN).validate(),
        Err(CameraError::Focal { .. })
    ));
    assert!(matches!(
        Camera::centered(0, 480, 500.0).validate(),
        Err(CameraError::EmptyImage { .. })
    ));
}

#[test]
fn projects_and_undistorts_as_colmap_does() {
    // pycolmap 4.2.1: Camera(model, 640, 480, params of `models`).img_from_cam of two points, cam_from_img of one pixel.
    let points = [
        Vector3::new(0.31, -0.22, 1.0),
        Vector3::new(-0.8, 0.55, 1.6),
    ];
    let pixel = Pixel::new(37.5, 441.0);
    #[rustfmt::skip]
    let expected = [
        [482.75, 124.5, 57.5, 420.468_75, -0.538_095_238_095, 0.382_857_142_857],
        [483.75, 122.4, 58.5, 421.187_5, -0.54, 0.381_132_075_472],
        [479.927_915, 126.502_77, 69.097_167_969, 412.495_697_021, -0.571_905_432_631, 0.406_913_245_872],
        [485.234_963_429, 122.736_477_566, 47.936_677_814, 427.043_534_003, -0.517_643_392_939, 0.368_305_564_534],
        [475.825_275_641, 133.097_187_561, 71.601_742_029, 409.101_056_816, -0.582_056_880_127, 0.419_088_214_65],
        [403.262_628_835, 179.855_220_876, 193.139_942_166, 328.773_723_506, -2.078_551_516_931, 1.452_953_011_929],
    ];
    for (camera, [u1, v1, u2, v2, x, y]) in models().iter().zip(expected) {
        let name = camera.model.name();
        for (point, (u, v)) in points.iter().zip([(u1, v1), (u2, v2)]) {
            let found = camera.pixel_from_cam(point).expect("in front");
            assert!(found.distance(Pixel::new(u, v)) < 1e-8, "{name}: {found:?}");
        }
        let bearing = camera.bearing_from_pixel(pixel).expect("inside");
        let ideal = Vector2::new(bearing.x, bearing.y) / bearing.z;
        assert!(
            (ideal - Vector2::new(x, y)).norm() < 1e-10,
            "{name}: {ideal}"
        );
    }
}

#[test]
fn a_turned_camera_sees_the_turned_pixel() {
    let point = Vector3::new(0.31, -0.22, 1.4);
    for camera in models() {
        let before = camera.pixel_from_cam(&point).expect("in front");
        let (turned, turn) = camera.turned_clockwise();
        let after = turned.pixel_from_cam(&(turn * point)).expect("in front");
        let expected = Pixel::new(480.0 - before.y, before.x);
        assert!(after.distance(expected) < 1e-9, "{}", camera.model.name());
    }
}

#[test]
fn names_parameters_and_ids_round_trip() {
    // Ids and names by pycolmap 4.2.1, CameraModelId.
    let ids = [
        (0, "SIMPLE_PINHOLE"),
        (1, "PINHOLE"),
        (2, "SIMPLE_RADIAL"),
        (3, "RADIAL"),
        (4, "OPENCV"),
        (5, "OPENCV_FISHEYE"),
    ];
    for (expected, camera) in ids.iter().zip(&models()) {
        let (params, count) = camera.model.params();
        assert_eq!((camera.model.colmap().id, camera.model.name()), *expected);
        let again = CameraModel::from_colmap(camera.model.name(), &params[..count]);
        assert_eq!(again.as_ref(), Ok(&camera.model));
        assert_eq!(
            CameraRecord::from_camera(camera).to_camera().as_ref(),
            Ok(camera)
        );
    }
}

#[test]
fn a_camera_serves_resized_pictures_and_no_others() {
    for camera in models() {
        let (width, height) = (camera.width, camera.height);
        let half = camera
            .for_size(width.div_ceil(2), height.div_ceil(2))
            .expect("the same shape");
        let point = Vector3::new(0.2, -0.1, 1.0);
        let full_px = camera.pixel_from_cam(&point).expect("in front");
        let half_px = half.pixel_from_cam(&point).expect("in front");
        let expected = Pixel::new(0.5 * full_px.x, 0.5 * full_px.y);
        assert!(half_px.distance(expected) < 1.0, "{}", camera.model.name());
        assert_eq!(camera.for_size(width, height), Some(camera));
        for (w, h) in [(height, width), (width, height - 9), (0, 0), (width, 0)] {
            assert_eq!(camera.for_size(w, h), None, "{w}x{h}");
        }
    }
}

#[test]
fn numbers_of_no_camera_are_refused_and_any_crop_is_not() {
    let with = |params: [f64; 4]| {
        let model = CameraModel::from_colmap("PINHOLE", &params).expect("four numbers");
        let camera = Camera {
            width: 640,
            height: 480,
            model,
        };
        camera.check_plausible()
    };
    for camera in models() {
        assert_eq!(camera.check_plausible(), Ok(()), "{}", camera.model.name());
    }
    // A telescope, and a part far from the middle of a large panorama.
    assert_eq!(with([60_000.0, 60_000.0, 320.0, 240.0]), Ok(()));
    assert_eq!(with([525.0, 525.0, -40_000.0, 240.0]), Ok(()));
    for params in [
        [1e300, 525.0, 320.0, 240.0],
        [525.0, 1e-300, 320.0, 240.0],
        [525.0, 525.0, -1e300, 240.0],
        [525.0, 525.0, 320.0, f64::NAN],
    ] {
        let told = with(params);
        assert!(
            matches!(told, Err(CameraError::Implausible { .. })),
            "{params:?}: {told:?}"
        );
    }
}
