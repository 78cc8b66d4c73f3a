//! Inpainting of the slopes of masked subapertures from their neighbours.

use crate::{Error, Result};
use cophase_numerics::systems::least_squares;
use ndarray::{Array2, s};

/// Inpainting matrix M: replaces the slopes of masked subapertures, separately for the x slopes and
/// the y slopes.
///
/// It uses the plate metaphor, as the paper does (J. D'Errico, `inpaint_nans`, MATLAB Central,
/// methods 0 and 1): masked cells of the map of lenslets, **and** those outside the pupil, are
/// filled so that the sum of squares of the discrete Laplacian over all cells that touch a filled
/// one is least. On the border of the map the Laplacian has only the second difference along the
/// border; at a corner it has none. Unmasked slopes are not changed.
///
/// The fill is linear in the unmasked slopes, so the matrix is computed once. The maps 1, x, y and
/// xy satisfy every equation and are filled exactly.
///
/// The equations are solved by a dense QR decomposition. Its error grows with the condition number,
/// that of the normal equations with its square. The system is smaller than the interaction matrix
/// in both directions, so its solution takes less time than the reconstructor's.
#[derive(Debug, Clone, PartialEq)]
pub struct Inpainting {
    /// `[subapertures, subapertures]`: filled = matrix · measured.
    matrix: Array2<f64>,
}

impl Inpainting {
    /// Inpainting matrix for the masked ones of `subapertures` (flat indices
    /// `row·lenslets_across + column`, ascending).
    ///
    /// # Errors
    /// [`Error::Shape`] for a mask of wrong length, [`Error::Value`] for subapertures that are out
    /// of range or not ascending, or if the unmasked ones do not determine the fill (fewer than
    /// four, or all in one line).
    pub fn new(lenslets_across: usize, subapertures: &[usize], mask: &[bool]) -> Result<Self> {
        super::check_subapertures(lenslets_across, subapertures)?;
        super::check_mask(subapertures, mask)?;
        let count = subapertures.len();
        let mut matrix = Array2::eye(count);
        if !mask.contains(&true) {
            return Ok(Self { matrix });
        }
        let cells = Cells::new(lenslets_across, subapertures, mask);
        let (unknown, known) = cells.equations();
        let fill = least_squares(unknown.view(), known.view()).ok_or_else(|| {
            let good = mask.iter().filter(|&&masked| !masked).count();
            Error::Value(format!(
                "{good} unmasked subapertures of {count} do not determine the slopes of the masked ones; mask fewer"
            ))
        })?;
        for (row, index) in subapertures.iter().enumerate().filter(|&(row, _)| mask[row]) {
            matrix[[row, row]] = 0.0;
            if let Cell::Filled(place) = cells.kinds[*index] {
                for (column, _) in mask.iter().enumerate().filter(|(_, masked)| !**masked) {
                    if let Cell::Good(good) = cells.kinds[subapertures[column]] {
                        matrix[[row, column]] = fill[[place, good]];
                    }
                }
            }
        }
        Ok(Self { matrix })
    }

    /// `[subapertures, subapertures]`: filled slopes of one axis = matrix · measured slopes. The
    /// columns of masked subapertures are zero.
    pub fn matrix(&self) -> &Array2<f64> {
        &self.matrix
    }

    /// Folds M into a matrix `[rows, 2·subapertures]` that acts on filled slopes:
    /// `reconstructor · M` for both axes, which acts on measured slopes.
    pub(super) fn fold_into(&self, reconstructor: &Array2<f64>) -> Array2<f64> {
        let count = self.matrix.nrows();
        let mut product = Array2::zeros(reconstructor.dim());
        for axis in [s![.., ..count], s![.., count..]] {
            product.slice_mut(axis).assign(&reconstructor.slice(axis).dot(&self.matrix));
        }
        product
    }
}

/// Kind of a cell of the map of lenslets, with its index among the cells of that kind.
#[derive(Clone, Copy)]
enum Cell {
    Good(usize),
    Filled(usize),
}

struct Cells {
    across: usize,
    kinds: Vec<Cell>,
    good: usize,
    filled: usize,
}

impl Cells {
    fn new(across: usize, subapertures: &[usize], mask: &[bool]) -> Self {
        let mut trusted = vec![false; across * across];
        for (&index, masked) in subapertures.iter().zip(mask) {
            trusted[index] = !masked;
        }
        let (mut good, mut filled) = (0, 0);
        let kinds = trusted
            .iter()
            .map(|&trusted| {
                let (kind, count): (fn(usize) -> Cell, _) =
                    if trusted { (Cell::Good, &mut good) } else { (Cell::Filled, &mut filled) };
                *count += 1;
                kind(*count - 1)
            })
            .collect();
        Self { across, kinds, good, filled }
    }

    /// Terms of the Laplacian at a cell: up to two second differences.
    fn laplacian(&self, index: usize) -> Vec<(usize, f64)> {
        let inside = |i: usize| i > 0 && i + 1 < self.across;
        let mut terms = Vec::with_capacity(6);
        for (along, step) in [(index % self.across, 1), (index / self.across, self.across)] {
            if inside(along) {
                terms.extend([(index - step, 1.0), (index, -2.0), (index + step, 1.0)]);
            }
        }
        terms
    }

