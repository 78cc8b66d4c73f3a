//! Extents of the rows of a frame: number, range and sum of their good pixels, with vector
//! instructions.

use ndarray::ArrayView2;
use pulp::{Arch, NullaryFnOnce};

/// Number, range and sum of the good pixels of a row.
#[derive(Debug, Clone, Copy)]
pub(super) struct Extent {
    pub(super) good: usize,
    pub(super) least: f64,
    pub(super) most: f64,
    pub(super) sum: f64,
}

impl Extent {
    pub(super) const EMPTY: Self = Self { good: 0, least: f64::MAX, most: f64::MIN, sum: 0.0 };

    /// Extent of a row without a bad pixel.
    pub(super) fn from_row(row: &[f64]) -> Self {
        Arch::new().dispatch(Row(row)).0
    }

    /// Extent of a row without a bad pixel; `None` where a value is not finite.
    pub(super) fn from_finite_row(row: &[f64]) -> Option<Self> {
        let (extent, finite) = Arch::new().dispatch(Row(row));
        finite.then_some(extent)
    }

    pub(super) fn with(self, value: f64) -> Self {
        self.and(&Self { good: 1, least: value, most: value, sum: value })
    }

    pub(super) fn and(self, other: &Self) -> Self {
        Self {
            good: self.good + other.good,
            least: self.least.min(other.least),
            most: self.most.max(other.most),
            sum: self.sum + other.sum,
        }
    }
}

/// Writes the extents of all rows of a frame, where none of its pixels is marked as bad or not
/// finite; `None` where one is, or where its rows are not contiguous.
pub(super) fn extents_of_clean_rows(
    data: ArrayView2<f64>,
    bad: ArrayView2<bool>,
    extents: &mut [Extent],
) -> Option<()> {
    let (data, marks) = (data.to_slice()?, bad.to_slice()?);
    Arch::new().dispatch(Frame { data, marks, columns: bad.ncols(), extents }).then_some(())
}

/// [`extents_of_clean_rows`] of contiguous rows, compiled for the widest vectors that this
/// processor has.
struct Frame<'a> {
    data: &'a [f64],
    marks: &'a [bool],
    columns: usize,
    extents: &'a mut [Extent],
}

impl NullaryFnOnce for Frame<'_> {
    type Output = bool;

    #[inline(always)]
    fn call(self) -> bool {
        // A loop without an early exit is vectorised.
        if self.marks.iter().fold(false, |any, marked| any | *marked) {
            return false;
        }
        let rows = self.data.chunks_exact(self.columns).zip(self.extents);
        rows.fold(true, |all, (row, extent)| {
            let finite;
            (*extent, finite) = Row(row).call();
            all & finite
        })
    }
}

/// The extent of a row, and whether all of it is finite: in eight partial sums, so that it is
/// vectorised.
struct Row<'a>(&'a [f64]);

impl NullaryFnOnce for Row<'_> {
    type Output = (Extent, bool);

    #[inline(always)]
    fn call(self) -> (Extent, bool) {
        const LANES: usize = 8;
        let (mut least, mut most, mut sum) = ([f64::MAX; LANES], [f64::MIN; LANES], [0.0; LANES]);
        // 0 times a value that is not finite is NaN.
        let mut zeros = [0.0; LANES];
        let (parts, rest) = self.0.as_chunks::<LANES>();
        for part in parts {
            for i in 0..LANES {
                least[i] = if part[i] < least[i] { part[i] } else { least[i] };
                most[i] = if part[i] > most[i] { part[i] } else { most[i] };
                sum[i] += part[i];
                zeros[i] += 0.0 * part[i];
            }
        }
        let whole = Extent {
            good: LANES * parts.len(),
            least: least.into_iter().fold(f64::MAX, f64::min),
            most: most.into_iter().fold(f64::MIN, f64::max),
            sum: sum.iter().sum(),
        };
        let finite = zeros.iter().sum::<f64>() == 0.0 && rest.iter().all(|value| value.is_finite());
        (rest.iter().fold(whole, |extent, &value| extent.with(value)), finite)
    }
}
