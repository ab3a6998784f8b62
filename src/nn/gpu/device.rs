//! Adapter, device and queue, with what has to be known when they fail: loss, refused commands, object counts.

use std::sync::{
    Arc, Mutex,
    atomic::{AtomicU32, Ordering},
};

use super::error::GpuError;

/// Which adapter is wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum AdapterChoice {
    /// A hardware adapter; a software one is refused, since the CPU kernels are faster.
    #[default]
    Hardware,
    /// Any, also a software one: for tests.
    Any,
}

/// What became of the device.
#[derive(Debug, Default)]
struct Health {
    lost: Mutex<Option<String>>,
    refused: Mutex<Option<String>>,
}

/// A device with the default limits of WebGPU, and nothing beyond them.
pub struct GpuDevice {
    pub(super) device: wgpu::Device,
    pub(super) queue: wgpu::Queue,
    info: wgpu::AdapterInfo,
    health: Arc<Health>,
    created: AtomicU32,
}

impl core::fmt::Debug for GpuDevice {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("GpuDevice")
            .field("adapter", &self.info.name)
            .finish_non_exhaustive()
    }
}

/// Limits that the kernels are written for: those that every WebGPU implementation guarantees.
pub(super) fn needed_limits() -> wgpu::Limits {
    wgpu::Limits::default()
}

