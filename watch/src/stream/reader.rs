//! Reader of a stream: the frames that are there and were not read, each as a whole.
//!
//! Metadata and pixels are read by `pread`, which gives an error where a map would kill the
//! process: a file that is cut short.

use super::layout::{Header, METADATA};
use super::semaphore::Semaphore;
use cophase::{Error, Result};
use std::fs::File;
use std::os::unix::fs::{FileExt, MetadataExt};
use std::path::{Path, PathBuf};

/// Tries to read a frame that a writer changes meanwhile.
const TRIES: usize = 20;

/// A stream that is open.
pub struct StreamReader {
    file: File,
    inode: u64,
    semaphore: Option<Semaphore>,
    /// Counter of the next frame; `None` before the first.
    next: Option<u64>,
    /// Counter less slot of the newest frame, which stays as it is.
    phase: Option<u64>,
    pub header: Header,
}

/// A frame, as it was written.
#[derive(Debug)]
pub struct RawFrame {
    pub count: u64,
    pub created: [i64; 2],
    pub inode: u64,
    pub columns: usize,
    pub rows: usize,
    pub pixels: Vec<f64>,
    pub acquired_s: f64,
    pub written_s: f64,
    /// Frames before this one that were overwritten before they were read.
    pub lost: u64,
}

/// File of the stream `name`: in the folder `MILK_SHM_DIR`, else `/milk/shm`, else `/tmp`, as
/// upstream looks for it.
pub fn path_of(name: &str) -> PathBuf {
    let named = std::env::var_os("MILK_SHM_DIR").map(PathBuf::from).filter(|folder| folder.is_dir());
    let usual = || Some(PathBuf::from("/milk/shm")).filter(|folder| folder.is_dir());
    named.or_else(usual).unwrap_or_else(|| "/tmp".into()).join(format!("{name}.im.shm"))
}

impl StreamReader {
    /// Opens the stream in the file `path`.
    ///
    /// # Errors
    /// [`Error::File`] where there is none, [`Error::Image`] for a form that is not read.
    pub fn open(path: &Path) -> Result<Self> {
        let failed = |error: std::io::Error| Error::file(path, format_args!("cannot be opened: {error}"));
        // A semaphore is written to; without that right the counter is looked at.
        let writable = File::options().read(true).write(true).open(path);
        let file = writable.or_else(|_| File::open(path)).map_err(failed)?;
        let header = header(&file)?;
        let inode = file.metadata().map_err(failed)?.ino();
        let semaphore = Semaphore::take(&file, &header);
        Ok(Self { file, inode, semaphore, next: None, phase: None, header })
    }

    /// Whether the file at `path` is still the one that is open: upstream makes a new one for
    /// another size.
    pub fn is_current(&self, path: &Path) -> bool {
        std::fs::metadata(path).is_ok_and(|found| found.ino() == self.inode && found.len() == self.header.file_bytes)
    }

    /// The next frame, if there is one.
    ///
    /// # Errors
    /// [`Error::Image`] where the metadata are no longer those of a stream.
    pub fn next(&mut self) -> Result<Option<RawFrame>> {
        // The counter decides; posts are taken so that the writer sees a reader that keeps up.
        if let Some(semaphore) = &self.semaphore {
            semaphore.drain();
        }
        for _ in 0..TRIES {
            let before = header(&self.file)?;
            if before.count == 0 || self.next.is_some_and(|next| next > before.count) {
                // A counter that was set back is a new sequence.
                if self.next.is_some_and(|next| next > before.count + 1) {
                    self.next = None;
                    continue;
                }
                return Ok(None);
            }
            if before.is_written && before.ring.is_none() {
                std::thread::yield_now();
                continue;
            }
            // The slot after the newest is the next to be overwritten.
            let kept = before.ring.map_or(1, |ring| (ring.slots - 1).max(1));
            let oldest = before.count.saturating_sub(kept - 1).max(1);
            let wanted = self.next.unwrap_or(oldest);
            let count = wanted.max(oldest);
            // A writer changes the slot first and the counter then; between the two they do not
            // belong together.
            if self.phase.is_some() && before.phase() != self.phase {
                std::thread::yield_now();
                continue;
            }
            let bytes = self.read(&before, before.count - count)?;
            let after = header(&self.file)?;
            let is_whole = match before.ring {
                None => after.count == before.count && !after.is_written,
                // Unchanged while the writer has not come round to its slot.
                Some(ring) => {
                    after.phase() == before.phase() && after.count.wrapping_sub(count) < (ring.slots - 1).max(1)
                }
            };
            if !is_whole || after.created != before.created {
                continue;
            }
            self.phase = before.phase();
            self.next = Some(count + 1);
            self.header = before;
            return Ok(Some(RawFrame {
                count,
                created: self.header.created,
                inode: self.inode,
                columns: self.header.columns,
                rows: self.header.rows,
                pixels: self.header.pixels.numbers(&bytes),
                acquired_s: self.header.acquired_s,
                written_s: self.header.written_s,
                lost: count - wanted,
            }));
        }
        self.phase = None;
        Ok(None)
    }

    /// The bytes of the frame `lag` before the newest.
    fn read(&self, header: &Header, lag: u64) -> Result<Vec<u8>> {
        let bytes = header.frame_bytes();
        let at = match header.ring {
            Some(ring) => ring.offset + (ring.newest + ring.slots - lag % ring.slots) % ring.slots * bytes as u64,
            None => header.data_at,
        };
        let mut data = vec![0; bytes];
        let read = self.file.read_exact_at(&mut data, at);
        read.map(|()| data).map_err(|error| Error::Image(format!("the stream cannot be read: {error}")))
    }
}

fn header(file: &File) -> Result<Header> {
    let mut bytes = [0; METADATA];
    let failed = |error: std::io::Error| Error::Image(format!("the stream has no metadata: {error}"));
    file.read_exact_at(&mut bytes, 0).map_err(failed)?;
    Header::parse(&bytes, file.metadata().map_err(failed)?.len())
}
