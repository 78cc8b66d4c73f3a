//! Signals: Ctrl-C and SIGTERM stop at the next safe place, and a limit on file sizes is an error like a full disk.

use cophase::optimize::CancelFlag;
use cophase::{Error, Result};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// 128 + SIGINT, as shells count it.
pub const EXIT_STATUS: u8 = 130;

/// A write beyond `ulimit -f` then fails with a reason, as on a full disk, instead of killing the process and leaving
/// its temporary file behind.
///
/// # Errors
/// [`Error::Value`] where the address space is limited (`ulimit -v`) and the threads do not fit into it.
pub fn prepare_process() -> Result<()> {
    // SAFETY: a plain system call before any thread starts; it installs no handler.
    unsafe {
        libc::signal(libc::SIGXFSZ, libc::SIG_IGN);
    }
    if is_address_space_limited() {
        share_arenas();
        // Started later, where a thread that does not start is a panic.
        rayon::ThreadPoolBuilder::new().build_global().map_err(|error| {
            Error::Value(format!(
                "the threads do not start within the memory that ulimit -v leaves ({error}): raise it, or set RAYON_NUM_THREADS \
                 to fewer"
            ))
        })?;
    }
    Ok(())
}

fn is_address_space_limited() -> bool {
    let mut limit = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
    // SAFETY: the call writes into a live local.
    unsafe { libc::getrlimit(libc::RLIMIT_AS, &mut limit) == 0 && limit.rlim_cur != libc::RLIM_INFINITY }
}

/// One heap for all threads where the address space is limited: glibc reserves 64 MiB of it for each thread, of which most
/// stay unused, and what is needed is refused then.
fn share_arenas() {
    #[cfg(target_env = "gnu")]
    // SAFETY: a plain call before any thread starts.
    unsafe {
        libc::mallopt(libc::M_ARENA_MAX, 1);
    }
}

/// Handler of SIGTERM. The feature `termination` of ctrlc would catch SIGHUP, too, which nohup ignores.
extern "C" fn raise_interrupt(_: libc::c_int) {
    // SAFETY: a plain call.
    unsafe {
        libc::raise(libc::SIGINT);
    }
}

/// Knows whether the user wants to stop.
pub struct Interrupt {
    flag: CancelFlag,
}

impl Interrupt {
    /// Catches Ctrl-C from now on, and SIGTERM, with which job schedulers and mpirun end a job. A second one ends the program at once.
    pub fn catch() -> Result<Self> {
        let flag: CancelFlag = Arc::new(AtomicBool::new(false));
        let raised = flag.clone();
        let handler = move || {
            if raised.swap(true, Ordering::SeqCst) {
                std::process::exit(EXIT_STATUS.into());
            }
        };
        ctrlc::set_handler(handler).map_err(|error| Error::Internal(format!("Ctrl-C cannot be caught: {error}")))?;
        // SAFETY: the handler calls nothing but `raise`, which is async-signal-safe.
        unsafe {
            libc::signal(libc::SIGTERM, raise_interrupt as *const () as libc::sighandler_t);
        }
        Ok(Self { flag })
    }

    /// What the optimiser looks at.
    pub fn flag(&self) -> &CancelFlag {
        &self.flag
    }

    /// Whether the user wants to stop.
    pub fn is_raised(&self) -> bool {
        self.flag.load(Ordering::SeqCst)
    }

    /// Stops between two steps: `state` says what is there by then.
    pub fn check(&self, state: &str) -> Result<()> {
        if self.flag.load(Ordering::SeqCst) { Err(Error::Interrupted(state.into())) } else { Ok(()) }
    }
}
