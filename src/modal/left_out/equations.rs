//! Normal equations of images at their minima, by the fitted modes and by what was left out.

use crate::imaging::LinearModel;
use crate::modal::assess::fisher::{Sensitivity, null_floor, pseudo_inverse, root_of_pseudo_inverse};
use crate::modal::assess::mean_residual::EXPLAINED;
use crate::modal::assess::residual::photometry;
use crate::modal::combine::combined_modes::CombinedModes;
use crate::modal::combine::global_motions::GlobalMotions;
use crate::modal::left_out::{AMPLITUDE_UNIT, Equations, LeftOut, SAME, Step, WithLeftOut, camera, priors};
use crate::modal::model::Model;
use crate::modal::prepare::PreparedFrame;
use crate::modal::solve::minimum::Minimum;
use crate::modes::symmetric_eigen;
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1, Axis, concatenate, s};
use rayon::prelude::*;

/// The covariance `noise_nm2` with what images scatter beyond another one of their noise. Where
/// that leaves variances below 0, because both are not known well, only what it adds is taken.
///
/// # Errors
/// [`Error::Internal`] for values that are not finite.
fn with_scatter(noise_nm2: Array2<f64>, scatter_nm2: &Array2<f64>) -> Result<Array2<f64>> {
    if scatter_nm2.iter().all(|value| *value == 0.0) {
        return Ok(noise_nm2);
    }
    let sum_nm2 = &noise_nm2 + scatter_nm2;
    let modes = sum_nm2.nrows();
    let is_positive = sum_nm2.diag().iter().all(|variance| *variance >= 0.0);
    if is_positive && root_of_pseudo_inverse(&sum_nm2, null_floor(modes, modes)).is_ok() {
        return Ok(sum_nm2);
    }
    let (variances, directions) = symmetric_eigen(scatter_nm2)?;
    let added = &directions * &variances.mapv(|variance| variance.max(0.0));
    Ok(noise_nm2 + added.dot(&directions.t()))
}

