//! What can go wrong with a device, acted out so that the way back to the CPU can be tested anywhere. What ships is built without
//! the feature `faults`, and then nothing of this is left.

#[cfg(feature = "faults")]
use super::{AdapterChoice, GpuDevice, GpuError};
#[cfg(feature = "faults")]
use std::sync::{
    Arc, Mutex, PoisonError,
    atomic::{AtomicU32, Ordering},
};

/// What can go wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(
    not(feature = "faults"),
    expect(
        dead_code,
        unreachable_pub,
        reason = "nothing goes wrong on purpose in what ships"
    )
)]
pub enum Fault {
    /// No adapter is found.
    NoAdapter,
    /// The adapter has half the workgroup memory that WebGPU guarantees.
    LowLimit,
    /// The shaders that are made from now on have an error in them.
    ShaderError,
    /// The products that are made from now on are wrong in every fourth row.
    WrongAnswer,
    /// Matrices in 16 bits are read wrongly by the shaders that are made from now on.
    WrongHalves,
    /// Results never arrive.
    LateMap,
    /// The device is gone, as after a reset of the driver.
    Lost,
}

/// What a device acts out, and how many objects it has made.
#[derive(Debug, Default)]
pub(super) struct Acting {
    #[cfg(feature = "faults")]
    fault: Mutex<Option<Fault>>,
    #[cfg(feature = "faults")]
    created: AtomicU32,
}

#[cfg(not(feature = "faults"))]
impl Acting {
    pub(super) const fn fault(&self) -> Option<Fault> {
        None
    }

    pub(super) const fn count_created(&self) {}
}

#[cfg(feature = "faults")]
impl Acting {
    /// What is being acted out.
    pub(super) fn fault(&self) -> Option<Fault> {
        *self.fault.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn set(&self, fault: Option<Fault>) {
        *self.fault.lock().unwrap_or_else(PoisonError::into_inner) = fault;
    }

    /// Counts an object that is about to be made.
    pub(super) fn count_created(&self) {
        self.created.fetch_add(1, Ordering::Relaxed);
    }
}

#[cfg(feature = "faults")]
impl GpuDevice {
    /// [`Self::request`] with something wrong from the start.
    ///
    /// # Errors
    /// Those of [`Self::request`].
    pub async fn request_with_fault(
        choice: AdapterChoice,
        fault: Option<Fault>,
    ) -> Result<Arc<Self>, GpuError> {
        let gpu = Self::open(choice, fault).await?;
        if let Some(fault) = fault {
            gpu.simulate(fault);
        }
        Ok(gpu)
    }

    /// Lets something go wrong from now on.
    pub fn simulate(&self, fault: Fault) {
        self.acting.set(Some(fault));
        if fault == Fault::Lost {
            self.lose("destroyed on request");
        }
    }

    /// Ends what [`Self::simulate`] began; a device that was lost stays so.
    pub fn recover(&self) {
        self.acting.set(None);
    }

    /// Number of buffers, bind groups, shaders and pipelines made so far: it stands still once the networks are loaded.
    pub fn num_objects_created(&self) -> u32 {
        self.acting.created.load(Ordering::Relaxed)
    }

    /// Number of buffers, bind groups, shaders and pipelines that are alive by the driver layer's own books, which also
    /// have what was made in passing; `None` in browsers, which do not tell.
    #[cfg(not(target_arch = "wasm32"))]
    pub fn num_objects_alive(&self) -> Option<usize> {
        let report = self.instance.generate_report()?;
        let hub = report.hub_report();
        let kinds = [
            &hub.buffers,
            &hub.bind_groups,
            &hub.bind_group_layouts,
            &hub.shader_modules,
            &hub.compute_pipelines,
            &hub.command_buffers,
            &hub.command_encoders,
        ];
        Some(kinds.iter().map(|kind| kind.num_kept_from_user).sum())
    }
}
