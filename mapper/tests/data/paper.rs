//! The paper's protocol on small folders in each layout: the official split, both pose sets, results that are not measured twice.

use crate::folder::Folder;
use landline_mapper::dataset::{Dataset, Split};
use landline_mapper::paper::{DataSet, Measured, PaperError, joined_poses, resumed};

fn names(dataset: &Dataset, split: Split) -> Vec<&str> {
    let positions = dataset.of_split(split).into_iter();
    positions.map(|i| dataset.images[i].name.as_str()).collect()
}

/// A scene of three sequences of one picture; the second tests.
fn seven_scenes(folder: &Folder, scene: &str) {
    for i in 1..=3 {
        let frame = format!("{scene}/seq-{i:02}/frame-000000");
        folder.picture(&format!("{frame}.color.png"), 64, 48);
        folder.text(
            &format!("{frame}.pose.txt"),
            &format!("1 0 0 {i}\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"),
        );
    }
    folder.text(&format!("{scene}/TrainSplit.txt"), "sequence1\nsequence3\n");
    folder.text(&format!("{scene}/TestSplit.txt"), "sequence2\n");
}

#[test]
fn seven_scenes_have_their_official_split_under_both_pose_sets() {
    let folder = Folder::new();
    seven_scenes(&folder, "heads");
    seven_scenes(&folder, "stairs");
    let set = DataSet::SevenScenes;
    assert_eq!(
        set.chosen(&folder.0, &[]).expect("two are there"),
        ["heads", "stairs"]
    );
    let one = set.chosen(&folder.0, &["stairs".to_owned()]);
    assert_eq!(one.expect("is there"), ["stairs"]);
    let shipped = set.open(&folder.0, "heads", None).expect("whole");
    let test = ["seq-02/frame-000000.color.png"];
    assert_eq!(names(&shipped, Split::Test), test);
    assert_eq!(shipped.of_split(Split::Train).len(), 2);

    let row = |i: u32| format!("seq-{i:02}/frame-000000.color.png 1 0 0 0 0 {i} 0 530\n");
    folder.text("sfm/heads_train.txt", &(row(1) + &row(3)));
    folder.text("sfm/heads_test.txt", &row(2));
    let joined =
        |scene: &str| joined_poses(&folder.0.join("sfm"), scene, &folder.0.join("w/p.txt"));
    assert_eq!(joined("stairs").expect("no list is no error"), None);
    let list = joined("heads").expect("readable").expect("there");
    let sfm = set.open(&folder.0, "heads", Some(&list)).expect("whole");
    assert_eq!(names(&sfm, Split::Test), test);
    let pose = sfm.images[1].cam_from_world.expect("has one");
    assert_eq!(pose.translation.as_slice(), [0.0, 2.0, 0.0]);

    let refused = set.chosen(&folder.0, &["kitchen".to_owned()]);
    assert!(matches!(refused, Err(PaperError::Unknown { .. })));
    let refused = DataSet::Indoor6.chosen(&folder.0, &[]);
    assert!(matches!(refused, Err(PaperError::NoScene { .. })));
    std::fs::remove_file(folder.0.join("stairs/TestSplit.txt")).expect("exists");
    let refused = set.open(&folder.0, "stairs", None).expect_err("no split");
    assert!(refused.to_string().contains("TestSplit.txt"), "{refused}");
}

#[test]
fn indoor6_teaches_without_its_pictures_for_validation() {
    let folder = Folder::new();
    for stem in ["image-a", "image-b", "image-c", "image-d"] {
        let file = |ending: &str| format!("scene2a/images/{stem}.{ending}");
        folder.picture(&file("color.jpg"), 64, 48);
        folder.text(&file("intrinsics.txt"), "64 48 50 32 24 0 original.jpg\n");
        folder.text(&file("pose.txt"), "1 0 0 1\n0 1 0 0\n0 0 1 0\n");
    }
    let pickle = pickled(&[("train", &["a", "b"]), ("val", &["c"]), ("test", &["d"])]);
    std::fs::write(folder.0.join("scene2a/train_test_val.pkl"), pickle).expect("writable");
    let set = DataSet::Indoor6;
    assert_eq!(
        set.chosen(&folder.0, &[]).expect("one is there"),
        ["scene2a"]
    );
    let dataset = set.open(&folder.0, "scene2a", None).expect("whole");
    assert_eq!(
        names(&dataset, Split::Train),
        ["image-a.color.jpg", "image-b.color.jpg"]
    );
    assert_eq!(names(&dataset, Split::Test), ["image-d.color.jpg"]);
}

/// `pickle.dumps` of lists of picture names, protocol 2 without its memo.
fn pickled(lists: &[(&str, &[&str])]) -> Vec<u8> {
    let text = |out: &mut Vec<u8>, text: &str| {
        out.push(b'X');
        out.extend((text.len() as u32).to_le_bytes());
        out.extend(text.bytes());
    };
    let mut out = b"\x80\x02}(".to_vec();
    for (key, stems) in lists {
        text(&mut out, key);
        out.extend(b"](");
        for stem in *stems {
            text(&mut out, &format!("image-{stem}.color.jpg"));
        }
        out.push(b'e');
    }
    out.extend(b"u.");
    out
}

#[test]
fn a_result_is_measured_once_for_each_identity() {
    let folder = Folder::new();
    seven_scenes(&folder, "fire");
    let open = || {
        DataSet::SevenScenes
            .open(&folder.0, "fire", None)
            .expect("whole")
    };
    let identity = |options: &str| Measured::identity(&open(), &"0".repeat(64), options);
    let mut count = 0;
    let mut measure = |identity: &str| {
        let make = || {
            count += 1;
            Ok(Measured {
                identity: identity.to_owned(),
                num_train: 2,
                num_test: 1,
                methods: vec![(
                    "scene".to_owned(),
                    [None, Some(1.0), Some(f64::from(count))],
                )],
                forward_ms: 1.0,
                pose_ms: 1.0,
                num_bytes: 1,
                teaching_s: 1.0,
            })
        };
        let measured = resumed(&folder.0.join("fire.json"), identity, make).expect("writable");
        measured.methods[0].1[2]
    };
    let first = identity("a");
    assert_eq!(measure(&first), Some(1.0));
    assert_eq!(
        measure(&first),
        Some(1.0),
        "an interrupted run goes on behind it"
    );
    assert_eq!(measure(&identity("b")), Some(2.0), "other options");
    // Another pose, another picture: another result.
    folder.text(
        "fire/seq-01/frame-000000.pose.txt",
        "1 0 0 9\n0 1 0 0\n0 0 1 0\n0 0 0 1\n",
    );
    assert_eq!(measure(&identity("b")), Some(3.0), "other poses");
    folder.picture("fire/seq-03/frame-000000.color.png", 80, 60);
    assert_eq!(measure(&identity("b")), Some(4.0), "another picture");
    std::fs::write(folder.0.join("fire.json"), "{").expect("writable");
    assert_eq!(measure(&identity("b")), Some(5.0), "a damaged result");
}