impl LeftOut {
    /// The modes of images of one wavefront, whose fits have the normal equations `found`, with
    /// what was left out: `mean_residual_chi2` is the reduced χ² of their mean residual,
    /// `likelihood` their combination, and `noise_nm2` the part of its covariance that follows from
    /// the images' noise. Behind them those that would be found if nothing had been left out, with
    /// the error bars of what χ² is then, and the equations.
    ///
    /// # Errors
    /// [`Error::Internal`] for values that are not finite.
    pub(in crate::modal) fn marginalised(
        &self,
        motions: &GlobalMotions,
        (mut found, mean_residual_chi2): (NormalEquations, f64),
        likelihood: &CombinedModes,
        noise_nm2: &Array2<f64>,
    ) -> Result<(WithLeftOut, CombinedModes, OwnEquations)> {
        let (information, pixels, inverse) = (found.information(), found.pixels, found.inverse.take());
        let NormalEquations { images: scores, chi2, freedom, .. } = &found;
        // By the fitted modes it is what the tolerance of the fit, or its precision, left: without
        // it there would be a slope along combinations that change no image, figures of all
        // segments with a staircase and a smooth shape, which were 220 nm off after fits to 1 nm.
        let score = scores.iter().fold(Array1::zeros(information.nrows()), |sum, own| sum + own);
        let at = Array1::from(likelihood.coefficients_nm.clone());
        let floor = null_floor(score.len(), pixels);
        let inverse = inverse.filter(|_| self.tilts.is_empty());
        // Where variances are `scale` times those of the noise.
        let step_of = |scale: f64| -> Result<(Step, Vec<f64>)> {
            let scaled = (scale != 1.0).then(|| (&information / scale, &score / scale));
            let inverse = inverse.as_ref().map(|inverse| inverse * scale);
            let (information, score) = scaled.as_ref().map_or((&information, &score), |(own, score)| (own, score));
            let equations = Equations {
                information,
                score,
                fitted: &at,
                tilts: self.tilts.clone(),
                precision: None,
                floor,
                inverse,
            };
            let step = Step::new(&equations, &priors(&self.groups))?;
            let left_out = step.with_prior_change.slice(s![self.tilts.len()..]);
            let change = concatenate(Axis(0), &[step.change.view(), left_out]).unwrap_or_default();
            Ok((step, found.explained(&change)))
        };
        let (mut step, mut explained_chi2) = step_of(1.0)?;
        // What is left of χ² scales the error bars, and so does that of the mean residual, of which
        // what is common to all images explains as much as of all their residuals.
        let explained: f64 = explained_chi2.iter().sum();
        let mut scale = ((chi2 - explained) / *freedom).max(1.0);
        let left_of_mean = mean_residual_chi2 - explained / freedom * scores.len() as f64;
        if left_of_mean > EXPLAINED.max(scale) {
            scale = left_of_mean;
        }
        if scale > 1.0 + SAME {
            (step, explained_chi2) = step_of(scale)?;
        } else {
            scale = 1.0;
        }
        let mut coefficients_nm = (&at + &step.change).to_vec();
        motions.remove(&mut coefficients_nm);
        let scatter_nm2 = &likelihood.covariance_nm2 - noise_nm2;
        let with_noise = |noise: &Array2<f64>| with_scatter(motions.removed_from(noise), &scatter_nm2);
        let covariance_nm2 = with_noise(&step.noise)? + motions.removed_from(&step.added);
        let modes = CombinedModes { coefficients_nm, covariance_nm2 };
        let alone_nm2 = if self.tilts.is_empty() {
            with_noise(&step.noise)?
        } else {
            let own = information.slice(s![..self.fitted, ..self.fitted]).to_owned() / scale;
            with_noise(&pseudo_inverse(&own, floor)?)?
        };
        let alone = CombinedModes { covariance_nm2: alone_nm2, ..likelihood.clone() };
        let found = WithLeftOut::new((self, motions), &self.groups, &step, modes, 1.0);
        let own = OwnEquations { information, score, scale, pixels };
        Ok((WithLeftOut { explained_chi2, mean_residual_chi2: left_of_mean, ..found }, alone, own))
    }

    /// Change of the PSF by one unit of each unknown that is no mode.
    fn further(&self, model: &Model, linear: &LinearModel) -> Vec<Array1<f64>> {
        let of_amplitudes = self.has_amplitudes.then(|| linear.by_amplitudes() * AMPLITUDE_UNIT);
        let rows = of_amplitudes.iter().flat_map(|columns| columns.outer_iter()).map(|column| column.to_owned());
        rows.chain(self.camera(model, linear)).collect()
    }

    /// Change of the PSF by one unit of each error of the camera.
    fn camera(&self, model: &Model, linear: &LinearModel) -> impl Iterator<Item = Array1<f64>> {
        let native = model.preparation.native_pixels().sqrt();
        let columns = camera::columns(linear.psf(), linear.pixels(), native).into_iter();
        let known = columns.zip(camera::errors(&self.tolerance)).filter(|(_, (_, tolerance))| *tolerance > 0.0);
        known.map(|(column, (_, tolerance))| column * tolerance)
    }

