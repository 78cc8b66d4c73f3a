//! Layout of the segments, as corrections need it: edges that they share, and the plane through
//! them.

use crate::pupil::Segment;
use ndarray::{Array1, Array2, Axis};

/// Pairs of segments that share an edge: their centres are as near as those of any two, within a
/// tenth of that distance.
pub(super) fn edges(segments: &[Segment]) -> Vec<(usize, usize)> {
    let distance_m =
        |(i, j): (usize, usize)| (segments[i].x_m - segments[j].x_m).hypot(segments[i].y_m - segments[j].y_m);
    let pairs = || (0..segments.len()).flat_map(|i| (0..i).map(move |j| (j, i)));
    let nearest_m = pairs().map(distance_m).fold(f64::INFINITY, f64::min);
    pairs().filter(|pair| distance_m(*pair) < 1.1 * nearest_m).collect()
}

/// Orthonormal directions of the pistons that all segments have in common: their mean, and the
/// plane through them where there are more than three segments, which define any plane.
pub(super) fn common_directions(segments: &[Segment]) -> Vec<Array1<f64>> {
    let values = |value: &dyn Fn(&Segment) -> f64| segments.iter().map(value).collect::<Array1<f64>>();
    let plane = [values(&|_| 1.0), values(&|segment| segment.x_m), values(&|segment| segment.y_m)];
    let mut directions: Vec<Array1<f64>> = Vec::new();
    for direction in plane.into_iter().take(if segments.len() > 3 { 3 } else { 1 }) {
        let mut new = direction.clone();
        directions.iter().for_each(|known| new.scaled_add(-known.dot(&direction), known));
        let (left, all) = (new.dot(&new), direction.dot(&direction));
        // Segments in a row along an axis have no such direction.
        if left > 1e-12 * all {
            directions.push(new / left.sqrt());
        }
    }
    directions
}

/// Projection of `count` pistons that removes `directions`, which are orthonormal,
/// `[segment, segment]`.
pub(super) fn projection_without(count: usize, directions: &[Array1<f64>]) -> Array2<f64> {
    let mut projection = Array2::eye(count);
    for direction in directions {
        projection -= &(&direction.view().insert_axis(Axis(1)) * &direction.view().insert_axis(Axis(0)));
    }
    projection
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn segments_share_edges_with_their_neighbours() {
        // Seven hexagons: six edges about the central one, and six between the others.
        let ring = (0..6).map(|k| (f64::from(k) * std::f64::consts::FRAC_PI_3).sin_cos());
        let centres = std::iter::once((0.0, 0.0)).chain(ring);
        let segments: Vec<Segment> = centres.map(|(y_m, x_m)| Segment { x_m, y_m, label: 0 }).collect();
        let edges = edges(&segments);
        assert_eq!(edges.len(), 12);
        assert_eq!(edges.iter().filter(|(i, _)| *i == 0).count(), 6);
    }

    #[test]
    fn the_projection_removes_the_plane_alone() {
        let at = |x_m: f64, y_m: f64| Segment { x_m, y_m, label: 0 };
        let segments = [at(0.0, 0.0), at(1.0, 0.0), at(0.5, 0.9), at(-0.5, 0.9), at(-1.0, 0.1), at(0.4, -0.9)];
        let flat = projection_without(6, &common_directions(&segments));
        let plane: Array1<f64> = segments.iter().map(|segment| 3.0 - 7.0 * segment.x_m + 2.0 * segment.y_m).collect();
        assert!(flat.dot(&plane).iter().all(|nm| nm.abs() < 1e-13));
        // A projection whose rank lacks three.
        assert!((&flat.dot(&flat) - &flat).iter().all(|off| off.abs() < 1e-14));
        assert!((flat.diag().sum() - 3.0).abs() < 1e-13);
        let mean = projection_without(3, &common_directions(&segments[..3]));
        assert!((mean.diag().sum() - 2.0).abs() < 1e-14);
        let mean = projection_without(6, &common_directions(&segments)[..1]);
        assert!((mean.diag().sum() - 5.0).abs() < 1e-14);
        let row = [at(-1.5, 0.0), at(-0.5, 0.0), at(0.5, 0.0), at(1.5, 0.0)];
        let row = projection_without(4, &common_directions(&row));
        assert!((row.diag().sum() - 2.0).abs() < 1e-14);
    }
}
