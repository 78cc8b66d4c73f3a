//! A semaphore of a stream that is this process's own.

use super::layout::Header;
use std::fs::File;
use std::os::fd::AsRawFd;
use std::ptr::NonNull;
use std::sync::atomic::{AtomicI32, Ordering};

/// Takes a semaphore that no living process has, and gives it back when it is dropped.
pub struct Semaphore {
    /// Tells the size of the file: what lies behind its end must not be touched.
    file: File,
    map: NonNull<libc::c_void>,
    bytes: usize,
    index: usize,
    is_taken: bool,
    semaphores_at: usize,
    readers_at: usize,
}

// SAFETY: the map belongs to this value alone, and what is in it is shared by processes: atomics
// and semaphores.
unsafe impl Send for Semaphore {}

impl Semaphore {
    /// A free semaphore of the stream in `file`; `None` where there is none, or the file is not
    /// writable.
    pub fn take(file: &File, header: &Header) -> Option<Self> {
        let bytes = usize::try_from(header.file_bytes).ok()?;
        let access = libc::PROT_READ | libc::PROT_WRITE;
        // SAFETY: a new map of a descriptor that is open; the kernel chooses the address.
        let map = unsafe { libc::mmap(std::ptr::null_mut(), bytes, access, libc::MAP_SHARED, file.as_raw_fd(), 0) };
        if map == libc::MAP_FAILED {
            return None;
        }
        let (semaphores_at, readers_at) = (header.semaphores_at as usize, header.readers_at as usize);
        let file = file.try_clone().ok()?;
        let mut taken =
            Self { file, map: NonNull::new(map)?, bytes, index: 0, is_taken: false, semaphores_at, readers_at };
        // SAFETY: a plain system call.
        let own = unsafe { libc::getpid() };
        taken.index = (0..header.semaphores).find(|&index| {
            let reader = taken.reader(index);
            let known = reader.load(Ordering::SeqCst);
            // As upstream: 0 and -1 mark a free semaphore, and a process that has ended has no
            // process group. SAFETY: a plain system call.
            let is_free = known <= 0 || unsafe { libc::getpgid(known) } < 0;
            is_free && reader.compare_exchange(known, own, Ordering::SeqCst, Ordering::SeqCst).is_ok()
        })?;
        taken.is_taken = true;
        Some(taken)
    }

    /// Takes all posts.
    pub fn drain(&self) {
        // SAFETY: a semaphore that the writer has initialised, within the map and the file.
        while self.is_whole() && unsafe { libc::sem_trywait(self.semaphore()) } == 0 {}
    }

    /// Whether the file still reaches to the end of the map. Upstream never cuts a file short; one
    /// that does it between this look and the touch that follows ends the process.
    fn is_whole(&self) -> bool {
        self.file.metadata().is_ok_and(|found| found.len() >= self.bytes as u64)
    }

    fn reader(&self, index: usize) -> &AtomicI32 {
        // SAFETY: within the map, aligned by the layout, and only changed as a whole.
        unsafe { AtomicI32::from_ptr(self.map.as_ptr().byte_add(self.readers_at + 4 * index).cast()) }
    }

    fn semaphore(&self) -> *mut libc::sem_t {
        let at = self.semaphores_at + size_of::<libc::sem_t>() * self.index;
        // SAFETY: within the map.
        unsafe { self.map.as_ptr().byte_add(at).cast() }
    }
}

impl Drop for Semaphore {
    fn drop(&mut self) {
        // SAFETY: a plain system call.
        let own = unsafe { libc::getpid() };
        if self.is_whole() && self.is_taken {
            // Another process's number stays.
            let _ = self.reader(self.index).compare_exchange(own, 0, Ordering::SeqCst, Ordering::SeqCst);
        }
        // SAFETY: the map of this value, which nothing uses any more.
        unsafe {
            libc::munmap(self.map.as_ptr(), self.bytes);
        }
    }
}
