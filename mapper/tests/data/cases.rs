//! Small inputs of other people that once gave a wrong answer without a word: `cargo test -p landline-mapper --test data
//! cases::` runs them all. Each is one of a kind; what is right is the assertion.
//!
//! They lie in `../shared/data/cases` and use pictures of `../shared/data/redkitchen`; without those the tests are skipped.

use crate::folder::Folder;
use crate::readers::{position, read};
use landline::geometry::Pixel;
use landline_mapper::dataset::{Dataset, Split};
use landline_mapper::labels::Labels;
use landline_mapper::picture::{self, PictureError};
use landline_testkit::{peak_bytes, shared_data};
use nalgebra::Vector3;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// The folders of the cases and of the pictures.
fn cases() -> Option<(PathBuf, PathBuf)> {
    Some((shared_data("data/cases")?, shared_data("data/redkitchen")?))
}

/// Camera positions by the reference poses, computed here from the file's own numbers.
fn truth(kitchen: &Path) -> HashMap<String, Vector3<f64>> {
    let text = std::fs::read_to_string(kitchen.join("poses_sfm.txt")).expect("is there");
    text.lines()
        .map(|line| {
            let (name, numbers) = line.split_once(' ').expect("a name");
            let v: Vec<f64> = numbers
                .split_whitespace()
                .map(|n| n.parse().expect("a number"))
                .collect();
            let q = nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(
                v[0], v[1], v[2], v[3],
            ));
            let center = -(q.inverse() * Vector3::new(v[4], v[5], v[6]));
            (name.to_owned(), center)
        })
        .collect()
}

fn assert_positions(dataset: &Dataset, kitchen: &Path, most: f64) {
    let truth = truth(kitchen);
    for image in &dataset.images {
        let base = image.name.rsplit('/').next().expect("a name");
        let center = image.cam_from_world.expect("posed").center_in_world();
        let off = (center - truth[base]).norm();
        assert!(off < most, "{} is {off} off", image.name);
    }
}

fn counts(dataset: &Dataset) -> [usize; 3] {
    [Split::Train, Split::Test, Split::Unused].map(|s| dataset.of_split(s).len())
}

/// A `transforms.json` of a case beside pictures of the kitchen.
fn with_json(case: &Path, kitchen: &Path, names: &[&str]) -> (Folder, PathBuf) {
    let folder = Folder::new();
    for name in names {
        folder.copy(&kitchen.join("rgb").join(name), &format!("images/{name}"));
    }
    folder.copy(case, "transforms.json");
    let path = folder.0.join("transforms.json");
    (folder, path)
}

const FIRST: [&str; 3] = [
    "frame-000000.color.jpg",
    "frame-000003.color.jpg",
    "frame-000006.color.jpg",
];

#[test]
fn applied_scale_is_undone_with_its_transform() {
    let Some((cases, kitchen)) = cases() else {
        return;
    };
    let (_folder, path) = with_json(
        &cases.join("applied_scale/transforms.json"),
        &kitchen,
        &FIRST,
    );
    let dataset = read(&path, &[]).expect("a whole file");
    assert_eq!(dataset.images.len(), 3);
    assert_positions(&dataset, &kitchen, 1e-5);
    assert!(dataset.table().to_string().contains("applied_scale 0.25"));
}

#[test]
fn test_pictures_do_not_teach_however_they_are_written() {
    let Some((cases, kitchen)) = cases() else {
        return;
    };
    for name in ["c07_dot.json", "c07_noext.json", "c07_val.json"] {
        let case = cases.join("test_names").join(name);
        let (folder, path) = with_json(&case, &kitchen, &FIRST);
        folder.copy(
            &kitchen.join("rgb/frame-000012.color.jpg"),
            "images/frame-000012.color.jpg",
        );
        // The list names a test picture that the file has no frame of: it would teach, were it there.
        let message = read(&path, &[]).expect_err("unknown name").to_string();
        assert!(
            message.contains("1 of the 2") && message.contains("frame-000033"),
            "{name}: {message}"
        );
        let mut json: serde_json::Value =
            serde_json::from_slice(&std::fs::read(&case).expect("is there")).expect("JSON");
        for key in ["test_filenames", "val_filenames"] {
            if let Some(list) = json.get_mut(key).and_then(|v| v.as_array_mut()) {
                list.retain(|v| !v.as_str().is_some_and(|v| v.contains("000033")));
            }
        }
        let path = folder.text("transforms.json", &json.to_string());
        let dataset = read(&path, &[]).expect("a whole file");
        let tests: Vec<&str> = dataset
            .of_split(Split::Test)
            .into_iter()
            .map(|i| dataset.images[i].name.as_str())
            .collect();
        assert_eq!(tests, ["images/frame-000003.color.jpg"], "{name}");
        // Frame 12 is in none of the lists.
        assert_eq!(counts(&dataset), [2, 1, 1], "{name}");
        assert_positions(&dataset, &kitchen, 1e-5);
    }
}

