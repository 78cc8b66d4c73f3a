//! The samples on which phases are known: where they are, how much glass they hold, and how the segments show in them.

use crate::imaging::{Mode, Optics};
use crate::pupil::SegmentWeights;
use crate::{Error, Result};
use ndarray::Array2;

/// The lit samples of a square grid.
#[derive(Debug, Clone)]
pub struct LitSamples {
    /// Samples along a side of the grid.
    pub samples: usize,
    /// Distance between them, m.
    pub pitch_m: f64,
    /// Flat index `y·samples + x` of each.
    pub places: Vec<usize>,
    /// Where they are along the columns, m.
    pub xs_m: Vec<f64>,
    /// Where they are along the rows, m.
    pub ys_m: Vec<f64>,
    /// How much glass each holds: about 0 to 1, a little beyond where it is low-passed.
    pub glass: Vec<f64>,
    /// Share of each segment in the phase of each sample, `[segment, sample]`: what 1 nm of its piston shows.
    pub pistons: Array2<f64>,
}

impl LitSamples {
    /// Those of `weights`, on a grid of `samples` a side, `pitch_m` apart.
    ///
    /// # Errors
    /// [`Error::Shape`] for a sample outside the grid.
    pub fn of(samples: usize, pitch_m: f64, weights: &SegmentWeights) -> Result<Self> {
        let places: Vec<usize> = weights.lit.iter().map(|&place| place as usize).collect();
        if let Some(place) = places.iter().find(|&&place| place >= samples * samples) {
            return Err(Error::Shape(format!("sample {place} lies outside a grid of {samples}x{samples} samples")));
        }
        let at = |i: usize| (i as f64 - (samples as f64 - 1.0) / 2.0) * pitch_m;
        let mut pistons = Array2::zeros((weights.segments, places.len()));
        let mut glass = vec![0.0; places.len()];
        for (sample, (_, segments, shares)) in weights.rows().enumerate() {
            glass[sample] = shares.iter().sum();
            // As retrieved phases show pistons, to the last digit: edges are what pistons are told by.
            let by = |share: &f64| if glass[sample] > LEAST_GLASS { *share } else { share.abs() };
            let whole: f64 = shares.iter().map(by).sum();
            for (&segment, share) in segments.iter().zip(shares) {
                pistons[[segment as usize, sample]] += by(share) / whole;
            }
        }
        let (xs_m, ys_m) = places.iter().map(|&place| (at(place % samples), at(place / samples))).unzip();
        Ok(Self { samples, pitch_m, places, xs_m, ys_m, glass, pistons })
    }

    /// Number of samples.
    #[allow(clippy::len_without_is_empty)] // a pupil has glass
    pub fn len(&self) -> usize {
        self.places.len()
    }

    /// The samples with at least `least` glass: the phase of those with less is hardly seen by any image.
    pub fn with_glass(&self, least: f64) -> Vec<usize> {
        (0..self.len()).filter(|&sample| self.glass[sample] >= least).collect()
    }

    /// Some of the samples, by index.
    pub fn selected(&self, kept: &[usize]) -> Self {
        let of = |values: &[f64]| kept.iter().map(|&sample| values[sample]).collect();
        Self {
            places: kept.iter().map(|&sample| self.places[sample]).collect(),
            xs_m: of(&self.xs_m),
            ys_m: of(&self.ys_m),
            glass: of(&self.glass),
            pistons: self.pistons.select(ndarray::Axis(1), kept),
            ..*self
        }
    }
}

/// Less glass than this in a sample is the ringing of its neighbours'.
pub(super) const LEAST_GLASS: f64 = 0.1;

/// The wavefront at each lit sample that some coefficients make, nm.
pub(super) fn shown_nm(optics: &Optics, coefficients_nm: &[f64]) -> Vec<f64> {
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
        // Beyond the rim low-passed weights ring about 0, where their mean would mean nothing.
        let own = if whole > LEAST_GLASS { sum / whole } else { sizes[0] / sizes[1] };
        own + smooth.iter().map(|&(row, nm)| nm * parts.basis[[row, p]]).sum::<f64>()
    };
    parts.weights.rows().enumerate().map(at).collect()
}
