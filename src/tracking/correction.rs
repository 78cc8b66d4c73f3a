//! Which modes are worth correcting, and by how much: gain, deadband, stroke limits, and no
//! correction that is expected to do harm.
//!
//! With an estimate m of the errors x, m ~ N(x, P), a correction c(m) changes the squared error in
//! the metric M by
//!
//! ```text
//! E|x|² − E|x − c|² = E[ mᵀMm − |m − c|² − 2·tr(M A P) ],   A = ∂c/∂m,
//! ```
//!
//! Stein's unbiased estimate of risk (Stein 1981, Ann. Stat. 9, 1135): what it gains less the error
//! bars that it writes into the mirror. A block (segments, or NCPA, of error bars that are alike)
//! whose gain is not positive, beyond the scatter that noise alone gives it, is left as it is.

use crate::linear_algebra::SpdInverse;
use crate::scene::{SegmentConvention, System};
use crate::statistics::normal_cdf;
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1, ArrayView2};
use std::f64::consts::PI;
use std::ops::Range;

/// Standard deviations by which the expected drop must exceed 0: noise alone is sent in some 2 % of
/// cases.
const SURE: f64 = 3.0;

/// Ratio of error bars within a block.
const ALIKE: f64 = 3.0;

/// How estimates become corrections.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CorrectionPolicy {
    /// Part of an error that is corrected at once, above 0 and at most 1.
    pub gain: f64,
    /// A mode that is smaller than so many of its error bars is left as it is.
    pub deadband_sigma: f64,
    /// Largest correction of a segment mode, nm.
    pub stroke_limit_nm: Option<f64>,
    /// Convention for the segments.
    pub convention: SegmentConvention,
}

impl Default for CorrectionPolicy {
    /// That of a scene without keys of it: all of each mode above its error bar.
    fn default() -> Self {
        Self { gain: 1.0, deadband_sigma: 1.0, stroke_limit_nm: None, convention: SegmentConvention::LeastSquares }
    }
}

/// Errors that may be corrected.
#[derive(Debug, Clone, Copy)]
pub struct Correctable<'a> {
    /// Coefficients, nm.
    pub coefficients_nm: ArrayView1<'a, f64>,
    /// Their covariance, nm², `[mode, mode]`.
    pub covariance_nm2: ArrayView2<'a, f64>,
    /// Coefficients that are segment modes; the rest are NCPA modes.
    pub segment_modes: &'a Range<usize>,
    /// Segment of each segment mode.
    pub segment_of_mode: &'a [usize],
    /// Pairs of segments that share an edge; read by [`SegmentConvention::EdgeMinimising`].
    pub edges: &'a [(usize, usize)],
    /// Modes that are never corrected, such as pointing.
    pub left_modes: &'a [usize],
}

/// Why a mode is not corrected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HoldReason {
    /// Its estimate is within the deadband.
    Deadband,
    /// The correction of its block is not expected to lower the error.
    NoBenefit,
    /// Nothing corrects it: pointing, or NCPA without a mirror.
    NeverCorrected,
}

impl HoldReason {
    /// The word in files.
    pub fn word(self) -> &'static str {
        match self {
            Self::Deadband => "deadband",
            Self::NoBenefit => "no-benefit",
            Self::NeverCorrected => "never-corrected",
        }
    }
}

/// A mode that is not corrected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HeldMode {
    /// Number of the coefficient.
    pub mode: usize,
    /// Its segment; `None` for an NCPA mode.
    pub segment: Option<usize>,
    /// Why.
    pub reason: HoldReason,
}

/// A correction.
#[derive(Debug, Clone, PartialEq)]
pub struct Correction {
    /// What is to be subtracted from the wavefront, nm of each mode; 0 for those that are held.
    pub coefficients_nm: Array1<f64>,
    /// Modes that are held; those that are never corrected are not among them.
    pub held: Vec<HeldMode>,
    /// Segment modes that are cut at the stroke limit.
    pub limited: Vec<usize>,
    /// Expected drop of the sum of squares of the segment modes (of the steps at edges by that
    /// convention), and of the NCPA modes, nm²; 0 where the block is held.
    pub expected_drop_nm2: [f64; 2],
}

