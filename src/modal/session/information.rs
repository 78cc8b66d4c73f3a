//! Information of the frames of a group at the flat wavefront, in memory that is allocated
//! beforehand: the metric of their fit, the error bars of the modes, and whether the frames are of
//! one wavefront.
//!
//! With G_il the information of channel i at the levels l between which the noise of its image lies
//! ([`Metrics::between`]), by the [`Unknowns`], a_il its multiples, P the inverse covariance of
//! what is known before the images, and R the directions that both determine:
//!
//! ```text
//! M = Σ a_il Rᵀ G_il R + Rᵀ P R = L Lᵀ     metric x = R L⁻ᵀ z     covariance R M⁻¹ Rᵀ
//! χ² = Σ (v·Rᵀ s_i)²/(a_i μ)               s_i: −½ of the gradient of image i at the minimum of all
//! ```
//!
//! with the eigenvectors v and eigenvalues μ of Rᵀ G_i R, but for directions of which an image
//! knows little, and with s_i moved to the minimum without P (see `group/consistency.rs`). Each
//! term is computed once; R has the scale that makes M near the identity for images of the flux
//! [`USUAL_FLUX_E`], so that its Cholesky decomposition is exact to rounding.

use crate::Result;
use crate::modal::assess::fisher::{null_floor, root_of_pseudo_inverse};
use crate::modal::assess::tilts::spanned_tip_and_tilt;
use crate::modal::combine::integers::are_determined;
use crate::modal::combine::joint::spanned_diversity;
use crate::modal::fitter::ModalFitter;
use crate::modal::group::prior::Prior;
use crate::modal::group::unknowns::{Amplitude, Unknowns};
use crate::modal::session::channel_fitters::ChannelFitters;
use crate::modal::solve::metrics::Metrics;
use crate::optimize::Metric;
use ndarray::{Array1, Array2, ArrayView1, s};

/// Flux of an image, electrons, for which the terms have a unit scale.
const USUAL_FLUX_E: f64 = 1e7;
/// Share of an image's best known direction below which a direction of it is left out of the
/// differences: at the wavefront it may know more of it than at the flat one.
const LEAST_SHARE: f64 = 0.1;
/// Part of the usual information below which images know nothing of a direction.
const RIDGE: f64 = 1e-9;

/// What is known of a channel beforehand, and of its image.
struct ChannelInformation {
    levels: Vec<Level>,
    /// a_il of the last image.
    multiples: [(usize, f64); 2],
}

/// Information of an image at the flat wavefront with the flux 1 at a level of the noise.
struct Level {
    /// Rᵀ G R.
    information: Array2<f64>,
    /// v/√μ by the modes of the image, `[direction, mode]`.
    of_modes: Array2<f64>,
    /// √μ v, `[direction, column of R]`.
    of_directions: Array2<f64>,
}

/// Information of the frames of a group.
pub(super) struct GroupInformation {
    channels: Vec<ChannelInformation>,
    pub(super) unknowns: Unknowns,
    /// P; `None` where nothing is known before the images.
    precision: Option<Array2<f64>>,
    /// R.
    directions: Array2<f64>,
    /// The modes of R without the motions of the mirror.
    shown: Array2<f64>,
    /// Rᵀ P R.
    prior: Array2<f64>,
    /// Degrees of freedom of the differences of the images.
    freedom: f64,
    /// A sum of information, and then its Cholesky factor.
    matrix: Array2<f64>,
    /// Along the unknowns, and along R.
    gradient: Vec<f64>,
    along: Vec<f64>,
}

