//! From the minima of single images to one estimate: statuses, mean, error bars, maps.

use super::Estimator;
use super::fit::{Minimum, reduced_chi2, variance};
use super::model::Model;
use super::prepare::Prepared;
use super::spread::Spread;
use crate::modes::{Degeneracy, Group, WEAK_BELOW};
use crate::optimize::StopReason;
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1, Axis, s};
use rayon::prelude::*;

/// What became of one image.
#[derive(Debug, Clone, PartialEq)]
pub enum Status {
    /// Fitted, and the model explains it.
    Ok,
    /// Fitted, but the residual is larger than the noise: the modes do not span what is there, or the model is off.
    /// Error bars are scaled up by √χ².
    Misfit,
    /// The residual is so large that the fit probably sits in a wrong minimum.
    WrongMinimum,
    /// The optimiser gave up before it converged.
    NotConverged(StopReason),
    /// The image could not be used.
    Unusable(String),
}

impl Status {
    /// One word for tables.
    pub fn word(&self) -> &'static str {
        match self {
            Status::Ok => "ok",
            Status::Misfit => "misfit",
            Status::WrongMinimum => "wrong-minimum",
            Status::NotConverged(_) => "not-converged",
            Status::Unusable(_) => "unusable",
        }
    }
}

/// Reduced χ² above which a fit is called a misfit. Its expectation is 1 with a scatter of √(2/9000) = 0.015; an
/// unmodelled error of one standard deviation in every pixel makes it 2.
const MISFIT: f64 = 2.0;
/// Reduced χ² above which a wrong minimum is suspected: a basis that misses part of the NCPA gives 17 at a peak SNR of
/// 500, wrong minima 900 to 5,000.
const WRONG_MINIMUM: f64 = 300.0;

/// The report on one image.
#[derive(Debug, Clone)]
pub struct ImageReport {
    /// What became of it.
    pub status: Status,
    /// Evaluations of objective and gradient.
    pub evaluations: usize,
    /// χ² per degree of freedom.
    pub reduced_chi2: f64,
    /// Electrons of the star.
    pub flux_e: f64,
    /// Electrons per native pixel.
    pub background_e: f64,
    /// Tilt of the fitted wavefront and of the shift onto the axis, along x and y, nm RMS over the pupil.
    pub tip_tilt_nm: [f64; 2],
    /// Pixels of the fitted part that were bad.
    pub bad_pixels: usize,
}

/// The static wavefront.
#[derive(Debug, Clone)]
pub struct Combined {
    /// Every mode, nm; pistons have zero mean over the pupil.
    pub coefficients_nm: Vec<f64>,
    /// Its covariance, nm².
    pub covariance_nm2: Array2<f64>,
}

impl Combined {
    /// Standard deviation of each mode, nm.
    pub fn sigma_nm(&self) -> Vec<f64> {
        self.covariance_nm2.diag().iter().map(|v| v.max(0.0).sqrt()).collect()
    }
}

/// Images of one estimate: what was compared, for pictures. `[y, x]`, electrons at the model's sampling.
#[derive(Debug, Clone)]
pub struct Compared {
    /// The data; NaN where bad.
    pub data_e: Array2<f64>,
    /// The fitted model.
    pub model_e: Array2<f64>,
    /// (data − model) in standard deviations; NaN where bad.
    pub residual_sigma: Array2<f64>,
}

/// What [`Estimator::estimate`] found.
#[derive(Debug, Clone)]
pub struct Estimate {
    /// One report per image, in order.
    pub images: Vec<ImageReport>,
    /// Coefficients of each image, `[image, mode]`, nm; NaN for unusable ones.
    pub image_coefficients_nm: Array2<f64>,
    /// The images that went into the mean: those of the best kind of status that is there.
    pub used_images: Vec<usize>,
    /// Mean over them.
    pub combined: Combined,
    /// Segment errors, `[y, x]`, nm, NaN outside the pupil.
    pub phasing_nm: Array2<f64>,
    /// Non-common path aberrations likewise.
    pub ncpa_nm: Array2<f64>,
    /// Error bar of each map, 1σ, nm.
    pub phasing_sigma_nm: Array2<f64>,
    /// Likewise.
    pub ncpa_sigma_nm: Array2<f64>,
    /// The first image that was used, beside its model.
    pub compared: Compared,
    /// Which combinations of modes the images do not see, or hardly.
    pub degeneracy: Degeneracy,
    /// Wall-clock time of the estimate, without building the model.
    pub seconds: f64,
    /// Where it ran.
    pub device: String,
    /// In which precision.
    pub precision: &'static str,
}

