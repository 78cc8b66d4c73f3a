//! Failures on demand, so that tests see what a fault leaves behind. They are in builds with debug assertions only, which no
//! release is, and the variable `COPHASE_FAULT` of the environment asks for one:
//!
//! | value | what fails |
//! |---|---|
//! | `panic` | the next call on an object of the C interface panics |
//! | `internal` | it fails as a broken promise of our own |
//! | `worker` | a thread that computes the model on the CPU panics |
//! | `device:K` | the K-th command of every OpenCL device that is opened, as where its memory is short |
//! | `lost:K` | that one and all after it, as where the device is gone |
//! | `kill:K` | the process is killed while it writes a file: 1 halfway, 2 before it is renamed, 3 after |

use crate::{Error, Result};

/// Whether the environment asks for this fault.
///
/// It neither allocates nor, in a release, does anything: calls that must not allocate are tested in debug builds too.
pub(crate) fn asked(fault: &str) -> bool {
    wanted().is_some_and(|wanted| wanted == fault.as_bytes())
}

/// The number K of `fault:K`, where the environment asks for that.
pub(crate) fn number(fault: &str) -> Option<u64> {
    let number = wanted()?.strip_prefix(fault.as_bytes())?.strip_prefix(b":")?;
    std::str::from_utf8(number).ok()?.parse().ok()
}

/// Fails where the environment asks for a `panic` or for an `internal` error.
pub(crate) fn in_a_call() -> Result<()> {
    if asked("panic") {
        panic!("COPHASE_FAULT asked for it");
    }
    if asked("internal") {
        return Err(Error::Internal("COPHASE_FAULT asked for it".into()));
    }
    Ok(())
}

/// Panics in a thread of the pool, where the environment asks for that.
pub(crate) fn in_a_worker() {
    if cfg!(debug_assertions) && asked("worker") && rayon::current_thread_index().is_some() {
        panic!("COPHASE_FAULT asked for it in a thread of the pool");
    }
}

/// Ends the process as the kernel or a user may end it at any time, where the environment asks for that `stage`.
pub(crate) fn killed(stage: u64) {
    if number("kill") == Some(stage) {
        // SAFETY: plain system calls; nothing of this process runs after them.
        unsafe {
            libc::kill(libc::getpid(), libc::SIGKILL);
            libc::pause();
        }
    }
}

#[cfg(debug_assertions)]
fn wanted() -> Option<&'static [u8]> {
    // Not `std::env`, which allocates.
    // SAFETY: a NUL-terminated name. What is found is looked at before the environment can change: only tests set it.
    let value = unsafe { libc::getenv(c"COPHASE_FAULT".as_ptr()) };
    // SAFETY: not NULL, and NUL-terminated as all of the environment is.
    (!value.is_null()).then(|| unsafe { std::ffi::CStr::from_ptr(value) }.to_bytes())
}

#[cfg(not(debug_assertions))]
fn wanted() -> Option<&'static [u8]> {
    None
}
