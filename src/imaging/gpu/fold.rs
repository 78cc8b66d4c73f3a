//! Conversion of the arrays of [`GpuLayout`] to the folded, padded arrays of `kernels/common.cl`.

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use super::layout::{GpuColour, GpuLayout};
use crate::device::{Build, FftPlan};

/// Output rows per work-item in the products along columns; `TALL` of `common.cl`.
pub(super) const TALL: usize = 6;
/// Outputs per work-item in the products along rows on a GPU; `ROW_WIDE` of `transform.cl`.
const ROW_WIDE: usize = 4;
/// Images per work-item in the products with the modes; `GROUP` of `common.cl`.
pub(super) const GROUP: usize = 4;
/// Modes per work-item in the projection.
pub(super) const MODES_AT_ONCE: usize = 4;

/// Sizes of the folded arrays.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FoldedShape {
    /// Numbers in a vector.
    pub vector: usize,
    /// Pupil rows on one side of the axis, n/2.
    pub rows: usize,
    /// `rows`, padded to whole vectors.
    pub width: usize,
    /// Image rows on one side of the axis, m/2.
    pub pairs: usize,
    /// `pairs`, padded to whole vectors.
    pub span: usize,
    /// Turns per sample and pixel.
    pub step: f64,
    /// The FFT that replaces the matrix products.
    pub fft: Option<FftPlan>,
}

impl FoldedShape {
    /// The sizes of `layout` for its wavelength `colour`; only the step depends on it.
    pub fn new(layout: &GpuLayout, colour: &GpuColour, build: Build) -> Self {
        let vector = build.vector;
        let (rows, pairs) = (layout.samples / 2, layout.pixels / 2);
        Self {
            vector,
            rows,
            width: rows.next_multiple_of(vector),
            pairs,
            span: pairs.next_multiple_of(vector),
            step: 1.0 / (layout.samples as f64 * colour.samples_per_lambda_over_d),
            fft: build.fft,
        }
    }

    /// The FFT for `layout`, where there is one: the image is the squared modulus of one field, it
    /// has as many pixels as the padded pupil has samples, and its rows are whole vectors.
    pub fn fft(layout: &GpuLayout, vector: usize) -> Option<FftPlan> {
        let [colour] = layout.colours.as_slice() else { return None };
        let (points, exact) = (layout.pixels, layout.samples as f64 * colour.samples_per_lambda_over_d);
        // 1e-9 of a sample over the whole grid is below the rounding of f64.
        let whole = layout.is_one_field()
            && vector > 1
            && points.is_multiple_of(vector)
            && (exact - points as f64).abs() < 1e-9;
        FftPlan::new(points, layout.samples / 2).filter(|_| whole)
    }

    /// Rows of the pupil on one side of the axis that the FFT reads.
    pub fn side_rows(&self) -> usize {
        self.fft.map_or(0, |fft| fft.nonzero_blocks * fft.b).max(self.width)
    }

    /// `[b][r][cos, sin]` of the angle b r / (a b).
    pub fn twiddles(&self) -> Vec<f64> {
        let Some(fft) = self.fft else { return Vec::new() };
        let turn = |turns: f64| [(TAU * turns).cos(), (TAU * turns).sin()];
        let points = fft.points() as f64;
        (0..fft.b).flat_map(|b| (0..fft.a).flat_map(move |r| turn((b * r) as f64 / points))).collect()
    }

    /// Size of the data, or of the weights, of one image.
    pub fn pixels(&self) -> usize {
        self.fft.map_or(self.pairs * 4 * self.span, |fft| fft.points().pow(2))
    }

    /// Index of pixel (row, column) of an image of `m` pixels: `[pair][+v, -v][+u, -u][u]`; with an
    /// FFT `[vector of v][u][lane of v]`, both in the FFT's order of frequencies.
    pub fn pixel(&self, m: usize, row: usize, column: usize) -> usize {
        if let Some(fft) = self.fft {
            let [v, u] = [row, column].map(|i| {
                let frequency = (i + m / 2) % m;
                frequency % fft.a * fft.b + frequency / fft.a
            });
            return (v / self.vector * m + u) * self.vector + v % self.vector;
        }
        let (v, below) = fold(row, m);
        let (u, left) = fold(column, m);
        ((v * 2 + below) * 2 + left) * self.span + u
    }

