//! Linearisation of the forward model: the PSF and its derivatives at one point, some rows of
//! pixels at a time.
//!
//! The derivative by a segment motion is a field on a small box of the pupil. Its transform is a
//! complex product over that box, with `8·b·m·(b + v)` operations for b×b samples and v rows of m
//! pixels; the whole pupil of n×n samples takes `4·n·m·(n + m)`. For one of 800 segments that is a
//! thirtieth, and the cost of some rows is proportional to their number.

use super::cpu::{CpuChain, vectorised};
use super::field::{Change, Field, FieldState};
use super::optics::Optics;
use super::pixels::Pixels;
use crate::fourier::{Sampling, Transform};
use cophase_numerics::product::{Matrix, MatrixMut};
use ndarray::{Array2, ArrayView1, ArrayViewMut1, ArrayViewMut2};
use pulp::NullaryFnOnce;
use rayon::prelude::*;
use std::ops::Range;

/// The model linearised at one point: see [`CpuChain::linearise`].
pub struct LinearModel<'a> {
    chain: &'a CpuChain<f64>,
    colours: Vec<ColourState<'a>>,
    pixels: Option<Pixels<f64>>,
    psf: Vec<f64>,
    /// Rows and columns of the pupil that each segment covers.
    boxes: Vec<[Range<usize>; 2]>,
}

/// The model at one wavelength.
struct ColourState<'a> {
    field: &'a Field<f64>,
    state: FieldState<f64>,
    transform: Transform<f64>,
    /// The focal field, row-planar. By the same transform as the derivatives: others differ by a
    /// phase.
    focus: Vec<f64>,
    waves: Waves,
    samples: usize,
    pixels: usize,
}

impl CpuChain<f64> {
    /// The model linearised at `coefficients_nm`.
    pub fn linearise(&self, coefficients_nm: ArrayView1<f64>) -> LinearModel<'_> {
        let colour = |(optics, field): (Optics, _)| ColourState::at(coefficients_nm, field, optics.sampling());
        let colours: Vec<ColourState> = self.optics().colours().into_iter().zip(self.fields()).map(colour).collect();
        let mut psf = vec![0.0; self.optics().sampling().pixels.pow(2)];
        colours.iter().for_each(|colour| colour.add_psf(&mut psf));
        let pixels = Pixels::of(self.optics());
        if let Some(pixels) = &pixels {
            let mut work = vec![0.0; psf.len()];
            pixels.apply(&mut psf, &mut work);
        }
        LinearModel { chain: self, colours, pixels, psf, boxes: boxes(self.optics()) }
    }
}

/// [`Field::forward`] in the widest vectors of this CPU.
struct Forward<'a> {
    field: &'a Field<f64>,
    coefficients_nm: ArrayView1<'a, f64>,
    state: &'a mut FieldState<f64>,
    pupil: &'a mut [f64],
}

impl NullaryFnOnce for Forward<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        self.field.forward(self.coefficients_nm, self.state, self.pupil);
    }
}

/// [`Field::derivative`] in the widest vectors of this CPU.
struct Derivative<'a> {
    field: &'a Field<f64>,
    change: Change,
    state: &'a FieldState<f64>,
    pupil: &'a mut [f64],
}

impl NullaryFnOnce for Derivative<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        self.field.derivative(self.change, self.state, self.pupil);
    }
}

impl<'a> ColourState<'a> {
    fn at(coefficients_nm: ArrayView1<f64>, field: &'a Field<f64>, sampling: Sampling) -> Self {
        let (n, m) = (sampling.samples, sampling.pixels);
        let transform = Transform::matrix(sampling);
        let mut state = field.state();
        let (mut pupil, mut focus) = (vec![0.0; 2 * n * n], vec![0.0; 2 * m * m]);
        vectorised(Forward { field, coefficients_nm, state: &mut state, pupil: &mut pupil });
        transform.forward(&pupil, &mut focus, &mut transform.workspace());
        Self { field, state, transform, focus, waves: Waves::new(sampling), samples: n, pixels: m }
    }

