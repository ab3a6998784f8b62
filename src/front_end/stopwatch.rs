//! Times of stages, read from the caller's clock: the core has none of its own.

/// Measures stages one after another.
pub(crate) struct Stopwatch<'a> {
    clock: &'a mut dyn FnMut() -> f64,
    started_ms: f64,
    last_ms: f64,
}

impl<'a> Stopwatch<'a> {
    pub(crate) fn start(clock: &'a mut dyn FnMut() -> f64) -> Self {
        let now = clock();
        Self {
            clock,
            started_ms: now,
            last_ms: now,
        }
    }

    /// Time since the last lap.
    pub(crate) fn lap(&mut self) -> f64 {
        let now = (self.clock)();
        let lap = now - self.last_ms;
        self.last_ms = now;
        lap
    }

    /// Time since the start.
    pub(crate) fn total(&self) -> f64 {
        self.last_ms - self.started_ms
    }

    /// The clock itself, for stages that have a time budget.
    pub(crate) fn clock(&mut self) -> &mut dyn FnMut() -> f64 {
        &mut *self.clock
    }
}
