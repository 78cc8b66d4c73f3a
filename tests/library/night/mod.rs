//! AO simulation against theory: fitting error, lag, noise, bandwidth, stability, Strehl ratio.
//!
//! Runs are short, so the tolerances are the statistical errors of the measured quantities.

mod loops;
mod optics;
mod system;
