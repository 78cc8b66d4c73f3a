//! Sums over the modes of a basis and over the samples of the pupil, computed without dense maps of
//! the sparse modes.

use super::{Basis, SparseMap};
use crate::linear_algebra::row_products;
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView2, CowArray, Ix2, Zip, s};
use rayon::prelude::*;
use std::ops::Range;

/// Samples processed at once: the values of 70 dense modes at them stay in a cache of 1 MB.
const TILE: usize = 1024;
/// Tiles that all cores share, whose products are kept until they are added.
const TILES_AT_ONCE: usize = 32;

/// The sparse modes, sample by sample.
struct BySample {
    /// Sample p has the entries `offsets[p]..offsets[p + 1]`.
    offsets: Vec<u32>,
    /// Mode and value.
    entries: Vec<(u32, f64)>,
}

impl BySample {
    fn at(&self, sample: usize) -> &[(u32, f64)] {
        &self.entries[self.offsets[sample] as usize..self.offsets[sample + 1] as usize]
    }
}

impl Basis {
    /// Σ of the maps of `modes` times their coefficients, `[y, x]`.
    ///
    /// # Panics
    /// If the number of coefficients differs from the number of modes.
    pub fn combined(&self, coefficients_nm: &[f64], modes: Range<usize>) -> Array2<f64> {
        assert_eq!(coefficients_nm.len(), self.len(), "coefficients");
        let samples = self.samples();
        let mut map = Array2::zeros((samples, samples));
        for mode in modes {
            let nm = coefficients_nm[mode];
            match self.sparse.get(mode) {
                Some(list) => list.iter().for_each(|&(at, v)| map[self.place(at as usize)] += nm * v),
                None => map.scaled_add(nm, &self.dense_map(mode)),
            }
        }
        map
    }

    /// Σ over the samples of each mode's map times `map` (`[y, x]`).
    ///
    /// # Errors
    /// [`Error::Shape`] for a map of another shape.
    pub fn along(&self, map: &Array2<f64>) -> Result<Vec<f64>> {
        self.check_shape(map)?;
        let of_sparse = |list: &SparseMap| list.iter().map(|&(at, v)| v * map[self.place(at as usize)]).sum();
        Ok(self.sparse.iter().map(of_sparse).chain(row_products(self.flat()?.view(), map.flatten().view())).collect())
    }

    /// Mean square of each mode over the pupil, weighted by `amplitude` `[y, x]`, nm² for a
    /// coefficient of 1 nm.
    ///
    /// # Errors
    /// As [`Basis::visible_gram`].
    pub fn mean_squares(&self, amplitude: &Array2<f64>) -> Result<Vec<f64>> {
        let weight = amplitude / self.total_amplitude(amplitude)?;
        let of_sparse = |list: &SparseMap| list.iter().map(|&(at, v)| v * v * weight[self.place(at as usize)]).sum();
        let of_map = |mode: ArrayView2<f64>| Zip::from(mode).and(&weight).fold(0.0, |sum, v, w| sum + v * v * w);
        Ok(self.sparse.iter().map(of_sparse).chain(self.dense.outer_iter().map(of_map)).collect())
    }

