//! Pupils given as maps, and least squares over a pupil.

use cophase::Error;
use cophase::pupil::Grid;
use cophase::pupil::{Aperture, Pupil};
use ndarray::{Array2, array};

/// Two illuminated columns and a dark one between them, on a 3 m grid.
fn two_segments() -> (Grid, Array2<f64>, Array2<i32>) {
    let amplitude = array![[1.0, 0.0, 0.5], [1.0, 0.0, 1.0], [1.0, 0.0, 0.5]];
    let labels = array![[0, -1, 1], [0, -1, 1], [0, -1, 1]];
    (Grid::new(3, 3.0).unwrap(), amplitude, labels)
}

#[test]
fn maps_of_a_pupil_are_its_pupil() {
    let aperture = Aperture::keck();
    let pupil = aperture.pupil(&Grid::new(120, 10.95).unwrap()).unwrap();
    let read = Pupil::from_maps(pupil.grid, pupil.amplitude.clone(), Some(pupil.owner.clone())).unwrap();
    assert_eq!((&read.amplitude, &read.owner), (&pupil.amplitude, &pupil.owner));
    for (read, exact) in read.segments.iter().zip(aperture.segments()) {
        // A cell on a border belongs to one segment: up to half a row of cells changes its segment
        // at two opposite edges, 0.046 m · 0.9 m each, 0.78 m from the centre of 2.1 m².
        assert!((read.x_m - exact.x_m).hypot(read.y_m - exact.y_m) < 0.031, "{read:?} against {exact:?}");
    }
}

#[test]
fn without_labels_the_telescope_is_monolithic() {
    let (grid, amplitude, _) = two_segments();
    let pupil = Pupil::from_maps(grid, amplitude, None).unwrap();
    assert_eq!(pupil.segments.len(), 1);
    assert_eq!((pupil.segments[0].x_m, pupil.segments[0].y_m), (-0.2, 0.0));
    assert_eq!(pupil.owner, array![[0, -1, 0], [0, -1, 0], [0, -1, 0]]);
    assert_eq!(pupil.segment_areas(), [5.0]);
}

#[test]
fn an_edge_without_labels_belongs_to_its_neighbour() {
    let (grid, amplitude, mut labels) = two_segments();
    labels[[0, 2]] = -1;
    // A label outside the illuminated area has no effect.
    labels[[1, 1]] = 7;
    let pupil = Pupil::from_maps(grid, amplitude, Some(labels)).unwrap();
    assert_eq!(pupil.owner, array![[0, -1, 1], [0, -1, 1], [0, -1, 1]]);
}

#[test]
fn labels_of_unsigned_integers_for_no_segment_are_no_segment() {
    let pupil = Aperture::keck().pupil(&Grid::new(120, 10.95).unwrap()).unwrap();
    for nowhere in [255, 65_535] {
        // The rim of the mirror is in no segment of such maps.
        let labels = pupil.owner.mapv(|owner| if owner < 0 { nowhere } else { owner });
        let rim = Array2::from_shape_fn(labels.dim(), |(y, x)| {
            let near = |c: usize| c.saturating_sub(1)..(c + 2).min(120);
            let is_at_edge = near(y).any(|v| near(x).any(|u| pupil.owner[[v, u]] < 0));
            if is_at_edge { nowhere } else { labels[[y, x]] }
        });
        let read = Pupil::from_maps(pupil.grid, pupil.amplitude.clone(), Some(rim)).unwrap();
        assert_eq!(read.segments.len(), 36);
        let moved = read.owner.iter().zip(&pupil.owner).filter(|(read, own)| read != own).count();
        assert!(moved < 30, "{moved} samples are of another segment");
    }
    // The same number is a segment's where its samples are lit.
    let (grid, amplitude, labels) = two_segments();
    let pupil =
        Pupil::from_maps(grid, amplitude, Some(labels.mapv(|label| if label == 1 { 255 } else { label }))).unwrap();
    assert_eq!(pupil.segments.len(), 2);
}

#[test]
fn invalid_maps_are_refused_with_the_place_and_the_value() {
    let (grid, amplitude, _) = two_segments();
    for value in [f64::NAN, f64::INFINITY, -0.1, 1.5] {
        let mut broken = amplitude.clone();
        broken[[1, 2]] = value;
        let message = Pupil::from_maps(grid, broken, None).unwrap_err().to_string();
        assert!(message.contains("row 1, column 2") && message.contains(&value.to_string()), "{message}");
    }
    let refused = |amplitude: &Array2<f64>, labels: Option<Array2<i32>>| {
        Pupil::from_maps(grid, amplitude.clone(), labels).unwrap_err()
    };
    assert!(matches!(refused(&Array2::zeros((3, 3)), None), Error::Value(_)));
    assert!(matches!(refused(&Array2::ones((3, 4)), None), Error::Shape(_)));
    assert!(matches!(refused(&amplitude, Some(Array2::zeros((2, 3)))), Error::Shape(_)));
    // Illuminated samples far from any label.
    let far = Grid::new(9, 9.0).unwrap();
    let mut corner = Array2::from_elem((9, 9), -1);
    corner[[0, 0]] = 0;
    let message = Pupil::from_maps(far, Array2::ones((9, 9)), Some(corner)).unwrap_err().to_string();
    assert!(message.contains("row 0, column 3"), "{message}");
}

