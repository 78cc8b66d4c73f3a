//! Numbers of the scene that are fitted beside the modes: the plate scale, the rotation of the pupil, the amplitude of the
//! defocus, the width of the filter.
//!
//! Each image has modes a of its own; the optics θ are those of all. With J the derivatives of an image's electrons, cleared
//! of what its flux and background absorb, W its weights and r its residual, Gauss-Newton about the images' own minima
//! (where Jₐᵀ W r = 0) eliminates a:
//!
//! ```text
//! c = Jₐᵀ W Jθ      F = Jₐᵀ W Jₐ      S = Σ (Jθᵀ W Jθ − cᵀ F⁻¹ c)      δθ = S⁻¹ Σ Jθᵀ W r
//! ```
//!
//! cov θ = χ² S⁻¹, and with G the mean of F⁻¹ c an error δθ moves the mean modes by −G δθ: G cov θ Gᵀ is the covariance that
//! all images share. The share of Jθᵀ W Jθ that is left in S says how well the optics can be told from the modes: where next
//! to nothing is left, the modes hold them, and the scene's number stays.

mod normal;

use super::band;
use super::cube::Cube;
use super::diversity_error::SharedError;
use super::fitted_optic::{FittedOptic, key};
use super::fitter::{ModalFitter, same_basis};
use super::minimum::Minimum;
use super::mode_set::OwnBasis;
use super::model::Model;
use super::recipe::Recipe;
use crate::imaging::{Chain, CpuChain, Precision};
use crate::optimize::CancelFlag;
use crate::scene::{Optic, Scene};
use crate::{Error, Result};
use ndarray::{Array1, ArrayView1, Axis};
use normal::{Round, Sum};
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// Images that are asked: optics that all share are known better than what each has of its own.
const ASKED: usize = 6;
/// Most rounds of fits and steps: 12 % of plate scale and six degrees away a scene is another one.
const ROUNDS: usize = 12;
/// Step of a filter's width.
const WIDTH_STEP: f64 = 1e-3;
/// The last step moved the optics by less than this fraction of their error bars.
const SETTLED: f64 = 0.1;
/// Steps of the derivatives to which a rounding moves the optics: they are not sought beyond.
const ROUNDING: f64 = 1e-4;
/// Steps of the derivatives that one round goes at most: the derivatives hold for a pixel at the rim of the spot.
const REACH: f64 = 10.0;

/// What `scene` says of an optic, and the step for its derivative: a twentieth of a pixel at the rim of a spot, about.
///
/// # Errors
/// [`Error::Scene`] where the scene has no such number.
fn number(scene: &Scene, optic: Optic) -> Result<(f64, f64)> {
    let missing = |what: &str| {
        Err(Error::Scene(format!(
            "estimate.fit_optics names \"{}\", which {what} does not have; leave it out",
            optic.word()
        )))
    };
    match optic {
        Optic::PlateScale => {
            let sampling = scene.image.samples_per_lambda_over_d;
            Ok((sampling, 1e-3 * sampling))
        }
        Optic::Rotation if scene.pupil.extent_m().is_none() => missing("a pupil from a file"),
        Optic::Rotation => Ok((scene.pupil.rotation_deg, 0.05)),
        Optic::Defocus if scene.image.diversity_file.is_some() => missing("a diversity from a file"),
        Optic::Defocus => Ok((scene.image.diversity_focus_waves_rms, 5e-3)),
        // An image does not know a width from its negative: it says nothing of how to leave 0.
        Optic::Bandwidth if scene.image.bandwidth_fraction == 0.0 => missing("light of one wavelength"),
        Optic::Bandwidth => Ok((scene.image.bandwidth_fraction, WIDTH_STEP.min(0.5 * scene.image.bandwidth_fraction))),
    }
}

/// `scene` with these optics.
fn with(scene: &Scene, optics: &[Optic], values: &[f64]) -> Result<Scene> {
    let texts: Vec<String> = values.iter().map(f64::to_string).collect();
    let settings: Vec<(&str, &str)> =
        optics.iter().zip(&texts).map(|(&optic, text)| (key(optic), text.as_str())).collect();
    scene.with(&settings)
}

