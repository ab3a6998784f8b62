//! What goes into a scene file comes out, and what is not one is refused by the name of what is wrong.

use super::super::{HeldOut, Timestamp, TrainingSummary, Units, serialize};
use super::*;
use crate::geometry::{Camera, CameraModel, CameraRecord};
use crate::landmarks::LandmarkError;
use crate::models::{ExtractorKind, Preset};
use crate::nn::WeightTensor;
use nalgebra::Vector3;

fn scene(preset: Preset) -> SceneFile {
    let config = RegressorConfig::preset(preset, 64);
    let mut state = 1_u32;
    let weights = config
        .tensors()
        .into_iter()
        .map(|t| {
            let n = t.shape.iter().product();
            let data = (0..n)
                .map(|_| {
                    state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    f32::from(u16::try_from(state >> 16).expect("16 bits")) / 65_536.0 - 0.5
                })
                .collect();
            (t.name, WeightTensor::f32(&t.shape, data).expect("sizes"))
        })
        .collect();
    let mut info = SceneInfo::new(ExtractorKind::Xfeat, "ab".repeat(32));
    info.preset = Some(preset);
    info.scale = SceneScale {
        centre: Vector3::new(1.5, -2.0, 100.25),
        scale: 3.5,
    };
    info.gravity = Some(Vector3::new(0.0, 0.0, -1.0));
    info.camera = Some(Camera {
        width: 640,
        height: 480,
        model: CameraModel::Pinhole {
            fx: 525.0,
            fy: 525.0,
            cx: 320.0,
            cy: 240.0,
        },
    });
    info.other_cameras = vec![Camera::centered(1280, 720, 1100.0)];
    info.training = Some(TrainingSummary {
        num_images: 10,
        held_out: Some(HeldOut {
            num_images: 3,
            num_not_located: 0,
            median_position: Some(0.01),
            median_rotation_deg: Some(0.3),
            recall_5cm_5deg: Some(1.0),
        }),
        ..TrainingSummary::default()
    });
    info.licence = "CC0".to_owned();
    info.units = Units::Metres;
    info.created = Timestamp::parse("2026-01-01").ok();
    SceneFile {
        info,
        config,
        weights,
        landmarks: None,
    }
}

#[test]
fn f32_files_come_back_exactly_and_equal_scenes_give_equal_bytes() {
    for preset in [Preset::Standard, Preset::Compact] {
        let scene = scene(preset);
        let bytes = scene.to_bytes(Precision::F32).expect("writes");
        assert_eq!(
            bytes,
            scene.clone().to_bytes(Precision::F32).expect("writes")
        );
        assert_eq!(SceneFile::from_bytes(&bytes).expect("reads"), scene);
    }
}

#[test]
fn compact_int8_is_small_and_close() {
    let scene = scene(Preset::Compact);
    let bytes = scene.to_bytes(Precision::Int8).expect("writes");
    assert!(bytes.len() < 350_000, "{}", bytes.len());
    let back = SceneFile::from_bytes(&bytes).expect("reads");
    for (name, tensor) in scene.weights.iter() {
        let limit = if name.ends_with("keys") {
            0.5 / 127.0
        } else {
            3e-4
        };
        let got = back.weights.get(name).expect("present").to_f32();
        for (a, b) in tensor.to_f32().iter().zip(got) {
            assert!((a - b).abs() <= limit, "{name}: {a} {b}");
        }
    }
}

#[test]
fn imported_networks_keep_their_last_layers_in_f32() {
    let mut scene = scene(Preset::Standard);
    scene.info.scale = SceneScale::default();
    let mut data = vec![0.1; 3];
    data[0] = 517.123_4;
    scene.weights.insert(
        "point.head.1.b",
        WeightTensor::f32(&[3], data).expect("sizes"),
    );
    let bytes = scene.to_bytes(Precision::F16).expect("writes");
    let back = SceneFile::from_bytes(&bytes).expect("reads");
    let b = back
        .weights
        .get("point.head.1.b")
        .expect("present")
        .to_f32();
    assert_eq!(b[0], 517.123_4);
}

#[test]
fn every_truncation_and_padding_is_refused() {
    let bytes = scene(Preset::Compact)
        .to_bytes(Precision::Int8)
        .expect("writes");
    let header =
        usize::try_from(u64::from_le_bytes(*bytes.first_chunk().expect("long"))).expect("small");
    let cuts = (0..header + 16).step_by(7).chain([bytes.len() - 1]);
    for n in cuts {
        assert!(SceneFile::from_bytes(&bytes[..n]).is_err(), "{n}");
    }
    let mut longer = bytes.clone();
    longer.push(0);
    assert!(matches!(
        SceneFile::from_bytes(&longer),
        Err(SceneFileError::Header { .. })
    ));
}

