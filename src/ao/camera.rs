//! The science camera behind the loop: PSFs of a residual wavefront with the static aberrations, and exposures of them.

use super::footprint::{Footprint, LANES};
use super::lines::Lines;
use super::phase::unit_phasor;
use crate::pupil::{BandLimit, Pupil, SegmentWeights};
use crate::scene::ImageScene;
use crate::source::Truth;
use crate::telescope::{Diversity, Telescope, band, wavelengths_to};
use crate::{Error, Result};
use ndarray::Array2;
use num_complex::Complex32;
use pulp::{Arch, NullaryFnOnce};
use rustfft::{Fft, FftPlanner};
use std::sync::Arc;

/// Samples around the glass on which a low-passed edge rings, and wavefronts are wanted: beyond them it is below 1 %.
pub(super) const MARGIN_SAMPLES: usize = 4;

/// What aberrations and turbulence add to the frequencies of the pupil that shape an image, cycles over the grid.
const ABERRATION_CYCLES: f64 = 8.0;
/// Least room for a low pass between its pass band and the Nyquist frequency, cycles over the grid.
const HALF_TRANSITION: f64 = 12.0;

/// Rows of the field that are transformed before they are turned into columns: a line of the cache holds 8 complex numbers.
const TOGETHER: usize = 8;

/// What the camera looks at and through, beside the residual wavefront of the loop.
#[derive(Debug, Clone, Copy)]
pub struct View {
    /// Whether the segments' errors are there, each with its own weight in the samples at the borders.
    pub segments: bool,
    /// Whether the NCPA are there.
    pub ncpa: bool,
    /// Whether the diversity is there.
    pub diversity: bool,
    /// Wavelength, nm.
    pub wavelength_nm: f64,
    /// Rows of the image; the axis is on pixel `[rows/2, columns/2]`.
    pub rows: usize,
    /// Its columns.
    pub columns: usize,
    /// Pixels per λ/`grid_m` at `wavelength_nm`.
    pub samples_per_lambda_over_d: f64,
    /// Width of the filter as a fraction of the wavelength; 0 for one wavelength.
    pub bandwidth_fraction: f64,
}

impl View {
    /// The scene's defocused images.
    pub fn of(image: &ImageScene) -> Self {
        let (rows, columns) = image.frame_shape();
        Self {
            segments: true,
            ncpa: true,
            diversity: true,
            wavelength_nm: image.wavelength_nm,
            rows,
            columns,
            samples_per_lambda_over_d: image.samples_per_lambda_over_d,
            bandwidth_fraction: image.bandwidth_fraction,
        }
    }
}

/// A camera. Its clones share the static part and have memory of their own.
#[derive(Clone)]
pub struct ScienceCamera {
    footprint: Footprint,
    rows: usize,
    columns: usize,
    colours: Arc<Vec<Colour>>,
    field: Vec<Complex32>,
    transform: Vec<Complex32>,
    scratch: Vec<Complex32>,
    arch: Arch,
}

/// One wavelength.
struct Colour {
    turns_per_nm: f32,
    /// The static field over the map, to be turned by the residual wavefront (which holds the segments' errors).
    re: Lines,
    im: Lines,
    /// What it adds to the PSF per |transform|².
    scale: f32,
    route: Route,
}

/// How the field is transformed.
enum Route {
    /// The padded length is a whole number of samples.
    Fft(Arc<dyn Fft<f32>>),
    /// `[pixel][sample]`, along x and along y.
    Matrix { x: Array2<Complex32>, y: Array2<Complex32> },
}

/// What a camera is made from.
pub struct Optics<'a> {
    /// The telescope.
    pub telescope: &'a Telescope,
    /// Its pupil on the simulator's grid.
    pub pupil: &'a Pupil,
    /// Where that has light.
    pub footprint: &'a Footprint,
    /// The static aberrations.
    pub truth: &'a Truth,
    /// The diversity of the scene.
    pub diversity: &'a Diversity,
    /// The segments' errors over the map, nm, as the residual wavefront holds them.
    pub segments_nm: &'a [f32],
}

impl ScienceCamera {
    /// The camera of `view`. The residual wavefronts it will be given hold the segments' errors if
    /// [`View::segments`] says so, and lack them otherwise.
    ///
    /// # Errors
    /// [`Error::Shape`] for an image wider than the samples of the pupil can carry.
    pub fn new(view: View, optics: &Optics) -> Result<Self> {
        let n = optics.footprint.samples();
        // Speckles of what no loop corrects reach the corners.
        let corner = 0.5 * (view.rows as f64).hypot(view.columns as f64) / view.samples_per_lambda_over_d;
        let count = wavelengths_to(corner, view.bandwidth_fraction);
        let weights = edges(&view, optics)?;
        let colours: Vec<Colour> = band(view.bandwidth_fraction, count)
            .into_iter()
            .map(|(ratio, share)| Colour::new(&view, (view.wavelength_nm * ratio, share), optics, &weights))
            .collect::<Result<_>>()?;
        let longest = colours.iter().map(|colour| colour.padded(n)).max().unwrap_or(n);
        let scratch = colours.iter().map(|colour| colour.scratch()).max().unwrap_or(0);
        let zero = Complex32::new(0.0, 0.0);
        Ok(Self {
            footprint: optics.footprint.clone(),
            rows: view.rows,
            columns: view.columns,
            colours: Arc::new(colours),
            field: vec![zero; TOGETHER * optics.footprint.stride().max(longest)],
            transform: vec![zero; view.columns * longest],
            scratch: vec![zero; scratch],
            arch: Arch::new(),
        })
    }

