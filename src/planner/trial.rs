//! Trials: wavefronts of a scene, imaged without noise, and the error with which a model estimates
//! them.

use super::price::Price;
use crate::control::Control;
use crate::imaging::Chain;
use crate::metrics::{MapGram, residual_nm};
use crate::modal::{CombinedModes, Cube, ModalFitter, Recipe, combine_estimates};
use crate::modes::Group;
use crate::scene::{AberrationScene, NcpaBasis, NollRange, SegmentModes, System};
use crate::source::{self, Camera, Truth};
use crate::telescope::Telescope;
use crate::{Error, Result};
use ndarray::{Array2, Array3, ArrayView1, Axis, s};
use rand::SeedableRng;
use rand_chacha::ChaCha12Rng;
use rayon::prelude::*;
use std::time::Instant;

/// Number of wavefronts that are drawn. The largest error of eight represents the scene: of a
/// hundred more, one in nine is worse, for which [`super::search`] leaves a margin.
pub(super) const DRAWS: usize = 8;
/// Stream of the random numbers: another one than that of the scene's own images, so that no image
/// is estimated with a model that was chosen by it.
const STREAM: u64 = 0x70_6c_61_6e;
/// RMS of the pistons and of the NCPA that are drawn where the scene has none, nm: typical of
/// segments and optics that drift after an alignment.
const ASSUMED_NM: [f64; 2] = [60.0, 70.0];
/// Last Noll index of these NCPA.
const ASSUMED_LAST_NOLL: usize = 18;

/// The recipe of a candidate: that of an estimate, with the modes that have a prior. Their prior is
/// not applied, so that a price is an upper bound (by 8 % of the noise of the NCPA of
/// `keck-artificial`) for estimates, and for sessions, which do not fit them. Without restarts: a
/// model that leads to a wrong minimum is not acceptable.
pub(super) fn recipe(scene: &System) -> Recipe {
    Recipe { restarts: 0, ..Recipe::with_prior(scene) }
}

/// The draws of one scene.
pub(super) struct Trials {
    /// Electrons without noise, `[draw, y, x]`.
    frames_e: Array3<f64>,
    bad: Array3<bool>,
    truths: Vec<Truth>,
    /// Electrons of the star, mean over the draws.
    flux_e: f64,
    /// Noise of the phasing and of the NCPA over that of these images alone: below 1 where other
    /// channels are combined with them.
    noise_share: [f64; 2],
}

/// A model on the draws.
pub(super) struct Trial {
    pub(super) price: Price,
    /// Estimate of each draw without noise, `[draw, mode]`, nm; NaN where there is none.
    coefficients_nm: Array2<f64>,
    /// Covariance of the modes from the noise of all images of the scene together, at the first
    /// draw, nm²; `None` where that has no estimate.
    covariance_nm2: Option<Array2<f64>>,
}

impl Trials {
    /// Draws and images wavefronts of `scene`.
    pub(super) fn new(scene: &System, control: &Control) -> Result<Self> {
        let scene = &if scene.aberrations.is_some() { scene.clone() } else { with_assumed_aberrations(scene)? };
        let telescope = Telescope::new(scene)?;
        let camera = Camera::new(scene, &telescope)?;
        let seed = scene.seed();
        let mut rng = ChaCha12Rng::seed_from_u64(seed);
        rng.set_stream(STREAM);
        let truths = (0..DRAWS).map(|_| Truth::draw(scene, &telescope, &mut rng)).collect::<Result<Vec<_>>>()?;
        let psf = |truth: &Truth| -> Result<(Array2<f64>, f64)> {
            control.check("nothing was planned")?;
            let (rows, columns) = scene.image.fitted_shape();
            let psf = camera.psf(truth)?.slice_move(s![..rows, ..columns]);
            let flux_e = source::flux_e(&scene.image, psf.iter().copied().fold(0.0, f64::max));
            Ok((psf * flux_e + scene.image.background_e, flux_e))
        };
        let made = truths.par_iter().map(psf).collect::<Result<Vec<_>>>()?;
        let views: Vec<_> = made.iter().map(|(frame, _)| frame.view()).collect();
        let frames_e =
            ndarray::stack(Axis(0), &views).map_err(|error| Error::Internal(format!("the draws differ: {error}")))?;
        let flux_e = made.iter().map(|(_, flux_e)| flux_e).sum::<f64>() / DRAWS as f64;
        Ok(Self { bad: frames_e.mapv(|_| false), frames_e, truths, flux_e, noise_share: [1.0; 2] })
    }

    /// Sets the noise of the phasing and of the NCPA over that of these images alone.
    pub(super) fn share_noise(&mut self, noise_share: [f64; 2]) {
        self.noise_share = noise_share;
    }

    /// Cost of `fitter` on these wavefronts.
    pub(super) fn price(&self, fitter: &ModalFitter, control: &Control) -> Result<Price> {
        Ok(self.run(fitter, control)?.price)
    }

