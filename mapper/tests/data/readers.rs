//! Every format to one data set: small folders written here, a COLMAP model written by COLMAP.

use crate::folder::Folder;
use clap::Parser;
use landline::geometry::CameraModel;
use landline_mapper::dataset::{DataArgs, Dataset, DatasetError, Split, open};
use nalgebra::Vector3;
use std::path::Path;

#[derive(Parser)]
struct Cli {
    #[command(flatten)]
    data: DataArgs,
}

pub(crate) fn read(path: &Path, more: &[&str]) -> Result<Dataset, DatasetError> {
    let mut words = vec!["test", path.to_str().expect("UTF-8")];
    words.extend(more);
    open(&Cli::try_parse_from(words).expect("valid arguments").data)
}

pub(crate) fn position(dataset: &Dataset, name: &str) -> Vector3<f64> {
    let image = dataset
        .images
        .iter()
        .find(|i| i.name == name)
        .unwrap_or_else(|| panic!("{name} is missing: {}", dataset.table()));
    image.cam_from_world.expect("has a pose").center_in_world()
}

fn near(a: Vector3<f64>, b: [f64; 3]) -> bool {
    (a - Vector3::from(b)).norm() < 1e-6
}

const RIG_PICTURES: [&str; 6] = [
    "camera000001_frame000000.png",
    "camera000001_frame000001.png",
    "camera000001_frame000002.png",
    "camera000002_frame000000.png",
    "camera000002_frame000001.png",
    "camera000002_frame000002.png",
];

fn colmap_fixture(extension: &str) -> Folder {
    let folder = Folder::new();
    let from = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/colmap_rig");
    for name in ["cameras", "images", "points3D", "rigs", "frames"] {
        let file = format!("{name}.{extension}");
        folder.copy(&from.join(&file), &format!("sparse/0/{file}"));
    }
    for name in RIG_PICTURES {
        folder.picture(&format!("images/{name}"), 64, 48);
    }
    folder
}

#[test]
fn colmap_model_with_rigs_reprojects_its_own_points() {
    for extension in ["bin", "txt"] {
        let folder = colmap_fixture(extension);
        let dataset = read(&folder.0, &[]).expect("a whole model");
        assert_eq!(dataset.images.len(), 6, "{extension}");
        assert_eq!(dataset.points.len(), 12);
        // The model was synthesised without noise, with lens distortion and two cameras in a rig: every observation
        // must reproject exactly, which holds poses, cameras and the joining of files to account at once.
        let mut count = 0;
        for point in &dataset.points {
            for (image, pixel) in &point.observations {
                let image = &dataset.images[*image];
                let in_cam = image
                    .cam_from_world
                    .expect("posed")
                    .transform_point(&point.point_in_world);
                let projected = image.camera.pixel_from_cam(&in_cam).expect("in front");
                assert!(
                    projected.distance(*pixel) < 1e-6,
                    "{extension} {}",
                    image.name
                );
                count += 1;
            }
        }
        assert_eq!(count, 72);
        assert!(matches!(
            dataset.images[0].camera.model,
            CameraModel::SimpleRadial { .. }
        ));
    }
}

#[test]
fn cut_or_wrong_colmap_files_name_file_and_place() {
    let folder = colmap_fixture("bin");
    let images = folder.0.join("sparse/0/images.bin");
    let bytes = std::fs::read(&images).expect("exists");
    std::fs::write(&images, &bytes[..bytes.len() / 2]).expect("writable");
    let message = read(&folder.0, &[]).expect_err("cut").to_string();
    assert!(
        message.contains("images.bin") && message.contains("byte"),
        "{message}"
    );

    let folder = colmap_fixture("bin");
    let cameras = folder.0.join("sparse/0/cameras.bin");
    let mut bytes = std::fs::read(&cameras).expect("exists");
    bytes[12] = 77;
    std::fs::write(&cameras, &bytes).expect("writable");
    let message = read(&folder.0, &[]).expect_err("unknown model").to_string();
    assert!(message.contains("camera model 77 is unknown"), "{message}");
}

