//! Adapter, device and queue, with what has to be known when they fail: loss and refused commands.

use std::sync::{Arc, Mutex, PoisonError};

use super::error::GpuError;
use super::faults::{Acting, Fault};

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
    #[cfg(all(feature = "faults", not(target_arch = "wasm32")))]
    pub(super) instance: wgpu::Instance,
    info: wgpu::AdapterInfo,
    health: Arc<Health>,
    pub(super) acting: Acting,
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
fn check_limits(found: &wgpu::Limits) -> Result<(), GpuError> {
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
        Self::open(choice, None).await
    }

    /// The same, with something wrong from the start.
    pub(super) async fn open(
        choice: AdapterChoice,
        fault: Option<Fault>,
    ) -> Result<Arc<Self>, GpuError> {
        let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
        descriptor.backends = wgpu::Backends::BROWSER_WEBGPU
            | wgpu::Backends::VULKAN
            | wgpu::Backends::METAL
            | wgpu::Backends::DX12;
        if fault == Some(Fault::NoAdapter) {
            if cfg!(target_arch = "wasm32") {
                return Err(GpuError::NoAdapter("none, on request".to_owned()));
            }
            descriptor.backends = wgpu::Backends::empty();
        }
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
        let mut limits = adapter.limits();
        if fault == Some(Fault::LowLimit) {
            limits.max_compute_workgroup_storage_size =
                needed_limits().max_compute_workgroup_storage_size / 2;
        }
        check_limits(&limits)?;
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
        #[cfg_attr(
            target_arch = "wasm32",
            expect(
                clippy::arc_with_non_send_sync,
                reason = "natively it may be sent, and the code is the same"
            )
        )]
        Ok(Arc::new(Self {
            device,
            queue,
            #[cfg(all(feature = "faults", not(target_arch = "wasm32")))]
            instance,
            info,
            health,
            acting: Acting::default(),
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

    /// Makes objects of the device and waits for its opinion of them: what it refuses comes back as an error here, and does
    /// not reach the console of a browser.
    ///
    /// # Errors
    /// [`GpuError::Refused`], or that of `make`.
    pub(super) async fn attempt<T>(
        &self,
        what: &str,
        make: impl FnOnce() -> Result<T, GpuError>,
    ) -> Result<T, GpuError> {
        self.check()?;
        let of_memory = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let of_validation = self.device.push_error_scope(wgpu::ErrorFilter::Validation);
        let made = make();
        // Both are taken off before either is waited for: scopes are a stack.
        let refused = [
            Box::pin(of_validation.pop()) as Refusal,
            Box::pin(of_memory.pop()),
        ];
        let mut message = None;
        for error in refused {
            message = message.or(error.await.map(|error| error.to_string()));
        }
        self.check()?;
        match message {
            Some(message) => Err(GpuError::Refused {
                what: what.to_owned(),
                message,
            }),
            None => made,
        }
    }

    /// Takes the device for lost.
    #[cfg(feature = "faults")]
    pub(super) fn lose(&self, why: &str) {
        self.device.destroy();
        note(&self.health.lost, why.to_owned());
    }

    /// Makes a buffer.
    pub(super) fn buffer(
        &self,
        label: &str,
        bytes: u64,
        usage: wgpu::BufferUsages,
    ) -> wgpu::Buffer {
        self.acting.count_created();
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            // Bindings must not be empty, and copies want a multiple of four.
            size: bytes.max(16).next_multiple_of(16),
            usage,
            mapped_at_creation: false,
        })
    }
}

/// What a scope of errors has caught, once the device has got there.
type Refusal = core::pin::Pin<Box<dyn Future<Output = Option<wgpu::Error>>>>;

/// Keeps the first message; a poisoned lock means a panic elsewhere and changes nothing here.
fn note(slot: &Mutex<Option<String>>, message: String) {
    let mut slot = slot.lock().unwrap_or_else(PoisonError::into_inner);
    slot.get_or_insert(message);
}

fn read(slot: &Mutex<Option<String>>) -> Option<String> {
    slot.lock().unwrap_or_else(PoisonError::into_inner).clone()
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