    /// Adds the derivative of the field in the pupil.
    fn derivative_of_field(&self, change: Change, pupil: &mut [f64]) {
        vectorised(Derivative { field: self.field, change, state: &self.state, pupil });
    }

    fn add_psf(&self, psf: &mut [f64]) {
        let m = self.pixels;
        let lines = self.focus.chunks_exact(2 * m).flat_map(|line| line[..m].iter().zip(&line[m..]));
        psf.iter_mut().zip(lines).for_each(|(psf, (re, im))| *psf += re * re + im * im);
    }

    /// Adds the derivative of the intensity of some rows of pixels.
    fn whole_pupil(&self, change: Change, rows: &Range<usize>, buffers: &mut ThreadBuffers, out: ArrayViewMut1<f64>) {
        let (n, m) = (self.samples, self.pixels);
        let FullPupilBuffers { pupil, focus, workspace } = buffers.whole.get_or_insert_with(|| FullPupilBuffers {
            pupil: vec![0.0; 2 * n * n],
            focus: vec![0.0; 2 * m * m],
            workspace: self.transform.workspace(),
        });
        pupil.fill(0.0);
        self.derivative_of_field(change, pupil);
        self.transform.forward(pupil, focus, workspace);
        self.intensity(rows, &focus[2 * m * rows.start..2 * m * rows.end], out);
    }

    /// As [`ColourState::whole_pupil`], of a change within some rows and columns of the pupil.
    fn patch(
        &self,
        change: Change,
        [ys, xs]: &[Range<usize>; 2],
        rows: &Range<usize>,
        buffers: &mut ThreadBuffers,
        out: ArrayViewMut1<f64>,
    ) {
        let (n, m) = (self.samples, self.pixels);
        let (height, count) = (ys.len(), rows.len());
        // The derivative is written into the whole pupil; only the box is changed, and cleared
        // afterwards.
        self.derivative_of_field(change, &mut buffers.pupil);
        let samples = Matrix::from_rows(&buffers.pupil, n, 2 * n);
        let [d_re, d_im] = [0, n].map(|plane| samples.part(ys.clone(), plane + xs.start..plane + xs.end));
        let [c, s] = [&self.waves.cos, &self.waves.sin].map(|table| Matrix::from_rows(table, n, m));
        let [cx, sx] = [c, s].map(|table| table.part(xs.clone(), 0..m));
        // (re + i·im)(c − i·s) along x, then along y.
        let a = &mut buffers.along_x[..2 * height * m];
        let (re, im) = MatrixMut::from_rows(a, height, 2 * m).split_at_column(m);
        two_products(re, [(1.0, d_re, cx), (1.0, d_im, sx)]);
        two_products(im, [(1.0, d_im, cx), (-1.0, d_re, sx)]);
        let a = Matrix::from_rows(&*a, height, 2 * m);
        let [a_re, a_im] = [0, m].map(|plane| a.part(0..height, plane..plane + m));
        let [cy, sy] = [c, s].map(|table| table.part(ys.clone(), rows.clone()).transpose());
        let u = &mut buffers.along_y[..2 * count * m];
        let (re, im) = MatrixMut::from_rows(u, count, 2 * m).split_at_column(m);
        two_products(re, [(1.0, cy, a_re), (1.0, sy, a_im)]);
        two_products(im, [(1.0, cy, a_im), (-1.0, sy, a_re)]);
        for line in buffers.pupil[2 * n * ys.start..2 * n * ys.end].chunks_exact_mut(n) {
            line[xs.clone()].fill(0.0);
        }
        self.intensity(rows, &buffers.along_y[..2 * count * m], out);
    }

    /// Adds d|U|² = 2 Re(U*·dU) of some rows.
    fn intensity(&self, rows: &Range<usize>, along: &[f64], mut out: ArrayViewMut1<f64>) {
        let m = self.pixels;
        let at = self.focus[2 * m * rows.start..2 * m * rows.end].chunks_exact(2 * m);
        for ((at, along), mut out) in at.zip(along.chunks_exact(2 * m)).zip(out.exact_chunks_mut(m)) {
            for (u, out) in out.iter_mut().enumerate() {
                *out += 2.0 * (at[u] * along[u] + at[m + u] * along[m + u]);
            }
        }
    }
}

