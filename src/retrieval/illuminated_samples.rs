//! Illuminated samples: the samples of the pupil on which a wavefront is retrieved, with their
//! positions, amplitudes and the response to the segments' pistons.

use crate::imaging::{Mode, Optics};
use crate::modes::TiltFrame;
use crate::pupil::SegmentWeights;
use crate::{Error, Result};
use ndarray::Array2;

/// Amplitude below which a sample holds nothing but the ringing of its neighbours' band-limited
/// weights.
const MIN_AMPLITUDE: f64 = 0.1;

/// Illuminated samples of a square grid over the pupil.
#[derive(Debug, Clone)]
pub struct IlluminatedSamples {
    /// Samples along a side of the grid.
    pub samples: usize,
    /// Distance between them, m.
    pub pitch_m: f64,
    /// Flat index `y·samples + x` of each.
    pub indices: Vec<usize>,
    /// Positions along the columns, m.
    pub xs_m: Vec<f64>,
    /// Positions along the rows, m.
    pub ys_m: Vec<f64>,
    /// Pupil amplitude of each: 0 to 1, a little beyond where the pupil is band-limited.
    pub amplitude: Vec<f64>,
    /// Response of the wavefront to 1 nm of each segment's piston, `[segment, sample]`: the
    /// segment's share of the sample.
    pub pistons: Array2<f64>,
}

impl IlluminatedSamples {
    /// The samples of `weights`, on a grid of `samples` a side, `pitch_m` apart.
    ///
    /// # Errors
    /// [`Error::Shape`] for a sample outside the grid.
    pub fn new(samples: usize, pitch_m: f64, weights: &SegmentWeights) -> Result<Self> {
        let indices: Vec<usize> = weights.illuminated.iter().map(|&index| index as usize).collect();
        if let Some(index) = indices.iter().find(|&&index| index >= samples * samples) {
            return Err(Error::Shape(format!("sample {index} lies outside a grid of {samples}x{samples} samples")));
        }
        let at = |i: usize| (i as f64 - (samples as f64 - 1.0) / 2.0) * pitch_m;
        let mut pistons = Array2::zeros((weights.segments, indices.len()));
        let mut amplitude = vec![0.0; indices.len()];
        for (sample, (_, segments, shares)) in weights.rows().enumerate() {
            amplitude[sample] = shares.iter().sum();
            // As in `modal_wavefront_nm`, to the last digit: pistons are identified by their edges.
            let weight = |share: &f64| if amplitude[sample] > MIN_AMPLITUDE { *share } else { share.abs() };
            let whole: f64 = shares.iter().map(weight).sum();
            for (&segment, share) in segments.iter().zip(shares) {
                pistons[[segment as usize, sample]] += weight(share) / whole;
            }
        }
        let (xs_m, ys_m) = indices.iter().map(|&index| (at(index % samples), at(index / samples))).unzip();
        Ok(Self { samples, pitch_m, indices, xs_m, ys_m, amplitude, pistons })
    }

    /// Response of the wavefront to 1 nm RMS of the tip of each segment, then of the tilt of each,
    /// about `frames`: `[mode, sample]`.
    ///
    /// A sample of several segments has their mean by weight, as for pistons. The imaging model
    /// adds the fields of the segments instead: the two differ in the amplitude of such a sample
    /// alone, by half the square of the difference of phases, 2 % where segments with tilts of 20
    /// nm differ by 60 nm at a wavelength of 2 µm.
    pub(crate) fn tilts(&self, frames: &[TiltFrame]) -> Array2<f64> {
        let segments = self.pistons.nrows();
        let mut tilts = Array2::zeros((2 * segments, self.len()));
        for ((segment, sample), &share) in self.pistons.indexed_iter().filter(|(_, share)| **share != 0.0) {
            let at = frames[segment].tilts([self.xs_m[sample], self.ys_m[sample]]);
            for (axis, nm) in at.into_iter().enumerate() {
                tilts[[axis * segments + segment, sample]] = share * nm;
            }
        }
        tilts
    }

    /// Number of samples.
    #[allow(clippy::len_without_is_empty)] // a pupil has illuminated samples
    pub fn len(&self) -> usize {
        self.indices.len()
    }

    /// Selects the samples with an amplitude of `least` or more: images hold next to no information
    /// on the phase of others.
    pub fn select_bright(&self, least: f64) -> Vec<usize> {
        (0..self.len()).filter(|&sample| self.amplitude[sample] >= least).collect()
    }

    /// The subset of the samples `kept`, by index.
    pub fn subset(&self, kept: &[usize]) -> Self {
        let select = |values: &[f64]| kept.iter().map(|&sample| values[sample]).collect();
        Self {
            indices: kept.iter().map(|&sample| self.indices[sample]).collect(),
            xs_m: select(&self.xs_m),
            ys_m: select(&self.ys_m),
            amplitude: select(&self.amplitude),
            pistons: self.pistons.select(ndarray::Axis(1), kept),
            ..*self
        }
    }
}

/// Evaluates the wavefront of coefficients of `optics`, nm at each illuminated sample.
///
/// A sample of several segments has their mean by weight. Beyond the rim the weights of a
/// band-limited pupil ring about 0, where that mean would be undefined: there it is the mean by the
/// weights' moduli.
pub(super) fn modal_wavefront_nm(optics: &Optics, coefficients_nm: &[f64]) -> Vec<f64> {
    let parts = optics.parts();
    let mut poses = vec![[0.0; 3]; parts.weights.segments];
    let mut smooth = Vec::new();
    for (&mode, &nm) in parts.modes.iter().zip(coefficients_nm) {
        match mode {
            Mode::Piston(segment) => poses[segment][0] += nm,
            Mode::Tip(segment) => poses[segment][1] += nm,
            Mode::Tilt(segment) => poses[segment][2] += nm,
            Mode::Smooth(row) => smooth.push((row, nm)),
        }
    }
    let slope = |entry: usize| parts.slopes.as_ref().map_or([0.0; 2], |(x, y)| [x[entry], y[entry]]);
    let mut entry = 0;
    let at = |(p, (_, segments, weights)): (usize, (usize, &[u32], &[f64]))| {
        let (mut sum, mut whole, mut sizes) = (0.0, 0.0, [0.0; 2]);
        for (&segment, &weight) in segments.iter().zip(weights) {
            let ([piston, tip, tilt], [x, y]) = (poses[segment as usize], slope(entry));
            let nm = piston + tip * x + tilt * y;
            (sum, whole) = (sum + weight * nm, whole + weight);
            sizes = [sizes[0] + weight.abs() * nm, sizes[1] + weight.abs()];
            entry += 1;
        }
        let segments_nm = if whole > MIN_AMPLITUDE { sum / whole } else { sizes[0] / sizes[1] };
        segments_nm + smooth.iter().map(|&(row, nm)| nm * parts.basis[[row, p]]).sum::<f64>()
    };
    parts.weights.rows().enumerate().map(at).collect()
}
