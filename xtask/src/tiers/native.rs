//! Unit tests, documentation examples and the tests of `tests/native` and `mapper/tests`, on this machine.

use crate::tally::Tally;
use crate::{setup, shell};
use anyhow::Result;

/// Runs them; `require_gpu` turns a GPU test that finds no adapter into a failure.
pub(crate) fn run(require_gpu: bool) -> Result<Tally> {
    setup::native_tools()?;
    setup::gpu_driver();
    let mut cargo = shell::cargo();
    cargo.args([
        "test",
        "--workspace",
        "--exclude",
        "landline-web",
        "--no-fail-fast",
        // All that is on by default but burn's vector code, which takes minutes to compile.
        "--no-default-features",
        "--features",
        "landline/webgpu,landline-mapper/train",
    ]);
    if let Ok(weights) = setup::weights() {
        cargo.env("LANDLINE_XFEAT_CHECKPOINT", weights.checkpoint);
    }
    // The software Vulkan driver complains once for each device where a session has no such folder.
    if cfg!(target_os = "linux") && std::env::var_os("XDG_RUNTIME_DIR").is_none() {
        cargo.env("XDG_RUNTIME_DIR", std::env::temp_dir());
    }
    if require_gpu {
        cargo.env("LANDLINE_REQUIRE_GPU", "1");
    }
    let tally = super::cargo_test(&mut cargo)?;
    setup::note_tests();
    Ok(tally)
}
