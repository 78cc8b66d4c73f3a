//! Control: mask of subapertures, reconstructor, control law, stability.
//!
//! ```text
//! segment_mask ─┐             ┌ Reconstructor (R) ┐             ┌ Stability   before the first frame
//!               ├ Plant (D) ──┤                   ├ ControlLaw ─┤
//! sensor, mirror┘             └ Inpainting (M) ───┘             └ Controller  one linear step for each frame
//! ```
//!
//! With c the commands, s the slopes of (turbulence − mirror), g the gain and l the leak, the three
//! laws are
//!
//! | `control.loop` | next command |
//! |---|---|
//! | `closed` | (1 − l) c + g R M s |
//! | `pseudo-open-loop` | (1 − l − g) c + g R M (s + D c) |
//! | `full-turbulence-slopes` | (1 − l) c + g R (M (s + D c) − D c) |
//!
//! where M is the inpainting of masked slopes, the identity unless `fill = "inpaint"`. The second
//! law is B. Ellerbroek's (2003), the third the cheaper variant that the paper suggests; with M = 1
//! the third equals the first. All laws are one linear step: a dense matrix, with
//! `control.optical_gains` the same by modes, or with `control.reconstructor = "sparse"` a banded
//! solution of the normal equations of a local interaction matrix.

mod band;
mod controller;
mod inpaint;
mod law;
mod linalg;
mod mask;
mod modal_step;
mod optical_gain;
mod plant;
mod reconstructor;
mod regularized;
mod stability;
mod step;
mod step_map;
#[cfg(test)]
mod testing;
mod windows;

pub use controller::Controller;
pub use inpaint::Inpainting;
pub use law::ControlLaw;
pub(crate) use linalg::{Svd, svd};
pub use mask::segment_mask;
pub(in crate::ao) use optical_gain::OpticalGains;
pub use plant::Plant;
pub use reconstructor::Reconstructor;
pub use regularized::SparseReconstructor;
pub use stability::Stability;

use plant::{check_mask, check_subapertures};
