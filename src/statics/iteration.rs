//! Iteration: the static errors estimated in one iteration, their maps, error budget and
//! convergence.

use super::error_budget::ErrorBudget;
use super::ncpa_basis::{NcpaBasis, NcpaFamily};
use super::segment_tilts::SegmentTilts;
use super::static_errors::StaticErrors;
use crate::Result;
use crate::loop_response::{CorrectableErrors, Corrections, NcpaModes, SegmentLimits};
use crate::modal::{CombinedModes, DiversityProjection, StaticMaps, check_reachable};
use crate::modes::SegmentModes;
use crate::scene::System;
use crate::telescope::Telescope;
use ndarray::{Array2, s};

/// Result of one iteration.
#[derive(Debug, Clone)]
pub struct Iteration {
    /// Static errors.
    pub errors: StaticErrors,
    /// Family of the NCPA's modes.
    pub family: NcpaFamily,
    /// Names of the NCPA's modes.
    pub ncpa_names: Vec<String>,
    /// Segment errors and NCPA on the scene's grid.
    pub maps: StaticMaps,
    /// Error bars of the maps.
    pub sigma_maps: StaticMaps,
    /// Expected residuals of both, with their terms.
    pub error_budget: ErrorBudget,
    /// RMS change of phasing and NCPA from the static wavefront about which the wavefronts were
    /// retrieved, nm; NaN in the first iteration and after a change of basis.
    pub change_nm: [f64; 2],
    /// Images that were used.
    pub used_images: Vec<usize>,
    /// Median χ² per degree of freedom.
    pub reduced_chi2: f64,
    /// RMS of the wavefronts about their mean, nm.
    pub residual_rms_nm: f64,
    /// Diversity in the NCPA's modes.
    pub diversity: DiversityProjection,
    /// Tilts of single segments in the residual of the mean wavefront that pistons alone leave; of
    /// the last iteration only, and where it was made for tilts that are estimated since, from then
    /// on. `None` where the scene has tilts.
    pub segment_tilts: Option<SegmentTilts>,
    /// Reference slopes about which the loop moves its mirror by 1 nm of each NCPA mode,
    /// `[mode, slope]`, mas; of the last iteration only, and `None` without measured slopes.
    pub reference_mas_per_nm: Option<Array2<f64>>,
}

impl Iteration {
    /// Names of the static modes: pistons, where they are estimated tips and tilts, then NCPA.
    pub fn mode_names(&self) -> Vec<String> {
        let segments = if self.has_tilts() { SegmentModes::PistonTipTilt } else { SegmentModes::Piston };
        let mut names = segments.names(self.errors.pistons_nm.len());
        names.extend_from_slice(&self.ncpa_names);
        names
    }

    /// Whether tips and tilts of the segments are estimated.
    pub fn has_tilts(&self) -> bool {
        !self.errors.tilts_nm.is_empty()
    }

    /// The static modes, with their covariance.
    pub fn modes(&self) -> CombinedModes {
        let coefficients_nm = self.errors.coefficients_nm().to_vec();
        CombinedModes { coefficients_nm, covariance_nm2: self.errors.covariance_nm2.clone() }
    }

    /// Computes the number of further images like these after which the expected residuals are
    /// `wanted_nm`, phasing and NCPA: the variance of a mean falls as one over their number.
    ///
    /// # Errors
    /// [`Error::Value`](crate::Error::Value) where no number suffices, because of errors common to
    /// all images.
    pub fn further_images(&self, wanted_nm: [f64; 2]) -> Result<usize> {
        let (total_nm, averaged_nm) = (self.error_budget.total_nm, self.error_budget.averaged_nm());
        let mut factor = 1.0f64;
        for (i, wanted_nm) in wanted_nm.into_iter().enumerate() {
            let averaged_nm = averaged_nm[i];
            let shared_nm2 = (total_nm[i].powi(2) - averaged_nm.powi(2)).max(0.0);
            check_reachable(wanted_nm, shared_nm2)?;
            factor = factor.max((averaged_nm / (wanted_nm.powi(2) - shared_nm2).sqrt()).powi(2));
        }
        Ok(((factor - 1.0) * self.used_images.len() as f64).ceil() as usize)
    }

    /// Computes the corrections of the static errors for `scene`, no command beyond `limit_nm`
    /// where it is given, and no piston or tilt beyond `limits`: see [`Corrections::new`].
    ///
    /// # Errors
    /// Those of [`Corrections::new`].
    pub fn corrections(&self, scene: &System, limit_nm: Option<f64>, limits: SegmentLimits) -> Result<Corrections> {
        let basis = NcpaBasis::new(self.family, scene, &Telescope::new(scene)?)?;
        let segments = self.errors.segment_modes();
        let errors = CorrectableErrors {
            pistons_nm: &self.errors.pistons_nm,
            tilts_nm: &self.errors.tilts_nm,
            segment_covariance_nm2: self.errors.covariance_nm2.slice(s![..segments, ..segments]),
            has_uncertain_plane: true,
            limits,
            ncpa_nm: &self.errors.ncpa_nm,
            ncpa_sigma_nm: &self.modes().sigma_nm()[segments..],
            ncpa: NcpaModes::Smooth(&basis.modes),
            has_ncpa_corrector: scene.has_mirror(),
            reference_mas_per_nm: self.reference_mas_per_nm.as_ref(),
        };
        Corrections::new(scene, &errors, limit_nm)
    }

    /// Adds NCPA of `rms_nm` beyond the modes to the error bars, evenly over the pupil.
    pub(super) fn add_beyond_modes(&mut self, rms_nm: f64) {
        self.error_budget.add_beyond_modes(rms_nm);
        self.sigma_maps.ncpa_nm.mapv_inplace(|nm| nm.hypot(rms_nm));
    }

    /// Whether it changed phasing or NCPA by the fraction `tolerance`, or more, of the part of
    /// their error bars that iterations change: errors common to all iterations do not show how
    /// much further ones will change.
    pub(crate) fn has_changed(&self, tolerance: f64) -> bool {
        let iterated_nm = self.error_budget.iterated_nm();
        (0..2).any(|i| self.change_nm[i] >= tolerance * iterated_nm[i])
    }
}