    fn angle(&self, sample: usize, pixel: usize) -> f64 {
        // Reduced to one turn before the multiplication by 2π, which keeps full precision.
        let turns = (sample as f64 + 0.5) * (pixel as f64 + 0.5) * self.step;
        TAU * (turns - turns.round())
    }

    /// `[group of TALL outputs][input][cos, sin][TALL]`; the angle is that of
    /// `angle(input, output)`.
    fn columns(outputs: usize, inputs: usize, angle: impl Fn(usize, usize) -> f64) -> Vec<f64> {
        let mut table = Vec::with_capacity(outputs.next_multiple_of(TALL) * inputs * 2);
        for group in 0..outputs.div_ceil(TALL) {
            for input in 0..inputs {
                for part in [f64::cos, f64::sin] {
                    table.extend((group * TALL..(group + 1) * TALL).map(|o| part(angle(input, o))));
                }
            }
        }
        table
    }

    /// Chunks of vectors of outputs as `[input][cos, sin][vectors][VEC]`, zero beyond `outputs`; on
    /// a GPU all are one chunk.
    fn rows(&self, outputs: usize, inputs: usize, angle: impl Fn(usize, usize) -> f64) -> Vec<f64> {
        let vectors = outputs.div_ceil(self.vector);
        let chunks = if self.vector == 1 { 1 } else { self.row_chunks(vectors * self.vector) };
        let mut table = Vec::with_capacity(vectors * self.vector * inputs * 2);
        for chunk in 0..chunks {
            let (start, end) = (2 * chunk, if chunk + 1 < chunks { 2 * chunk + 2 } else { vectors });
            for input in 0..inputs {
                for part in [f64::cos, f64::sin] {
                    let inside = |o: usize| if o < outputs { part(angle(input, o)) } else { 0.0 };
                    table.extend((start * self.vector..end * self.vector).map(inside));
                }
            }
        }
        table
    }

    /// Number of work-items for a row of `width` outputs: two vectors each, three for the last of
    /// an odd number; on a GPU four outputs.
    pub fn row_chunks(&self, width: usize) -> usize {
        if self.vector == 1 { width.div_ceil(ROW_WIDE) } else { (width / self.vector / 2).max(1) }
    }

    /// Sizes of the four tables and of the twiddle factors, which replace the tables with an FFT.
    pub fn table_sizes(&self) -> [usize; 5] {
        if let Some(fft) = self.fft {
            return [0, 0, 0, 0, 2 * fft.points()];
        }
        let columns = |outputs: usize, inputs: usize| outputs.next_multiple_of(TALL) * inputs * 2;
        [
            columns(self.pairs, self.rows),
            2 * self.span * self.rows,
            2 * self.width * self.pairs,
            columns(self.rows, self.pairs),
            0,
        ]
    }

    /// Sizes of the scratch arrays of the FFT of one image: one line, and the samples of both
    /// sides.
    pub fn fft_scratch(&self) -> [usize; 2] {
        self.fft.map_or([0; 2], |fft| [fft.points() * 2 * self.vector, self.side_rows() * 4 * self.vector])
    }

    /// The four tables, in the order in which the stages use them: y to v, x to u, u to x, v to y.
    pub fn tables(&self) -> [Vec<f64>; 4] {
        let forward = |sample, pixel| self.angle(sample, pixel);
        let adjoint = |pixel, sample| self.angle(sample, pixel);
        [
            Self::columns(self.pairs, self.rows, forward),
            self.rows(self.pairs, self.rows, forward),
            self.rows(self.rows, self.pairs, adjoint),
            Self::columns(self.rows, self.pairs, adjoint),
        ]
    }
}

/// Distance of sample or pixel `i` of `size` from the axis, in whole steps, and 1 where it is on
/// the negative side.
fn fold(i: usize, size: usize) -> (usize, usize) {
    if i >= size / 2 { (i - size / 2, 0) } else { (size / 2 - 1 - i, 1) }
}

