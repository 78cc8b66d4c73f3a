//! Who waits for an experiment, and whether they still want to.

use cophase::optimize::CancelFlag;
use cophase::{Error, Result};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Counts fitted images over a whole experiment.
pub struct Progress<'a> {
    watch: &'a (dyn Fn(usize, usize) + Sync),
    cancel: Option<&'a CancelFlag>,
    done: AtomicUsize,
    total: AtomicUsize,
}

impl<'a> Progress<'a> {
    /// `watch` is called with (done, total); `cancel` stops the experiment where it goes up.
    pub fn new(watch: &'a (dyn Fn(usize, usize) + Sync), cancel: Option<&'a CancelFlag>) -> Self {
        Self { watch, cancel, done: AtomicUsize::new(0), total: AtomicUsize::new(0) }
    }

    /// Flag that stops the experiment, for code that polls it.
    pub fn cancel(&self) -> Option<&'a CancelFlag> {
        self.cancel
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
    /// [`Error::Interrupted`] where the flag is up, with how far the experiment came.
    pub fn check(&self) -> Result<()> {
        if self.cancel.is_some_and(|flag| flag.load(Ordering::Relaxed)) {
            let (done, total) = (self.done.load(Ordering::Relaxed), self.total.load(Ordering::Relaxed));
            return Err(Error::Interrupted(format!("{done} of {total} steps were done")));
        }
        Ok(())
    }
}
