//! Labels of segments in a map: any whole numbers, with gaps or without.

use crate::{Error, Result};
use ndarray::Array2;
use std::collections::BTreeSet;

/// Largest distance of an unlabelled illuminated sample from a labelled one, in samples: at an
/// anti-aliased edge or a gap. A larger distance means that a label is missing.
const RIM: usize = 2;
/// Labels that may stand for no segment: 0, and what −1 becomes in unsigned or is replaced by in
/// short integers.
const NOWHERE: [i32; 5] = [0, 127, 255, 32_767, 65_535];
/// Most segments of a pupil: more labels are another map than one of segments.
const MOST_SEGMENTS: usize = 10_000;

/// The segment of each illuminated sample, −1 elsewhere, and the label of each segment, ascending.
pub(super) fn owners(amplitude: &Array2<f64>, mut labels: Array2<i32>) -> Result<(Array2<i32>, Vec<i32>)> {
    for outside in NOWHERE {
        if is_outside(amplitude, &labels, outside) {
            labels.mapv_inplace(|label| if label == outside { -1 } else { label });
        }
    }
    let mut label = Array2::from_elem(labels.dim(), -1);
    for ((y, x), _) in amplitude.indexed_iter().filter(|(_, a)| **a > 0.0) {
        label[[y, x]] = nearest_label(amplitude, &labels, y, x).ok_or_else(|| {
            Error::Value(format!(
                "the pupil is illuminated at row {y}, column {x}, but there is no segment label within {RIM} samples: label \
                 the segments with numbers from 0 or 1, and all other samples −1, or 0 where segments begin at 1"
            ))
        })?;
    }
    let found: Vec<i32> =
        label.iter().copied().filter(|label| *label >= 0).collect::<BTreeSet<i32>>().into_iter().collect();
    if found.len() > MOST_SEGMENTS {
        let count = found.len();
        return Err(Error::Value(format!("the map has {count} segment labels: at most {MOST_SEGMENTS} are accepted")));
    }
    let number = |label: i32| found.binary_search(&label).map_or(-1, |number| number as i32);
    Ok((label.mapv(number), found))
}

/// Whether a label means that there is no segment: where no label is negative and all illuminated
/// samples with it are at the rim of a segment. A segment has samples farther inside.
fn is_outside(amplitude: &Array2<f64>, labels: &Array2<i32>, outside: i32) -> bool {
    let has_it = labels.iter().any(|label| *label == outside);
    if !has_it || labels.iter().any(|label| *label < 0) || labels.iter().all(|label| *label == outside) {
        return false;
    }
    // The number of a segment has few samples without light.
    let lights = || labels.iter().zip(amplitude).filter(|(label, _)| **label == outside).map(|(_, a)| *a > 0.0);
    if outside != 0 && 2 * lights().filter(|is_lit| *is_lit).count() > lights().count() {
        return false;
    }
    let others = labels.mapv(|label| if label == outside { -1 } else { label });
    let lit = labels.indexed_iter().filter(|(at, label)| **label == outside && amplitude[*at] > 0.0);
    lit.map(|(at, _)| at).all(|(y, x)| nearest_label(amplitude, &others, y, x).is_some())
}

/// The label of the nearest labelled illuminated sample; among equally near ones, the first in grid
/// order.
fn nearest_label(amplitude: &Array2<f64>, labels: &Array2<i32>, y: usize, x: usize) -> Option<i32> {
    if labels[[y, x]] >= 0 {
        return Some(labels[[y, x]]);
    }
    let around = |c: usize, end: usize| c.saturating_sub(RIM)..(c + RIM + 1).min(end);
    let near = around(y, labels.nrows()).flat_map(|v| around(x, labels.ncols()).map(move |u| (v, u)));
    near.filter(|&at| labels[at] >= 0 && amplitude[at] > 0.0)
        .min_by_key(|&(v, u)| v.abs_diff(y).pow(2) + u.abs_diff(x).pow(2))
        .map(|at| labels[at])
}