impl Estimate {
    /// Number of images that went into the mean.
    pub fn used(&self) -> usize {
        self.used_images.len()
    }

    /// Median reduced χ² of the images that were used.
    pub fn reduced_chi2(&self) -> f64 {
        let mut values: Vec<f64> = self.used_images.iter().map(|&image| self.images[image].reduced_chi2).collect();
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
    }

    /// The worst status among the images.
    pub fn status(&self) -> &Status {
        let rank = |status: &Status| match status {
            Status::Ok => 0,
            Status::Misfit => 1,
            Status::WrongMinimum => 2,
            Status::NotConverged(_) => 3,
            Status::Unusable(_) => 4,
        };
        let worst = self.images.iter().map(|image| &image.status).max_by_key(|status| rank(status));
        worst.unwrap_or(&Status::Ok)
    }
}

/// One minimum under its fitted model.
struct Judged {
    report: ImageReport,
    psf: Vec<f64>,
    variance_e2: Vec<f64>,
}

/// Judges one minimum. `tilts` are the slopes of each mode.
fn judge(estimator: &Estimator, tilts: &Tilts, prepared: &Prepared, minimum: &Minimum) -> Judged {
    let model = &estimator.model;
    let psf = estimator.judge.psf(ArrayView1::from(&minimum.coefficients_nm));
    let variance_e2 = variance(&psf, minimum, &prepared.floor_variance_e2);
    let reduced_chi2 = reduced_chi2(&psf, minimum, &variance_e2, model.optics.modes());
    let status = match minimum.reason {
        reason if !reason.converged() && reason != StopReason::NoDescent => Status::NotConverged(reason),
        _ if reduced_chi2 > WRONG_MINIMUM => Status::WrongMinimum,
        _ if reduced_chi2 > MISFIT => Status::Misfit,
        _ => Status::Ok,
    };
    let ratio = model.preparation.frame_pixels as f64 / model.preparation.reduced_pixels as f64;
    let report = ImageReport {
        status,
        evaluations: minimum.evaluations,
        reduced_chi2,
        flux_e: minimum.flux_e,
        background_e: minimum.background_e / (ratio * ratio),
        tip_tilt_nm: tilts.of(&minimum.coefficients_nm, prepared.shift_pixels),
        bad_pixels: prepared.bad_pixels,
    };
    Judged { report, psf, variance_e2 }
}

fn compared(model: &Model, psf: &[f64], minimum: &Minimum, variance_e2: &[f64]) -> Compared {
    let size = model.preparation.pixels;
    let pixel = |(v, u): (usize, usize)| v * size + u;
    let model_e = Array2::from_shape_fn((size, size), |at| minimum.flux_e * psf[pixel(at)] + minimum.background_e);
    let data_e = Array2::from_shape_fn((size, size), |at| {
        if variance_e2[pixel(at)].is_finite() { minimum.exposure.data_e[pixel(at)] } else { f64::NAN }
    });
    let residual_sigma =
        Array2::from_shape_fn((size, size), |at| (data_e[at] - model_e[at]) / variance_e2[pixel(at)].sqrt());
    Compared { data_e, model_e, residual_sigma }
}

/// Slopes over the pupil, by least squares, as nm RMS of tip and tilt.
struct Tilts {
    /// Of each mode, along x and y, per nm.
    modes: Vec<[f64; 2]>,
    /// Of a shift by one model pixel.
    per_pixel_nm: [f64; 2],
}

impl Tilts {
    fn new(model: &Model) -> Self {
        let pupil = &model.telescope.pupil;
        let total = pupil.weight_sum();
        let mean = |map: &Array2<f64>| (map * &pupil.amplitude).sum() / total;
        // x and y about their mean, at unit RMS over the pupil; and that RMS, m.
        let axes = [0, 1].map(|axis| {
            let along = |(y, x): (usize, usize)| pupil.grid.coordinate_m(if axis == 0 { x } else { y });
            let map = Array2::from_shape_fn(pupil.amplitude.dim(), along);
            let centred = &map - mean(&map);
            let rms_m = mean(&(&centred * &centred)).sqrt();
            (centred / rms_m, rms_m)
        });
        let modes = model.basis.maps().outer_iter().map(|mode| [0, 1].map(|i| mean(&(&mode * &axes[i].0)))).collect();
        // One pixel is λ over the width of the model's grid, divided by the pixels per λ/D.
        let sampling = model.optics.sampling();
        let width_m = pupil.grid.width_m() * model.width_ratio();
        let per_pixel_nm_m = model.optics.parts().wavelength_nm / (sampling.pixels_per_lambda_over_d * width_m);
        Self { modes, per_pixel_nm: [0, 1].map(|i| per_pixel_nm_m * axes[i].1) }
    }

