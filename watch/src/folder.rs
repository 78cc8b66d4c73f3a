//! Source of frames: a folder in which FITS files appear.
//!
//! The kernel's notices (crate `notify`) say where to look; a scan of the whole folder every few
//! seconds finds what they miss, and is all that there is on network folders, whose notices do not
//! leave the machine that writes. A file is taken once its headers and sizes are those of a
//! complete FITS file and either its writer has closed it (or renamed it) or two looks found it
//! unchanged.

use crate::store::FileRecord;
use cophase::io::FitsReader;
use notify::event::{AccessKind, AccessMode, EventKind, ModifyKind, RenameMode};
use notify::{RecommendedWatcher, RecursiveMode, Watcher};
use std::collections::HashMap;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};

/// Between two looks at a file that must find it unchanged: longer than a camera's program pauses
/// within one file, and shorter than a person notices.
const LOOK: Duration = Duration::from_millis(100);
/// Ends of the names of files that are taken.
const EXTENSIONS: [&str; 8] = [".fits", ".fit", ".fts", ".fits.gz", ".fit.gz", ".fts.gz", ".fits.fz", ".fit.fz"];

/// A file as it is now: another one has other bytes, as far as a look without reading them can say.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stamp {
    pub size: u64,
    pub mtime_ns: i64,
    pub inode: u64,
}

impl Stamp {
    /// That of the file `path`; `None` where there is no such file.
    pub fn of(path: &Path) -> Option<Self> {
        let found = std::fs::metadata(path).ok().filter(std::fs::Metadata::is_file)?;
        let mtime_ns = found.mtime().saturating_mul(1_000_000_000).saturating_add(found.mtime_nsec());
        Some(Self { size: found.len(), mtime_ns, inode: found.ino() })
    }

    /// When the file was last changed, s since 1970.
    pub fn mtime_s(&self) -> f64 {
        self.mtime_ns as f64 * 1e-9
    }
}

/// What a folder has to tell.
#[derive(Debug)]
pub enum News {
    /// A complete file.
    File(PathBuf, Stamp),
    /// A file that has not changed for a while and is not complete, and why.
    Incomplete(PathBuf, Stamp, String),
    /// A sentence for the list of events.
    Sentence(String),
}

/// A file that is not taken yet.
struct Pending {
    stamp: Stamp,
    /// When it was first seen with this stamp.
    since: Instant,
    /// Whether its writer has closed or renamed it since.
    is_closed: bool,
    /// Why it is no complete file; `None` before a look.
    incomplete: Option<String>,
}

/// The folder.
pub struct Folder {
    path: PathBuf,
    poll: Duration,
    settle: Duration,
    /// Files that were handed over, as they were then.
    taken: HashMap<PathBuf, Stamp>,
    pending: HashMap<PathBuf, Pending>,
    watcher: Option<RecommendedWatcher>,
    sender: Sender<notify::Result<notify::Event>>,
    notices: Receiver<notify::Result<notify::Event>>,
    /// Inode of the folder; `None` while it is not there.
    inode: Option<u64>,
    next_scan: Instant,
    /// Whether the folder has been scanned once.
    is_scanned: bool,
    news: Vec<News>,
}

impl Folder {
    /// The folder `path`, of which `taken` files were taken before. It is scanned every `poll`; a
    /// file that is not complete is given up once it has not changed for `settle`.
    pub fn new(path: &Path, taken: &HashMap<PathBuf, FileRecord>, poll: Duration, settle: Duration) -> Self {
        let stamp = |file: &FileRecord| Stamp { size: file.size, mtime_ns: file.mtime_ns, inode: file.inode };
        let (sender, notices) = channel();
        Self {
            path: path.to_path_buf(),
            poll,
            settle,
            taken: taken.iter().map(|(path, file)| (path.clone(), stamp(file))).collect(),
            pending: HashMap::new(),
            watcher: None,
            sender,
            notices,
            inode: None,
            next_scan: Instant::now(),
            is_scanned: false,
            news: Vec::new(),
        }
    }

    /// Waits up to `wait` for something new. Complete files come in the order of their last change.
    pub fn wait(&mut self, wait: Duration) -> Vec<News> {
        let wait = if self.pending.is_empty() { wait } else { wait.min(LOOK / 4) };
        if let Ok(notice) = self.notices.recv_timeout(wait) {
            self.take_notice(notice);
        }
        while let Ok(notice) = self.notices.try_recv() {
            self.take_notice(notice);
        }
        if Instant::now() >= self.next_scan {
            self.scan();
        }
        self.look_at_pending();
        std::mem::take(&mut self.news)
    }

    /// Whether everything that was there is handed over.
    pub fn is_idle(&self) -> bool {
        self.is_scanned && self.pending.is_empty()
    }

    /// Hands `path` over again, after the next scan.
    pub fn forget(&mut self, path: &Path) {
        self.taken.remove(path);
    }

    /// Hands `path` over again, as soon as it has not changed between two looks.
    pub fn look_again(&mut self, path: &Path) {
        self.taken.remove(path);
        self.see(path, false, Instant::now());
    }

