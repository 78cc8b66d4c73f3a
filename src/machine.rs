//! Memory that this process can still get, and the refusal of work that needs more; its threads.
//!
//! A process that takes more memory than there is does not fail: the allocator aborts it, or the
//! kernel kills it, and no sentence says why. So the memory of a scene is computed before the work
//! and compared with the smallest of
//!
//! | bound | source |
//! |---|---|
//! | available memory | `MemAvailable` of `/proc/meminfo` |
//! | address space (`ulimit -v`) | `RLIMIT_AS`, less the size in `/proc/self/statm` |
//! | control group, version 2 | `memory.max` of each group above the process, less `memory.current` without file cache |
//! | control group, version 1 | `memory.limit_in_bytes`, less `memory.usage_in_bytes` without file cache |
//!
//! A source that does not exist sets no bound.

mod threads;

pub use threads::{check_threads, lacks_its_threads, most_threads, start_threads, thread_pool};

use crate::{Error, Result};
use std::path::{Path, PathBuf};

/// Memory that is available to this process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Available {
    /// Bytes.
    pub bytes: u64,
    /// What sets the bound, in words.
    pub bound: &'static str,
}

/// Memory that this process can still get; `None` where the system does not tell.
pub fn available() -> Option<Available> {
    let free = std::fs::read_to_string("/proc/meminfo").ok().and_then(|text| field(&text, "MemAvailable:", 1024));
    let bounds = [
        free.map(|bytes| Available { bytes, bound: "the machine's free memory" }),
        address_space().map(|bytes| Available { bytes, bound: "the limit of this process, ulimit -v" }),
        control_group().map(|bytes| Available { bytes, bound: "the limit of its control group" }),
    ];
    bounds.into_iter().flatten().min_by_key(|available| available.bytes)
}

/// Refuses work that needs more than the available memory. `what` is the subject of the sentence,
/// `advice` its end.
///
/// # Errors
/// [`Error::Value`] with both figures, and what sets the bound.
pub fn check_memory(what: impl std::fmt::Display, bytes: u64, advice: &str) -> Result<()> {
    match available().filter(|available| bytes > available.bytes) {
        Some(available) => Err(Error::Value(refusal(what, bytes, available, advice))),
        None => Ok(()),
    }
}

fn refusal(what: impl std::fmt::Display, bytes: u64, available: Available, advice: &str) -> String {
    let Available { bytes: there, bound } = available;
    format!("{what} would take {} of memory, where {bound} leaves {}: {advice}", gib(bytes), gib(there))
}

/// `bytes` in words: `29.6 GiB`.
pub fn gib(bytes: u64) -> String {
    let gib = bytes as f64 / (1u64 << 30) as f64;
    if gib < 0.1 { format!("{:.1} MiB", gib * 1024.0) } else { format!("{gib:.1} GiB") }
}

/// Number after `key` in the text of a file of /proc or of a control group, times `unit`.
fn field(text: &str, key: &str, unit: u64) -> Option<u64> {
    let words = text.lines().find_map(|line| line.strip_prefix(key))?;
    words.split_whitespace().next()?.parse::<u64>().ok()?.checked_mul(unit)
}

/// Address space that is left; `None` without a limit.
fn address_space() -> Option<u64> {
    let mut limit = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
    // SAFETY: the call writes into a live local.
    let status = unsafe { libc::getrlimit(libc::RLIMIT_AS, &mut limit) };
    if status != 0 || limit.rlim_cur == libc::RLIM_INFINITY {
        return None;
    }
    // SAFETY: a plain query.
    let page = u64::try_from(unsafe { libc::sysconf(libc::_SC_PAGESIZE) }).unwrap_or(4096);
    let taken = std::fs::read_to_string("/proc/self/statm").ok().and_then(|text| field(&text, "", page)).unwrap_or(0);
    Some(limit.rlim_cur.saturating_sub(taken))
}