impl LinearModel<'_> {
    /// The PSF, m×m.
    pub fn psf(&self) -> &[f64] {
        &self.psf
    }

    /// Number of modes.
    pub fn modes(&self) -> usize {
        self.chain.optics().modes()
    }

    /// Pixels along a side.
    pub fn pixels(&self) -> usize {
        self.chain.optics().sampling().pixels
    }

    /// Writes the derivatives of some rows of pixels by every coefficient, per nm, into `out`:
    /// `[mode, pixel]`, with the pixels of those rows in order.
    ///
    /// # Panics
    /// If `out` has another shape.
    pub fn derivatives(&self, rows: Range<usize>, out: ArrayViewMut2<f64>) {
        assert_eq!(out.dim(), (self.modes(), rows.len() * self.pixels()), "modes and pixels");
        self.write(self.chain.optics().parts().modes.iter().map(|&mode| Change::Mode(mode)), rows, out);
    }

    /// The derivatives by the natural logarithm of the amplitude of each segment,
    /// `[segment, pixel]`.
    pub fn by_amplitudes(&self) -> Array2<f64> {
        let mut out = Array2::zeros((self.boxes.len(), self.pixels().pow(2)));
        self.write((0..self.boxes.len()).map(Change::Amplitude), 0..self.pixels(), out.view_mut());
        out
    }

    /// Writes the derivatives of some rows of pixels by `changes`.
    fn write(&self, changes: impl Iterator<Item = Change>, rows: Range<usize>, mut out: ArrayViewMut2<f64>) {
        let lines: Vec<_> = out.outer_iter_mut().zip(changes).collect();
        lines.into_par_iter().for_each_init(
            || ThreadBuffers::new(self),
            |buffers, (mut out, change)| match &self.pixels {
                None => self.derivative(change, &rows, buffers, out),
                Some(pixels) => {
                    let needed = pixels.needed(&rows);
                    let mut points = std::mem::take(&mut buffers.points);
                    points.resize(needed.len() * self.pixels(), 0.0);
                    self.derivative(change, &needed, buffers, ArrayViewMut1::from(&mut points[..]));
                    let mut lines = out.exact_chunks_mut(self.pixels()).into_iter();
                    pixels.apply_to_rows(&mut points, &rows, &mut buffers.line, |line| {
                        lines.next().into_iter().for_each(|mut out| out.assign(&ArrayView1::from(line)));
                    });
                    buffers.points = points;
                }
            },
        );
    }

    /// Writes the derivative of the intensity at the centres of some rows of pixels into `out`.
    fn derivative(
        &self,
        change: Change,
        rows: &Range<usize>,
        buffers: &mut ThreadBuffers,
        mut out: ArrayViewMut1<f64>,
    ) {
        out.fill(0.0);
        let small = change.segment().filter(|&segment| self.is_small(segment));
        self.colours.iter().for_each(|colour| match small {
            Some(segment) => colour.patch(change, &self.boxes[segment], rows, buffers, out.view_mut()),
            None => colour.whole_pupil(change, rows, buffers, out.view_mut()),
        });
    }

    /// Whether the box of a segment takes fewer operations than the whole pupil.
    fn is_small(&self, segment: usize) -> bool {
        let [ys, xs] = &self.boxes[segment];
        let (n, m) = (self.chain.optics().sampling().samples, self.pixels());
        2 * ys.len() * (xs.len() + m) < n * (n + m)
    }
}

/// Sum of two products, each times a sign.
fn two_products(mut out: MatrixMut, [first, second]: [(f64, Matrix, Matrix); 2]) {
    out.assign_product(first.0, first.1, first.2);
    out.add_product(second.0, second.1, second.2);
}

