//! The figures of sections 4 and 5 of the paper, one file each, from our own adaptive optics.
//!
//! ```text
//! setup ─┬─ layers                       what goes in
//!        ├─ leak                         what the loop makes of the segments alone
//!        └─ estimated ─┬─ modes          what a sequence of images tells
//!                      └─ corrected ─┬─ strehl
//!                                    └─ psd
//! ```

mod leak;
mod setup;

pub use leak::{Leak, LeakCase, LeakDraw, LeakRow, leak};
pub use setup::LoopKind;
