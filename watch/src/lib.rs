//! Night watch: an estimate of every frame that appears, kept in one file, shown on a page.
//!
//! ```text
//! folder or stream ─ frame ─ FrameEstimator ─ Tracker ─ Store (one transaction) ─ page, log
//! ```
//!
//! One thread takes frames, estimates them and writes the store. Ctrl-C, a kill and a power cut may
//! come at any time: a frame is in the store as a whole or not at all, and what is not there is
//! taken by the next watch.

pub mod arguments;
mod clock;
mod corrections;
mod export;
mod folder;
mod frame_file;
mod live;
mod log;
mod model;
mod page;
mod pointing;
mod report;
mod service;
mod source;
mod store;
mod stream;
mod tracking;
mod watcher;

/// For tests that read the store.
#[doc(hidden)]
pub use store::rusqlite;