    fn take_notice(&mut self, notice: notify::Result<notify::Event>) {
        let Ok(event) = notice else {
            self.next_scan = Instant::now();
            return;
        };
        if event.need_rescan() || matches!(event.kind, EventKind::Remove(_)) {
            self.next_scan = Instant::now();
        }
        let is_closed = matches!(
            event.kind,
            EventKind::Access(AccessKind::Close(AccessMode::Write))
                | EventKind::Modify(ModifyKind::Name(RenameMode::To | RenameMode::Both))
        );
        for path in &event.paths {
            if path.parent() == Some(&self.path) {
                self.see(path, is_closed, Instant::now());
            }
        }
    }

    /// Notes a file that is new or has changed.
    fn see(&mut self, path: &Path, is_closed: bool, now: Instant) {
        if !is_wanted(path) {
            return;
        }
        let Some(stamp) = Stamp::of(path) else { return };
        if self.taken.get(path) == Some(&stamp) {
            return;
        }
        match self.pending.get_mut(path).filter(|pending| pending.stamp == stamp) {
            Some(pending) => pending.is_closed |= is_closed,
            None => {
                let pending = Pending { stamp, since: now, is_closed, incomplete: None };
                self.pending.insert(path.to_path_buf(), pending);
            }
        }
    }

    fn scan(&mut self) {
        self.next_scan = Instant::now() + self.poll;
        // Both, or it was removed between the two.
        let read =
            std::fs::read_dir(&self.path).and_then(|entries| Ok((entries, std::fs::metadata(&self.path)?.ino())));
        let (entries, inode) = match read {
            Ok(read) => read,
            Err(error) => {
                if self.inode.take().is_some() || !self.is_scanned {
                    let folder = self.path.display();
                    self.news.push(News::Sentence(format!(
                        "the folder {folder} cannot be read ({error}): waiting until it is back"
                    )));
                }
                (self.watcher, self.is_scanned) = (None, true);
                return;
            }
        };
        if self.inode != Some(inode) {
            self.watch(inode);
        }
        // One time for all, so that they come in the order of their changes.
        let now = Instant::now();
        for entry in entries.flatten() {
            self.see(&entry.path(), false, now);
        }
        self.is_scanned = true;
    }

    /// Asks for notices of a folder that is new, or back.
    fn watch(&mut self, inode: u64) {
        if self.is_scanned {
            self.news.push(News::Sentence(format!("the folder {} is back", self.path.display())));
        }
        self.inode = Some(inode);
        let watched = notify::recommended_watcher(self.sender.clone()).and_then(|mut watcher| {
            watcher.watch(&self.path, RecursiveMode::NonRecursive)?;
            Ok(watcher)
        });
        match watched {
            Ok(watcher) => self.watcher = Some(watcher),
            Err(error) => {
                self.watcher = None;
                let (folder, seconds) = (self.path.display(), self.poll.as_secs_f64());
                self.news.push(News::Sentence(format!(
                    "the system gives no notice of changes in {folder} ({error}): it is read every {seconds} s"
                )));
            }
        }
    }

    fn look_at_pending(&mut self) {
        let now = Instant::now();
        let mut ready = Vec::new();
        let (pending, settle) = (&mut self.pending, self.settle);
        pending.retain(|path, pending| {
            let Some(stamp) = Stamp::of(path) else { return false };
            if stamp != pending.stamp {
                *pending = Pending { stamp, since: now, is_closed: false, incomplete: None };
                return true;
            }
            let age = now.duration_since(pending.since);
            if !pending.is_closed && age < LOOK {
                return true;
            }
            // Again at the end: a change within the resolution of the file system's times leaves
            // the stamp as it was.
            if pending.incomplete.is_none() || age >= settle {
                match FitsReader::open(path) {
                    Ok(_) => {
                        ready.push((path.clone(), stamp, None));
                        return false;
                    }
                    Err(error) => pending.incomplete = Some(error.to_string()),
                }
            }
            if age < settle {
                return true;
            }
            ready.push((path.clone(), stamp, pending.incomplete.take()));
            false
        });
        ready.sort_by(|(path, stamp, _), (other, others, _)| (stamp.mtime_ns, path).cmp(&(others.mtime_ns, other)));
        for (path, stamp, incomplete) in ready {
            self.taken.insert(path.clone(), stamp);
            self.news.push(match incomplete {
                None => News::File(path, stamp),
                Some(reason) => News::Incomplete(path, stamp, reason),
            });
        }
    }
}

/// Whether it has the name of a FITS file, and not that of a temporary one.
fn is_wanted(path: &Path) -> bool {
    let Some(name) = path.file_name().map(|name| name.to_string_lossy().to_ascii_lowercase()) else { return false };
    !name.starts_with('.') && !name.starts_with('~') && EXTENSIONS.iter().any(|extension| name.ends_with(extension))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn temporary_names_are_left_alone() {
        for name in ["a.fits", "A.FITS", "b.fits.gz", "c.fz.fits", "d.fits.fz"] {
            assert!(is_wanted(Path::new(name)), "{name}");
        }
        for name in [".a.fits", "a.fits.tmp", "a.fits.part", "a.txt", "~a.fits", "fits"] {
            assert!(!is_wanted(Path::new(name)), "{name}");
        }
    }
}
