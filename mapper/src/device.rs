//! Where the networks run.

use anyhow::{Result, bail};
use landline::relocalizer::{Device, Relocalizer};
use landline::scene_file::{ExtractorFile, SceneFile};

/// Moves the networks of a relocalizer to what was asked for. Returns what they run on, in words.
///
/// # Errors
/// When a GPU was asked for and cannot be used; the message says why.
pub fn place(
    relocalizer: &mut Relocalizer,
    device: Device,
    scene: &SceneFile,
    extractor: &ExtractorFile,
) -> Result<String> {
    let placed = pollster::block_on(relocalizer.place(device, scene, extractor, None));
    match (placed, relocalizer.gpu()) {
        (Ok(()), Some(gpu)) => Ok(gpu.device().adapter_name()),
        (Ok(()), None) => Ok("the CPU".to_owned()),
        (Err(why), _) if device == Device::Auto => Ok(format!("the CPU: {why}")),
        (Err(why), _) => bail!("--device gpu: {why}; --device auto or cpu works without one"),
    }
}
