//! Linearisation of the forward model: the PSF and its derivatives at one point, some rows of
//! pixels at a time.
//!
//! The derivative by a segment motion is a field on a small box of the pupil. Its transform is a
//! complex product over that box, with `8·b·m·(b + v)` operations for b×b samples and v rows of m
//! pixels; the whole pupil of n×n samples takes `4·n·m·(n + m)`. For one of 800 segments that is a
//! thirtieth, and the cost of some rows is proportional to their number.

use super::cpu::{CpuChain, vectorised};
use super::detector::LoadedImage;
use super::field::{Change, Field, FieldState, SegmentFigure};
use super::optics::Optics;
use super::pixels::Pixels;
use crate::fourier::{Sampling, Transform};
use cophase_numerics::product::{Matrix, MatrixMut};
use ndarray::{Array2, ArrayView1, ArrayViewMut1, ArrayViewMut2};
use pulp::NullaryFnOnce;
use rayon::prelude::*;
use std::borrow::Cow;
use std::collections::HashMap;
use std::ops::Range;
use std::slice::from_ref;

/// The model linearised at one point: see [`CpuChain::linearise`].
pub struct LinearModel<'a> {
    chain: &'a CpuChain<f64>,
    colours: Vec<ColourState<'a>>,
    pixels: Option<Pixels<f64>>,
    psf: Vec<f64>,
    /// Rows and columns of the pupil that each segment covers.
    boxes: Vec<PupilBox>,
    /// Changes that are no modes, each once.
    changes: Vec<Change>,
    /// Unknowns behind the modes: sums of some of these.
    further: Vec<Vec<usize>>,
}

/// Rows and columns of the pupil.
type PupilBox = [Range<usize>; 2];

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
        let colour = |(optics, field): (Cow<Optics>, _)| ColourState::at(coefficients_nm, field, optics.sampling());
        let colours: Vec<ColourState> = self.optics().colours().into_iter().zip(self.fields()).map(colour).collect();
        let mut psf = vec![0.0; self.optics().sampling().pixels.pow(2)];
        colours.iter().for_each(|colour| colour.add_psf(&mut psf));
        let pixels = Pixels::of(self.optics());
        if let Some(pixels) = &pixels {
            let mut work = vec![0.0; psf.len()];
            pixels.apply(&mut psf, &mut work);
        }
        let boxes = boxes(self.optics());
        LinearModel { chain: self, colours, pixels, psf, boxes, changes: Vec::new(), further: Vec::new() }
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

/// [`Field::adjoint`] in the widest vectors of this CPU.
struct Adjoint<'a> {
    field: &'a Field<f64>,
    pupil_bar: &'a [f64],
    state: &'a mut FieldState<f64>,
    gradient: &'a mut [f64],
}