/// Memory of one thread.
struct ThreadBuffers {
    pupil: Vec<f64>,
    along_x: Vec<f64>,
    along_y: Vec<f64>,
    whole: Option<FullPupilBuffers>,
    /// The derivative at the centres of pixels that have an area, and a row of it.
    points: Vec<f64>,
    line: Vec<f64>,
}

/// Memory of a transform of the whole pupil.
struct FullPupilBuffers {
    pupil: Vec<f64>,
    focus: Vec<f64>,
    workspace: crate::fourier::Workspace<f64>,
}

impl ThreadBuffers {
    fn new(linear: &LinearModel) -> Self {
        let (n, m) = (linear.chain.optics().sampling().samples, linear.pixels());
        let tallest = linear.boxes.iter().map(|[ys, _]| ys.len()).max().unwrap_or(0);
        let (along_x, along_y) = (vec![0.0; 2 * tallest * m], vec![0.0; 2 * m * m]);
        Self { pupil: vec![0.0; 2 * n * n], along_x, along_y, whole: None, points: Vec::new(), line: Vec::new() }
    }
}

/// exp(−2πi·step·(x − (n−1)/2)(u − m/2)), `[sample, pixel]`.
struct Waves {
    cos: Vec<f64>,
    sin: Vec<f64>,
}

impl Waves {
    fn new(sampling: Sampling) -> Self {
        let (n, m) = (sampling.samples, sampling.pixels);
        let angle = |at: usize| {
            let (x, u) = ((at / m) as f64 - (n as f64 - 1.0) / 2.0, (at % m) as f64 - m as f64 / 2.0);
            // Reduced to one turn before it becomes an angle, so that high harmonics keep full
            // precision.
            let turns = sampling.step() * x * u;
            std::f64::consts::TAU * (turns - turns.round())
        };
        let (sin, cos) = (0..n * m).map(|at| angle(at).sin_cos()).unzip();
        Self { cos, sin }
    }
}