/// The pupil in blocks: one block is `VEC` samples in x, in all four quadrants. A column of blocks
/// extends from the axis to its outermost illuminated sample.
#[derive(Debug, Default)]
pub(super) struct Blocks {
    /// Row and first column of each, by distance from the axis.
    pub place: Vec<i32>,
    /// Extent of each vector of columns: rows from the axis to the outermost illuminated sample.
    pub extent: Vec<i32>,
    /// The illuminated samples, in the order of the layout.
    samples: Vec<FoldedSample>,
    /// Basis, with the strides below.
    pub basis: Vec<f64>,
    /// Strides of blocks, modes and quadrants in the basis.
    pub block_stride: usize,
    pub mode_stride: usize,
    pub quadrant_stride: usize,
    /// Entries of block b in quadrant q: `entry_start[4 b + q]..entry_start[4 b + q + 1]`.
    pub entry_start: Vec<i32>,
    /// Segment of each entry.
    pub entry_segment: Vec<i32>,
    /// Index of the samples of each entry in the planes of g.
    pub entry_place: Vec<i32>,
    /// Weights of each entry, `VEC` numbers.
    pub entry_weight: Vec<f64>,
    /// Slopes of each entry, `VEC` numbers; empty where no segment tilts.
    pub entry_x: Vec<f64>,
    pub entry_y: Vec<f64>,
    /// The same list by segment: `segment_start[s]..segment_start[s + 1]` of `segment_entry`.
    pub segment_start: Vec<i32>,
    pub segment_entry: Vec<i32>,
    /// Index of each illuminated sample in the planes of psi; empty without a free phase.
    pub sample_place: Vec<i32>,
}

impl Blocks {
    pub fn count(&self) -> usize {
        self.place.len() / 2
    }

    pub fn new(layout: &GpuLayout, shape: &FoldedShape) -> Self {
        let (n, vector) = (layout.samples, shape.vector);
        let folded: Vec<FoldedSample> = layout
            .illuminated
            .iter()
            .map(|&flat| {
                let ((row, below), (x, left)) = (fold(flat / n, n), fold(flat % n, n));
                FoldedSample { row, column: x / vector, quadrant: 2 * below + left, lane: x % vector, block: 0 }
            })
            .collect();
        let mut blocks = Blocks { extent: vec![0; shape.width / vector], ..Default::default() };
        for sample in &folded {
            blocks.extent[sample.column] = blocks.extent[sample.column].max(sample.row as i32 + 1);
        }
        // All blocks within the extent, also those without an illuminated sample: the adjoint
        // writes there, and the next field must overwrite that with zeros.
        let mut number = vec![vec![0; blocks.extent.len()]; shape.rows];
        for (row, numbers) in number.iter_mut().enumerate() {
            for (column, number) in numbers.iter_mut().enumerate() {
                if (row as i32) < blocks.extent[column] {
                    *number = blocks.count();
                    blocks.place.extend([row as i32, (column * vector) as i32]);
                }
            }
        }
        let folded: Vec<FoldedSample> = folded
            .into_iter()
            .map(|sample| FoldedSample { block: number[sample.row][sample.column], ..sample })
            .collect();
        if layout.free_phase {
            blocks.sample_place = folded.iter().map(|sample| blocks.plane(sample, vector) as i32).collect();
        }
        blocks.fill_modes(layout, shape, &folded);
        blocks.fill_segments(layout, vector, &folded);
        blocks.samples = folded;
        blocks
    }

    /// Index of the sample in planes of numbers: `PLANE` of common.cl.
    fn plane(&self, sample: &FoldedSample, vector: usize) -> usize {
        let block = if vector == 1 {
            sample.quadrant * self.count() + sample.block
        } else {
            4 * sample.block + sample.quadrant
        };
        block * vector + sample.lane
    }

    fn fill_modes(&mut self, layout: &GpuLayout, shape: &FoldedShape, folded: &[FoldedSample]) {
        let (count, vector) = (self.count(), shape.vector);
        let modes = layout.smooth.len().next_multiple_of(MODES_AT_ONCE);
        // A CPU reads the modes of one block in order; neighbouring work-items of a GPU read
        // neighbouring blocks.
        [self.block_stride, self.mode_stride, self.quadrant_stride] =
            if vector == 1 { [1, 4 * count, count] } else { [modes * 4 * vector, 4 * vector, vector] };
        self.basis = vec![0.0; modes * 4 * count * vector];
        for (p, sample) in folded.iter().enumerate() {
            let place = sample.block * self.block_stride + sample.quadrant * self.quadrant_stride + sample.lane;
            for (j, mode) in layout.smooth.iter().enumerate() {
                self.basis[place + j * self.mode_stride] = mode[p];
            }
        }
    }

