//! Combination of the fits of several channels in memory that is allocated beforehand.
//!
//! In the notation of `joint.rs`, with a_il the multiples of the information Λ_il of channel i at
//! the levels l between which the noise of its image lies ([`Metrics::between`]), over χ² where the
//! model misfits, and V the directions that the images determine:
//!
//! ```text
//! M = Σ a_il Vᵀ [1 p_i]ᵀ Λ_il [1 p_i] V + Vᵀ diag(0, 1/σ²) V     [c δ] = V M⁻¹ Vᵀ Σ a_il [1 p_i]ᵀ Λ_il ĉ_i     covariance V M⁻¹ Vᵀ
//! ```
//!
//! V and each term of M are computed once. M is near a multiple of the identity, and its Cholesky
//! decomposition is exact to rounding.

use super::super::fitter::ModalFitter;
use super::options::ImageResult;
use crate::Result;
use crate::modal::assess::fisher::{null_floor, pseudo_inverse, rank, root_of_pseudo_inverse, without};
use crate::modal::assess::tilts::spanned_tip_and_tilt;
use crate::modal::combine::joint::spanned_diversity;
use crate::modal::combine::pistons;
use crate::modal::session::channel_fitters::ChannelFitters;
use crate::modal::solve::engine::ImageFit;
use crate::modal::solve::metrics::Metrics;
use ndarray::{Array1, Array2, Axis, s};

/// The fit of a frame of a channel, which converged.
pub(super) struct FittedChannel<'a> {
    pub(super) fitter: &'a ModalFitter,
    pub(super) fit: &'a ImageFit,
    pub(super) result: &'a ImageResult,
}

/// What is known of a channel beforehand, and its part of a combination.
struct ChannelPart {
    levels: Vec<Level>,
    /// p of the modes, nm; none where the amplitude of the diversities is known.
    diversity_nm: Option<Array1<f64>>,
    /// ĉ, nm, in the same wavelengths as that of the first channel.
    coefficients_nm: Vec<f64>,
    /// a_il of the last fit.
    multiples: [(usize, f64); 2],
}

/// Information of an image at the flat wavefront with the flux 1 at a level of the noise.
struct Level {
    /// Λ, per nm².
    information: Array2<f64>,
    /// Vᵀ [1 p]ᵀ Λ [1 p] V.
    projected: Array2<f64>,
}

/// Combines the fits of several channels.
pub(super) struct Combiner {
    channels: Vec<ChannelPart>,
    /// V, `[mode, and δ where it is unknown, direction]`.
    directions: Array2<f64>,
    /// The modes of V without the motions of the mirror.
    shown: Array2<f64>,
    /// Vᵀ diag(0, 1/σ²) V.
    prior: Array2<f64>,
    /// 1/σ², 0 where δ is known.
    inverse_variance: f64,
    /// Degrees of freedom of the differences of the channels.
    freedom: f64,
    /// M, and then its Cholesky factor.
    matrix: Array2<f64>,
    /// Vectors along the modes (and δ) and along the directions.
    right: Vec<f64>,
    solution: Vec<f64>,
    along: Vec<f64>,
    column: Vec<f64>,
}

impl Combiner {
    /// # Errors
    /// [`Error::Scene`](crate::Error::Scene) for an unknown amplitude of a diversity that the modes
    /// do not span; [`Error::Value`](crate::Error::Value) where no mode changes the images.
    pub(super) fn new(fitters: &ChannelFitters) -> Result<Self> {
        let first = fitters.first();
        let modes = first.model.optics.modes();
        let sigma = fitters.scene().tolerance.defocus_fraction;
        let inverse_variance = if sigma > 0.0 { sigma.powi(-2) } else { 0.0 };
        let size = modes + usize::from(sigma > 0.0);
        let mut channels = Vec::with_capacity(fitters.len());
        for (number, (_, fitter)) in fitters.iter().enumerate() {
            channels.push(ChannelPart::new(fitter, number > 0, sigma > 0.0)?);
        }
        // Directions that no channel determines are those of any multiples above 0.
        let middle = Metrics::levels() / 2;
        let mut sum = Array2::<f64>::zeros((size, size));
        let mut freedom = 0.0;
        for part in &channels {
            sum += &part.designed(&part.levels[middle].information);
            freedom += rank(&part.levels[middle].information, null_floor(modes, modes)) as f64;
        }
        if inverse_variance > 0.0 {
            sum[[modes, modes]] *= 2.0;
            freedom += 1.0;
        }
        let directions = root_of_pseudo_inverse(&sum, null_floor(size, size))?;
        freedom -= directions.ncols() as f64;
        for part in &mut channels {
            for level in 0..part.levels.len() {
                let designed = part.designed(&part.levels[level].information);
                part.levels[level].projected = directions.t().dot(&designed.dot(&directions));
            }
        }
        let mut shown = directions.slice(s![..modes, ..]).to_owned();
        for mut column in shown.columns_mut() {
            let mut nm = column.to_vec();
            first.motions.remove(&mut nm);
            column.assign(&Array1::from(nm));
        }
        let last = directions.row(size - 1).insert_axis(Axis(1));
        let prior = last.dot(&last.t()) * inverse_variance;
        let found = directions.ncols();
        Ok(Self {
            matrix: Array2::zeros((found, found)),
            right: vec![0.0; size],
            solution: vec![0.0; size],
            along: vec![0.0; found],
            column: vec![0.0; found.max(modes)],
            channels,
            directions,
            shown,
            prior,
            inverse_variance,
            freedom: freedom.max(0.0),
        })
    }

