//! Dead and stuck pixels that stand together: columns, rows and blocks that have one value. Noise
//! gives them none.

use ndarray::{Array2, ArrayView1, ArrayView2, Axis};

/// Largest part of the pixels of the lines beside a dead one that have its value: beside a line of
/// a frame of few photons, all of which are 0, nearly all are 0, too.
const MOST_BESIDE: f64 = 0.5;
/// Pixels about a block of which few have its value.
const RING: usize = 2;
/// Their largest part. Eight more pixels of the value of a ninth are then a chance of 1e-8.
const MOST_AROUND: f64 = 0.1;
/// Longest side of a block.
const LONGEST: usize = 64;
/// Largest part of a frame that blocks fill. Beyond, the frame has levels without noise.
const MAX_SHARE: f64 = 0.1;
/// Most blocks that are named.
const MOST_NAMED: usize = 64;

/// Finds dead pixels in frames of one size, in memory that is allocated once.
pub(crate) struct DeadPixels {
    /// The bad pixels of the last frame, with its dead ones, `[y, x]`.
    bad: Array2<bool>,
    /// Numbers of its dead columns, and rows.
    lines: [Vec<usize>; 2],
    /// First column, first row, columns and rows of its blocks.
    blocks: Vec<[usize; 4]>,
    /// Value of each line of one direction that has one.
    values: Vec<Option<f64>>,
}

impl DeadPixels {
    pub(crate) fn new((rows, columns): (usize, usize)) -> Self {
        Self {
            bad: Array2::from_elem((rows, columns), false),
            lines: [Vec::with_capacity(columns), Vec::with_capacity(rows)],
            blocks: Vec::with_capacity(MOST_NAMED),
            values: Vec::with_capacity(rows.max(columns)),
        }
    }

    /// Searches a frame of that size with these bad pixels. Returns whether it has dead ones.
    pub(crate) fn find(&mut self, data: ArrayView2<f64>, bad: ArrayView2<bool>) -> bool {
        self.find_all_lines(data, bad);
        self.blocks.clear();
        if !self.find_blocks(data) {
            self.blocks.clear();
            self.find_all_lines(data, bad);
        }
        !self.blocks.is_empty() || self.lines.iter().any(|lines| !lines.is_empty())
    }

    /// The bad pixels of the last frame, with its dead ones, `[y, x]`.
    pub(crate) fn bad(&self) -> ArrayView2<'_, bool> {
        self.bad.view()
    }

    /// Ascending numbers of its dead columns, and rows.
    pub(crate) fn lines(&self) -> &[Vec<usize>; 2] {
        &self.lines
    }

    /// First column, first row, columns and rows of its blocks.
    pub(crate) fn blocks(&self) -> &[[usize; 4]] {
        &self.blocks
    }

    fn find_all_lines(&mut self, data: ArrayView2<f64>, bad: ArrayView2<bool>) {
        self.bad.assign(&bad);
        self.lines.iter_mut().for_each(Vec::clear);
        // A column has one value but where it crosses a row of another.
        for axis in [0, 1, 0] {
            self.find_lines(data, axis);
        }
        self.lines[0].sort_unstable();
    }

    /// Marks the columns (0) or rows (1) whose good pixels have one value.
    fn find_lines(&mut self, data: ArrayView2<f64>, axis: usize) {
        let Self { bad: marked, lines, values, .. } = self;
        let across = Axis(1 - axis);
        values.clear();
        values.extend((0..data.len_of(across)).map(|line| {
            let (own, bad) = (data.index_axis(across, line), marked.index_axis(across, line));
            let mut good = own.iter().zip(bad).filter(|(_, bad)| !**bad).map(|(value, _)| *value);
            let first = good.next().filter(|first| first.is_finite())?;
            // Of a few good pixels nothing is known.
            let is_known = || 2 * bad.iter().filter(|bad| !**bad).count() > bad.len();
            (good.all(|value| value == first) && is_known()).then_some(first)
        }));
        let differs = |line: usize, value: f64| {
            let own = data.index_axis(across, line);
            let equal = own.iter().filter(|other| **other == value).count();
            (equal as f64) < MOST_BESIDE * own.len() as f64
        };
        for (line, value) in values.iter().enumerate().filter_map(|(line, value)| Some((line, (*value)?))) {
            let before = values[..line].iter().rposition(Option::is_none);
            let behind = values[line..].iter().position(Option::is_none).map(|beyond| line + beyond);
            if before.into_iter().chain(behind).any(|other| differs(other, value)) {
                marked.index_axis_mut(across, line).fill(true);
                lines[axis].push(line);
            }
        }
    }

    /// Marks the blocks of 3 × 3 and more pixels; `false` where they are too many.
    fn find_blocks(&mut self, data: ArrayView2<f64>) -> bool {
        let (rows, columns) = data.dim();
        let (mut count, most) = (0, (MAX_SHARE * data.len() as f64) as usize);
        let mut largest = None;
        for y in (1..rows.saturating_sub(1)).filter(|&y| has_equal_neighbours(data.row(y))) {
            for x in 1..columns.saturating_sub(1) {
                let value = data[(y, x)];
                let is_one = |(v, u): (usize, usize)| data[(v, u)] == value;
                let three = || (y - 1..=y + 1).flat_map(|v| (x - 1..=x + 1).map(move |u| (v, u)));
                if data[(y, x + 1)] != value || !three().all(is_one) {
                    continue;
                }
                // Light that saturates has one value, too.
                if value == *largest.get_or_insert_with(|| largest_good(data, self.bad.view())) {
                    continue;
                }
                let Some(block) = block_about(data, (y, x)).filter(|block| is_alone(data, *block, value)) else {
                    continue;
                };
                let before = count;
                for at in three() {
                    count += usize::from(!self.bad[at]);
                    self.bad[at] = true;
                }
                if count > most {
                    return false;
                }
                if count > before && self.blocks.len() < MOST_NAMED && !self.blocks.contains(&block) {
                    self.blocks.push(block);
                }
            }
        }
        true
    }
}

