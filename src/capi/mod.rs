//! C interface, ABI version 1: handles, one fence around every call, arrays of the caller's,
//! structs that grow.
//!
//! `include/cophase.h` and `include/cophase_simulator.h` are made of the files of this module by
//! cbindgen, in the order of the templates `cophase.h.in` and `cophase_simulator.h.in`
//! (`tests/header.rs` makes them again and compares). The comments of functions and structs are the
//! documentation that C programmers read. `handle` holds the fence.

// The header says in prose what a caller owes, for readers who do not know Rust.
#![allow(clippy::missing_safety_doc)]
// Nor are its brackets links: [RT] marks a call.
#![allow(rustdoc::broken_intra_doc_links)]

mod calibration;
mod correction;
mod estimate;
mod estimate_handle;
mod estimator;
mod failure;
mod group_report;
mod handle;
mod image_report;
mod input;
mod library;
mod model;
mod pointer;
mod policy;
mod sequence;
mod session;
mod session_options;
mod simulator;
mod sized;
mod status;
mod text;
mod version;

pub use calibration::cophase_calibration;
pub use correction::*;
pub use estimate::*;
pub use estimate_handle::cophase_estimate;
pub use estimator::*;
pub use failure::cophase_last_error;
pub use group_report::cophase_group_report;
pub use image_report::cophase_image_report;
pub use input::{COPHASE_F32, COPHASE_F64, COPHASE_I32, COPHASE_U8, COPHASE_U16, cophase_input};
pub use library::{cophase_device_list, cophase_scene_preset};
pub use model::*;
pub use policy::*;
pub use sequence::*;
pub use session::*;
pub use session_options::*;
pub use simulator::*;
pub use status::*;
pub use text::*;
pub use version::{COPHASE_ABI_VERSION, cophase_abi_version, cophase_version};