impl GroupInformation {
    /// Of channels each of which `is_weak` or determines the wavefront by itself: where all are,
    /// the modes have the prior of groups, before the images say more.
    ///
    /// # Errors
    /// [`Error::Scene`](crate::Error::Scene) for an unknown amplitude of a diversity that the modes
    /// do not span; [`Error::Value`](crate::Error::Value) where no mode changes the images.
    pub(super) fn new(fitters: &ChannelFitters, is_weak: &[bool]) -> Result<Self> {
        let model = &fitters.first().model;
        let modes = model.optics.modes();
        let (amplitude, amplitude_nm) = amplitude(fitters)?;
        let tilts = spanned_tip_and_tilt(model)?;
        let unknowns = Unknowns::new(modes, amplitude, tilts.clone(), fitters.len());
        let count = unknowns.count();
        let mut precision = Array2::zeros((count, count));
        if !is_weak.contains(&false) {
            let wavelengths_nm: Vec<f64> =
                fitters.iter().map(|(_, fitter)| fitter.model.optics.parts().wavelength_nm).collect();
            let range_nm = fitters.first().scene.modes.piston_range_nm;
            let range_nm = are_determined(&wavelengths_nm).then_some(range_nm);
            precision = Prior::new(model, tilts, range_nm).precision(count);
        }
        if let Some(place) = unknowns.amplitude() {
            precision[[place, place]] += amplitude_nm.powi(-2);
        }
        let mut known = Vec::with_capacity(fitters.len());
        for (number, (_, fitter)) in fitters.iter().enumerate() {
            let of_level = |level| {
                let mut own = Array2::zeros((count, count));
                unknowns.add_information(number, &fitter.metrics.information(&fitter.reference, level)?, &mut own);
                Ok(own)
            };
            known.push((0..Metrics::levels()).map(of_level).collect::<Result<Vec<Array2<f64>>>>()?);
        }
        // Directions that no channel determines are those of any multiples above 0.
        let middle = Metrics::levels() / 2;
        let of_images = known.iter().fold(Array2::zeros((count, count)), |sum, own| sum + &own[middle] * USUAL_FLUX_E);
        let directions = root_of_pseudo_inverse(&(&of_images + &precision), null_floor(count, modes))?;
        let along = |matrix: &Array2<f64>| {
            let along = directions.t().dot(&matrix.dot(&directions));
            (&along + &along.t()) * 0.5
        };
        // Without what the prior alone determines.
        let columns = Metric::from_gauss_newton(&along(&of_images), RIDGE)?;
        let columns = columns.whitening().map(|columns| columns.to_owned()).unwrap_or_default();
        let inverse = columns.dot(&columns.t());
        let mut freedom = if unknowns.amplitude().is_some() { 1.0 } else { 0.0 };
        let mut channels = Vec::with_capacity(fitters.len());
        for (channel, of_levels) in known.iter().enumerate() {
            let of_level = |(level, own): (usize, &Array2<f64>)| {
                let information = along(own);
                let metric = Metric::from_gauss_newton(&information, LEAST_SHARE)?;
                // Columns v/√μ.
                let columns = metric.whitening().map(|columns| columns.to_owned()).unwrap_or_default();
                let mut of_directions = columns.t().to_owned();
                for mut row in of_directions.outer_iter_mut() {
                    row /= row.dot(&row);
                }
                if level == middle {
                    let knows = |row: ArrayView1<f64>| 1.0 - USUAL_FLUX_E * row.dot(&inverse.dot(&row));
                    freedom += of_directions.outer_iter().map(|row| knows(row).max(0.0)).sum::<f64>();
                }
                let mut of_modes = Array2::zeros((columns.ncols(), modes));
                for (row, column) in of_modes.outer_iter_mut().zip(directions.dot(&columns).columns()) {
                    unknowns.write_coefficients(channel, &column.to_vec(), row);
                }
                Ok(Level { information, of_modes, of_directions })
            };
            let levels = of_levels.iter().enumerate().map(of_level).collect::<Result<Vec<_>>>()?;
            channels.push(ChannelInformation { levels, multiples: [(0, 0.0); 2] });
        }
        let mut shown = directions.slice(s![..modes, ..]).to_owned();
        for mut column in shown.columns_mut() {
            let mut nm = column.to_vec();
            fitters.first().motions.remove(&mut nm);
            column.assign(&Array1::from(nm));
        }
        let found = directions.ncols();
        Ok(Self {
            prior: along(&precision),
            precision: precision.iter().any(|value| *value != 0.0).then_some(precision),
            matrix: Array2::zeros((found, found)),
            gradient: vec![0.0; count],
            along: vec![0.0; found],
            channels,
            unknowns,
            directions,
            shown,
            freedom,
        })
    }

    /// A metric of the unknowns, for [`GroupInformation::write_metric`].
    pub(super) fn empty_metric(&self) -> Metric {
        Metric::of_whitening(self.directions.clone())
    }

    /// Adds what is known before the images at `point`: to the gradient; what it adds to the
    /// objective.
    pub(super) fn add_prior(&self, point: &[f64], gradient: &mut [f64]) -> f64 {
        let Some(precision) = &self.precision else { return 0.0 };
        let mut objective = 0.0;
        for ((row, own), slope) in precision.outer_iter().zip(point).zip(gradient) {
            let pull = dot(row.iter(), point.iter());
            *slope += 2.0 * pull;
            objective += own * pull;
        }
        objective
    }

    /// Takes the flux, electrons, and the least variance of the image of a channel.
    pub(super) fn take(&mut self, channel: usize, fitter: &ModalFitter, (flux_e, floor_e2): (f64, f64)) {
        self.channels[channel].multiples = fitter.metrics.between(&fitter.reference, flux_e, floor_e2);
    }

    /// Without an image of a channel.
    pub(super) fn take_none(&mut self, channel: usize) {
        self.channels[channel].multiples = [(0, 0.0); 2];
    }