    /// Writes the common modes and their error bars; returns the reduced χ² of the differences of
    /// the channels and its degrees of freedom, (1, 0) where there are none. Allocates nothing.
    pub(super) fn combine<'a>(
        &mut self,
        fits: impl Iterator<Item = FittedChannel<'a>> + Clone,
        coefficients_nm: &mut [f64],
        sigma_nm: &mut [f64],
    ) -> (f64, f64) {
        let Some(first) = fits.clone().next() else { return (1.0, 0.0) };
        self.matrix.assign(&self.prior);
        self.right.fill(0.0);
        for (number, (part, channel)) in self.channels.iter_mut().zip(fits).enumerate() {
            part.take(&channel, (number > 0).then_some(&first));
            part.add_to(&mut self.matrix, &mut self.right, &mut self.column);
        }
        decompose(&mut self.matrix);
        self.along.fill(0.0);
        for (right, row) in self.right.iter().zip(self.directions.outer_iter()) {
            self.along.iter_mut().zip(row).for_each(|(along, v)| *along += right * v);
        }
        solve_lower(&self.matrix, &mut self.along);
        solve_upper(&self.matrix, &mut self.along);
        let Self { directions, shown, along, matrix, column, .. } = self;
        for (value, row) in self.solution.iter_mut().zip(directions.outer_iter()) {
            *value = dot(row.iter(), along.iter());
        }
        for (mode, row) in shown.outer_iter().enumerate() {
            coefficients_nm[mode] = dot(row.iter(), along.iter());
            let column = &mut column[..row.len()];
            column.iter_mut().zip(row).for_each(|(to, v)| *to = *v);
            solve_lower(matrix, column);
            sigma_nm[mode] = dot(column.iter(), column.iter()).sqrt();
        }
        let (chi2, freedom) = self.disagreement();
        // Channels that disagree by more than their noise are wrong by at least as much.
        let scale = chi2.max(1.0).sqrt();
        sigma_nm.iter_mut().for_each(|sigma| *sigma *= scale);
        (chi2, freedom)
    }

    /// Reduced χ² of the channels about the solution, and its degrees of freedom.
    fn disagreement(&mut self) -> (f64, f64) {
        if self.freedom < 1.0 {
            return (1.0, 0.0);
        }
        let modes = self.shown.nrows();
        let delta = self.solution.get(modes).copied().unwrap_or(0.0);
        let mut chi2 = delta * delta * self.inverse_variance;
        let off = &mut self.column[..modes];
        for part in &self.channels {
            for (mode, off) in off.iter_mut().enumerate() {
                let shift = part.diversity_nm.as_ref().map_or(0.0, |p| delta * p[mode]);
                *off = part.coefficients_nm[mode] - self.solution[mode] - shift;
            }
            for (level, multiple) in part.multiples {
                let rows = part.levels[level].information.outer_iter();
                let square: f64 = rows.zip(off.iter()).map(|(row, own)| own * dot(row.iter(), off.iter())).sum();
                chi2 += multiple * square;
            }
        }
        (chi2 / self.freedom, self.freedom)
    }
}

