//! Residual RMS over the pupil (weight A), with piston, tip and tilt removed by least squares: of
//! an estimate against the truth, and its expectation from a covariance.

use crate::modes::Basis;
use crate::pupil::Pupil;
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView2, ArrayView3, Axis, Zip, s};
use std::ops::Range;

/// RMS over the pupil of `estimate_nm − truth_nm` (`[y, x]`, nm), piston, tip and tilt removed, in
/// nm.
///
/// # Errors
/// [`Error::Shape`] for maps that do not have the pupil's shape, [`Error::Value`] for a value
/// inside the pupil that is not finite.
pub fn residual_nm(pupil: &Pupil, estimate_nm: ArrayView2<f64>, truth_nm: ArrayView2<f64>) -> Result<f64> {
    if estimate_nm.dim() != truth_nm.dim() {
        let ((rows, columns), (wanted_rows, wanted_columns)) = (estimate_nm.dim(), truth_nm.dim());
        return Err(Error::Shape(format!(
            "an estimate of {rows}x{columns} samples cannot be compared with a truth of {wanted_rows}x{wanted_columns}; \
             the same grid is needed"
        )));
    }
    pupil.rms(pupil.remove_piston_tip_tilt((&estimate_nm - &truth_nm).view())?.view())
}

/// Gram matrix G of mode maps over the pupil, with piston, tip and tilt removed: with the
/// covariance of the coefficients it gives the expectation of [`residual_nm`].
#[derive(Debug, Clone)]
pub struct MapGram {
    /// `[mode, mode]`.
    products: Array2<f64>,
}

impl MapGram {
    /// Gram matrix of the maps `[mode, y, x]` on the grid of `pupil`, nm per nm.
    ///
    /// # Errors
    /// Those of [`Pupil::remove_piston_tip_tilt`].
    pub fn new(pupil: &Pupil, maps: ArrayView3<f64>) -> Result<Self> {
        let root = pupil.amplitude.mapv(|a| (a / pupil.weight_sum()).sqrt());
        let mut weighted = Array2::zeros((maps.len_of(Axis(0)), pupil.amplitude.len()));
        for (map, mut row) in maps.outer_iter().zip(weighted.outer_iter_mut()) {
            let detrended = pupil.remove_piston_tip_tilt(map)?;
            // The map is NaN outside the pupil, where its weight is 0.
            Zip::from(&mut row)
                .and(&detrended.flatten())
                .and(&root.flatten())
                .for_each(|out, &value, &root| *out = if root > 0.0 { root * value } else { 0.0 });
        }
        Ok(Self { products: weighted.dot(&weighted.t()) })
    }

    /// Gram matrix of the modes of `basis` on the grid of `pupil`, by inner products, because the
    /// maps of hundreds of segments take gigabytes.
    ///
    /// # Errors
    /// Those of [`Basis::gram`].
    pub fn of_basis(pupil: &Pupil, basis: &Basis) -> Result<Self> {
        Self::of_products(pupil, basis, basis.gram(&(&pupil.amplitude / pupil.weight_sum()))?)
    }

    /// As [`MapGram::of_basis`], from the mean `products` of the modes over the pupil.
    ///
    /// # Errors
    /// Those of [`Basis::along`].
    pub(crate) fn of_products(pupil: &Pupil, basis: &Basis, products: Array2<f64>) -> Result<Self> {
        let weight = &pupil.amplitude / pupil.weight_sum();
        let [piston, tip, tilt] = Self::planes(pupil).map(|plane| basis.along(&(plane * &weight)));
        Ok(Self::from_products(products, [piston?, tip?, tilt?]))
    }

    /// That of the modes at `places` alone.
    pub(crate) fn of_modes(&self, places: &[usize]) -> Self {
        Self { products: self.products.select(Axis(0), places).select(Axis(1), places) }
    }

    /// Gram matrix from the mean products over the pupil of the maps with each other (piston, tip
    /// and tilt included), `[mode, mode]`, and with the three [`MapGram::planes`], `[plane][mode]`.
    fn from_products(mut products: Array2<f64>, along: [Vec<f64>; 3]) -> Self {
        // The planes are orthonormal: a map's products with them are its components along them.
        for along in along.map(Array1::from) {
            for (mut row, &part) in products.outer_iter_mut().zip(&along) {
                row.scaled_add(-part, &along);
            }
        }
        Self { products }
    }

    /// Piston, tip and tilt, orthonormal in the mean over the pupil (weight A): `[y, x]` each.
    fn planes(pupil: &Pupil) -> [Array2<f64>; 3] {
        let weight = &pupil.amplitude / pupil.weight_sum();
        let shape = pupil.amplitude.dim();
        let mut planes = [
            Array2::ones(shape),
            Array2::from_shape_fn(shape, |(_, x)| pupil.grid.coordinate_m(x)),
            Array2::from_shape_fn(shape, |(y, _)| pupil.grid.coordinate_m(y)),
        ];
        for k in 0..3 {
            let (before, rest) = planes.split_at_mut(k);
            let plane = &mut rest[0];
            for other in before.iter() {
                let share = (&*plane * other * &weight).sum();
                plane.scaled_add(-share, other);
            }
            let norm = (&*plane * &*plane * &weight).sum().sqrt();
            plane.mapv_inplace(|value| value / norm);
        }
        planes
    }

