//! Error budget: the named contributions to the error bars.

/// One contribution to the error bars, RMS over the pupil with piston, tip and tilt removed. The squares of all terms of
/// an estimate add up to the square of its error bar.
#[derive(Debug, Clone, PartialEq)]
pub struct ErrorTerm {
    /// What contributes: `noise`, `scatter between images`, `diversity`, …
    pub name: String,
    /// Contribution to the phasing, nm RMS.
    pub phasing_nm: f64,
    /// Contribution to the NCPA, nm RMS.
    pub ncpa_nm: f64,
}

impl ErrorTerm {
    /// Root of the sum of squares of some terms, phasing and NCPA, nm.
    pub fn total_nm(terms: &[Self]) -> [f64; 2] {
        let total = |value: &dyn Fn(&Self) -> f64| terms.iter().map(|term| value(term).powi(2)).sum::<f64>().sqrt();
        [total(&|term| term.phasing_nm), total(&|term| term.ncpa_nm)]
    }
}