impl NullaryFnOnce for Adjoint<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        self.field.adjoint(self.pupil_bar, self.state, self.gradient);
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

    /// Adds the derivative of the intensity of some rows of pixels by several changes together.
    fn whole_pupil(
        &self,
        changes: &[Change],
        rows: &Range<usize>,
        buffers: &mut ThreadBuffers,
        out: ArrayViewMut1<f64>,
    ) {
        let (n, m) = (self.samples, self.pixels);
        let FullPupilBuffers { pupil, focus, workspace } = buffers.whole.get_or_insert_with(|| FullPupilBuffers {
            pupil: vec![0.0; 2 * n * n],
            focus: vec![0.0; 2 * m * m],
            workspace: self.transform.workspace(),
        });
        pupil.fill(0.0);
        changes.iter().for_each(|change| self.derivative_of_field(*change, pupil));
        self.transform.forward(pupil, focus, workspace);
        self.intensity(rows, &focus[2 * m * rows.start..2 * m * rows.end], out);
    }

    /// As [`ColourState::whole_pupil`], of a change within some rows and columns of the pupil.
    fn patch(
        &self,
        change: Change,
        [ys, xs]: &PupilBox,
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

    /// Adds the products of `slope`, an image, with the derivatives of the intensity by modes, and
    /// by other changes in turn: with Ē the adjoint transform of slope·U they are 2 Re Σ Ē*·dE over
    /// the pupil.
    fn add_products<'c>(
        &mut self,
        slope: &[f64],
        boxes: &[PupilBox],
        modes: &mut [f64],
        others: impl Iterator<Item = (&'c Change, &'c mut f64)>,
    ) {
        let n = self.samples;
        let mut focus = self.focus.clone();
        LoadedImage::times_slope(slope, &mut focus, self.pixels);
        let (mut pupil_bar, mut pupil) = (vec![0.0; 2 * n * n], vec![0.0; 2 * n * n]);
        self.transform.adjoint(&focus, &mut pupil_bar, &mut self.transform.workspace());
        for (change, product) in others {
            let [ys, xs] = &change.segment().map_or([0..n, 0..n], |segment| boxes[segment].clone());
            self.derivative_of_field(*change, &mut pupil);
            let lines = pupil.chunks_exact_mut(n).zip(pupil_bar.chunks_exact(n));
            // Both planes of a row are lines.
            for (along, bar) in lines.take(2 * ys.end).skip(2 * ys.start) {
                *product += 2.0 * xs.clone().map(|x| along[x] * bar[x]).sum::<f64>();
                along[xs.clone()].fill(0.0);
            }
        }
        let Self { field, state, .. } = self;
        vectorised(Adjoint { field, pupil_bar: &pupil_bar, state, gradient: modes });
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

    /// With `figures` of the segments as unknowns, each of one segment or of several.
    pub fn with_figures(mut self, figures: &[Vec<SegmentFigure>]) -> Self {
        let mut places = HashMap::new();
        let mut place = |figure: &SegmentFigure| {
            *places.entry((figure.segment, figure.terms.map(f64::to_bits))).or_insert_with(|| {
                self.changes.push(Change::Figure(*figure));
                self.changes.len() - 1
            })
        };
        self.further.extend(figures.iter().map(|own| own.iter().map(&mut place).collect::<Vec<_>>()));
        self
    }

    /// With patterns of the logarithm of the amplitude as unknowns: `rows` of the smooth basis.
    pub fn with_light(mut self, rows: Range<usize>) -> Self {
        let first = self.changes.len();
        self.further.extend((first..first + rows.len()).map(|place| vec![place]));
        self.changes.extend(rows.map(Change::Light));
        self
    }

    /// Number of unknowns: modes, and behind them what was added, in its order.
    pub fn unknowns(&self) -> usize {
        self.chain.optics().modes() + self.further.len()
    }

    /// Pixels along a side.
    pub fn pixels(&self) -> usize {
        self.chain.optics().sampling().pixels
    }

    /// Writes the derivatives of some rows of pixels by every unknown, per nm but for those of the
    /// light, into `out`: `[unknown, pixel]`, with the pixels of those rows in order.
    ///
    /// # Panics
    /// If `out` has another shape.
    pub fn derivatives(&self, rows: Range<usize>, out: ArrayViewMut2<f64>) {
        assert_eq!(out.dim(), (self.unknowns(), rows.len() * self.pixels()), "unknowns and pixels");
        let modes: Vec<Change> = self.chain.optics().parts().modes.iter().map(|&mode| Change::Mode(mode)).collect();
        let changes = |own: &Vec<usize>| own.iter().map(|&place| self.changes[place]).collect();
        let further: Vec<Vec<Change>> = self.further.iter().map(changes).collect();
        self.write(modes.iter().map(from_ref).chain(further.iter().map(Vec::as_slice)), rows, out);
    }

    /// The derivatives by the natural logarithm of the amplitude of each segment,
    /// `[segment, pixel]`.
    pub fn by_amplitudes(&self) -> Array2<f64> {
        let mut out = Array2::zeros((self.boxes.len(), self.pixels().pow(2)));
        self.write(self.amplitudes().iter().map(from_ref), 0..self.pixels(), out.view_mut());
        out
    }

    fn amplitudes(&self) -> Vec<Change> {
        (0..self.boxes.len()).map(Change::Amplitude).collect()
    }

    /// Products of `image`, m×m, with the derivatives by every unknown, and with those
    /// [by the amplitudes](Self::by_amplitudes): without them, by one adjoint transform.
    pub fn products(&mut self, image: &[f64]) -> [Vec<f64>; 2] {
        let mut slope = image.to_vec();
        if let Some(pixels) = &self.pixels {
            // The convolution is its own adjoint.
            pixels.apply(&mut slope, &mut vec![0.0; image.len()]);
        }
        let (of_amplitudes, count) = (self.amplitudes(), self.chain.optics().modes());
        let (mut unknowns, mut amplitudes) = (vec![0.0; count], vec![0.0; of_amplitudes.len()]);
        let mut each = vec![0.0; self.changes.len()];
        for colour in &mut self.colours {
            let others = self.changes.iter().zip(&mut each).chain(of_amplitudes.iter().zip(&mut amplitudes));
            colour.add_products(&slope, &self.boxes, &mut unknowns, others);
        }
        unknowns.extend(self.further.iter().map(|own| own.iter().map(|&place| each[place]).sum::<f64>()));
        [unknowns, amplitudes]
    }

    /// Writes the derivatives of some rows of pixels by `changes`, of which each line has its own.
    fn write<'c>(&self, changes: impl Iterator<Item = &'c [Change]>, rows: Range<usize>, mut out: ArrayViewMut2<f64>) {
        let lines: Vec<_> = out.outer_iter_mut().zip(changes).collect();
        lines.into_par_iter().for_each_init(
            || ThreadBuffers::new(self),
            |buffers, (mut out, changes)| match &self.pixels {
                None => self.derivative(changes, &rows, buffers, out),
                Some(pixels) => {
                    let needed = pixels.needed(&rows);
                    let mut points = std::mem::take(&mut buffers.points);
                    points.resize(needed.len() * self.pixels(), 0.0);
                    self.derivative(changes, &needed, buffers, ArrayViewMut1::from(&mut points[..]));
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
        changes: &[Change],
        rows: &Range<usize>,
        buffers: &mut ThreadBuffers,
        mut out: ArrayViewMut1<f64>,
    ) {
        out.fill(0.0);
        let small = match changes {
            [only] => only.segment().filter(|&segment| self.is_small(segment)).map(|segment| (*only, segment)),
            _ => None,
        };
        self.colours.iter().for_each(|colour| match small {
            Some((change, segment)) => colour.patch(change, &self.boxes[segment], rows, buffers, out.view_mut()),
            None => colour.whole_pupil(changes, rows, buffers, out.view_mut()),
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
fn boxes(optics: &Optics) -> Vec<PupilBox> {
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
mod tests;
