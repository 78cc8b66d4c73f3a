//! Status numbers and their names.

use crate::Error;
use std::ffi::{CStr, c_char};

/// Name of a status number: `OK`, `BAD_SCENE`, …; `UNKNOWN` for a number of a later version.
///
/// Returns a static string that the caller must not free. Never NULL.
#[unsafe(no_mangle)]
pub extern "C" fn cophase_status_name(status: i32) -> *const c_char {
    let name: &CStr = match status {
        0 => c"OK",
        other => Error::status_name(other).unwrap_or(c"UNKNOWN"),
    };
    name.as_ptr()
}
