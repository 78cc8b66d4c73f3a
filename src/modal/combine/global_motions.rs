//! Motions of the whole mirror, which the segment modes have and the images do not determine, and
//! which are 0 by convention.
//!
//! Piston changes no image. Tip and tilt, which segments with tips and tilts make together, are
//! also modes of the NCPA where those span them: what a fit divides among the two is moved to the
//! NCPA. Where the NCPA do not span them, the images determine them.

use crate::modal::combine::diversity_error::{ModeProjector, Projection};
use crate::modal::model::Model;
use crate::modes::{Basis, Direction};
use crate::pupil::Pupil;
use crate::{Error, Result};
use ndarray::linalg::general_mat_mul;
use ndarray::{Array1, Array2, ArrayView1, ArrayView2, ArrayViewMut1, Axis, Zip, s};
use rayon::prelude::*;
use std::ops::Range;

/// Share of tip or tilt (RMS) outside the modes of the NCPA up to which they span it. The basis is
/// exact to rounding.
const MAX_RESIDUAL_SHARE: f64 = 1e-3;
/// Share of a direction (of its coefficients) outside the motions up to which it is one of them.
/// Null directions are known to 1e-6 and sampled on two grids.
const MAX_OTHER_SHARE: f64 = 0.01;

/// Rows of a matrix in one task.
const ROWS_AT_ONCE: usize = 16;

/// Motions of the whole mirror.
pub(crate) struct GlobalMotions {
    /// What of each motion is in coefficients, `[motion, mode]`.
    amounts: Array2<f64>,
    /// Coefficients of each motion, `[motion, mode]`.
    motions: Array2<f64>,
}

/// A motion while it is made orthogonal to those before it: its map and its coefficients.
struct Motion {
    map: Array2<f64>,
    coefficients: Array1<f64>,
}

impl GlobalMotions {
    /// # Errors
    /// [`Error::Value`] for pistons of segments without area.
    pub(in crate::modal) fn new(model: &Model) -> Result<Self> {
        let (basis, pupil) = (&model.basis, &model.telescope.pupil);
        let pistons = model.pistons();
        if pistons == 0 {
            let none = || Array2::zeros((0, basis.len()));
            return Ok(Self { amounts: none(), motions: none() });
        }
        let has_tilts = model.optics.parts().slopes.is_some() && model.segment_modes < basis.len();
        let (mut found, weight) = segment_motions((basis, pistons), pupil, has_tilts)?;
        if has_tilts {
            let projector = ModeProjector::new(pupil, basis, model.segment_modes)?;
            let mut is_spanned = true;
            for motion in &mut found[1..] {
                let Projection { coefficients_nm, mean_square_nm2 } = projector.project(basis, &motion.map)?;
                is_spanned &= 1.0 - mean_square_nm2 < MAX_RESIDUAL_SHARE.powi(2);
                motion.coefficients -= &coefficients_nm;
            }
            if !is_spanned {
                found.truncate(1);
            }
        }
        Self::of(&found, &weight, basis, model.segment_modes)
    }

    /// Piston, tip and tilt of the pistons, tips and tilts `segments` of all segments, the first of
    /// `modes` coefficients. They are in no other mode: behind a loop that flattens the whole
    /// mirror a plane through the segments changes no image.
    ///
    /// # Errors
    /// As [`GlobalMotions::new`].
    pub(crate) fn of_segments(segments: &Basis, pupil: &Pupil, modes: usize) -> Result<Self> {
        let (found, weight) = segment_motions((segments, segments.len() / 3), pupil, true)?;
        let own = Self::of(&found, &weight, segments, segments.len())?;
        let padded = |rows: &Array2<f64>| {
            let mut padded = Array2::zeros((rows.nrows(), modes));
            padded.slice_mut(s![.., ..segments.len()]).assign(rows);
            padded
        };
        Ok(Self { amounts: padded(&own.amounts), motions: padded(&own.motions) })
    }