impl ChannelPart {
    /// `has_own_tilt`: tip and tilt are this channel's own. `is_unknown`: so is the amplitude of
    /// the diversities.
    fn new(fitter: &ModalFitter, has_own_tilt: bool, is_unknown: bool) -> Result<Self> {
        let (model, modes) = (&fitter.model, fitter.model.optics.modes());
        let tilts = if has_own_tilt { spanned_tip_and_tilt(model)? } else { Array2::zeros((0, modes)) };
        let level = |level: usize| -> Result<Level> {
            let covariance_nm2 = fitter.motions.removed_from(&fitter.metrics.covariance(&fitter.reference, level)?);
            let information = pseudo_inverse(&covariance_nm2, null_floor(modes, modes))?;
            let information = without(fitter.motions.without_information_on(&information), &tilts);
            Ok(Level { information, projected: Array2::zeros((0, 0)) })
        };
        let diversity_nm = is_unknown.then(|| spanned_diversity(fitter)).transpose()?;
        Ok(Self {
            levels: (0..Metrics::levels()).map(level).collect::<Result<_>>()?,
            diversity_nm,
            coefficients_nm: vec![0.0; modes],
            multiples: [(0, 0.0); 2],
        })
    }

    /// [1 p]ᵀ Λ [1 p].
    fn designed(&self, information: &Array2<f64>) -> Array2<f64> {
        let Some(p) = &self.diversity_nm else { return information.clone() };
        let (modes, column) = (p.len(), information.dot(p));
        let mut all = Array2::zeros((modes + 1, modes + 1));
        all.slice_mut(s![..modes, ..modes]).assign(information);
        all.slice_mut(s![..modes, modes]).assign(&column);
        all.slice_mut(s![modes, ..modes]).assign(&column);
        all[[modes, modes]] = p.dot(&column);
        all
    }

    /// Takes the fit of a frame, with its pistons within half a wavelength of those of the `first`
    /// channel.
    fn take(&mut self, channel: &FittedChannel, first: Option<&FittedChannel>) {
        let FittedChannel { fitter, fit, result } = channel;
        self.coefficients_nm.copy_from_slice(&result.coefficients_nm);
        if let Some(first) = first {
            pistons::wrap(&mut self.coefficients_nm, &first.result.coefficients_nm, &fitter.model);
            first.fitter.motions.remove(&mut self.coefficients_nm);
        }
        let floor_e2 = fit.prepared.floor_variance_e2.iter().copied().fold(f64::INFINITY, f64::min);
        let scale = result.report.reduced_chi2.max(1.0);
        self.multiples = fitter.metrics.between(&fitter.reference, result.report.flux_e, floor_e2);
        self.multiples.iter_mut().for_each(|(_, multiple)| *multiple /= scale);
    }

    /// Adds its part to M and to Σ a [1 p]ᵀ Λ ĉ. `work` holds as many numbers as there are modes.
    fn add_to(&self, matrix: &mut Array2<f64>, right: &mut [f64], work: &mut [f64]) {
        let modes = self.coefficients_nm.len();
        let work = &mut work[..modes];
        work.fill(0.0);
        for (level, multiple) in self.multiples.into_iter().filter(|(_, multiple)| *multiple > 0.0) {
            let Level { information, projected } = &self.levels[level];
            matrix.iter_mut().zip(projected).for_each(|(sum, value)| *sum += multiple * value);
            for (sum, row) in work.iter_mut().zip(information.outer_iter()) {
                *sum += multiple * dot(row.iter(), self.coefficients_nm.iter());
            }
        }
        right.iter_mut().zip(work.iter()).for_each(|(sum, value)| *sum += value);
        if let Some(p) = &self.diversity_nm {
            right[modes] += dot(p.iter(), work.iter());
        }
    }
}

fn dot<'a>(a: impl Iterator<Item = &'a f64>, b: impl Iterator<Item = &'a f64>) -> f64 {
    a.zip(b).map(|(a, b)| a * b).sum()
}

/// Replaces the lower triangle of a positive definite matrix by its Cholesky factor.
fn decompose(matrix: &mut Array2<f64>) {
    for i in 0..matrix.nrows() {
        for j in 0..=i {
            let (before_i, before_j) = (matrix.slice(s![i, ..j]), matrix.slice(s![j, ..j]));
            let rest = matrix[[i, j]] - dot(before_i.iter(), before_j.iter());
            matrix[[i, j]] = if i == j { rest.max(f64::MIN_POSITIVE).sqrt() } else { rest / matrix[[j, j]] };
        }
    }
}

/// L⁻¹ v.
fn solve_lower(factor: &Array2<f64>, v: &mut [f64]) {
    for i in 0..v.len() {
        v[i] = (v[i] - dot(factor.slice(s![i, ..i]).iter(), v[..i].iter())) / factor[[i, i]];
    }
}

/// L⁻ᵀ v.
fn solve_upper(factor: &Array2<f64>, v: &mut [f64]) {
    for i in (0..v.len()).rev() {
        v[i] /= factor[[i, i]];
        let (own, before) = (v[i], factor.slice(s![i, ..i]));
        v[..i].iter_mut().zip(before).for_each(|(v, l)| *v -= l * own);
    }
}
