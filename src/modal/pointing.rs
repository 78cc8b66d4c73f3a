//! Pointing: where the star is in an image, which each image has for itself and which is no error
//! of the wavefront.
//!
//! A star that is off the axis is a plane over the pupil. A fit finds it in two parts: the whole
//! pixels by which the image was moved before it, and tip and tilt among the modes. A staircase of
//! segment pistons has a mean slope as well; it moves the image, but it is an error of the mirror,
//! which the modes hold besides, and is no part of the pointing.

use super::model::Model;
use crate::Result;
use crate::modal::assess::tilts::{Tilts, tip_and_tilt};
use crate::modal::combine::diversity_error::ModeProjector;
use crate::modal::combine::global_motions::GlobalMotions;
use ndarray::{Array1, Array2, ArrayView1};

/// Share of a plane (RMS) outside the modes up to which they hold it: exactly, to rounding; and
/// nearly, as some Karhunen-Loève modes do, so that a tenth of the pointing at most is taken for
/// something else.
const EXACT: f64 = 1e-3;
const NEARLY: f64 = 0.1;

/// Part of a mode in a plane below which it is rounding.
const ROUNDING: f64 = 1e-9;

/// Pointing in terms of the modes of a model.
#[derive(Debug, Clone)]
pub struct Pointing {
    /// What 1 nm RMS of tip, and of tilt, of the whole pupil is of each mode,
    /// `[tip or tilt, mode]`. No rows where the modes do not hold them: the star's motion is then
    /// an error of the estimates.
    pub modes: Array2<f64>,
    /// Whether the modes hold a plane exactly.
    pub is_exact: bool,
    /// Tip and tilt of a star that is one pixel of the frames off, nm RMS, along x and y.
    pub nm_per_pixel: [f64; 2],
    tilts: Tilts,
}

impl Pointing {
    /// # Errors
    /// Those of [`ModeProjector`].
    pub(super) fn new(model: &Model, motions: &GlobalMotions, tilts: &Tilts) -> Result<Self> {
        let count = model.basis.len();
        let smooth = (model.segment_modes < count).then(|| planes(model, motions, model.segment_modes)).transpose()?;
        let all = || planes(model, motions, 0);
        let (modes, share) = match smooth {
            Some(smooth) if smooth.1 < EXACT => smooth,
            smooth => {
                let all = all()?;
                if all.1 < EXACT { all } else { smooth.filter(|(_, share)| *share < NEARLY).unwrap_or(all) }
            }
        };
        let modes = if share < NEARLY { modes } else { Array2::zeros((0, count)) };
        let nm_per_pixel = [0, 1].map(|axis| tilts.per_pixel_nm()[axis] / model.preparation.native_along(axis));
        Ok(Self { modes, is_exact: share < EXACT, nm_per_pixel, tilts: tilts.clone() })
    }

    /// The pointing of an image, nm RMS of tip and tilt, from its coefficients and
    /// [`ImageReport::tip_tilt_nm`](super::ImageReport).
    pub fn of(&self, coefficients_nm: &[f64], tip_tilt_nm: [f64; 2]) -> [f64; 2] {
        if self.modes.nrows() == 0 {
            return tip_tilt_nm;
        }
        let (in_modes, smooth) = (self.tilts.tip_tilt_nm(coefficients_nm, [0, 0]), self.amounts(coefficients_nm));
        [0, 1].map(|axis| tip_tilt_nm[axis] - in_modes[axis] + smooth[axis])
    }

    /// Coefficients without the pointing: the wavefront alone.
    pub fn removed_from(&self, coefficients_nm: &[f64]) -> Vec<f64> {
        let mut left_nm = Array1::from(coefficients_nm.to_vec());
        if self.modes.nrows() > 0 {
            let amounts = self.amounts(coefficients_nm);
            self.modes.rows().into_iter().zip(amounts).for_each(|(row, nm)| left_nm.scaled_add(-nm, &row));
        }
        left_nm.to_vec()
    }

    /// Tip and tilt among the modes, nm RMS: least squares, (M·Mᵀ)⁻¹·M·c.
    fn amounts(&self, coefficients_nm: &[f64]) -> [f64; 2] {
        let (gram, along) = (self.modes.dot(&self.modes.t()), self.modes.dot(&ArrayView1::from(coefficients_nm)));
        let determinant = gram[[0, 0]] * gram[[1, 1]] - gram[[0, 1]] * gram[[1, 0]];
        [
            (gram[[1, 1]] * along[0] - gram[[0, 1]] * along[1]) / determinant,
            (gram[[0, 0]] * along[1] - gram[[1, 0]] * along[0]) / determinant,
        ]
    }
}

/// Planes of 1 nm RMS in the modes behind the first `before`, without what is a convention, and the
/// larger share (RMS) outside them.
fn planes(model: &Model, motions: &GlobalMotions, before: usize) -> Result<(Array2<f64>, f64)> {
    let projector = ModeProjector::new(&model.telescope.pupil, &model.basis, before)?;
    let (mut rows, mut share) = (Vec::new(), 0.0f64);
    for (map, _) in tip_and_tilt(&model.telescope.pupil) {
        let projection = projector.project(&model.basis, &map)?;
        share = share.max((1.0 - projection.mean_square_nm2).max(0.0).sqrt());
        let mut row = projection.coefficients_nm.to_vec();
        motions.remove(&mut row);
        // Where single modes are tip and tilt, the others keep their bits.
        row.iter_mut().filter(|part| part.abs() < ROUNDING).for_each(|part| *part = 0.0);
        rows.push(row);
    }
    let modes = Array2::from_shape_fn((2, model.basis.len()), |(axis, mode)| rows[axis][mode]);
    Ok((modes, share))
}