/// The correction of `errors` by `policy`.
///
/// # Errors
/// [`Error::Value`] for a policy out of range and for edges without pistons; [`Error::Shape`] for
/// arrays that do not fit.
pub fn correction(policy: &CorrectionPolicy, errors: &Correctable<'_>) -> Result<Correction> {
    policy.check()?;
    errors.check()?;
    let modes = errors.coefficients_nm.len();
    let is_left = |mode: &usize| errors.left_modes.contains(mode);
    let segments: Vec<usize> = errors.segment_modes.clone().collect();
    let others: Vec<usize> = (0..modes).filter(|mode| !errors.segment_modes.contains(mode)).collect();
    let mut correction = Correction {
        coefficients_nm: Array1::zeros(modes),
        held: Vec::new(),
        limited: Vec::new(),
        expected_drop_nm2: [0.0; 2],
    };
    let others = errors.alike(&others).into_iter().map(|block| (1, block, None, None));
    let blocks = match policy.convention {
        SegmentConvention::LeastSquares => {
            errors.alike(&segments).into_iter().map(|block| (0, block, None, policy.stroke_limit_nm)).collect()
        }
        SegmentConvention::EdgeMinimising => {
            vec![(0, segments, Some(errors.edge_laplacian()?), policy.stroke_limit_nm)]
        }
    };
    for (number, block, metric, limit_nm) in blocks.into_iter().chain(others) {
        let metric = metric.unwrap_or_else(|| Array2::eye(block.len()));
        let is_moved: Vec<bool> = block.iter().map(|mode| !is_left(mode) && errors.exceeds(*mode, policy)).collect();
        let can_move: Vec<bool> = block.iter().map(|mode| !is_left(mode)).collect();
        let moving = Block { errors, policy, modes: &block, metric: &metric, is_moved: &is_moved, can_move: &can_move };
        let Moves { moves_nm, drop_nm2, is_sure: is_sent, limited } = moving.moves(limit_nm)?;
        for (place, &mode) in block.iter().enumerate().filter(|(_, mode)| !is_left(mode)) {
            if is_sent && is_moved[place] {
                correction.coefficients_nm[mode] = moves_nm[place];
                continue;
            }
            let segment = (number == 0).then(|| errors.segment_of_mode[mode - errors.segment_modes.start]);
            let reason = if is_moved[place] { HoldReason::NoBenefit } else { HoldReason::Deadband };
            correction.held.push(HeldMode { mode, segment, reason });
        }
        if is_sent {
            correction.expected_drop_nm2[number] += drop_nm2;
            correction.limited.extend(limited.into_iter().map(|place| block[place]));
        }
    }
    correction.held.sort_by_key(|held| held.mode);
    correction.limited.sort_unstable();
    Ok(correction)
}

/// The modes of a block.
struct Block<'a, 'b> {
    errors: &'a Correctable<'b>,
    policy: &'a CorrectionPolicy,
    modes: &'a [usize],
    metric: &'a Array2<f64>,
    is_moved: &'a [bool],
    can_move: &'a [bool],
}

/// Corrections of a block.
struct Moves {
    /// Of each mode, nm.
    moves_nm: Array1<f64>,
    /// Expected drop of the squared error, nm².
    drop_nm2: f64,
    /// Whether it is beyond what noise alone shows.
    is_sure: bool,
    /// Places of those at the limit.
    limited: Vec<usize>,
}

