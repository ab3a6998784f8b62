//! Where the networks run.

use anyhow::{Result, bail};
use landline::relocalizer::{Device as Policy, Relocalizer};
use landline::scene_file::{ExtractorFile, SceneFile};

/// What may run the networks: [`Policy`] as a word of the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum)]
pub enum Device {
    /// The faster of a hardware GPU and the CPU, as measured on the first pictures.
    Auto,
    /// A GPU, also one that is simulated in software; refused when there is none.
    Gpu,
    /// The CPU.
    #[default]
    Cpu,
}

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
    let policy = match device {
        Device::Auto => Policy::Auto,
        Device::Gpu => Policy::Gpu,
        Device::Cpu => Policy::Cpu,
    };
    let placed = pollster::block_on(relocalizer.place(policy, scene, extractor, None));
    match (placed, relocalizer.gpu()) {
        (Ok(()), Some(gpu)) => Ok(gpu.device().adapter_name()),
        (Ok(()), None) => Ok("the CPU".to_owned()),
        (Err(why), _) if device == Device::Auto => Ok(format!("the CPU: {why}")),
        (Err(why), _) => bail!("--device gpu: {why}; --device auto or cpu works without one"),
    }
}
