//! Where the time of a frame went.

/// Milliseconds per stage, read from the caller's clock: the core has none of its own.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct StageTimings {
    /// Grey image and resize.
    pub preprocess_ms: f64,
    /// Extractor network, keypoints and their descriptors.
    pub features_ms: f64,
    /// Line segments.
    pub lines_ms: f64,
    /// The scene's two branches.
    pub regress_ms: f64,
    /// Correspondences and pose.
    pub solve_ms: f64,
    /// From the first stage to the last.
    pub total_ms: f64,
}

/// Measures stages one after another.
pub(super) struct Stopwatch<'a> {
    clock: &'a mut dyn FnMut() -> f64,
    started_ms: f64,
    last_ms: f64,
}

impl<'a> Stopwatch<'a> {
    pub(super) fn start(clock: &'a mut dyn FnMut() -> f64) -> Self {
        let now = clock();
        Self {
            clock,
            started_ms: now,
            last_ms: now,
        }
    }

    /// Time since the last lap.
    pub(super) fn lap(&mut self) -> f64 {
        let now = (self.clock)();
        let lap = now - self.last_ms;
        self.last_ms = now;
        lap
    }

    /// Time since the start.
    pub(super) fn total(&self) -> f64 {
        self.last_ms - self.started_ms
    }

    /// The clock itself, for stages that have a time budget.
    pub(super) fn clock(&mut self) -> &mut dyn FnMut() -> f64 {
        &mut *self.clock
    }
}
