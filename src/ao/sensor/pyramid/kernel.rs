//! Intensities behind the pyramid, summed over the modulation: the inner loop.
//!
//! With the field E and the differences A = S_u E, B = S_v E and C = S_u S_v E of the two edges,
//! the fields in the four images are (E ± A ± B ± C)/4 with the signs σ, τ and στ of the faces.
//! Their intensities are
//!
//! ```text
//! 16 I_στ = T + σX + τY + στZ,   T = |E|² + |A|² + |B|² + |C|²,   X = 2 Re(E A* + B C*),   Y = 2 Re(E B* + A C*),   Z = 2 Re(E C* + A B*)
//! ```
//!
//! From a point of the modulation to the next, A, B and C change by one term of rank 1 for each
//! node of a strip. A vector of [`LANES`] samples of a row stays in registers for the whole circle:
//!
//! ```text
//! for each vector of columns, for each row:
//!     load E, A, B, C at the first point
//!     for each step:  A += α e,  C += γ e      e: the node's wave along x, α and γ of the row
//!                     B += φ b,  C += φ c      φ: the node's wave along y, b and c of the columns
//!                     T, X, Y, Z += ...
//! ```

use crate::ao::footprint::LANES;
use pulp::NullaryFnOnce;
use std::ops::Range;

pub(super) type Lane = [f32; LANES];

/// Complex numbers, one in each lane.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct Vector {
    pub re: Lane,
    pub im: Lane,
}

impl Vector {
    pub(super) const ZERO: Self = Self { re: [0.0; LANES], im: [0.0; LANES] };

    /// self + a·b.
    #[inline(always)]
    fn plus_scaled(mut self, [re, im]: [f32; 2], b: &Self) -> Self {
        for l in 0..LANES {
            self.re[l] = re.mul_add(b.re[l], (-im).mul_add(b.im[l], self.re[l]));
            self.im[l] = re.mul_add(b.im[l], im.mul_add(b.re[l], self.im[l]));
        }
        self
    }
}

/// sum + Re(a·b*).
#[inline(always)]
fn plus_product(mut sum: Lane, a: &Vector, b: &Vector) -> Lane {
    for (l, sum) in sum.iter_mut().enumerate() {
        *sum = a.re[l].mul_add(b.re[l], a.im[l].mul_add(b.im[l], *sum));
    }
    sum
}

/// Terms of a step: ranges of the terms of u and of v, and the first node of those of u.
#[derive(Clone)]
pub(super) struct StepTerms {
    pub u: Range<usize>,
    pub u_node: usize,
    pub v: Range<usize>,
}

/// Columns of one vector and rows whose intensities are computed.
#[derive(Clone)]
pub(super) struct Tile {
    pub vector: usize,
    pub rows: Range<usize>,
}

/// Kernel: the sums over the modulation in all tiles.
pub(super) struct SumIntensities<'a> {
    pub tiles: &'a [Tile],
    pub steps: &'a [StepTerms],
    /// Vectors in a row.
    pub vectors: usize,
    /// E, A, B and C at the first point, `[row][vector]`.
    pub fields: [&'a [Vector]; 4],
    /// Waves of the nodes along x, `[vector][node]`.
    pub waves: &'a [Vector],
    /// α and γ, `[row][term of u]`.
    pub u_terms: &'a [[[f32; 2]; 2]],
    /// φ, `[row][term of v]`.
    pub phasors: &'a [[f32; 2]],
    /// b and c, `[vector][term of v]`.
    pub v_terms: &'a [[Vector; 2]],
    /// Numbers of nodes, terms of u and terms of v.
    pub counts: [usize; 3],
    /// T, X/2, Y/2 and Z/2, `[row][vector]`.
    pub sums: &'a mut [[Lane; 4]],
}

