//! What runs the networks: one policy for page and tool.

use super::Relocalizer;
use super::backend::Backend;
use super::gpu::GpuNetworks;
use crate::nn::gpu::{AdapterChoice, GpuDevice, GpuError, Timer};
use crate::scene_file::{ExtractorFile, SceneFile};

/// What may run the networks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Device {
    /// The faster of a hardware GPU and the CPU, as measured on the first frames.
    Auto,
    /// A GPU, also one that is simulated in software, without measuring.
    Gpu,
    /// The CPU.
    #[default]
    Cpu,
}

impl Relocalizer {
    /// Moves the networks to what is asked for. `scene` and `extractor` are those that this was made of. `timer` bounds the
    /// wait for results; natively the driver blocks and none is needed.
    ///
    /// # Errors
    /// [`GpuError`] when there is no device or it cannot be used: the networks stay on the CPU then.
    pub async fn place(
        &mut self,
        device: Device,
        scene: &SceneFile,
        extractor: &ExtractorFile,
        timer: Option<Timer>,
    ) -> Result<(), GpuError> {
        self.backend = Backend::default();
        let choice = match device {
            Device::Cpu => return Ok(()),
            Device::Auto => AdapterChoice::Hardware,
            Device::Gpu => AdapterChoice::Any,
        };
        let gpu = GpuDevice::request(choice).await?;
        let front_end = &self.options.front_end;
        let networks = GpuNetworks::new(gpu, scene, extractor, front_end, timer).await?;
        self.backend = Backend::new(networks, device == Device::Auto);
        Ok(())
    }

    /// Moves the networks to a device that was prepared with [`Self::options`]. They stay there until it fails; then the CPU
    /// takes over, for that frame and all later ones, and [`Self::gpu_failure`] tells why. An answer that is late is made up
    /// for by the CPU once; the device goes if the next one is late too.
    ///
    /// # Errors
    /// [`GpuError::Unsupported`] when they were prepared with other options.
    pub fn use_gpu(&mut self, networks: GpuNetworks) -> Result<(), GpuError> {
        networks.check_options(&self.options.front_end)?;
        self.backend = Backend::new(networks, false);
        Ok(())
    }

    /// The networks on a device, if they are there.
    pub fn gpu(&self) -> Option<&GpuNetworks> {
        self.backend.networks()
    }

    /// Why the last frame ran on the CPU though a device was given, if it did. After [`Device::Auto`] this may be that the
    /// CPU was measured to be faster.
    pub fn gpu_failure(&self) -> Option<&str> {
        self.backend.failure()
    }
}
