//! Normal equations of images at their minima, by the fitted modes and by what was left out.

use crate::imaging::LinearModel;
use crate::modal::assess::fisher::{Sensitivity, null_floor};
use crate::modal::assess::residual::photometry;
use crate::modal::combine::combined_modes::CombinedModes;
use crate::modal::combine::global_motions::GlobalMotions;
use crate::modal::left_out::{AMPLITUDE_UNIT, Equations, ILLUMINATIONS, LeftOut, Step, WithLeftOut, camera, priors};
use crate::modal::model::Model;
use crate::modal::prepare::PreparedFrame;
use crate::modal::solve::minimum::Minimum;
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1, Axis, concatenate, s};
use rayon::prelude::*;

impl LeftOut {
    /// The modes of images of one wavefront, whose fits ended in `minima`, with what was left out:
    /// `likelihood` is their combination, and `noise_nm2` the part of its covariance that follows
    /// from the images' noise.
    ///
    /// # Errors
    /// [`Error::Internal`] for values that are not finite.
    pub(in crate::modal) fn marginalised(
        &self,
        (model, motions): (&Model, &GlobalMotions),
        images: &[(&PreparedFrame, &Minimum)],
        likelihood: &CombinedModes,
        noise_nm2: &Array2<f64>,
    ) -> Result<WithLeftOut> {
        let NormalEquations { information, images: scores, chi2, freedom } = self.normal_equations(model, images)?;
        let square_snr: f64 = images.iter().map(|(_, minimum)| minimum.chi2.square_snr).sum();
        let mut score = scores.iter().fold(Array1::zeros(information.nrows()), |sum, own| sum + own);
        // Each image is in its own minimum.
        let free = (0..self.fitted).filter(|mode| !self.tilts.contains(mode));
        free.for_each(|mode| score[mode] = 0.0);
        let equations = Equations {
            information: &(information * square_snr),
            score: &score,
            fitted: &Array1::from(likelihood.coefficients_nm.clone()),
            tilts: self.tilts.clone(),
            precision: None,
            floor: null_floor(score.len(), images.first().map_or(1, |(first, _)| first.exposure.weight.len())),
        };
        let step = Step::new(&equations, &priors(&self.groups))?;
        let change = &step.with_prior_change;
        let own_change = change.dot(&step.left.dot(change)) / square_snr;
        let with_prior = |score: &Array1<f64>| {
            let ends = [s![self.tilts.clone()], s![self.fitted..]].map(|part| score.slice(part));
            concatenate(Axis(0), &ends).unwrap_or_default()
        };
        let explained = |(score, (_, minimum)): (&Array1<f64>, &(&PreparedFrame, &Minimum))| {
            2.0 * change.dot(&with_prior(score)) - own_change * minimum.chi2.square_snr
        };
        let explained_chi2: Vec<f64> = scores.iter().zip(images).map(explained).collect();
        // What is left of χ² scales the error bars.
        let scale = ((chi2 - explained_chi2.iter().sum::<f64>()) / freedom).max(1.0);
        let mut coefficients_nm = (equations.fitted + &step.change).to_vec();
        motions.remove(&mut coefficients_nm);
        let added_nm2 = motions.removed_from(&step.added) * scale;
        let noise_alone_nm2 = motions.removed_from(&step.noise) * scale;
        let covariance_nm2 = &likelihood.covariance_nm2 - noise_nm2 + noise_alone_nm2 + &added_nm2;
        let modes = CombinedModes { coefficients_nm, covariance_nm2 };
        let found = WithLeftOut::new(model, &self.groups, &step.found, scale, (modes, added_nm2));
        Ok(WithLeftOut { explained_chi2, ..found })
    }

    /// Change of the PSF by one unit of each unknown that is no mode.
    fn further(&self, model: &Model, linear: &LinearModel) -> Vec<Array1<f64>> {
        let mut columns = Vec::new();
        if let Some(patterns) = &self.illumination {
            let amplitudes = linear.by_amplitudes();
            columns.extend(amplitudes.outer_iter().map(|column| column.to_owned() * AMPLITUDE_UNIT));
            let illumination = patterns.dot(&amplitudes);
            let slopes = illumination.outer_iter().map(|column| column.to_owned());
            columns.extend(in_tolerances(slopes.zip([self.tolerance.illumination_fraction; ILLUMINATIONS.len()])));
        }
        let native = model.preparation.native_pixels().sqrt();
        let camera = camera::columns(linear.psf(), linear.pixels(), native).into_iter();
        columns.extend(in_tolerances(camera.zip(camera::errors(&self.tolerance).map(|(_, tolerance)| tolerance))));
        columns
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
        let each = images.par_iter().with_max_len(1).enumerate();
        // The Gauss-Newton matrix of the first image, as much as all images say.
        let each = each.map(|(number, (prepared, minimum))| self.of_image(model, prepared, minimum, number == 0));
        let (images_score, information): (Vec<_>, Vec<_>) = each.collect::<Result<Vec<_>>>()?.into_iter().unzip();
        let Some(information) = information.into_iter().flatten().next() else {
            return Err(Error::Internal("there is no image whose left-out modes could be marginalised".into()));
        };
        let freedom = images.iter().map(|(_, minimum)| minimum.chi2.freedom).sum();
        let chi2 = images.iter().map(|(_, minimum)| minimum.chi2.value * minimum.chi2.freedom).sum();
        Ok(NormalEquations { information, images: images_score, chi2, freedom })
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
        let (mut loaded, mut scratch, mut evaluation) = (chain.empty_image(), chain.scratch(), chain.evaluation());
        let mut at = Array1::<f64>::zeros(self.modes);
        at.slice_mut(s![..minimum.coefficients_nm.len()]).assign(&ArrayView1::from(&minimum.coefficients_nm));
        chain.set(&mut loaded, exposure)?;
        chain.evaluate_one(&loaded, at.view(), &mut scratch, &mut evaluation);
        let linear = chain.linearise(at.view());
        let further = self.further(model, &linear);
        let (flux_e, background_e) = photometry(exposure, linear.psf());
        let weighted: Array1<f64> = (linear.psf().iter().zip(&exposure.data_e).zip(&exposure.weight))
            .map(|((psf, data), weight)| weight * (data - flux_e * psf - background_e))
            .collect();
        let of_modes = evaluation.gradient.iter().map(|slope| -0.5 * slope);
        let score = of_modes.chain(further.iter().map(|column| flux_e * column.dot(&weighted))).collect();
        let information = has_information.then(|| {
            let weights = (exposure.weight.as_slice(), None);
            let bytes = model.tiles().derivative_bytes;
            let own = Sensitivity::of(&linear, &further, flux_e, weights, exposure.photometry, bytes).fisher;
            (&own + &own.t()) * (0.5 / minimum.chi2.square_snr)
        });
        Ok((score, information))
    }
}

/// Columns in units of their tolerances; those that are exact are none.
fn in_tolerances(columns: impl Iterator<Item = (Array1<f64>, f64)>) -> impl Iterator<Item = Array1<f64>> {
    columns.filter(|(_, tolerance)| *tolerance > 0.0).map(|(column, tolerance)| column * tolerance)
}

/// Normal equations of images of one scene at their minima.
pub(in crate::modal) struct NormalEquations {
    /// Gauss-Newton matrix of an image over its squared S/N.
    pub(in crate::modal) information: Array2<f64>,
    /// −½ of the gradient of each image.
    pub(in crate::modal) images: Vec<Array1<f64>>,
    /// χ² of all, and its degrees of freedom.
    pub(in crate::modal) chi2: f64,
    pub(in crate::modal) freedom: f64,
}