    /// Estimates these wavefronts by the model of `fitter`.
    pub(super) fn run(&self, fitter: &ModalFitter, control: &Control) -> Result<Trial> {
        control.check("nothing was planned")?;
        let (model, scene) = (fitter.model(), fitter.scene());
        let precision = scene.estimate.precision().into();
        let mut chain = Chain::cpu(model.optics.clone(), precision);
        let cube = Cube { images_e: self.frames_e.view(), bad: self.bad.view(), read_noise_e: None };
        let found = fitter.fit_each(&mut chain, cube, control)?;
        // Once more for the time: the first fit also computes the metrics.
        let began = Instant::now();
        fitter.fit_each(&mut chain, cube, control)?;
        let estimate_us = 1e6 * began.elapsed().as_secs_f64() / DRAWS as f64;
        let misfit = found.reports.iter().map(|report| report.reduced_chi2 / (report.expected_chi2 - 1.0));
        let evaluations = found.reports.iter().map(|report| report.evaluations as f64).sum::<f64>() / DRAWS as f64;
        let covariance_nm2 = self.covariance_nm2(fitter, &found.coefficients_nm)?;
        let own_nm = noise_nm(fitter, covariance_nm2.as_ref())?;
        let price = Price {
            model_nm: self.model_nm(fitter, &found.coefficients_nm)?,
            noise_nm: [0, 1].map(|part| own_nm[part] * self.noise_share[part]),
            misfit: misfit.fold(0.0, f64::max),
            evaluations,
            megaflops: 1e-6 * evaluations * chain.shapes().work(precision, DRAWS).flops,
            estimate_us,
        };
        Ok(Trial { price, coefficients_nm: found.coefficients_nm, covariance_nm2 })
    }

    /// Largest errors of the phasing and of the NCPA of the estimates of the draws, nm; infinite
    /// where there is none.
    fn model_nm(&self, fitter: &ModalFitter, coefficients_nm: &Array2<f64>) -> Result<[f64; 2]> {
        let errors = self
            .truths
            .par_iter()
            .zip(coefficients_nm.axis_iter(Axis(0)).into_par_iter())
            .map(|(truth, coefficients_nm)| errors_nm(fitter, truth, &coefficients_nm.to_vec()))
            .collect::<Result<Vec<_>>>()?;
        let worst = |part: usize| {
            errors
                .iter()
                .map(|error| error[part])
                .fold(0.0, |worst: f64, nm| if nm.is_nan() { nm } else { worst.max(nm) })
        };
        Ok([worst(0), worst(1)].map(|nm| if nm.is_nan() { f64::INFINITY } else { nm }))
    }

    /// See [`Trial::covariance_nm2`].
    fn covariance_nm2(&self, fitter: &ModalFitter, coefficients_nm: &Array2<f64>) -> Result<Option<Array2<f64>>> {
        let (at, image) = (coefficients_nm.row(0), &fitter.scene().image);
        if at.iter().any(|nm| !nm.is_finite()) {
            return Ok(None);
        }
        Ok(Some(fitter.bound(at, self.flux_e, image.background_e)? / image.count as f64))
    }
}

/// Cost of the models of several channels of `scene`, each on its own images of the same
/// wavefronts, combined: work and time are those of all.
pub(super) fn joint_price(scene: &System, channels: &[(&ModalFitter, &Trials)], control: &Control) -> Result<Price> {
    let each = channels.iter().map(|(fitter, trials)| trials.run(fitter, control)).collect::<Result<Vec<_>>>()?;
    let Some((first, trials)) = channels.first() else { return Err(Error::Internal("there is no channel".into())) };
    let covariances: Option<Vec<&Array2<f64>>> = each.iter().map(|trial| trial.covariance_nm2.as_ref()).collect();
    let mut coefficients_nm = Array2::from_elem((DRAWS, first.model().optics.modes()), f64::NAN);
    let mut covariance_nm2 = None;
    for (draw, mut row) in coefficients_nm.outer_iter_mut().enumerate() {
        let is_fitted = |trial: &Trial| trial.coefficients_nm.row(draw).iter().all(|nm| nm.is_finite());
        let Some(covariances) = covariances.as_ref().filter(|_| each.iter().all(is_fitted)) else { continue };
        let estimates = channels.iter().zip(&each).zip(covariances).map(|(((fitter, _), trial), covariance_nm2)| {
            let coefficients_nm = trial.coefficients_nm.row(draw).to_vec();
            (*fitter, CombinedModes { coefficients_nm, covariance_nm2: (*covariance_nm2).clone() })
        });
        let joint = combine_estimates(scene, &estimates.collect::<Vec<_>>())?;
        row.assign(&ArrayView1::from(&joint.coefficients_nm));
        covariance_nm2.get_or_insert(joint.covariance_nm2);
    }
    let sum = |value: fn(&Price) -> f64| each.iter().map(|trial| value(&trial.price)).sum::<f64>();
    Ok(Price {
        model_nm: trials.model_nm(first, &coefficients_nm)?,
        noise_nm: noise_nm(first, covariance_nm2.as_ref())?,
        misfit: each.iter().map(|trial| trial.price.misfit).fold(0.0, f64::max),
        evaluations: sum(|price| price.evaluations),
        megaflops: sum(|price| price.megaflops),
        estimate_us: sum(|price| price.estimate_us),
    })
}

