//! Versions of the library and of the C interface.

use std::ffi::{CStr, c_char};

/// Version of the C interface. It changes only where a program built against an older header could
/// break.
pub const COPHASE_ABI_VERSION: u32 = 1;

const VERSION: &CStr = match CStr::from_bytes_with_nul(concat!(env!("CARGO_PKG_VERSION"), "\0").as_bytes()) {
    Ok(version) => version,
    Err(_) => panic!("the package's version holds no zero byte"),
};

/// Version of the library, such as "0.1.0". A static string, never NULL.
#[unsafe(no_mangle)]
pub extern "C" fn cophase_version() -> *const c_char {
    VERSION.as_ptr()
}

/// Version of the C interface of the library that is loaded; must be COPHASE_ABI_VERSION of the
/// header.
#[unsafe(no_mangle)]
pub extern "C" fn cophase_abi_version() -> u32 {
    COPHASE_ABI_VERSION
}
