//! Gauss-Newton iterations of the optical parameters, each about the images' own minima.

use super::super::fitter::{ModalFitter, same_basis};
use super::super::model::Model;
use super::normal::{NormalEquations, ParameterIteration};
use super::parameter::{self, FittedParameter, starts, telescope, with_numbers};
use crate::control::Control;
use crate::imaging::{Chain, CpuChain, Precision};
use crate::modal::combine::diversity_error::SharedError;
use crate::modal::model::band;
use crate::modal::model::mode_set::{ModeSet, SceneBasis};
use crate::modal::model::model_cache::ModelCache;
use crate::modal::model::recipe::Recipe;
use crate::modal::prepare::cube::Cube;
use crate::modal::solve::minimum::Minimum;
use crate::scene::{Changes, Crop, OpticalParameter, System};
use crate::telescope::Telescope;
use crate::{Error, Result};
use ndarray::{Array1, Array3, ArrayView1, Axis};
use std::sync::{Arc, OnceLock};

/// Most images by which a minimum is sought, and by which it is then found to its error bars:
/// parameters that all images share have smaller ones than the modes of each.
const MAX_IMAGES: [usize; 2] = [6, 48];
/// Most iterations of fits and steps: they reach 12 % of plate scale and six degrees of rotation.
const MAX_ITERATIONS: usize = 12;
/// Converged where the last step is less than this fraction of the error bars.
const TOLERANCE: f64 = 0.1;
/// Converged where the last step is less than this fraction of the derivatives' step: rounding.
const ROUNDING: f64 = 1e-4;
/// Largest step of one iteration, in steps of the derivatives: they hold for about half a pixel at
/// the rim of the spot.
const MAX_STEP: f64 = 10.0;
/// Most times that modes are made again. From the second on a shadow moves by less than a sample.
const MAX_RENEWALS: usize = 3;

/// The search, with what all iterations share.
pub(super) struct ParameterSearch {
    scene: System,
    pub(super) parameters: Vec<FittedParameter>,
    /// Steps of the derivatives.
    steps: Vec<f64>,
    recipe: Recipe,
    native: bool,
    scene_basis: Arc<SceneBasis>,
    /// The modes with the values of the parameters that they were made for, where others have the
    /// same.
    modes: OnceLock<(Vec<f64>, ModeSet)>,
    /// Images that are fitted, evenly from all.
    images_e: Array3<f64>,
    bad: Array3<bool>,
    read_noise_e: Option<f64>,
    control: Control,
}

impl ParameterSearch {
    /// The search for the parameters that `scene` names in images of `cube`, and the scene's values
    /// of them; `native` as in [`ModalFitter::new`].
    ///
    /// # Errors
    /// [`Error::Scene`] for parameters that the scene does not have.
    pub(super) fn new(
        scene: &System,
        recipe: &Recipe,
        cache: &ModelCache,
        cube: Cube,
        native: bool,
        control: &Control,
    ) -> Result<(Self, Vec<f64>)> {
        let numbers = || scene.estimate.fit_optics.iter().flat_map(|optic| optic.parameters());
        let starts = starts(scene, recipe)?;
        let parameters = starts.iter().map(|start| start.parameter).collect();
        let (own, steps): (Vec<f64>, Vec<f64>) = starts.iter().map(|start| (start.value, start.step)).unzip();
        let mut fixed = scene.with(|sections| sections.estimate.fit_optics.clear())?;
        if numbers().any(|number| number.changes == Changes::Wavelengths) && scene.estimate.wavelengths.is_none() {
            // The same number for all widths, so that it does not change between iterations.
            let wavelengths = band::enough_beyond(&fixed)?;
            fixed = fixed.with(|sections| sections.estimate.wavelengths = Some(wavelengths))?;
        }
        let (images_e, bad) = evenly_from(&cube, MAX_IMAGES[0]);
        let search = Self {
            scene: fixed,
            parameters,
            steps,
            recipe: recipe.clone(),
            // Another plate scale would need another reduction.
            native: native || numbers().any(|number| number.changes == Changes::Samples),
            scene_basis: cache.basis.clone(),
            modes: OnceLock::new(),
            images_e,
            bad,
            read_noise_e: cube.read_noise_e,
            control: control.silent(),
        };
        Ok((search, own))
    }

    /// Takes the images of `cube`, which is that of [`ParameterSearch::new`], by which error bars
    /// are found; says whether these are more.
    pub(super) fn take_more(&mut self, cube: &Cube) -> bool {
        let before = self.images_e.len_of(Axis(0));
        (self.images_e, self.bad) = evenly_from(cube, MAX_IMAGES[1]);
        self.images_e.len_of(Axis(0)) > before
    }

