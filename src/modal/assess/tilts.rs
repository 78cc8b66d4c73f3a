//! Tip and tilt of a fitted wavefront.

use crate::modal::combine::diversity_error::ModeProjector;
use crate::modal::model::Model;
use crate::pupil::Pupil;
use crate::{Error, Result};
use ndarray::{Array2, Axis};

/// Share of tip and tilt (RMS) outside the modes up to which the modes span them. The basis is
/// exact to rounding.
const MAX_RESIDUAL_SHARE: f64 = 1e-3;

/// x and y about their mean, at unit RMS over the pupil; and that RMS, m.
pub(in crate::modal) fn tip_and_tilt(pupil: &Pupil) -> [(Array2<f64>, f64); 2] {
    let mean = |map: &Array2<f64>| (map * &pupil.amplitude).sum() / pupil.weight_sum();
    [0, 1].map(|axis| {
        let along = |(y, x): (usize, usize)| pupil.grid.coordinate_m(if axis == 0 { x } else { y });
        let map = Array2::from_shape_fn(pupil.amplitude.dim(), along);
        let centred = &map - mean(&map);
        let rms_m = mean(&(&centred * &centred)).sqrt();
        (centred / rms_m, rms_m)
    })
}

/// Coefficients of tip and tilt of the whole pupil, `[axis, mode]`, those that the modes of the
/// NCPA span.
pub(in crate::modal) fn spanned_tip_and_tilt(model: &Model) -> Result<Array2<f64>> {
    let (pupil, basis) = (&model.telescope.pupil, &model.basis);
    let mut found = Array2::zeros((0, basis.len()));
    if model.segment_modes == basis.len() {
        return Ok(found);
    }
    let projector = ModeProjector::new(pupil, basis, model.segment_modes)?;
    for (map, _) in tip_and_tilt(pupil) {
        let projection = projector.project(basis, &map)?;
        if 1.0 - projection.mean_square_nm2 < MAX_RESIDUAL_SHARE.powi(2) {
            let pushed = found.push(Axis(0), projection.coefficients_nm.view());
            pushed.map_err(|error| Error::Internal(format!("tip and tilt: {error}")))?;
        }
    }
    Ok(found)
}

/// Slopes over the pupil, by least squares, as nm RMS of tip and tilt.
#[derive(Debug, Clone)]
pub(in crate::modal) struct Tilts {
    /// Tip and tilt of each mode, per nm.
    modes: Vec<[f64; 2]>,
    /// Tip and tilt of a shift by one model pixel.
    per_pixel_nm: [f64; 2],
}

impl Tilts {
    /// Computes the slopes of the modes of `model`.
    ///
    /// # Errors
    /// [`crate::Error::Shape`] for modes on another grid than the pupil's.
    pub(in crate::modal) fn new(model: &Model) -> Result<Self> {
        let pupil = &model.telescope.pupil;
        let total = pupil.weight_sum();
        let axes = tip_and_tilt(pupil);
        let [along_x, along_y] = [0, 1].map(|i| model.basis.along(&(&axes[i].0 * &pupil.amplitude / total)));
        let modes = along_x?.into_iter().zip(along_y?).map(|(x, y)| [x, y]).collect();
        // One pixel is λ over the width of the model's grid, divided by the pixels per λ/D.
        let sampling = model.optics.sampling();
        let width_m = pupil.grid.width_m() * model.width_ratio();
        let per_pixel_nm_m = model.optics.parts().wavelength_nm / (sampling.pixels_per_lambda_over_d * width_m);
        Ok(Self { modes, per_pixel_nm: [0, 1].map(|i| per_pixel_nm_m * axes[i].1) })
    }

    /// Tip and tilt of a shift by one model pixel along x and y, nm RMS.
    pub(in crate::modal) fn per_pixel_nm(&self) -> [f64; 2] {
        self.per_pixel_nm
    }

    /// Tip and tilt of a wavefront whose image was moved onto the axis by `shift_pixels`, nm RMS.
    pub(in crate::modal) fn tip_tilt_nm(&self, coefficients_nm: &[f64], shift_pixels: [i64; 2]) -> [f64; 2] {
        [0, 1].map(|axis| {
            let modes = self.modes.iter().zip(coefficients_nm).map(|(slope, nm)| slope[axis] * nm);
            modes.sum::<f64>() + shift_pixels[axis] as f64 * self.per_pixel_nm[axis]
        })
    }
}