/// What the control groups of this process leave; `None` without a limit.
fn control_group() -> Option<u64> {
    let groups = std::fs::read_to_string("/proc/self/cgroup").ok()?;
    let bounds = groups.lines().flat_map(|line| {
        // `hierarchy:controllers:path`; version 2 is hierarchy 0 without controllers.
        let mut parts = line.splitn(3, ':').skip(1);
        let (controllers, path) = (parts.next().unwrap_or_default(), parts.next().unwrap_or_default());
        let (root, names) = match controllers {
            "" => ("/sys/fs/cgroup", ["memory.max", "memory.current"]),
            "memory" => ("/sys/fs/cgroup/memory", ["memory.limit_in_bytes", "memory.usage_in_bytes"]),
            _ => return Vec::new(),
        };
        groups_above(Path::new(root), path).iter().filter_map(|group| left_by(group, names)).collect()
    });
    bounds.min()
}

/// The group at `path` below `root`, and those above it. Within a container the path may be one of
/// the host: the root is the container's own group then.
fn groups_above(root: &Path, path: &str) -> Vec<PathBuf> {
    let own = root.join(path.trim_start_matches('/'));
    own.ancestors().take_while(|group| group.starts_with(root)).map(Path::to_path_buf).collect()
}

fn left_by(group: &Path, [limit, usage]: [&str; 2]) -> Option<u64> {
    let read = |name: &str| std::fs::read_to_string(group.join(name)).ok();
    // `max` is no number: no limit. Version 1 has a number near 2^63 for it.
    let limit = field(&read(limit)?, "", 1).filter(|&limit| limit < 1 << 60)?;
    let cache = read("memory.stat").and_then(|text| field(&text, "inactive_file ", 1)).unwrap_or(0);
    let taken = field(&read(usage)?, "", 1).unwrap_or(0).saturating_sub(cache);
    Some(limit.saturating_sub(taken))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_found_and_scaled() {
        let text = "MemTotal:       24683520 kB\nMemAvailable:   23639040 kB\n";
        assert_eq!(field(text, "MemAvailable:", 1024), Some(23_639_040 * 1024));
        assert_eq!(field(text, "SwapFree:", 1024), None);
        assert_eq!(field("max\n", "", 1), None);
        assert_eq!(field("123 45", "", 4096), Some(123 * 4096));
    }

    #[test]
    fn groups_are_searched_up_to_the_root_and_not_above() {
        let groups = groups_above(Path::new("/sys/fs/cgroup"), "/a/b");
        assert_eq!(groups, ["/sys/fs/cgroup/a/b", "/sys/fs/cgroup/a", "/sys/fs/cgroup"].map(PathBuf::from));
        assert_eq!(groups_above(Path::new("/sys/fs/cgroup"), "/").len(), 1);
    }

    #[test]
    fn a_group_leaves_its_limit_less_what_is_taken_without_cache() {
        let folder = tempfile::tempdir().unwrap();
        let put = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
        let names = ["memory.max", "memory.current"];
        assert_eq!(left_by(folder.path(), names), None);
        put("memory.max", "1000\n");
        put("memory.current", "700\n");
        assert_eq!(left_by(folder.path(), names), Some(300));
        put("memory.stat", "anon 500\ninactive_file 200\n");
        assert_eq!(left_by(folder.path(), names), Some(500));
        put("memory.max", "max\n");
        assert_eq!(left_by(folder.path(), names), None);
    }

    #[test]
    fn the_refusal_has_both_figures_and_the_bound() {
        let available = Available { bytes: 3 << 30, bound: "the limit of its control group" };
        let sentence = refusal("truth_samples = 16384", 30 << 30, available, "lower it");
        let facts = ["truth_samples = 16384", "30.0 GiB", "the limit of its control group", "3.0 GiB", "lower it"];
        assert!(facts.iter().all(|fact| sentence.contains(fact)), "{sentence}");
        assert_eq!(gib(5 << 20), "5.0 MiB");
        assert!(check_memory("nothing", 0, "").is_ok());
        assert!(available_now_is_sane());
    }

    fn available_now_is_sane() -> bool {
        available().is_none_or(|available| available.bytes > 1 << 20)
    }
}
