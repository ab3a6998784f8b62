//! How far long work has come, who is told, and who may stop it.
//!
//! The long functions of this module are `async` for one reason: a page has one thread for its work and its messages. Between
//! two steps they await what the observer gives them; an observer that gives nothing makes a future that is ready at once.

use std::pin::Pin;

/// What is being done.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Stage {
    /// Descriptors of pairs without poses are compared.
    Match,
    /// Geometry of pairs is estimated.
    Verify,
    /// Pictures are registered.
    Grow,
    /// Everything is adjusted.
    Adjust,
    /// Descriptors of posed pairs are compared.
    PosedMatch,
    /// Points are triangulated.
    Points,
    /// Segments are matched and lines triangulated.
    Lines,
    /// What locates is chosen and written.
    Landmarks,
}

/// Something to be awaited between two steps of work.
pub type Pause = Pin<Box<dyn Future<Output = ()>>>;

/// Is told what is done of how much, and may stop it. A closure is one that never pauses.
pub trait Observer {
    /// So much of a stage is done; false stops the work.
    fn tell(&mut self, stage: Stage, done: usize, total: usize) -> bool;

    /// Awaited after each call of [`Self::tell`].
    fn pause(&mut self) -> Option<Pause> {
        None
    }
}

impl<F: FnMut(Stage, usize, usize) -> bool> Observer for F {
    fn tell(&mut self, stage: Stage, done: usize, total: usize) -> bool {
        self(stage, done, total)
    }
}

/// Tells an observer from inside of the work.
pub struct Watch<'a> {
    observer: &'a mut dyn Observer,
}

impl<'a> Watch<'a> {
    /// Of this observer.
    pub fn new(observer: &'a mut dyn Observer) -> Self {
        Self { observer }
    }

    /// `None` when the observer wants no more.
    pub async fn tell(&mut self, stage: Stage, done: usize, total: usize) -> Option<()> {
        let goes_on = self.observer.tell(stage, done, total);
        if let (true, Some(pause)) = (goes_on, self.observer.pause()) {
            pause.await;
        }
        goes_on.then_some(())
    }
}

/// Pairs in one piece of work, after which is told how far it came: few where one thread works and wants to hear of being
/// stopped, enough for many threads else.
pub(crate) const PIECE: usize = if cfg!(feature = "parallel") { 256 } else { 16 };
