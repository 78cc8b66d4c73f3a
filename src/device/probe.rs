//! Probe of the OpenCL drivers before they are loaded into this process: `probe.c` loads them in a
//! child, with a time limit.
//!
//! The outcome is kept in a file, `$XDG_CACHE_HOME/cophase/opencl-….txt` (default: `~/.cache`),
//! which begins with what it depends on ([`drivers::fingerprint`]): a machine is probed once, and
//! again after its drivers change or it was started again. A failure is kept for an hour only.
//! Where the file cannot be written, each process probes for itself.

use super::drivers;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::{Duration, SystemTime};

/// Time within which the drivers of a machine list their devices; `COPHASE_OPENCL_TIMEOUT_S` sets
/// another. A GPU that was asleep takes some seconds.
const LIMIT: Duration = Duration::from_secs(20);

/// How long a failure is believed.
const FAILURE_HOLDS: Duration = Duration::from_secs(3600);

/// Outcomes of `probe.c`.
const LOADED: i32 = 0;
const HANGS: i32 = 2;
const EXITED: i32 = 3;
const SIGNAL: i32 = 256;

#[cfg(all(unix, not(target_os = "macos")))]
unsafe extern "C" {
    fn cophase_probe_opencl(limit_ms: i32) -> i32;
}

/// Why the drivers must not be loaded into this process; `None` where they can be.
pub(super) fn refusal() -> Option<&'static str> {
    static REFUSAL: OnceLock<Option<String>> = OnceLock::new();
    REFUSAL.get_or_init(probed).as_deref()
}

fn probed() -> Option<String> {
    if drivers::are_loaded() {
        return None;
    }
    let fingerprint = drivers::fingerprint();
    let file = cache_file(&fingerprint);
    if let Some(known) = file.as_deref().and_then(|file| recall(file, &fingerprint)) {
        return known;
    }
    let limit = limit();
    let outcome = run(limit);
    let refusal = sentence(outcome, limit).map(|reason| {
        let again = file.as_deref().map(|file| format!(" (delete {} to try it again)", file.display()));
        format!(
            "an OpenCL driver of this machine cannot be used: {reason} when its devices were listed in a process of its own; \
             installed: {}; remove or repair it, or use the CPU chain{}",
            drivers::listed(),
            again.unwrap_or_default()
        )
    });
    if let Some(file) = file.filter(|_| outcome == LOADED || refusal.is_some()) {
        let text = format!("{fingerprint}{END}{}", refusal.as_deref().unwrap_or_default());
        // Without the file the next process probes again: no failure.
        let _ = file.parent().map(std::fs::create_dir_all);
        let _ = crate::atomic::write(&file, text.as_bytes());
    }
    refusal
}

/// Between the fingerprint and the refusal in the cache's file.
const END: &str = "refusal: ";

fn limit() -> Duration {
    let set = std::env::var("COPHASE_OPENCL_TIMEOUT_S").ok().and_then(|text| text.parse::<f64>().ok());
    set.filter(|seconds| (0.01..=3600.0).contains(seconds)).map_or(LIMIT, Duration::from_secs_f64)
}

#[cfg(all(unix, not(target_os = "macos")))]
fn run(limit: Duration) -> i32 {
    // SAFETY: the function has no pointers; `probe.c` says what makes its fork safe.
    unsafe { cophase_probe_opencl(limit.as_millis() as i32) }
}

/// Where the system's own framework is linked there is nothing to load.
#[cfg(not(all(unix, not(target_os = "macos"))))]
fn run(_: Duration) -> i32 {
    LOADED
}

/// An outcome in words; `None` for drivers that load, and where no child could be made.
fn sentence(outcome: i32, limit: Duration) -> Option<String> {
    match outcome {
        HANGS => Some(format!("it did not return within {} s (COPHASE_OPENCL_TIMEOUT_S)", limit.as_secs_f64())),
        EXITED => Some("it ended the process".into()),
        signal if signal > SIGNAL => Some(match signal - SIGNAL {
            libc::SIGABRT => "it aborted the process".into(),
            libc::SIGSEGV | libc::SIGBUS => "it crashed".into(),
            number => format!("it ended the process with signal {number}"),
        }),
        _ => None,
    }
}

/// File of the outcome for this fingerprint; `None` without a home.
fn cache_file(fingerprint: &str) -> Option<PathBuf> {
    let absolute = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let folder = absolute("XDG_CACHE_HOME").or_else(|| Some(absolute("HOME")?.join(".cache")))?;
    // The name only has to differ between environments: the file has the whole fingerprint.
    let mut hasher = DefaultHasher::new();
    fingerprint.hash(&mut hasher);
    Some(folder.join("cophase").join(format!("opencl-{:016x}.txt", hasher.finish())))
}

/// The refusal in `file` (`None` within: the drivers can be loaded); `None` where it holds none for
/// this fingerprint.
fn recall(file: &Path, fingerprint: &str) -> Option<Option<String>> {
    let text = std::fs::read_to_string(file).ok()?;
    let refusal = text.strip_prefix(fingerprint)?.strip_prefix(END)?;
    if refusal.is_empty() {
        return Some(None);
    }
    let age = SystemTime::now().duration_since(std::fs::metadata(file).ok()?.modified().ok()?).ok()?;
    (age < FAILURE_HOLDS).then(|| Some(refusal.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outcomes_are_reported_and_unknown_ones_are_no_refusal() {
        assert_eq!(sentence(LOADED, LIMIT), None);
        assert_eq!(sentence(1, LIMIT), None);
        assert!(sentence(HANGS, LIMIT).unwrap().contains("20 s"));
        assert!(sentence(SIGNAL + libc::SIGABRT, LIMIT).unwrap().contains("aborted"));
        assert!(sentence(SIGNAL + libc::SIGKILL, LIMIT).unwrap().contains("signal 9"));
    }

    #[test]
    fn a_cached_outcome_holds_for_its_fingerprint_only() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("opencl.txt");
        assert_eq!(recall(&file, "a\n"), None);
        std::fs::write(&file, "a\nrefusal: ").unwrap();
        assert_eq!(recall(&file, "a\n"), Some(None));
        assert_eq!(recall(&file, "b\n"), None);
        std::fs::write(&file, "a\nrefusal: it aborted").unwrap();
        assert_eq!(recall(&file, "a\n"), Some(Some("it aborted".into())));
        let old = SystemTime::now() - 2 * FAILURE_HOLDS;
        std::fs::File::options().write(true).open(&file).unwrap().set_modified(old).unwrap();
        assert_eq!(recall(&file, "a\n"), None);
    }
}
