//! Status numbers and their names.

use crate::Error;
use std::ffi::{CStr, c_char};

/// What became of a call: COPHASE_OK, or why it failed. Numbers are permanent; a later version may have more.
#[allow(non_camel_case_types)] // a name of the header
pub type cophase_status = i32;

/// The call did what it says.
pub const COPHASE_OK: i32 = 0;
/// A scene that cannot be parsed, or that names something impossible.
pub const COPHASE_BAD_SCENE: i32 = 1;
/// A file that cannot be read or written.
pub const COPHASE_BAD_FILE: i32 = 2;
/// An array whose shape does not fit.
pub const COPHASE_BAD_SHAPE: i32 = 3;
/// A number out of its range, or a call that comes too early.
pub const COPHASE_BAD_VALUE: i32 = 4;
/// An image that holds nothing to fit.
pub const COPHASE_BAD_IMAGE: i32 = 5;
/// OpenCL is absent, or a device failed.
pub const COPHASE_DEVICE: i32 = 6;
/// The user asked to stop.
pub const COPHASE_INTERRUPTED: i32 = 7;
/// A broken promise of the library's own; please report it.
pub const COPHASE_INTERNAL: i32 = 8;
/// An argument that cannot be used: NULL, misaligned, not UTF-8, an output that overlaps itself.
pub const COPHASE_BAD_ARGUMENT: i32 = 9;
/// The object is in use by another thread; nothing was done.
pub const COPHASE_BUSY: i32 = 10;
/// The library panicked, now or earlier, in a call on this object: it can only be destroyed. Please report it.
pub const COPHASE_PANIC: i32 = 11;

/// Name of a status number: `OK`, `BAD_SCENE`, …; `UNKNOWN` for a number of a later version.
///
/// Returns a static string that the caller must not free. Never NULL.
#[unsafe(no_mangle)]
pub extern "C" fn cophase_status_name(status: cophase_status) -> *const c_char {
    let name: &CStr = match status {
        COPHASE_OK => c"OK",
        other => Error::status_name(other).unwrap_or(c"UNKNOWN"),
    };
    name.as_ptr()
}

#[cfg(test)]
mod tests {
    use crate::Error;

    #[test]
    fn the_constants_are_the_numbers_of_the_errors() {
        // `error.rs` is where the numbers live; the header generator reads literals only, from this file.
        let lines = include_str!("status.rs").lines();
        let constants: Vec<(&str, i32)> = lines
            .filter_map(|line| line.strip_prefix("pub const COPHASE_")?.strip_suffix(';')?.split_once(": i32 = "))
            .map(|(name, number)| (name, number.parse().unwrap()))
            .collect();
        assert_eq!(constants[0], ("OK", 0));
        for (position, &(name, number)) in constants.iter().enumerate().skip(1) {
            assert_eq!(number, position as i32);
            assert_eq!(Error::status_name(number).unwrap().to_str().unwrap(), name);
        }
        assert!(Error::status_name(constants.len() as i32).is_none(), "a kind of failure lacks its constant");
    }
}