    /// Σ over the samples of `weight` times the product of each two modes, `[mode, mode]`.
    ///
    /// # Errors
    /// [`Error::Shape`] for a weight of another shape.
    pub fn gram(&self, weight: &Array2<f64>) -> Result<Array2<f64>> {
        self.check_shape(weight)?;
        let (lists, maps) = (self.sparse.len(), self.dense.dim().0);
        let by_sample = self.by_sample();
        let weighted_samples: Vec<(usize, f64)> =
            weight.iter().copied().enumerate().filter(|(_, weight)| *weight != 0.0).collect();
        let mut of_maps = Array2::<f64>::zeros((maps, maps));
        let mut gram = Array2::<f64>::zeros((self.len(), self.len()));
        let products = |tile: &[(usize, f64)]| {
            let values = self.gathered(tile.iter().map(|&(at, _)| at), lists..self.len());
            let weights: Array1<f64> = tile.iter().map(|&(_, weight)| weight).collect();
            let weighted = &values * &weights.insert_axis(ndarray::Axis(1));
            (values.t().dot(&weighted), weighted)
        };
        let tiles: Vec<&[(usize, f64)]> = weighted_samples.chunks(TILE).collect();
        // The sum is in the order of the tiles, on any number of threads.
        for tiles in tiles.chunks(TILES_AT_ONCE) {
            let found: Vec<_> = tiles.par_iter().map(|tile| products(tile)).collect();
            for (tile, (own, weighted)) in tiles.iter().zip(found) {
                of_maps += &own;
                for (&(at, weight), weighted) in tile.iter().zip(weighted.outer_iter()) {
                    for &(i, value) in by_sample.at(at) {
                        gram.slice_mut(s![i as usize, lists..]).scaled_add(value, &weighted);
                        by_sample
                            .at(at)
                            .iter()
                            .for_each(|&(j, v)| gram[[i as usize, j as usize]] += weight * value * v);
                    }
                }
            }
        }
        gram.slice_mut(s![lists.., lists..]).assign(&of_maps);
        for i in 0..lists {
            for j in lists..self.len() {
                gram[[j, i]] = gram[[i, j]];
            }
        }
        Ok(gram)
    }

    /// Mean products of the modes over the pupil, `[modes, modes]`, weighted by `amplitude`
    /// `[y, x]` and with the mean of each mode removed: an image does not depend on piston.
    ///
    /// # Errors
    /// [`Error::Shape`] where the amplitude has another shape than the maps; [`Error::Value`] where
    /// it sums to no positive number.
    pub fn visible_gram(&self, amplitude: &Array2<f64>) -> Result<Array2<f64>> {
        let weight = amplitude / self.total_amplitude(amplitude)?;
        self.without_means(self.gram(&weight)?, &weight)
    }

    /// Mean products of the modes with the mean of each mode removed, from those with it.
    ///
    /// # Errors
    /// [`Error::Shape`] for a weight of another shape.
    pub(crate) fn without_means(&self, mut gram: Array2<f64>, weight: &Array2<f64>) -> Result<Array2<f64>> {
        let means = Array1::from(self.along(weight)?);
        for (mut row, &mean) in gram.outer_iter_mut().zip(&means) {
            row.scaled_add(-mean, &means);
        }
        Ok(gram)
    }

    /// The variance of Σ of the maps of `modes` at each sample, `[y, x]`, for coefficients of the
    /// given covariance (`[mode, mode]`, of all modes).
    ///
    /// # Panics
    /// If the covariance does not have one row and column per mode.
    pub fn variance(&self, covariance: &Array2<f64>, modes: Range<usize>) -> Array2<f64> {
        assert_eq!(covariance.dim(), (self.len(), self.len()), "covariance");
        let samples = self.samples();
        let by_sample = self.by_sample();
        let maps = modes.start.max(self.sparse.len()).min(modes.end)..modes.end;
        let of_maps = covariance.slice(s![maps.clone(), maps.clone()]);
        let mut variance = vec![0.0; samples * samples];
        variance.par_chunks_mut(TILE).enumerate().for_each(|(tile, variance)| {
            let first = tile * TILE;
            // Maps are 0 outside the pupil.
            let is_inside = |at: &usize| maps.clone().any(|mode| self.dense_map(mode)[self.place(*at)] != 0.0);
            let is_listed = |at: &usize| !by_sample.at(*at).is_empty();
            let inside: Vec<usize> =
                (first..first + variance.len()).filter(|at| is_listed(at) || is_inside(at)).collect();
            let values = self.gathered(inside.iter().copied(), maps.clone());
            let moved = values.dot(&of_maps);
            for (&at, (values, moved)) in inside.iter().zip(values.outer_iter().zip(moved.outer_iter())) {
                let variance = &mut variance[at - first];
                *variance = values.dot(&moved);
                let here = || by_sample.at(at).iter().filter(|(mode, _)| modes.contains(&(*mode as usize)));
                for &(i, value) in here() {
                    let row = covariance.row(i as usize);
                    *variance += 2.0 * value * row.slice(s![maps.clone()]).dot(&values);
                    *variance += here().map(|&(j, v)| value * v * row[j as usize]).sum::<f64>();
                }
            }
        });
        Array2::from_shape_vec((samples, samples), variance).unwrap_or_default()
    }

