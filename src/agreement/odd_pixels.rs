//! Pixels that no detector measures: counts that wrapped, and columns and rows with one value.

use ndarray::{Array3, ArrayView2, ArrayView3, Axis};
use std::borrow::Cow;
use std::collections::BTreeSet;

/// The largest count of 16 bits without a sign.
const LARGEST_U16: f64 = 65_535.0;
/// Counts from either end of these 16 bits within which pixels without light are after a
/// subtraction of equal levels: 50 standard deviations of a read noise of 40 counts.
const NEAR: f64 = 2_000.0;
/// Least part of the pixels at the edge that is near each end: noise about 0 puts half of them
/// there.
const LEAST_PART: f64 = 0.1;
/// Largest part of the pixels of the lines beside a dead one that have its value: beside a line of
/// a frame of few photons, all of which are 0, nearly all are 0, too.
const MOST_EQUAL: f64 = 0.5;

/// Why `counts` `[image, y, x]` are refused: differences of unsigned 16-bit counts below 0 became
/// large.
pub(crate) fn wrapped(counts: ArrayView3<f64>) -> Option<String> {
    let (rows, columns) = (counts.len_of(Axis(1)), counts.len_of(Axis(2)));
    let is_edge = |y: usize, x: usize| y < 2 || x < 2 || y + 2 >= rows || x + 2 >= columns;
    let (mut all, mut low, mut high) = (0, 0, 0);
    for ((_, y, x), &count) in counts.indexed_iter() {
        if count.is_finite() && (count.fract() != 0.0 || !(0.0..=LARGEST_U16).contains(&count)) {
            return None;
        }
        if is_edge(y, x) && count.is_finite() {
            all += 1;
            low += usize::from(count < NEAR);
            high += usize::from(count > LARGEST_U16 - NEAR);
        }
    }
    let part = |of: usize| of as f64 / f64::from(all.max(1));
    (part(low).min(part(high)) > LEAST_PART).then(|| {
        format!(
            "{:.0} % of the pixels at the edge have counts near {LARGEST_U16}, and {:.0} % near 0: a subtraction of unsigned 16-bit counts wrapped \
             below 0; counts that were subtracted as signed or as floating-point numbers are needed",
            100.0 * part(high),
            100.0 * part(low)
        )
    })
}

/// The good pixels of `images` `[image, y, x]` without the columns and rows all of which have one
/// value, where the lines beside them do not: `bad` with these, and the numbers of such columns,
/// and of such rows, of any image. Noise gives no line one value.
pub(crate) fn without_dead_lines<'a>(
    images: ArrayView3<f64>,
    bad: &'a Array3<bool>,
) -> (Cow<'a, Array3<bool>>, [BTreeSet<usize>; 2]) {
    let (mut marked, mut found) = (Cow::Borrowed(bad), [BTreeSet::new(), BTreeSet::new()]);
    for (number, image) in images.outer_iter().enumerate() {
        // A column has one value but where it crosses a row of another.
        for axis in [0, 1, 0] {
            let across = Axis(1 - axis);
            for line in dead(image, marked.index_axis(Axis(0), number), across) {
                marked.to_mut().index_axis_mut(Axis(0), number).index_axis_mut(across, line).fill(true);
                found[axis].insert(line);
            }
        }
    }
    (marked, found)
}

/// The lines across an axis whose pixels have one value.
fn dead(image: ArrayView2<f64>, bad: ArrayView2<bool>, across: Axis) -> Vec<usize> {
    let value = |line: usize| {
        let (values, bad) = (image.index_axis(across, line), bad.index_axis(across, line));
        let mut good = values.iter().zip(bad).filter(|(_, bad)| !**bad).map(|(value, _)| *value);
        let first = good.next().filter(|first| first.is_finite())?;
        // Of a few good pixels nothing is known.
        let is_known = || 2 * bad.iter().filter(|bad| !**bad).count() > bad.len();
        (good.all(|value| value == first) && is_known()).then_some(first)
    };
    let size = image.len_of(across);
    let values: Vec<Option<f64>> = (0..size).map(value).collect();
    let differs = |line: Option<usize>, value: f64| {
        line.is_some_and(|line| {
            let own = image.index_axis(across, line);
            let equal = own.iter().filter(|other| **other == value).count();
            (equal as f64) < MOST_EQUAL * own.len() as f64
        })
    };
    let is_dead = |line: &usize| {
        values[*line].is_some_and(|value| {
            let before = (0..*line).rev().find(|&other| values[other].is_none());
            let behind = (line + 1..size).find(|&other| values[other].is_none());
            differs(before, value) || differs(behind, value)
        })
    };
    (0..size).filter(is_dead).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Counts from `level` to 12 above it, in no order.
    fn frame(level: f64) -> Array3<f64> {
        let mixed = |at: usize| (at * at * 7919 + at * 104_729) / 31;
        Array3::from_shape_fn((2, 24, 30), |(i, y, x)| level + (mixed(720 * i + 30 * y + x) % 13) as f64)
    }

    #[test]
    fn lines_of_one_value_are_marked() {
        let none = Array3::from_elem((2, 24, 30), false);
        let lines = |images: &Array3<f64>| without_dead_lines(images.view(), &none).1.map(Vec::from_iter);
        assert_eq!(lines(&frame(5.0)), [vec![], vec![]]);
        let mut spoilt = frame(5.0);
        spoilt.index_axis_mut(Axis(0), 1).slice_mut(ndarray::s![.., 3..6]).fill(0.0);
        spoilt.slice_mut(ndarray::s![.., 9, ..]).fill(700.0);
        assert_eq!(lines(&spoilt), [vec![3, 4, 5], vec![9]]);
        let (marked, _) = without_dead_lines(spoilt.view(), &none);
        // Three columns cross one row of the second image, which is marked in both.
        assert_eq!(marked.iter().filter(|bad| **bad).count(), 2 * 30 + 3 * 24 - 3);
        // A frame of few photons has lines without any, beside others with few.
        let mut faint = Array3::zeros((2, 24, 30));
        faint[[0, 12, 14]] = 1.0;
        faint[[1, 13, 15]] = 2.0;
        assert_eq!(lines(&faint), [vec![], vec![]]);
    }

    #[test]
    fn counts_that_wrapped_are_refused() {
        let noise = frame(0.0) - 6.0;
        let wrap = |counts: &Array3<f64>| counts.mapv(|count| count.rem_euclid(65_536.0));
        assert!(wrapped(wrap(&noise).view()).unwrap().contains("wrapped"));
        assert!(wrapped(noise.view()).is_none() && wrapped(frame(500.0).view()).is_none());
        assert!(wrapped((wrap(&noise) + 0.5).view()).is_none());
    }
}