    /// Pixels of an image: as many as [`ScienceCamera::add`] sums.
    pub fn pixels(&self) -> usize {
        self.rows * self.columns
    }

    /// Adds the PSF of `residual_nm`, a map over the footprint, to `sum`, `[x, y]` (columns first: see
    /// [`ScienceCamera::upright`]). A PSF sums to 1 over an unbounded detector.
    pub fn add(&mut self, residual_nm: &[f32], sum: &mut [f32]) {
        for colour in self.colours.clone().iter() {
            self.columns(colour, residual_nm);
            let n = self.footprint.samples();
            let (padded, rows) = (colour.padded(n), self.rows);
            for (line, out) in self.transform.chunks_exact_mut(padded).zip(sum.chunks_exact_mut(rows)) {
                match &colour.route {
                    Route::Fft(fft) => {
                        fft.process_with_scratch(line, &mut self.scratch);
                        for (v, out) in out.iter_mut().enumerate() {
                            *out += colour.scale * line[unwrapped(v, rows, padded)].norm_sqr();
                        }
                    }
                    Route::Matrix { y, .. } => {
                        let line = ndarray::aview1(&line[..n]);
                        for (row, out) in y.rows().into_iter().zip(out) {
                            *out += colour.scale * row.dot(&line).norm_sqr();
                        }
                    }
                }
            }
        }
    }

    /// The field of each row, transformed along x, into columns `[u][y]`; what lies beyond the samples is 0. Rows go in
    /// [`TOGETHER`], so that a column is written a line of the cache at a time.
    fn columns(&mut self, colour: &Colour, residual_nm: &[f32]) {
        let zero = Complex32::new(0.0, 0.0);
        let n = self.footprint.samples();
        let padded = colour.padded(n);
        self.transform[..self.columns * padded].fill(zero);
        let width = self.field.len() / TOGETHER;
        for first in (0..n).step_by(TOGETHER) {
            let rows = first..(first + TOGETHER).min(n);
            if rows.clone().all(|y| self.footprint.span(y).is_empty()) {
                continue;
            }
            self.field.fill(zero);
            for y in rows.clone() {
                self.turn(colour, residual_nm, y, (y - first) * width);
            }
            let rows = rows.len();
            match &colour.route {
                Route::Fft(fft) => {
                    for row in self.field.chunks_exact_mut(width).take(rows) {
                        fft.process_with_scratch(&mut row[..padded], &mut self.scratch);
                    }
                    for u in 0..self.columns {
                        let from = unwrapped(u, self.columns, padded);
                        let line = &mut self.transform[u * padded + first..][..rows];
                        for (out, row) in line.iter_mut().zip(self.field.chunks_exact(width)) {
                            *out = row[from];
                        }
                    }
                }
                Route::Matrix { x, .. } => {
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

    /// The field of row `y` at `start` of the block in hand.
    fn turn(&mut self, colour: &Colour, residual_nm: &[f32], y: usize, start: usize) {
        let span = self.footprint.span(y);
        let place = y * self.footprint.stride() + span.start..y * self.footprint.stride() + span.end;
        self.arch.dispatch(Turn {
            turns_per_nm: colour.turns_per_nm,
            residual_nm: &residual_nm[place.clone()],
            re: &colour.re[place.clone()],
            im: &colour.im[place],
            field: &mut self.field[start + span.start..start + span.end],
        });
    }

    /// An image `[y, x]` from what [`ScienceCamera::add`] summed.
    pub fn upright(&self, sum: &[f32]) -> Array2<f32> {
        Array2::from_shape_fn((self.rows, self.columns), |(y, x)| sum[x * self.rows + y])
    }

    /// The PSF of one residual wavefront, `[y, x]`.
    pub fn psf(&mut self, residual_nm: &[f32]) -> Array2<f32> {
        let mut sum = vec![0.0; self.pixels()];
        self.add(residual_nm, &mut sum);
        self.upright(&sum)
    }
}

/// How the segments show in the samples: low-passed where the pupil is known finely enough.
///
/// Shares of area are a low pass too, and a poor one: at 240 samples over 11.25 m it takes 10 % off an edge at the frequencies
/// that land on the rim of an image 120 λ/D wide, and folds 6 % of others onto them. Pistons read from such images come out
/// 3 to 5 % too small.
fn edges(view: &View, optics: &Optics) -> Result<SegmentWeights> {
    let (grid, telescope) = (optics.pupil.grid, optics.telescope);
    let n = grid.samples() as f64;
    let half_width = view.rows.max(view.columns) as f64 / (2.0 * view.samples_per_lambda_over_d);
    let spot = if view.diversity { optics.diversity.spot(&telescope.pupil, view.wavelength_nm) } else { 0.0 };
    let pass = (half_width + spot + ABERRATION_CYCLES).min(n / 2.0 - HALF_TRANSITION);
    // A map is to be twice as fine as what is made of it, and a handful of samples has no room for a transition.
    if pass <= 0.0 || !telescope.is_fine() || telescope.truth_samples() < 2 * grid.samples() {
        return telescope.area_weights(grid);
    }
    telescope.band_limited_weights(grid, &BandLimit::new(pass, grid.samples())?)
}

/// Where the transform of length `padded` holds pixel `u` of an image whose axis is its pixel `pixels/2`.
fn unwrapped(u: usize, pixels: usize, padded: usize) -> usize {
    (u + padded - pixels / 2) % padded
}

impl Colour {
    /// Light of one wavelength, nm, that has this share of all.
    fn new(
        view: &View,
        (wavelength_nm, light_share): (f64, f64),
        optics: &Optics,
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
                 carry: at most {} pixels are accepted",
                length as usize / 2 * 2
            )));
        }
        let route = if length.fract() == 0.0 {
            Route::Fft(FftPlanner::new().plan_fft_forward(length as usize))
        } else {
            let along = |pixels: usize| {
                Array2::from_shape_fn((pixels, n), |(u, j)| {
                    let (u, j) = (u as f64 - (pixels / 2) as f64, j as f64 - (n as f64 - 1.0) / 2.0);
                    let (sin, cos) = (-std::f64::consts::TAU * u * j / length).sin_cos();
                    Complex32::new(cos as f32, sin as f32)
                })
            };
            Route::Matrix { x: along(view.columns), y: along(view.rows) }
        };
        let (mut re, mut im) = (optics.footprint.zeros(), optics.footprint.zeros());
        let phasor = |nm: f64| (std::f64::consts::TAU * (nm / wavelength_nm)).sin_cos();
        let at = |&cell: &u32| (grid.coordinate_m(cell as usize % n), grid.coordinate_m(cell as usize / n));
        let (xs_m, ys_m): (Vec<f64>, Vec<f64>) = weights.lit.iter().map(at).unzip();
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
        Ok(Self { turns_per_nm: (1.0 / wavelength_nm) as f32, re, im, scale, route })
    }