    /// `elsewhere` with its iteration where it is farther from `start` than one step and χ² is
    /// lower there, else `start`.
    pub(super) fn better_start(
        &self,
        start: (Vec<f64>, ParameterIteration),
        elsewhere: Vec<f64>,
    ) -> Result<(Vec<f64>, ParameterIteration)> {
        let is_near = |((from, to), step): ((&f64, &f64), &f64)| (to - from).abs() <= MAX_STEP * step;
        if start.0.iter().zip(&elsewhere).zip(&self.steps).all(is_near) {
            return Ok(start);
        }
        match self.iterate(&elsewhere) {
            Ok(first) if first.reduced_chi2 < start.1.reduced_chi2 => Ok((elsewhere, first)),
            Err(error @ Error::Interrupted(_)) => Err(error),
            // The scene may not accept the value, or no fit converges there.
            Ok(_) | Err(_) => Ok(start),
        }
    }

    /// Iterates from `start`, values and their iteration, and returns the fitter with the median
    /// reduced χ². `own` are the scene's values.
    pub(super) fn run(mut self, own: &[f64], start: (Vec<f64>, ParameterIteration)) -> Result<(ModalFitter, f64)> {
        let (values, iteration) = self.minimum(start)?;
        Ok((self.fitter_at(own, &values, &iteration)?, iteration.reduced_chi2))
    }

    /// The values of the minimum that iterations from `start` reach, with the last iteration.
    pub(super) fn minimum(&mut self, start: (Vec<f64>, ParameterIteration)) -> Result<(Vec<f64>, ParameterIteration)> {
        let mut found = self.minimum_of_modes(start)?;
        for _ in 0..MAX_RENEWALS {
            if !self.is_light_elsewhere(&found.0) {
                break;
            }
            self.modes = OnceLock::new();
            let first = self.iterate(&found.0)?;
            found = self.minimum_of_modes((found.0, first))?;
        }
        Ok(found)
    }

    /// Whether the part of the pupil that has light is no longer that of the modes, which are 0
    /// where there was none.
    fn is_light_elsewhere(&self, values: &[f64]) -> bool {
        let Some((made_for, _)) = self.modes.get() else { return false };
        let has_moved = |(number, parameter): (usize, &FittedParameter)| {
            let is_light = matches!(parameter, FittedParameter::Number(_, of) if of.changes == Changes::Light);
            is_light && (values[number] - made_for[number]).abs() > self.steps[number]
        };
        self.parameters.iter().enumerate().any(has_moved)
    }

    /// As [`ParameterSearch::minimum`], with the modes that there are.
    fn minimum_of_modes(&self, start: (Vec<f64>, ParameterIteration)) -> Result<(Vec<f64>, ParameterIteration)> {
        let (mut values, mut iteration) = start;
        for number in 1..=MAX_ITERATIONS {
            let mut step = iteration.step.clone();
            let longest = step.iter().zip(&self.steps).map(|(step, unit)| (step / unit).abs()).fold(0.0, f64::max);
            if longest > MAX_STEP {
                step.iter_mut().for_each(|step| *step *= MAX_STEP / longest);
            }
            let is_small =
                |((step, sigma), unit): ((&f64, &f64), &f64)| step.abs() <= (TOLERANCE * sigma).max(ROUNDING * unit);
            if step.iter().zip(&iteration.sigma).zip(&self.steps).all(is_small) {
                break;
            }
            if number == MAX_ITERATIONS {
                return Err(Error::Image(format!(
                    "estimate.fit_optics did not converge in {MAX_ITERATIONS} iterations ({}): leave it out, or give the scene \
                     values that are nearer",
                    self.describe(&values)
                )));
            }
            // Half a step where a whole one raises χ², or leads to a scene whose model cannot be
            // built.
            let mut refusal = None;
            let better = [1.0, 0.5, 0.25, 0.125].iter().find_map(|share| {
                let next: Vec<f64> = values.iter().zip(&step).map(|(value, step)| value + share * step).collect();
                match self.iterate(&next) {
                    Ok(found) if found.reduced_chi2 > iteration.reduced_chi2 * (1.0 + 1e-3) => None,
                    Ok(found) => Some(Ok((next, found))),
                    Err(error @ Error::Interrupted(_)) => Some(Err(error)),
                    Err(error) => {
                        refusal = Some(error);
                        None
                    }
                }
            });
            match (better, refusal) {
                (Some(better), _) => (values, iteration) = better?,
                (None, Some(refusal)) => return Err(refusal),
                // No step lowers χ²: a minimum up to rounding, or one whose χ² is a misfit.
                (None, None) => break,
            }
        }
        Ok((values, iteration))
    }

