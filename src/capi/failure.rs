//! Sentence of the last error of each thread.

use super::status::cophase_status;
use crate::Error;
use std::cell::RefCell;
use std::ffi::c_char;
use std::fmt::{self, Write};

/// Bytes of a sentence that are kept. A fixed size, so that failing allocates nothing of its own.
const CAPACITY: usize = 2048;

/// UTF-8 text, cut at the capacity.
struct Sentence {
    bytes: [u8; CAPACITY],
    length: usize,
    full: bool,
}

impl Write for Sentence {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        let free = if self.full { 0 } else { CAPACITY - self.length };
        let mut whole = text.len().min(free);
        while !text.is_char_boundary(whole) {
            whole -= 1;
        }
        self.bytes[self.length..self.length + whole].copy_from_slice(&text.as_bytes()[..whole]);
        self.length += whole;
        self.full |= whole < text.len();
        Ok(())
    }
}

thread_local! {
    static LAST: RefCell<Sentence> = const { RefCell::new(Sentence { bytes: [0; CAPACITY], length: 0, full: false }) };
}

/// Keeps the sentence of `error` for this thread; its status.
pub(super) fn keep(error: &Error) -> cophase_status {
    LAST.with_borrow_mut(|last| {
        (last.length, last.full) = (0, false);
        // A sentence that is cut is no failure.
        let _ = write!(last, "{error}");
    });
    error.status()
}

/// Sentence of the last call that failed in this thread, UTF-8; empty before the first. Calls that
/// succeed do not change it.
///
/// text: receives at most `capacity` bytes, the terminating zero included, as with snprintf; may be
///   NULL if capacity is 0.
///
/// Returns the length of the whole sentence in bytes, without the zero. Sentences are cut after
/// 2048 bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_last_error(text: *mut c_char, capacity: usize) -> usize {
    LAST.with_borrow(|last| {
        if !text.is_null() && capacity > 0 {
            let length = last.length.min(capacity - 1);
            // The caller's promise: `capacity` bytes at `text`.
            unsafe {
                std::ptr::copy_nonoverlapping(last.bytes.as_ptr(), text.cast(), length);
                text.add(length).write(0);
            }
        }
        last.length
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sentence_is_cut_between_characters_and_stays_on_its_thread() {
        assert_eq!(keep(&Error::Value("é".repeat(CAPACITY))), 4);
        assert_eq!(unsafe { cophase_last_error(std::ptr::null_mut(), 0) }, CAPACITY);
        // An odd start: the last character does not fit as a whole, and what follows it must not
        // take its place.
        keep(&Error::Value(format!("x{}z", "é".repeat(CAPACITY / 2))));
        let mut text = [1u8; 6];
        assert_eq!(unsafe { cophase_last_error(text.as_mut_ptr().cast(), 5) }, CAPACITY - 1);
        assert_eq!(text, [b'x', 0xc3, 0xa9, 0xc3, 0, 1]);
        let other = std::thread::spawn(|| unsafe { cophase_last_error(std::ptr::null_mut(), 0) });
        assert_eq!(other.join().unwrap(), 0);
    }
}