    fn padded(&self, samples: usize) -> usize {
        match &self.route {
            Route::Fft(fft) => fft.len(),
            Route::Matrix { .. } => samples,
        }
    }

    fn scratch(&self) -> usize {
        match &self.route {
            Route::Fft(fft) => fft.get_inplace_scratch_len(),
            Route::Matrix { .. } => 0,
        }
    }
}

/// A stretch of the static field, turned by the residual wavefront.
struct Turn<'a> {
    turns_per_nm: f32,
    residual_nm: &'a [f32],
    re: &'a [f32],
    im: &'a [f32],
    field: &'a mut [Complex32],
}

impl NullaryFnOnce for Turn<'_> {
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

/// Strehl ratio of a residual wavefront at `wavelength_nm`: the intensity on the axis over that without aberration.
pub fn strehl_on_axis(footprint: &Footprint, residual_nm: &[f32], wavelength_nm: f64) -> f64 {
    let [re, im] = Arch::new().dispatch(OnAxis { footprint, residual_nm, turns_per_nm: (1.0 / wavelength_nm) as f32 });
    (re * re + im * im) / footprint.total().powi(2)
}

/// Σ A·exp(2πi·W/λ).
struct OnAxis<'a> {
    footprint: &'a Footprint,
    residual_nm: &'a [f32],
    turns_per_nm: f32,
}

impl NullaryFnOnce for OnAxis<'_> {
    type Output = [f64; 2];

    #[inline(always)]
    fn call(self) -> [f64; 2] {
        let Self { footprint, residual_nm, turns_per_nm } = self;
        let stride = footprint.stride();
        let mut field = [0.0; 2];
        for y in 0..footprint.samples() {
            let span = footprint.span(y);
            let place = y * stride + span.start..y * stride + span.end;
            let amplitude = footprint.amplitude()[place.clone()].as_chunks::<LANES>().0;
            let (mut re, mut im) = ([0.0f32; LANES], [0.0f32; LANES]);
            for (a, opd) in amplitude.iter().zip(residual_nm[place].as_chunks::<LANES>().0) {
                let (mut cos, mut sin) = ([0.0f32; LANES], [0.0f32; LANES]);
                for l in 0..LANES {
                    (cos[l], sin[l]) = unit_phasor(opd[l] * turns_per_nm);
                }
                for l in 0..LANES {
                    re[l] = a[l].mul_add(cos[l], re[l]);
                }
                for l in 0..LANES {
                    im[l] = a[l].mul_add(sin[l], im[l]);
                }
            }
            field[0] += f64::from(re.iter().sum::<f32>());
            field[1] += f64::from(im.iter().sum::<f32>());
        }
        field
    }
}
