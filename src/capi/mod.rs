//! The C boundary: thin, and single. An `extern "C"` function converts, calls, and converts back.
//!
//! `include/cophase.h` is generated from this room by cbindgen (`tests/header.rs` regenerates and compares it). Its
//! comments are the documentation that C programmers read; `handle` holds the fence that every body runs inside.

// The header says in prose what a caller owes, for readers who do not know Rust.
#![allow(clippy::missing_safety_doc)]
// Nor are its brackets links: [RT] marks a call.
#![allow(rustdoc::broken_intra_doc_links)]

mod array;
mod corrections;
mod device;
mod failure;
mod found;
mod full_phase;
mod handle;
mod input;
mod model;
mod options;
mod pointer;
mod report;
mod scene;
mod sequence;
mod session;
mod simulator;
mod sized;
mod status;
mod version;

pub use array::cophase_array_f32;
pub use corrections::*;
pub use device::{cophase_device, cophase_device_close, cophase_device_list, cophase_device_name, cophase_device_open};
pub use failure::cophase_last_error;
pub use found::*;
pub use full_phase::*;
pub use input::{COPHASE_F32, COPHASE_F64, COPHASE_I32, COPHASE_U8, COPHASE_U16, cophase_input};
pub use model::*;
pub use options::*;
pub use report::*;
pub use scene::cophase_scene_preset;
pub use sequence::*;
pub use session::*;
pub use simulator::*;
pub use status::*;
pub use version::{COPHASE_ABI_VERSION, cophase_abi_version, cophase_version};
