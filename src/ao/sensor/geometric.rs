//! Geometric sensor: mean slopes of the wavefront over the illuminated area of each lenslet,
//! without diffraction or noise.

use super::lenslets::{Lenslets, MAS_PER_NM_M};
use crate::ao::footprint::Footprint;
use crate::grid::Grid;

/// Geometric slopes of all subapertures.
#[derive(Clone)]
pub(super) struct Geometric {
    lenslets: Lenslets,
    footprint: Footprint,
    stride: usize,
    mas_per_nm: f32,
}

impl Geometric {
    pub(super) fn new(lenslets: &Lenslets, grid: &Grid, footprint: &Footprint) -> Self {
        Self {
            lenslets: lenslets.clone(),
            footprint: footprint.clone(),
            stride: footprint.stride(),
            mas_per_nm: (MAS_PER_NM_M / grid.pitch_m()) as f32,
        }
    }

    /// Mean differences between neighbouring samples, weighted by the smaller of their two
    /// amplitudes.
    pub(super) fn raw_slopes(&self, opd_nm: &[f32], slopes: &mut [f32]) {
        let (n, across, stride) = (self.lenslets.samples, self.lenslets.across, self.stride);
        let count = self.lenslets.subapertures.len();
        let mean = |start: usize, rows: usize, columns: usize, step: usize| {
            let (mut sum, mut weight) = (0.0f32, 0.0f32);
            for y in 0..rows {
                for at in (start + y * stride..).take(columns) {
                    let both = self.footprint.amplitude()[at].min(self.footprint.amplitude()[at + step]);
                    sum += both * (opd_nm[at + step] - opd_nm[at]);
                    weight += both;
                }
            }
            if weight > 0.0 { sum / weight * self.mas_per_nm } else { 0.0 }
        };
        for (i, &subaperture) in self.lenslets.subapertures.iter().enumerate() {
            let start = subaperture / across * n * stride + subaperture % across * n;
            slopes[i] = mean(start, n, n - 1, 1);
            slopes[count + i] = mean(start, n - 1, n, stride);
        }
    }
}