    /// Writes the metric of the images that were taken. Allocates nothing.
    pub(super) fn write_metric(&mut self, metric: &mut Metric) {
        self.matrix.assign(&self.prior);
        self.decompose();
        let (Some(mut whitening), factor) = (metric.whitening_mut(), &self.matrix) else { return };
        // Each row of R L⁻ᵀ is L⁻¹ times that of R.
        for (mut to, row) in whitening.outer_iter_mut().zip(self.directions.outer_iter()) {
            self.along.iter_mut().zip(row).for_each(|(to, v)| *to = *v);
            solve_lower(factor, &mut self.along);
            to.assign(&ArrayView1::from(&self.along));
        }
    }

    /// Writes the error bars of the modes by the images that were taken. Allocates nothing.
    pub(super) fn write_sigma(&mut self, sigma_nm: &mut [f64]) {
        self.matrix.assign(&self.prior);
        self.decompose();
        for (sigma, row) in sigma_nm.iter_mut().zip(self.shown.outer_iter()) {
            self.along.iter_mut().zip(row).for_each(|(to, v)| *to = *v);
            solve_lower(&self.matrix, &mut self.along);
            *sigma = dot(self.along.iter(), self.along.iter()).sqrt();
        }
    }

    /// Reduced χ² of the differences of the images that were taken from the wavefront of all, and
    /// its degrees of freedom; (1, 0) where there are none. `gradients` of each image by its modes
    /// and the scales of their variances are given, at the minimum `point`. Allocates nothing.
    pub(super) fn differences<'a>(
        &mut self,
        point: &[f64],
        images: impl Iterator<Item = (ArrayView1<'a, f64>, f64)>,
    ) -> (f64, f64) {
        if self.freedom < 1.0 {
            return (1.0, 0.0);
        }
        let mut chi2 = 0.0;
        self.along.fill(0.0);
        if let Some(precision) = &self.precision {
            if let Some(place) = self.unknowns.amplitude() {
                chi2 += point[place] * point[place] * precision[[place, place]];
            }
            // What P pulls, and how far the minimum without it is off.
            for (pull, row) in self.gradient.iter_mut().zip(precision.outer_iter()) {
                *pull = dot(row.iter(), point.iter());
            }
            for (along, column) in self.along.iter_mut().zip(self.directions.columns()) {
                *along = dot(column.iter(), self.gradient.iter());
            }
            self.matrix.fill(0.0);
            self.decompose();
            solve_lower(&self.matrix, &mut self.along);
            solve_upper(&self.matrix, &mut self.along);
        }
        for (channel, (gradient, scale)) in self.channels.iter().zip(images) {
            let total: f64 = channel.multiples.iter().map(|(_, multiple)| multiple).sum();
            for (level, multiple) in channel.multiples.into_iter().filter(|(_, multiple)| *multiple > 0.0) {
                let Level { of_modes, of_directions, .. } = &channel.levels[level];
                let off = |(modes, directions): (ArrayView1<f64>, ArrayView1<f64>)| {
                    let score = -0.5 * dot(modes.iter(), gradient.iter());
                    (score - total * dot(directions.iter(), self.along.iter())).powi(2)
                };
                let squares = of_modes.outer_iter().zip(of_directions.outer_iter()).map(off).sum::<f64>();
                chi2 += multiple / (total * total * scale) * squares;
            }
        }
        (chi2 / self.freedom, self.freedom)
    }

    /// Adds the information of the images that were taken to the matrix, and decomposes it.
    fn decompose(&mut self) {
        let mut mean = 0.0;
        for channel in &self.channels {
            for (level, multiple) in channel.multiples.into_iter().filter(|(_, multiple)| *multiple > 0.0) {
                self.matrix.scaled_add(multiple, &channel.levels[level].information);
                mean += multiple / USUAL_FLUX_E;
            }
        }
        self.matrix.diag_mut().iter_mut().for_each(|value| *value += RIDGE * mean);
        decompose(&mut self.matrix);
    }
}

/// The amplitude of the diversities of the channels, and its standard deviation, nm.
///
/// # Errors
/// [`Error::Scene`](crate::Error::Scene) for modes that do not span a diversity.
fn amplitude(fitters: &ChannelFitters) -> Result<(Amplitude, f64)> {
    let sigma = fitters.scene().tolerance.defocus_fraction;
    if sigma <= 0.0 {
        return Ok((Amplitude::Known, f64::INFINITY));
    }
    let each = fitters.iter().map(|(_, fitter)| spanned_diversity(fitter)).collect::<Result<Vec<_>>>()?;
    let largest_nm = each.iter().map(|nm| nm.dot(nm).sqrt()).fold(0.0, f64::max);
    if largest_nm == 0.0 {
        return Ok((Amplitude::Known, f64::INFINITY));
    }
    let each = each.into_iter().map(|nm| nm / largest_nm).collect();
    Ok((Amplitude::InModes(each), sigma * largest_nm))
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
