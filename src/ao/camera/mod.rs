//! Science camera behind the loop: PSFs of the residual wavefront together with the static
//! aberrations.

mod strehl;
mod view;
mod wavelength;

pub use strehl::strehl_on_axis;
pub use view::{CameraOptics, View};

use crate::Result;
use crate::ao::footprint::{Footprint, LANES};
use crate::ao::phase::unit_phasor;
use crate::machine;
use crate::telescope::{Filter, wavelengths_to};
use ndarray::Array2;
use num_complex::Complex32;
use pulp::{Arch, NullaryFnOnce};
use std::sync::Arc;
use wavelength::{CameraTransform, MonochromaticField, segment_weights};

/// Samples around the illuminated area on which wavefronts are needed: a low-passed edge rings
/// there, and by less than 1 % beyond them.
pub(super) const MARGIN_SAMPLES: usize = 4;

/// Rows of the field that are transformed before they are transposed: a cache line holds 8 complex
/// numbers.
const ROWS_PER_BLOCK: usize = 8;

/// Science camera of one view. Clones share the static field and have work arrays of their own.
#[derive(Clone)]
pub struct ScienceCamera {
    footprint: Footprint,
    rows: usize,
    columns: usize,
    wavelengths: Arc<Vec<MonochromaticField>>,
    field: Vec<Complex32>,
    transform: Vec<Complex32>,
    scratch: Vec<Complex32>,
    arch: Arch,
}

impl ScienceCamera {
    /// Camera of `view`. Its residual wavefronts include the segment errors if [`View::segments`]
    /// is true, and exclude them otherwise.
    ///
    /// # Errors
    /// [`crate::Error::Shape`] for an image wider than the sampling of the pupil allows.
    pub fn new(view: View, optics: &CameraOptics) -> Result<Self> {
        let n = optics.footprint.samples();
        // Light scattered by uncorrected turbulence reaches the corners.
        let corner = 0.5 * (view.rows as f64).hypot(view.columns as f64) / view.samples_per_lambda_over_d;
        let filter = if view.spectrum { optics.filter.clone() } else { Filter::top_hat(view.bandwidth_fraction) };
        let count = wavelengths_to(corner, filter.width());
        // Two maps for each wavelength, and a transform of complex numbers for each column of
        // pixels.
        let longest = n as f64 * view.samples_per_lambda_over_d * (1.0 + filter.width());
        let bytes = 8.0 * ((n * n * count) as f64 + view.columns as f64 * longest.max(n as f64));
        machine::check_memory(
            format_args!("a camera of {count} wavelengths on {n}x{n} samples"),
            bytes as u64,
            "set a smaller image.bandwidth_fraction (or a narrower image.filter_file) or fewer wavefront_sensor.samples_per_lenslet",
        )?;
        let weights = segment_weights(&view, optics)?;
        let wavelengths: Vec<MonochromaticField> = filter
            .wavelengths(count)?
            .into_iter()
            .map(|(ratio, share)| MonochromaticField::new(&view, (view.wavelength_nm * ratio, share), optics, &weights))
            .collect::<Result<_>>()?;
        let longest = wavelengths.iter().map(|field| field.padded(n)).max().unwrap_or(n);
        let scratch = wavelengths.iter().map(|field| field.scratch()).max().unwrap_or(0);
        let zero = Complex32::new(0.0, 0.0);
        Ok(Self {
            footprint: optics.footprint.clone(),
            rows: view.rows,
            columns: view.columns,
            wavelengths: Arc::new(wavelengths),
            field: vec![zero; ROWS_PER_BLOCK * optics.footprint.stride().max(longest)],
            transform: vec![zero; view.columns * longest],
            scratch: vec![zero; scratch],
            arch: Arch::new(),
        })
    }

    /// Number of pixels of an image.
    pub fn pixels(&self) -> usize {
        self.rows * self.columns
    }

    /// Adds the PSF of `residual_nm`, a map over the footprint, to `sum`, `[x, y]` (columns first:
    /// see [`ScienceCamera::to_image`]). A PSF sums to 1 over an unbounded detector.
    pub fn add(&mut self, residual_nm: &[f32], sum: &mut [f32]) {
        for static_field in self.wavelengths.clone().iter() {
            self.transform_rows(static_field, residual_nm);
            let n = self.footprint.samples();
            let (padded, rows) = (static_field.padded(n), self.rows);
            for (line, out) in self.transform.chunks_exact_mut(padded).zip(sum.chunks_exact_mut(rows)) {
                match &static_field.transform {
                    CameraTransform::Fft(fft) => {
                        fft.process_with_scratch(line, &mut self.scratch);
                        for (v, out) in out.iter_mut().enumerate() {
                            *out += static_field.scale * line[frequency_index(v, rows, padded)].norm_sqr();
                        }
                    }
                    CameraTransform::Matrix { y, .. } => {
                        let line = ndarray::aview1(&line[..n]);
                        for (row, out) in y.rows().into_iter().zip(out) {
                            *out += static_field.scale * row.dot(&line).norm_sqr();
                        }
                    }
                }
            }
        }
    }

