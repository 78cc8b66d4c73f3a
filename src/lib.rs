//! **cophase** estimates the phasing errors of a telescope's segments and the non-common path
//! aberrations (NCPA) behind its adaptive optics from defocused images of a star: separately, in
//! nanometres, with error bars.
//!
//! # Conventions, the same in every language
//!
//! * **Units** stand in the names. Wavefronts and mode coefficients are `_nm` of optical path
//!   difference (wavefront, not mirror surface), lengths `_m`, time `_s`, angles on the sky `_mas`,
//!   signal `_e` (electrons). Phase exists only inside the imaging chains.
//! * **Arrays** are `[row = y, col = x]` in C order. A pupil grid of N samples over `width_m` has
//!   `x_j = (j − (N−1)/2)·width_m/N`: the axis lies between the two central samples.
//! * **Sign**: field `E = A·exp(+i·2π·W/λ)`, `W` the wavefront plus the diversity; focal field =
//!   forward Fourier transform (kernel `exp(−2πi·u·x)`). A wavefront that grows along +x moves the
//!   spot along +column.
//! * **Image**: the optical axis is on pixel `[rows/2, columns/2]`; `samples_per_lambda_over_d`
//!   counts pixels per λ/`grid_m`. The PSF over an unbounded detector sums to 1; an image is
//!   `flux·PSF + background`, in electrons.
//! * **Modes**: a segment-piston coefficient is nm of piston of that segment; a Zernike or
//!   Karhunen-Loève coefficient is nm RMS over the pupil. The segment part is reported with zero
//!   mean piston over the pupil.
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
//! for (name, nm) in estimate.basis.names.iter().zip(&estimate.modes.coefficients_nm) {
//!     println!("{name}: {nm:.2} nm");
//! }
//! # Ok(())
//! # }
//! ```
//!
//! A scene is TOML text that describes telescope, camera and estimate: [`Scene::preset`] has some
//! built in, [`Scene::from_file`] reads one, and `cophase scene --reference` lists all keys.
//! `docs/rust.md` has more.
//!
//! # What is here
//!
//! | Task | Items |
//! |---|---|
//! | images to an estimate | [`Scene`], [`Images`], [`Estimator`], [`Estimate`]; the types of its fields are in [`pipeline`] |
//! | progress, cancellation, the choices of an estimate | [`Control`], [`Policy`] |
//! | corrections of segments and mirror | [`Estimate::corrections`], [`pipeline::Corrections`] |
//! | frames with a deadline, without allocation | [`Session`] of [`ChannelFitters`] |
//! | the running estimate of a sequence | [`Accumulator`] |
//! | a telescope as arrays | [`ModalFitter::from_arrays`] |
//! | drift, jumps and corrections of a night | [`tracking::Tracker`] |
//! | simulated images, with their truth | [`simulate`], [`Simulator`], [`Stepper`] |
//! | plan of a model or of an observation | [`planner`], [`pipeline::plan_observation`] |
//!
//! These are the interface that versions keep. The feature `internals` makes the parts public
//! (`imaging`, `modal`, `telescope`, …), which the programs and experiments of this repository use;
//! it has no promise. `ARCHITECTURE.md` says which module uses which.

#![deny(missing_docs)]
// Parts have items that only the programs and experiments use.
#![cfg_attr(not(feature = "internals"), allow(dead_code, unused_imports, rustdoc::private_intra_doc_links))]

mod agreement;
mod atomic;
#[doc(hidden)]
pub mod capi;
mod empirical_bayes;
mod error;
mod fault;
mod fourier;
mod grid;
mod hexagons;
mod linear_algebra;
mod loop_response;
pub mod pipeline;
pub mod planner;
mod retrieval;
mod statics;
mod statistics;
pub mod tracking;

#[cfg(not(feature = "internals"))]
mod ao;
#[cfg(feature = "internals")]
pub mod ao;
#[cfg(not(feature = "internals"))]
mod control;
#[cfg(feature = "internals")]
pub mod control;
#[cfg(not(feature = "internals"))]
mod device;
#[cfg(feature = "internals")]
pub mod device;
#[cfg(not(feature = "internals"))]
mod imaging;
#[cfg(feature = "internals")]
pub mod imaging;
#[cfg(not(feature = "internals"))]
mod io;
#[cfg(feature = "internals")]
pub mod io;
#[cfg(not(feature = "internals"))]
mod machine;
#[cfg(feature = "internals")]
pub mod machine;
#[cfg(not(feature = "internals"))]
mod metrics;
#[cfg(feature = "internals")]
pub mod metrics;
#[cfg(not(feature = "internals"))]
mod modal;
#[cfg(feature = "internals")]
pub mod modal;
#[cfg(not(feature = "internals"))]
mod modes;
#[cfg(feature = "internals")]
pub mod modes;
#[cfg(not(feature = "internals"))]
mod optimize;
#[cfg(feature = "internals")]
pub mod optimize;
#[cfg(not(feature = "internals"))]
mod pupil;
#[cfg(feature = "internals")]
pub mod pupil;
#[cfg(not(feature = "internals"))]
mod reduction;
#[cfg(feature = "internals")]
pub mod reduction;
#[cfg(not(feature = "internals"))]
mod scene;
#[cfg(feature = "internals")]
pub mod scene;
#[cfg(not(feature = "internals"))]
mod source;
#[cfg(feature = "internals")]
pub mod source;
#[cfg(not(feature = "internals"))]
mod telescope;
#[cfg(feature = "internals")]
pub mod telescope;

pub use ao::{Recorder, Shot, Simulator, Stepper, Summary};
pub use error::{Error, Result};
pub use imaging::{Choice, Precision};
pub use modal::{
    Accumulator, Arrays, ChannelFitters, FitOptions, FittedImage, GroupResult, ImageReport, ImageResult, ModalFitter,
    RefinedGroup, Refusal, RejectedPixels, RunningEstimate, Session, SessionChannel, SessionOptions, Status,
};
pub use pipeline::{Control, Estimate, Estimator, Images, Policy};
pub use scene::{Channel, Scene};
pub use source::{SourceImages, Truth, simulate};