    /// Shapes by their coefficients, which are 0 but for the modes in `range`: in that order, made
    /// orthonormal by the products `gram` of the modes.
    ///
    /// # Errors
    /// [`Error::Internal`] for shapes of another number of modes.
    pub(in crate::modal) fn of_shapes(
        shapes: Vec<Array1<f64>>,
        gram: &Array2<f64>,
        range: Range<usize>,
    ) -> Result<Self> {
        let none = || Array2::zeros((0, gram.nrows()));
        let mut own = Self { amounts: none(), motions: none() };
        for mut shape in shapes {
            own.remove(shape.as_slice_mut().unwrap_or_default());
            let products = gram.dot(&shape);
            let norm = shape.dot(&products).max(0.0).sqrt();
            if norm == 0.0 {
                continue;
            }
            let mut amount = Array1::zeros(shape.len());
            amount.slice_mut(s![range.clone()]).assign(&products.slice(s![range.clone()]));
            own.push(&(amount / norm), &(shape / norm))?;
        }
        Ok(own)
    }

    /// These and `others`, none of which has a part of one of these.
    ///
    /// # Errors
    /// [`Error::Internal`] for motions of another number of modes.
    pub(in crate::modal) fn and(mut self, others: &Self) -> Result<Self> {
        let mut motions = others.amounts.outer_iter().zip(others.motions.outer_iter());
        motions.try_for_each(|(amount, motion)| self.push(&amount.to_owned(), &motion.to_owned()))?;
        Ok(self)
    }

    fn push(&mut self, amount: &Array1<f64>, motion: &Array1<f64>) -> Result<()> {
        let pushed = self.amounts.push(Axis(0), amount.view()).and(self.motions.push(Axis(0), motion.view()));
        pushed.map_err(|error| Error::Internal(format!("the motions of the mirror: {error}")))
    }

    /// Collects motions, and what of them is in the first `segment_modes` modes of `basis`.
    fn of(found: &[Motion], weight: &Array2<f64>, basis: &Basis, segment_modes: usize) -> Result<Self> {
        let none = || Array2::zeros((0, basis.len()));
        let mut own = Self { amounts: none(), motions: none() };
        for motion in found {
            let mut amount = Array1::from(basis.along(&(&motion.map * weight))?);
            amount.slice_mut(s![segment_modes..]).fill(0.0);
            own.push(&amount, &motion.coefficients)?;
        }
        Ok(own)
    }

    /// Removes the motions from coefficients. Allocates nothing.
    pub(crate) fn remove(&self, coefficients_nm: &mut [f64]) {
        let mut coefficients_nm = ArrayViewMut1::from(coefficients_nm);
        // The motions are orthogonal, so that one after the other removes them all.
        for (amount, motion) in self.amounts.outer_iter().zip(self.motions.outer_iter()) {
            let nm = amount.dot(&coefficients_nm);
            coefficients_nm.scaled_add(-nm, &motion);
        }
    }

    /// Wavefronts `columns` of the first modes, `[mode, sample]`, of coefficients from which the
    /// motions are removed: these change none.
    pub(crate) fn removed_from_columns(&self, columns: &Array2<f64>) -> Array2<f64> {
        let [amounts, motions] = [&self.amounts, &self.motions].map(|rows| rows.slice(s![.., ..columns.nrows()]));
        // Pᵀ of the columns, with P = 1 − Mᵀ A.
        columns - &amounts.t().dot(&motions.dot(columns))
    }

    /// Columns of coefficients, `[mode, column]`, from which the motions were removed.
    pub(in crate::modal) fn removed_from_rows(&self, rows: &ArrayView2<f64>) -> Array2<f64> {
        let mut left = rows.to_owned();
        general_mat_mul(-1.0, &self.motions.t(), &self.amounts.dot(rows), 1.0, &mut left);
        left
    }

    /// The covariance of coefficients from which the motions were removed.
    pub(crate) fn removed_from(&self, covariance_nm2: &Array2<f64>) -> Array2<f64> {
        projected(covariance_nm2, &self.amounts, &self.motions)
    }

    /// The information on coefficients, per nm², without what it says of the motions: Pᵀ Λ P.
    pub(in crate::modal) fn without_information_on(&self, information: &Array2<f64>) -> Array2<f64> {
        projected(information, &self.motions, &self.amounts)
    }

    /// Whether a direction is a combination of these motions.
    pub(in crate::modal) fn contain(&self, direction: &Direction) -> bool {
        let mut rest = Array1::from(direction.coefficients.clone());
        let mut units: Vec<Array1<f64>> = Vec::new();
        for motion in self.motions.outer_iter() {
            let mut unit = motion.to_owned();
            units.iter().for_each(|before| unit.scaled_add(-before.dot(&motion), before));
            unit /= unit.dot(&unit).sqrt();
            let share = unit.dot(&rest);
            rest.scaled_add(-share, &unit);
            units.push(unit);
        }
        rest.dot(&rest) <= MAX_OTHER_SHARE.powi(2) * ArrayView1::from(&direction.coefficients).mapv(|c| c * c).sum()
    }
}

