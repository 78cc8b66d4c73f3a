//! A device that fails on demand: see [`crate::fault`].

#[cfg(debug_assertions)]
use crate::Error;
use crate::Result;
#[cfg(debug_assertions)]
use std::sync::atomic::{AtomicU64, Ordering};

/// Counts what a device is asked to do. In a release it has no size and does nothing.
#[derive(Default)]
pub(crate) struct Fault {
    #[cfg(debug_assertions)]
    commands: AtomicU64,
    /// The commands that fail: the first, and one beyond the last.
    #[cfg(debug_assertions)]
    failing: (AtomicU64, AtomicU64),
}

impl Fault {
    /// What the environment asks for.
    pub fn from_environment() -> Self {
        let fault = Self::default();
        #[cfg(debug_assertions)]
        match (crate::fault::number("device"), crate::fault::number("lost")) {
            (Some(k), _) => fault.arm(k, k.saturating_add(1)),
            (None, Some(k)) => fault.arm(k, u64::MAX),
            (None, None) => {}
        }
        fault
    }

    /// Makes the commands `first` to `end` − 1 fail, counted from 1.
    #[cfg(debug_assertions)]
    pub fn arm(&self, first: u64, end: u64) {
        self.failing.0.store(first, Ordering::Relaxed);
        self.failing.1.store(end, Ordering::Relaxed);
    }

    /// Commands so far.
    #[cfg(all(test, debug_assertions))]
    pub fn commands(&self) -> u64 {
        self.commands.load(Ordering::Relaxed)
    }

    /// One more command.
    ///
    /// # Errors
    /// [`Error::Device`] where it is one that was asked to fail, in the words that a driver's failure has.
    pub fn strike(&self) -> Result<()> {
        #[cfg(debug_assertions)]
        {
            let command = self.commands.fetch_add(1, Ordering::Relaxed) + 1;
            if (self.failing.0.load(Ordering::Relaxed)..self.failing.1.load(Ordering::Relaxed)).contains(&command) {
                let sentence = format!("OpenCL failed: CL_OUT_OF_RESOURCES (COPHASE_FAULT, command {command})");
                return Err(Error::Device(sentence));
            }
        }
        Ok(())
    }
}