impl Block<'_, '_> {
    /// What each mode would be corrected by.
    fn moves(&self, limit_nm: Option<f64>) -> Result<Moves> {
        let count = self.modes.len();
        let estimate_nm: Array1<f64> = self.modes.iter().map(|&mode| self.errors.coefficients_nm[mode]).collect();
        let mut derivative = self.derivative()?;
        let mut moves_nm = derivative.dot(&estimate_nm);
        let mut limited = Vec::new();
        for place in 0..count {
            if let Some(limit_nm) = limit_nm.filter(|limit_nm| moves_nm[place].abs() > *limit_nm) {
                moves_nm[place] = moves_nm[place].clamp(-limit_nm, limit_nm);
                derivative.row_mut(place).fill(0.0);
                limited.push(place);
            }
        }
        let covariance_nm2 =
            Array2::from_shape_fn((count, count), |(i, j)| self.errors.covariance_nm2[[self.modes[i], self.modes[j]]]);
        let rest_nm = &estimate_nm - &moves_nm;
        let written_nm2 = self.metric.dot(&derivative).dot(&covariance_nm2).diag().sum();
        let gained_nm2 = estimate_nm.dot(&self.metric.dot(&estimate_nm)) - rest_nm.dot(&self.metric.dot(&rest_nm));
        // For modes without an error: with m in error bars, A the probability of |m| > k, and φ the
        // normal density, the step of c at ±k has a derivative of mean 2·k·φ, and the gain m² − 2
        // of those beyond k the mean square E[(m² − 2)²] = 3·A + 2·φ·(k³ + 3·k) − 8·k·φ.
        let (gain, k) = (self.policy.gain, self.policy.deadband_sigma);
        let density = (-k * k / 2.0).exp() / (2.0 * PI).sqrt();
        let square = 6.0 * normal_cdf(-k) + 2.0 * density * (k.powi(3) + 3.0 * k) - 8.0 * k * density;
        let product = self.metric.dot(&covariance_nm2);
        let mut chosen_nm2 = 0.0;
        let mut scatter_nm4 = 0.0;
        let free = || (0..count).filter(|&place| self.can_move[place]);
        for i in free() {
            chosen_nm2 += 2.0 * gain * k * density * product[[i, i]];
            scatter_nm4 += square * free().map(|j| product[[i, j]] * product[[j, i]]).sum::<f64>();
        }
        let drop_nm2 = gained_nm2 - 2.0 * (written_nm2 + chosen_nm2);
        Ok(Moves { moves_nm, drop_nm2, is_sure: drop_nm2 > SURE * scatter_nm4.max(0.0).sqrt(), limited })
    }

    /// A = ∂c/∂m. By least squares the gain on what moves; by the edges, for the moved modes F and
    /// the others H with the Laplacian L, the steps are least where L_FF·(m − c)_F + L_FH·m_H = 0.
    fn derivative(&self) -> Result<Array2<f64>> {
        let count = self.modes.len();
        let gain = self.policy.gain;
        let mut derivative = Array2::zeros((count, count));
        let moved: Vec<usize> = (0..count).filter(|&place| self.is_moved[place]).collect();
        moved.iter().for_each(|&place| derivative[[place, place]] = gain);
        let held: Vec<usize> = (0..count).filter(|&place| !self.is_moved[place]).collect();
        let has_edges = (0..count).any(|i| (0..i).any(|j| self.metric[[i, j]] != 0.0));
        if !has_edges || moved.is_empty() || held.is_empty() {
            return Ok(derivative);
        }
        let part = |rows: &[usize], columns: &[usize]| {
            Array2::from_shape_fn((rows.len(), columns.len()), |(i, j)| self.metric[[rows[i], columns[j]]])
        };
        // Moved segments without a neighbour that stays have no place of their own but 0, which the
        // small part added to the diagonal gives them.
        let inverse = SpdInverse::of_normal_equations(part(&moved, &moved))?.inverse;
        let towards = inverse.dot(&part(&moved, &held)) * gain;
        for ((i, j), &value) in towards.indexed_iter() {
            derivative[[moved[i], held[j]]] = value;
        }
        Ok(derivative)
    }
}