#[test]
fn labels_may_be_any_numbers() {
    let (grid, amplitude, labels) = two_segments();
    let owner = Pupil::from_maps(grid, amplitude.clone(), Some(labels.clone())).unwrap().owner;
    // From 1, with a gap, in the other order, large.
    for names in [[0, 1], [1, 2], [3, 17], [0, i32::MAX]] {
        let named = labels.mapv(|label| usize::try_from(label).map_or(-1, |segment| names[segment]));
        let pupil = Pupil::from_maps(grid, amplitude.clone(), Some(named)).unwrap();
        assert_eq!(pupil.owner, owner);
        assert_eq!(pupil.segments.iter().map(|segment| segment.label).collect::<Vec<_>>(), names);
    }
    let turned = labels.mapv(|label| if label < 0 { label } else { 9 - label });
    let pupil = Pupil::from_maps(grid, amplitude, Some(turned)).unwrap();
    assert_eq!((pupil.owner[[0, 0]], pupil.segments[1].label, pupil.segments[1].x_m), (1, 9, -1.0));
}

#[test]
fn where_segments_begin_at_1_zero_is_none() {
    let whole = Aperture::keck().pupil(&Grid::new(120, 10.95).unwrap()).unwrap();
    // As POPPY labels them: from 1, 0 elsewhere, and at edges that are illuminated in part, too.
    let is_rim = |at: (usize, usize)| whole.amplitude[at] < 0.5;
    let from_1 = Array2::from_shape_fn((120, 120), |at| if is_rim(at) { 0 } else { whole.owner[at] + 1 });
    assert!(from_1.indexed_iter().any(|(at, label)| *label == 0 && whole.amplitude[at] > 0.0));
    let read = Pupil::from_maps(whole.grid, whole.amplitude.clone(), Some(from_1)).unwrap();
    assert_eq!(read.segments.len(), 36);
    assert_eq!(read.segments.iter().map(|segment| segment.label).collect::<Vec<_>>(), (1..=36).collect::<Vec<_>>());
    for (read, exact) in read.segments.iter().zip(&whole.segments) {
        assert!((read.x_m - exact.x_m).hypot(read.y_m - exact.y_m) < 0.05, "{read:?} against {exact:?}");
    }
    // A segment with label 0 and nothing negative is one: it has samples inside.
    let from_0 = whole.owner.mapv(|owner| owner.max(0));
    let read = Pupil::from_maps(whole.grid, whole.amplitude.clone(), Some(from_0)).unwrap();
    assert_eq!((read.segments.len(), read.segments[0].label), (36, 0));
}

#[test]
fn piston_tip_and_tilt_leave_nothing_of_a_plane() {
    let pupil = Aperture::keck().pupil(&Grid::new(120, 10.95).unwrap()).unwrap();
    let at = |j| pupil.grid.coordinate_m(j);
    let plane = Array2::from_shape_fn((120, 120), |(y, x)| 40.0 + 30.0 * at(x) - 70.0 * at(y));
    let flat = pupil.remove_piston_tip_tilt(plane.view()).unwrap();
    // A few hundred nm to start with, 1e-16 relative, some 1e4 terms.
    assert!(pupil.rms(flat.view()).unwrap() < 1e-11);
    assert!(flat.indexed_iter().all(|(at, value)| value.is_nan() == (pupil.amplitude[at] == 0.0)));
    // The best fit to a cubic leaves a residual without weighted overlap with 1, x or y.
    let cubic = Array2::from_shape_fn((120, 120), |(y, x)| at(x).powi(3) + at(y) * at(x) - 3.0);
    let rest = pupil.remove_piston_tip_tilt(cubic.view()).unwrap();
    for power in [(0, 0), (1, 0), (0, 1)] {
        let overlap =
            |((y, x), a): ((usize, usize), &f64)| a * rest[[y, x]] * at(x).powi(power.0) * at(y).powi(power.1);
        let sum: f64 = pupil.amplitude.indexed_iter().filter(|(_, a)| **a > 0.0).map(overlap).sum();
        // The overlap that was removed, Σ A x⁴, is 1e6; a sum of 1e4 terms rounds to some 100
        // epsilons of it, twice.
        assert!(sum.abs() < 1e-7, "{power:?}: {sum:e}");
    }
}

#[test]
fn statistics_are_weighted_and_bad_maps_refused() {
    let (grid, amplitude, labels) = two_segments();
    let pupil = Pupil::from_maps(grid, amplitude, Some(labels)).unwrap();
    assert_eq!(pupil.weight_sum(), 5.0);
    assert_eq!(pupil.segment_areas(), [3.0, 2.0]);
    let map = array![[1.0, f64::NAN, 4.0], [1.0, f64::NAN, 2.0], [1.0, f64::NAN, 4.0]];
    // (3·1 + 2·0.5·16 + 4) / 5
    assert!((pupil.rms(map.view()).unwrap().powi(2) - 23.0 / 5.0).abs() < 1e-14);
    let mean = (3.0 + 4.0 + 2.0) / 5.0;
    assert!((pupil.remove_piston(map.view()).unwrap()[[0, 2]] - (4.0 - mean)).abs() < 1e-14);
    let mut broken = map.clone();
    broken[[0, 0]] = f64::NAN;
    assert!(pupil.rms(broken.view()).unwrap_err().to_string().contains("row 0, column 0"));
    assert!(matches!(pupil.remove_piston(Array2::zeros((2, 3)).view()), Err(Error::Shape(_))));
}

#[test]
fn an_undetermined_tilt_is_not_removed() {
    let grid = Grid::new(3, 3.0).unwrap();
    let line = array![[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [0.0, 0.0, 0.0]];
    let pupil = Pupil::from_maps(grid, line, None).unwrap();
    let map = array![[0.0, 0.0, 0.0], [1.0, 4.0, 1.0], [0.0, 0.0, 0.0]];
    let rest = pupil.remove_piston_tip_tilt(map.view()).unwrap();
    for (value, expected) in rest.row(1).iter().zip([-1.0, 2.0, -1.0]) {
        assert!((value - expected).abs() < 1e-15);
    }
}
