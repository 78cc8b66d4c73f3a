//! Injected device failures for tests: see [`crate::fault`].

#[cfg(debug_assertions)]
use crate::Error;
use crate::Result;
#[cfg(debug_assertions)]
use std::sync::atomic::{AtomicU64, Ordering};

/// Counter of the commands of a device, some of which are made to fail. Without debug assertions it
/// has no size and does nothing.
#[derive(Default)]
pub(crate) struct Fault {
    #[cfg(debug_assertions)]
    commands: AtomicU64,
    /// The commands that fail: first, and one past the last.
    #[cfg(debug_assertions)]
    failing: (AtomicU64, AtomicU64),
}

impl Fault {
    /// The failures that the variable `COPHASE_FAULT` requests.
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

    /// Commands counted so far.
    #[cfg(all(test, debug_assertions))]
    pub fn commands(&self) -> u64 {
        self.commands.load(Ordering::Relaxed)
    }

    /// Counts one command.
    ///
    /// # Errors
    /// [`Error::Device`] where this command is to fail, with a message like that of a driver.
    pub fn count_command(&self) -> Result<()> {
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
