//! A disk that is full in the middle of a run: a clear error, and nothing lost.

use crate::folder::Folder;
use landline::front_end::FrontEndOptions;
use landline::geometry::{CamFromWorld, Camera};
use landline::math::Rng;
use landline::models::ExtractorKind;
use landline::nn::{WeightTensor, Weights};
use landline::reconstruction::{PointTrack, Reconstruction};
use landline::scene_file::ExtractorFile;
use landline_mapper::dataset::{DatasetImage, Split};
use landline_mapper::extract::Extraction;
use landline_mapper::labels::{Labels, Origin};
use landline_mapper::progress::Progress;
use landline_testkit::skip;
use nalgebra::Vector3;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A file system of a given size in memory, where the user may mount one.
struct SmallDisk(PathBuf);

impl SmallDisk {
    fn mount(at: PathBuf, num_kb: u64) -> Option<Self> {
        std::fs::create_dir_all(&at).expect("writable");
        Self::run(
            "mount",
            &["-t", "tmpfs", "-o", &format!("size={num_kb}k"), "tmpfs"],
            &at,
        )
        .then_some(Self(at))
    }

    fn grow(&self) {
        assert!(Self::run("mount", &["-o", "remount,size=64m"], &self.0));
    }

    fn run(program: &str, words: &[&str], at: &Path) -> bool {
        Command::new(program)
            .args(words)
            .arg(at)
            .output()
            .is_ok_and(|o| o.status.success())
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        Self::run("umount", &[], &self.0);
    }
}

/// An extractor of random weights: it finds something, which is all that is asked of it here.
fn extractor() -> ExtractorFile {
    let kind = ExtractorKind::Xfeat;
    let mut rng = Rng::from_seed(5);
    let mut weights = Weights::new();
    for spec in kind.tensors() {
        let fan_in: usize = spec.shape.iter().skip(1).product();
        let bound = (6.0 / fan_in.max(1) as f64).sqrt().min(1.0);
        let len = spec.shape.iter().product::<usize>();
        let data = (0..len).map(|_| rng.range(-bound, bound) as f32).collect();
        let tensor = WeightTensor::f32(&spec.shape, data).expect("lengths agree");
        weights.insert(spec.name, tensor);
    }
    ExtractorFile {
        kind,
        source_sha256: "cd".repeat(32),
        source: "random".to_owned(),
        licence: "none".to_owned(),
        weights,
    }
}

fn extraction(cache: &Path) -> Extraction {
    let file = extractor();
    let options = FrontEndOptions::new(file.kind);
    Extraction::new(file, options, Some(cache))
}

fn pictures(folder: &Folder, num: usize) -> Vec<DatasetImage> {
    (0..num)
        .map(|i| {
            let name = format!("{i:02}.png");
            DatasetImage {
                path: folder.picture(&name, 160, 128 + i as u32),
                name,
                camera: Camera::centered(160, 128 + i as u32, 150.0),
                cam_from_world: Some(CamFromWorld::identity()),
                split: Split::Train,
            }
        })
        .collect()
}

fn cached(folder: &Path) -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .expect("exists")
        .map(|e| e.expect("readable").path())
        .collect();
    files.sort();
    files
}