/// Compares what an adapter offers with what the kernels need.
pub(super) fn check_limits(found: &wgpu::Limits) -> Result<(), GpuError> {
    let needed = needed_limits();
    let rows: [(&'static str, u64, u64); 7] = [
        (
            "maxStorageBufferBindingSize",
            found.max_storage_buffer_binding_size,
            needed.max_storage_buffer_binding_size,
        ),
        (
            "maxBufferSize",
            found.max_buffer_size,
            needed.max_buffer_size,
        ),
        (
            "maxStorageBuffersPerShaderStage",
            found.max_storage_buffers_per_shader_stage.into(),
            needed.max_storage_buffers_per_shader_stage.into(),
        ),
        (
            "maxComputeWorkgroupStorageSize",
            found.max_compute_workgroup_storage_size.into(),
            needed.max_compute_workgroup_storage_size.into(),
        ),
        (
            "maxComputeInvocationsPerWorkgroup",
            found.max_compute_invocations_per_workgroup.into(),
            needed.max_compute_invocations_per_workgroup.into(),
        ),
        (
            "maxComputeWorkgroupSizeX",
            found.max_compute_workgroup_size_x.into(),
            needed.max_compute_workgroup_size_x.into(),
        ),
        (
            "maxComputeWorkgroupsPerDimension",
            found.max_compute_workgroups_per_dimension.into(),
            needed.max_compute_workgroups_per_dimension.into(),
        ),
    ];
    match rows.into_iter().find(|(_, found, needed)| found < needed) {
        Some((limit, found, needed)) => Err(GpuError::LimitTooLow {
            limit,
            found,
            needed,
        }),
        None => Ok(()),
    }
}

impl GpuDevice {
    /// Asks for an adapter and a device.
    ///
    /// In a browser this must be called in a window or a dedicated worker in which `navigator.gpu` exists.
    ///
    /// # Errors
    /// [`GpuError::NoAdapter`], [`GpuError::SoftwareAdapter`], [`GpuError::LimitTooLow`], [`GpuError::NoDevice`].
    pub async fn request(choice: AdapterChoice) -> Result<Arc<Self>, GpuError> {
        let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
        descriptor.backends = wgpu::Backends::BROWSER_WEBGPU
            | wgpu::Backends::VULKAN
            | wgpu::Backends::METAL
            | wgpu::Backends::DX12;
        let instance = wgpu::Instance::new(descriptor);
        let adapter = instance
            .request_adapter(&wgpu::RequestAdapterOptions {
                power_preference: wgpu::PowerPreference::HighPerformance,
                ..Default::default()
            })
            .await
            .map_err(|error| GpuError::NoAdapter(error.to_string()))?;
        let info = adapter.get_info();
        if choice == AdapterChoice::Hardware && info.device_type == wgpu::DeviceType::Cpu {
            return Err(GpuError::SoftwareAdapter(info.name));
        }
        check_limits(&adapter.limits())?;
        let (device, queue) = adapter
            .request_device(&wgpu::DeviceDescriptor {
                label: Some("landline"),
                required_limits: needed_limits(),
                ..Default::default()
            })
            .await
            .map_err(|error| GpuError::NoDevice(error.to_string()))?;
        let health = Arc::new(Health::default());
        let of_loss = Arc::clone(&health);
        device.set_device_lost_callback(move |reason, message| {
            note(&of_loss.lost, format!("{reason:?}: {message}"));
        });
        let of_refusal = Arc::clone(&health);
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            note(&of_refusal.refused, error.to_string());
        }));
        Ok(Arc::new(Self {
            device,
            queue,
            info,
            health,
            created: AtomicU32::new(0),
        }))
    }

    /// Name, driver and kind of the adapter, for reports. Browsers say little.
    pub fn adapter_name(&self) -> String {
        let name = if self.info.name.is_empty() {
            "unnamed adapter"
        } else {
            &self.info.name
        };
        format!(
            "{name} ({:?}, {:?})",
            self.info.backend, self.info.device_type
        )
    }

    /// Whether the adapter is a software one.
    pub fn is_software(&self) -> bool {
        self.info.device_type == wgpu::DeviceType::Cpu
    }

    /// What has gone wrong since the device was made, if anything.
    ///
    /// # Errors
    /// [`GpuError::Lost`], [`GpuError::Refused`].
    pub fn check(&self) -> Result<(), GpuError> {
        if let Some(reason) = read(&self.health.lost) {
            return Err(GpuError::Lost(reason));
        }
        if let Some(message) = read(&self.health.refused) {
            return Err(GpuError::Refused {
                what: "a command".to_owned(),
                message,
            });
        }
        Ok(())
    }

    /// Number of buffers, bind groups, shaders and pipelines made so far: it stands still once the networks are loaded.
    pub fn num_objects_created(&self) -> u32 {
        self.created.load(Ordering::Relaxed)
    }

    /// Ends the device as a driver reset would: for tests of the recovery.
    pub fn simulate_loss(&self) {
        self.device.destroy();
        note(&self.health.lost, "destroyed on request".to_owned());
    }

    /// Counts an object that is about to be made.
    pub(super) fn count_created(&self) {
        self.created.fetch_add(1, Ordering::Relaxed);
    }

    /// Makes a buffer.
    pub(super) fn buffer(
        &self,
        label: &str,
        bytes: u64,
        usage: wgpu::BufferUsages,
    ) -> wgpu::Buffer {
        self.count_created();
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            // Bindings must not be empty, and copies want a multiple of four.
            size: bytes.max(16).next_multiple_of(16),
            usage,
            mapped_at_creation: false,
        })
    }
}

/// Keeps the first message; a poisoned lock means a panic elsewhere and changes nothing here.
fn note(slot: &Mutex<Option<String>>, message: String) {
    let mut slot = slot
        .lock()
        .unwrap_or_else(std::sync::PoisonError::into_inner);
    slot.get_or_insert(message);
}

fn read(slot: &Mutex<Option<String>>) -> Option<String> {
    slot.lock()
        .unwrap_or_else(std::sync::PoisonError::into_inner)
        .clone()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refuses_an_adapter_below_the_guaranteed_limits() {
        let mut limits = needed_limits();
        assert_eq!(check_limits(&limits), Ok(()));
        limits.max_compute_workgroup_storage_size = 8192;
        assert_eq!(
            check_limits(&limits),
            Err(GpuError::LimitTooLow {
                limit: "maxComputeWorkgroupStorageSize",
                found: 8192,
                needed: 16384
            })
        );
    }
}
