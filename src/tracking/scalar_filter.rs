//! Kalman filter of one coordinate, and the likelihood of what it observes.

/// Probability that an estimate belongs to no walk: after an intervention, or a change of all
/// modes. Such an estimate costs each rate that does not explain it the same, and moves the maximum
/// by nothing.
const INTERVENTION: f64 = 1e-3;
/// Variance of the innovation of such an estimate, over that of usual ones.
const INTERVENTION_SPREAD: f64 = 100.0;

/// State and its variance.
pub(super) struct ScalarFilter {
    pub(super) state_nm: f64,
    pub(super) variance_nm2: f64,
}

impl ScalarFilter {
    /// Takes an observation with an error of the variance `error_nm2`, after a walk that added
    /// `added_nm2`. The log-likelihood of its innovation, without the constant of the normal
    /// density.
    pub(super) fn learn(&mut self, z_nm: f64, error_nm2: f64, added_nm2: f64) -> f64 {
        let predicted_nm2 = self.variance_nm2 + added_nm2;
        let (innovation_nm, variance_nm2) = (z_nm - self.state_nm, predicted_nm2 + error_nm2);
        let square = innovation_nm * innovation_nm / variance_nm2;
        let usual = (1.0 - INTERVENTION).ln() - 0.5 * (variance_nm2.ln() + square);
        let spread = 0.5 * ((INTERVENTION_SPREAD * variance_nm2).ln() + square / INTERVENTION_SPREAD);
        let intervention = INTERVENTION.ln() - spread;
        if intervention > usual {
            (self.state_nm, self.variance_nm2) = (z_nm, error_nm2);
        } else {
            self.state_nm += predicted_nm2 / variance_nm2 * innovation_nm;
            self.variance_nm2 = predicted_nm2 * error_nm2 / variance_nm2;
        }
        let (more, less) = if usual > intervention { (usual, intervention) } else { (intervention, usual) };
        more + (less - more).exp().ln_1p()
    }
}
