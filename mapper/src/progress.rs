//! Progress on the terminal: bars with a remaining time, silent where nobody looks.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use landline::reconstruction::{Observer, Stage};
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

/// One bar for each stage of a reconstruction, one after the other.
#[derive(Debug)]
pub struct StageBars {
    progress: Progress,
    current: Option<(Stage, ProgressBar)>,
}

impl StageBars {
    /// None yet.
    pub fn new(progress: Progress) -> Self {
        Self {
            progress,
            current: None,
        }
    }
}

impl Observer for StageBars {
    fn tell(&mut self, stage: Stage, done: usize, total: usize) -> bool {
        if self.current.as_ref().is_none_or(|(s, _)| *s != stage) {
            if let Some((_, bar)) = self.current.take() {
                bar.finish();
            }
            let what = match stage {
                Stage::Match => "matching pictures",
                Stage::Verify => "comparing pairs",
                Stage::Grow => "placing pictures",
                Stage::Adjust => "adjusting",
                Stage::PosedMatch => "matching",
                Stage::Points => "triangulating points",
                Stage::Lines => "matching segments",
                Stage::Landmarks => "choosing landmarks",
            };
            self.current = Some((stage, self.progress.bar(what, total)));
        }
        if let Some((_, bar)) = &self.current {
            bar.set_position(done as u64);
        }
        true
    }
}

impl Drop for StageBars {
    fn drop(&mut self) {
        if let Some((_, bar)) = self.current.take() {
            bar.finish();
        }
    }
}
