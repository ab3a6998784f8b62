//! Work on all cores where there are threads.

/// `f(0), f(1), ..., f(count - 1)` in this order.
#[cfg(not(target_arch = "wasm32"))]
pub(crate) fn map_range<T: Send>(count: usize, f: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
    use rayon::prelude::*;
    (0..count).into_par_iter().map(f).collect()
}

/// `f(0), f(1), ..., f(count - 1)` in this order.
#[cfg(target_arch = "wasm32")]
pub(crate) fn map_range<T>(count: usize, f: impl Fn(usize) -> T) -> Vec<T> {
    (0..count).map(f).collect()
}