/// Whether a row has two neighbours of one value: of noise in real numbers none has.
fn has_equal_neighbours(row: ArrayView1<f64>) -> bool {
    row.to_slice().is_none_or(|row| row.iter().zip(&row[1..]).fold(false, |any, (left, right)| any | (left == right)))
}

fn largest_good(data: ArrayView2<f64>, bad: ArrayView2<bool>) -> f64 {
    data.iter().zip(&bad).filter(|(_, bad)| !**bad).fold(f64::NEG_INFINITY, |most, (value, _)| most.max(*value))
}

/// First column, first row, columns and rows of the pixels of one value in line with one; `None`
/// where they are too many, or lead from edge to edge.
fn block_about(data: ArrayView2<f64>, (y, x): (usize, usize)) -> Option<[usize; 4]> {
    let value = data[(y, x)];
    let stretch = |line: ArrayView1<f64>, at: usize| {
        let before = (0..at).rev().take(LONGEST).take_while(|&other| line[other] == value).count();
        let behind = (at + 1..line.len()).take(LONGEST).take_while(|&other| line[other] == value).count();
        let size = before + 1 + behind;
        (size <= LONGEST && size < line.len()).then_some((at - before, size))
    };
    let (first_x, columns) = stretch(data.row(y), x)?;
    let (first_y, rows) = stretch(data.column(x), y)?;
    Some([first_x, first_y, columns, rows])
}

/// Whether few of the pixels about a block have its value.
fn is_alone(data: ArrayView2<f64>, [first_x, first_y, columns, rows]: [usize; 4], value: f64) -> bool {
    let range = |first: usize, size: usize, end: usize| first.saturating_sub(RING)..(first + size + RING).min(end);
    let is_inside =
        |y: usize, x: usize| (first_y..first_y + rows).contains(&y) && (first_x..first_x + columns).contains(&x);
    let (mut all, mut equal) = (0, 0_usize);
    for y in range(first_y, rows, data.nrows()) {
        for x in range(first_x, columns, data.ncols()).filter(|&x| !is_inside(y, x)) {
            all += 1;
            equal += usize::from(data[(y, x)] == value);
        }
    }
    (equal as f64) < MOST_AROUND * all as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::s;

    /// Counts from `level` to `level` + 12, in no order.
    fn frame(level: f64) -> Array2<f64> {
        let mixed = |at: usize| (at * at * 7919 + at * 104_729) / 31;
        Array2::from_shape_fn((40, 50), |(y, x)| level + (mixed(50 * y + x) % 13) as f64)
    }

    fn found(data: &Array2<f64>) -> DeadPixels {
        let mut dead = DeadPixels::new(data.dim());
        let any = dead.find(data.view(), Array2::from_elem(data.dim(), false).view());
        assert_eq!(any, dead.bad().iter().any(|bad| *bad));
        dead
    }

    #[test]
    fn lines_of_one_value_are_marked() {
        assert_eq!(found(&frame(5.0)).lines(), &[vec![], vec![]]);
        let mut spoilt = frame(5.0);
        spoilt.slice_mut(s![.., 3..6]).fill(0.0);
        spoilt.row_mut(9).fill(700.0);
        let dead = found(&spoilt);
        assert_eq!(dead.lines(), &[vec![3, 4, 5], vec![9]]);
        assert_eq!(dead.bad().iter().filter(|bad| **bad).count(), 50 + 3 * 40 - 3);
        // A frame of few photons has lines without any, beside others with few.
        let mut faint = Array2::zeros((40, 50));
        faint[[12, 14]] = 1.0;
        faint[[20, 31]] = 2.0;
        assert!(found(&faint).bad().iter().all(|bad| !bad));
    }

    #[test]
    fn blocks_of_one_value_are_marked_and_saturation_is_not() {
        let mut spoilt = frame(500.0);
        spoilt.slice_mut(s![10..14, 20..26]).fill(0.0);
        spoilt.slice_mut(s![0..3, 47..50]).fill(505.5);
        let dead = found(&spoilt);
        assert_eq!(dead.blocks(), [[47, 0, 3, 3], [20, 10, 6, 4]]);
        assert_eq!(dead.bad().iter().filter(|bad| **bad).count(), 24 + 9);
        // The largest value is that of light beyond the detector's range.
        spoilt.slice_mut(s![30..34, 30..34]).fill(4095.0);
        assert_eq!(found(&spoilt).bad(), dead.bad());
        // Counts of two values have blocks of one by chance, among others of the same.
        let coarse = Array2::from_shape_fn((40, 50), |(y, x)| f64::from(u8::from((y / 4 + x / 4) % 2 == 0)) - 1.0);
        assert!(found(&coarse).blocks().is_empty());
    }
}
