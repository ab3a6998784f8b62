//! Checkpoints and scene files from anywhere: typed errors, no panic, no memory beyond the file's own size.

use landline::models::{ExtractorKind, Preset, RegressorConfig};
use landline::nn::{WeightTensor, Weights};
use landline::scene_file::{ExtractorFile, Precision, SceneFile, SceneFileError, SceneInfo};
use landline_mapper::import::checkpoint::{Checkpoint, CheckpointError};
use landline_mapper::import::pickle::PickleError;
use landline_mapper::import::{ImportError, ImportOptions, import};
use landline_testkit::{peak_bytes, shared_data};
use proptest::prelude::*;

/// Small files may need this much for tables and messages.
const SLACK: usize = 1 << 20;

fn reads_within_bounds(bytes: &[u8]) {
    let (_, peak) = peak_bytes(|| Checkpoint::read(bytes).map(drop));
    assert!(
        peak < 64 * bytes.len() + SLACK,
        "checkpoint of {} bytes took {peak}",
        bytes.len()
    );
    let (_, peak) = peak_bytes(|| SceneFile::from_bytes(bytes).map(drop));
    assert!(
        peak < 64 * bytes.len() + SLACK,
        "scene of {} bytes took {peak}",
        bytes.len()
    );
    let (_, peak) = peak_bytes(|| ExtractorFile::from_bytes(bytes).map(drop));
    assert!(
        peak < 64 * bytes.len() + SLACK,
        "extractor of {} bytes took {peak}",
        bytes.len()
    );
}

