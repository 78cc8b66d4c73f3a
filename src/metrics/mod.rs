//! Figures of merit: what is left of a wavefront over the pupil and in its spectrum, what an error bar makes one
//! expect, and how good an image is.
//!
//! Plain functions on arrays `[y, x]`, and averages over telemetry ([`Marechal`], [`PsdAverage`]) whose memory does not
//! grow with it.

mod centre;
mod fft2;
mod psd;
mod psd_average;
mod residual;
mod strehl;

pub use centre::{Centred, centre};
pub use psd::{Psd, Rings, control_half_width_per_m};
pub use psd_average::{LARGEST_PADDING, PsdAverage};
pub use residual::{MapGram, residual_nm};
pub use strehl::{Marechal, strehl_by_energy, strehl_by_marechal, strehl_by_otf};
