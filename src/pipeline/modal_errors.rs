//! Modes of a modal estimate as errors that are corrected.

use crate::loop_response::{CorrectableErrors, Corrections, NcpaModes};
use crate::modal;
use crate::modes::Group;
use crate::scene::Scene;
use crate::tracking::{Correction, CorrectionPolicy};
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView2, s};

/// Modes of a model, and their covariance: of an estimate, or tracked.
pub(super) struct ModalErrors<'a> {
    pub(super) scene: &'a Scene,
    pub(super) model: &'a modal::Model,
    /// Segment modes, then NCPA modes, nm.
    pub(super) coefficients_nm: &'a [f64],
    /// nm².
    pub(super) covariance_nm2: ArrayView2<'a, f64>,
    /// Largest correction of a piston, nm.
    pub(super) segment_limit_nm: f64,
}

impl ModalErrors<'_> {
    /// The corrections: see [`super::Estimate::corrections`].
    pub(super) fn corrections(&self, limit_nm: Option<f64>) -> Result<Corrections> {
        self.with_errors(|errors| Corrections::new(self.scene, errors, limit_nm))
    }

    /// Which modes are corrected, and by how much, without anything of mirror and controllers.
    pub(super) fn correction(&self) -> Result<Correction> {
        let policy = CorrectionPolicy {
            stroke_limit_nm: Some(self.segment_limit_nm).filter(|limit_nm| limit_nm.is_finite()),
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
        let sigma_nm: Vec<f64> = self.covariance_nm2.diag().iter().map(|nm2| nm2.max(0.0).sqrt()).collect();
        make(&CorrectableErrors {
            pistons_nm: &self.coefficients_nm[..pistons],
            tilts_nm: &[],
            segment_covariance_nm2: self.covariance_nm2.slice(s![..pistons, ..pistons]),
            has_uncertain_plane: false,
            segment_limit_nm: self.segment_limit_nm,
            ncpa_nm: &self.coefficients_nm[segment_modes..],
            ncpa_sigma_nm: &sigma_nm[segment_modes..],
            ncpa: NcpaModes::Maps(&map_nm),
            has_ncpa_corrector: self.scene.has_mirror(),
        })
    }
}