    /// Of a wavefront whose image was moved onto the axis by `shift_pixels`.
    fn of(&self, coefficients_nm: &[f64], shift_pixels: [i64; 2]) -> [f64; 2] {
        [0, 1].map(|axis| {
            let modes = self.modes.iter().zip(coefficients_nm).map(|(slope, nm)| slope[axis] * nm);
            modes.sum::<f64>() + shift_pixels[axis] as f64 * self.per_pixel_nm[axis]
        })
    }
}

/// The covariance of coefficients whose pistons are about their mean over the pupil.
pub(super) fn about_mean_piston(model: &Model, covariance: Array2<f64>) -> Result<Array2<f64>> {
    let share = piston_shares(model)?;
    let modes = covariance.nrows();
    // P = I − 1·shareᵀ on the pistons.
    let mut projector = Array2::eye(modes);
    for i in 0..share.len() {
        for (j, share) in share.iter().enumerate() {
            projector[[i, j]] -= share;
        }
    }
    Ok(projector.dot(&covariance).dot(&projector.t()))
}

/// Each piston's share in the mean over the pupil; empty where pistons are not estimated.
fn piston_shares(model: &Model) -> Result<Vec<f64>> {
    let pistons = model.basis.names().iter().take(model.segment_modes).take_while(|name| name.ends_with("-piston"));
    let count = pistons.count();
    let pupil = &model.telescope.pupil;
    let maps = model.basis.maps();
    let shares: Vec<f64> = maps.outer_iter().take(count).map(|map| (&map * &pupil.amplitude).sum()).collect();
    let total: f64 = shares.iter().sum();
    if count > 0 && total <= 0.0 {
        return Err(Error::Value("the segment pistons move no glass".into()));
    }
    Ok(shares.iter().map(|share| share / total).collect())
}

/// Pistons about their mean over the pupil.
fn centre_pistons(model: &Model, coefficients_nm: &mut [f64]) -> Result<()> {
    let shares = piston_shares(model)?;
    let mean: f64 = shares.iter().zip(coefficients_nm.iter()).map(|(share, nm)| share * nm).sum();
    coefficients_nm[..shares.len()].iter_mut().for_each(|nm| *nm -= mean);
    Ok(())
}

/// Mean, error bars and maps of all images of a call. `indices` says which images the minima belong to.
pub(super) fn combine(
    estimator: &Estimator,
    refused: Vec<Option<Error>>,
    indices: &[usize],
    prepared: &[Prepared],
    mut minima: Vec<Minimum>,
) -> Result<Estimate> {
    let model = &estimator.model;
    let modes = model.optics.modes();
    minima.iter_mut().try_for_each(|minimum| centre_pistons(model, &mut minimum.coefficients_nm))?;
    let tilts = Tilts::new(model);
    let mut judged: Vec<Judged> =
        prepared.par_iter().zip(&minima).map(|(p, m)| judge(estimator, &tilts, p, m)).collect();
    let mut images: Vec<ImageReport> = refused.into_iter().map(unusable).collect();
    let mut image_coefficients_nm = Array2::from_elem((images.len(), modes), f64::NAN);
    for ((&image, minimum), judged) in indices.iter().zip(&minima).zip(&judged) {
        images[image] = judged.report.clone();
        image_coefficients_nm.row_mut(image).assign(&ArrayView1::from(&minimum.coefficients_nm));
    }
    let kept = kept(&judged.iter().map(|judged| &judged.report).collect::<Vec<_>>());
    if kept.is_empty() {
        let reason = match &judged[0].report.status {
            Status::NotConverged(reason) => reason.to_string(),
            other => other.word().into(),
        };
        return Err(Error::Image(format!("no image could be fitted: {reason}")));
    }
    let rows: Vec<ArrayView1<f64>> = kept.iter().map(|&i| ArrayView1::from(&minima[i].coefficients_nm)).collect();
    let stacked = ndarray::stack(Axis(0), &rows).map_err(|error| Error::Internal(error.to_string()))?;
    let variances: Vec<Vec<f64>> = judged.iter_mut().map(|judged| std::mem::take(&mut judged.variance_e2)).collect();
    let spread = Spread::of(estimator, prepared, &minima, &variances)?;
    let covariance = |&i: &usize| spread.covariance(i) * judged[i].report.reduced_chi2.max(1.0);
    let combined = mean(&stacked, kept.iter().map(covariance));
    let first = kept[0];
    Ok(Estimate {
        phasing_nm: model.map_nm(&combined.coefficients_nm, Group::Segment),
        ncpa_nm: model.map_nm(&combined.coefficients_nm, Group::Ncpa),
        phasing_sigma_nm: sigma_map(model, &combined.covariance_nm2, Group::Segment),
        ncpa_sigma_nm: sigma_map(model, &combined.covariance_nm2, Group::Ncpa),
        compared: compared(model, &judged[first].psf, &minima[first], &variances[first]),
        used_images: kept.iter().map(|&i| indices[i]).collect(),
        degeneracy: Degeneracy::of(spread.fisher(first), model.basis.names(), WEAK_BELOW)?,
        images,
        image_coefficients_nm,
        combined,
        seconds: 0.0,
        device: String::new(),
        precision: "",
    })
}

