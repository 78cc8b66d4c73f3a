//! Amplitudes of the segments among the unknowns of a retrieval.
//!
//! A segment's field is `exp(ln a + 2πi·c/λ)`: the logarithm of its amplitude is to its piston what a real part is to an
//! imaginary one, moves the light as much, and is as well seen.

use crate::imaging::{Polynomial, Scratch};

/// The logarithms of the amplitudes in one image, and their white numbers.
pub(super) struct Amplitudes {
    rms: f64,
    /// Samples that each segment fills.
    filled: Vec<f64>,
    /// Logarithm for 1 of each white number, and the weight of that number's square in the prior.
    scales: Vec<[f64; 2]>,
    ln: Vec<f64>,
}

impl Amplitudes {
    /// Of segments that fill so many samples each and whose amplitudes are expected to scatter by `rms`; of none, nothing
    /// varies.
    pub(super) fn new(rms: f64, filled: &[f64]) -> Self {
        Self { rms, filled: filled.to_vec(), scales: vec![[0.0; 2]; filled.len()], ln: vec![0.0; filled.len()] }
    }

    /// Takes up an image that tells the phase of a sample to `information_rad2`.
    pub(super) fn begin(&mut self, information_rad2: f64) {
        for (scale, filled) in self.scales.iter_mut().zip(&self.filled) {
            let seen = information_rad2 * filled;
            *scale = [1.0 / (seen + self.rms.powi(-2)).sqrt(), 1.0 / (1.0 + seen * self.rms * self.rms)];
        }
    }

    /// Goes to the white numbers `u`.
    pub(super) fn place(&mut self, u: &[f64]) {
        for ((ln, u), [scale, _]) in self.ln.iter_mut().zip(u).zip(&self.scales) {
            *ln = scale * u;
        }
    }

    /// Has `scratch` hold the amplitudes, where they vary.
    pub(super) fn show<T: Polynomial>(&self, scratch: &mut Scratch<T>) {
        if !self.ln.is_empty() {
            scratch.set_amplitudes(self.ln.iter().map(|ln| ln.exp()));
        }
    }

    /// The prior at `u`; turns a gradient by the logarithms into one by `u`, with the prior's added.
    pub(super) fn add_prior(&self, u: &[f64], gradient: &mut [f64]) -> f64 {
        let mut sum = 0.0;
        for ((gradient, u), [scale, prior]) in gradient.iter_mut().zip(u).zip(&self.scales) {
            sum += prior * u * u;
            *gradient = *gradient * scale + 2.0 * prior * u;
        }
        sum
    }

    /// The logarithms, as they were last placed.
    pub(super) fn ln(&self) -> &[f64] {
        &self.ln
    }
}
