//! Progress of an experiment, its cancellation, and the draws that it shares with other processes.

use super::shares::{KeptDraw, Shares};
use cophase::pipeline::Control;
use cophase::{Error, Result};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Counts fitted images over a whole experiment; its draws may be shared with other processes.
pub struct Progress<'a> {
    shares: Option<Shares>,
    watch: &'a (dyn Fn(usize, usize) + Sync),
    control: Control,
    done: AtomicUsize,
    total: AtomicUsize,
}

impl<'a> Progress<'a> {
    /// `watch` is called with (done, total); `control` stops the experiment where it is cancelled.
    pub fn new(watch: &'a (dyn Fn(usize, usize) + Sync), control: &Control) -> Self {
        Self { shares: None, watch, control: control.clone(), done: AtomicUsize::new(0), total: AtomicUsize::new(0) }
    }

    /// This, of an experiment that shares its draws.
    pub fn with_shares(self, shares: Shares) -> Self {
        Self { shares: Some(shares), ..self }
    }

    /// The draws that the experiment shares; none where it has all to itself.
    pub fn shares(&self) -> Option<&Shares> {
        self.shares.as_ref()
    }

    /// Draw `seed` of `row`, in the given place of all draws: the one that is kept, or else that of
    /// `make`, which is kept; none where it is of another process's part. It takes `steps` steps,
    /// which `make` counts.
    ///
    /// # Errors
    /// Those of `make`; [`Error::File`]; [`Error::Interrupted`].
    pub fn draw<D: KeptDraw>(
        &self,
        (row, seed, place): (&str, usize, usize),
        steps: usize,
        make: impl FnOnce() -> Result<D>,
    ) -> Result<Option<D>> {
        self.check()?;
        let Some(shares) = &self.shares else { return make().map(Some) };
        let kept = shares.kept(row, seed);
        if kept.is_some() || !shares.is_own(place) {
            self.add(steps);
            return Ok(kept);
        }
        let made = make()?;
        shares.keep(row, seed, &made)?;
        Ok(Some(made))
    }

    /// What stops the experiment, for the calls of which it is made.
    pub fn control(&self) -> &Control {
        &self.control
    }

    /// So many steps lie ahead.
    pub fn expect(&self, total: usize) {
        self.total.store(total, Ordering::Relaxed);
        (self.watch)(0, total);
    }

    /// So many more are done.
    pub fn add(&self, images: usize) {
        let done = self.done.fetch_add(images, Ordering::Relaxed) + images;
        (self.watch)(done, self.total.load(Ordering::Relaxed).max(done));
    }

    /// # Errors
    /// [`Error::Interrupted`] where the control is cancelled, with how far the experiment came.
    pub fn check(&self) -> Result<()> {
        if self.control.is_cancelled() {
            let (done, total) = (self.done.load(Ordering::Relaxed), self.total.load(Ordering::Relaxed));
            return Err(Error::Interrupted(format!("{done} of {total} steps were done")));
        }
        Ok(())
    }
}
