//! Where the networks run.

use anyhow::{Result, bail};
use landline::nn::gpu::{AdapterChoice, GpuDevice, GpuError};
use landline::relocalizer::{GpuNetworks, Relocalizer, RelocalizerOptions};
use landline::scene_file::{ExtractorFile, SceneFile};

/// What may run the networks.
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

/// Moves the networks of a relocalizer to what was asked for; `change` is what the relocalizer was made with. Returns what
/// they run on, in words.
///
/// # Errors
/// When a GPU was asked for and cannot be used; the message says why.
pub fn place(
    relocalizer: &mut Relocalizer,
    device: Device,
    scene: &SceneFile,
    extractor: &ExtractorFile,
    change: impl FnOnce(&mut RelocalizerOptions),
) -> Result<String> {
    if device == Device::Cpu {
        return Ok("the CPU".to_owned());
    }
    match on_gpu(relocalizer, device, scene, extractor, change) {
        Ok(name) => Ok(name),
        Err(why) if device == Device::Auto => Ok(format!("the CPU: {why}")),
        Err(why) => bail!("--device gpu: {why}; --device auto or cpu works without one"),
    }
}

fn on_gpu(
    relocalizer: &mut Relocalizer,
    device: Device,
    scene: &SceneFile,
    extractor: &ExtractorFile,
    change: impl FnOnce(&mut RelocalizerOptions),
) -> Result<String, GpuError> {
    let choice = match device {
        Device::Auto => AdapterChoice::Hardware,
        Device::Gpu | Device::Cpu => AdapterChoice::Any,
    };
    let networks = pollster::block_on(async {
        let gpu = GpuDevice::request(choice).await?;
        GpuNetworks::new(gpu, scene, extractor, change, None).await
    })?;
    let name = networks.device().adapter_name();
    if device == Device::Auto {
        relocalizer.try_gpu(networks);
    } else {
        relocalizer.use_gpu(networks);
    }
    Ok(name)
}