/// Expected errors of the phasing and of the NCPA from a covariance of the modes, nm; infinite
/// without one.
fn noise_nm(fitter: &ModalFitter, covariance_nm2: Option<&Array2<f64>>) -> Result<[f64; 2]> {
    let model = fitter.model();
    let Some(covariance_nm2) = covariance_nm2 else { return Ok([f64::INFINITY; 2]) };
    let (n, pupil) = (model.segment_modes, &model.telescope.pupil);
    let gram = MapGram::of_basis(pupil, &model.basis)?;
    let rms_nm = |part: std::ops::Range<usize>| {
        gram.expected_rms_of_nm(part.clone(), covariance_nm2.slice(s![part.clone(), part]))
    };
    Ok([rms_nm(0..n)?, rms_nm(n..covariance_nm2.nrows())?])
}

/// `scene` with aberrations that its own modes span: nothing is known of others.
fn with_assumed_aberrations(scene: &System) -> Result<System> {
    let exact = match recipe(scene).exact_zernikes {
        NollRange::Span { first, last } => first..=last,
        NollRange::None => 0..=0,
    };
    let is_spanned = |noll: &usize| match scene.modes.ncpa {
        NcpaBasis::Kl => true,
        NcpaBasis::Zernike => *noll <= scene.modes.ncpa_count + 1 || exact.contains(noll),
        NcpaBasis::None | NcpaBasis::File(_) => exact.contains(noll),
    };
    let last = (4..=ASSUMED_LAST_NOLL).take_while(is_spanned).last();
    let [piston_nm, ncpa_nm] = ASSUMED_NM;
    let mut aberrations = scene.aberrations.clone().map_or_else(AberrationScene::flat, Ok)?;
    aberrations.segment_piston_rms_nm = if scene.modes.segment == SegmentModes::None { 0.0 } else { piston_nm };
    if let Some(last) = last {
        (aberrations.ncpa_rms_nm, aberrations.ncpa_zernikes) = (ncpa_nm, NollRange::Span { first: 4, last });
    }
    scene.with(|sections| sections.aberrations = Some(aberrations.clone()))
}

/// Residual RMS of phasing and NCPA, nm; NaN for an image that was not fitted.
fn errors_nm(fitter: &ModalFitter, truth: &Truth, coefficients_nm: &[f64]) -> Result<[f64; 2]> {
    if coefficients_nm.iter().any(|nm| !nm.is_finite()) {
        return Ok([f64::NAN; 2]);
    }
    let model = fitter.model();
    let pupil = &model.telescope.pupil;
    let [phasing_nm, ncpa_nm] = truth.maps_on(pupil)?;
    let residual =
        |group, truth: &Array2<f64>| residual_nm(pupil, model.map_nm(coefficients_nm, group).view(), truth.view());
    Ok([residual(Group::Segment, &phasing_nm)?, residual(Group::Ncpa, &ncpa_nm)?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;

    #[test]
    fn assumed_aberrations_are_spanned_by_the_modes_of_an_estimate() {
        let preset = Scene::preset("keck-artificial").unwrap();
        let none = ("aberrations.ncpa_rms_nm", "0");
        let last_of = |modes: &[(&str, &str)]| {
            let scene = preset.with(&[&[none, ("modes.ncpa_count", "")], modes].concat()).unwrap();
            let assumed = with_assumed_aberrations(&scene).unwrap().aberrations.clone().unwrap();
            match assumed.ncpa_zernikes {
                NollRange::Span { first: 4, last } if assumed.ncpa_rms_nm > 0.0 => Some(last),
                _ => None,
            }
        };
        let five = [("modes.ncpa", "zernike"), ("modes.ncpa_count", "5")];
        let nothing = ("modes.ncpa", "none");
        assert_eq!(last_of(&[]), Some(18));
        // Where the scene leaves them open, Zernikes to Noll 21 are estimated beside any basis.
        assert_eq!(last_of(&five), Some(18));
        assert_eq!(last_of(&[five[0], five[1], ("modes.exact_zernikes", "[]")]), Some(6));
        assert_eq!(last_of(&[five[0], five[1], ("modes.exact_zernikes", "[10, 21]")]), Some(6));
        assert_eq!(last_of(&[("modes.ncpa", ""), ("modes.file", "modes.fits")]), Some(18));
        assert_eq!(last_of(&[nothing]), None);
        assert_eq!(last_of(&[nothing, ("modes.exact_zernikes", "[2, 11]")]), Some(11));
    }
}