fn unusable(refused: Option<Error>) -> ImageReport {
    ImageReport {
        status: Status::Unusable(refused.map(|error| error.to_string()).unwrap_or_default()),
        evaluations: 0,
        reduced_chi2: f64::NAN,
        flux_e: f64::NAN,
        background_e: f64::NAN,
        tip_tilt_nm: [f64::NAN; 2],
        bad_pixels: 0,
    }
}

/// Which fits go into the mean: those that converged on a plausible minimum; where there is none, suspected wrong
/// minima; where all gave up early, those that at least ended on numbers. Each says what it is by its status.
fn kept(reports: &[&ImageReport]) -> Vec<usize> {
    let rank = |report: &ImageReport| match report.status {
        Status::Ok | Status::Misfit => Some(0),
        Status::WrongMinimum => Some(1),
        Status::NotConverged(_) if report.reduced_chi2.is_finite() => Some(2),
        Status::NotConverged(_) | Status::Unusable(_) => None,
    };
    let Some(best) = reports.iter().filter_map(|report| rank(report)).min() else { return Vec::new() };
    reports.iter().enumerate().filter(|(_, report)| rank(report) == Some(best)).map(|(i, _)| i).collect()
}

/// Mean over images, with the larger of two error bars: what the noise of each image gives, and, from four images on,
/// what their scatter shows (a static wavefront under a changing one scatters more than its noise).
fn mean(coefficients_nm: &Array2<f64>, covariances_nm2: impl Iterator<Item = Array2<f64>>) -> Combined {
    let count = coefficients_nm.nrows() as f64;
    let mean: Array1<f64> = coefficients_nm.sum_axis(Axis(0)) / count;
    let mut covariance = Array2::<f64>::zeros((mean.len(), mean.len()));
    for image in covariances_nm2 {
        covariance += &image;
    }
    covariance /= count * count;
    if coefficients_nm.nrows() >= 4 {
        let deviations = coefficients_nm - &mean.view().insert_axis(Axis(0));
        let scatter = deviations.t().dot(&deviations) / (count * (count - 1.0));
        // A common factor keeps the matrix positive; the mean over modes keeps it steady.
        let ratio = scatter.diag().sum() / covariance.diag().sum();
        if ratio > 1.0 {
            covariance *= ratio;
        }
    }
    Combined { coefficients_nm: mean.to_vec(), covariance_nm2: covariance }
}

/// √ of the diagonal of M C Mᵀ over the pupil, for the modes of one group.
fn sigma_map(model: &Model, covariance_nm2: &Array2<f64>, group: Group) -> Array2<f64> {
    let range = match group {
        Group::Segment => 0..model.segment_modes,
        Group::Ncpa => model.segment_modes..model.basis.len(),
    };
    let covariance = covariance_nm2.slice(s![range.clone(), range.clone()]);
    let maps = model.basis.maps();
    let shape = model.telescope.pupil.amplitude.dim();
    let flat = maps.slice(s![range.clone(), .., ..]);
    let flat = flat.to_shape((range.len(), shape.0 * shape.1)).map(|flat| flat.to_owned()).unwrap_or_default();
    let product = covariance.dot(&flat);
    let variance: Array1<f64> = (&product * &flat).sum_axis(Axis(0));
    let map = Array2::from_shape_vec(shape, variance.mapv(|v| v.max(0.0).sqrt()).to_vec());
    model.outside_to_nan(map.unwrap_or_else(|_| Array2::zeros(shape)))
}
