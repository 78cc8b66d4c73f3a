//! The figures of section 4 of the paper, one file each, from our own adaptive optics.
//!
//! ```text
//! setup ─┬─ layers                  what goes in
//!        ├─ leak                    what the loop makes of the segments alone
//!        ├─ modes                   the estimate from a sequence, mode by mode
//!        └─ corrected ─┬─ strehl    what it is worth when the segments are moved
//!                      └─ psd
//! ```

mod corrected;
mod layers;
mod leak;
mod modes;
mod psd;
mod setup;
mod strehl;

pub use corrected::{Amplitude, State};
pub use layers::{LayerRow, Layers, layers};
pub use leak::{Leak, LeakCase, LeakDraw, LeakRow, leak};
pub(super) use leak::{settled_commands_nm, wavefront_maps};
pub use modes::{ModalDraw, Modes, modes};
pub use psd::{Psds, StatePsd, psd};
pub use strehl::{StrehlDraw, Strehls, strehl};
