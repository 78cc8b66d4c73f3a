//! Sum of the layers: bilinear interpolation at each layer's shift, a few rows at a time.

use super::layer::{Layer, Window};
use crate::ao::footprint::Footprint;
use pulp::{Simd, WithSimd};

/// Kernel: overwrites the footprint's spans of a map, and a few samples around them, with the sum
/// of the layers.
pub(super) struct Blend<'a> {
    pub(super) layers: &'a [Layer],
    pub(super) footprint: &'a Footprint,
    pub(super) opd_nm: &'a mut [f32],
}

/// Rows that are computed together. A row of a layer, once interpolated along x, contributes to the
/// two rows next to it. The time is limited by loads that cross cache lines: 10 for 4 rows instead
/// of 16.
const BAND: usize = 4;

impl WithSimd for Blend<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let stride = self.footprint.stride();
        let mut y = 0;
        let mut bands = self.opd_nm.chunks_exact_mut(BAND * stride);
        for band in &mut bands {
            blend::<S, BAND>(simd, self.layers, self.footprint, y, band);
            y += BAND;
        }
        for row in bands.into_remainder().chunks_exact_mut(stride) {
            blend::<S, 1>(simd, self.layers, self.footprint, y, row);
            y += 1;
        }
    }
}

/// Computes `ROWS` rows from `y` on.
#[inline(always)]
fn blend<S: Simd, const ROWS: usize>(simd: S, layers: &[Layer], footprint: &Footprint, y: usize, band: &mut [f32]) {
    let spans = (y..y + ROWS).map(|y| footprint.span(y)).filter(|span| !span.is_empty());
    let Some(span) = spans.reduce(|a, b| a.start.min(b.start)..a.end.max(b.end)) else { return };
    let mut rows = band.chunks_exact_mut(footprint.stride());
    let mut out: [&mut [f32]; ROWS] =
        std::array::from_fn(|_| rows.next().map_or(&mut [][..], |row| &mut row[span.clone()]));
    for out in &mut out {
        out.fill(0.0);
    }
    for layer in layers {
        add(simd, layer.window(), y, span.start, &mut out);
    }
}

/// Adds the window's rows from `y` on and columns from `first` on, a multiple of the vector's
/// length. Products and sums are not fused, so that the result does not depend on the length of the
/// vectors.
#[inline(always)]
fn add<S: Simd, const ROWS: usize>(simd: S, window: Window, y: usize, first: usize, out: &mut [&mut [f32]; ROWS]) {
    let [x0, x1, y0, y1] = [1.0 - window.shift_x, window.shift_x, 1.0 - window.shift_y, window.shift_y]
        .map(|weight| simd.splat_f32s(weight));
    let len = out[0].len();
    let vectors = S::as_simd_f32s(&out[0][..]).0.len();
    let above = row::<S>(&window, y, first, len).map(|values| &values[..vectors]);
    let mut below = [above; ROWS];
    for (r, below) in below.iter_mut().enumerate() {
        *below = row::<S>(&window, y + 1 + r, first, len).map(|values| &values[..vectors]);
    }
    let out = out.each_mut().map(|out| &mut S::as_mut_simd_f32s(out).0[..vectors]);
    let along = |[left, right]: [&[S::f32s]; 2], i: usize| {
        simd.add_f32s(simd.mul_f32s(x0, left[i]), simd.mul_f32s(x1, right[i]))
    };
    #[allow(clippy::needless_range_loop)] // one index into a dozen slices
    for i in 0..vectors {
        let mut near = along(above, i);
        for r in 0..ROWS {
            let far = along(below[r], i);
            let value = simd.add_f32s(simd.mul_f32s(y0, near), simd.mul_f32s(y1, far));
            out[r][i] = simd.add_f32s(out[r][i], value);
            near = far;
        }
    }
}

/// `len` samples of the window's row `y` from column `first` on, and their right neighbours. A
/// function, as the closure of `array::from_fn` is a call of its own wherever the compiler does not
/// inline it: 2 % of the loop's time.
#[inline(always)]
fn row<'a, S: Simd>(window: &Window<'a>, y: usize, first: usize, len: usize) -> [&'a [S::f32s]; 2] {
    let values = &window.values[window.starts[y] + first..][..len + 1];
    [&values[..len], &values[1..]].map(|values| S::as_simd_f32s(values).0)
}
