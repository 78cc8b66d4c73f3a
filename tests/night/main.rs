//! The AO loop against physics: fitting error, lag, noise, bandwidth, stability, Strehl.
//!
//! Runs are short, so every tolerance says how well its quantity is known.

mod loops;
mod optics;
mod system;
