//! Checkpoints as PyTorch writes them, in both of its formats, and what is made of damaged ones.

use landline::models::ExtractorKind;
use landline_mapper::import::checkpoint::{Checkpoint, ForeignTensor};
use landline_mapper::import::zip::{ZipError, entries};
use landline_mapper::import::{ImportError, ImportOptions, Imported, import};
use landline_testkit::{peak_bytes, shared_data};
use proptest::prelude::*;
use std::collections::BTreeMap;

/// Tensors by their foreign names.
type Tensors = BTreeMap<String, ForeignTensor>;

/// An archive of plainly stored entries.
fn stored(entries: &[(&str, &[u8])]) -> Vec<u8> {
    let mut out = Vec::new();
    let mut directory = Vec::new();
    for (name, data) in entries {
        let offset = out.len() as u32;
        let sizes = [(data.len() as u32).to_le_bytes(); 2].concat();
        let names = (name.len() as u16).to_le_bytes();
        let head = [
            b"PK\x03\x04".as_slice(),
            &[20, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
            &sizes,
            &names,
            &[0, 0],
            name.as_bytes(),
        ]
        .concat();
        out.extend(head);
        out.extend(*data);
        directory.extend(
            [
                b"PK\x01\x02".as_slice(),
                &[20, 0, 20, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
                &sizes,
                &names,
                &[0; 12],
                &offset.to_le_bytes(),
                name.as_bytes(),
            ]
            .concat(),
        );
    }
    let start = out.len() as u32;
    let count = (entries.len() as u16).to_le_bytes();
    out.extend(&directory);
    out.extend(
        [
            b"PK\x05\x06".as_slice(),
            &[0; 4],
            &count,
            &count,
            &(directory.len() as u32).to_le_bytes(),
            &start.to_le_bytes(),
            &[0, 0],
        ]
        .concat(),
    );
    out
}

fn text(out: &mut Vec<u8>, text: &str) {
    out.push(b'X');
    out.extend((text.len() as u32).to_le_bytes());
    out.extend(text.as_bytes());
}

fn sizes(out: &mut Vec<u8>, sizes: &[usize]) {
    out.push(b'(');
    for size in sizes {
        out.push(b'J');
        out.extend((*size as u32).to_le_bytes());
    }
    out.push(b't');
}

/// The pickle of a state dict whose tensor number `i` lies in the storage called `i`.
fn state_dict(tensors: &Tensors) -> Vec<u8> {
    let empty = b"ccollections\nOrderedDict\n)R";
    let mut out = b"\x80\x02".to_vec();
    out.extend(empty);
    out.push(b'(');
    for (key, (name, tensor)) in tensors.iter().enumerate() {
        text(&mut out, name);
        out.extend(b"ctorch._utils\n_rebuild_tensor_v2\n((");
        text(&mut out, "storage");
        out.extend(b"ctorch\nFloatStorage\n");
        text(&mut out, &key.to_string());
        text(&mut out, "cpu");
        out.push(b'J');
        out.extend((tensor.data.len() as u32).to_le_bytes());
        out.extend(b"tQK\x00");
        sizes(&mut out, &tensor.shape);
        let strides: Vec<usize> = (1..=tensor.shape.len())
            .map(|axis| tensor.shape[axis..].iter().product())
            .collect();
        sizes(&mut out, &strides);
        out.push(0x89);
        out.extend(empty);
        out.extend(b"tR");
    }
    out.extend(b"u.");
    out
}

fn storage(tensor: &ForeignTensor) -> Vec<u8> {
    tensor.data.iter().flat_map(|x| x.to_le_bytes()).collect()
}

/// As `torch.save` writes them since 1.6.
fn archive(tensors: &Tensors) -> Vec<u8> {
    let mut files = vec![("archive/data.pkl".to_owned(), state_dict(tensors))];
    for (key, tensor) in tensors.values().enumerate() {
        files.push((format!("archive/data/{key}"), storage(tensor)));
    }
    let files: Vec<(&str, &[u8])> = files.iter().map(|(n, d)| (n.as_str(), &d[..])).collect();
    stored(&files)
}

/// As `torch.save` wrote them before.
fn stream(tensors: &Tensors) -> Vec<u8> {
    let mut out =
        b"\x80\x02\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19.\x80\x02M\xe9\x03.\x80\x02}."
            .to_vec();
    out.extend(state_dict(tensors));
    out.extend(b"\x80\x02](");
    for key in 0..tensors.len() {
        text(&mut out, &key.to_string());
    }
    out.extend(b"e.");
    for tensor in tensors.values() {
        out.extend((tensor.data.len() as u64).to_le_bytes());
        out.extend(storage(tensor));
    }
    out
}

/// SuperPoint's first release: its weights may not be passed on, so its names and sizes with other numbers.
fn superpoint_v1() -> Tensors {
    let ours_of = [
        ("conv1a", "encoder.0"),
        ("conv1b", "encoder.1"),
        ("conv2a", "encoder.2"),
        ("conv2b", "encoder.3"),
        ("conv3a", "encoder.4"),
        ("conv3b", "encoder.5"),
        ("conv4a", "encoder.6"),
        ("conv4b", "encoder.7"),
        ("convPa", "detector.0"),
        ("convPb", "detector.1"),
        ("convDa", "descriptor.0"),
        ("convDb", "descriptor.1"),
    ];
    let specs = ExtractorKind::SuperPointV1.tensors();
    let mut out = Tensors::new();
    for (number, (theirs, ours)) in ours_of.iter().enumerate() {
        for (part, long) in [("w", "weight"), ("b", "bias")] {
            let name = format!("{ours}.{part}");
            let spec = specs
                .iter()
                .find(|s| s.name == name)
                .expect("a known layer");
            let mut shape = spec.shape.clone();
            if part == "w" {
                shape.resize(4, 1);
            }
            let data = vec![number as f32; shape.iter().product()];
            out.insert(format!("{theirs}.{long}"), ForeignTensor { shape, data });
        }
    }
    out
}

/// Every network that is known, as far as its checkpoint is at hand.
fn networks() -> Vec<(&'static str, Tensors)> {
    let mut out = vec![("superpoint-v1", superpoint_v1())];
    let mut read = |name, path: Option<std::path::PathBuf>| match path {
        Some(path) => {
            let bytes = std::fs::read(&path).expect("the checkpoint is readable");
            out.push((name, Checkpoint::read(&bytes).expect("reads").tensors));
        }
        None => println!("without {name}: no checkpoint at hand"),
    };
    let variable = |name| std::env::var_os(name).map(Into::into);
    read("xfeat", variable("LANDLINE_XFEAT_CHECKPOINT"));
    read(
        "superpoint-open",
        variable("LANDLINE_SUPERPOINT_OPEN_CHECKPOINT"),
    );
    if let Some(dir) = shared_data("data/golden/regressor") {
        read("proposed", Some(dir.join("proposed.pth.tar")));
        read("v1", Some(dir.join("v1.pth.tar")));
    }
    out
}

fn imported(tensors: &Tensors) -> Result<Imported, ImportError> {
    import(&archive(tensors), &ImportOptions::default())
}

#[test]
fn both_formats_give_the_same_tensors() {
    for (name, tensors) in networks() {
        for bytes in [archive(&tensors), stream(&tensors)] {
            let read = Checkpoint::read(&bytes).expect("reads").tensors;
            assert!(read == tensors, "{name}: other tensors came back");
            let made = import(&bytes, &ImportOptions::default()).expect("converts");
            let found = match made {
                Imported::Extractor(file) => file.kind.name(),
                Imported::Regressor { config, .. } => config.variant().name(),
            };
            assert_eq!(found, name);
        }
    }
}

#[test]
fn the_first_superpoint_release_is_a_renaming() {
    let Imported::Extractor(file) = imported(&superpoint_v1()).expect("converts") else {
        panic!("not an extractor")
    };
    assert_eq!(file.kind, ExtractorKind::SuperPointV1);
    file.kind.check_weights(&file.weights).expect("complete");
    for (layer, number) in [
        ("encoder.0.w", 0.0),
        ("detector.1.b", 9.0),
        ("descriptor.1.w", 11.0),
    ] {
        let w = file.weights.get(layer).expect("present");
        assert!(w.to_f32().iter().all(|x| *x == number), "{layer}");
    }
}

/// Whatever is wrong with one tensor is said, with its name where it is there.
#[test]
fn missing_misshapen_and_infinite_tensors_are_refused() {
    for (network, good) in networks() {
        let used: Vec<String> = good
            .keys()
            .filter(|name| !name.starts_with("fine_matcher."))
            .cloned()
            .collect();
        // The large networks have their tensors in groups of the same treatment.
        for name in used.iter().step_by(used.len().div_ceil(25)) {
            let mut bad = good.clone();
            let tensor = bad.remove(name).expect("present");
            let error = imported(&bad).map(drop).expect_err("a tensor is missing");
            assert!(
                matches!(
                    error,
                    ImportError::Missing { .. }
                        | ImportError::UnknownNetwork { .. }
                        | ImportError::LeftOver { .. }
                        | ImportError::Shape { .. }
                ),
                "{network} without {name}: {error:?}"
            );

            let mut not_finite = tensor.clone();
            if let Some(last) = not_finite.data.last_mut() {
                *last = f32::NAN;
            }
            bad.insert(name.clone(), not_finite);
            let error = imported(&bad).map(drop).expect_err("a number is NaN");
            assert!(
                matches!(&error, ImportError::NotFinite { name: found, .. } if found == name),
                "{network} with NaN in {name}: {error:?}"
            );

            let mut longer = tensor.clone();
            longer.shape[0] += 1;
            let row = longer.data.len() / tensor.shape[0];
            longer.data.extend(vec![0.5; row]);
            bad.insert(name.clone(), longer);
            let error = imported(&bad).map(drop).expect_err("a row too many");
            assert!(
                matches!(
                    error,
                    ImportError::Shape { .. } | ImportError::Heads { .. } | ImportError::Model(_)
                ),
                "{network} with a row too many in {name}: {error:?}"
            );
        }
        let mut stray = good.clone();
        let tensor = ForeignTensor {
            shape: vec![1],
            data: vec![0.0],
        };
        stray.insert("optimizer.lr".to_owned(), tensor);
        assert!(matches!(
            imported(&stray),
            Err(ImportError::LeftOver { name, count: 1, .. }) if name == "optimizer.lr"
        ));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn changed_and_cut_checkpoints_are_read_or_refused(
        old in any::<bool>(),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
        cut in any::<prop::sample::Index>(),
        padding in prop::collection::vec(any::<u8>(), 0..40),
    ) {
        let tensor = |shape: &[usize]| ForeignTensor {
            shape: shape.to_vec(),
            data: vec![0.5; shape.iter().product()],
        };
        let tensors = Tensors::from([
            ("conv1a.weight".to_owned(), tensor(&[3, 1, 2, 2])),
            ("convPa.weight".to_owned(), tensor(&[2])),
        ]);
        let good = if old { stream(&tensors) } else { archive(&tensors) };
        let mut bytes = good.clone();
        for (at, value) in changes {
            let i = at.index(bytes.len());
            bytes[i] = value;
        }
        let padded = [&bytes[..], &padding].concat();
        let cut = &good[..cut.index(good.len())];
        for bytes in [&bytes[..], &padded, cut] {
            let (_, peak) = peak_bytes(|| import(bytes, &ImportOptions::default()).map(drop));
            prop_assert!(peak < 64 * bytes.len() + (1 << 20), "{} bytes took {peak}", bytes.len());
        }
        let refused = Checkpoint::read(cut).is_err();
        prop_assert!(refused, "{} of {} bytes were read", cut.len(), good.len());
    }
}

#[test]
fn the_archive_of_a_checkpoint_has_its_entries() {
    let bytes = stored(&[("a/data.pkl", b"hello"), ("a/data/0", b"\x01\x02")]);
    let found = entries(&bytes).expect("valid");
    assert_eq!(&bytes[found["a/data.pkl"].clone()], b"hello");
    assert_eq!(&bytes[found["a/data/0"].clone()], b"\x01\x02");
    for n in 0..bytes.len() {
        assert!(entries(&bytes[..n]).is_err(), "{n}");
    }
    for i in 0..bytes.len() {
        let mut bad = bytes.clone();
        bad[i] ^= 0xff;
        if let Ok(found) = entries(&bad) {
            assert!(found.values().all(|r| r.end <= bad.len()), "{i}");
        }
    }
}

#[test]
fn archives_with_duplicates_or_compression_are_refused() {
    let twice = stored(&[("a", b"x"), ("a", b"y")]);
    assert!(matches!(entries(&twice), Err(ZipError::Duplicate { .. })));
    let mut deflated = stored(&[("a", b"x")]);
    let at = deflated
        .windows(4)
        .position(|w| w == b"PK\x01\x02")
        .expect("directory");
    deflated[at + 10] = 8;
    assert!(matches!(
        entries(&deflated),
        Err(ZipError::NotStored { method: 8, .. })
    ));
}
