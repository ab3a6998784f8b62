//! Where reference data lies, and how a test says that it did not run.
//!
//! Reference pictures and numbers stay outside the repository, in a folder `shared` beside the checkout
//! (`LANDLINE_SHARED` names another one). A test that needs them asks [`shared_data`]; a test that cannot run for
//! another reason calls [`skip`]. Both print the reason, and `cargo xtask test` counts the test as skipped.

use std::fs::OpenOptions;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Path of `rel` (such as `"data/golden"`) in the folder of reference data, if it is there.
///
/// Where it is missing, the calling test is recorded as skipped with the reason and `None` comes back:
///
/// ```no_run
/// # fn body() {
/// let Some(dir) = landline_testkit::shared_data("data/golden/lsd") else { return };
/// # }
/// ```
#[must_use]
pub fn shared_data(rel: &str) -> Option<PathBuf> {
    let path = shared_root().join(rel);
    if path.exists() {
        return Some(path);
    }
    skip(&format!("reference data not here: ../shared/{rel}"));
    None
}

fn shared_root() -> PathBuf {
    match std::env::var_os("LANDLINE_SHARED") {
        Some(dir) => PathBuf::from(dir),
        None => Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared"),
    }
}

/// Records the running test as skipped: prints the reason and tells the test command, which counts it.
/// The test then returns without asserting anything.
///
/// # Panics
///
/// When `LANDLINE_SKIP_LOG` names a file that cannot be written: a skip that is not counted would read as a pass.
pub fn skip(reason: &str) {
    let name = test_name();
    println!("skipped {name}: {reason}");
    if let Some(log) = std::env::var_os("LANDLINE_SKIP_LOG") {
        let line = format!("{name}\t{reason}\n");
        let written = OpenOptions::new()
            .append(true)
            .create(true)
            .open(&log)
            .and_then(|mut file| file.write_all(line.as_bytes()));
        assert!(
            written.is_ok(),
            "skip log {} is not writable: {written:?}",
            Path::new(&log).display()
        );
    }
}

/// The device that `request` gives; where it gives none, the calling test is recorded as skipped with the reason and `None`
/// comes back:
///
/// ```no_run
/// # use landline_testkit::gpu_or_skip;
/// # async fn request() -> Result<u32, String> { Ok(1) }
/// # fn body() {
/// let Some(gpu) = gpu_or_skip(request()) else { return };
/// # }
/// ```
///
/// # Panics
///
/// Under `cargo xtask test --require-gpu`: on a machine that should have an adapter, its absence is a failure.
#[cfg(not(target_arch = "wasm32"))]
pub fn gpu_or_skip<D, E: std::fmt::Display>(
    request: impl Future<Output = Result<D, E>>,
) -> Option<D> {
    match pollster::block_on(request) {
        Ok(device) => Some(device),
        Err(why) => {
            assert!(
                std::env::var_os("LANDLINE_REQUIRE_GPU").is_none(),
                "no GPU adapter, and --require-gpu asks for one: {why}"
            );
            skip(&format!("no GPU adapter: {why}"));
            None
        }
    }
}

/// The running test's name: libtest names the thread after it.
fn test_name() -> String {
    std::thread::current()
        .name()
        .unwrap_or("unnamed test")
        .to_owned()
}