impl CorrectionPolicy {
    /// The policy in the section `[commands]` of a scene, without a stroke limit.
    pub fn of_scene(scene: &System) -> Self {
        let commands = &scene.commands;
        Self {
            gain: commands.gain,
            deadband_sigma: commands.deadband_sigma,
            stroke_limit_nm: None,
            convention: commands.convention,
        }
    }

    fn check(&self) -> Result<()> {
        if !(self.gain > 0.0 && self.gain <= 1.0) {
            let gain = self.gain;
            return Err(Error::Value(format!("a gain of {gain} was given, where one above 0 and at most 1 is needed")));
        }
        if !(self.deadband_sigma >= 0.0 && self.deadband_sigma.is_finite()) {
            let deadband = self.deadband_sigma;
            return Err(Error::Value(format!(
                "a deadband of {deadband} error bars was given, where 0 or more is needed"
            )));
        }
        match self.stroke_limit_nm.filter(|limit_nm| !(limit_nm.is_finite() && *limit_nm > 0.0)) {
            Some(limit_nm) => {
                Err(Error::Value(format!("a limit of {limit_nm} nm was given: a positive one is needed")))
            }
            None => Ok(()),
        }
    }
}

impl Correctable<'_> {
    fn check(&self) -> Result<()> {
        let modes = self.coefficients_nm.len();
        let (rows, columns) = self.covariance_nm2.dim();
        let (named, segments) = (self.segment_of_mode.len(), self.segment_modes.len());
        if (rows, columns) != (modes, modes) || named != segments || self.segment_modes.end > modes {
            return Err(Error::Shape(format!(
                "a covariance of {rows}x{columns} and segments of {named} modes were given for {modes} modes, {segments} of them \
                 of segments"
            )));
        }
        Ok(())
    }

    /// Blocks of `modes` with error bars that are alike: a mode of three times the error bar of
    /// others scatters the squares as much as 81 of them, so that one that is badly known would
    /// hold them all. Modes that are never corrected are in none.
    fn alike(&self, modes: &[usize]) -> Vec<Vec<usize>> {
        let sigma_nm = |mode: usize| self.covariance_nm2[[mode, mode]].max(0.0).sqrt();
        let mut sorted: Vec<usize> = modes.iter().copied().filter(|mode| !self.left_modes.contains(mode)).collect();
        sorted.sort_by(|a, b| sigma_nm(*a).total_cmp(&sigma_nm(*b)));
        let mut blocks: Vec<Vec<usize>> = Vec::new();
        for mode in sorted {
            match blocks.last_mut() {
                Some(block) if sigma_nm(mode) <= ALIKE * sigma_nm(block[0]) => block.push(mode),
                _ => blocks.push(vec![mode]),
            }
        }
        blocks
    }

    fn exceeds(&self, mode: usize, policy: &CorrectionPolicy) -> bool {
        let sigma_nm = self.covariance_nm2[[mode, mode]].max(0.0).sqrt();
        self.coefficients_nm[mode].abs() > policy.deadband_sigma * sigma_nm
    }

    /// Laplacian of the edges: xᵀ·L·x is the sum of the squares of the steps.
    fn edge_laplacian(&self) -> Result<Array2<f64>> {
        let count = self.segment_of_mode.len();
        let place = |segment: usize| {
            let mut places = (0..count).filter(|&place| self.segment_of_mode[place] == segment);
            match (places.next(), places.next()) {
                (Some(place), None) => Ok(place),
                _ => Err(Error::Value(format!(
                    "segment {segment} has no piston alone, which the correction of steps at edges needs"
                ))),
            }
        };
        let mut laplacian = Array2::zeros((count, count));
        for &(one, other) in self.edges {
            let (i, j) = (place(one)?, place(other)?);
            for (row, column, value) in [(i, i, 1.0), (j, j, 1.0), (i, j, -1.0), (j, i, -1.0)] {
                laplacian[[row, column]] += value;
            }
        }
        Ok(laplacian)
    }
}