#[test]
fn windows_json_with_a_mark_is_read_and_a_lost_pose_drops_its_picture() {
    let Some((cases, kitchen)) = cases() else {
        return;
    };
    // The case's file is the beginning of one: mark, line ends of Windows. The rest comes from another case.
    let start = std::fs::read(cases.join("json_bom_nan_win/bom.json")).expect("is there");
    assert!(start.starts_with(b"\xef\xbb\xbf{\r\n"));
    let whole = std::fs::read_to_string(cases.join("applied_scale/transforms.json"));
    let whole = format!("\u{feff}{}", whole.expect("text").replace('\n', "\r\n"));
    let (folder, _) = with_json(
        &cases.join("applied_scale/transforms.json"),
        &kitchen,
        &FIRST,
    );
    let path = folder.text("transforms.json", &whole);
    assert_eq!(read(&path, &[]).expect("a whole file").images.len(), 3);
    let text = whole
        .replacen("0.9288400350327883", "NaN", 1)
        .replace("images/", r".\\images\\");
    let path = folder.text("transforms.json", &text);
    let dataset = read(&path, &[]).expect("all but one");
    assert_eq!(dataset.images.len(), 2);
    assert!(dataset.table().to_string().contains("finite numbers"));
    assert_positions(&dataset, &kitchen, 1e-5);
}

#[test]
fn two_spaces_and_umlauts_in_names() {
    let Some((cases, kitchen)) = cases() else {
        return;
    };
    let folder = Folder::new();
    let images = std::fs::read_to_string(cases.join("spaces/images.txt")).expect("text");
    let mut sources = ["frame-000003.color.jpg", "frame-000012.color.jpg"].iter();
    let mut model = String::new();
    let mut list = String::new();
    for line in images.lines() {
        // Lines begin with the number that they had in the whole file.
        let line = line.split_once(':').map_or(line, |(_, rest)| rest);
        let fields: Vec<&str> = line.splitn(10, ' ').collect();
        let source = sources.next().expect("two pictures");
        folder.copy(
            &kitchen.join("rgb").join(source),
            &format!("images/{}", fields[9]),
        );
        model.push_str(&format!("{line}\n\n"));
        list.push_str(&format!(
            "{} {} 525.505\n",
            fields[9],
            fields[1..8].join(" ")
        ));
    }
    folder.text(
        "sparse/0/cameras.txt",
        "1 SIMPLE_PINHOLE 640 480 525.505 320 240\n",
    );
    folder.text("sparse/0/images.txt", &model);
    // Without points3D.txt: poses do not need it.
    let test_list = folder.text("test.txt", "IMG 003 (1) - Kopie.JPG\n");
    let words = ["--test-list", test_list.to_str().expect("UTF-8")];
    let of_model = read(&folder.0, &words).expect("a model without points");
    let list = folder.text("list.txt", &list);
    let of_list = read(&list, &words).expect("a list");
    for dataset in [&of_model, &of_list] {
        assert_eq!(counts(dataset), [1, 1, 0], "{}", dataset.table());
    }
    assert!(
        of_model
            .images
            .iter()
            .any(|i| i.name == "küche/IMG  001 (1) - Kopie.jpg")
    );

    // A wrong name in a list of test pictures is an error that names it.
    let wrong = folder.text("wrong.txt", "IMG  003 (1) - Kopie.jpg\nIMG 004.jpg\n");
    let message = read(&list, &["--test-list", wrong.to_str().expect("UTF-8")])
        .expect_err("one is unknown")
        .to_string();
    assert!(
        message.contains("1 of the 2") && message.contains("IMG 004.jpg"),
        "{message}"
    );
}

#[test]
fn intrinsics_of_the_full_picture_are_scaled() {
    let Some((cases, kitchen)) = cases() else {
        return;
    };
    let folder = Folder::new();
    folder.copy(&cases.join("k_other_size/poses.txt"), "poses.txt");
    folder.copy(&cases.join("k_other_size/K.txt"), "K.txt");
    let pictures = kitchen.join("rgb");
    let dataset = read(
        &folder.0.join("poses.txt"),
        &["--pictures", pictures.to_str().expect("UTF-8")],
    )
    .expect("a list");
    let camera = dataset.images[0].camera;
    assert_eq!(camera.focal_px(), (525.505, 525.505));
    assert_eq!(camera.principal_point(), Pixel::new(320.0, 240.0));
    assert!(
        dataset.table().to_string().contains("1280x960"),
        "{}",
        dataset.table()
    );
}

