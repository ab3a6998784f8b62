//! Waiting for numbers from the device, with a deadline.

use std::{
    future::{Future, poll_fn},
    pin::Pin,
    sync::{Arc, Mutex, PoisonError},
    task::{Context, Poll, Waker},
};

use super::{device::GpuDevice, error::GpuError, faults::Fault};

/// A map of a staging buffer answers within this time or the frame is given up: a lost device may leave it open for ever.
pub const MAP_DEADLINE_MS: u32 = 1000;
/// The same for the first answer of a network: some browsers compile pipelines at their first use.
const FIRST_DEADLINE_MS: u32 = 10_000;
/// The same on a software adapter, which is there for its results and not for its speed.
const SOFTWARE_DEADLINE_MS: u32 = 120_000;

/// Firefox looks at its queue only every 100 ms unless something is submitted, so a waiting page submits nothing so often.
const NUDGE_MS: u32 = 1;
/// After so many nudges the answer is slow for another reason, and they become rarer.
const QUICK_NUDGES: u32 = 20;
const SLOW_NUDGE_MS: u32 = 20;

/// A timer of the host: completes after the given number of milliseconds. The core has no clock of its own.
pub type Timer = Box<dyn Fn(u32) -> Pin<Box<dyn Future<Output = ()>>>>;

#[derive(Default)]
struct Shared {
    result: Option<Result<(), String>>,
    waker: Option<Waker>,
}

/// Completes when the map does.
struct Mapped(Arc<Mutex<Shared>>);

impl Mapped {
    fn start(staging: &wgpu::Buffer, bytes: u64) -> Self {
        let shared = Arc::new(Mutex::new(Shared::default()));
        let of_callback = Arc::clone(&shared);
        staging.map_async(wgpu::MapMode::Read, 0..bytes, move |result| {
            let mut shared = of_callback.lock().unwrap_or_else(PoisonError::into_inner);
            shared.result = Some(result.map_err(|error| error.to_string()));
            if let Some(waker) = shared.waker.take() {
                waker.wake();
            }
        });
        Self(shared)
    }

    fn poll(&self, context: &Context<'_>) -> Poll<Result<(), GpuError>> {
        let mut shared = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        match shared.result.take() {
            Some(result) => Poll::Ready(result.map_err(GpuError::MapFailed)),
            None => {
                shared.waker = Some(context.waker().clone());
                Poll::Pending
            }
        }
    }
}

/// How long an answer may take.
fn deadline_ms(gpu: &GpuDevice, is_first: bool) -> u32 {
    if gpu.is_software() {
        SOFTWARE_DEADLINE_MS
    } else if is_first {
        FIRST_DEADLINE_MS
    } else {
        MAP_DEADLINE_MS
    }
}

/// Maps the first `bytes` of a staging buffer, hands them to `take`, and unmaps.
///
/// Natively this blocks in the driver until the submitted work is done; in a browser it waits for the promise. Neither
/// takes longer than the deadline; a browser needs `timer` for that. After an error the buffer can be used again.
///
/// # Errors
/// [`GpuError::MapFailed`], [`GpuError::MapTimeout`], [`GpuError::Lost`], [`GpuError::Refused`].
pub(super) async fn read_mapped<T>(
    gpu: &GpuDevice,
    staging: &wgpu::Buffer,
    bytes: u64,
    is_first: bool,
    timer: Option<&Timer>,
    take: impl FnOnce(&[u8]) -> T,
) -> Result<T, GpuError> {
    gpu.check()?;
    let deadline_ms = deadline_ms(gpu, is_first);
    let mapped = Mapped::start(staging, bytes);
    let arrived = wait(gpu, &mapped, deadline_ms, timer).await;
    if let Err(error) = arrived {
        // Ends the pending map too; without this the next frame could not copy into the buffer.
        staging.unmap();
        gpu.check()?;
        return Err(error);
    }
    gpu.check()?;
    let taken = {
        let view = staging
            .get_mapped_range(0..bytes)
            .map_err(|error| GpuError::MapFailed(error.to_string()))?;
        take(&view)
    };
    staging.unmap();
    Ok(taken)
}

async fn wait(
    gpu: &GpuDevice,
    mapped: &Mapped,
    deadline_ms: u32,
    timer: Option<&Timer>,
) -> Result<(), GpuError> {
    if gpu.acting.fault() == Some(Fault::LateMap) {
        return Err(GpuError::MapTimeout(deadline_ms));
    }
    #[cfg(not(target_arch = "wasm32"))]
    {
        let timeout = std::time::Duration::from_millis(deadline_ms.into());
        let polled = gpu.device.poll(wgpu::PollType::Wait {
            submission_index: None,
            timeout: Some(timeout),
        });
        match polled {
            Ok(_) => {}
            Err(wgpu::PollError::Timeout) => return Err(GpuError::MapTimeout(deadline_ms)),
            Err(error) => return Err(GpuError::MapFailed(error.to_string())),
        }
    }
    let mut deadline = timer.map(|timer| timer(deadline_ms));
    let mut nudge = timer.map(|timer| timer(NUDGE_MS));
    let mut num_nudges = 0;
    poll_fn(|context| {
        if let Poll::Ready(result) = mapped.poll(context) {
            return Poll::Ready(result);
        }
        if let Some(deadline) = &mut deadline
            && deadline.as_mut().poll(context).is_ready()
        {
            return Poll::Ready(Err(GpuError::MapTimeout(deadline_ms)));
        }
        while let Some(timer) = timer
            && let Some(waiting) = &mut nudge
            && waiting.as_mut().poll(context).is_ready()
        {
            gpu.queue.submit([]);
            num_nudges += 1;
            nudge = Some(timer(if num_nudges < QUICK_NUDGES {
                NUDGE_MS
            } else {
                SLOW_NUDGE_MS
            }));
        }
        Poll::Pending
    })
    .await
}