impl NullaryFnOnce for SumIntensities<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let [nodes, u_count, v_count] = self.counts;
        for tile in self.tiles {
            let waves = &self.waves[tile.vector * nodes..][..nodes];
            let v_terms = &self.v_terms[tile.vector * v_count..][..v_count];
            for row in tile.rows.clone() {
                let place = row * self.vectors + tile.vector;
                let u_terms = &self.u_terms[row * u_count..][..u_count];
                let phasors = &self.phasors[row * v_count..][..v_count];
                let [e, a, b, c] = self.fields;
                let start = [e[place], a[place], b[place], c[place]];
                self.sums[place] = sum_over_circle(start, self.steps, waves, u_terms, phasors, v_terms);
            }
        }
    }
}

/// Sums of one vector over all points.
// The form matters: functions that are inlined, no closures, and values that are copied. A closure
// would be compiled for the baseline processor, with a call of the library for each fused
// multiply-add, which takes a hundred times as long.
#[inline(always)]
fn sum_over_circle(
    [e, mut a, mut b, mut c]: [Vector; 4],
    steps: &[StepTerms],
    waves: &[Vector],
    u_terms: &[[[f32; 2]; 2]],
    phasors: &[[f32; 2]],
    v_terms: &[[Vector; 2]],
) -> [Lane; 4] {
    let mut sums = add_point([[0.0; LANES]; 4], &e, &a, &b, &c);
    for step in steps {
        for (term, node) in step.u.clone().zip(step.u_node..) {
            let (wave, [alpha, gamma]) = (waves[node], u_terms[term]);
            a = a.plus_scaled(alpha, &wave);
            c = c.plus_scaled(gamma, &wave);
        }
        for term in step.v.clone() {
            let ([of_b, of_c], phasor) = (v_terms[term], phasors[term]);
            b = b.plus_scaled(phasor, &of_b);
            c = c.plus_scaled(phasor, &of_c);
        }
        sums = add_point(sums, &e, &a, &b, &c);
    }
    sums
}

/// The sums T, X/2, Y/2 and Z/2 and those of a point.
#[inline(always)]
fn add_point([mut t, mut x, mut y, mut z]: [Lane; 4], e: &Vector, a: &Vector, b: &Vector, c: &Vector) -> [Lane; 4] {
    for field in [e, a, b, c] {
        t = plus_product(t, field, field);
    }
    x = plus_product(plus_product(x, e, a), b, c);
    y = plus_product(plus_product(y, e, b), a, c);
    z = plus_product(plus_product(z, e, c), a, b);
    [t, x, y, z]
}

/// Kernel: Fourier components of lines, `out[node][i] = Σ_s conj(wave[node](s))·lines[s][i]`;
/// `waves` is `[s][node]`.
pub(super) struct Components<'a> {
    pub lines: &'a [Vector],
    pub vectors: usize,
    pub waves: &'a [[f32; 2]],
    pub nodes: usize,
    pub out: &'a mut [Vector],
}

/// Nodes that are summed together, in registers.
const TOGETHER: usize = 4;

impl NullaryFnOnce for Components<'_> {
    type Output = ();

    #[inline(always)]
    #[allow(clippy::needless_range_loop)] // constant counts, as in `control::step`
    fn call(self) {
        let Self { lines, vectors, waves, nodes, out } = self;
        for vector in 0..vectors {
            for first in (0..nodes).step_by(TOGETHER) {
                let mut sums = [Vector::ZERO; TOGETHER];
                let count = TOGETHER.min(nodes - first);
                for line in 0..lines.len() / vectors {
                    let value = lines[line * vectors + vector];
                    for together in 0..TOGETHER {
                        // Nodes beyond the last repeat it, and are not kept.
                        let [re, im] = waves[line * nodes + (first + together).min(nodes - 1)];
                        sums[together] = sums[together].plus_scaled([re, -im], &value);
                    }
                }
                for (node, sum) in sums.iter().take(count).enumerate() {
                    out[(first + node) * vectors + vector] = *sum;
                }
            }
        }
    }
}