#[test]
fn landmarks_come_back_exactly_and_without_them_the_version_stays() {
    let mut scene = scene(Preset::Compact);
    let old = scene.to_bytes(Precision::Int8).expect("writes");
    let version = |bytes: &[u8]| {
        let file = TensorFile::parse(bytes).expect("parses");
        file.text("format").expect("present").to_owned()
    };
    assert_eq!(version(&old), "1");
    for lines in [true, false] {
        let mut table = crate::landmarks::table::small();
        if !lines {
            table.line_positions.clear();
            table.line_codes.clear();
            table.line_views.clear();
        }
        scene.landmarks = Some(table);
        let bytes = scene.to_bytes(Precision::Int8).expect("writes");
        assert_eq!(version(&bytes), "2");
        let back = SceneFile::from_bytes(&bytes).expect("reads");
        assert_eq!(back.landmarks, scene.landmarks);
    }
}

#[test]
fn a_landmark_table_that_is_damaged_is_refused_by_name() {
    let mut good = scene(Preset::Compact);
    good.landmarks = Some(crate::landmarks::table::small());
    let mut metadata = good
        .info
        .to_metadata(&good.config, LANDMARK_VERSION)
        .expect("plain data");
    let raw = landmarks::to_raw(good.landmarks.as_ref().expect("set"), &mut metadata);
    let read = |metadata: &_, raw: Vec<_>| {
        let bytes = serialize_with(metadata, &good.weights, raw, |_, _| Element::F16);
        SceneFile::from_bytes(&bytes.expect("writes")).map(|_| ())
    };
    read(&metadata, raw.clone()).expect("is right");
    for i in 0..raw.len() {
        let mut fewer = raw.clone();
        fewer.remove(i);
        assert!(read(&metadata, fewer).is_err(), "without {}", raw[i].name);
        let mut other = raw.clone();
        other[i].dtype = "I8";
        other[i].shape = vec![other[i].bytes.len(), 1];
        assert!(
            matches!(
                read(&metadata, other),
                Err(SceneFileError::LandmarkTensor { .. })
            ),
            "{} of another type",
            raw[i].name
        );
    }
    let with = |name: &str, change: &dyn Fn(&mut Vec<u8>)| {
        let mut damaged = raw.clone();
        let tensor = damaged.iter_mut().find(|t| t.name == name);
        change(&mut tensor.expect("present").bytes);
        read(&metadata, damaged).expect_err("must refuse")
    };
    let error = with("landmark.point.clusters", &|bytes| bytes[1] = 77);
    assert!(matches!(
        error,
        SceneFileError::Landmarks(LandmarkError::Cluster { found: 77, .. })
    ));
    let error = with("landmark.point.mean", &|bytes| {
        bytes[4..8].copy_from_slice(&f32::NAN.to_le_bytes());
    });
    assert!(matches!(
        error,
        SceneFileError::Landmarks(LandmarkError::NotFinite { index: 1, .. })
    ));
    for (key, value) in [
        ("landmark_step", "0"),
        ("landmark_step", "NaN"),
        ("landmark_origin", "[1,2]"),
        ("landmark_clusters", "-1"),
        ("landmark_clusters", "300"),
    ] {
        let mut other = metadata.clone();
        other.insert(key.to_owned(), value.to_owned());
        assert!(read(&other, raw.clone()).is_err(), "{key} {value}");
    }
    let mut empty = raw.clone();
    for tensor in empty
        .iter_mut()
        .filter(|t| t.name.starts_with("landmark.point") && t.shape.len() == 2)
    {
        tensor.bytes.clear();
        tensor.shape[0] = 0;
    }
    assert!(matches!(
        read(&metadata, empty),
        Err(SceneFileError::Landmarks(LandmarkError::Empty))
    ));
}

