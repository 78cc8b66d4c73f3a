//! Illuminated part of the simulator's grid, stored in rows of whole SIMD vectors.

use super::aligned::AlignedBuffer;
use crate::pupil::Pupil;
use std::ops::Range;
use std::sync::Arc;

/// f32 values in the widest SIMD vector (512 bits). Rows and spans are multiples of it.
pub const LANES: usize = 16;

/// Illuminated part of a square grid. A map over it is a slice of [`Footprint::len`] values, rows
/// `[y, x]` of [`Footprint::stride`] values each ([`Footprint::zeros`] makes one). Values outside
/// the spans are unspecified.
#[derive(Debug, Clone)]
pub struct Footprint {
    samples: usize,
    stride: usize,
    spans: Vec<Range<usize>>,
    /// Shared by the clones: several stages read it in every frame, and one copy fits the cache.
    amplitude: Arc<AlignedBuffer>,
    total: f64,
}

impl Footprint {
    /// Footprint of `pupil`.
    pub fn new(pupil: &Pupil) -> Self {
        Self::with_margin(pupil, 0)
    }

    /// Footprint of `pupil` whose spans include `margin` samples around the illuminated area.
    pub fn with_margin(pupil: &Pupil, margin: usize) -> Self {
        let samples = pupil.grid.samples();
        let stride = samples.next_multiple_of(LANES);
        let mut amplitude = AlignedBuffer::zeros(samples * stride);
        let mut ends = Vec::with_capacity(samples);
        for (row, out) in pupil.amplitude.rows().into_iter().zip(amplitude.chunks_exact_mut(stride)) {
            for (out, &a) in out.iter_mut().zip(row) {
                *out = a as f32;
            }
            ends.push(row.iter().position(|&a| a > 0.0).zip(row.iter().rposition(|&a| a > 0.0)));
        }
        let near = |y: usize| ends[y.saturating_sub(margin)..samples.min(y + margin + 1)].iter().flatten();
        let span = |y: usize| match (near(y).map(|ends| ends.0).min(), near(y).map(|ends| ends.1).max()) {
            (Some(first), Some(last)) => {
                let end = samples.min(last + 1 + margin).next_multiple_of(LANES);
                first.saturating_sub(margin) / LANES * LANES..end
            }
            _ => 0..0,
        };
        let spans = (0..samples).map(span).collect();
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

    /// Columns of row `y` that hold its illuminated samples and the margin. Both ends are multiples
    /// of [`LANES`]; the span of a dark row is empty.
    pub fn span(&self, y: usize) -> Range<usize> {
        self.spans[y].clone()
    }

    /// Pupil amplitude, a map: the illuminated fraction of each sample's area; 0 outside the pupil.
    pub fn amplitude(&self) -> &[f32] {
        &self.amplitude
    }

    /// Sum of the amplitude.
    pub fn total(&self) -> f64 {
        self.total
    }

    /// A map of zeros.
    pub fn zeros(&self) -> AlignedBuffer {
        AlignedBuffer::zeros(self.len())
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
        let pupil = Telescope::new(&scene).unwrap().pupil;
        let footprint = Footprint::new(&pupil);
        let mut inside = 0.0;
        for y in 0..footprint.samples() {
            let span = footprint.span(y);
            assert!(span.start.is_multiple_of(LANES) && span.end.is_multiple_of(LANES));
            assert!(span.end <= footprint.stride());
            inside += footprint.amplitude()[y * footprint.stride()..][span].iter().sum::<f32>();
        }
        // Single precision: 9,000 terms of at most 1.
        assert!((f64::from(inside) / pupil.weight_sum() - 1.0).abs() < 1e-5);
        let (wider, margin) = (Footprint::with_margin(&pupil, 5), 5);
        let near = |y: usize, x: usize| {
            let rows = y.saturating_sub(margin)..(y + margin + 1).min(120);
            rows.into_iter()
                .any(|v| (x.saturating_sub(margin)..(x + margin + 1).min(120)).any(|u| pupil.amplitude[[v, u]] > 0.0))
        };
        assert!((0..120 * 120).all(|at| !near(at / 120, at % 120) || wider.span(at / 120).contains(&(at % 120))));
        assert!((0..120).all(|y| wider.span(y).end <= wider.stride()));
    }
}
