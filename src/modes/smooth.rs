//! Bases of smooth modes, given as functions: they can be evaluated at any point, at the samples of
//! the pupil, outside its edge (as the band-limited model needs) or on a finer grid. Petals, which
//! have steps behind the arms of the spider, are such functions, too.

use super::basis::{Basis, Group};
use super::influence::InfluenceFunctions;
use super::petals::Petals;
use super::samples::{Samples, check_lengths};
use super::zernike::Zernikes;
use crate::Result;
use crate::pupil::Pupil;
use ndarray::linalg::general_mat_mul;
use ndarray::parallel::prelude::*;
use ndarray::{Array1, Array2, Array3, ArrayView1, ArrayView2, Axis, s};

/// Points evaluated at a time: the values of 400 raw functions stay in the second-level cache (1.6
/// MB), and a grid of a million points needs no memory beyond its result.
const BLOCK: usize = 512;

/// Raw functions from which modes are combined.
#[derive(Debug, Clone, PartialEq)]
pub enum Functions {
    /// Zernike polynomials.
    Zernike(Zernikes),
    /// Influence functions of a deformable mirror.
    Influence(InfluenceFunctions),
    /// Piston, tip and tilt of the parts of the pupil.
    Petals(Petals),
}

impl Functions {
    pub(super) fn count(&self) -> usize {
        match self {
            Functions::Zernike(zernikes) => zernikes.nolls().len(),
            Functions::Influence(influence) => influence.len(),
            Functions::Petals(petals) => petals.len(),
        }
    }
}

/// Smooth modes: `mode_i(x, y) = offset_i + Σ_j matrix_ij · function_j(x, y)`.
#[derive(Debug, Clone, PartialEq)]
pub struct SmoothBasis {
    names: Vec<String>,
    functions: Vec<Functions>,
    /// `[modes, functions]`, over all functions in order.
    matrix: Array2<f64>,
    offset: Array1<f64>,
}

impl SmoothBasis {
    /// The Zernike polynomials themselves, named `noll-4` and so on.
    pub fn zernike(zernikes: Zernikes) -> Self {
        let names = zernikes.nolls().iter().map(|noll| format!("noll-{noll}")).collect();
        Self::raw(names, Functions::Zernike(zernikes))
    }

    /// The influence functions themselves, named `actuator-17` and so on by the index
    /// `row·across + column`.
    pub fn influence(influence: InfluenceFunctions) -> Self {
        let names = influence.indices().iter().map(|index| format!("actuator-{index}")).collect();
        Self::raw(names, Functions::Influence(influence))
    }

    /// The motions of the petals themselves, named `petal-piston-0` and so on.
    pub fn petals(petals: Petals) -> Self {
        Self::raw(petals.names(), Functions::Petals(petals))
    }

    fn raw(names: Vec<String>, functions: Functions) -> Self {
        let count = functions.count();
        Self { names, functions: vec![functions], matrix: Array2::eye(count), offset: Array1::zeros(count) }
    }

    /// Number of modes.
    pub fn len(&self) -> usize {
        self.names.len()
    }

    /// Whether there is no mode.
    pub fn is_empty(&self) -> bool {
        self.names.is_empty()
    }

    /// Names of the modes.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Whether all functions are sums of a few products of a function of x and one of y.
    pub fn is_separable(&self) -> bool {
        self.functions.iter().all(|functions| match functions {
            Functions::Zernike(_) => true,
            Functions::Influence(influence) => influence.is_separable(),
            Functions::Petals(_) => false,
        })
    }

