//! **cophase** estimates the phasing errors of a telescope's segments and the non-common path aberrations (NCPA) behind its
//! adaptive optics from defocused images of a star: separately, in nanometres, with error bars.
//!
//! # Conventions, the same in every language
//!
//! * **Units** stand in the names. Wavefronts and mode coefficients are `_nm` of optical path difference (wavefront, not
//!   mirror surface), lengths `_m`, time `_s`, angles on the sky `_mas`, signal `_e` (electrons). Phase exists only
//!   inside the imaging chains.
//! * **Arrays** are `[row = y, col = x]` in C order. A pupil grid of N samples over `width_m` has
//!   `x_j = (j − (N−1)/2)·width_m/N`: the axis lies between the two central samples.
//! * **Sign**: field `E = A·exp(+i·2π·W/λ)`, `W` the wavefront plus the diversity; focal field = forward Fourier
//!   transform (kernel `exp(−2πi·u·x)`). A wavefront that grows along +x moves the spot along +column.
//! * **Image**: the optical axis is on pixel `[rows/2, columns/2]`; `samples_per_lambda_over_d` counts pixels per λ/`grid_m`.
//!   The PSF over an unbounded detector sums to 1; an image is `flux·PSF + background`, in electrons.
//! * **Modes**: a segment-piston coefficient is nm of piston of that segment; a Zernike or Karhunen-Loève coefficient is
//!   nm RMS over the pupil. The segment part is reported with zero mean piston over the pupil.
//!
//! # An estimate
//!
//! ```
//! use cophase::{Estimator, Images, Scene};
//!
//! # fn main() -> cophase::Result<()> {
//! let scene = Scene::preset("keck-artificial")?;
//! # let scene = scene.with(&[("pupil.samples", "48"), ("modes.ncpa", "none"), ("modes.exact_zernikes", "[2, 4]")])?;
//! let images = Images::simulated(&scene)?; // or Images::read("images.fits", None)?, Images::new(array)
//! let estimate = Estimator::new(&scene)?.estimate(&images)?;
//! println!("{}", estimate.report());
//! # Ok(())
//! # }
//! ```
//!
//! Every interface (the program, C, Python, MATLAB) calls [`pipeline`]. The other modules are its parts, from the telescope to
//! the optimiser; `ARCHITECTURE.md` says which module uses which.

#![deny(missing_docs)]

mod agreement;
pub mod ao;
mod atomic;
pub mod capi;
pub mod device;
mod error;
mod fault;
mod fourier;
mod grid;
mod hexagons;
pub mod imaging;
pub mod io;
mod linear_algebra;
mod loop_response;
pub mod machine;
pub mod metrics;
pub mod modal;
pub mod modes;
pub mod optimize;
pub mod pipeline;
pub mod planner;
pub mod pupil;
pub mod reduction;
mod retrieval;
pub mod scene;
pub mod source;
mod statics;
mod statistics;
pub mod telescope;
pub mod tracking;

pub use error::{Error, Result};
pub use pipeline::{Control, Estimate, Estimator, Images, Policy};
pub use scene::Scene;