    /// The fitter of the scene with `values`, those of `iteration`.
    pub(super) fn fitter_at(&self, own: &[f64], values: &[f64], iteration: &ParameterIteration) -> Result<ModalFitter> {
        let scene = with_numbers(&self.scene, &self.parameters, values)?;
        let mut fitter = self.fitter(&scene, values, self.recipe.clone(), self.modes_of(&scene, values)?)?;
        fitter.shared.push(SharedError { name: "fitted optics", covariance_nm2: iteration.shared_nm2.clone() });
        fitter.fitted_optics = self.fitted(&fitter.model.telescope, own, values, iteration);
        Ok(fitter)
    }

    /// The numbers of the scene and the reflectivities that were fitted; `own` are the scene's
    /// values.
    fn fitted(
        &self,
        telescope: &Telescope,
        own: &[f64],
        values: &[f64],
        last: &ParameterIteration,
    ) -> Vec<OpticalParameter> {
        let mut fitted = Vec::new();
        for (i, parameter) in self.parameters.iter().enumerate() {
            if let FittedParameter::Number(optic, of) = *parameter {
                let parameter = OpticalParameter::of_key(optic, of.key, [own[i], values[i]]);
                fitted.push(parameter.with_error(last.sigma[i], last.identifiable_share[i]));
            }
        }
        let is_amplitude = |parameter: &FittedParameter| matches!(parameter, FittedParameter::Amplitude(_));
        let shares = self.parameters.iter().zip(&last.identifiable_share);
        // Of the last segment, which has no parameter, the least of the others.
        let shares: Vec<f64> =
            shares.filter(|(parameter, _)| is_amplitude(parameter)).map(|(_, share)| *share).collect();
        let least = shares.iter().copied().fold(f64::INFINITY, f64::min);
        let sigmas = parameter::amplitude_sigmas(telescope, &self.parameters, values, &last.covariance);
        for (segment, (amplitude, sigma)) in telescope.amplitudes().iter().zip(sigmas).enumerate() {
            let share = shares.get(segment).copied().unwrap_or(least);
            fitted.push(OpticalParameter::of_segment(segment, amplitude * amplitude, 2.0 * amplitude * sigma, share));
        }
        fitted
    }

    fn describe(&self, values: &[f64]) -> String {
        let each = self.parameters.iter().zip(values).map(|(parameter, value)| match parameter {
            FittedParameter::Number(_, number) => format!("{} = {value}", number.key),
            FittedParameter::Amplitude(segment) => format!("amplitude {segment} = {value:.3}"),
        });
        each.collect::<Vec<_>>().join(", ")
    }

    /// Karhunen-Loève basis of `scene`: another rotation of the pupil needs another basis.
    fn basis_of(&self, scene: &System) -> Arc<SceneBasis> {
        if same_basis(&self.scene, scene) { self.scene_basis.clone() } else { Arc::default() }
    }

    /// Modes of `scene`, which has these values: other places of the segments need others.
    fn modes_of(&self, scene: &System, values: &[f64]) -> Result<ModeSet> {
        let (recipe, scene_basis) = (&self.recipe, self.basis_of(scene));
        let make = || ModeSet::from_scene(scene, scene.modes.segment, recipe, &Telescope::new(scene)?, &scene_basis);
        let is_of_modes =
            |of: &FittedParameter| matches!(of, FittedParameter::Number(_, number) if number.changes == Changes::Modes);
        if self.parameters.iter().any(is_of_modes) {
            return make();
        }
        if let Some((_, modes)) = self.modes.get() {
            return Ok(modes.clone());
        }
        let made = (values.to_vec(), make()?);
        Ok(self.modes.get_or_init(|| made).1.clone())
    }

    /// Fitter of `scene` with these values of the parameters, whose modes are `modes`.
    fn fitter(&self, scene: &System, values: &[f64], recipe: Recipe, modes: ModeSet) -> Result<ModalFitter> {
        let telescope = telescope(scene, &self.parameters, values)?;
        let model = Model::with_modes(scene, &recipe, self.native, telescope, modes)?;
        Ok(ModalFitter { scene_basis: self.basis_of(scene), ..ModalFitter::from_model(scene, recipe, model)? })
    }

