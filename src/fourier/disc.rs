//! Fourier transform of a disc: the diffraction of a round aperture.

use std::f64::consts::{PI, TAU};

/// Power spectrum of a disc over its area's square, at `x` cycles a radius. Its integral over the
/// plane is 1/area.
pub(crate) fn disc(x: f64) -> f64 {
    // J1 by its integral; the trapezoidal rule over a period of an analytic function converges
    // geometrically.
    let (argument, points) = (TAU * x, 64);
    let j1: f64 = (0..points)
        .map(|i| PI * (f64::from(i) + 0.5) / f64::from(points))
        .map(|t| (t - argument * t.sin()).cos())
        .sum::<f64>()
        / f64::from(points);
    if argument < 1e-6 { 1.0 } else { (2.0 * j1 / argument).powi(2) }
}
