//! Weights of the segments in the samples: by owner and by area. `band_limit` has the accurate
//! model.

use super::aperture::Aperture;
use super::sampled::Pupil;
use crate::Result;
use crate::grid::Grid;
use ndarray::Array2;

/// Weight of each segment in each illuminated sample: `E_p = e^{ikψ_p} Σ_s w_ps e^{ik c_s}`.
/// Compressed sparse rows over the illuminated samples.
#[derive(Debug, Clone)]
pub struct SegmentWeights {
    /// Number of segments.
    pub segments: usize,
    /// Flat grid index `y·samples + x` of each illuminated sample, ascending.
    pub illuminated: Vec<u32>,
    /// Row starts into `segment` and `weight`; `illuminated.len() + 1` entries.
    pub offsets: Vec<u32>,
    /// Segment of each entry.
    pub segment: Vec<u32>,
    /// Weight of each entry (may be negative for a band-limited pupil).
    pub weight: Vec<f64>,
    /// Σ over the aperture of amplitude², in units of this grid's samples, of the unfiltered pupil.
    /// It normalises the PSF to a sum of 1 over an unbounded detector.
    pub energy: f64,
}

impl SegmentWeights {
    /// The basic model: each sample belongs to its owner only, with the amplitude of the pupil. The
    /// energy is Σ A².
    pub fn hard(pupil: &Pupil) -> Self {
        let mut columns = vec![Vec::new(); pupil.segments.len()];
        for (cell, (&amplitude, &owner)) in pupil.amplitude.iter().zip(&pupil.owner).enumerate() {
            if amplitude > 0.0 && owner >= 0 {
                columns[owner as usize].push((cell as u32, amplitude));
            }
        }
        let energy = pupil.amplitude.iter().map(|a| a * a).sum();
        Self::from_columns(pupil.grid.samples(), &columns, energy)
    }

    /// The exact fraction of each sample's area that each segment covers. The energy is the area of
    /// the mirror in samples.
    ///
    /// # Errors
    /// Those of [`Aperture::pupil`].
    pub fn area(aperture: &Aperture, grid: &Grid) -> Result<Self> {
        Ok(Self::from_columns(grid.samples(), &aperture.shares(grid)?, aperture.energy(grid)))
    }

    /// The entries of each illuminated sample, in the order of `illuminated`: (flat grid index,
    /// segments, weights).
    pub fn rows(&self) -> impl Iterator<Item = (usize, &[u32], &[f64])> + '_ {
        self.illuminated.iter().zip(self.offsets.windows(2)).map(|(&cell, ends)| {
            let entries = ends[0] as usize..ends[1] as usize;
            (cell as usize, &self.segment[entries.clone()], &self.weight[entries])
        })
    }

    /// The weights of one segment as a map `[y, x]` on a grid of `samples` a side; 0 outside the
    /// segment.
    pub fn map(&self, segment: usize, samples: usize) -> Array2<f64> {
        let mut map = Array2::zeros((samples, samples));
        for (cell, segments, weights) in self.rows() {
            for (_, weight) in segments.iter().zip(weights).filter(|(s, _)| **s as usize == segment) {
                map[[cell / samples, cell % samples]] += weight;
            }
        }
        map
    }

    /// Converts lists of `(y·samples + x, weight)` per segment into rows over the illuminated
    /// samples.
    pub(super) fn from_columns(samples: usize, columns: &[Vec<(u32, f64)>], energy: f64) -> Self {
        let mut count = vec![0u32; samples * samples];
        for &(cell, _) in columns.iter().flatten() {
            count[cell as usize] += 1;
        }
        let illuminated: Vec<u32> = (0..).zip(&count).filter(|(_, count)| **count > 0).map(|(cell, _)| cell).collect();
        let mut offsets = Vec::with_capacity(illuminated.len() + 1);
        let mut next = vec![0u32; samples * samples];
        let mut total = 0;
        for &cell in &illuminated {
            offsets.push(total);
            next[cell as usize] = total;
            total += count[cell as usize];
        }
        offsets.push(total);
        let mut segment = vec![0; total as usize];
        let mut weight = vec![0.0; total as usize];
        for (index, &(cell, value)) in (0u32..).zip(columns).flat_map(|(s, list)| list.iter().map(move |e| (s, e))) {
            let at = &mut next[cell as usize];
            segment[*at as usize] = index;
            weight[*at as usize] = value;
            *at += 1;
        }
        Self { segments: columns.len(), illuminated, offsets, segment, weight, energy }
    }
}

impl Aperture {
    /// Illuminated area in samples of `grid`: Σ amplitude² of a pupil whose amplitude is 0 or 1.
    pub(super) fn energy(&self, grid: &Grid) -> f64 {
        self.segment_areas_m2().iter().sum::<f64>() / grid.pitch_m().powi(2)
    }
}
