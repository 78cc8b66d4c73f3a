//! Settings of the estimate of static errors.

use super::ncpa_basis::NcpaFamily;
use crate::scene::AoKnowledge;

/// Whether tip and tilt of each segment are estimated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TiltSelection {
    /// No; they are sought in the residual of the mean wavefront.
    Never,
    /// Where they are significant in the residual of the mean wavefront.
    WhereSignificant,
    /// Yes, from the first iteration on.
    Always,
}

/// Settings of the estimate of static errors.
#[derive(Debug, Clone)]
pub struct StaticsSettings {
    /// Basis ladder of the NCPA, from coarse to fine: the next family is taken where the prior
    /// variance of the last one's highest modes shows NCPA beyond them, unless that family leaves
    /// out a large part of the estimated NCPA.
    pub families: Vec<NcpaFamily>,
    /// Tips and tilts of the segments.
    pub tilts: TiltSelection,
    /// Knowledge of the adaptive optics: nothing, its power spectrum, the loop, or its telemetry.
    pub ao_knowledge: AoKnowledge,
    /// Error of each sample of the mean wavefront in addition to the turbulence's, nm.
    pub sample_error_nm: f64,
    /// Most iterations.
    pub max_iterations: usize,
    /// Change of phasing and NCPA, as a fraction of their error bars, below which the iterations
    /// end. The remaining change is about as large.
    pub tolerance: f64,
}

impl Default for StaticsSettings {
    fn default() -> Self {
        // To order 13, 104 polynomials of up to 26 zeros around the pupil: few, so that NCPA
        // without finer structure have small error bars. Of the part of three measured maps that
        // Keck's mirror can correct they leave 29, 33 and 16 nm, those to order 20 (230 of them)
        // 14, 16 and 8, those to 24 13 of the second map; the mirror's own 274 modes leave 0.
        let families = vec![NcpaFamily::Zernike { highest_order: 13 }, NcpaFamily::Mirror];
        Self {
            families,
            tilts: TiltSelection::Never,
            ao_knowledge: AoKnowledge::Telemetry,
            sample_error_nm: 3.0,
            max_iterations: 8,
            tolerance: 0.25,
        }
    }
}