    /// The normal equations of images of one scene at their minima: the fitted modes, then what was
    /// left out.
    ///
    /// # Errors
    /// [`Error::Internal`] where there is none.
    pub(in crate::modal) fn normal_equations(
        &self,
        model: &Model,
        images: &[(&PreparedFrame, &Minimum)],
    ) -> Result<NormalEquations> {
        let square_snr: Vec<f64> = images.iter().map(|(_, minimum)| minimum.chi2.square_snr).collect();
        let (first, kinds) = alike(&square_snr);
        let each = images.par_iter().with_max_len(1).enumerate();
        let each =
            each.map(|(number, (prepared, minimum))| self.of_image(model, prepared, minimum, first.contains(&number)));
        let (scores, shapes): (Vec<_>, Vec<_>) = each.collect::<Result<Vec<_>>>()?.into_iter().unzip();
        let shapes: Vec<Array2<f64>> = shapes.into_iter().flatten().collect();
        if shapes.is_empty() {
            return Err(Error::Internal("there is no image whose left-out modes could be marginalised".into()));
        }
        let freedom = images.iter().map(|(_, minimum)| minimum.chi2.freedom).sum();
        let chi2 = images.iter().map(|(_, minimum)| minimum.chi2.value * minimum.chi2.freedom).sum();
        let pixels = images[0].0.exposure.weight.len();
        Ok(NormalEquations { shapes, kinds, square_snr, images: scores, chi2, freedom, pixels, inverse: None })
    }

    /// Score of an image at its minimum, and its Gauss-Newton matrix over its squared S/N where it
    /// `has_information`.
    fn of_image(
        &self,
        model: &Model,
        prepared: &PreparedFrame,
        minimum: &Minimum,
        has_information: bool,
    ) -> Result<(Array1<f64>, Option<Array2<f64>>)> {
        let (chain, exposure) = (&self.chain, &prepared.exposure);
        let mut at = Array1::<f64>::zeros(self.modes);
        at.slice_mut(s![..minimum.coefficients_nm.len()]).assign(&ArrayView1::from(&minimum.coefficients_nm));
        let mut linear = chain.linearise(at.view()).with_figures(&self.figures).with_light(self.light.clone());
        let (flux_e, background_e) = photometry(exposure, linear.psf());
        let weighted: Array1<f64> = (linear.psf().iter().zip(&exposure.data_e).zip(&exposure.weight))
            .map(|((psf, data), weight)| flux_e * weight * (data - flux_e * psf - background_e))
            .collect();
        let [of_modes, of_amplitudes] = linear.products(weighted.as_slice().unwrap_or_default()).map(Array1::from);
        let mut score = of_modes.to_vec();
        if self.has_amplitudes {
            score.extend(of_amplitudes * AMPLITUDE_UNIT);
        }
        score.extend(self.camera(model, &linear).map(|column| column.dot(&weighted)));
        let score = Array1::from(score);
        let information = has_information.then(|| {
            let weights = (exposure.weight.as_slice(), None);
            let bytes = model.tiles().derivative_bytes;
            let further = self.further(model, &linear);
            let own = Sensitivity::of(&linear, &further, flux_e, weights, exposure.photometry, bytes).fisher;
            own * minimum.chi2.square_snr.recip()
        });
        Ok((score, information))
    }
}

/// Normal equations of the images of a channel at their minima: the fitted modes, then what was
/// left out.
#[derive(Debug, Clone)]
pub(in crate::modal) struct OwnEquations {
    pub(in crate::modal) information: Array2<f64>,
    /// −½ of the gradient.
    pub(in crate::modal) score: Array1<f64>,
    /// Variances over those of the noise.
    pub(in crate::modal) scale: f64,
    /// Pixels of an image.
    pub(in crate::modal) pixels: usize,
}

/// Ratio of the squared S/N of two images up to which one has the Gauss-Newton matrix of the other
/// but for a factor. Of fainter ones read noise weighs the pixels, of brighter ones photon noise:
/// with one matrix for S/N 30 and 300 the error bars were five times too large.
const ALIKE: f64 = 1.5;

/// The first image of each kind of those with these squared S/N, and the kind of each image.
fn alike(square_snr: &[f64]) -> (Vec<usize>, Vec<usize>) {
    let mut first: Vec<usize> = Vec::new();
    let kinds = square_snr.iter().enumerate().map(|(image, own)| {
        let ratio = |&other: &usize| (own / square_snr[other]).max(square_snr[other] / own);
        let nearest = (0..first.len()).min_by(|&a, &b| ratio(&first[a]).total_cmp(&ratio(&first[b])));
        nearest.filter(|&kind| ratio(&first[kind]) <= ALIKE).unwrap_or_else(|| {
            first.push(image);
            first.len() - 1
        })
    });
    let kinds = kinds.collect();
    (first, kinds)
}