    /// The combination that makes the modes from the raw functions, `[modes, functions]`.
    pub fn matrix(&self) -> ArrayView2<'_, f64> {
        self.matrix.view()
    }

    /// The raw functions, in the order of the columns of [`SmoothBasis::matrix`].
    pub(super) fn functions(&self) -> &[Functions] {
        &self.functions
    }

    /// The constant added to each mode.
    pub(super) fn offset(&self) -> ArrayView1<'_, f64> {
        self.offset.view()
    }

    /// Values of the modes at the points (x, y), `[modes, points]`.
    ///
    /// # Errors
    /// [`crate::Error::Shape`] where the coordinates differ in number.
    pub fn evaluate(&self, xs_m: &[f64], ys_m: &[f64]) -> Result<Array2<f64>> {
        check_lengths(xs_m, ys_m)?;
        let mut values = Array2::zeros((self.len(), xs_m.len()));
        values.axis_chunks_iter_mut(Axis(1), BLOCK).into_par_iter().enumerate().for_each(|(block, mut values)| {
            let points = block * BLOCK..block * BLOCK + values.ncols();
            values.assign(&self.block(&xs_m[points.clone()], &ys_m[points]));
        });
        Ok(values)
    }

    /// Values at a few points, `[modes, points]`.
    fn block(&self, xs_m: &[f64], ys_m: &[f64]) -> Array2<f64> {
        let mut raw = Array2::zeros((self.matrix.ncols(), xs_m.len()));
        let mut first = 0;
        for functions in &self.functions {
            let rows = raw.slice_mut(s![first..first + functions.count(), ..]);
            match functions {
                Functions::Zernike(zernikes) => zernikes.fill(xs_m, ys_m, rows),
                Functions::Influence(influence) => influence.fill(xs_m, ys_m, rows),
                Functions::Petals(petals) => petals.fill(xs_m, ys_m, rows),
            }
            first += functions.count();
        }
        let mut values = self.matrix.dot(&raw);
        values.axis_iter_mut(Axis(0)).zip(&self.offset).for_each(|(mut row, offset)| row += *offset);
        values
    }

    /// Mean of each mode over the samples, and the mean products of all pairs of modes,
    /// `[modes, modes]`.
    pub(super) fn moments(&self, samples: &Samples) -> (Array1<f64>, Array2<f64>) {
        let modes = self.len();
        // A fixed number of parts, added in order: the sums do not depend on the number of threads.
        let part = samples.weights.len().div_ceil(16).max(BLOCK);
        let starts: Vec<usize> = (0..samples.weights.len()).step_by(part).collect();
        let partial: Vec<_> = starts
            .into_par_iter()
            .map(|start| {
                let (mut mean, mut gram) = (Array1::zeros(modes), Array2::zeros((modes, modes)));
                let end = (start + part).min(samples.weights.len());
                for first in (start..end).step_by(BLOCK) {
                    let points = first..(first + BLOCK).min(end);
                    let values = self.block(&samples.xs_m[points.clone()], &samples.ys_m[points.clone()]);
                    let weighted = &values * &ndarray::aview1(&samples.weights[points]);
                    mean += &weighted.sum_axis(Axis(1));
                    general_mat_mul(1.0, &weighted, &values.t(), 1.0, &mut gram);
                }
                (mean, gram)
            })
            .collect();
        let zero = (Array1::zeros(modes), Array2::zeros((modes, modes)));
        partial.into_iter().fold(zero, |(mean, gram), (m, g)| (mean + m, gram + g))
    }

    /// The modes `combination · (self − mean)`, with new names.
    pub(super) fn combined(&self, names: Vec<String>, combination: &Array2<f64>, mean: &Array1<f64>) -> Self {
        Self {
            names,
            functions: self.functions.clone(),
            matrix: combination.dot(&self.matrix),
            offset: combination.dot(&(&self.offset - mean)),
        }
    }

    /// Some of the modes, by index (each below [`len`](Self::len)).
    pub(super) fn selected(&self, modes: &[usize]) -> Self {
        Self {
            names: modes.iter().map(|&mode| self.names[mode].clone()).collect(),
            functions: self.functions.clone(),
            matrix: self.matrix.select(Axis(0), modes),
            offset: self.offset.select(Axis(0), modes),
        }
    }

    /// These modes, then those of `other`.
    pub fn followed_by(&self, other: &Self) -> Self {
        let (left, right) = (self.matrix.ncols(), other.matrix.ncols());
        let mut matrix = Array2::zeros((self.len() + other.len(), left + right));
        matrix.slice_mut(s![..self.len(), ..left]).assign(&self.matrix);
        matrix.slice_mut(s![self.len().., left..]).assign(&other.matrix);
        Self {
            names: self.names.iter().chain(&other.names).cloned().collect(),
            functions: self.functions.iter().chain(&other.functions).cloned().collect(),
            matrix,
            offset: self.offset.iter().chain(&other.offset).copied().collect(),
        }
    }

    /// The modes as maps on the grid of the pupil, zero outside its illuminated samples.
    ///
    /// # Errors
    /// Those of [`Samples::from_pupil`]; [`crate::Error::Value`] where two modes share a name.
    pub fn sampled(&self, pupil: &Pupil) -> Result<Basis> {
        let samples = Samples::from_pupil(pupil)?;
        let values = self.evaluate(&samples.xs_m, &samples.ys_m)?;
        let n = pupil.grid.samples();
        let mut maps = Array3::zeros((self.len(), n, n));
        for (mut map, row) in maps.outer_iter_mut().zip(values.rows()) {
            for (&index, &value) in samples.indices.iter().zip(row) {
                map[[index / n, index % n]] = value;
            }
        }
        Basis::from_cube(self.names.clone(), vec![Group::Ncpa; self.len()], maps)
    }
}
