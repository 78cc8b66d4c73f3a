//! The static field of a camera at one wavelength, and its transform to the focus.

use super::view::{CameraOptics, View, largest_band_cycles};
use crate::ao::aligned::AlignedBuffer;
use crate::pupil::{BandLimit, SegmentWeights};
use crate::{Error, Result};
use cophase_numerics::fft::{Fft, FftDirection, FftReal};
use ndarray::Array2;
use num_complex::Complex32;
use std::sync::Arc;

/// Static field at one wavelength, and its transform.
pub(super) struct MonochromaticField {
    pub(super) turns_per_nm: f32,
    /// Static field over the footprint. It is multiplied by the phasor of the residual wavefront,
    /// which includes the segment errors.
    pub(super) re: AlignedBuffer,
    pub(super) im: AlignedBuffer,
    /// Contribution to the PSF per |transform|².
    pub(super) scale: f32,
    pub(super) transform: CameraTransform,
}

/// Fourier transform of the field.
pub(super) enum CameraTransform {
    /// FFT, if the padded length is a whole number of samples.
    Fft(Arc<dyn Fft<f32>>),
    /// Matrices `[pixel][sample]`, along x and along y.
    Matrix { x: Array2<Complex32>, y: Array2<Complex32> },
}

impl MonochromaticField {
    /// Static field at a wavelength, nm, that carries the given share of the light.
    pub(super) fn new(
        view: &View,
        (wavelength_nm, light_share): (f64, f64),
        optics: &CameraOptics,
        weights: &SegmentWeights,
    ) -> Result<Self> {
        let (grid, stride) = (&optics.pupil.grid, optics.footprint.stride());
        let n = grid.samples();
        // A pixel is a fixed angle: it spans fewer λ/D where λ is longer.
        let per_lambda_over_d = view.samples_per_lambda_over_d * wavelength_nm / view.wavelength_nm;
        let length = n as f64 * per_lambda_over_d;
        let larger = view.rows.max(view.columns);
        if larger as f64 > length {
            return Err(Error::Shape(format!(
                "an image of {larger} pixels at {per_lambda_over_d} pixels per lambda/D is wider than the simulator's {n} samples \
                 allow; at most {} pixels are accepted",
                length as usize / 2 * 2
            )));
        }
        let transform = if length.fract() == 0.0 {
            CameraTransform::Fft(f32::plan(length as usize, FftDirection::Forward))
        } else {
            let along = |pixels: usize| {
                Array2::from_shape_fn((pixels, n), |(u, j)| {
                    let (u, j) = (u as f64 - (pixels / 2) as f64, j as f64 - (n as f64 - 1.0) / 2.0);
                    let (sin, cos) = (-std::f64::consts::TAU * u * j / length).sin_cos();
                    Complex32::new(cos as f32, sin as f32)
                })
            };
            CameraTransform::Matrix { x: along(view.columns), y: along(view.rows) }
        };
        let (mut re, mut im) = (optics.footprint.zeros(), optics.footprint.zeros());
        let phasor = |nm: f64| (std::f64::consts::TAU * (nm / wavelength_nm)).sin_cos();
        let at = |&cell: &u32| (grid.coordinate_m(cell as usize % n), grid.coordinate_m(cell as usize / n));
        let (xs_m, ys_m): (Vec<f64>, Vec<f64>) = weights.illuminated.iter().map(at).unzip();
        let mut smooth_nm = if view.ncpa { optics.truth.ncpa_at(&xs_m, &ys_m)? } else { vec![0.0; xs_m.len()] };
        if view.diversity {
            for (nm, (&x_m, &y_m)) in smooth_nm.iter_mut().zip(xs_m.iter().zip(&ys_m)) {
                *nm += optics.diversity.at(x_m, y_m);
            }
        }
        for ((cell, segments, shares), smooth_nm) in weights.rows().zip(smooth_nm) {
            let (y, x) = (cell / n, cell % n);
            if !optics.footprint.span(y).contains(&x) {
                continue;
            }
            let (x_m, y_m) = (grid.coordinate_m(x), grid.coordinate_m(y));
            let place = y * stride + x;
            let (mut sum_re, mut sum_im) = (0.0, 0.0);
            for (&segment, share) in segments.iter().zip(shares) {
                let own = optics.truth.segment_nm(&optics.telescope.pupil, segment as usize, x_m, y_m);
                let nm = if view.segments { own - f64::from(optics.segments_nm[place]) } else { 0.0 };
                let (sin, cos) = phasor(nm);
                let share = share * optics.truth.amplitude[segment as usize];
                (sum_re, sum_im) = (sum_re + share * cos, sum_im + share * sin);
            }
            let (sin, cos) = phasor(smooth_nm);
            re[place] = (sum_re * cos - sum_im * sin) as f32;
            im[place] = (sum_re * sin + sum_im * cos) as f32;
        }
        let light = weights.energy * optics.truth.throughput(optics.telescope);
        let scale = (light_share / (length * length * light)) as f32;
        Ok(Self { turns_per_nm: (1.0 / wavelength_nm) as f32, re, im, scale, transform })
    }

    /// Length of the transform of a row of `samples`.
    pub(super) fn padded(&self, samples: usize) -> usize {
        match &self.transform {
            CameraTransform::Fft(fft) => fft.len(),
            CameraTransform::Matrix { .. } => samples,
        }
    }

    /// Length of the transform's work array.
    pub(super) fn scratch(&self) -> usize {
        match &self.transform {
            CameraTransform::Fft(fft) => fft.get_inplace_scratch_len(),
            CameraTransform::Matrix { .. } => 0,
        }
    }
}

/// Weights of the segments in the samples: low-passed if the pupil is known on a fine enough grid,
/// else by area.
///
/// Weights by area are a low pass too, but a poor one. At 240 samples over 11.25 m they attenuate
/// an edge by 10 % at the frequencies that reach the rim of an image 120 λ/D wide, and alias 6 % of
/// higher frequencies onto them. Pistons estimated from such images are 3 to 5 % too small.
pub(super) fn segment_weights(view: &View, optics: &CameraOptics) -> Result<SegmentWeights> {
    let (grid, telescope) = (optics.pupil.grid, optics.telescope);
    let needed = view.band_cycles(&telescope.pupil, optics.diversity);
    let pass = needed.min(largest_band_cycles(grid.samples()));
    // A low pass needs a pupil map at least twice as fine as the grid, and samples enough for its
    // transition.
    if pass <= 0.0 || !telescope.is_fine() || telescope.truth_samples() < 2 * grid.samples() {
        return telescope.area_weights(grid);
    }
    telescope.band_limited_weights(grid, &BandLimit::new(pass, grid.samples())?)
}