    /// Diversity of a wavelength modulo one turn, in planes of numbers; `shape` is that of the
    /// wavelength.
    pub fn diversity(&self, layout: &GpuLayout, colour: &GpuColour, shape: &FoldedShape) -> Vec<f64> {
        let (vector, n) = (shape.vector, layout.samples);
        // The image axis is at pixel m/2; a tilt of half a pixel moves it to the centre of the
        // array. The FFT needs no shift.
        let half = if shape.fft.is_some() { 0.0 } else { 0.5 };
        let tilt = |flat: usize| half * shape.step * ((flat / n + flat % n) as f64 - (n as f64 - 1.0));
        let mut diversity = vec![0.0; 4 * self.count() * vector];
        for ((sample, turns), &flat) in self.samples.iter().zip(&colour.diversity_turns).zip(&layout.illuminated) {
            let turns = turns + tilt(flat);
            diversity[self.plane(sample, vector)] = turns - turns.round();
        }
        diversity
    }

    /// Diversity of a wavelength without that of the first times its scale, modulo one turn: see
    /// `field.cl`.
    pub fn excess(&self, layout: &GpuLayout, colour: usize, build: Build) -> Vec<f64> {
        let diversity = |colour: &GpuColour| self.diversity(layout, colour, &FoldedShape::new(layout, colour, build));
        let (own, first) = (diversity(&layout.colours[colour]), diversity(&layout.colours[0]));
        let scale = layout.phase_scale(colour);
        let excess = |(own, first): (f64, f64)| {
            let turns = own - scale * first;
            turns - turns.round()
        };
        own.into_iter().zip(first).map(excess).collect()
    }

    fn fill_segments(&mut self, layout: &GpuLayout, vector: usize, folded: &[FoldedSample]) {
        // (block, quadrant, segment) -> weights and slopes of the lanes.
        let mut weights: BTreeMap<(usize, usize, usize), [Vec<f64>; 3]> = BTreeMap::new();
        for (p, sample) in folded.iter().enumerate() {
            for e in layout.segment_start[p]..layout.segment_start[p + 1] {
                let key = (sample.block, sample.quadrant, layout.segment_index[e]);
                let [weight, x, y] = weights.entry(key).or_insert_with(|| [0; 3].map(|_| vec![0.0; vector]));
                weight[sample.lane] += layout.segment_weight[e];
                if let Some(slopes) = &layout.segment_slopes {
                    (x[sample.lane], y[sample.lane]) = (slopes.0[e], slopes.1[e]);
                }
            }
        }
        let mut by_segment = vec![Vec::new(); layout.segments];
        let mut ends = vec![0; 4 * self.count() + 1];
        for (entry, ((block, quadrant, segment), [weight, x, y])) in weights.into_iter().enumerate() {
            ends[4 * block + quadrant + 1] = entry as i32 + 1;
            by_segment[segment].push(entry as i32);
            self.entry_segment.push(segment as i32);
            // `COMPLEX` of common.cl.
            let place = if vector == 1 { 2 * quadrant * self.count() + block } else { 8 * block + 2 * quadrant };
            self.entry_place.push(place as i32);
            self.entry_weight.extend(weight);
            if layout.poses() > 1 {
                self.entry_x.extend(x);
                self.entry_y.extend(y);
            }
        }
        // A quadrant without entries starts and ends where the previous one ended.
        for i in 1..ends.len() {
            ends[i] = ends[i].max(ends[i - 1]);
        }
        self.entry_start = ends;
        self.segment_start = vec![0];
        for list in by_segment {
            self.segment_entry.extend(list);
            self.segment_start.push(self.segment_entry.len() as i32);
        }
    }
}

/// Position of an illuminated sample in the folded pupil.
#[derive(Debug)]
struct FoldedSample {
    row: usize,
    /// Vector of columns.
    column: usize,
    block: usize,
    quadrant: usize,
    lane: usize,
}
