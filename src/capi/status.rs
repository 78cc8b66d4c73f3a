//! Status numbers of calls and of images, and their names.

use crate::Error;
use std::ffi::{CStr, c_char};

/// Status of a call: COPHASE_OK, or why it failed. Numbers are permanent; later versions may have
/// more.
#[allow(non_camel_case_types)] // a name of the header
pub type cophase_status = i32;

/// Success.
pub const COPHASE_OK: i32 = 0;
/// Scene that cannot be parsed, or with an impossible value.
pub const COPHASE_BAD_SCENE: i32 = 1;
/// File that cannot be read or written.
pub const COPHASE_BAD_FILE: i32 = 2;
/// Array of the wrong shape.
pub const COPHASE_BAD_SHAPE: i32 = 3;
/// Number out of range, or a call before the one that it needs.
pub const COPHASE_BAD_VALUE: i32 = 4;
/// No usable image.
pub const COPHASE_BAD_IMAGE: i32 = 5;
/// No OpenCL device, or a device that failed.
pub const COPHASE_DEVICE: i32 = 6;
/// Call stopped by a cancel call.
pub const COPHASE_INTERRUPTED: i32 = 7;
/// Error of the library itself; please report it.
pub const COPHASE_INTERNAL: i32 = 8;
/// Unusable argument: NULL, misaligned, not UTF-8, a struct_size that no version has.
pub const COPHASE_BAD_ARGUMENT: i32 = 9;
/// Object in use by another thread; nothing was done.
pub const COPHASE_BUSY: i32 = 10;
/// Panic inside the library, in this call or an earlier one on this object, which can only be
/// destroyed. Please report it.
pub const COPHASE_PANIC: i32 = 11;

/// Image status: fitted, and the model explains the image.
pub const COPHASE_IMAGE_OK: i32 = 100;
/// Image status: fitted, but the residual is larger or smaller than the noise.
pub const COPHASE_IMAGE_MISFIT: i32 = 101;
/// Image status: the residual is so large that the fit is probably in a wrong minimum.
pub const COPHASE_IMAGE_WRONG_MINIMUM: i32 = 102;
/// Image status: the optimizer stopped before it converged.
pub const COPHASE_IMAGE_NOT_CONVERGED: i32 = 103;
/// Image status: the image could not be used; its coefficients are NaN.
pub const COPHASE_IMAGE_UNUSABLE: i32 = 104;
/// Image status: the deadline passed; its coefficients are the best so far.
pub const COPHASE_IMAGE_DEADLINE: i32 = 105;
/// Status of an estimate alone: its images are of several wavefronts, and their mean is of none.
pub const COPHASE_IMAGE_CONTRADICTORY: i32 = 106;

/// Name of the status of a call or of an image, without its prefix: `OK`, `BAD_SCENE`, ..., `OK`,
/// `MISFIT`, ...; `UNKNOWN` for a number of a later version. A static string, never NULL.
#[unsafe(no_mangle)]
pub extern "C" fn cophase_status_name(status: i32) -> *const c_char {
    let name: &CStr = match status {
        COPHASE_OK | COPHASE_IMAGE_OK => c"OK",
        COPHASE_IMAGE_MISFIT => c"MISFIT",
        COPHASE_IMAGE_WRONG_MINIMUM => c"WRONG_MINIMUM",
        COPHASE_IMAGE_NOT_CONVERGED => c"NOT_CONVERGED",
        COPHASE_IMAGE_UNUSABLE => c"UNUSABLE",
        COPHASE_IMAGE_DEADLINE => c"DEADLINE",
        COPHASE_IMAGE_CONTRADICTORY => c"CONTRADICTORY",
        other => Error::status_name(other).unwrap_or(c"UNKNOWN"),
    };
    name.as_ptr()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Constants of this file, their names without COPHASE_.
    fn constants() -> Vec<(&'static str, i32)> {
        let lines = include_str!("status.rs").lines();
        lines
            .filter_map(|line| line.strip_prefix("pub const COPHASE_")?.strip_suffix(';')?.split_once(": i32 = "))
            .map(|(name, number)| (name, number.parse().unwrap()))
            .collect()
    }

    #[test]
    fn constants_are_the_numbers_of_the_errors() {
        // `error.rs` has the numbers; the header generator reads literals only, from this file.
        let all = constants();
        let calls: Vec<_> = all.iter().filter(|(name, _)| !name.starts_with("IMAGE_")).collect();
        assert_eq!(calls[0], &("OK", 0));
        for (position, &&(name, number)) in calls.iter().enumerate().skip(1) {
            assert_eq!(number, position as i32);
            assert_eq!(Error::status_name(number).unwrap().to_str().unwrap(), name);
        }
        assert!(Error::status_name(calls.len() as i32).is_none(), "a kind of failure lacks its constant");
    }

    #[test]
    fn every_status_has_its_name() {
        for (name, number) in constants() {
            let named = unsafe { CStr::from_ptr(cophase_status_name(number)) }.to_str().unwrap();
            assert_eq!(named, name.trim_start_matches("IMAGE_"));
        }
    }
}
