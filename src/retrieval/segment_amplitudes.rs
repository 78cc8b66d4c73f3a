//! Segment amplitudes as unknowns of a retrieval.
//!
//! A segment's field is `exp(ln a + 2πi·c/λ)`: ln a is to the piston c what a real part is to an
//! imaginary one, so the image has the same Fisher information on it, per radian.

use crate::imaging::{Polynomial, Scratch};

/// Logarithms of the segments' amplitudes in one image, ln a, and their whitened coordinates u.
pub(super) struct SegmentAmplitudes {
    rms: f64,
    /// Illuminated samples of each segment.
    samples: Vec<f64>,
    /// ln a for u = 1, and the weight of u² in the prior.
    scales: Vec<[f64; 2]>,
    ln: Vec<f64>,
}

impl SegmentAmplitudes {
    /// For segments with so many illuminated samples each and amplitudes of prior standard
    /// deviation `rms`; without segments no amplitude varies.
    pub(super) fn new(rms: f64, samples: &[f64]) -> Self {
        Self { rms, samples: samples.to_vec(), scales: vec![[0.0; 2]; samples.len()], ln: vec![0.0; samples.len()] }
    }

    /// Sets the coordinates for an image with information `information_rad2` on the phase of a
    /// sample, rad⁻².
    pub(super) fn begin(&mut self, information_rad2: f64) {
        for (scale, samples) in self.scales.iter_mut().zip(&self.samples) {
            let information = information_rad2 * samples;
            *scale = [1.0 / (information + self.rms.powi(-2)).sqrt(), 1.0 / (1.0 + information * self.rms * self.rms)];
        }
    }

    /// Moves to the coordinates `u`.
    pub(super) fn place(&mut self, u: &[f64]) {
        for ((ln, u), [scale, _]) in self.ln.iter_mut().zip(u).zip(&self.scales) {
            *ln = scale * u;
        }
    }

    /// Sets the amplitudes in `scratch`, where they vary.
    pub(super) fn set_amplitudes<T: Polynomial>(&self, scratch: &mut Scratch<T>) {
        if !self.ln.is_empty() {
            scratch.set_amplitudes(self.ln.iter().map(|ln| ln.exp()));
        }
    }

    /// Returns the prior's term at `u`; turns a gradient by ln a into one by u and adds the
    /// prior's.
    pub(super) fn add_prior(&self, u: &[f64], gradient: &mut [f64]) -> f64 {
        let mut sum = 0.0;
        for ((gradient, u), [scale, prior]) in gradient.iter_mut().zip(u).zip(&self.scales) {
            sum += prior * u * u;
            *gradient = *gradient * scale + 2.0 * prior * u;
        }
        sum
    }

    /// Logarithms at the last place.
    pub(super) fn ln(&self) -> &[f64] {
        &self.ln
    }
}
