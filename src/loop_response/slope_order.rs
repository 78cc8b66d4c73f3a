//! Orders, axes and signs in which a file could hold the slopes of a wavefront sensor: the discrete alternatives to
//! `[all x, all y]` over the subapertures in use, row by row.

use std::collections::HashMap;

/// Order, axes or sign of slopes that differ from the expected ones in one respect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SlopeOrder {
    /// All x, then all y, subapertures row by row.
    Expected,
    /// Along y first, then along x.
    YBeforeX,
    /// x and y of each subaperture in turn.
    Interleaved,
    /// Subapertures column by column.
    ColumnMajor,
    /// The slopes along x have the opposite sign.
    OppositeX,
    /// The slopes along y have the opposite sign.
    OppositeY,
    /// Positions and signs mirrored, left to right.
    FlippedX,
    /// Positions and signs mirrored, up to down.
    FlippedY,
    /// Both: rotated by 180°.
    Rotated180,
    /// x and y exchanged, positions too.
    Transposed,
    /// Rotated by 90°, one way or the other.
    Rotated90,
    /// As [`SlopeOrder::Rotated90`], the other way.
    Rotated270,
    /// x and y exchanged about the other diagonal.
    TransposedBack,
}

impl SlopeOrder {
    /// All orders but the expected one.
    pub(super) const ALTERNATIVES: [Self; 12] = [
        Self::YBeforeX,
        Self::Interleaved,
        Self::ColumnMajor,
        Self::OppositeX,
        Self::OppositeY,
        Self::FlippedX,
        Self::FlippedY,
        Self::Rotated180,
        Self::Transposed,
        Self::Rotated90,
        Self::Rotated270,
        Self::TransposedBack,
    ];

    /// Exchange of x and y, and then flips of x and y, from the expected coordinates to those of the file.
    fn symmetry(self) -> Option<(bool, [bool; 2])> {
        match self {
            Self::FlippedX => Some((false, [true, false])),
            Self::FlippedY => Some((false, [false, true])),
            Self::Rotated180 => Some((false, [true, true])),
            Self::Transposed => Some((true, [false, false])),
            Self::Rotated90 => Some((true, [true, false])),
            Self::Rotated270 => Some((true, [false, true])),
            Self::TransposedBack => Some((true, [true, true])),
            _ => None,
        }
    }

    /// Where each expected slope is in the file, and its sign there; `None` where the subapertures (`row·across + column`,
    /// ascending) do not have the symmetry.
    pub(super) fn sources(self, across: usize, subapertures: &[usize]) -> Option<Vec<(usize, f64)>> {
        let count = subapertures.len();
        let plain = |source: &dyn Fn(usize) -> (usize, f64)| Some((0..2 * count).map(source).collect());
        if let Some((exchange, flip)) = self.symmetry() {
            return mirrored(exchange, flip, across, subapertures);
        }
        match self {
            Self::YBeforeX => plain(&|slope| ((slope + count) % (2 * count), 1.0)),
            Self::Interleaved => plain(&|slope| (2 * (slope % count) + slope / count, 1.0)),
            Self::ColumnMajor => {
                let mut by_column: Vec<usize> = (0..count).collect();
                by_column.sort_by_key(|&i| (subapertures[i] % across, subapertures[i] / across));
                let mut rank = vec![0; count];
                by_column.iter().enumerate().for_each(|(place, &i)| rank[i] = place);
                plain(&|slope| (rank[slope % count] + slope / count * count, 1.0))
            }
            Self::OppositeX => plain(&|slope| (slope, if slope < count { -1.0 } else { 1.0 })),
            Self::OppositeY => plain(&|slope| (slope, if slope < count { 1.0 } else { -1.0 })),
            _ => plain(&|slope| (slope, 1.0)),
        }
    }
}

