//! Memory that runs out is said in one sentence.
//!
//! The memory of a scene is compared with what the machine has before the work
//! (`cophase::machine`), by formulas. This is what remains where a formula is too low or another
//! program takes the memory: the standard library would print two lines and abort, which a script
//! sees as a crash. Files that appear by a rename are not there, or as they were.

use std::alloc::{GlobalAlloc, Layout, System};
use std::io::{Cursor, Write};

/// The system's allocator; a request that fails ends the process with exit status 1 and a sentence.
pub struct Allocator;

// SAFETY: every call is passed on to the system's allocator as it came.
unsafe impl GlobalAlloc for Allocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: as the caller promises.
        checked(unsafe { System.alloc(layout) }, layout.size())
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: as the caller promises.
        checked(unsafe { System.alloc_zeroed(layout) }, layout.size())
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: as the caller promises.
        checked(unsafe { System.realloc(pointer, layout, size) }, size)
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[inline]
fn checked(pointer: *mut u8, bytes: usize) -> *mut u8 {
    if pointer.is_null() {
        end(bytes);
    }
    pointer
}

/// Ends the process without another allocation: no destructor, no handler at exit runs.
#[cold]
fn end(bytes: usize) -> ! {
    let mut line = [0u8; 240];
    let mut text = Cursor::new(&mut line[..]);
    // A line that is too long is cut.
    let _ = writeln!(
        text,
        "cophase: memory ran out: {bytes} bytes more were refused (ulimit -v, the control group or the machine sets the \
         limit): take fewer samples, pixels, modes, images or threads (RAYON_NUM_THREADS)"
    );
    let length = text.position() as usize;
    // SAFETY: `length` bytes of the line are written; `_exit` takes any status.
    unsafe {
        libc::write(libc::STDERR_FILENO, line.as_ptr().cast(), length);
        libc::_exit(1)
    }
}
