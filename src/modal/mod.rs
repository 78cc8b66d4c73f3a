//! Modal fits: segment errors and NCPA as coefficients of modes, fitted to images, in nm with error
//! bars.
//!
//! ```text
//! System ─ Recipe ─ Model ┐
//!                        ├ prepare ─ fit (lock-step over the batch) ─ Fisher ─ combine ─ prior ─ ModalEstimate
//! frames ────────────────┘
//! ```
//!
//! | Room | What is in it |
//! |---|---|
//! | `model` | what does not depend on the images: recipe, modes, pixels, prior, memory |
//! | `prepare` | a frame to an exposure: calibration, outlier pixels, reduction, weights |
//! | `solve` | fits of a batch: engines, metric, optimiser, restarts |
//! | `assess` | χ², status, Fisher matrix and covariance of a fit |
//! | `combine` | fits to one estimate: sequences, channels, whole wavelengths, errors that all share |
//! | `fitter`, `estimate` | the fitter of a model, and the steps of an estimate in turn |
//! | `group` | images of one wavefront fitted together |
//! | `fit_optics` | optical parameters fitted together with the modes |
//! | `session` | fits in real time |
//! | `pointing` | where the star is in an image |
//!
//! [`ModalFitter::new`], or [`ModalFitter::from_arrays`] for a telescope that the caller gives as
//! arrays, builds everything that does not depend on the images; [`ModalFitter::estimate`] takes a
//! cube of images. A [`Session`] fits frames as a camera delivers them, in memory that is allocated
//! once, and an [`Accumulator`] combines its results.

mod assess;
mod combine;
mod estimate;
mod fit_optics;
mod fitter;
mod group;
mod left_out;
mod model;
mod pointing;
mod prepare;
mod session;
mod solve;

pub(crate) use assess::residual::photometry;
pub use assess::status::{ImageReport, Status};
pub use combine::accumulator::{Accumulator, RunningEstimate};
pub use combine::agreement::{Agreement, Verdict};
pub use combine::combined_modes::CombinedModes;
pub(crate) use combine::combined_modes::sigma_nm;
pub use combine::diversity_error::{DiversityProjection, SharedError};
pub(crate) use combine::diversity_error::{ModeProjector, check_reachable, has_diversity, is_weak};
pub(crate) use combine::global_motions::GlobalMotions;
pub use combine::integers::PistonInteger;
pub(crate) use combine::integers::{ColourEstimate, are_determined, resolve_estimates};
pub(crate) use combine::joint::{JointEstimate, combine_estimates, joint};
pub(crate) use combine::pistons::pistons_near;
pub use combine::static_maps::StaticMaps;
pub use combine::{Combination, FittedImage, ModalEstimate};
pub(crate) use estimate::ModalFit;
pub use estimate::image_fits::ImageFits;
pub(crate) use estimate::scene_fitter::fitter_for;
pub use estimate::scene_fitter::fitter_of;
pub(crate) use fit_optics::{OpticsMinimum, OpticsStart, explaining_fit, fit_together};
pub use fitter::ModalFitter;
pub(crate) use group::sequence::Sequence;
pub(crate) use group::stored::{GroupSeries, StoredGroup};
pub(crate) use group::{GroupChannel, GroupEstimate, GroupSequence, Minima, Search, estimate_group};
pub use left_out::ModelError;
pub(crate) use left_out::{SharedFigure, WithLeftOut, camera};
pub use model::Model;
pub use model::arrays::Arrays;
pub use model::memory::{Memory, Tiles};
pub use model::model_cache::ModelCache;
pub(crate) use model::plan::{ABERRATION_CYCLES, LEAST_HALF_WIDTH, SPOT_MARGIN};
pub use model::recipe::Recipe;
pub use pointing::Pointing;
pub(crate) use prepare::calibration::{Calibration, CameraMaps};
pub use prepare::cube::Cube;
pub(crate) use prepare::dead::DeadPixels;
pub use prepare::rejected::RejectedPixels;
pub use prepare::{Frame, Preparation, PreparedFrame, Refusal};
pub(crate) use prepare::{check_frame_shape, cut_out_hint};
pub use session::channel_fitters::ChannelFitters;
pub use session::{FitOptions, GroupResult, ImageResult, RefinedGroup, Session, SessionChannel, SessionOptions};
pub(crate) use solve::fit_series::{FitSeries, StoredFit};
pub(crate) use solve::minimum::Minimum;
pub(crate) use solve::reject_outliers::{CleanedImages, reject_outliers};
