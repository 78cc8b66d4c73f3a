//! Where the light is on the simulator's grid, in rows of whole vectors.

use super::lines::Lines;
use crate::pupil::Pupil;
use std::ops::Range;
use std::sync::Arc;

/// Samples that one vector instruction takes at best (f32 in 512 bits); rows and spans are multiples of it.
pub const LANES: usize = 16;

/// The lit part of a square grid. A map over it is a slice of [`Footprint::len`] values, rows `[y, x]` of
/// [`Footprint::stride`] values each ([`Footprint::zeros`] makes one); only the samples inside the spans mean anything.
#[derive(Debug, Clone)]
pub struct Footprint {
    samples: usize,
    stride: usize,
    spans: Vec<Range<usize>>,
    /// Shared by its clones: several stages read it in every frame, and the cache is small.
    amplitude: Arc<Lines>,
    total: f64,
}

impl Footprint {
    /// The footprint of `pupil`.
    pub fn of(pupil: &Pupil) -> Self {
        let samples = pupil.grid.samples();
        let stride = samples.next_multiple_of(LANES);
        let mut amplitude = Lines::zeros(samples * stride);
        let mut spans = Vec::with_capacity(samples);
        for (row, out) in pupil.amplitude.rows().into_iter().zip(amplitude.chunks_exact_mut(stride)) {
            for (out, &a) in out.iter_mut().zip(row) {
                *out = a as f32;
            }
            let first = row.iter().position(|&a| a > 0.0);
            let last = row.iter().rposition(|&a| a > 0.0);
            spans.push(match (first, last) {
                (Some(first), Some(last)) => first / LANES * LANES..(last + 1).next_multiple_of(LANES),
                _ => 0..0,
            });
        }
        let total = amplitude.iter().map(|&a| f64::from(a)).sum();
        Self { samples, stride, spans, amplitude: Arc::new(amplitude), total }
    }

    /// Samples along a side.
    pub fn samples(&self) -> usize {
        self.samples
    }

    /// Values from one row to the next: `samples`, rounded up to a multiple of [`LANES`].
    pub fn stride(&self) -> usize {
        self.stride
    }

    /// Values of a map.
    #[allow(clippy::len_without_is_empty)] // a grid has at least one sample
    pub fn len(&self) -> usize {
        self.samples * self.stride
    }

    /// The columns of row `y` that hold all of its light: both ends multiples of [`LANES`], empty where it is dark.
    pub fn span(&self, y: usize) -> Range<usize> {
        self.spans[y].clone()
    }

    /// Fraction of each sample's area that is glass, a map; 0 outside the pupil.
    pub fn amplitude(&self) -> &[f32] {
        &self.amplitude
    }

    /// Sum of the amplitude.
    pub fn total(&self) -> f64 {
        self.total
    }

    /// A map of zeros.
    pub fn zeros(&self) -> Lines {
        Lines::zeros(self.len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;
    use crate::telescope::Telescope;

    #[test]
    fn spans_hold_all_of_the_light_in_whole_vectors() {
        let scene = Scene::preset("keck-onsky").unwrap();
        let pupil = Telescope::of(&scene).unwrap().pupil;
        let footprint = Footprint::of(&pupil);
        let mut inside = 0.0;
        for y in 0..footprint.samples() {
            let span = footprint.span(y);
            assert!(span.start.is_multiple_of(LANES) && span.end.is_multiple_of(LANES));
            assert!(span.end <= footprint.stride());
            inside += footprint.amplitude()[y * footprint.stride()..][span].iter().sum::<f32>();
        }
        // Single precision: 9,000 terms of at most 1.
        assert!((f64::from(inside) / pupil.weight_sum() - 1.0).abs() < 1e-5);
    }
}