#[test]
fn features_made_before_the_disk_was_full_stay_and_the_run_goes_on_from_there() {
    let folder = Folder::new();
    let images = pictures(&folder, 6);
    let borrowed: Vec<&DatasetImage> = images.iter().collect();
    let whole = folder.0.join("whole");
    let expected = extraction(&whole)
        .all(&borrowed, Progress::Hidden)
        .expect("a large disk");
    let size: u64 = cached(&whole)
        .iter()
        .map(|f| f.metadata().expect("exists").len())
        .sum();
    let Some(disk) = SmallDisk::mount(folder.0.join("small"), size / 2 / 1024) else {
        skip("no right to mount a small file system here");
        return;
    };
    let message = extraction(&disk.0)
        .all(&borrowed, Progress::Hidden)
        .expect_err("the disk is full")
        .to_string();
    assert!(
        message.contains("No space left") && message.contains(".features"),
        "{message}"
    );
    let kept = cached(&disk.0);
    assert!((1..6).contains(&kept.len()), "{kept:?}");
    for file in &kept {
        // Whole: one that is not would be made again, for which there is no room, or be called damaged.
        let position = images
            .iter()
            .position(|i| file.ends_with(format!("{}.features", i.name)))
            .unwrap_or_else(|| panic!("{} is of no picture", file.display()));
        let again = extraction(&disk.0)
            .features(&images[position])
            .expect("is in the cache");
        assert!(again == expected[position], "{}", file.display());
    }
    let written = |f: &PathBuf| f.metadata().and_then(|m| m.modified()).expect("exists");
    let before: Vec<_> = kept.iter().map(written).collect();
    disk.grow();
    let features = extraction(&disk.0)
        .all(&borrowed, Progress::Hidden)
        .expect("there is room now");
    assert_eq!(features.len(), expected.len());
    assert_eq!(before, kept.iter().map(written).collect::<Vec<_>>());
}

#[test]
fn another_picture_of_the_same_name_is_not_taken_from_the_cache() {
    let folder = Folder::new();
    let images = pictures(&folder, 1);
    let cache = folder.0.join("cache");
    let first = extraction(&cache).features(&images[0]).expect("reads");
    let again = extraction(&cache).features(&images[0]).expect("reads");
    assert_eq!(first.keypoints, again.keypoints);
    folder.picture("00.png", 128, 160);
    let other = extraction(&cache).features(&images[0]).expect("reads");
    assert_ne!(first.keypoints, other.keypoints);
    let given = [[10.0, 10.0, 90.0, 20.0]];
    let with_segments = extraction(&cache)
        .features_with_segments(&images[0], &given)
        .expect("reads");
    assert_eq!(with_segments.segments.len(), 1);
    let s = with_segments.segments[0];
    assert!((s.start.x - 10.0).abs() < 1e-9 && (s.end.y - 20.0).abs() < 1e-9);
    assert_eq!(with_segments.tokens, 12);

    let missing = DatasetImage {
        path: folder.0.join("gone.png"),
        ..images[0].clone()
    };
    let message = extraction(&cache)
        .features(&missing)
        .expect_err("missing")
        .to_string();
    assert!(message.contains("gone.png"), "{message}");
}

#[test]
fn an_export_that_does_not_fit_leaves_the_old_file() {
    let folder = Folder::new();
    let points = (0..2000).map(|i| Vector3::new(f64::from(i), 0.0, 1.0));
    let labels = Labels {
        origin: Origin {
            extractor_sha256: "ab".repeat(32),
            ..Origin::default()
        },
        map: Reconstruction {
            points: points.map(|p| PointTrack::new(p, Vec::new())).collect(),
            ..Reconstruction::default()
        },
        ..Labels::default()
    };
    let path = folder.0.join("labels.safetensors");
    labels.write(&path).expect("writable");
    let out = folder.text("map.ply", "old");
    // Files of this process may not grow beyond a few blocks; the signal that says so is ignored, the write fails.
    let run = Command::new("sh")
        .args(["-c", "trap '' XFSZ; ulimit -f 4; exec \"$@\"", "sh"])
        .arg(env!("CARGO_BIN_EXE_landline"))
        .arg("export")
        .arg(&path)
        .arg("--ply")
        .arg(&out)
        .output()
        .expect("there is a shell");
    let message = String::from_utf8_lossy(&run.stderr).into_owned();
    assert!(!run.status.success(), "{message}");
    assert!(
        message.contains("map.ply") && message.contains("too large"),
        "{message}"
    );
    assert_eq!(std::fs::read(&out).expect("exists"), b"old");
    assert_eq!(std::fs::read_dir(&folder.0).expect("exists").count(), 2);
}
