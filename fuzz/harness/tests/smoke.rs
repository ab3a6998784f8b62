//! Every target for a moment: its seeds, and changes of them. No panic, no memory beyond measure, no accepted nonsense.

use landline::math::Rng;
use landline_fuzz::{TARGETS, explore, target};

#[global_allocator]
static ALLOCATOR: landline_testkit::CountingAllocator = landline_testkit::CountingAllocator;

/// Changed inputs of each target.
const CASES: u64 = 300;

#[test]
fn parsers_survive_changed_inputs() {
    for target in TARGETS {
        let tried = explore(*target, CASES, &mut Rng::from_seed(21));
        let tried = tried.unwrap_or_else(|f| panic!("{} at {}", f.what, f.input.escape_ascii()));
        println!("{:<16} {tried:?}", target.name);
        assert!(tried.num_inputs > CASES && tried.most_bytes > 0);
    }
}

/// A seed that is refused tests nothing but the refusal.
#[test]
fn seeds_are_accepted() {
    for target in TARGETS {
        let seeds = (target.seeds)();
        let num_accepted = seeds.iter().filter(|seed| (target.run)(seed)).count();
        // Whole extractors take megabytes; of the checkpoints one is safetensors, the others ways into the readers.
        let expected = match target.name {
            "extractor" => 0,
            "checkpoint" => 1,
            _ => seeds.len(),
        };
        assert_eq!(num_accepted, expected, "{}", target.name);
    }
}

/// What was found once: focal lengths of 5e-10 and 3e-322 px, of which scaling to the picture's size made zero.
#[test]
fn focal_lengths_of_no_camera_are_refused() {
    let mut cameras = 1u64.to_le_bytes().to_vec();
    cameras.extend(1u32.to_le_bytes());
    cameras.extend(1i32.to_le_bytes());
    cameras.extend(8256u64.to_le_bytes());
    cameras.extend(6144u64.to_le_bytes());
    for v in [4.66e-10_f64, 3.16e-322, 16.0, 12.0] {
        cameras.extend(v.to_le_bytes());
    }
    assert!(!(target("colmap_cameras").run)(&cameras));
}

/// A parser that panics is a find, with the input that did it.
#[test]
fn a_find_has_its_input() {
    let mut target = TARGETS[0];
    target.run = |bytes| {
        assert!(!bytes.starts_with(b"NaN"), "found");
        true
    };
    let find = explore(target, 100_000, &mut Rng::from_seed(1)).expect_err("some begin so");
    assert!(find.input.starts_with(b"NaN"));
    assert!(find.what.contains(target.name) && find.what.contains("panicked"));
}

/// libFuzzer's programs are those of the table.
#[test]
fn every_target_has_its_program() {
    let manifest = include_str!("../../Cargo.toml");
    for target in TARGETS {
        assert!(
            manifest.contains(&format!("name = \"{}\"", target.name)),
            "{}",
            target.name
        );
        let program = format!(
            "{}/../targets/{}.rs",
            env!("CARGO_MANIFEST_DIR"),
            target.name
        );
        let text = std::fs::read_to_string(&program).expect("is there");
        assert!(text.contains(&format!("\"{}\"", target.name)), "{program}");
    }
}