    /// Transforms the field of each row along x and stores it transposed, `[u][y]`, padded with
    /// zeros. Rows are processed in blocks of [`ROWS_PER_BLOCK`], so that a column is written one
    /// cache line at a time.
    fn transform_rows(&mut self, static_field: &MonochromaticField, residual_nm: &[f32]) {
        let zero = Complex32::new(0.0, 0.0);
        let n = self.footprint.samples();
        let padded = static_field.padded(n);
        self.transform[..self.columns * padded].fill(zero);
        let width = self.field.len() / ROWS_PER_BLOCK;
        for first in (0..n).step_by(ROWS_PER_BLOCK) {
            let rows = first..(first + ROWS_PER_BLOCK).min(n);
            if rows.clone().all(|y| self.footprint.span(y).is_empty()) {
                continue;
            }
            self.field.fill(zero);
            for y in rows.clone() {
                self.fill_row(static_field, residual_nm, y, (y - first) * width);
            }
            let rows = rows.len();
            match &static_field.transform {
                CameraTransform::Fft(fft) => {
                    for row in self.field.chunks_exact_mut(width).take(rows) {
                        fft.process_with_scratch(&mut row[..padded], &mut self.scratch);
                    }
                    for u in 0..self.columns {
                        let from = frequency_index(u, self.columns, padded);
                        let line = &mut self.transform[u * padded + first..][..rows];
                        for (out, row) in line.iter_mut().zip(self.field.chunks_exact(width)) {
                            *out = row[from];
                        }
                    }
                }
                CameraTransform::Matrix { x, .. } => {
                    for (u, weights) in x.rows().into_iter().enumerate() {
                        let line = &mut self.transform[u * padded + first..][..rows];
                        for (out, row) in line.iter_mut().zip(self.field.chunks_exact(width)) {
                            *out = weights.dot(&ndarray::aview1(&row[..n]));
                        }
                    }
                }
            }
        }
    }

    /// Writes the field of row `y` at position `start` of the present block.
    fn fill_row(&mut self, static_field: &MonochromaticField, residual_nm: &[f32], y: usize, start: usize) {
        let span = self.footprint.span(y);
        let place = y * self.footprint.stride() + span.start..y * self.footprint.stride() + span.end;
        self.arch.dispatch(ApplyPhase {
            turns_per_nm: static_field.turns_per_nm,
            residual_nm: &residual_nm[place.clone()],
            re: &static_field.re[place.clone()],
            im: &static_field.im[place],
            field: &mut self.field[start + span.start..start + span.end],
        });
    }

    /// Transposes a sum of [`ScienceCamera::add`] into an image `[y, x]`.
    pub fn to_image(&self, sum: &[f32]) -> Array2<f32> {
        Array2::from_shape_fn((self.rows, self.columns), |(y, x)| sum[x * self.rows + y])
    }

    /// Computes the PSF of one residual wavefront, `[y, x]`.
    pub fn psf(&mut self, residual_nm: &[f32]) -> Array2<f32> {
        let mut sum = vec![0.0; self.pixels()];
        self.add(residual_nm, &mut sum);
        self.to_image(&sum)
    }
}

/// Index in a transform of length `padded` of pixel `u` of an image whose axis is on pixel
/// `pixels/2`.
fn frequency_index(u: usize, pixels: usize, padded: usize) -> usize {
    (u + padded - pixels / 2) % padded
}

/// Kernel: multiplies part of a row of the static field by the phasor of the residual wavefront.
struct ApplyPhase<'a> {
    turns_per_nm: f32,
    residual_nm: &'a [f32],
    re: &'a [f32],
    im: &'a [f32],
    field: &'a mut [Complex32],
}

impl NullaryFnOnce for ApplyPhase<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let planes = self.re.as_chunks::<LANES>().0.iter().zip(self.im.as_chunks::<LANES>().0);
        let blocks = self.field.as_chunks_mut::<LANES>().0.iter_mut().zip(self.residual_nm.as_chunks::<LANES>().0);
        for ((field, residual_nm), (re, im)) in blocks.zip(planes) {
            let (mut cos, mut sin) = ([0.0f32; LANES], [0.0f32; LANES]);
            for l in 0..LANES {
                (cos[l], sin[l]) = unit_phasor(residual_nm[l] * self.turns_per_nm);
            }
            for l in 0..LANES {
                field[l] = Complex32::new(re[l] * cos[l] - im[l] * sin[l], re[l] * sin[l] + im[l] * cos[l]);
            }
        }
    }
}
