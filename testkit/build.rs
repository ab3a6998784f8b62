//! Makes the reference pictures of the line segment detector part of the test binaries, because tests in a browser
//! cannot read files. Where the folder of reference data is missing, the list is empty.

use std::path::{Path, PathBuf};
use std::{env, fs};

fn main() {
    println!("cargo::rerun-if-env-changed=LANDLINE_SHARED");
    let shared = match env::var_os("LANDLINE_SHARED") {
        Some(dir) => PathBuf::from(dir),
        None => Path::new(&env::var_os("CARGO_MANIFEST_DIR").expect("set by cargo"))
            .join("../../shared"),
    };
    let dir = shared.join("data/golden/lsd");
    println!("cargo::rerun-if-changed={}", dir.display());
    let mut pictures: Vec<PathBuf> = fs::read_dir(&dir)
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.extension().is_some_and(|e| e == "png"))
        .collect();
    pictures.sort();
    let rows: String = pictures
        .iter()
        .map(|path| {
            let name = path.file_stem().unwrap_or_default().to_string_lossy();
            format!("    ({name:?}, include_bytes!({path:?})),\n")
        })
        .collect();
    let text = format!("&[\n{rows}]\n");
    let out = Path::new(&env::var_os("OUT_DIR").expect("set by cargo")).join("lsd_pictures.rs");
    fs::write(out, text).expect("the output folder is writable");
}