    /// The sum of an amplitude on the grid of the maps.
    fn total_amplitude(&self, amplitude: &Array2<f64>) -> Result<f64> {
        self.check_shape(amplitude)?;
        let total = amplitude.sum();
        if !(total.is_finite() && total > 0.0) {
            return Err(Error::Value(format!("the pupil amplitude sums to {total}: a positive sum is needed")));
        }
        Ok(total)
    }

    fn check_shape(&self, map: &Array2<f64>) -> Result<()> {
        let wanted = (self.samples(), self.samples());
        if map.dim() != wanted {
            return Err(Error::Shape(format!("a map of shape {:?} was given: {wanted:?} is needed", map.dim())));
        }
        Ok(())
    }

    fn place(&self, at: usize) -> [usize; 2] {
        [at / self.samples(), at % self.samples()]
    }

    /// The dense modes, `[mode, sample]`.
    fn flat(&self) -> Result<CowArray<'_, f64, Ix2>> {
        let (modes, rows, columns) = self.dense.dim();
        self.dense.to_shape((modes, rows * columns)).map_err(|error| Error::Internal(error.to_string()))
    }

    fn dense_map(&self, mode: usize) -> ArrayView2<'_, f64> {
        self.dense.index_axis(ndarray::Axis(0), mode - self.sparse.len())
    }

    /// Values of the dense `modes` at `samples`, `[sample, mode]`.
    fn gathered(&self, samples: impl ExactSizeIterator<Item = usize> + Clone, modes: Range<usize>) -> Array2<f64> {
        let mut values = Array2::zeros((samples.len(), modes.len()));
        for (mode, mut column) in modes.zip(values.columns_mut()) {
            let map = self.dense_map(mode);
            column.iter_mut().zip(samples.clone()).for_each(|(value, at)| *value = map[self.place(at)]);
        }
        values
    }

    fn by_sample(&self) -> BySample {
        let mut offsets = vec![0u32; self.samples().pow(2) + 1];
        self.sparse.iter().flatten().for_each(|&(at, _)| offsets[at as usize + 1] += 1);
        for p in 1..offsets.len() {
            offsets[p] += offsets[p - 1];
        }
        let mut next = offsets.clone();
        let mut entries = vec![(0, 0.0); self.sparse.iter().map(Vec::len).sum()];
        for (mode, list) in (0u32..).zip(&self.sparse) {
            for &(at, value) in list {
                let place = &mut next[at as usize];
                entries[*place as usize] = (mode, value);
                *place += 1;
            }
        }
        BySample { offsets, entries }
    }
}

#[cfg(test)]
mod tests {
    use crate::modes::{Basis, Group};
    use ndarray::{Array2, Array3, ArrayView1, Axis};

    /// Three overlapping sparse modes and two dense ones; and the same five modes as dense maps.
    fn both() -> (Basis, Basis) {
        let samples = 40;
        let names = |prefix: &str, count: usize| (0..count).map(|i| format!("{prefix}-{i}")).collect::<Vec<_>>();
        let list = |seed: u32| (0..300).map(|i| (5 * i + seed, (0.3 * f64::from(i + seed)).sin() + 0.2)).collect();
        let sparse = vec![list(0), list(1), (0..300).map(|i| (5 * i, 0.5 + 0.01 * f64::from(i))).collect()];
        let lists = Basis::from_lists(names("list", 3), vec![Group::Segment; 3], samples, sparse).unwrap();
        let wave = |(mode, y, x): (usize, usize, usize)| ((1 + mode) as f64 * 0.11 * x as f64).cos() + 0.02 * y as f64;
        let cube = Array3::from_shape_fn((2, samples, samples), wave);
        let dense = Basis::from_cube(names("map", 2), vec![Group::Ncpa; 2], cube).unwrap();
        let joined = lists.followed_by(dense).unwrap();
        let as_maps = Basis::from_cube(joined.names.clone(), joined.groups.clone(), joined.maps()).unwrap();
        assert_eq!((joined.sparse.len(), as_maps.sparse.len()), (3, 0));
        (joined, as_maps)
    }

