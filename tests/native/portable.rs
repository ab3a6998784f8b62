//! Writes down the digest that `tests/wasm_node` has to reach.

use landline_testkit::portable::digest;
use std::fs;
use std::path::Path;

#[test]
fn the_same_run_gives_the_same_bits_twice() {
    let first = digest();
    assert_eq!(first, digest(), "something depends on more than its input");
    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join("portable-digest.txt");
    fs::write(&file, &first)
        .unwrap_or_else(|error| panic!("cannot write {}: {error}", file.display()));
    println!("{first}");
}
