//! The C boundary: thin, and single. An `extern "C"` function converts, calls, and converts back.
//!
//! `include/cophase.h` is generated from this room by cbindgen (`tests/header.rs` regenerates and compares it).

mod status;
mod version;

pub use status::cophase_status_name;
pub use version::{cophase_abi_version, cophase_version};
