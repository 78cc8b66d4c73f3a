//! Signals: Ctrl-C and SIGTERM stop at the next safe place, and a limit on file sizes is an error
//! like a full disk.

use crate::terminal::{self, Wait};
use cophase::control::CancelFlag;
use cophase::io::abandon_files;
use cophase::machine::start_threads;
use cophase::pipeline::Control;
use cophase::{Error, Result};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// 128 + SIGINT, as shells count it.
pub const EXIT_STATUS: u8 = 130;

/// Time from the first signal to the end of the program, where the work has not ended by itself: a
/// set-up, a decomposition, or a file that is read reaches its next safe place later.
const GRACE: Duration = Duration::from_millis(1500);
/// Time for the last line, where a pipe does not take it.
const LAST_LINE: Duration = Duration::from_millis(200);

/// Whether the last line is taken: the verb's own, or that of a program which is ended.
static LAST_LINE_IS_TAKEN: AtomicBool = AtomicBool::new(false);

/// A write beyond `ulimit -f` then fails with a reason, as on a full disk, instead of killing the
/// process and leaving its temporary file behind.
///
/// # Errors
/// [`Error::Value`] where the address space is limited (`ulimit -v`) and the threads do not fit
/// into it.
pub fn prepare_process() -> Result<()> {
    // SAFETY: a plain system call before any thread starts; it installs no handler.
    unsafe {
        libc::signal(libc::SIGXFSZ, libc::SIG_IGN);
    }
    if is_address_space_limited() {
        share_arenas();
        // Started later, where a thread that does not start is a panic.
        start_threads()?;
    } else if std::env::var_os("RAYON_NUM_THREADS").is_some() {
        // As many as are accepted.
        start_threads()?;
    }
    Ok(())
}

fn is_address_space_limited() -> bool {
    let mut limit = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
    // SAFETY: the call writes into a live local.
    unsafe { libc::getrlimit(libc::RLIMIT_AS, &mut limit) == 0 && limit.rlim_cur != libc::RLIM_INFINITY }
}

/// One heap for all threads where the address space is limited: glibc reserves 64 MiB of it for
/// each thread, of which most stay unused, and what is needed is refused then.
fn share_arenas() {
    #[cfg(target_env = "gnu")]
    // SAFETY: a plain call before any thread starts.
    unsafe {
        libc::mallopt(libc::M_ARENA_MAX, 1);
    }
}

/// The verb has ended and says the last line: or, where it ends at the very moment at which the
/// program is ended, does not return.
pub(crate) fn verb_has_ended() {
    if !take_last_line() {
        loop {
            std::thread::park();
        }
    }
}

/// Whether the caller is the first to ask, and says the last line.
fn take_last_line() -> bool {
    !LAST_LINE_IS_TAKEN.swap(true, Ordering::SeqCst)
}

/// Ends the program after [`GRACE`]: files that are not complete are removed, and none appears
/// after the line that says so.
fn end_after_grace() {
    std::thread::sleep(GRACE);
    abandon_files();
    if take_last_line() {
        let seconds = GRACE.as_secs_f64();
        let line = move || {
            terminal::complain(&Error::Interrupted(format!(
                "the work was ended after {seconds} s, in which it reached no place to stop at; files that were not complete are removed"
            )).to_string());
        };
        // Another thread may hold standard error, and wait for its reader.
        drop(std::thread::Builder::new().spawn(line));
    }
    std::thread::sleep(LAST_LINE);
    end();
}

/// Ends the process. Handlers of libraries at its exit would wait for threads that still work.
fn end() -> ! {
    abandon_files();
    // SAFETY: ends the process.
    unsafe { libc::_exit(EXIT_STATUS.into()) }
}

/// Handler of SIGTERM. The feature `termination` of ctrlc would catch SIGHUP, too, which nohup
/// ignores.
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
    /// Catches Ctrl-C from now on, and SIGTERM, with which job schedulers and mpirun end a job.
    /// Work that has not stopped within two seconds is ended; a second signal ends the program at
    /// once.
    pub fn catch() -> Result<Self> {
        let flag: CancelFlag = Arc::new(AtomicBool::new(false));
        let raised = flag.clone();
        let handler = move || {
            if raised.swap(true, Ordering::SeqCst) {
                end();
            }
            // A thread of its own: this one takes the second signal.
            if std::thread::Builder::new().spawn(end_after_grace).is_err() {
                end_after_grace();
            }
        };
        ctrlc::set_handler(handler).map_err(|error| Error::Internal(format!("Ctrl-C cannot be caught: {error}")))?;
        // SAFETY: the handler calls nothing but `raise`, which is async-signal-safe.
        unsafe {
            libc::signal(libc::SIGTERM, raise_interrupt as *const () as libc::sighandler_t);
        }
        Ok(Self { flag })
    }

    /// The control of a call that stops at Ctrl-C and shows its progress on `wait`.
    pub fn control(&self, wait: &Wait) -> Control {
        Control::with_flag(self.flag.clone(), wait.observer())
    }

    /// The control of calls that stop at Ctrl-C, and show no progress.
    pub fn silent_control(&self) -> Control {
        Control::of_flag(self.flag.clone())
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