#[test]
fn wrong_kinds_versions_and_values_have_their_own_errors() {
    let good = scene(Preset::Compact);
    let change = |key: &str, value: &str| {
        let mut metadata = good
            .info
            .to_metadata(&good.config, FORMAT_VERSION)
            .expect("plain data");
        metadata.insert(key.to_owned(), value.to_owned());
        let bytes = serialize(&metadata, &good.weights, |_, _| Element::F32).expect("writes");
        SceneFile::from_bytes(&bytes)
            .map(|_| ())
            .expect_err("must refuse")
    };
    assert!(matches!(
        change("landline", "extractor"),
        SceneFileError::Kind { .. }
    ));
    assert!(matches!(
        change("format", "3"),
        SceneFileError::Version { .. }
    ));
    let one = CameraRecord::from_camera(&Camera::centered(4, 4, 3.0));
    let many = serde_json::json!(vec![one; 8]).to_string();
    for (key, value) in [
        ("extractor", "sift"),
        ("extractor_sha256", "zz"),
        ("sampler", "legacy"),
        ("scene_scale", "0"),
        ("scene_scale", "NaN"),
        ("scene_scale", "1e300"),
        ("scene_scale", "-1"),
        ("scene_scale", "5e-324"),
        ("scene_scale", "1e12"),
        ("scene_centre", "[1,2]"),
        ("scene_centre", "[1,2,1e300]"),
        ("gravity", "[0,0,2]"),
        ("gravity", "[0,0,0]"),
        ("units", "feet"),
        ("units", "metres"),
        ("created", "today"),
        (
            "camera",
            "{\"model\":\"PINHOLE\",\"width\":0,\"height\":0,\"params\":[1,1,1,1]}",
        ),
        (
            "camera",
            "{\"model\":\"SIMPLE_PINHOLE\",\"width\":640,\"height\":480,\"params\":[1e300,320,240]}",
        ),
        (
            "camera",
            "{\"model\":\"PINHOLE\",\"width\":640,\"height\":480,\"params\":[1e-300,525,320,240]}",
        ),
        (
            "camera",
            "{\"model\":\"SIMPLE_PINHOLE\",\"width\":640,\"height\":480,\"params\":[525,320,-1e300]}",
        ),
        (
            "other_cameras",
            "[{\"model\":\"PINHOLE\",\"width\":4,\"height\":4,\"params\":[3,1e300,2,2]}]",
        ),
        ("other_cameras", "{}"),
        (
            "other_cameras",
            "[{\"model\":\"PINHOLE\",\"width\":4,\"height\":4,\"params\":[1]}]",
        ),
        ("other_cameras", many.as_str()),
        ("variant", "v1"),
        ("config", "{}"),
        ("working_max_side", "1e9"),
        ("working_max_side", "2049"),
        ("training", "5"),
        ("training", "{\"seconds\":-1e300}"),
        (
            "training",
            "{\"held_out\":{\"num_images\":1,\"num_not_located\":2}}",
        ),
        (
            "training",
            "{\"held_out\":{\"num_images\":2,\"num_not_located\":0,\"recall_5cm_5deg\":50}}",
        ),
    ] {
        let error = change(key, value);
        assert!(
            matches!(error, SceneFileError::Value { key: k, .. } if k == key),
            "{key}: {error}"
        );
        assert!(error.to_string().contains(key), "{error}");
    }
    let huge = serde_json::json!(good.config)
        .to_string()
        .replace("2048", "18446744073709551615");
    assert!(matches!(change("config", &huge), SceneFileError::Model(_)));
    let other = ExtractorFile {
        kind: ExtractorKind::Xfeat,
        source_sha256: "cd".repeat(32),
        source: String::new(),
        licence: String::new(),
        weights: Weights::new(),
    };
    assert!(matches!(
        good.check_extractor(&other),
        Err(SceneFileError::WrongExtractor { .. })
    ));
}

#[test]
fn a_file_has_to_say_when_it_was_made_or_that_it_does_not_know() {
    let good = scene(Preset::Compact);
    let with = |created: Option<&str>| {
        let mut metadata = good
            .info
            .to_metadata(&good.config, FORMAT_VERSION)
            .expect("plain data");
        metadata.remove("created");
        metadata.extend(created.map(|t| ("created".to_owned(), t.to_owned())));
        let bytes = serialize(&metadata, &good.weights, |_, _| Element::F32).expect("writes");
        SceneFile::from_bytes(&bytes).map(|scene| scene.info.created)
    };
    assert_eq!(
        with(None),
        Err(SceneFileError::MissingKey { key: "created" })
    );
    // As the first tool versions wrote it.
    assert_eq!(with(Some("")), Ok(None));
    let noon = Timestamp::parse("2026-02-03T12:00:00Z").expect("a moment");
    assert_eq!(with(Some("2026-02-03T12:00:00Z")), Ok(Some(noon)));
}