    fn cube(&self) -> Cube<'_> {
        Cube { images_e: self.images_e.view(), bad: self.bad.view(), read_noise_e: self.read_noise_e }
    }

    /// Fits the images with these values of the parameters, and computes the next step.
    pub(super) fn iterate(&self, values: &[f64]) -> Result<ParameterIteration> {
        self.control.check("the optical parameters were not fitted yet")?;
        let scene = with_numbers(&self.scene, &self.parameters, values)?;
        // Far from the right parameters restarts do not help.
        let recipe = Recipe { restarts: 0, ..self.recipe.clone() };
        let modes = self.modes_of(&scene, values)?;
        let fitter = self.fitter(&scene, values, recipe, modes.clone())?;
        let mut chain = Chain::cpu(fitter.model.optics.clone(), Precision::F64);
        let fitted = fitter.fit_all(&mut chain, self.cube(), None, None, &self.control)?;
        let perturbed = self.perturbed_models(&scene, &fitter, values, &modes)?;
        let mut equations = NormalEquations::new(self.parameters.len(), fitter.model.optics.modes());
        for (image, minimum) in fitted.prepared.iter().zip(&fitted.minima) {
            if minimum.reason.has_converged() && minimum.reduced_chi2().is_finite() {
                equations.add(&fitter, image, minimum, &self.derivatives(&fitter, &perturbed, values, minimum))?;
            }
        }
        equations.solve(&fitter)
    }

    /// For each parameter, the models one step below and one step above `values`, for the same
    /// modes and pixels.
    fn perturbed_models(
        &self,
        scene: &System,
        fitter: &ModalFitter,
        values: &[f64],
        modes: &ModeSet,
    ) -> Result<Vec<Perturbed>> {
        // Models a step apart may select other pixels and samples by themselves: these are fixed.
        let plan = fitter.model.preparation;
        let samples = fitter.model.optics.sampling().samples;
        let [longest, reduced] = [plan.frame, plan.reduced].map(|side| side[0].max(side[1]));
        let crop = Crop::Pixels((plan.pixels * longest).div_ceil(reduced));
        let model = |number: usize, side: f64| -> Result<CpuChain<f64>> {
            let mut values = values.to_vec();
            values[number] += side * self.steps[number];
            let perturbed = with_numbers(scene, &self.parameters, &values)?;
            let perturbed = perturbed.with(|sections| {
                sections.image.crop_pixels = crop;
                sections.estimate.samples = Some(samples);
            })?;
            let mut telescope = telescope(&perturbed, &self.parameters, &values)?;
            if !self.parameters[number].changes_pupil() {
                telescope = telescope.with_moments_of(&fitter.model.telescope);
            }
            let model = Model::with_modes(&perturbed, &self.recipe, self.native, telescope, modes.clone())?;
            if model.preparation != plan {
                return Err(Error::Internal("models a step apart have other pixels".into()));
            }
            Ok(CpuChain::new(model.optics))
        };
        let pair = |(number, parameter): (usize, &FittedParameter)| match *parameter {
            FittedParameter::Number(..) => {
                let (below, above) = rayon::join(|| model(number, -1.0), || model(number, 1.0));
                Ok(Perturbed::Models(Box::new([below?, above?])))
            }
            FittedParameter::Amplitude(segment) => Ok(Perturbed::Amplitude(segment)),
        };
        self.parameters.iter().enumerate().map(pair).collect()
    }

    /// Derivatives of an image's electrons by the parameters, `[parameter, pixel]`, per unit.
    fn derivatives(
        &self,
        fitter: &ModalFitter,
        perturbed: &[Perturbed],
        values: &[f64],
        minimum: &Minimum,
    ) -> Vec<Array1<f64>> {
        let at = ArrayView1::from(&minimum.coefficients_nm);
        let (chain, segments) = (&fitter.reference, fitter.model.optics.parts().weights.segments);
        let mut scratch = chain.scratch();
        let derivative = |(perturbed, (value, step)): (&Perturbed, (&f64, &f64))| {
            let [below, above] = match perturbed {
                Perturbed::Models(chains) => [0, 1].map(|side| Array1::from(chains[side].psf(at))),
                // The model has the amplitudes `values`: those of the scratch memory are factors.
                Perturbed::Amplitude(segment) => [-1.0, 1.0].map(|side| {
                    let factor = |s: usize| if s == *segment { 1.0 + side * step / value } else { 1.0 };
                    scratch.set_amplitudes((0..segments).map(factor));
                    Array1::from(chain.psf_in(at, &mut scratch).to_vec())
                }),
            };
            (above - below) * (minimum.flux_e / (2.0 * step))
        };
        perturbed.iter().zip(values.iter().zip(&self.steps)).map(derivative).collect()
    }
}

/// Up to `most` images of `cube`, evenly from all, and their bad pixels.
fn evenly_from(cube: &Cube, most: usize) -> (Array3<f64>, Array3<bool>) {
    let count = cube.images_e.len_of(Axis(0));
    let fitted = most.min(count);
    let at: Vec<usize> = (0..fitted).map(|i| (2 * i + 1) * count / (2 * fitted)).collect();
    (cube.images_e.select(Axis(0), &at), cube.bad.select(Axis(0), &at))
}

/// What a step of a parameter changes.
enum Perturbed {
    /// The model: one step below and one step above.
    Models(Box<[CpuChain<f64>; 2]>),
    /// The amplitude of a segment.
    Amplitude(usize),
}