/// P C Pᵀ of a symmetric matrix C, with P = 1 − Mᵀ A of few rows A, `along`, and M, `shapes`.
///
/// With W = A C − ½ A C Aᵀ M it is C − Mᵀ W − Wᵀ M. Symmetric to the last bit, which an
/// eigen-decomposition may need.
fn projected(matrix: &Array2<f64>, along: &Array2<f64>, shapes: &Array2<f64>) -> Array2<f64> {
    let mut with = along.dot(matrix);
    let both = with.dot(&along.t());
    general_mat_mul(-0.25, &(&both + &both.t()), shapes, 1.0, &mut with);
    let mut left = matrix.clone();
    left.axis_chunks_iter_mut(Axis(0), ROWS_AT_ONCE).into_par_iter().enumerate().for_each(|(chunk, mut lines)| {
        let first = chunk * ROWS_AT_ONCE;
        let columns = matrix.slice(s![.., first..first + lines.nrows()]);
        for (mut lines, column) in lines.columns_mut().into_iter().zip(columns.outer_iter()) {
            lines.zip_mut_with(&column, |value, mirrored| *value = 0.5 * (*value + mirrored));
        }
        for (row, mut line) in (first..).zip(lines.outer_iter_mut()) {
            for (shape, with) in shapes.outer_iter().zip(with.outer_iter()) {
                let [own_shape, own_with] = [shape[row], with[row]];
                Zip::from(&mut line).and(&shape).and(&with).for_each(|value, shape, with| {
                    *value -= own_shape * with + own_with * shape;
                });
            }
        }
    });
    left
}

/// Piston of the whole mirror, and where its segments have tilts tip and tilt: by `pistons`
/// pistons, and as many tips and tilts, the first modes of `basis`. They are orthonormal under the
/// weight of each sample in a mean over the pupil, which comes with them.
fn segment_motions(
    (basis, pistons): (&Basis, usize),
    pupil: &Pupil,
    has_tilts: bool,
) -> Result<(Vec<Motion>, Array2<f64>)> {
    let areas = basis.along(&pupil.amplitude)?[..pistons].to_vec();
    let total: f64 = areas.iter().sum();
    if total <= 0.0 {
        return Err(Error::Value("the segments of the pistons have no illuminated area".into()));
    }
    let weight = ndarray::Zip::from(&pupil.amplitude)
        .and(&pupil.owner)
        .map_collect(|a, owner| if *owner < 0 { 0.0 } else { a / total });
    let coefficients = Array1::from_shape_fn(basis.len(), |mode| f64::from(u8::from(mode < pistons)));
    let mut found = vec![Motion { map: Array2::ones(weight.dim()), coefficients }];
    for axis in 0..if has_tilts { 2 } else { 0 } {
        // On a segment, a coordinate is its mean times the piston and its RMS about it times the
        // tip or the tilt.
        let coordinate = |(y, x): (usize, usize)| pupil.grid.coordinate_m(if axis == 0 { x } else { y });
        let map = Array2::from_shape_fn(weight.dim(), coordinate);
        let mut coefficients = Array1::from(basis.along(&(&map * &weight))?);
        let is_its = |mode: usize| [0, axis + 1].contains(&(mode / pistons)) && areas[mode % pistons] > 0.0;
        coefficients.indexed_iter_mut().for_each(|(mode, c)| {
            *c = if is_its(mode) { *c * total / areas[mode % pistons] } else { 0.0 };
        });
        let motion = Motion { map, coefficients }.orthogonal_to(&found, &weight);
        found.push(motion);
    }
    Ok((found, weight))
}

impl Motion {
    /// This motion without what it has of others, which are orthogonal to each other and of unit
    /// mean square, and at unit mean square.
    fn orthogonal_to(mut self, others: &[Motion], weight: &Array2<f64>) -> Self {
        let product = |a: &Array2<f64>, b: &Array2<f64>| (a * b * weight).sum();
        for other in others {
            let share = product(&self.map, &other.map);
            self.map.scaled_add(-share, &other.map);
            self.coefficients.scaled_add(-share, &other.coefficients);
        }
        let rms = product(&self.map, &self.map).sqrt();
        Self { map: self.map / rms, coefficients: self.coefficients / rms }
    }
}