fn small_scene() -> SceneFile {
    let mut config = RegressorConfig::preset(Preset::Compact, 64);
    if let RegressorConfig::Branches { point, line } = &mut config {
        *line = None;
        if let landline::models::PointBranchConfig::Anchored(c) = point {
            c.num_anchors = 5;
            c.reliability_hidden = 3;
        }
    }
    let weights: Weights = config
        .tensors()
        .into_iter()
        .map(|t| {
            let n = t.shape.iter().product();
            (
                t.name,
                WeightTensor::f32(&t.shape, vec![0.25; n]).expect("sizes agree"),
            )
        })
        .collect();
    SceneFile {
        info: SceneInfo::new(ExtractorKind::Xfeat, "0".repeat(64)),
        config,
        weights,
        landmarks: None,
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn noise_is_refused(bytes in prop::collection::vec(any::<u8>(), 0..400), magic in 0_usize..5) {
        let prefix: &[u8] = [
            b"".as_slice(),
            b"PK\x03\x04",
            b"\x80\x02",
            b"\x40\x00\x00\x00\x00\x00\x00\x00{",
            b"\x80\x02\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19.\x80\x02",
        ][magic];
        reads_within_bounds(&[prefix, &bytes].concat());
    }

    #[test]
    fn pickle_opcodes_in_any_order_are_survived(
        ops in prop::collection::vec(
            prop::sample::select(&b"}](()tuseabRQqhrjKMJNX.\x85\x86\x87\x88\x8a\x8c\x93\x94\x95c"[..]),
            0..200,
        ),
        arguments in prop::collection::vec(0_u8..8, 0..200),
    ) {
        let mixed: Vec<u8> = ops
            .iter()
            .zip(arguments.iter().chain(std::iter::repeat(&0)))
            .flat_map(|(o, a)| [*o, *a])
            .collect();
        reads_within_bounds(&[b"\x80\x02", ops.as_slice(), b"."].concat());
        reads_within_bounds(&[b"\x80\x02", mixed.as_slice(), b"."].concat());
    }

    #[test]
    fn scene_files_with_changed_bytes_are_read_or_refused(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        cut in any::<prop::sample::Index>(),
    ) {
        let mut bytes = small_scene().to_bytes(Precision::Int8).expect("writes");
        for (at, value) in changes {
            let i = at.index(bytes.len());
            bytes[i] = value;
        }
        reads_within_bounds(&bytes);
        bytes.truncate(cut.index(bytes.len()));
        let refused = SceneFile::from_bytes(&bytes).is_err();
        prop_assert!(refused);
    }

    #[test]
    fn headers_with_any_offsets_are_survived(
        shape in prop::collection::vec(any::<u64>(), 0..4),
        offsets in any::<[u64; 2]>(),
        small in any::<[u8; 2]>(),
        dtype in prop::sample::select(vec!["F32", "F16", "I8", "F64", "BOOL", "F4", "X"]),
    ) {
        for offsets in [offsets, small.map(u64::from)] {
            let header = format!(
                "{{\"__metadata__\":{{\"landline\":\"scene\",\"format\":\"1\"}},\"a\":{{\"dtype\":\"{dtype}\",\"shape\":{shape:?},\"data_offsets\":{offsets:?}}}}}"
            );
            let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
            bytes.extend(header.as_bytes());
            bytes.extend([0; 64]);
            reads_within_bounds(&bytes);
        }
    }
}

#[test]
fn changed_checkpoints_are_read_or_refused() {
    let Some(dir) = shared_data("data/golden/regressor") else {
        return;
    };
    let good = std::fs::read(dir.join("v1.pth.tar")).expect("the checkpoint is readable");
    // The pickle and the directory are what a change can mislead; the numbers between them are only numbers.
    let pickle = good
        .windows(2)
        .position(|w| w == b"\x80\x02")
        .expect("a pickle");
    let places = (0..64)
        .chain(pickle..pickle + 14_100)
        .chain(good.len() - 7000..good.len());
    let mut bytes = good.clone();
    let mut refused = 0;
    for i in places.step_by(13) {
        let before = bytes[i];
        bytes[i] ^= 1 << (i % 8);
        let (result, peak) = peak_bytes(|| import(&bytes, &ImportOptions::default()));
        assert!(peak < 8 * bytes.len() + SLACK, "byte {i}: {peak}");
        refused += usize::from(result.is_err());
        bytes[i] = before;
    }
    assert!(refused > 100, "most changes matter: {refused}");
    for n in [0, 3, 10, 1000, good.len() / 2, good.len() - 1] {
        assert!(matches!(
            import(&good[..n], &ImportOptions::default()),
            Err(ImportError::Checkpoint(_))
        ));
    }
}

#[test]
fn a_pickle_that_would_run_a_command_is_refused_by_name() {
    let bytes = b"\x80\x02\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19.\x80\x02M\xe9\x03.\x80\x02}.\x80\x02cposix\nsystem\nX\x04\x00\x00\x00true\x85R.";
    match Checkpoint::read(bytes) {
        Err(CheckpointError::Pickle(PickleError::Name { module, name, .. })) => {
            assert_eq!((module.as_str(), name.as_str()), ("posix", "system"));
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_memo_that_multiplies_is_held_in_bounds() {
    // Each round makes a tuple of the tuple before it, twice: 2^64 leaves in the tree, a handful of values in the arena.
    let mut bytes = b"\x80\x02)q\x00".to_vec();
    for _ in 0..64 {
        bytes.extend(b"h\x00h\x00\x86q\x00");
    }
    bytes.push(b'.');
    reads_within_bounds(&bytes);
}

#[test]
fn memo_slots_with_gaps_are_held_in_bounds() {
    // Each instruction of five bytes names a slot 1,024 beyond the last one.
    let mut bytes = b"\x80\x02N".to_vec();
    for i in 1..20_000_u32 {
        bytes.push(b'r');
        bytes.extend((1024 * i).to_le_bytes());
    }
    bytes.push(b'.');
    reads_within_bounds(&bytes);
}

#[test]
fn a_view_that_repeats_a_storage_is_refused() {
    // One element seen as 10^9 by a stride of zero, in the older stream format.
    let pickle = |numel: &[u8], shape: &[u8]| {
        [
            b"\x80\x02}X\x01\x00\x00\x00actorch._utils\n_rebuild_tensor_v2\n((X\x07\x00\x00\x00storagectorch\nFloatStorage\nX\x01\x00\x00\x000X\x03\x00\x00\x00cpu".as_slice(),
            numel,
            b"NtQK\x00",
            shape,
            b"\x85K\x00\x85\x89ccollections\nOrderedDict\n)RtRs.",
        ]
        .concat()
    };
    let stream = |body: Vec<u8>| {
        [
            b"\x80\x02\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19.\x80\x02M\xe9\x03.\x80\x02}.".as_slice(),
            &body,
            b"\x80\x02]X\x01\x00\x00\x000a.",
            &1_u64.to_le_bytes(),
            &1.5_f32.to_le_bytes(),
        ]
        .concat()
    };
    let good = stream(pickle(b"K\x01", b"K\x01"));
    let tensors = Checkpoint::read(&good)
        .expect("a tensor of one number")
        .tensors;
    assert_eq!(tensors["a"].data, [1.5]);
    let bad = stream(pickle(b"K\x01", b"J\x00\xca\x9a\x3b"));
    let (result, peak) = peak_bytes(|| Checkpoint::read(&bad));
    assert!(
        matches!(result, Err(CheckpointError::Repeats)),
        "{result:?}"
    );
    assert!(peak < SLACK, "{peak}");
    let outside = stream(pickle(b"K\x01", b"K\x02"));
    assert!(
        Checkpoint::read(&outside).is_ok(),
        "a stride of zero may repeat a little"
    );
    let wrong_size = stream(pickle(b"K\x05", b"K\x01"));
    assert!(matches!(
        Checkpoint::read(&wrong_size),
        Err(CheckpointError::StorageSize { .. })
    ));
}

#[test]
fn scene_files_of_the_future_and_of_others_are_refused() {
    let scene = small_scene();
    let bytes = scene.to_bytes(Precision::F16).expect("writes");
    let swap = |from: &str, to: &str| {
        let text = String::from_utf8_lossy(&bytes[8..]).into_owned();
        let at = text.find(from).expect("present");
        let mut changed = bytes.clone();
        changed[8 + at..8 + at + to.len()].copy_from_slice(to.as_bytes());
        SceneFile::from_bytes(&changed).map(drop)
    };
    let future = swap("\"format\":\"1\"", "\"format\":\"9\"");
    assert!(
        matches!(future, Err(SceneFileError::Version { .. })),
        "{future:?}"
    );
    let mistyped = swap("\"F16\"", "\"U16\"");
    assert!(
        matches!(mistyped, Err(SceneFileError::Element { .. })),
        "{mistyped:?}"
    );
    let other = ExtractorFile {
        kind: ExtractorKind::SuperPointV1,
        source_sha256: "1".repeat(64),
        source: String::new(),
        licence: String::new(),
        weights: Weights::new(),
    };
    let message = scene
        .check_extractor(&other)
        .expect_err("another extractor")
        .to_string();
    assert!(
        message.contains("superpoint-v1") && message.contains("xfeat"),
        "{message}"
    );
}
