//! `landline eval` and `landline locate` as a user runs them, on the demo's sample scene.

use crate::folder::Folder;
use landline_testkit::skip;
use serde_json::Value;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn sample() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../www/scenes/sample")
}

/// Runs the tool; `None` where the extractor's weights are not at hand.
fn landline(words: &[&str]) -> Option<Output> {
    let Some(extractor) = std::env::var_os("LANDLINE_XFEAT_CHECKPOINT") else {
        skip("LANDLINE_XFEAT_CHECKPOINT names no checkpoint; `cargo xtask test` fetches it");
        return None;
    };
    let output = Command::new(env!("CARGO_BIN_EXE_landline"))
        .args(words)
        .env("LANDLINE_EXTRACTOR", extractor)
        .output()
        .expect("the tool starts");
    Some(output)
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// `landline eval` of a scene on pictures of the sample, with their poses in a list.
fn eval(scene: &Path, list: &Path, camera: &str, more: &[&str]) -> Option<Output> {
    let path = |p: &Path| p.to_str().expect("UTF-8").to_owned();
    let (scene, list, pictures) = (path(scene), path(list), path(&sample()));
    let words = [
        "eval",
        &scene,
        &list,
        "--pictures",
        &pictures,
        "--camera",
        camera,
        "--pose-direction",
        "cam-from-world",
    ];
    landline(&[&words, more].concat())
}

/// The first pictures of the sample as a pose list, and its camera in COLMAP's words.
fn pose_list(folder: &Folder, num: usize) -> (PathBuf, String) {
    let json = std::fs::read(sample().join("sample.json")).expect("is in the repository");
    let list: Value = serde_json::from_slice(&json).expect("is JSON");
    let mut lines = String::new();
    for picture in list["pictures"]
        .as_array()
        .expect("a list")
        .iter()
        .take(num)
    {
        let numbers: Vec<String> = picture["cam_from_world"]
            .as_array()
            .expect("rows")
            .iter()
            .flat_map(|row| row.as_array().expect("numbers"))
            .map(Value::to_string)
            .collect();
        let name = picture["name"].as_str().expect("a name");
        let _ = writeln!(lines, "{name} {}", numbers.join(" "));
    }
    let c = &list["camera"];
    let camera = format!(
        "PINHOLE,{},{},{},{},{},{}",
        c["width"], c["height"], c["fx"], c["fy"], c["cx"], c["cy"]
    );
    (folder.text("poses.txt", &lines), camera)
}

#[test]
fn eval_writes_a_report_that_agrees_with_its_json() {
    let folder = Folder::new();
    let (list, camera) = pose_list(&folder, 3);
    let report = folder.0.join("report");
    let scene = sample().join("sample.landline");
    let report_path = report.to_str().expect("UTF-8");
    let more = [
        "--test",
        "0-",
        "--seeds",
        "2",
        "--no-baseline",
        "--json",
        "--report",
        report_path,
    ];
    let Some(output) = eval(&scene, &list, &camera, &more) else {
        return;
    };
    assert!(output.status.success(), "{}", text(&output.stderr));
    let json: Value = serde_json::from_slice(&output.stdout).expect("JSON and nothing else");
    let both = &json["methods"][0];
    assert_eq!(both["name"], "points + lines");
    // Three pictures with two seeds each.
    assert_eq!(both["num_images"], 6);
    assert!(
        both["median_position"].as_f64().expect("located") < 0.05,
        "{both}"
    );
    assert_eq!(json["images"].as_array().expect("a list").len(), 3);
    let compared = &json["points_and_lines_against_points"];
    assert_eq!(
        compared["position"]
            .as_array()
            .expect("three numbers")
            .len(),
        3
    );
    let read = |name: &str| std::fs::read_to_string(report.join(name)).expect("is written");
    let written: Value = serde_json::from_str(&read("report.json")).expect("JSON");
    assert_eq!(written, json);
    // A line each for three pictures, two seeds and four methods (the first pose is one), and the head.
    assert_eq!(read("per_image.csv").lines().count(), 1 + 3 * 2 * 4);
    let page = read("report.html");
    assert_eq!(page.matches("<svg").count(), 4);
    assert_eq!(page.matches("</svg>").count(), 4);
    assert!(!page.contains("NaN"), "a plot has a place that is none");
    assert!(read("report.txt").contains("points only"));
}

#[test]
fn eval_says_what_is_missing() {
    let folder = Folder::new();
    let (list, camera) = pose_list(&folder, 2);
    let scene = sample().join("sample.landline");
    for (more, expected) in [
        (&[][..], "no test pictures; choose some with --test"),
        (
            &["--test", "0-"][..],
            "the baseline needs training pictures",
        ),
        (
            &["--test", "7"][..],
            "--test selects none of the 2 pictures",
        ),
    ] {
        let Some(output) = eval(&scene, &list, &camera, more) else {
            return;
        };
        let message = text(&output.stderr);
        assert!(
            !output.status.success() && message.contains(expected),
            "{message}"
        );
    }
}

#[test]
fn locate_draws_what_it_found_and_goes_on_after_a_picture_that_is_none() {
    let folder = Folder::new();
    let broken = folder.text("broken.jpg", "no picture");
    let scene = sample().join("sample.landline");
    let picture = sample().join("query-00.jpg");
    // Another one of the same name.
    folder.copy(&sample().join("query-03.jpg"), "other/query-00.jpg");
    let other = folder.0.join("other/query-00.jpg");
    let overlays = folder.0.join("overlays");
    let path = |p: &Path| p.to_str().expect("UTF-8").to_owned();
    let Some(output) = landline(&[
        "locate",
        &path(&scene),
        &path(&broken),
        &path(&picture),
        &path(&other),
        "--json",
        "--overlay",
        &path(&overlays),
    ]) else {
        return;
    };
    let message = text(&output.stderr);
    assert!(!output.status.success(), "{message}");
    assert!(
        message.contains("broken.jpg") && message.contains("1 of 3 pictures could not be read"),
        "{message}"
    );
    for line in text(&output.stdout).lines() {
        let found: Value = serde_json::from_str(line).expect("a line of JSON");
        assert_eq!(found["reason"], Value::Null, "{found}");
        assert!(
            found["inliers"]["points"].as_u64().expect("a number") > 50,
            "{found}"
        );
    }
    for name in ["sample_query-00", "other_query-00"] {
        let drawn = image::open(overlays.join(format!("{name}.overlay.png")));
        let drawn = drawn.expect("is a picture");
        // Enlarged twice, so that strokes are fine against it.
        assert_eq!((drawn.width(), drawn.height()), (1280, 960));
    }
}

#[test]
fn locate_takes_folders_in_the_order_of_names_and_a_focal_length() {
    let folder = Folder::new();
    for (from, to) in [("query-03.jpg", "b.jpg"), ("query-00.jpg", "a.jpg")] {
        folder.copy(&sample().join(from), &format!("photos/{to}"));
    }
    let scene = sample().join("sample.landline");
    let words = |focal: &str| {
        let scene = scene.to_str().expect("UTF-8");
        let photos = folder.0.join("photos");
        let photos = photos.to_str().expect("UTF-8");
        landline(&["locate", scene, photos, "--json", "--focal", focal])
    };
    let Some(output) = words("560") else {
        return;
    };
    let found: Vec<Value> = text(&output.stdout)
        .lines()
        .map(|line| serde_json::from_str(line).expect("a line of JSON"))
        .collect();
    assert_eq!(found.len(), 2, "{}", text(&output.stderr));
    for (found, name) in found.iter().zip(["a.jpg", "b.jpg"]) {
        assert!(found["picture"].as_str().expect("a path").ends_with(name));
        assert_eq!(found["camera_source"], "given", "{found}");
        assert_eq!(found["focal_px"], 560.0, "{found}");
    }
    // In pixels of the picture, not in millimetres.
    let output = words("24").expect("as before");
    let message = text(&output.stderr);
    assert!(
        message.contains("expected 64 to 12800 pixels")
            && message.contains("2 of 2 pictures do not go with what was given"),
        "{message}"
    );
}

/// Every answer is right in the scene's world; the data's lies three metres beside it.
#[test]
fn eval_tells_another_world_from_wrong_answers() {
    let folder = Folder::new();
    let (list, camera) = pose_list(&folder, 8);
    let scene = sample().join("sample.landline");
    let other_world = |list: &Path| {
        let more = ["--test", "0-7", "--no-baseline", "--json"];
        let output = eval(&scene, list, &camera, &more)?;
        let said = text(&output.stdout);
        let found: Value = serde_json::from_str(&said).expect("JSON");
        Some(found["other_world"].clone())
    };
    let Some(as_it_is) = other_world(&list) else {
        return;
    };
    assert_eq!(as_it_is, Value::Null);
    let poses = std::fs::read_to_string(&list).expect("was written");
    let mut moved = String::new();
    for line in poses.lines() {
        let (name, numbers) = line.split_once(' ').expect("a name");
        let mut m: Vec<f64> = numbers
            .split(' ')
            .map(|n| n.parse().expect("a number"))
            .collect();
        for row in 0..3 {
            m[4 * row + 3] += 3.0 * m[4 * row];
        }
        let numbers: Vec<String> = m.iter().map(f64::to_string).collect();
        let _ = writeln!(moved, "{name} {}", numbers.join(" "));
    }
    let told = other_world(&folder.text("moved.txt", &moved)).expect("as before");
    let number = |name: &str| told[name].as_f64().expect(name);
    assert!((number("before") - 3.0).abs() < 0.05, "{told}");
    assert!((number("scale") - 1.0).abs() < 0.02, "{told}");
    assert!(number("after") < 0.02, "{told}");
}

#[test]
fn eval_takes_the_features_that_the_scenes_run_left() {
    let folder = Folder::new();
    let (list, camera) = pose_list(&folder, 4);
    folder.copy(&sample().join("sample.landline"), "room.landline");
    let cache = folder.0.join("room.run/features");
    std::fs::create_dir_all(&cache).expect("writable");
    let scene = folder.0.join("room.landline");
    let more = ["--train", "0-2", "--test", "3"];
    let Some(output) = eval(&scene, &list, &camera, &more) else {
        return;
    };
    // The sample's pictures are too far apart to teach; their features were asked for before that.
    let kept = std::fs::read_dir(&cache).expect("is there").count();
    assert!(kept >= 3, "{kept} kept: {}", text(&output.stderr));
}

/// Descriptors do not see through turns: such a picture looks like another place, and it is told that it is none.
#[test]
fn a_turned_picture_is_called_so() {
    let folder = Folder::new();
    let scene = sample().join("sample.landline");
    let turned = folder.0.join("turned.png");
    if let Ok(picture) = image::open(sample().join("query-00.jpg")) {
        picture.rotate270().save(&turned).expect("can be written");
    }
    let path = |p: &Path| p.to_str().expect("UTF-8").to_owned();
    let Some(output) = landline(&["locate", &path(&scene), &path(&turned), "--json"]) else {
        return;
    };
    let found: Value = serde_json::from_slice(&output.stdout).expect("one line of JSON");
    assert_eq!(found["turn_clockwise_deg"], 90, "{found}");
    assert_eq!(found["pose"], Value::Null, "{found}");
}

/// Without intrinsics a picture of the scene's shape is of the scene's camera; given ones that it contradicts are not believed.
#[test]
fn the_camera_of_a_picture_is_the_scenes_own_unless_the_picture_says_otherwise() {
    let path = |p: &Path| p.to_str().expect("UTF-8").to_owned();
    let scene = path(&sample().join("sample.landline"));
    let locate = |name: &str, camera: &[&str]| -> Option<Value> {
        let picture = path(&sample().join(name));
        let output = landline(&[&["locate", &scene, &picture, "--json"], camera].concat())?;
        Some(serde_json::from_slice(&output.stdout).expect("one line of JSON"))
    };
    let sure = |found: &Value| {
        assert_eq!(found["camera_source"], "scene", "{found}");
        assert_eq!(found["focal_mismatch"], false, "{found}");
        found["quality"]["confidence"].as_f64().expect("a number") > 0.9
    };
    let Some(own) = locate("query-04.jpg", &[]) else {
        return;
    };
    // Nobody said that it is: a corner of the room tells the focal length by itself, a wall does not.
    assert!(sure(&own), "{own}");
    let wall = locate("query-12.jpg", &[]).expect("was there before");
    assert!(!sure(&wall), "{wall}");
    let focal_px = own["focal_px"].as_f64().expect("a number");
    for factor in [0.8, 1.25] {
        let camera = format!("SIMPLE_PINHOLE,640,480,{},320,240", factor * focal_px);
        let found = locate("query-04.jpg", &["--camera", &camera]).expect("was there before");
        assert_eq!(found["focal_mismatch"], true, "{factor}: {found}");
        let solved = found["focal_px"].as_f64().expect("a number");
        assert!((solved / focal_px - 1.0).abs() < 0.02, "{factor}: {found}");
    }
}

/// A video that was drawn into a frame of another shape: nobody knows the intrinsics, and they are not those of a camera.
#[test]
fn a_squeezed_picture_is_located_and_says_that_its_camera_is_a_guess() {
    let folder = Folder::new();
    let (list, _) = pose_list(&folder, 3);
    let scene = sample().join("sample.landline");
    let path = |p: &Path| p.to_str().expect("UTF-8").to_owned();
    for row in std::fs::read_to_string(list).expect("was written").lines() {
        let (name, pose) = row.split_once(' ').expect("a name and numbers");
        let m: Vec<f64> = pose
            .split(' ')
            .map(|n| n.parse().expect("a number"))
            .collect();
        let center = |i: usize| -(0..3).map(|k| m[4 * k + i] * m[4 * k + 3]).sum::<f64>();
        let picture = image::open(sample().join(name)).expect("is a picture");
        let squeezed = folder.0.join(name).with_extension("png");
        let filter = image::imageops::FilterType::Triangle;
        let (width, height) = (picture.width(), picture.height() * 3 / 4);
        let small = picture.resize_exact(width, height, filter);
        small.save(&squeezed).expect("can be written");
        let Some(output) = landline(&["locate", &path(&scene), &path(&squeezed), "--json"]) else {
            return;
        };
        let found: Value = serde_json::from_slice(&output.stdout).expect("one line of JSON");
        let position = &found["pose"]["position"];
        for axis in 0..3 {
            let off = position[axis].as_f64().expect("is located") - center(axis);
            assert!(off.abs() < 0.03, "{name}: {off} m along axis {axis}");
        }
        let confidence = found["quality"]["confidence"].as_f64().expect("a number");
        assert!(confidence < 0.9, "{name}: {confidence}");
    }
}