    /// Equations `unknown · filled = known · good`, one row for each cell whose Laplacian touches a
    /// filled one.
    fn equations(&self) -> (Array2<f64>, Array2<f64>) {
        let touches = |terms: &Vec<(usize, f64)>| terms.iter().any(|&(i, _)| matches!(self.kinds[i], Cell::Filled(_)));
        let rows: Vec<_> = (0..self.kinds.len()).map(|index| self.laplacian(index)).filter(touches).collect();
        let mut unknown = Array2::zeros((rows.len(), self.filled));
        let mut known = Array2::zeros((rows.len(), self.good));
        for (row, terms) in rows.iter().enumerate() {
            for &(index, weight) in terms {
                match self.kinds[index] {
                    Cell::Filled(place) => unknown[[row, place]] += weight,
                    Cell::Good(place) => known[[row, place]] -= weight,
                }
            }
        }
        (unknown, known)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{keck, keck_mask};
    use super::*;
    use ndarray::Array1;

    /// Largest error of the fill of a map f(x, y), x and y in lenslets from the centre. Unmasked
    /// slopes must not change.
    fn largest_error(map: impl Fn(f64, f64) -> f64) -> f64 {
        let (_, subapertures) = keck(240);
        let mask = keck_mask();
        let inpainting = Inpainting::new(20, &subapertures, &mask).unwrap();
        let centred = |i: usize| i as f64 - 9.5;
        let truth: Array1<f64> = subapertures.iter().map(|i| map(centred(i % 20), centred(i / 20))).collect();
        // The measured values of masked slopes must have no effect.
        let mut measured = truth.clone();
        measured.iter_mut().zip(&mask).filter(|(_, masked)| **masked).for_each(|(slope, _)| *slope = 1e3);
        let filled = inpainting.matrix().dot(&measured);
        let mut worst = 0f64;
        for (i, masked) in mask.iter().enumerate() {
            assert!(*masked || filled[i] == truth[i]);
            worst = worst.max((filled[i] - truth[i]).abs());
        }
        worst
    }

    #[test]
    fn maps_without_second_differences_are_filled_exactly() {
        // Maps whose second differences vanish satisfy every equation, so they are the
        // least-squares solution. Rounding: values up to 180, and a condition number of about 1e3
        // (two second differences over a dozen cells).
        for exact in [|_: f64, _: f64| 1.0, |x: f64, y: f64| 3.0 * x - 5.0 * y + 2.0, |x: f64, y: f64| 2.0 * x * y] {
            let error = largest_error(exact);
            assert!(error < 1e-10, "{error}");
        }
    }

    #[test]
    fn smooth_maps_are_filled_closely() {
        // Equations at the map's border have one of the two second differences, so x² − y² has an
        // error near the free edge of the plate. The plate bends less than x² everywhere, by about
        // the curvature, 2, times the squared width of a masked patch, 1 to 2 cells, over 8:
        // below 2. The values go up to 90.
        let saddle = largest_error(|x, y| x * x - y * y);
        let bowl = largest_error(|x, y| x * x + y * y);
        println!("saddle {saddle:.3}, bowl {bowl:.3}");
        assert!(saddle < 2.0 && bowl < 2.0);
        // A wave of 20 lenslets: its curvature is (2π/20)² = 0.1 of its amplitude.
        let wave = largest_error(|x, _| (std::f64::consts::TAU * x / 20.0).sin());
        println!("wave {wave:.3}");
        assert!(wave < 0.1);
    }

    #[test]
    fn the_fill_has_the_least_laplacian() {
        // A map without symmetry. The gradient of the sum of squares vanishes to rounding, and the
        // function is convex, so this is its minimum.
        let subapertures: Vec<usize> = (0..36).filter(|&i| i != 0 && i != 35 && i != 30).collect();
        let mask: Vec<bool> = subapertures.iter().map(|&i| [8, 14, 15, 28].contains(&i)).collect();
        let cells = Cells::new(6, &subapertures, &mask);
        let (unknown, known) = cells.equations();
        assert_eq!((cells.good, cells.filled), (29, 7));
        let good: Array1<f64> = (0..cells.good).map(|i| (i as f64 * 1.7).sin()).collect();
        let fill = least_squares(unknown.view(), known.view()).unwrap().dot(&good);
        let gradient = unknown.t().dot(&(unknown.dot(&fill) - known.dot(&good)));
        assert!(gradient.iter().all(|value| value.abs() < 1e-13), "{gradient}");
    }

    #[test]
    fn no_mask_is_the_identity_and_invalid_masks_are_refused() {
        let all: Vec<usize> = (0..9).collect();
        assert_eq!(Inpainting::new(3, &all, &[false; 9]).unwrap().matrix(), &Array2::<f64>::eye(9));
        assert!(Inpainting::new(3, &all, &[true; 9]).is_err());
        // Three in one line do not determine the slope across the line.
        assert!(Inpainting::new(3, &all, &[false, false, false, true, true, true, true, true, true]).is_err());
        assert!(Inpainting::new(3, &all, &[false; 8]).is_err());
        assert!(Inpainting::new(3, &[0, 9], &[false; 2]).is_err());
        assert!(Inpainting::new(3, &[1, 1], &[false; 2]).is_err());
        assert!(Inpainting::new(1, &[0], &[true]).is_err());
    }
}