/// Found by fuzzing: of a binary model nobody had asked whether its points are numbers.
#[test]
fn points_and_keypoints_of_a_model_are_numbers() {
    // After the count and the id; after the count, id, pose, camera, name and count of keypoints.
    let in_image = 8 + 4 + 7 * 8 + 4 + RIG_PICTURES[0].len() + 1 + 8;
    for (file, at) in [("points3D.bin", 8 + 8 + 8), ("images.bin", in_image)] {
        for value in [f64::NAN, f64::NEG_INFINITY] {
            let folder = colmap_fixture("bin");
            let path = folder.0.join("sparse/0").join(file);
            let mut bytes = std::fs::read(&path).expect("exists");
            bytes[at..at + 8].copy_from_slice(&value.to_le_bytes());
            std::fs::write(&path, &bytes).expect("writable");
            let message = read(&folder.0, &[]).expect_err("no number").to_string();
            let said = format!("byte {at}");
            assert!(
                message.contains(file) && message.contains(&said),
                "{message}"
            );
        }
    }
    let folder = colmap_fixture("txt");
    let path = folder.0.join("sparse/0/images.txt");
    let text = std::fs::read_to_string(&path).expect("exists");
    let line = text.lines().filter(|l| !l.starts_with('#')).nth(1);
    let first = line.and_then(|l| l.split(' ').next()).expect("keypoints");
    std::fs::write(&path, text.replacen(&format!("\n{first} "), "\nNaN ", 1)).expect("writable");
    let message = read(&folder.0, &[]).expect_err("no number").to_string();
    assert!(message.contains("images.txt"), "{message}");
}

#[test]
fn missing_and_damaged_pictures_are_counted_in_the_table() {
    let folder = colmap_fixture("txt");
    std::fs::remove_file(folder.0.join("images").join(RIG_PICTURES[0])).expect("exists");
    std::fs::write(folder.0.join("images").join(RIG_PICTURES[1]), b"no picture").expect("exists");
    folder.picture(&format!("images/{}", RIG_PICTURES[2]), 64, 40);
    let dataset = read(&folder.0, &[]).expect("three are left");
    assert_eq!(dataset.images.len(), 3);
    let table = dataset.table().to_string();
    for reason in [
        "picture is missing",
        "picture cannot be read",
        "picture and camera differ in aspect",
    ] {
        assert!(table.contains(&format!("1 x {reason}")), "{table}");
    }
    std::fs::remove_dir_all(folder.0.join("images")).expect("exists");
    std::fs::create_dir(folder.0.join("images")).expect("writable");
    let message = read(&folder.0, &[]).expect_err("none left").to_string();
    assert!(message.contains("6 x picture is missing"), "{message}");
}