/// The estimator of `scene` with the optics that `cube` shows; `native` as in [`ModalFitter::new`].
///
/// # Errors
/// Those of [`ModalFitter::new`] and of fits; [`Error::Scene`] for optics that the scene does not have;
/// [`Error::Interrupted`].
pub(super) fn estimator(
    scene: &Scene,
    recipe: &Recipe,
    cube: Cube,
    native: bool,
    cancel: Option<&CancelFlag>,
) -> Result<ModalFitter> {
    let optics = scene.estimate.fit_optics.clone();
    let numbers: Vec<(f64, f64)> = optics.iter().map(|&optic| number(scene, optic)).collect::<Result<_>>()?;
    let (own, steps): (Vec<f64>, Vec<f64>) = numbers.into_iter().unzip();
    let mut fixed = scene.with(&[("estimate.fit_optics", "[]")])?;
    if optics.contains(&Optic::Bandwidth) && scene.estimate.wavelengths.is_none() {
        // As many for all widths: their number must not change from one to the next.
        fixed = fixed.with(&[("estimate.wavelengths", &band::enough_beyond(&fixed)?.to_string())])?;
    }
    let recipe = recipe.clone();
    // Another plate scale would be another reduction.
    let native = native || optics.contains(&Optic::PlateScale);
    let count = cube.images_e.len_of(Axis(0));
    let asked = ASKED.min(count);
    let at: Vec<usize> = (0..asked).map(|i| (2 * i + 1) * count / (2 * asked)).collect();
    let (images_e, bad) = (cube.images_e.select(Axis(0), &at), cube.bad.select(Axis(0), &at));
    let cube = Cube { images_e: images_e.view(), bad: bad.view(), read_noise_e: cube.read_noise_e };
    let search = Search { scene: fixed, optics, steps, recipe, native, own_basis: Arc::default(), cube, cancel };
    search.run(own)
}

/// What all rounds share.
struct Search<'a> {
    scene: Scene,
    optics: Vec<Optic>,
    /// For the derivatives.
    steps: Vec<f64>,
    recipe: Recipe,
    native: bool,
    own_basis: Arc<OwnBasis>,
    cube: Cube<'a>,
    cancel: Option<&'a CancelFlag>,
}