#[test]
fn metadata_are_replaced_without_touching_a_tensor() {
    let scene = scene(Preset::Compact);
    let mut metadata = scene
        .info
        .to_metadata(&scene.config, FORMAT_VERSION)
        .expect("plain data");
    metadata.insert("of_a_later_version".to_owned(), "kept".to_owned());
    let bytes = serialize(&metadata, &scene.weights, |_, _| Element::F16).expect("writes");
    let changed = SceneFile::redescribed(&bytes, |scene| {
        let info = &mut scene.info;
        info.units = Units::Arbitrary;
        info.gravity = None;
        info.licence = "a much longer licence than before".repeat(20);
    })
    .expect("a scene");
    let blobs = |bytes: &[u8]| {
        let len = u64::from_le_bytes(*bytes.first_chunk().expect("long"));
        bytes[8 + usize::try_from(len).expect("small")..].to_vec()
    };
    assert_eq!(blobs(&changed), blobs(&bytes));
    let read = SceneFile::from_bytes(&changed).expect("a scene");
    assert_eq!(
        (read.info.units, read.info.gravity),
        (Units::Arbitrary, None)
    );
    assert_eq!(read.info.scale, scene.info.scale);
    let file = TensorFile::parse(&changed).expect("a file");
    assert_eq!(file.text("of_a_later_version"), Ok("kept"));
    assert_eq!(file.metadata().get("gravity"), None);
    // What cannot be read is not written.
    let zero = SceneFile::redescribed(&bytes, |scene| scene.info.scale.scale = 0.0);
    assert!(matches!(
        zero,
        Err(SceneFileError::Value {
            key: "scene_scale",
            ..
        })
    ));
    let same = SceneFile::redescribed(&bytes, |_| ()).expect("a scene");
    assert_eq!(same, bytes);
}

#[test]
fn held_out_accuracy_counts_failures_and_knows_its_unit() {
    let errors = [Some((0.01, 1.0)), Some((0.04, 6.0)), None];
    let metric = HeldOut::of(&errors, Units::Metres);
    assert_eq!((metric.num_images, metric.num_not_located), (3, 1));
    assert_eq!(metric.median_position, Some(0.04));
    assert_eq!(metric.median_rotation_deg, Some(6.0));
    assert_eq!(metric.recall_5cm_5deg, Some(1.0 / 3.0));
    assert_eq!(HeldOut::of(&errors, Units::Arbitrary).recall_5cm_5deg, None);
    let lost = HeldOut::of(&[None, None, Some((0.0, 0.0))], Units::Metres);
    assert_eq!(lost.median_position, None);
    // What a file holds comes back, a missing median too.
    for held_out in [metric, lost] {
        let mut scene = scene(Preset::Compact);
        scene.info.training.get_or_insert_default().held_out = Some(held_out);
        let bytes = scene.to_bytes(Precision::F32).expect("writes");
        assert_eq!(SceneFile::from_bytes(&bytes), Ok(scene));
    }
}

#[test]
fn tensors_that_are_missing_misnamed_misshapen_or_not_finite_are_refused() {
    let good = scene(Preset::Compact);
    let metadata = good
        .info
        .to_metadata(&good.config, FORMAT_VERSION)
        .expect("plain data");
    let write = |weights: &Weights| {
        let bytes = serialize(&metadata, weights, |_, _| Element::F32).expect("writes");
        SceneFile::from_bytes(&bytes)
            .map(|_| ())
            .expect_err("must refuse")
    };
    let mut missing = good.weights.clone();
    let sharpness = missing.remove("point.anchor.sharpness").expect("present");
    assert!(matches!(write(&missing), SceneFileError::Model(_)));
    missing.insert("point.anchor.sharpnes", sharpness);
    assert!(matches!(write(&missing), SceneFileError::Model(_)));
    let mut stray = good.weights.clone();
    stray.insert("x", WeightTensor::f32(&[1], vec![0.0]).expect("sizes"));
    assert!(matches!(
        write(&stray),
        SceneFileError::Model(crate::models::ModelError::UnexpectedTensor { .. })
    ));
    // A NaN cannot be written, so it is put into the bytes.
    let mut bytes = good.to_bytes(Precision::F32).expect("writes");
    let at = bytes.len() - 4;
    bytes[at..].copy_from_slice(&f32::NAN.to_le_bytes());
    assert!(matches!(
        SceneFile::from_bytes(&bytes),
        Err(SceneFileError::NotFinite { .. })
    ));
}

#[test]
fn a_row_factor_that_overflows_with_its_numbers_is_refused() {
    let mut good = scene(Preset::Compact);
    let keys = good.weights.remove("point.anchor.keys").expect("present");
    let mut data = keys.to_f32();
    data[0] = 987.654;
    let keys = WeightTensor::f32(keys.shape(), data).expect("sizes");
    good.weights.insert("point.anchor.keys", keys);
    let mut bytes = good.to_bytes(Precision::Int8).expect("writes");
    // The row's factor, found by its value: each of the two numbers alone is finite.
    let factor = (987.654_f32 / 127.0).to_le_bytes();
    let at = bytes
        .windows(4)
        .position(|w| w == factor)
        .expect("the largest number of the row is 127 times the factor");
    bytes[at..at + 4].copy_from_slice(&3.3e38_f32.to_le_bytes());
    assert!(matches!(
        SceneFile::from_bytes(&bytes),
        Err(SceneFileError::NotFinite { .. })
    ));
}
