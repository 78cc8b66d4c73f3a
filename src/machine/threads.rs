//! Threads: how many are accepted, and which process they belong to.
//!
//! Work is arithmetic, so that threads beyond the processor's cores make nothing faster, and each
//! takes memory: tens of thousands of them keep a machine busy with starting them. A child of
//! `fork()` has none of the threads of its parent, and would wait for them for ever.

use crate::{Error, Result};
use std::sync::Once;
use std::sync::atomic::{AtomicBool, Ordering};

/// Most threads for each core: some time is spent waiting for memory and files.
const PER_CORE: usize = 4;
/// Number that is accepted on every machine, so that a call for a node of a cluster runs on a
/// laptop, too.
const ALWAYS: usize = 64;

/// Whether threads were started in this process.
static STARTED: AtomicBool = AtomicBool::new(false);
/// Whether this process is a child of one in which they were.
static ORPHANED: AtomicBool = AtomicBool::new(false);

/// Largest number of threads that is accepted: four for each core, or 64.
pub fn most_threads() -> usize {
    most_for(std::thread::available_parallelism().map_or(1, usize::from))
}

fn most_for(cores: usize) -> usize {
    cores.saturating_mul(PER_CORE).max(ALWAYS)
}

/// Refuses more threads than [`most_threads`]. `what` names the setting.
///
/// # Errors
/// [`Error::Value`] with the number and what is accepted.
pub fn check_threads(what: &str, threads: usize) -> Result<()> {
    let most = most_threads();
    if threads <= most {
        return Ok(());
    }
    Err(Error::Value(format!("{what} is {threads}: at most {most} threads are accepted on this machine")))
}

/// A pool of `threads` threads, which the caller has checked.
///
/// # Errors
/// [`Error::Value`] where they do not start.
pub fn thread_pool(threads: usize) -> Result<rayon::ThreadPool> {
    begin();
    let made = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    made.map_err(|error| Error::Value(format!("{threads} threads do not start ({error}): fewer are accepted")))
}

/// Starts the threads that all calls without a pool of their own share, unless they were started
/// before: one for each core, or `RAYON_NUM_THREADS`, of which more than [`most_threads`] count as
/// that many, because the variable may be meant for another program.
///
/// # Errors
/// [`Error::Value`] where they do not start.
pub fn start_threads() -> Result<()> {
    if STARTED.load(Ordering::Acquire) {
        return Ok(());
    }
    begin();
    let asked = std::env::var("RAYON_NUM_THREADS").ok().and_then(|text| text.trim().parse::<usize>().ok());
    let threads = asked.filter(|&threads| threads > 0).map_or(0, |threads| threads.min(most_threads()));
    match rayon::ThreadPoolBuilder::new().num_threads(threads).build_global() {
        Ok(()) => Ok(()),
        // A program of the caller's has started them.
        Err(error) if std::error::Error::source(&error).is_none() => Ok(()),
        Err(error) => Err(Error::Value(format!(
            "the threads do not start within the memory that is left ({error}): raise the limit (ulimit -v), or set \
             RAYON_NUM_THREADS to fewer"
        ))),
    }
}

/// Whether this process is a child of `fork()` in whose parent threads were started: work in it
/// would wait for threads that it does not have. Safe in a signal handler.
pub fn lacks_its_threads() -> bool {
    ORPHANED.load(Ordering::Relaxed)
}

/// Notes that threads are started, and that a child will not have them.
fn begin() {
    static ONCE: Once = Once::new();
    // SAFETY: the handler stores a number, which is safe between fork and exec.
    ONCE.call_once(|| unsafe {
        libc::pthread_atfork(None, None, Some(orphaned));
    });
    STARTED.store(true, Ordering::Release);
}

extern "C" fn orphaned() {
    ORPHANED.store(true, Ordering::Relaxed);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn threads_are_bounded_by_the_cores() {
        assert_eq!([most_for(1), most_for(16), most_for(128)], [64, 64, 512]);
        let refused = check_threads("options->threads", 100_000).unwrap_err().to_string();
        for fact in ["options->threads", "100000", &most_threads().to_string()] {
            assert!(refused.contains(fact), "{fact}: {refused}");
        }
        assert!(check_threads("options->threads", most_threads()).is_ok());
    }

    #[test]
    fn pools_work_and_the_process_has_its_threads() {
        assert_eq!(thread_pool(3).unwrap().install(rayon::current_num_threads), 3);
        start_threads().unwrap();
        assert!(STARTED.load(Ordering::Acquire) && !lacks_its_threads());
    }
}
