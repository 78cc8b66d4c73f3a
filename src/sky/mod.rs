//! Full-phase retrieval, and static errors from a sequence of phases.
//!
//! ```text
//! phases ─ mean ─ generalised least squares ─ pistons, NCPA ─┐
//!   ↑       └ scatter ─ covariance ─┘  ↑                      │
//!   └──────── static phase ────────────┼── calm loop ─────────┘      pass after pass, until one changes nothing
//! ```
//!
//! What a loop has made of the pistons is smooth and pistons are edges, so a covariance like that of turbulence tells one
//! from the other; what the loop answers to them is known by closing it on them alone, without turbulence and noise.

mod amplitudes;
mod calm_loop;
mod commands;
mod convolver;
mod covariance;
mod descent;
mod engine;
mod estimate;
mod evidence;
mod found;
mod linalg;
mod lit;
mod lockstep;
mod ncpa;
mod optics_fit;
mod optics_found;
mod passes;
mod path;
mod phases;
mod precondition;
mod prior;
mod probe;
mod retrieve;
mod retrieved;
mod sampling;
mod segment_tilts;
mod sensed;
mod sensor;
mod sequence;
mod statics;
mod true_phases;
mod worker;

pub use calm_loop::CalmLoop;
pub use commands::Commands;
pub use covariance::{MeanCovariance, ResidualCovariance};
pub use estimate::{SkyImages, knows, read, write};
pub use evidence::{Evidence, Family};
pub use found::FullPhase;
pub use lit::LitSamples;
pub use optics_found::OpticsFound;
pub use passes::{Measured, Pass, PassRecipe, PhaseSource, StaticWavefront, find_statics};
pub use phases::{Phases, RetrievalReport};
pub use prior::{Spectrum, Unknown};
pub use retrieve::{RetrievalRecipe, Retriever, Statics};
pub use retrieved::RetrievedPhases;
pub use segment_tilts::SegmentTilts;
pub use sensed::Sensed;
pub use sensor::SensorModel;
pub use statics::{StaticErrors, StaticModel};
pub use true_phases::TruePhases;

#[cfg(test)]
mod tests;
