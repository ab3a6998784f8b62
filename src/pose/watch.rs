//! The time budget of a call.

/// Share of the budget that the search may use; the rest is for the refinement of what it found.
const SEARCH_SHARE: f64 = 0.7;

/// Reads the caller's clock, and only where there is a budget.
pub(super) struct Watch<'a> {
    clock: &'a mut dyn FnMut() -> f64,
    /// When the search and the whole call have to end.
    ends: Option<(f64, f64)>,
}

impl<'a> Watch<'a> {
    pub(super) fn start(clock: &'a mut dyn FnMut() -> f64, budget_ms: Option<f64>) -> Self {
        let ends = budget_ms.map(|budget| {
            let now = clock();
            (now + SEARCH_SHARE * budget, now + budget)
        });
        Self { clock, ends }
    }

    pub(super) fn is_search_over(&mut self) -> bool {
        self.ends
            .is_some_and(|(search, _)| (self.clock)() >= search)
    }

    pub(super) fn is_over(&mut self) -> bool {
        self.ends.is_some_and(|(_, call)| (self.clock)() >= call)
    }
}