#[test]
fn nerfstudio_axes_and_applied_transform() {
    let folder = Folder::new();
    for name in ["images/a.png", "images/b.png"] {
        folder.picture(name, 64, 48);
    }
    // Camera at (1, 2, 3) of the source, looking along the source's -z with y up: OpenGL's own camera.
    // The world was turned: x' = x, y' = z, z' = -y.
    folder.text(
        "transforms.json",
        r#"{"camera_model": "OPENCV", "fl_x": 50, "fl_y": 51, "cx": 32.5, "cy": 24, "w": 64, "h": 48,
            "k1": 0.01, "applied_transform": [[1,0,0,0],[0,0,1,0],[0,-1,0,0]],
            "test_filenames": ["images/b.png"],
            "frames": [
              {"file_path": "./images/a.png", "transform_matrix": [[1,0,0,1],[0,0,1,3],[0,-1,0,-2],[0,0,0,1]]},
              {"file_path": "images/b", "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]},
              {"file_path": "images/c.png", "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]},
              {"file_path": "images/a.png", "transform_matrix": [[-1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}]}"#,
    );
    let dataset = read(&folder.0, &[]).expect("two usable frames");
    assert_eq!(dataset.images.len(), 2);
    assert!(near(position(&dataset, "images/a.png"), [1.0, 2.0, 3.0]));
    let image = &dataset.images[0];
    // One metre in front of the camera and 0.1 m up in the source's world lies above the middle of the picture.
    let in_cam = image
        .cam_from_world
        .expect("posed")
        .transform_point(&Vector3::new(1.0, 2.1, 2.0));
    assert!(near(in_cam, [0.0, -0.1, 1.0]), "{in_cam}");
    assert_eq!(dataset.images[1].split, Split::Test);
    let table = dataset.table().to_string();
    assert!(
        table.contains("picture is missing") && table.contains("mirrored"),
        "{table}"
    );
}

#[test]
fn instant_ngp_angle_gives_the_focal_length() {
    let folder = Folder::new();
    folder.picture("0001.jpg", 64, 48);
    folder.picture("0002.jpg", 64, 48);
    let frame = |n: u32, x: f64| {
        format!(
            r#"{{"file_path": "000{n}.jpg", "transform_matrix": [[1,0,0,{x}],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}}"#
        )
    };
    let path = folder.text(
        "t.json",
        &format!(
            r#"{{"camera_angle_x": 1.5707963267948966, "frames": [{}, {}]}}"#,
            frame(1, 0.0),
            frame(2, 0.5)
        ),
    );
    let dataset = read(&path, &[]).expect("plain");
    let (fx, fy) = dataset.images[0].camera.focal_px();
    assert!((fx - 32.0).abs() < 1e-9 && (fy - 32.0).abs() < 1e-9);
    assert!(near(position(&dataset, "0002.jpg"), [0.5, 0.0, 0.0]));
}

const IDENTITY_AT_X: &str = "1 0 0 X\n0 1 0 0\n0 0 1 0\n0 0 0 1\n";

#[test]
fn seven_scenes_moves_poses_to_the_colour_camera() {
    let folder = Folder::new();
    for (sequence, x) in [("seq-01", "0.5"), ("seq-02", "inf")] {
        folder.picture(&format!("{sequence}/frame-000000.color.png"), 640, 480);
        folder.text(
            &format!("{sequence}/frame-000000.pose.txt"),
            &IDENTITY_AT_X.replace('X', x),
        );
    }
    folder.picture("seq-03/frame-000000.color.png", 640, 480);
    folder.text(
        "seq-03/frame-000000.pose.txt",
        &IDENTITY_AT_X.replace('X', "0"),
    );
    folder.text("TrainSplit.txt", "sequence1\nsequence2\n");
    folder.text("TestSplit.txt", "sequence3\n");
    let dataset = read(&folder.0, &[]).expect("two usable");
    assert_eq!(dataset.format, "7-Scenes");
    assert_eq!(dataset.images.len(), 2);
    assert_eq!(dataset.images[1].split, Split::Test);
    assert!(dataset.table().to_string().contains("not finite"));
    // The colour camera sits 2.5 cm beside the depth camera.
    let moved = position(&dataset, "seq-01/frame-000000.color.png") - Vector3::new(0.5, 0.0, 0.0);
    assert!((moved.norm() - 0.0256).abs() < 1e-4, "{moved}");
    assert_eq!(dataset.images[0].camera.focal_px(), (525.0, 525.0));

    // Poses of the colour camera already: nothing is moved.
    let own = read(&folder.0, &["--poses-of", "color"]).expect("two usable");
    assert!(near(
        position(&own, "seq-01/frame-000000.color.png"),
        [0.5, 0.0, 0.0]
    ));

    // Better poses as a list replace them; the split files stay.
    folder.text(
        "pgt.txt",
        "seq-01/frame-000000.color.png 1 0 0 0 -1 0 0 530\nseq-03/frame-000000.color.png 1 0 0 0 0 0 0 530\n",
    );
    let dataset = read(&folder.0, &["--poses", "pgt.txt"]).expect("a list");
    assert!(near(
        position(&dataset, "seq-01/frame-000000.color.png"),
        [1.0, 0.0, 0.0]
    ));
    assert_eq!(dataset.images[1].split, Split::Test);
}

#[test]
fn ace_folders_are_matched_by_name() {
    let folder = Folder::new();
    for i in 0..2 {
        folder.picture(&format!("train/rgb/{i}.png"), 64, 48);
        folder.text(
            &format!("train/poses/{i}.txt"),
            &IDENTITY_AT_X.replace('X', &i.to_string()),
        );
        folder.text(&format!("train/calibration/{i}.txt"), "50\n");
    }
    let dataset = read(&folder.0, &[]).expect("plain");
    assert!(near(position(&dataset, "train/rgb/1.png"), [1.0, 0.0, 0.0]));
    std::fs::remove_file(folder.0.join("train/poses/0.txt")).expect("exists");
    let dataset = read(&folder.0, &[]).expect("one is left");
    assert!(near(position(&dataset, "train/rgb/1.png"), [1.0, 0.0, 0.0]));
    assert_eq!(dataset.dropped.len(), 1);
    folder.text("train/poses/first.txt", &IDENTITY_AT_X.replace('X', "0"));
    std::fs::rename(
        folder.0.join("train/poses/1.txt"),
        folder.0.join("train/poses/second.txt"),
    )
    .expect("exists");
    let dataset = read(&folder.0, &[]).expect("as many of each");
    assert_eq!(dataset.images.len(), 2);
    assert!(dataset.table().to_string().contains("matched by order"));
    std::fs::remove_file(folder.0.join("train/poses/first.txt")).expect("exists");
    let message = read(&folder.0, &[])
        .expect_err("nothing to go by")
        .to_string();
    assert!(message.contains("2 pictures, 1 poses"), "{message}");
}

#[test]
fn indoor6_poses_are_camera_from_world_and_its_split_is_pickled() {
    let folder = Folder::new();
    for (stem, x) in [("image-a", "-1"), ("image-b", "-2"), ("image-c", "-3")] {
        folder.picture(&format!("images/{stem}.color.jpg"), 64, 48);
        folder.text(
            &format!("images/{stem}.intrinsics.txt"),
            "64 48 50 32 24 0 original.jpg\n",
        );
        folder.text(
            &format!("images/{stem}.pose.txt"),
            &format!("1 0 0 {x}\n0 1 0 0\n0 0 1 0\n"),
        );
    }
    // pickle.dumps({'train': ['image-a.color.jpg'], 'test': ['image-b.color.jpg']}, protocol=2)
    let pickle = b"\x80\x02}q\x00(X\x05\x00\x00\x00trainq\x01]q\x02X\x11\x00\x00\x00image-a.color.jpgq\x03aX\x04\x00\x00\x00testq\x04]q\x05X\x11\x00\x00\x00image-b.color.jpgq\x06au.";
    std::fs::write(folder.0.join("train_test_val.pkl"), pickle).expect("writable");
    let dataset = read(&folder.0, &[]).expect("plain");
    assert_eq!(dataset.format, "Indoor-6");
    assert!(near(
        position(&dataset, "image-b.color.jpg"),
        [2.0, 0.0, 0.0]
    ));
    let splits: Vec<Split> = dataset.images.iter().map(|i| i.split).collect();
    assert_eq!(splits, [Split::Train, Split::Test, Split::Unused]);
}

#[test]
fn tum_poses_are_joined_by_time() {
    let folder = Folder::new();
    for name in ["rgb/1.png", "rgb/2.png", "rgb/3.png"] {
        folder.picture(name, 64, 48);
    }
    folder.text(
        "rgb.txt",
        "# color images\n10.00 rgb/1.png\n11.00 rgb/2.png\n12.00 rgb/3.png\n",
    );
    folder.text(
        "groundtruth.txt",
        "# t tx ty tz qx qy qz qw\n9.99 1 0 0 0 0 0 1\n10.005 2 0 0 0 0 0 1\n10.99 0 3 0 0 0 0.7071068 0.7071068\n",
    );
    let camera = ["--camera", "PINHOLE,64,48,50,50,32,24"];
    let dataset = read(&folder.0, &camera).expect("two with poses");
    assert!(near(position(&dataset, "rgb/1.png"), [2.0, 0.0, 0.0]));
    assert!(near(position(&dataset, "rgb/2.png"), [0.0, 3.0, 0.0]));
    assert!(
        dataset
            .table()
            .to_string()
            .contains("no pose within 0.02 s (rgb/3.png)")
    );
    let message = read(&folder.0, &[]).expect_err("no camera").to_string();
    assert!(message.contains("--camera"), "{message}");
}

#[test]
fn lists_of_poses_and_queries() {
    let folder = Folder::new();
    for name in ["a b.png", "c.png", "d.png"] {
        folder.picture(&format!("rgb/{name}"), 64, 48);
    }
    folder.text(
        "poses_sfm.txt",
        "a b.png 1 0 0 0 -1 0 0 50\nc.png 1 0 0 0 0 -2 0 50\nd.png 2 0 0 0 0 0 0 50\n",
    );
    let dataset = read(&folder.0, &["--test", "1"]).expect("two usable");
    assert!(near(position(&dataset, "a b.png"), [1.0, 0.0, 0.0]));
    assert_eq!(dataset.images[1].split, Split::Test);
    assert!(dataset.table().to_string().contains("scale 2.000"));
    let inverted = read(&folder.0, &["--pose-direction", "world-from-cam"]).expect("as told");
    assert!(near(position(&inverted, "a b.png"), [-1.0, 0.0, 0.0]));

    // Matrices, with the camera of K.txt whose pixels are integers at their centres.
    let matrices = Folder::new();
    matrices.picture("rgb/a.png", 64, 48);
    matrices.text("poses.txt", "a.png 1 0 0 7 0 1 0 0 0 0 1 0 0 0 0 1\n");
    matrices.text("K.txt", "50 0 31.5\n0 50 23.5\n0 0 1\n");
    let dataset = read(&matrices.0, &[]).expect("world from camera");
    assert!(near(position(&dataset, "a.png"), [7.0, 0.0, 0.0]));
    assert_eq!(
        dataset.images[0].camera.principal_point(),
        landline::geometry::Pixel::new(32.0, 24.0)
    );
    matrices.text("poses.txt", "a.png -1 0 0 7 0 1 0 0 0 0 1 0 0 0 0 1\n");
    let message = read(&matrices.0, &[]).expect_err("mirrored").to_string();
    assert!(
        message.contains("a.png") && message.contains("mirrored"),
        "{message}"
    );

    let queries = folder.text("queries.txt", "c.png SIMPLE_RADIAL 64 48 50 32 24 0.1\n");
    let dataset = read(&queries, &[]).expect("a query list");
    assert_eq!(dataset.images[0].cam_from_world, None);
    assert_eq!(dataset.images[0].split, Split::Test);

    let broken = folder.text(
        "broken.txt",
        "a b.png 1 0 0 0 -1 0 0 50\nc.png 1 0 0 zero 0 0 0 50\n",
    );
    let message = read(&broken, &[]).expect_err("no number").to_string();
    assert!(
        message.contains("line 2") && message.contains("zero"),
        "{message}"
    );
}

#[test]
fn limap_tracks_join_segments_by_any_white_space() {
    let folder = Folder::new();
    for name in ["a.png", "b.png"] {
        folder.picture(&format!("images/{name}"), 64, 48);
    }
    folder.text(
        "poses.txt",
        "a.png 1 0 0 0 0 0 0 50\nb.png 1 0 0 0 -1 0 0 50\n",
    );
    folder.text(
        "limap/image_list.txt",
        "number of images, 2\n1, /data/images/a.png\n2,b.png\n",
    );
    folder.text(
        "limap/segments/segments_1.txt",
        "2\n0 0 10 0\n5.5  1   5.5 9\n",
    );
    folder.text("limap/segments/segments_2.txt", "0\n");
    folder.text(
        "limap/alltracks.txt",
        "1\n0 1 1\n0.0   1.0  2.0\n3 4 5\n1 \n1 \n",
    );
    let limap = folder.0.join("limap");
    let limap = limap.to_str().expect("UTF-8");
    let dataset = read(&folder.0, &["--lines", limap]).expect("a line map");
    assert_eq!(dataset.lines.len(), 1);
    assert_eq!(dataset.lines[0].observations, [(0, 1)]);
    assert_eq!(dataset.lines[0].end_in_world, Vector3::new(3.0, 4.0, 5.0));
    let segments = dataset.segments.expect("came with the map");
    // Corner-based: half a pixel more than the file.
    assert_eq!(segments[0][1], [6.0, 1.5, 6.0, 9.5]);
    assert!(segments[1].is_empty());

    folder.text("limap/alltracks.txt", "1\n0 1 1\n0 1 2\n3 4 5\n1\n7\n");
    let message = read(&folder.0, &["--lines", limap])
        .expect_err("no such segment")
        .to_string();
    assert!(
        message.contains("segment 7 of picture 1, which has 2"),
        "{message}"
    );
}

#[test]
fn pictures_with_an_exif_turn_bring_their_pose_along() {
    let folder = Folder::new();
    let path = folder.picture("rgb/a.jpg", 64, 48);
    folder.picture("rgb/b.jpg", 64, 48);
    // A JPEG with orientation 6 (turn clockwise to see it upright): an APP1 segment after the first marker.
    let plain = std::fs::read(&path).expect("exists");
    let tiff = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0";
    let mut turned = plain[..2].to_vec();
    turned.extend([0xff, 0xe1]);
    turned.extend(((tiff.len() + 2) as u16).to_be_bytes());
    turned.extend(tiff);
    turned.extend(&plain[2..]);
    std::fs::write(&path, turned).expect("writable");
    let queries = folder.text(
        "cameras.txt",
        "a.jpg PINHOLE 64 48 50 51 30 20\nb.jpg PINHOLE 64 48 50 51 30 20\n",
    );
    folder.text("poses.txt", "a.jpg 1 0 0 0 0 0 0\nb.jpg 1 0 0 0 0 0 0\n");
    let cameras = queries.to_str().expect("UTF-8");
    let dataset =
        read(&folder.0, &["--cameras", cameras, "--poses", "poses.txt"]).expect("both usable");
    let a = &dataset.images[0];
    assert_eq!((a.camera.width, a.camera.height), (48, 64));
    let world = Vector3::new(0.1, -0.05, 1.0);
    let pixel = |i: usize| {
        let image = &dataset.images[i];
        let in_cam = image.cam_from_world.expect("posed").transform_point(&world);
        image.camera.pixel_from_cam(&in_cam).expect("in front")
    };
    let (turned, plain) = (pixel(0), pixel(1));
    assert!((turned.x - (48.0 - plain.y)).abs() < 1e-9 && (turned.y - plain.x).abs() < 1e-9);
    assert!(dataset.table().to_string().contains("EXIF"));
}

#[test]
fn pointers_in_place_of_files_and_unknown_folders_are_named() {
    let folder = Folder::new();
    folder.text(
        "poses.txt",
        "version https://git-lfs.github.com/spec/v1\noid sha256:0\n",
    );
    let path = folder.0.join("poses.txt");
    let message = read(&path, &["--format", "pose-list"])
        .expect_err("a pointer")
        .to_string();
    assert!(
        message.contains("neither a pose nor a query") || message.contains("LFS"),
        "{message}"
    );
    let empty = Folder::new();
    let message = read(&empty.0, &[]).expect_err("empty").to_string();
    assert!(
        message.contains("no data set that this tool knows"),
        "{message}"
    );
    let message = read(Path::new("/nowhere/at/all"), &[])
        .expect_err("absent")
        .to_string();
    assert!(message.contains("/nowhere/at/all"), "{message}");
}
