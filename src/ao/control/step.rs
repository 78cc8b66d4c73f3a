//! Product of a dense matrix and a vector in single precision, once per frame.
//!
//! The matrix has about a megabyte, the vector a few kilobytes, so the speed is limited by reading
//! the matrix from the cache. The matrix is therefore stored in the order in which it is read:
//! panels of [`PANEL`] vectors of rows, and in a panel one column after the other. The sums of a
//! panel stay in registers, and each column adds its multiple.
//!
//! Every sum adds its columns in order, by fused multiply-adds, so the result does not depend on
//! the length of the processor's vectors.

use crate::ao::footprint::LANES;
use ndarray::Array2;
use pulp::NullaryFnOnce;

/// Vectors of rows that are summed together: enough to hide the latency of the additions, few
/// enough for the registers of processors with vectors of half the length.
const PANEL: usize = 4;

/// Rows of a panel.
const ROWS: usize = PANEL * LANES;

/// SIMD vector, aligned so that no load crosses a cache line.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
struct Vector([f32; LANES]);

/// Block matrix `[M₁ M₂ …]` in panels.
#[derive(Debug)]
pub(super) struct StepMatrix {
    rows: usize,
    /// Length of each input vector.
    lengths: Vec<usize>,
    panels: Vec<Vector>,
}

/// Input and output arrays of a product.
#[derive(Debug, Clone)]
pub(super) struct StepWorkspace {
    input: Vec<f32>,
    output: Vec<f32>,
}

impl StepMatrix {
    /// Block matrix of `parts`, which have the same number of rows.
    pub fn new(parts: &[Array2<f64>]) -> Self {
        let rows = parts.first().map_or(0, Array2::nrows);
        let lengths: Vec<usize> = parts.iter().map(Array2::ncols).collect();
        let mut panels = Vec::with_capacity(rows.div_ceil(ROWS) * PANEL * lengths.iter().sum::<usize>());
        for panel in (0..rows).step_by(ROWS) {
            for column in parts.iter().flat_map(|part| part.columns()) {
                panels.extend((0..PANEL).map(|vector| {
                    let first = panel + vector * LANES;
                    let at = |lane| column.get(first + lane).map_or(0.0, |&value| value as f32);
                    Vector(std::array::from_fn(at))
                }));
            }
        }
        Self { rows, lengths, panels }
    }

    /// Allocates the arrays of [`apply`](Self::apply).
    pub fn workspace(&self) -> StepWorkspace {
        let input = vec![0.0; self.lengths.iter().sum()];
        StepWorkspace { input, output: vec![0.0; self.rows.next_multiple_of(ROWS)] }
    }

    /// Computes `M₁·inputs₁ + M₂·inputs₂ + …`; inputs beyond the number of blocks are not read.
    pub fn apply<'a>(&self, inputs: &[&[f32]], workspace: &'a mut StepWorkspace) -> &'a [f32] {
        let mut rest = &mut workspace.input[..];
        for (values, &length) in inputs.iter().zip(&self.lengths) {
            let (here, after) = rest.split_at_mut(length);
            here.copy_from_slice(values);
            rest = after;
        }
        pulp::Arch::new().dispatch(Product {
            panels: &self.panels,
            input: &workspace.input,
            output: &mut workspace.output,
        });
        &workspace.output[..self.rows]
    }
}

struct Product<'a> {
    panels: &'a [Vector],
    input: &'a [f32],
    output: &'a mut [f32],
}

// A named type with an inlined body is compiled for the widest vectors of the processor; a closure
// would be compiled for the baseline processor.
impl NullaryFnOnce for Product<'_> {
    type Output = ();

    // The form of the loops matters: constant counts, and sums in a local array that are loaded and
    // stored explicitly. With zipped iterators the compiler keeps the sums in memory, which takes
    // twenty times as long.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)]
    fn call(self) {
        let Self { panels, input, output } = self;
        let panels = panels.chunks_exact(PANEL * input.len().max(1));
        for (panel, output) in panels.zip(output.as_chunks_mut::<LANES>().0.chunks_exact_mut(PANEL)) {
            let mut sums = [[0.0f32; LANES]; PANEL];
            for (column, &value) in panel.as_chunks::<PANEL>().0.iter().zip(input) {
                for vector in 0..PANEL {
                    let mut sum = sums[vector];
                    for lane in 0..LANES {
                        sum[lane] = column[vector].0[lane].mul_add(value, sum[lane]);
                    }
                    sums[vector] = sum;
                }
            }
            output.copy_from_slice(&sums);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_product_equals_the_sum_in_double_precision_at_any_size() {
        for (rows, columns) in [(1, vec![1]), (64, vec![16]), (65, vec![17, 3]), (137, vec![40, 0, 50])] {
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
                    // Each entry is rounded once, and a sum has at most 90 additions: 91 times ε/2.
                    let bound = 91.0 / 2.0 * f64::from(f32::EPSILON) * size;
                    assert!((f64::from(*product) - sum).abs() <= bound, "{rows}: {i}");
                }
                workspace.output.fill(f32::NAN);
            }
        }
    }
}
