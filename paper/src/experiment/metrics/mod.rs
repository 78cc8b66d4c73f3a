//! Figures of merit of simulated images and of telemetry: Strehl ratios, power spectra.
//!
//! Functions on arrays `[y, x]`, and running averages over telemetry ([`Marechal`], [`PsdAverage`])
//! in constant memory.

mod centre;
mod fft2;
mod psd;
mod psd_average;
mod strehl;

pub use centre::{CentredImage, centre};
pub use psd::{Psd, Rings, control_half_width_per_m};
pub use psd_average::{LARGEST_PADDING, PsdAverage};
pub use strehl::{Marechal, strehl_by_energy, strehl_by_marechal, strehl_by_otf};
