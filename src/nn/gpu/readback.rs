//! Waiting for numbers from the device, with a deadline.

use std::{
    future::Future,
    pin::Pin,
    sync::{Arc, Mutex, PoisonError},
    task::{Context, Poll, Waker},
};

use super::{device::GpuDevice, error::GpuError};

/// A map of a staging buffer answers within this time or the GPU is given up: a lost device may leave it open for ever.
pub const MAP_DEADLINE_MS: u32 = 1000;

/// A timer of the host: completes after the given number of milliseconds. The core has no clock of its own.
pub type Timer = Box<dyn Fn(u32) -> Pin<Box<dyn Future<Output = ()>>>>;

#[derive(Default)]
struct Shared {
    result: Option<Result<(), String>>,
    waker: Option<Waker>,
}

/// Completes when the map does.
struct Mapped(Arc<Mutex<Shared>>);

impl Future for Mapped {
    type Output = Result<(), GpuError>;

    fn poll(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Self::Output> {
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

/// The first of two futures.
struct Either<A, B>(A, B);

impl<A, B> Future for Either<A, B>
where
    A: Future<Output = Result<(), GpuError>> + Unpin,
    B: Future<Output = ()> + Unpin,
{
    type Output = Result<(), GpuError>;

    fn poll(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Self::Output> {
        if let Poll::Ready(result) = Pin::new(&mut self.0).poll(context) {
            return Poll::Ready(result);
        }
        match Pin::new(&mut self.1).poll(context) {
            Poll::Ready(()) => Poll::Ready(Err(GpuError::MapTimeout(MAP_DEADLINE_MS))),
            Poll::Pending => Poll::Pending,
        }
    }
}

/// Maps the first `bytes` of a staging buffer, hands them to `take`, and unmaps.
///
/// Natively this blocks in the driver until the submitted work is done; in a browser it waits for the promise, no longer
/// than [`MAP_DEADLINE_MS`] when there is a timer.
///
/// # Errors
/// [`GpuError::MapFailed`], [`GpuError::MapTimeout`], [`GpuError::Lost`], [`GpuError::Refused`].
pub(super) async fn read_mapped<T>(
    gpu: &GpuDevice,
    staging: &wgpu::Buffer,
    bytes: u64,
    timer: Option<&Timer>,
    take: impl FnOnce(&[u8]) -> T,
) -> Result<T, GpuError> {
    gpu.check()?;
    let shared = Arc::new(Mutex::new(Shared::default()));
    let of_callback = Arc::clone(&shared);
    staging.map_async(wgpu::MapMode::Read, 0..bytes, move |result| {
        let mut shared = of_callback.lock().unwrap_or_else(PoisonError::into_inner);
        shared.result = Some(result.map_err(|error| error.to_string()));
        if let Some(waker) = shared.waker.take() {
            waker.wake();
        }
    });
    #[cfg(not(target_arch = "wasm32"))]
    gpu.device
        .poll(wgpu::PollType::wait_indefinitely())
        .map_err(|error| GpuError::MapFailed(error.to_string()))?;
    match timer {
        Some(timer) => Either(Mapped(shared), timer(MAP_DEADLINE_MS)).await?,
        None => Mapped(shared).await?,
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