/// Normal equations of images of one scene at their minima.
pub(in crate::modal) struct NormalEquations {
    /// Gauss-Newton matrix of an image of each kind, over its squared S/N.
    shapes: Vec<Array2<f64>>,
    /// Kind of each image, and its squared S/N.
    kinds: Vec<usize>,
    square_snr: Vec<f64>,
    /// −½ of the gradient of each image.
    pub(in crate::modal) images: Vec<Array1<f64>>,
    /// χ² of all, and its degrees of freedom.
    chi2: f64,
    freedom: f64,
    /// Pixels of an image.
    pixels: usize,
    /// Pseudo-inverse of the part of the fitted modes, where it is known.
    inverse: Option<Array2<f64>>,
}

impl NormalEquations {
    /// The Fisher matrix of the fitted modes, per nm², and their covariance from the noise, nm².
    ///
    /// # Errors
    /// [`Error::Value`] where no mode changes the images.
    pub(in crate::modal) fn of_modes(&mut self, modes: usize) -> Result<(Array2<f64>, Array2<f64>)> {
        let fisher = self.information().slice(s![..modes, ..modes]).to_owned();
        let inverse = pseudo_inverse(&fisher, null_floor(self.images[0].len(), self.pixels))?;
        self.inverse = Some(inverse.clone());
        Ok((fisher, inverse))
    }

    /// Gauss-Newton matrix of an image.
    pub(in crate::modal) fn information_of(&self, image: usize) -> Array2<f64> {
        &self.shapes[self.kinds[image]] * self.square_snr[image]
    }

    /// Gauss-Newton matrix of all images.
    fn information(&self) -> Array2<f64> {
        let of_kind = |kind: usize| {
            let own = self.kinds.iter().zip(&self.square_snr).filter(|(of, _)| **of == kind);
            own.map(|(_, square_snr)| square_snr).sum::<f64>()
        };
        let mut sum = &self.shapes[0] * of_kind(0);
        (1..self.shapes.len()).for_each(|kind| sum.scaled_add(of_kind(kind), &self.shapes[kind]));
        sum
    }

    /// χ² of each image that a `change` of the unknowns explains.
    fn explained(&self, change: &Array1<f64>) -> Vec<f64> {
        let squares: Vec<f64> = self.shapes.iter().map(|shape| change.dot(&shape.dot(change))).collect();
        let each = self.images.iter().zip(&self.kinds).zip(&self.square_snr);
        each.map(|((score, &kind), square_snr)| 2.0 * change.dot(score) - squares[kind] * square_snr).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn images_of_like_brightness_are_of_a_kind() {
        let (first, kinds) = alike(&[100.0, 120.0, 900.0, 80.0, 700.0, 10.0, 151.0]);
        assert_eq!((first, kinds), (vec![0, 2, 5, 6], vec![0, 0, 1, 0, 1, 2, 3]));
    }

    #[test]
    fn scatter_leaves_no_variance_below_zero() {
        let noise_nm2 = array![[2.0, 0.5], [0.5, 1.0]];
        // Less than the noise of another estimate of it, and by less than this has.
        let small = array![[-0.5, 0.0], [0.0, 3.0]];
        assert_eq!(with_scatter(noise_nm2.clone(), &small).unwrap(), &noise_nm2 + &small);
        let large = array![[-4.0, 0.0], [0.0, 3.0]];
        let found = with_scatter(noise_nm2.clone(), &large).unwrap();
        let expected = &noise_nm2 + &array![[0.0, 0.0], [0.0, 3.0]];
        assert!((&found - &expected).iter().all(|off| off.abs() < 1e-14), "{found}");
        assert_eq!(with_scatter(noise_nm2.clone(), &Array2::zeros((2, 2))).unwrap(), noise_nm2);
    }
}