#[test]
fn ace_files_are_matched_by_name() {
    let Some((_, kitchen)) = cases() else {
        return;
    };
    // One of everything but: no pose of picture 8, neither picture nor calibration of 12, and a hidden file.
    let folder = Folder::new();
    let list = std::fs::read_to_string(kitchen.join("poses_sfm.txt")).expect("text");
    for (i, line) in list.lines().step_by(6).take(20).enumerate() {
        let fields: Vec<&str> = line.split(' ').collect();
        let v: Vec<f64> = fields[1..8]
            .iter()
            .map(|f| f.parse().expect("a number"))
            .collect();
        let rotation = nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(
            v[0], v[1], v[2], v[3],
        ))
        .inverse();
        let center = -(rotation * Vector3::new(v[4], v[5], v[6]));
        let m = rotation.to_rotation_matrix();
        let rows: Vec<String> = (0..3)
            .map(|r| format!("{} {} {} {}", m[(r, 0)], m[(r, 1)], m[(r, 2)], center[r]))
            .collect();
        let stem = fields[0].trim_end_matches(".color.jpg");
        if i != 12 {
            folder.copy(
                &kitchen.join("rgb").join(fields[0]),
                &format!("train/rgb/{}", fields[0]),
            );
            folder.text(
                &format!("train/calibration/{stem}.calibration.txt"),
                "525.505\n",
            );
        }
        if i != 8 {
            folder.text(
                &format!("train/poses/{stem}.pose.txt"),
                &format!("{}\n0 0 0 1\n", rows.join("\n")),
            );
        }
    }
    folder.text("train/rgb/.DS_Store", "Bud1");
    let dataset = read(&folder.0, &[]).expect("eighteen pairs");
    assert_eq!(dataset.images.len(), 18, "{}", dataset.table());
    assert_positions(&dataset, &kitchen, 1e-5);
    let table = dataset.table().to_string();
    assert!(
        table.contains("frame-000048") && table.contains("frame-000072"),
        "{table}"
    );
}

#[test]
fn a_list_of_stored_pixels_leaves_the_turned_pictures_open() {
    let Some((cases, kitchen)) = cases() else {
        return;
    };
    let folder = exif_folder(&cases, &kitchen);
    let dataset = read(&folder.0.join("poses.txt"), &[]).expect("a list");
    assert_eq!(dataset.undecided.len(), 30, "{}", dataset.table());
    // The other reading is that of the upright original: the same place, turned about the axis.
    let truth = truth(&kitchen);
    for other in &dataset.undecided {
        let image = &dataset.images[other.image];
        assert_eq!((image.camera.width, image.camera.height), (640, 480));
        assert_eq!(
            other.camera,
            landline::geometry::Camera::centered(640, 480, 525.505)
        );
        let center = other.cam_from_world.expect("posed").center_in_world();
        assert!((center - truth[&image.name]).norm() < 1e-5);
    }
}

/// Pictures of the case `exif_list`: every second one turned counterclockwise as stored, with EXIF orientation 6.
pub(crate) fn exif_folder(cases: &Path, kitchen: &Path) -> Folder {
    let folder = Folder::new();
    folder.copy(&cases.join("exif_list/poses.txt"), "poses.txt");
    let list = std::fs::read_to_string(cases.join("exif_list/poses.txt")).expect("text");
    for (i, line) in list.lines().enumerate() {
        let name = line.split(' ').next().expect("a name");
        let from = kitchen.join("rgb").join(name);
        if i % 2 == 0 {
            folder.copy(&from, &format!("images/{name}"));
        } else {
            let picture = picture::read(&from).expect("a picture").rotate270();
            let path = folder.text(&format!("images/{name}"), "");
            crate::folder::write_turned_jpeg(&picture, &path);
        }
    }
    folder
}

#[test]
fn hostile_files_are_refused_by_what_they_declare() {
    let Some((cases, _)) = cases() else { return };
    let hostile = cases.join("hostile");
    for name in ["png-header-65535.png", "jpeg-1kB-20s.jpg"] {
        let path = hostile.join(name);
        let (outcomes, peak) = peak_bytes(|| {
            [
                picture::size(&path).map(drop),
                picture::read(&path).map(drop),
            ]
        });
        for outcome in outcomes {
            assert!(
                matches!(outcome, Err(PictureError::Refused { .. })),
                "{name}: {outcome:?}"
            );
        }
        assert!(peak < 4 << 20, "{name}: {peak} bytes");
    }
    // Of version 1: the same faults in a file of this version are beside the reader.
    for name in [
        "labels-keypoints-1e11.st",
        "labels-rotation-0.st",
        "labels-samples-wrap.st",
        "labels-translation-1e308.st",
    ] {
        let (outcome, peak) = peak_bytes(|| Labels::read(&hostile.join(name)).map(drop));
        let message = outcome.expect_err(name).to_string();
        assert!(
            message.contains("version 1") && message.contains(name),
            "{message}"
        );
        assert!(peak < 1 << 20, "{name}: {peak} bytes");
    }
    let path = hostile.join("memo-bomb-small.pkl");
    let bytes = std::fs::read(&path).expect("is there");
    let (_, peak) = peak_bytes(|| {
        landline_mapper::import::pickle::Arena::default()
            .read(&bytes)
            .map(drop)
    });
    assert!(peak < 64 * bytes.len() + (1 << 20), "{peak} bytes");
}

