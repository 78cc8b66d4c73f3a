//! Modes of a modal estimate as errors that are corrected.

use crate::ao::actuators_in_use;
use crate::linear_algebra::SpdInverse;
use crate::loop_response::{CorrectableErrors, Corrections, NcpaModes, SegmentLimits};
use crate::modal::{self, sigma_nm};
use crate::modes::{Group, Samples};
use crate::scene::Scene;
use crate::tracking::{Correction, CorrectionPolicy};
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1, ArrayView2, s};

/// Modes of a model: of an estimate, or tracked.
pub(super) struct ModalErrors<'a> {
    pub(super) scene: &'a Scene,
    pub(super) model: &'a modal::Model,
    /// Segment modes, then NCPA modes.
    pub(super) coefficients_nm: &'a [f64],
    /// Their covariance.
    pub(super) covariance_nm2: ArrayView2<'a, f64>,
    /// Limits of the corrections of pistons.
    pub(super) limits: SegmentLimits,
}

impl ModalErrors<'_> {
    /// The corrections: see [`super::Estimate::corrections`].
    pub(super) fn corrections(&self, limit_nm: Option<f64>) -> Result<Corrections> {
        self.with_errors(|errors| Corrections::new(self.scene, errors, limit_nm))
    }

    /// Which modes are corrected, and by how much, without anything of mirror and controllers.
    pub(super) fn correction(&self) -> Result<Correction> {
        let policy = CorrectionPolicy {
            stroke_limit_nm: Some(self.limits.cut_nm).filter(|limit_nm| limit_nm.is_finite()),
            ..CorrectionPolicy::of_scene(self.scene)
        };
        let segments = &self.model.telescope.pupil.segments[..self.model.pistons()];
        let mut correction = self.with_errors(|errors| errors.correction(&policy, segments))?;
        // Tips and tilts of a modal estimate are not corrected.
        let (pistons, tilts) = (self.model.pistons(), self.model.segment_modes - self.model.pistons());
        let nm = &correction.coefficients_nm;
        let (pistons_nm, ncpa_nm) = (nm.slice(s![..pistons]), nm.slice(s![pistons..]));
        correction.coefficients_nm = pistons_nm
            .iter()
            .copied()
            .chain(std::iter::repeat_n(0.0, tilts))
            .chain(ncpa_nm.iter().copied())
            .collect::<Array1<f64>>();
        Ok(correction)
    }

    fn with_errors<T>(&self, make: impl FnOnce(&CorrectableErrors) -> Result<T>) -> Result<T> {
        let (pistons, segment_modes) = (self.model.pistons(), self.model.segment_modes);
        let segments = self.model.telescope.pupil.segments.len();
        if segment_modes > 0 && pistons != segments {
            return Err(Error::Value(format!(
                "{segment_modes} segment modes with {pistons} pistons for {segments} segments have no corrections: a piston for each is needed"
            )));
        }
        let map_nm = |ncpa_nm: &[f64]| -> Array2<f64> {
            let all_nm = [vec![0.0; segment_modes], ncpa_nm.to_vec()].concat();
            self.model.map_nm(&all_nm, Group::Ncpa)
        };
        make(&CorrectableErrors {
            pistons_nm: &self.coefficients_nm[..pistons],
            tilts_nm: &[],
            segment_covariance_nm2: self.covariance_nm2.slice(s![..pistons, ..pistons]),
            has_uncertain_plane: false,
            limits: self.limits,
            ncpa_nm: &self.coefficients_nm[segment_modes..],
            ncpa_sigma_nm: &sigma_nm(self.covariance_nm2)[segment_modes..],
            ncpa: NcpaModes::Maps(&map_nm),
            has_ncpa_corrector: self.scene.has_mirror(),
            reference_mas_per_nm: None,
        })
    }
}

/// What `corrections` change of the coefficients of `model`, nm: pistons about their mean over the
/// pupil, as they are reported, and the part of the mirror's surface that the NCPA modes represent,
/// by least squares over the pupil with piston, tip and tilt, which are no modes.
pub(super) fn change_by(scene: &Scene, model: &modal::Model, corrections: &Corrections) -> Result<Vec<f64>> {
    let pupil = &model.telescope.pupil;
    let mut change_nm = vec![0.0; model.basis.len()];
    let areas = pupil.segment_areas();
    let pistons_nm = &corrections.pistons_nm;
    let mean_nm = pistons_nm.iter().zip(&areas).map(|(nm, area)| nm * area).sum::<f64>() / areas.iter().sum::<f64>();
    change_nm.iter_mut().zip(pistons_nm).for_each(|(change, nm)| *change = nm - mean_nm);
    let actuators_nm: Array1<f64> = corrections.actuators_nm.iter().map(|(_, nm)| *nm).collect();
    if actuators_nm.iter().all(|nm| *nm == 0.0) {
        return Ok(change_nm);
    }
    let samples = Samples::from_pupil(pupil)?;
    let influence = actuators_in_use(scene, &model.telescope)?;
    let surface_nm = actuators_nm.dot(&influence.evaluate(&samples.xs_m, &samples.ys_m)?);
    let modes = model.modes_of(Group::Ncpa);
    let mut shapes = Array2::<f64>::ones((modes.len() + 3, samples.indices.len()));
    for (row, mode) in modes.clone().enumerate() {
        let unit: Vec<f64> = (0..change_nm.len()).map(|other| f64::from(u8::from(other == mode))).collect();
        let map_nm = model.map_nm(&unit, Group::Ncpa);
        shapes.row_mut(row).iter_mut().zip(&samples.indices).for_each(|(value, &at)| {
            *value = map_nm[[at / map_nm.ncols(), at % map_nm.ncols()]];
        });
    }
    shapes.row_mut(modes.len()).assign(&ArrayView1::from(&samples.xs_m));
    shapes.row_mut(modes.len() + 1).assign(&ArrayView1::from(&samples.ys_m));
    let weighted = &shapes * &ArrayView1::from(&samples.weights);
    let inverse = SpdInverse::of_normal_equations(weighted.dot(&shapes.t()))?.inverse;
    let represented_nm = inverse.dot(&weighted.dot(&surface_nm));
    modes.zip(&represented_nm).for_each(|(mode, nm)| change_nm[mode] = -nm);
    Ok(change_nm)
}