    /// √(trace of G·C), nm: the root mean square residual of an estimate whose coefficients have
    /// the covariance C = `covariance_nm2`, `[mode, mode]`, about the truth.
    ///
    /// # Errors
    /// [`Error::Shape`] for a covariance of another number of modes.
    pub fn expected_rms_nm(&self, covariance_nm2: ArrayView2<f64>) -> Result<f64> {
        self.expected_rms_of_nm(0..self.products.nrows(), covariance_nm2)
    }

    /// As [`MapGram::expected_rms_nm`], of the modes in `range` alone, which have the covariance
    /// `covariance_nm2`.
    ///
    /// # Errors
    /// As [`MapGram::expected_rms_nm`].
    pub fn expected_rms_of_nm(&self, range: Range<usize>, covariance_nm2: ArrayView2<f64>) -> Result<f64> {
        let products = self.products.slice(s![range.clone(), range]);
        if covariance_nm2.dim() != products.dim() {
            let ((rows, columns), modes) = (covariance_nm2.dim(), products.nrows());
            return Err(Error::Shape(format!(
                "a covariance of {rows}x{columns} was given for {modes} modes; {modes}x{modes} is needed"
            )));
        }
        // G is symmetric.
        let trace = Zip::from(&products).and(&covariance_nm2).fold(0.0, |sum, own, nm2| sum + own * nm2);
        Ok(trace.max(0.0).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Grid;
    use ndarray::{Array3, array};

    /// Pupil with amplitudes between 0 and 1 on 8 × 8 samples over 2 m.
    fn pupil() -> Pupil {
        let amplitude = Array2::from_shape_fn((8, 8), |(y, x)| if y == 0 { 0.0 } else { 0.3 + 0.08 * x as f64 });
        Pupil::from_maps(Grid::new(8, 2.0).unwrap(), amplitude, None).unwrap()
    }

    fn maps() -> Array3<f64> {
        let tilt = |y: usize, x: usize| 3.0 * x as f64 - y as f64 + 2.0;
        Array3::from_shape_fn((3, 8, 8), |(mode, y, x)| match mode {
            0 => tilt(y, x),
            1 => (x as f64 * 0.9).sin() + tilt(y, x),
            _ => (y as f64 * 1.3).cos() * x as f64,
        })
    }

    #[test]
    fn plane_between_estimate_and_truth_is_not_a_residual() {
        let (pupil, maps) = (pupil(), maps());
        let [plane, wave] = [0, 1].map(|mode| maps.index_axis(Axis(0), mode).to_owned());
        // The maps are of the order of 20 nm: rounding leaves about 1e-15 of that.
        assert!(residual_nm(&pupil, (&wave + &plane).view(), wave.view()).unwrap() < 1e-13);
        assert!(residual_nm(&pupil, wave.view(), plane.view()).unwrap() > 0.1);
    }

    #[test]
    fn the_covariance_of_one_draw_gives_its_residual() {
        // C = c·cᵀ is the covariance of ±c: the residual of that draw is the expectation for any
        // modes.
        let (pupil, maps) = (pupil(), maps());
        let c = array![0.7, -1.9, 0.4];
        let map = maps.outer_iter().zip(&c).fold(Array2::zeros((8, 8)), |sum, (map, c)| sum + &map * *c);
        let found = residual_nm(&pupil, map.view(), Array2::zeros((8, 8)).view()).unwrap();
        let outer = c.view().insert_axis(Axis(1)).dot(&c.view().insert_axis(Axis(0)));
        let expected = MapGram::new(&pupil, maps.view()).unwrap().expected_rms_nm(outer.view()).unwrap();
        // The square cancels the planes to about 1e-16 of (20 nm)²; its root is at most 2e-7.
        assert!((found - expected).abs() < 1e-6 * found, "{found} {expected}");
    }

    #[test]
    fn the_gram_matrix_from_products_equals_that_from_maps() {
        let (pupil, maps) = (pupil(), maps());
        let weight = &pupil.amplitude / pupil.weight_sum();
        let mean = |a: ArrayView2<f64>, b: ArrayView2<f64>| (&a * &b * &weight).sum();
        let map = |mode| maps.index_axis(Axis(0), mode);
        let products = Array2::from_shape_fn((3, 3), |(i, j)| mean(map(i), map(j)));
        let along = MapGram::planes(&pupil).map(|plane| (0..3).map(|mode| mean(map(mode), plane.view())).collect());
        let (found, wanted) = (MapGram::from_products(products, along), MapGram::new(&pupil, maps.view()).unwrap());
        // Mean squares of up to (20 nm)², from which the planes are subtracted: a few times 1e-16
        // of that.
        assert!((found.products - wanted.products).iter().all(|difference| difference.abs() < 1e-11));
    }

    #[test]
    fn maps_and_covariances_of_wrong_shape_are_refused() {
        let pupil = pupil();
        assert!(residual_nm(&pupil, Array2::zeros((8, 8)).view(), Array2::zeros((8, 7)).view()).is_err());
        assert!(residual_nm(&pupil, Array2::zeros((7, 7)).view(), Array2::zeros((7, 7)).view()).is_err());
        let gram = MapGram::new(&pupil, maps().view()).unwrap();
        assert!(gram.expected_rms_nm(Array2::zeros((2, 2)).view()).is_err());
    }
}
