//! Progress on the terminal: bars with a remaining time, silent where nobody looks.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::time::Duration;

/// Makes progress bars.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Progress {
    /// On standard error, when it is a terminal.
    Terminal,
    /// Nowhere.
    Hidden,
}

impl Progress {
    fn start(self, bar: ProgressBar, what: &str, template: &str) -> ProgressBar {
        if self == Self::Hidden {
            bar.set_draw_target(ProgressDrawTarget::hidden());
        }
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style.progress_chars("=> "));
        }
        bar.set_message(what.to_owned());
        bar.enable_steady_tick(Duration::from_millis(200));
        bar
    }

    /// A bar for `len` steps.
    pub fn bar(self, what: &str, len: usize) -> ProgressBar {
        self.start(
            ProgressBar::new(len as u64),
            what,
            "{msg:22} [{bar:32}] {pos}/{len} {elapsed} (about {eta} left)",
        )
    }

    /// Something of unknown length.
    pub fn spinner(self, what: &str) -> ProgressBar {
        self.start(
            ProgressBar::new_spinner(),
            what,
            "{msg:22} {spinner} {elapsed}",
        )
    }
}
