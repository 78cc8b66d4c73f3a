//! The C boundary: thin, and single. An `extern "C"` function converts, calls, and converts back.
//!
//! `include/cophase.h` is generated from this room by cbindgen (`tests/header.rs` regenerates and compares it). Its
//! comments are the documentation that C programmers read; `handle` holds the fence that every body runs inside.

// The header says in prose what a caller owes, for readers who do not know Rust.
#![allow(clippy::missing_safety_doc)]

mod array;
mod failure;
mod handle;
mod pointer;
mod scene;
mod simulator;
mod status;
mod version;

pub use array::cophase_array_f32;
pub use failure::cophase_last_error;
pub use scene::cophase_scene_preset;
pub use simulator::*;
pub use status::*;
pub use version::{COPHASE_ABI_VERSION, cophase_abi_version, cophase_version};
