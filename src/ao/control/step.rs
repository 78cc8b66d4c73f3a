//! The product of a dense matrix and a vector in single precision, once per frame.
//!
//! A megabyte of matrix for a few kilobytes of vector: the product is as fast as the matrix streams from the cache. So
//! the matrix is stored in the order in which it is read, as one stream: blocks of [`ROWS`] rows; in a block, the
//! vectors of [`LANES`] columns in turn; in each, its rows. The sums keep the order of the definition below whatever the
//! processor's vectors, and every operation is a fused multiply-add: the same bits everywhere.

use crate::ao::LANES;
use ndarray::Array2;
use pulp::NullaryFnOnce;

/// Rows that are summed side by side: enough to hide the latency of the additions, few enough to stay in registers.
const ROWS: usize = 4;

/// A vector, aligned so that no load crosses a line of the cache.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(align(64))]
struct Vector([f32; LANES]);

const ZERO: Vector = Vector([0.0; LANES]);

/// A matrix that multiplies several inputs in turn: `[M₁ M₂ …]`.
#[derive(Debug)]
pub(super) struct StepMatrix {
    rows: usize,
    /// Vectors that hold an input, for each of the inputs.
    widths: Vec<usize>,
    blocks: Vec<Vector>,
}

/// Where a product takes its inputs and leaves its result.
#[derive(Debug, Clone)]
pub(super) struct Workspace {
    input: Vec<Vector>,
    output: Vec<f32>,
}

impl StepMatrix {
    /// The matrices side by side; they have the same number of rows.
    pub fn new(parts: &[Array2<f64>]) -> Self {
        let rows = parts.first().map_or(0, Array2::nrows);
        let widths: Vec<usize> = parts.iter().map(|part| part.ncols().div_ceil(LANES)).collect();
        let mut blocks = Vec::with_capacity(rows.next_multiple_of(ROWS) * widths.iter().sum::<usize>());
        for block in (0..rows).step_by(ROWS) {
            for (part, &width) in parts.iter().zip(&widths) {
                for vector in 0..width {
                    blocks.extend((block..block + ROWS).map(|row| {
                        let at = |lane| part.get([row, vector * LANES + lane]).map_or(0.0, |&value| value as f32);
                        Vector(std::array::from_fn(at))
                    }));
                }
            }
        }
        Self { rows, widths, blocks }
    }

    /// What [`apply`](Self::apply) needs.
    pub fn workspace(&self) -> Workspace {
        let input = vec![ZERO; self.widths.iter().sum()];
        Workspace { input, output: vec![0.0; self.rows.next_multiple_of(ROWS)] }
    }

    /// `M₁·inputs₁ + M₂·inputs₂ + …`; inputs beyond the matrices are not read.
    pub fn apply<'a>(&self, inputs: &[&[f32]], workspace: &'a mut Workspace) -> &'a [f32] {
        let mut rest = &mut workspace.input[..];
        for (values, &width) in inputs.iter().zip(&self.widths) {
            let (here, after) = rest.split_at_mut(width);
            for (vector, values) in here.iter_mut().zip(values.chunks(LANES)) {
                vector.0[..values.len()].copy_from_slice(values);
            }
            rest = after;
        }
        pulp::Arch::new().dispatch(Product {
            blocks: &self.blocks,
            input: &workspace.input,
            output: &mut workspace.output,
        });
        &workspace.output[..self.rows]
    }
}

struct Product<'a> {
    blocks: &'a [Vector],
    input: &'a [Vector],
    output: &'a mut [f32],
}

// A named type with an inlined body, so that it is compiled for the widest vectors that the processor has; a closure
// would be compiled for the oldest processor.
impl NullaryFnOnce for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { blocks, input, output } = self;
        let blocks = blocks.chunks_exact(ROWS * input.len().max(1));
        for (block, output) in blocks.zip(output.chunks_exact_mut(ROWS)) {
            let mut sums = [ZERO; ROWS];
            for (column, input) in block.chunks_exact(ROWS).zip(input) {
                for (sum, row) in sums.iter_mut().zip(column) {
                    for ((sum, &a), &b) in sum.0.iter_mut().zip(&row.0).zip(&input.0) {
                        *sum = a.mul_add(b, *sum);
                    }
                }
            }
            for (output, sum) in output.iter_mut().zip(&sums) {
                *output = total(sum);
            }
        }
    }
}

/// The sum over the lanes, by halves.
#[inline(always)]
fn total(vector: &Vector) -> f32 {
    let mut lanes = vector.0;
    let mut half = LANES / 2;
    while half > 0 {
        for lane in 0..half {
            lanes[lane] += lanes[lane + half];
        }
        half /= 2;
    }
    lanes[0]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_product_is_the_double_sum_at_any_size_and_with_dirty_scratch() {
        for (rows, columns) in [(1, vec![1]), (4, vec![16]), (5, vec![17, 3]), (37, vec![40, 0, 50])] {
            let value = |i: usize, j: usize, k: usize| ((i * 31 + j * 17 + k * 7) as f64).sin();
            let part = |(k, &n): (usize, &usize)| Array2::from_shape_fn((rows, n), |(i, j)| value(i, j, k));
            let parts: Vec<Array2<f64>> = columns.iter().enumerate().map(part).collect();
            let inputs: Vec<Vec<f32>> = columns.iter().map(|&n| (0..n).map(|j| (j as f32).cos()).collect()).collect();
            let matrix = StepMatrix::new(&parts);
            let mut workspace = matrix.workspace();
            for _ in 0..2 {
                let inputs: Vec<&[f32]> = inputs.iter().map(Vec::as_slice).collect();
                let product = matrix.apply(&inputs, &mut workspace).to_vec();
                assert_eq!(product.len(), rows);
                for (i, product) in product.iter().enumerate() {
                    let terms = parts.iter().zip(&inputs).flat_map(|(part, input)| {
                        part.row(i).to_vec().into_iter().zip(input.iter()).map(|(a, &b)| a * f64::from(b))
                    });
                    let (sum, size) = terms.fold((0.0, 0.0), |(sum, size), term| (sum + term, size + term.abs()));
                    // Each entry is rounded once (ε/2), and a sum has at most 6 + 4 additions in sequence.
                    assert!((f64::from(*product) - sum).abs() <= 10.0 * f64::from(f32::EPSILON) * size, "{rows}: {i}");
                }
                workspace.output.fill(f32::NAN);
            }
        }
    }
}
