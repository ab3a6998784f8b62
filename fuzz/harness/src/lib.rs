//! What fuzzing runs: a function for each parser of outside bytes, that panics where the parser does or where it accepts
//! nonsense; small seeds for each; and changes that keep a file's structure.
//!
//! `fuzz/Cargo.toml` has a program of libFuzzer for each target (`cargo +nightly fuzz run scene`); `tests/smoke.rs` runs all of
//! them for seconds on a stable compiler.

mod explore;
mod mutate;
mod seeds;

pub use explore::{Find, Tried, explore};
pub use mutate::mutated;

use landline::formats::{TextFile, colmap as model, list};
use landline::scene_file::{ExtractorFile, SceneFile};
use landline_mapper::dataset::{DataArgs, Dataset, open, parse_camera};
use landline_mapper::import::checkpoint::Checkpoint;
use landline_mapper::import::pickle::Arena;
use landline_mapper::labels::Labels;
use landline_mapper::picture;
use std::fs;
use std::path::{Path, PathBuf};

/// One parser.
#[derive(Clone, Copy)]
pub struct Target {
    /// Its name, and that of libFuzzer's program.
    pub name: &'static str,
    /// Panics where something is wrong; returns whether the bytes were accepted.
    pub run: fn(&[u8]) -> bool,
    /// Small inputs that are accepted.
    pub seeds: fn() -> Vec<Vec<u8>>,
}

/// All parsers of outside bytes.
pub const TARGETS: &[Target] = &[
    Target {
        name: "ace_pose",
        run: ace_pose,
        seeds: seeds::matrix,
    },
    Target {
        name: "checkpoint",
        run: checkpoint,
        seeds: seeds::checkpoint,
    },
    Target {
        name: "colmap_cameras",
        run: colmap_cameras,
        seeds: seeds::colmap_cameras,
    },
    Target {
        name: "colmap_images",
        run: colmap_images,
        seeds: seeds::colmap_images,
    },
    Target {
        name: "colmap_points",
        run: colmap_points,
        seeds: seeds::colmap_points,
    },
    Target {
        name: "extractor",
        run: extractor,
        seeds: seeds::extractor,
    },
    Target {
        name: "labels",
        run: labels,
        seeds: seeds::labels,
    },
    Target {
        name: "pickle",
        run: pickle,
        seeds: seeds::pickle,
    },
    Target {
        name: "picture",
        run: picture,
        seeds: seeds::picture,
    },
    Target {
        name: "pose_list",
        run: pose_list,
        seeds: seeds::pose_list,
    },
    Target {
        name: "scene",
        run: scene,
        seeds: seeds::scene,
    },
    Target {
        name: "transforms",
        run: transforms,
        seeds: seeds::transforms,
    },
    Target {
        name: "tum",
        run: tum,
        seeds: seeds::tum,
    },
];

/// The target of a name.
///
/// # Panics
/// When there is none.
#[must_use]
pub fn target(name: &str) -> Target {
    let found = TARGETS.iter().find(|t| t.name == name);
    *found.unwrap_or_else(|| panic!("no target is called {name}"))
}

fn scene(bytes: &[u8]) -> bool {
    let Ok(scene) = SceneFile::from_bytes(bytes) else {
        return false;
    };
    let scale = scene.info.scale;
    assert!(scale.scale.is_finite() && scale.scale > 0.0, "{scale:?}");
    assert!(scale.centre.iter().all(|v| v.is_finite()), "{scale:?}");
    if let Some(camera) = scene.info.camera {
        camera.validate().expect("a camera that was accepted");
    }
    true
}

fn extractor(bytes: &[u8]) -> bool {
    ExtractorFile::from_bytes(bytes).is_ok()
}

fn checkpoint(bytes: &[u8]) -> bool {
    Checkpoint::read(bytes).is_ok()
}

fn pickle(bytes: &[u8]) -> bool {
    Arena::default().read(bytes).is_ok()
}

fn labels(bytes: &[u8]) -> bool {
    let Ok(labels) = Labels::from_bytes(bytes, Path::new("labels")) else {
        return false;
    };
    for view in &labels.map.views {
        let pixels = view.features.keypoints.iter().map(|k| k.pixel);
        assert!(pixels.into_iter().all(|p| (p.x + p.y).is_finite()));
    }
    let tracks = labels.map.points.iter().flat_map(|t| &t.observations);
    for seen in tracks {
        let view = &labels.map.views[seen.view as usize];
        assert!((seen.feature as usize) < view.features.keypoints.len());
    }
    true
}

fn picture(bytes: &[u8]) -> bool {
    // What a decoder may take is its own library's matter; sizes are checked before.
    thread_local!(static FOLDER: Folder = Folder::new());
    FOLDER.with(|f| picture::size(&f.with("a.png", bytes)).is_ok())
}

/// The way through a folder takes twenty times as long as the format's own reader: what that refuses is not taken there.
fn pose_list(bytes: &[u8]) -> bool {
    let file = TextFile::from_bytes("poses.txt", bytes.to_vec());
    let Some((file, kind)) = file
        .ok()
        .and_then(|f| list::sniff(&f).map(|kind| (f, kind)))
    else {
        return false;
    };
    let entry = |line| list::entry(&line, kind, kind.usual_direction(), <_>::default());
    if file.lines().map(entry).any(|e| e.is_err()) {
        return false;
    }
    thread_local!(static FOLDER: Folder = Folder::of(&[("a.png", &seeds::picture()[0])]));
    FOLDER.with(|f| reads(&f.with("poses.txt", bytes), Some(seeds::CAMERA)))
}

