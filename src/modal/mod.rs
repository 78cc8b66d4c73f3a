//! Modal fits: segment errors and NCPA as coefficients of modes, fitted to images, in nm with error bars.
//!
//! ```text
//! System ─ Recipe ─ Model ┐
//!                        ├ prepare ─ fit (lock-step over the batch) ─ Fisher ─ combine ─ prior ─ ModalEstimate
//! frames ────────────────┘
//! ```
//!
//! [`ModalFitter::new`], or [`ModalFitter::from_arrays`] for a telescope that the caller gives as arrays, builds everything
//! that does not depend on the images; [`ModalFitter::estimate`] takes a cube of images. A [`Session`] fits frames as a camera
//! delivers them, in memory that is allocated once, and an [`Accumulator`] combines its results.

mod accumulator;
mod arrays;
mod band;
mod calibration;
mod channel_fitters;
mod chi2;
mod combine;
mod combined_modes;
mod cube;
mod device;
mod diversity_error;
mod engine;
mod estimate;
mod fisher;
mod fit_optics;
mod fit_series;
mod fitted_optic;
mod fitter;
mod gauss_newton;
mod global_motions;
mod image_fits;
mod in_focus;
mod integers;
mod joint;
mod mean_residual;
mod memory;
mod metrics;
mod minimum;
mod mode_set;
mod model;
mod model_cache;
mod model_memory;
mod outliers;
mod pistons;
mod plan;
mod pointing;
mod prepare;
mod prior;
mod recipe;
mod reject_outliers;
mod rejected;
mod rejection;
mod residual;
mod restart;
mod runner;
mod scene_fit;
mod sequence;
mod session;
mod spread;
mod static_maps;
mod status;
mod tilts;

pub use accumulator::{Accumulator, RunningEstimate};
pub use arrays::Arrays;
pub(crate) use calibration::{Calibration, CameraMaps};
pub use channel_fitters::ChannelFitters;
pub use combine::{Combination, FittedImage, ModalEstimate};
pub use combined_modes::CombinedModes;
pub use cube::Cube;
pub use diversity_error::{DiversityProjection, SharedError};
pub(crate) use diversity_error::{ModeProjector, check_reachable, has_diversity};
pub(crate) use estimate::ModalFit;
pub(crate) use fit_optics::{OpticsMinimum, OpticsStart, explaining_fit, fit_together};
pub(crate) use fit_series::{FitSeries, StoredFit};
pub use fitted_optic::FittedOptic;
pub use fitter::ModalFitter;
pub(crate) use global_motions::GlobalMotions;
pub use image_fits::ImageFits;
pub use integers::PistonInteger;
pub(crate) use integers::{ColourEstimate, are_determined, resolve_estimates};
pub(crate) use joint::{JointEstimate, combine_estimates, joint};
pub use memory::{Memory, Tiles};
pub(crate) use minimum::Minimum;
pub use model::Model;
pub use model_cache::ModelCache;
pub(crate) use pistons::pistons_near;
pub(crate) use plan::{ABERRATION_CYCLES, LEAST_HALF_WIDTH, SPOT_MARGIN};
pub use pointing::Pointing;
pub use prepare::{Frame, Preparation, PreparedFrame, Refusal};
pub(crate) use prepare::{check_frame_shape, cut_out_hint};
pub use recipe::Recipe;
pub(crate) use reject_outliers::{CleanedImages, reject_outliers};
pub use rejected::RejectedPixels;
pub(crate) use residual::photometry;
pub use scene_fit::{OpenChain, estimate_scene, estimate_with};
pub(crate) use scene_fit::{fitter_for, fitter_of};
pub use session::{FitOptions, GroupResult, ImageResult, RefinedGroup, Session, SessionChannel, SessionOptions};
pub use static_maps::StaticMaps;
pub use status::{ImageReport, Status};