/// Sources under a symmetry of the square. With W(u, v) = W'(u', v'), where u' is ±u or, exchanged, ±v, a slope along u is
/// ± the one along the file's axis that u became.
fn mirrored(
    exchange: bool,
    [flip_x, flip_y]: [bool; 2],
    across: usize,
    subapertures: &[usize],
) -> Option<Vec<(usize, f64)>> {
    let count = subapertures.len();
    let index: HashMap<usize, usize> = subapertures.iter().enumerate().map(|(i, &place)| (place, i)).collect();
    let reflect = |at: usize, flip: bool| if flip { across - 1 - at } else { at };
    let sign = |flip: bool| if flip { -1.0 } else { 1.0 };
    let mut sources = vec![(0, 0.0); 2 * count];
    for (i, &place) in subapertures.iter().enumerate() {
        let (row, column) = (place / across, place % across);
        let (u, v) = if exchange { (row, column) } else { (column, row) };
        let there = *index.get(&(reflect(v, flip_y) * across + reflect(u, flip_x)))?;
        let (along_x, along_y) = ((there, sign(flip_x)), (count + there, sign(flip_y)));
        (sources[i], sources[count + i]) = if exchange { (along_y, along_x) } else { (along_x, along_y) };
    }
    Some(sources)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Slopes of W = x²·(2y + 1) + y³/3 about the centre of a 3 × 3 array without one corner pair, in another frame.
    #[test]
    fn sources_undo_each_order() {
        let across = 4;
        // A symmetric set: all but the corners.
        let subapertures: Vec<usize> = (0..16).filter(|i| ![0, 3, 12, 15].contains(i)).collect();
        let count = subapertures.len();
        let at = |i: usize| (i as f64) - 1.5;
        let wavefront = |u: f64, v: f64| u * u * (2.0 * v + 1.0) + v * v * v / 3.0 + 0.3 * u;
        let slopes = |w: &dyn Fn(f64, f64) -> f64| {
            let h = 1e-4;
            let places = || subapertures.iter().map(|p| (at(p % across), at(p / across)));
            let x = places().map(|(u, v)| (w(u + h, v) - w(u - h, v)) / (2.0 * h));
            let y = places().map(|(u, v)| (w(u, v + h) - w(u, v - h)) / (2.0 * h));
            x.chain(y).collect::<Vec<f64>>()
        };
        let expected = slopes(&wavefront);
        // The file's wavefront W'(g(x)) = W(x), so W' = W∘g⁻¹.
        type Field<'a> = &'a dyn Fn(f64, f64) -> f64;
        let orientations: [(SlopeOrder, Field); 4] = [
            (SlopeOrder::FlippedX, &|u, v| wavefront(-u, v)),
            (SlopeOrder::Rotated180, &|u, v| wavefront(-u, -v)),
            (SlopeOrder::Transposed, &|u, v| wavefront(v, u)),
            // g(u, v) = (−v, u): g⁻¹(u', v') = (v', −u').
            (SlopeOrder::Rotated90, &|u, v| wavefront(v, -u)),
        ];
        let restored = |order: SlopeOrder, given: &[f64]| -> Vec<f64> {
            let sources = order.sources(across, &subapertures).unwrap();
            sources.iter().map(|&(source, sign)| sign * given[source]).collect()
        };
        for (order, other) in orientations {
            let found = restored(order, &slopes(other));
            assert!(found.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-6), "{order:?}");
        }
        let interleaved: Vec<f64> = (0..2 * count).map(|i| expected[i / 2 + i % 2 * count]).collect();
        assert_eq!(restored(SlopeOrder::Interleaved, &interleaved), expected);
        let swapped = [&expected[count..], &expected[..count]].concat();
        assert_eq!(restored(SlopeOrder::YBeforeX, &swapped), expected);
        let mut by_column: Vec<usize> = (0..count).collect();
        by_column.sort_by_key(|&i| (subapertures[i] % across, subapertures[i] / across));
        let columns: Vec<f64> =
            by_column.iter().map(|&i| expected[i]).chain(by_column.iter().map(|&i| expected[count + i])).collect();
        assert_eq!(restored(SlopeOrder::ColumnMajor, &columns), expected);
        assert!(SlopeOrder::FlippedX.sources(across, &subapertures[1..]).is_none());
    }
}