fn transforms(bytes: &[u8]) -> bool {
    thread_local!(static FOLDER: Folder = Folder::of(&[("a.png", &seeds::picture()[0])]));
    FOLDER.with(|f| reads(&f.with("transforms.json", bytes), None))
}

fn tum(bytes: &[u8]) -> bool {
    thread_local!(static FOLDER: Folder = Folder::of(&[
        ("rgb/1.0.png", &seeds::picture()[0]),
        ("rgb.txt", b"1.0 rgb/1.0.png\n"),
    ]));
    FOLDER.with(|f| {
        f.with("groundtruth.txt", bytes);
        reads(&f.0, Some(seeds::CAMERA))
    })
}

fn ace_pose(bytes: &[u8]) -> bool {
    thread_local!(static FOLDER: Folder = Folder::of(&[
        ("train/rgb/a.png", &seeds::picture()[0]),
        ("train/calibration/a.txt", b"10"),
    ]));
    FOLDER.with(|f| {
        f.with("train/poses/a.txt", bytes);
        reads(&f.0, None)
    })
}

/// The files of a model of one picture, of which each target changes one. As with lists, what the format refuses does not come here.
fn model_without(changed: &str) -> Folder {
    let files = [
        ("cameras.bin", seeds::colmap_cameras()),
        ("images.bin", seeds::colmap_images()),
        ("points3D.bin", seeds::colmap_points()),
    ];
    let folder = Folder::of(&[("a.png", &seeds::picture()[0])]);
    for (name, seeds) in files {
        if name != changed {
            folder.with(name, &seeds[0]);
        }
    }
    folder
}

fn colmap_cameras(bytes: &[u8]) -> bool {
    const FILE: &str = "cameras.bin";
    thread_local!(static FOLDER: Folder = model_without(FILE));
    model::cameras_of_bytes(FILE, bytes).is_ok() && FOLDER.with(|f| f.reads_with(FILE, bytes))
}

fn colmap_images(bytes: &[u8]) -> bool {
    const FILE: &str = "images.bin";
    thread_local!(static FOLDER: Folder = model_without(FILE));
    model::images_of_bytes(FILE, bytes).is_ok() && FOLDER.with(|f| f.reads_with(FILE, bytes))
}

fn colmap_points(bytes: &[u8]) -> bool {
    const FILE: &str = "points3D.bin";
    thread_local!(static FOLDER: Folder = model_without(FILE));
    model::points_of_bytes(FILE, bytes).is_ok() && FOLDER.with(|f| f.reads_with(FILE, bytes))
}

/// Reads a data set, with a camera told or none; what is accepted has to make sense.
fn reads(data: &Path, camera: Option<&str>) -> bool {
    let args = DataArgs {
        camera: camera.map(|text| parse_camera(text).expect("a right camera")),
        ..DataArgs::of(data.to_owned())
    };
    open(&args).is_ok_and(|dataset| {
        check(&dataset);
        true
    })
}

fn check(dataset: &Dataset) {
    for image in &dataset.images {
        image.camera.validate().expect("a camera that was accepted");
        let Some(pose) = image.cam_from_world else {
            continue;
        };
        assert!(
            pose.rotation
                .iter()
                .chain(&pose.translation)
                .all(|v| v.is_finite()),
            "{}: {pose:?}",
            image.name
        );
        let determinant = pose.rotation.determinant();
        assert!(
            (determinant - 1.0).abs() < 1e-3,
            "{}: {determinant}",
            image.name
        );
    }
    for point in &dataset.points {
        assert!(point.point_in_world.iter().all(|v| v.is_finite()));
        let mut seen = point.observations.iter().map(|(_, pixel)| pixel);
        assert!(seen.all(|p| (p.x + p.y).is_finite()));
    }
}

/// A temporary folder. A target keeps one for each thread and writes only the file anew that it is about.
struct Folder(PathBuf);

impl Folder {
    fn new() -> Self {
        use std::sync::atomic::{AtomicUsize, Ordering};
        static COUNT: AtomicUsize = AtomicUsize::new(0);
        let count = COUNT.fetch_add(1, Ordering::Relaxed);
        let name = format!("landline-fuzz-{}-{count}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        fs::create_dir_all(&folder).expect("a writable folder");
        Self(folder)
    }

    /// With these files.
    fn of(files: &[(&str, &[u8])]) -> Self {
        let folder = Self::new();
        for (name, bytes) in files {
            folder.with(name, bytes);
        }
        folder
    }

    /// Whether the folder is a data set with this file.
    fn reads_with(&self, name: &str, bytes: &[u8]) -> bool {
        self.with(name, bytes);
        reads(&self.0, None)
    }

    /// Writes a file; returns its path.
    fn with(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.0.join(name);
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent).expect("a writable folder");
        }
        fs::write(&path, bytes).expect("a writable folder");
        path
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // A left-over folder of a temporary place harms nobody.
        drop(fs::remove_dir_all(&self.0));
    }
}
