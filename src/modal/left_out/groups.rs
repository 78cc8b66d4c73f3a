//! Groups of unknowns that a fit leaves out, each with one prior variance.

use crate::empirical_bayes::{CoefficientGroup, VarianceRule};
use crate::imaging::Mode;
use ndarray::Array2;
use std::ops::Range;

/// Smallest prior standard deviation, in the unit of a group: far below what an image at a peak S/N
/// of 1,000 shows of a mode, so that it adds nothing to an error bar.
const LEAST: f64 = 1e-3;
/// Unknowns with one prior variance.
#[derive(Debug, Clone)]
pub(in crate::modal) struct Group {
    pub(super) name: String,
    pub(super) columns: Range<usize>,
    /// Standard deviation of one, where the search begins: nm for modes.
    pub(super) rms: f64,
    /// Largest one.
    pub(super) largest: f64,
    pub(super) rule: VarianceRule,
    pub(super) of: Of,
}

/// What the modes of a group are of, in order.
#[derive(Debug, Clone, Copy)]
pub(super) enum Of {
    /// Each segment, along x, and then each along y.
    Tilts,
    /// The same, which are among the fitted modes.
    FittedTilts,
    /// Three of each segment, one segment after the other.
    Figures,
    /// All segments.
    AllSegments,
    Ncpa,
    /// Amplitudes of the segments, or patterns of them.
    Amplitudes,
    /// An error of the optics or the camera, in units of this tolerance.
    Tolerance(f64),
}

/// Modes that are marginalised, before they are modes of a chain.
#[derive(Default)]
pub(super) struct Columns {
    pub(super) modes: Vec<Mode>,
    pub(super) groups: Vec<Group>,
    /// Smooth modes at the illuminated samples, `[mode, sample]`, and patterns of the amplitude.
    pub(super) rows: Vec<Array2<f64>>,
    /// Number of both.
    pub(super) smooth: usize,
    /// Number of modes with a prior that are fitted.
    pub(super) fitted: usize,
    /// Number of unknowns that are no modes, which come last.
    pub(super) further: usize,
}

impl Columns {
    pub(super) fn push(
        &mut self,
        name: impl Into<String>,
        modes: Vec<Mode>,
        [rms, largest]: [f64; 2],
        (rule, of): (VarianceRule, Of),
    ) {
        // Fitted ones come first, and are modes of the chain already.
        let first = if self.groups.is_empty() { 0 } else { self.fitted + self.modes.len() };
        self.modes.extend(modes);
        self.groups.push(Group {
            name: name.into(),
            columns: first..self.fitted + self.modes.len(),
            rms,
            largest,
            rule,
            of,
        });
    }

    /// Adds an error with this tolerance, where it has one.
    pub(super) fn push_error(&mut self, name: &str, tolerance: f64) {
        if tolerance > 0.0 {
            self.push_further(name, 1, [1.0, 1.0], (VarianceRule::Fixed, Of::Tolerance(tolerance)));
        }
    }

    /// Adds unknowns that are no modes, behind all of these.
    pub(super) fn push_further(
        &mut self,
        name: &str,
        count: usize,
        [rms, largest]: [f64; 2],
        (rule, of): (VarianceRule, Of),
    ) {
        let first = self.fitted + self.modes.len() + self.further;
        self.further += count;
        self.groups.push(Group { name: name.into(), columns: first..first + count, rms, largest, rule, of });
    }

    pub(super) fn push_rows(
        &mut self,
        name: impl Into<String>,
        rows: Array2<f64>,
        sizes_nm: [f64; 2],
        rule: (VarianceRule, Of),
    ) {
        let modes = (self.smooth..self.smooth + rows.nrows()).map(Mode::Smooth).collect();
        self.push_patterns(rows);
        self.push(name, modes, sizes_nm, rule);
    }

    /// Adds rows of the basis that are no modes.
    pub(super) fn push_patterns(&mut self, rows: Array2<f64>) {
        self.smooth += rows.nrows();
        self.rows.push(rows);
    }
}

/// The priors of `groups`.
pub(in crate::modal) fn priors(groups: &[Group]) -> Vec<CoefficientGroup> {
    groups.iter().map(Group::prior).collect()
}

impl Group {
    fn prior(&self) -> CoefficientGroup {
        CoefficientGroup {
            columns: self.columns.clone(),
            variance_nm2: self.rms.powi(2),
            range_nm2: [LEAST.powi(2), self.largest.powi(2)],
            rule: self.rule,
        }
    }
}
