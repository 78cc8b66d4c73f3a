//! Corrections that were sent, and whether estimates show that they were applied.
//!
//! A tracker is not informed when a correction is applied, which changes the coefficients by d.
//! Each estimate weighs "not applied" against "applied before it", with the part a ~ N(1, f²) of d
//! that actuators of the relative error f make. For the white innovation w and u = L⁻¹d,
//!
//! ```text
//! ln Λ = ½·(|w|² − χ²) − ½·ln(1 + f²|u|²),   χ² = |w − u|² − f²·(u·(w − u))²/(1 + f²|u|²).
//! ```
//!
//! The moment is not known, so that their sum starts again where it falls below 0 (CUSUM; Page
//! 1954, Biometrika 41, 100), and with it the state of the applied correction, which is at d from
//! the tracked one and follows the same gain: d ← d − K·d. While nothing is applied, the sum
//! exceeds h once in exp(h) estimates at most (Lorden 1971, Ann. Math. Stat. 42, 1897).

use crate::Result;
use crate::tracking::bytes::{ByteReader, Writer, damaged};
use crate::tracking::filter::Innovation;
use crate::tracking::settings::AppliedPart;
use ndarray::{Array1, Array2};

/// Relative error of actuators, 1σ: that of a calibration by hand.
pub(super) const ACTUATOR_ERROR: f64 = 0.1;
/// Standard deviations by which the applied part may differ from all: a half, five of them, is no
/// application.
const PART_SIGMA: f64 = 3.0;

/// A correction, or the part of it that is sent to the segments or to the mirror, that may be
/// applied at any time.
#[derive(Debug, Clone)]
pub(super) struct Expected {
    /// Number of the correction.
    pub(super) number: i64,
    pub(super) part: AppliedPart,
    /// What it changes, in coordinates, nm.
    pub(super) change_nm: Array1<f64>,
    /// State with it less state without it, nm.
    lead_nm: Array1<f64>,
    /// Sum of ln Λ.
    pub(super) log_ratio: f64,
    /// Sums of u·w and of |u|², from which the applied part follows.
    projection: f64,
    information: f64,
}

impl Expected {
    pub(super) fn new(number: i64, part: AppliedPart, change_nm: Array1<f64>) -> Self {
        let lead_nm = change_nm.clone();
        Self { number, part, change_nm, lead_nm, log_ratio: 0.0, projection: 0.0, information: 0.0 }
    }

    /// Starts again, as where nothing was applied so far.
    pub(super) fn restart(&mut self) {
        self.lead_nm.assign(&self.change_nm);
        (self.log_ratio, self.projection, self.information) = (0.0, 0.0, 0.0);
    }

    /// Weighs an estimate. One that an applied correction does not explain (χ² beyond `limit`)
    /// lowers the log-likelihood ratio, except where the state without the correction does not
    /// explain it either: that is a bad estimate, and is ignored.
    pub(super) fn weigh(&mut self, innovation: &Innovation, limit: f64) {
        let white_lead = innovation.whiten_vector(&self.lead_nm);
        let information = white_lead.dot(&white_lead);
        let (projection, without) = (white_lead.dot(&innovation.white), innovation.chi2());
        let opening = 1.0 + ACTUATOR_ERROR.powi(2) * information;
        let off = projection - information;
        let with = without - 2.0 * projection + information - ACTUATOR_ERROR.powi(2) * off * off / opening;
        let log_ratio = 0.5 * (without - with) - 0.5 * opening.ln();
        let weight = match (with <= limit, without <= limit) {
            (true, _) => log_ratio,
            (false, true) => log_ratio.min(0.0),
            (false, false) => return,
        };
        if self.log_ratio + weight <= 0.0 {
            return self.restart();
        }
        self.log_ratio += weight;
        self.projection += projection;
        self.information += information;
    }

    /// Follows an update of the state with the gain `whitened_gain`, L⁻¹·P.
    pub(super) fn follow(&mut self, innovation: &Innovation, whitened_gain: &Array2<f64>) {
        if self.log_ratio > 0.0 {
            let white_lead = innovation.whiten_vector(&self.lead_nm);
            self.lead_nm -= &whitened_gain.t().dot(&white_lead);
        }
    }

    /// The part of it that was applied, and its error bar.
    pub(super) fn fraction(&self) -> [f64; 2] {
        [self.projection / self.information, 1.0 / self.information.sqrt()]
    }

    /// Whether the applied part is all of it within the error of actuators.
    pub(super) fn is_whole(&self) -> bool {
        let [fraction, error] = self.fraction();
        (fraction - 1.0).abs() <= PART_SIGMA * ACTUATOR_ERROR.hypot(error)
    }

    /// State with it less state without it, nm.
    pub(super) fn lead_nm(&self) -> &Array1<f64> {
        &self.lead_nm
    }

    pub(super) fn write(&self, writer: &mut Writer) {
        writer.number(self.number as usize);
        writer.number(self.part as usize);
        writer.vector(self.change_nm.iter());
        writer.vector(self.lead_nm.iter());
        [self.log_ratio, self.projection, self.information].into_iter().for_each(|value| writer.real(value));
    }

    pub(super) fn read(size: usize, reader: &mut ByteReader) -> Result<Self> {
        let number = reader.number()? as i64;
        let part = match reader.number()? {
            0 => AppliedPart::Whole,
            1 => AppliedPart::Segments,
            2 => AppliedPart::Ncpa,
            _ => return Err(damaged()),
        };
        let (change_nm, lead_nm) = (reader.vector()?, reader.vector()?);
        if change_nm.len() != size || lead_nm.len() != size {
            return Err(damaged());
        }
        let [log_ratio, projection, information] = [reader.real()?, reader.real()?, reader.real()?];
        Ok(Self { number, part, change_nm, lead_nm, log_ratio, projection, information })
    }
}