#[test]
fn pictures_that_are_cut_off_or_dark_by_their_depth() {
    let Some((_, kitchen)) = cases() else { return };
    let folder = Folder::new();
    let jpeg = std::fs::read(kitchen.join("rgb").join(FIRST[0])).expect("is there");
    let cut = folder.0.join("cut.jpg");
    std::fs::write(&cut, &jpeg[..20_000.min(jpeg.len() / 2)]).expect("writable");
    assert!(matches!(
        picture::size(&cut),
        Err(PictureError::CutOff { .. })
    ));
    assert!(matches!(
        picture::read(&cut),
        Err(PictureError::CutOff { .. })
    ));
    // Without its end marker only: some cameras leave it out.
    let whole = folder.0.join("whole.jpg");
    let end = jpeg
        .windows(2)
        .rposition(|w| w == [0xff, 0xd9])
        .expect("ends");
    std::fs::write(&whole, &jpeg[..end]).expect("writable");
    picture::size(&whole).expect("all pixels are there");

    // Twelve bits in sixteen look as eight bits do.
    let gray = picture::read(&kitchen.join("rgb").join(FIRST[0]))
        .expect("reads")
        .into_luma8();
    let deep =
        image::ImageBuffer::<image::Luma<u16>, _>::from_fn(gray.width(), gray.height(), |x, y| {
            image::Luma([(u32::from(gray.get_pixel(x, y)[0]) * 4095 / 255) as u16])
        });
    let path = folder.0.join("deep.png");
    deep.save(&path).expect("writable");
    let read = picture::read_gray(&path).expect("reads");
    let most = read
        .data
        .iter()
        .zip(gray.as_raw())
        .map(|(a, b)| a.abs_diff(*b))
        .max();
    assert!(most <= Some(1), "{most:?}");

    // Formats that browsers read too.
    for ending in ["webp", "tiff", "bmp"] {
        let path = folder.0.join(format!("a.{ending}"));
        gray.save(&path).expect("writable");
        assert_eq!(
            picture::read_gray(&path).expect(ending).data,
            *gray.as_raw(),
            "{ending}"
        );
    }
    let avif = folder.0.join("a.avif");
    std::fs::write(&avif, b"\0\0\0\x1cftypavif\0\0\0\0avifmif1miaf").expect("writable");
    let message = picture::size(&avif).expect_err("no decoder").to_string();
    assert!(
        message.contains("AVIF") && message.contains("convert"),
        "{message}"
    );
}

#[test]
fn a_model_split_over_two_says_which_is_read_and_a_missing_picture_where_it_was_looked_for() {
    let folder = Folder::new();
    folder.picture("photos/a.png", 64, 48);
    for (model, names) in [("0", &["a.png"][..]), ("1", &["a.png", "b.png"])] {
        folder.text(
            &format!("sparse/{model}/cameras.txt"),
            "1 PINHOLE 64 48 50 50 32 24\n",
        );
        let lines: String = names
            .iter()
            .enumerate()
            .map(|(i, name)| format!("{} 1 0 0 0 {i} 0 0 1 {name}\n\n", i + 1))
            .collect();
        folder.text(&format!("sparse/{model}/images.txt"), &lines);
    }
    // Found below the folder, though it is called neither images nor rgb.
    let dataset = read(&folder.0, &[]).expect("one of two");
    let table = dataset.table().to_string();
    assert!(position(&dataset, "a.png").norm() < 1e-9);
    assert!(
        table.contains("sparse/1 with 2 pictures") && table.contains("sparse/0 (1"),
        "{table}"
    );
    assert!(
        table.contains("--pictures") && table.contains("b.png"),
        "{table}"
    );
    std::fs::remove_file(folder.0.join("photos/a.png")).expect("exists");
    let message = read(&folder.0, &[]).expect_err("none").to_string();
    assert!(
        message.contains("a.png, ...") && message.contains("looked for in"),
        "{message}"
    );
}