impl Search<'_> {
    fn run(&self, own: Vec<f64>) -> Result<ModalFitter> {
        let (mut values, mut round) = (own.clone(), self.round(&own)?);
        for number in 1..=ROUNDS {
            let mut step = round.step.clone();
            let longest = step.iter().zip(&self.steps).map(|(step, unit)| (step / unit).abs()).fold(0.0, f64::max);
            if longest > REACH {
                step.iter_mut().for_each(|step| *step *= REACH / longest);
            }
            let settled =
                |((step, sigma), unit): ((&f64, &f64), &f64)| step.abs() <= (SETTLED * sigma).max(ROUNDING * unit);
            if step.iter().zip(&round.sigma).zip(&self.steps).all(settled) {
                break;
            }
            if number == ROUNDS {
                return Err(Error::Image(format!(
                    "after {ROUNDS} rounds estimate.fit_optics is not done ({}): leave it out, or give the scene numbers \
                     that are nearer",
                    self.in_words(&values)
                )));
            }
            // Half a step, where a whole one makes it worse or leads where no model can be made.
            let mut refusal = None;
            let better = [1.0, 0.5, 0.25, 0.125].iter().find_map(|share| {
                let next: Vec<f64> = values.iter().zip(&step).map(|(value, step)| value + share * step).collect();
                match self.round(&next) {
                    Ok(found) if found.reduced_chi2 > round.reduced_chi2 * (1.0 + 1e-3) => None,
                    Ok(found) => Some(Ok((next, found))),
                    Err(error @ Error::Interrupted(_)) => Some(Err(error)),
                    Err(error) => {
                        refusal = Some(error);
                        None
                    }
                }
            });
            match (better, refusal) {
                (Some(better), _) => (values, round) = better?,
                (None, Some(refusal)) => return Err(refusal),
                // A minimum as good as rounding tells, or one that χ² calls a misfit.
                (None, None) => break,
            }
        }
        let scene = with(&self.scene, &self.optics, &values)?;
        let mut estimator =
            ModalFitter::with_own_basis(&scene, self.recipe.clone(), self.native, self.own_basis(&scene))?;
        estimator.shared.push(SharedError { name: "fitted optics", covariance_nm2: round.common_nm2.clone() });
        let each = self.optics.iter().zip(own).zip(values).zip(round.sigma.iter().zip(&round.told));
        estimator.fitted_optics = each
            .map(|(((&optic, scene), value), (&sigma, &told))| FittedOptic { optic, scene, value, sigma, told })
            .collect();
        Ok(estimator)
    }

    fn in_words(&self, values: &[f64]) -> String {
        let each = self.optics.iter().zip(values).map(|(&optic, value)| format!("{} = {value}", key(optic)));
        each.collect::<Vec<_>>().join(", ")
    }

    /// The Karhunen-Loève basis that belongs to `scene`: a pupil that has turned has its own.
    fn own_basis(&self, scene: &Scene) -> Arc<OwnBasis> {
        if same_basis(&self.scene, scene) { self.own_basis.clone() } else { Arc::default() }
    }

    fn round(&self, values: &[f64]) -> Result<Round> {
        if self.cancel.is_some_and(|flag| flag.load(Ordering::Relaxed)) {
            return Err(Error::Interrupted("the optics were not found yet".into()));
        }
        let scene = with(&self.scene, &self.optics, values)?;
        // Far from the right optics no start is better than another.
        let recipe = Recipe { restarts: 0, ..self.recipe.clone() };
        let own_basis = self.own_basis(&scene);
        let estimator = ModalFitter::with_own_basis(&scene, recipe, self.native, own_basis.clone())?;
        let mut chain = Chain::cpu(estimator.model.optics.clone(), Precision::F64);
        let fitted = estimator.fitted(&mut chain, self.cube, self.cancel, &mut |_, _| {})?;
        let beside = self.beside(&scene, &estimator, values, &own_basis)?;
        let mut sum = Sum::of(self.optics.len(), estimator.model.optics.modes());
        for (image, minimum) in fitted.prepared.iter().zip(&fitted.minima) {
            if minimum.reason.has_converged() && minimum.reduced_chi2.is_finite() {
                sum.add(&estimator, image, minimum, &self.electrons(&beside, minimum))?;
            }
        }
        sum.solved(&estimator)
    }

    /// For each optic, the models a step below and a step above `values`, of the same modes on the same pixels.
    fn beside(
        &self,
        scene: &Scene,
        estimator: &ModalFitter,
        values: &[f64],
        own_basis: &OwnBasis,
    ) -> Result<Vec<[CpuChain<f64>; 2]>> {
        // So near to each other they may differ in the pixels that are worth fitting all the same.
        let plan = estimator.model.preparation;
        let [longest, reduced] = [plan.frame, plan.reduced].map(|side| side[0].max(side[1]));
        let crop = (plan.pixels * longest).div_ceil(reduced).to_string();
        let model = |optic: usize, side: f64| -> Result<CpuChain<f64>> {
            let mut values = values.to_vec();
            values[optic] += side * self.steps[optic];
            let beside = with(scene, &self.optics, &values)?.with(&[("image.crop_pixels", &crop)])?;
            let model = Model::beside(scene, &beside, &self.recipe, self.native, own_basis)?;
            if model.preparation != plan {
                return Err(Error::Internal("models a step apart have other pixels".into()));
            }
            Ok(CpuChain::new(model.optics))
        };
        (0..values.len()).map(|optic| Ok([model(optic, -1.0)?, model(optic, 1.0)?])).collect()
    }

    /// Derivatives of an image's electrons by the optics, `[optic, pixel]`, per unit.
    fn electrons(&self, beside: &[[CpuChain<f64>; 2]], minimum: &Minimum) -> Vec<Array1<f64>> {
        let at = ArrayView1::from(&minimum.coefficients_nm);
        let derivative = |([below, above], step): (&[CpuChain<f64>; 2], &f64)| {
            let change = Array1::from(above.psf(at)) - Array1::from(below.psf(at));
            change * (minimum.flux_e / (2.0 * step))
        };
        beside.iter().zip(&self.steps).map(derivative).collect()
    }
}
