//! Error budget of static errors: expected RMS errors of phasing and NCPA, as terms whose squares
//! add up to the total's.

/// Source of an expected error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ErrorSource {
    /// Noise and turbulence, averaged over the images: falls as one over the root of their number.
    NoiseAndTurbulence,
    /// Error of the diversity (`tolerance.defocus_fraction`), common to all images.
    DiversityError,
    /// Response of a loop that is not known to the pistons, which counts as NCPA; 0 where the loop
    /// is known.
    UnknownLoopResponse,
    /// NCPA beyond the finest modes, extrapolated from the variance of the coarser ones; 0 where
    /// they do not extend beyond.
    NcpaBeyondModes,
    /// Shapes of segments with tips and tilts that follow a smooth surface, which the loop
    /// compensates: an error of the prior, in no wavefront behind the loop. 0 where segments have
    /// pistons alone, whose edges show, and where the loop is not known.
    CompensatedSegments,
}

impl ErrorSource {
    /// Name of its term.
    fn name(self) -> &'static str {
        match self {
            Self::NoiseAndTurbulence => "noise and turbulence averaged over the images",
            Self::DiversityError => "diversity error",
            Self::UnknownLoopResponse => "unknown loop response",
            Self::NcpaBeyondModes => "NCPA beyond the modes",
            Self::CompensatedSegments => "segments that the loop compensates",
        }
    }
}

/// One contribution to the error bars, RMS over the pupil with piston, tip and tilt removed. The
/// squares of all terms of an estimate add up to the square of its error bar.
#[derive(Debug, Clone, PartialEq)]
pub struct ErrorTerm {
    /// What contributes: `noise`, `scatter between images`, `diversity`, …
    pub name: String,
    /// Contribution to the phasing, nm RMS.
    pub phasing_nm: f64,
    /// Contribution to the NCPA, nm RMS.
    pub ncpa_nm: f64,
}

/// Error budget of static errors.
#[derive(Debug, Clone, PartialEq)]
pub struct ErrorBudget {
    /// Expected RMS error over the pupil, phasing and NCPA, piston, tip and tilt removed, nm.
    pub total_nm: [f64; 2],
    /// One term for each source, 0 where it does not contribute; for either group the squares add
    /// up to the total's, to rounding.
    pub terms: Vec<ErrorTerm>,
}

impl ErrorBudget {
    /// From the totals without NCPA beyond the modes, the part that averages over the images, and
    /// the NCPA's other terms. The rest of the phasing's total is of segments that the loop
    /// compensates.
    pub(super) fn new(
        total_nm: [f64; 2],
        [phasing_nm, ncpa_nm]: [f64; 2],
        diversity_nm: f64,
        loop_response_nm: f64,
    ) -> Self {
        let compensated_nm = (total_nm[0].powi(2) - phasing_nm.powi(2)).max(0.0).sqrt();
        let term =
            |source: ErrorSource, phasing_nm, ncpa_nm| ErrorTerm { name: source.name().into(), phasing_nm, ncpa_nm };
        let terms = vec![
            term(ErrorSource::NoiseAndTurbulence, phasing_nm, ncpa_nm),
            term(ErrorSource::DiversityError, 0.0, diversity_nm),
            term(ErrorSource::UnknownLoopResponse, 0.0, loop_response_nm),
            term(ErrorSource::NcpaBeyondModes, 0.0, 0.0),
            term(ErrorSource::CompensatedSegments, compensated_nm, 0.0),
        ];
        Self { total_nm, terms }
    }

    /// Terms of phasing and NCPA from one source, nm.
    pub(crate) fn term_nm(&self, source: ErrorSource) -> [f64; 2] {
        let terms = self.terms.iter().filter(|term| term.name == source.name());
        terms.map(|term| [term.phasing_nm, term.ncpa_nm]).next().unwrap_or_default()
    }

    /// Part of phasing and NCPA that averages over the images, nm.
    pub fn averaged_nm(&self) -> [f64; 2] {
        self.term_nm(ErrorSource::NoiseAndTurbulence)
    }

    /// Part of phasing and NCPA that iterations change: what averages over the images, and segments
    /// that the loop compensates, nm.
    pub(super) fn iterated_nm(&self) -> [f64; 2] {
        let [phasing_nm, ncpa_nm] = self.averaged_nm();
        [phasing_nm.hypot(self.term_nm(ErrorSource::CompensatedSegments)[0]), ncpa_nm]
    }

    /// Adds NCPA of `rms_nm` beyond the modes.
    pub(super) fn add_beyond_modes(&mut self, rms_nm: f64) {
        self.total_nm[1] = self.total_nm[1].hypot(rms_nm);
        for term in self.terms.iter_mut().filter(|term| term.name == ErrorSource::NcpaBeyondModes.name()) {
            term.ncpa_nm = term.ncpa_nm.hypot(rms_nm);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn squares_of_the_terms_add_up_to_the_total() {
        let mut budget = ErrorBudget::new([5.0, 13.0], [3.0, 5.0], 12.0, 0.0);
        budget.add_beyond_modes(84.0);
        let sum = |of: fn(&ErrorTerm) -> f64| budget.terms.iter().map(|term| of(term).powi(2)).sum::<f64>().sqrt();
        assert_eq!((sum(|term| term.phasing_nm), sum(|term| term.ncpa_nm)), (5.0, 85.0));
        assert_eq!((budget.total_nm, budget.averaged_nm()), ([5.0, 85.0], [3.0, 5.0]));
        assert_eq!(budget.term_nm(ErrorSource::CompensatedSegments), [4.0, 0.0]);
        assert_eq!(budget.iterated_nm(), [5.0, 5.0]);
    }
}