/// Rows and columns of the pupil that each segment covers.
fn boxes(optics: &Optics) -> Vec<[Range<usize>; 2]> {
    let (weights, n) = (&optics.parts().weights, optics.sampling().samples);
    let mut boxes = vec![[n..0, n..0]; weights.segments];
    for (cell, segments, _) in weights.rows() {
        for &segment in segments {
            for (range, at) in boxes[segment as usize].iter_mut().zip([cell / n, cell % n]) {
                *range = range.start.min(at)..range.end.max(at + 1);
            }
        }
    }
    // A segment without samples has an empty box.
    boxes.into_iter().map(|ranges| ranges.map(|range| range.start.min(range.end)..range.end)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fourier::PixelResponse;
    use crate::imaging::{Colour, Mode, OpticsParts};
    use crate::pupil::SegmentWeights;
    use std::sync::Arc;

    /// Nine segments in a square of 27×27 samples of 30, each of which overlaps its neighbours by
    /// one sample, and a smooth mode over all of them.
    fn optics(tilts: bool, colours: &[Colour], pixel: [PixelResponse; 2]) -> Arc<Optics> {
        let (n, m, side) = (30, 14, 9);
        let (mut illuminated, mut offsets, mut segment, mut weight) = (Vec::new(), vec![0], Vec::new(), Vec::new());
        for (y, x) in (0..27).flat_map(|y| (0..27).map(move |x| (y, x))) {
            illuminated.push((n * (y + 1) + x + 2) as u32);
            for s in 0..9 {
                let (top, left) = ((s / 3 * side) as i32, (s % 3 * side) as i32);
                let inside = |at: i32, first: i32| (first - 1..first + 10).contains(&at);
                if inside(y as i32, top) && inside(x as i32, left) {
                    segment.push(s as u32);
                    weight.push(0.4 + 0.3 * ((x * 7 + y * 3 + s) as f64).sin());
                }
            }
            offsets.push(weight.len() as u32);
        }
        let slope = |seed: f64| (0..weight.len()).map(|i| (seed * i as f64).cos()).collect::<Vec<f64>>();
        let modes_of =
            |s| if tilts { vec![Mode::Piston(s), Mode::Tip(s), Mode::Tilt(s)] } else { vec![Mode::Piston(s)] };
        let parts = OpticsParts {
            products: None,
            sampling: Sampling::new(n, m, 1.9).unwrap(),
            wavelength_nm: 2000.0,
            colours: colours.to_vec(),
            pixel,
            diversity_nm: (0..illuminated.len()).map(|p| 900.0 * (0.02 * p as f64).sin()).collect(),
            basis: Array2::from_shape_fn((1, illuminated.len()), |(_, p)| (0.05 * p as f64).cos()),
            modes: (0..9).flat_map(modes_of).chain([Mode::Smooth(0)]).collect(),
            slopes: Some((slope(0.3), slope(0.7))),
            weights: SegmentWeights {
                segments: 9,
                energy: weight.iter().map(|w| w * w).sum(),
                illuminated,
                offsets,
                segment,
                weight,
            },
        };
        Arc::new(Optics::new(parts).unwrap())
    }

    /// Derivatives from boxes and from the whole pupil agree, all rows at once and in tiles.
    #[test]
    fn derivatives_in_tiles_agree_with_those_of_the_whole_image() {
        let three = [(0.95, 0.3), (1.0, 0.4), (1.04, 0.3)].map(|(ratio, share)| Colour { ratio, share });
        let alone = [Colour::MONOCHROMATIC];
        let points = [PixelResponse::POINT; 2];
        let squares = [1.0, 0.6].map(|width_pixels| PixelResponse { width_pixels, diffusion_pixels: 0.1 });
        for (tilts, colours, pixel) in [
            (false, &alone[..], points),
            (true, &alone, points),
            (false, &three, points),
            (true, &three, points),
            (true, &three, squares),
        ] {
            let chain = CpuChain::<f64>::new(optics(tilts, colours, pixel));
            let modes = chain.optics().modes();
            let at = ndarray::Array1::from_shape_fn(modes, |i| 60.0 * (i as f64 * 1.7).sin());
            let linear = chain.linearise(at.view());
            assert!((0..9).all(|segment| linear.is_small(segment)), "the test needs segments with small boxes");
            let (psf, wanted) = chain.jacobian(at.view());
            let (m, peak) = (linear.pixels(), wanted.iter().fold(0.0f64, |m, v| m.max(v.abs())));
            // Sums of some thousand products, in another order: 1e-13 of the largest leaves an
            // order of magnitude.
            let same = |a: f64, b: f64, scale: f64| (a - b).abs() < 1e-13 * scale;
            let brightest = psf.iter().copied().fold(0.0, f64::max);
            assert!(linear.psf().iter().zip(&psf).all(|(a, b)| same(*a, *b, brightest)));
            // The PSF is of second degree in the amplitudes, so that the difference between one and
            // a half and a half of one is its derivative.
            for (changed, found) in linear.by_amplitudes().outer_iter().enumerate() {
                let with_factor = |factor: f64| {
                    let mut parts = chain.optics().parts().clone();
                    let entries = parts.weights.segment.iter().zip(&mut parts.weights.weight);
                    entries.filter(|(own, _)| **own == changed as u32).for_each(|(_, weight)| *weight *= factor);
                    CpuChain::<f64>::new(Arc::new(Optics::new(parts).unwrap())).psf(at.view())
                };
                let pairs = with_factor(1.5).into_iter().zip(with_factor(0.5));
                assert!(pairs.zip(found).all(|((more, less), found)| same(*found, more - less, brightest)), "{tilts}");
            }
            for tile in [m, 5, 1] {
                for first in (0..m).step_by(tile) {
                    let rows = first..m.min(first + tile);
                    let mut found = Array2::from_elem((modes, rows.len() * m), f64::NAN);
                    linear.derivatives(rows.clone(), found.view_mut());
                    let wanted = wanted.slice(ndarray::s![.., rows.start * m..rows.end * m]);
                    assert!(found.iter().zip(wanted).all(|(a, b)| same(*a, *b, peak)), "{tilts} {rows:?}");
                }
            }
        }
    }
}
