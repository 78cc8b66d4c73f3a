//! Fault injection for tests, in builds with debug assertions only (no release has them). The
//! environment variable `COPHASE_FAULT` selects a fault:
//!
//! | value | what fails |
//! |---|---|
//! | `panic` | the next call on an object of the C interface panics |
//! | `internal` | the next call on an object of the C interface returns an internal error |
//! | `worker` | a thread that computes the model on the CPU panics |
//! | `device:K` | the K-th command of every OpenCL device that is opened fails, as for a lack of memory |
//! | `lost:K` | the K-th command and all after it fail, as for a device that was removed |
//! | `kill:K` | the process is killed while it writes a file: 1 halfway, 2 before the rename, 3 after it |

use crate::{Error, Result};

/// Whether this fault is selected.
///
/// Does not allocate, because calls that must not allocate are tested in debug builds too. Always
/// false in a release.
pub(crate) fn is_selected(fault: &str) -> bool {
    selected().is_some_and(|selected| selected == fault.as_bytes())
}

/// The number K of `fault:K`, if that fault is selected.
pub(crate) fn number(fault: &str) -> Option<u64> {
    let number = selected()?.strip_prefix(fault.as_bytes())?.strip_prefix(b":")?;
    std::str::from_utf8(number).ok()?.parse().ok()
}

/// Panics or returns an internal error, if the fault `panic` or `internal` is selected.
pub(crate) fn fail_call() -> Result<()> {
    if is_selected("panic") {
        panic!("the fault that COPHASE_FAULT selects");
    }
    if is_selected("internal") {
        return Err(Error::Internal("the fault that COPHASE_FAULT selects".into()));
    }
    Ok(())
}

/// Panics in a thread of the pool, if the fault `worker` is selected.
pub(crate) fn panic_in_worker() {
    if cfg!(debug_assertions) && is_selected("worker") && rayon::current_thread_index().is_some() {
        panic!("the fault that COPHASE_FAULT selects, in a thread of the pool");
    }
}

/// Kills the process with SIGKILL, if the fault `kill` of this `stage` is selected.
pub(crate) fn kill_process(stage: u64) {
    if number("kill") == Some(stage) {
        // SAFETY: plain system calls; nothing of this process runs after them.
        unsafe {
            libc::kill(libc::getpid(), libc::SIGKILL);
            libc::pause();
        }
    }
}

/// Value of `COPHASE_FAULT`.
#[cfg(debug_assertions)]
fn selected() -> Option<&'static [u8]> {
    // `std::env` allocates. SAFETY: a NUL-terminated name. The value is read before the environment
    // can change: only tests set it.
    let value = unsafe { libc::getenv(c"COPHASE_FAULT".as_ptr()) };
    // SAFETY: not NULL, and NUL-terminated like every environment variable.
    (!value.is_null()).then(|| unsafe { std::ffi::CStr::from_ptr(value) }.to_bytes())
}

/// No fault in a release.
#[cfg(not(debug_assertions))]
fn selected() -> Option<&'static [u8]> {
    None
}