    /// 1,600 terms of up to a few units, summed in other orders: 1e-16 times their number and size.
    const ROUNDING: f64 = 1e-11;

    fn same(a: &Array2<f64>, b: &Array2<f64>) -> bool {
        assert_eq!(a.dim(), b.dim());
        assert!(a.iter().any(|value| *value != 0.0));
        (a - b).iter().all(|difference| difference.abs() < ROUNDING)
    }

    #[test]
    fn lists_and_maps_of_the_same_modes_give_the_same_sums() {
        let (lists, maps) = both();
        let weight = Array2::from_shape_fn((40, 40), |(y, x)| if x < 5 { 0.0 } else { 0.5 + 0.01 * y as f64 });
        assert!(same(&lists.gram(&weight).unwrap(), &maps.gram(&weight).unwrap()));
        assert!(same(&lists.visible_gram(&weight).unwrap(), &maps.visible_gram(&weight).unwrap()));
        let along = |basis: &Basis| Array2::from_shape_vec((1, 5), basis.along(&weight).unwrap()).unwrap();
        assert!(same(&along(&lists), &along(&maps)));
        // Mean squares are the diagonal of the Gram matrix.
        for basis in [&lists, &maps] {
            let gram = basis.gram(&(&weight / weight.sum())).unwrap();
            let squares = basis.mean_squares(&weight).unwrap();
            assert!(gram.diag().iter().zip(&squares).all(|(a, b)| (a - b).abs() < ROUNDING && *a > 0.0));
        }
        let root = Array2::from_shape_fn((5, 5), |(i, j)| ((3 * i + 7 * j) as f64).sin());
        let covariance = root.dot(&root.t());
        for range in [0..3, 3..5, 1..4, 0..5] {
            let c = [0.3, -1.0, 2.0, 0.7, -0.4];
            assert!(same(&lists.combined(&c, range.clone()), &maps.combined(&c, range.clone())), "{range:?}");
            assert!(same(&lists.variance(&covariance, range.clone()), &maps.variance(&covariance, range.clone())));
        }
    }

    #[test]
    fn sums_agree_with_the_definition() {
        let (lists, _) = both();
        let maps = lists.maps();
        let weight = Array2::from_shape_fn((40, 40), |(y, x)| 1.0 / (1 + x + y) as f64);
        let flat = maps.to_shape((5, 1600)).unwrap();
        let weighted = &flat * &ArrayView1::from(weight.as_slice().unwrap());
        assert!(same(&lists.gram(&weight).unwrap(), &weighted.dot(&flat.t())));
        // The covariance of one draw ±c: its standard deviation is the map of c.
        let c = [0.3, -1.0, 2.0, 0.7, -0.4];
        let column = Array2::from_shape_vec((5, 1), c.to_vec()).unwrap();
        let map = maps.outer_iter().zip(c).fold(Array2::zeros((40, 40)), |sum, (map, c)| sum + &map * c);
        assert!(same(&lists.combined(&c, 0..5), &map));
        assert!(same(&lists.variance(&column.dot(&column.t()), 0..5), &map.mapv(|v| v * v)));
    }

    #[test]
    fn sparse_modes_after_dense_ones_become_dense() {
        let (lists, maps) = both();
        let renamed =
            Basis::from_cube(vec!["other".into()], vec![Group::Ncpa], maps.maps().slice_move(ndarray::s![..1, .., ..]));
        let joined = renamed.unwrap().followed_by(lists.clone()).unwrap();
        assert_eq!(joined.len(), 6);
        let tail = joined.maps().slice_move(ndarray::s![1.., .., ..]);
        assert_eq!(tail, lists.maps());
        assert_eq!(joined.maps().index_axis(Axis(0), 0), maps.maps().index_axis(Axis(0), 0));
    }
}
