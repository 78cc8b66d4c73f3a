//! Model selection: modes, reflectivities and shadows that the scene does not name, where what it
//! names does not explain the images.
//!
//! An image decides between models by the Bayesian information criterion (BIC, Schwarz's
//! criterion): with N pixels of known noise and k parameters, −2 ln of the probability of the image
//! given the model is χ² + k ln N up to terms that do not grow with N, because the image narrows
//! each parameter by a factor that goes with 1/√N (Laplace's approximation; Schwarz, Annals of
//! Statistics 6, 1978). Where the best model has a reduced χ² above 1 no model is exact, and all χ²
//! are divided by it.
//!
//! Only an image that the scene's model does not explain is tried, so that others pay nothing. An
//! extension is adopted where it leaves almost nothing of the residual: the wrong modes do not.

use super::lost_light::{self, LostLight};
use super::policy::Policy;
use crate::control::Control;
use crate::modal::{ModalEstimate, ModalFitter, Status};
use crate::scene::{ModelChoice, NcpaBasis, NollRange, Optic, Optimizer, Scene, Sections, SegmentModes};
use crate::{Error, Result};

/// Largest part of χ² beyond 1 that an adopted extension may leave. The right one leaves 0.1 % or
/// less (segment tilts of 30 nm, white NCPA to Noll 200, reflectivities of 5 %, a spider of 2.5 cm,
/// an obscuration of 2.5 m; Keck, peak S/N of 500). Of a plate scale 1 % off, a filter of 5 %,
/// square pixels, reflectivities or a spider tilts leave 97 % or more and Zernikes 96 % or more.
const MOST_LEFT: f64 = 0.1;
/// Part of χ² beyond 1 that an extension must remove for a larger one of the same kind, or one of
/// the other kind beside it, to be tried: of NCPA to Noll 200 the Zernikes to 91 remove 57 %.
const WORTH_EXTENDING: f64 = 0.3;
/// Last Noll indices of Zernikes that are added, in turn: radial orders 12 and 19, where three or
/// four periods cross a segment of Keck.
const LAST_NOLL: [usize; 2] = [91, 210];
/// Samples of the model with those Zernikes relative to those of the scene's pupil: with 120
/// samples of Keck white NCPA of these orders leave a reduced χ² of 1.35 and 2.2 (peak S/N of 500),
/// with these 0.99 and 1.02.
const FINER: [f64; 2] = [4.0 / 3.0, 5.0 / 3.0];

/// Samples that are tried before anything else, relative to those of the model: 120 on GTC
/// leave a reduced χ² of 1.06 to 1.18 at a peak S/N of 500, 144 leave 1.025, 200 leave 1.015.
const MORE_SAMPLES: f64 = 5.0 / 3.0;

/// Width of a spider's vanes, m, and diameter of an obscuration relative to the pupil, from which
/// their fits start: 2 to 10 cm, and 1.65 to 2.5 m on Keck, are reached. [`lost_light`] finds about
/// where larger ones are.
const SPIDER_M: f64 = 0.01;
const OBSCURATION: f64 = 0.16;

/// Reduced χ² from which segments without light and shadows are looked for, with up to a hundred
/// fits of a coarse model: two of 36 segments leave 2,200, a stop that hides 5 % of the light 1,300
/// (Keck, peak S/N of 500).
const SHADED: f64 = 100.0;

/// What is added to the model of a scene.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Extension {
    /// More samples of the pupil than those of the model.
    Samples(usize),
    /// Tip and tilt of each segment.
    SegmentTilts,
    /// All Zernikes to a Noll index.
    ZernikesTo {
        /// The index.
        last: usize,
        /// Samples of the model without them: it has no fewer with them.
        own_samples: usize,
    },
    /// An optical parameter that is fitted: the reflectivities, a spider or an obscuration.
    Fitted(Optic),
    /// Segments without light, or a shadow, which is fitted.
    LostLight(LostLight),
}

/// Optical parameters that are tried. Others that may be wrong are the instrument's, and for the
/// user to change.
const FITTED: [Optic; 3] = [Optic::REFLECTIVITIES, Optic::SPIDERS, Optic::OBSCURATION];

/// An even number of samples, about `factor` times `samples`.
fn more_samples(samples: usize, factor: f64) -> usize {
    2 * (0.5 * factor * samples as f64).round() as usize
}

impl Extension {
    /// Adds this extension.
    pub(super) fn add_to(&self, sections: &mut Sections) {
        let extent_m = sections.pupil.extent_m();
        match *self {
            Self::Samples(own_samples) => {
                sections.estimate.samples = Some(more_samples(own_samples, MORE_SAMPLES));
            }
            Self::SegmentTilts => sections.modes.segment = SegmentModes::PistonTipTilt,
            Self::ZernikesTo { last, own_samples } => {
                let finer = FINER[usize::from(last > LAST_NOLL[0])];
                // Only a pupil that is known on a finer grid can have more samples.
                if extent_m.is_some() && sections.estimate.samples.is_none() {
                    sections.estimate.samples = Some(more_samples(sections.pupil.samples, finer).max(own_samples));
                }
                sections.modes.exact_zernikes = Some(NollRange::Span { first: 2, last });
            }
            Self::Fitted(optic) => match (optic, extent_m) {
                (Optic::SPIDERS, _) => sections.pupil.spider_width_m = SPIDER_M,
                (Optic::OBSCURATION, Some(extent_m)) => {
                    sections.pupil.central_obscuration_m = OBSCURATION * extent_m;
                }
                _ => {}
            },
            Self::LostLight(ref lost) => lost.take_from(&mut sections.pupil),
        }
        sections.estimate.fit_optics.extend(self.optic());
    }

    /// The optical parameter that is fitted with this.
    fn optic(&self) -> Option<Optic> {
        match *self {
            Self::Fitted(optic) => Some(optic),
            Self::LostLight(LostLight::Stop(_)) => Some(Optic::STOP),
            Self::LostLight(LostLight::Obscuration(_)) => Some(Optic::OBSCURATION),
            Self::LostLight(LostLight::Spider(_)) => Some(Optic::SPIDERS),
            Self::Samples(_) | Self::SegmentTilts | Self::ZernikesTo { .. } | Self::LostLight(LostLight::Dark(_)) => {
                None
            }
        }
    }

    fn name(&self) -> String {
        match *self {
            Self::Samples(_) => "more samples of the pupil (estimate.samples)".into(),
            Self::SegmentTilts => "tip and tilt of each segment".into(),
            Self::ZernikesTo { last, .. } => format!("Zernikes to Noll {last}"),
            Self::Fitted(Optic::OBSCURATION) | Self::LostLight(LostLight::Obscuration(_)) => {
                "a central obscuration".into()
            }
            Self::Fitted(Optic::SPIDERS) | Self::LostLight(LostLight::Spider(_)) => "a spider".into(),
            Self::Fitted(optic) => optic.word().into(),
            Self::LostLight(LostLight::Dark(ref segments)) => {
                format!("segments without light (pupil.dark_segments = {segments:?})")
            }
            Self::LostLight(LostLight::Stop(_)) => {
                "a stop of the camera (pupil.stop_diameter_m, stop_x_m and stop_y_m)".into()
            }
        }
    }

    /// Whether `scene` has this, or cannot have it.
    fn is_in(&self, scene: &Scene) -> bool {
        let has_geometry = scene.pupil.extent_m().is_some();
        match *self {
            Self::Samples(_) => !has_geometry || scene.estimate.samples.is_some(),
            Self::SegmentTilts => scene.modes.segment != SegmentModes::Piston || scene.image.is_pupil_turned(),
            Self::ZernikesTo { last: wanted, .. } => {
                matches!(scene.modes.exact_zernikes, Some(NollRange::Span { last, .. }) if last >= wanted)
            }
            Self::Fitted(Optic::SPIDERS) | Self::LostLight(LostLight::Spider(_)) => {
                !has_geometry || scene.pupil.spider_width_m > 0.0
            }
            Self::Fitted(Optic::OBSCURATION) | Self::LostLight(LostLight::Obscuration(_)) => {
                !has_geometry || scene.pupil.central_obscuration_m > 0.0
            }
            Self::Fitted(_) => scene.modes.segment != SegmentModes::Piston,
            Self::LostLight(LostLight::Dark(_)) => !has_geometry || !scene.pupil.dark_segments.is_empty(),
            Self::LostLight(LostLight::Stop(_)) => !has_geometry || scene.pupil.stop_diameter_m > 0.0,
        }
    }
}

/// A fit of an image, as far as models are compared by it.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Fit {
    reduced_chi2: f64,
    parameters: usize,
    /// Samples of the pupil along a side.
    samples: usize,
    is_explained: bool,
}

impl Fit {
    fn of((fitter, found): &(ModalFitter, ModalEstimate), image: usize) -> Self {
        // By the modes: what these leave out is no model that is compared.
        let report = found.report_by_modes(image);
        Self {
            reduced_chi2: report.reduced_chi2,
            parameters: fitter.model().basis.len() + fitter.fitted_optics().len(),
            samples: fitter.model().optics.sampling().samples,
            is_explained: report.status == Status::Ok,
        }
    }

    /// Part of χ² beyond 1 of the fit `from` that is left.
    fn left_of(&self, from: &Fit) -> f64 {
        (self.reduced_chi2 - 1.0).max(0.0) / (from.reduced_chi2 - 1.0)
    }

    /// Schwarz's criterion of the module, for an image of `pixels` pixels and noise variances that
    /// are `scale` times as large as stated.
    fn criterion(&self, pixels: f64, scale: f64) -> f64 {
        let (chi2, k) = (self.reduced_chi2 * (pixels - self.parameters as f64), self.parameters as f64);
        chi2 / scale + k * pixels.ln()
    }
}

/// A model with extensions, fitted to one image.
struct Trial {
    extensions: Vec<Extension>,
    scene: Scene,
    fit: Fit,
}

/// Fits a scene to one image; `None` where the optical parameters that are to be fitted would not
/// lower χ² enough.
pub(super) type FitOne<'a> = dyn Fn(&Scene) -> Result<Option<(ModalFitter, ModalEstimate)>> + Sync + 'a;

/// A model that explains images which that of the scene does not.
pub(super) struct Selected {
    /// The scene with its modes.
    pub(super) scene: Scene,
    /// What extends it.
    pub(super) extensions: Vec<Extension>,
    /// What was added, for reports.
    pub(super) added: String,
    /// What it explains, as a sentence.
    pub(super) remark: String,
}

/// Whether the model of `scene` may be extended.
pub(super) fn may_extend(scene: &Scene, policy: &Policy) -> bool {
    policy.select_model
        && policy.fit_optics
        && scene.estimate.model == ModelChoice::Auto
        && scene.estimate.optimizer == Optimizer::GaussNewton
        && scene.estimate.fit_optics.is_empty()
        && !matches!(scene.modes.ncpa, NcpaBasis::File(_) | NcpaBasis::None)
}

/// Looks for a model that explains an image which a fit of `scene` does not explain: the fit, the
/// image's number in it, and the image's name for reports. `fit` fits a scene to that image, and
/// `fit_coarsely` does without a search for outliers.
///
/// # Errors
/// [`Error::Interrupted`].
pub(super) fn select(
    scene: &Scene,
    control: &Control,
    (own, image, name): (&(ModalFitter, ModalEstimate), usize, &str),
    [fit, fit_coarsely]: [&FitOne; 2],
) -> Result<Option<Selected>> {
    let base = Fit::of(own, image);
    if base.is_explained || base.reduced_chi2 <= 1.0 {
        return Ok(None);
    }
    let chi2_of = |fit: &FitOne, extended: &Scene| {
        control.check("the images were fitted, a model that explains them was not found yet")?;
        match fit(extended) {
            Ok(found) => Ok(found.map(|found| Fit::of(&found, 0))),
            Err(error @ Error::Interrupted(_)) => Err(error),
            // The telescope may be too small for so many modes.
            Err(_) => Ok(None),
        }
    };
    let mut trials = trials(scene, &base, &mut |extended| chi2_of(fit, extended))?;
    if base.reduced_chi2 > SHADED && !trials.iter().any(|trial| trial.fit.is_explained) {
        let coarse_chi2 = |coarse: &Scene| Ok(chi2_of(fit_coarsely, coarse)?.map(|found| found.reduced_chi2));
        let lost: Vec<_> = lost_light::find(scene, &coarse_chi2)?.into_iter().map(Extension::LostLight).collect();
        if !lost.is_empty() {
            let shaded = attempt(scene, &lost, &mut |extended| chi2_of(fit, extended), &mut trials)?;
            // A spider may be too thin for the coarse model.
            let has_spider = lost.iter().any(|lost| lost.optic() == Some(Optic::SPIDERS));
            if let Some(shaded) = shaded.filter(|fit| !fit.is_explained && !has_spider) {
                let both = [&lost[..], &[Extension::Fitted(Optic::SPIDERS)]].concat();
                let found = attempt(scene, &both, &mut |extended| chi2_of(fit, extended), &mut trials)?;
                // What helps little is not what is missing.
                trials.pop_if(|_| found.is_some_and(|fit| fit.left_of(&shaded) > 1.0 - WORTH_EXTENDING));
            }
        }
    }
    let pixels = (own.0.model().optics.sampling().pixels as f64).powi(2);
    // Samples add no freedom, with which a wrong model explains an image.
    let is_right = |trial: &Trial| match trial.extensions[..] {
        [Extension::Samples(_)] => trial.fit.is_explained && trial.fit.left_of(&base) < 1.0 - WORTH_EXTENDING,
        _ => trial.fit.left_of(&base) < MOST_LEFT,
    };
    Ok(best(&trials, pixels).filter(|trial| is_right(trial)).map(|trial| {
        let names: Vec<String> = trial.extensions.iter().map(|extension| extension.name()).collect();
        let added = match &names[..] {
            [first @ .., before, last] => [first, &[format!("{before} and {last}")]].concat().join(", "),
            _ => names.concat(),
        };
        let remark = format!(
            "The model was extended by {added}: the reduced χ² of {name} is {:.3} in place of {:.1} \
             (estimate.model = \"scene\" keeps that of the scene).",
            trial.fit.reduced_chi2, base.reduced_chi2
        );
        Selected { scene: trial.scene.clone(), extensions: trial.extensions.clone(), added, remark }
    }))
}

/// Tries `scene` with `extensions`, and adds the trial to `done`; `None` where the scene has one of
/// them, or does not accept them.
fn attempt(
    scene: &Scene,
    extensions: &[Extension],
    fit: &mut dyn FnMut(&Scene) -> Result<Option<Fit>>,
    done: &mut Vec<Trial>,
) -> Result<Option<Fit>> {
    if extensions.iter().any(|extension| extension.is_in(scene)) {
        return Ok(None);
    }
    let add = |sections: &mut Sections| extensions.iter().for_each(|extension| extension.add_to(sections));
    let Ok(extended) = scene.changed(add) else { return Ok(None) };
    let Some(found) = fit(&extended)? else { return Ok(None) };
    done.push(Trial { extensions: extensions.to_vec(), scene: extended, fit: found });
    Ok(Some(found))
}

/// The models that are tried, until one explains the image: each extension alone, then tilts and
/// Zernikes.
fn trials(scene: &Scene, base: &Fit, fit: &mut dyn FnMut(&Scene) -> Result<Option<Fit>>) -> Result<Vec<Trial>> {
    let mut done: Vec<Trial> = Vec::new();
    let mut attempt = |extensions: &[Extension], done: &mut Vec<Trial>| attempt(scene, extensions, fit, done);
    let zernikes_to = |last| Extension::ZernikesTo { last, own_samples: base.samples };
    let removes = |fit: &Fit| 1.0 - fit.left_of(base);
    for first in [Extension::Samples(base.samples), Extension::SegmentTilts] {
        if attempt(&[first], &mut done)?.is_some_and(|fit| fit.is_explained && removes(&fit) > WORTH_EXTENDING) {
            return Ok(done);
        }
    }
    for last in LAST_NOLL {
        match attempt(&[zernikes_to(last)], &mut done)? {
            Some(fit) if fit.is_explained => return Ok(done),
            Some(fit) if removes(&fit) < WORTH_EXTENDING => break,
            _ => {}
        }
    }
    for optic in FITTED {
        if attempt(&[Extension::Fitted(optic)], &mut done)?.is_some_and(|fit| fit.is_explained) {
            return Ok(done);
        }
    }
    let most = done.iter().map(|trial| removes(&trial.fit)).fold(0.0, f64::max);
    if most >= WORTH_EXTENDING {
        for last in LAST_NOLL {
            let both = [Extension::SegmentTilts, zernikes_to(last)];
            if attempt(&both, &mut done)?.is_some_and(|fit| fit.is_explained) {
                break;
            }
        }
    }
    Ok(done)
}

/// The trial with the smallest criterion.
fn best(trials: &[Trial], pixels: f64) -> Option<&Trial> {
    let scale = trials.iter().map(|trial| trial.fit.reduced_chi2).fold(f64::INFINITY, f64::min).max(1.0);
    let criterion = |trial: &Trial| trial.fit.criterion(pixels, scale);
    trials.iter().min_by(|a, b| criterion(a).total_cmp(&criterion(b)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fit(reduced_chi2: f64, parameters: usize) -> Fit {
        Fit { reduced_chi2, parameters, samples: 120, is_explained: reduced_chi2 < 1.2 }
    }

    /// Names of the extensions of the trials that were made, for an image with these χ² by
    /// extension, and the best of them.
    fn tried(chi2: impl Fn(&Scene) -> Option<f64>) -> (Vec<String>, Option<String>) {
        let scene = Scene::preset("keck-artificial").unwrap();
        let trials = trials(&scene, &fit(100.0, 120), &mut |scene| {
            let tilts = if scene.modes.segment == SegmentModes::PistonTipTilt { 72 } else { 0 };
            if !scene.estimate.fit_optics.is_empty() {
                return Ok(None);
            }
            let zernikes = match scene.modes.exact_zernikes {
                Some(NollRange::Span { last, .. }) => last,
                _ => 20,
            };
            Ok(chi2(scene).map(|chi2| fit(chi2, 100 + zernikes + tilts)))
        });
        let trials = trials.unwrap();
        let name = |trial: &Trial| trial.extensions.iter().map(|e| e.name()).collect::<Vec<_>>().join(" + ");
        (trials.iter().map(name).collect(), best(&trials, 1e4).map(name))
    }

    fn last_noll(scene: &Scene) -> usize {
        match scene.modes.exact_zernikes {
            Some(NollRange::Span { last, .. }) => last,
            _ => 21,
        }
    }

    #[test]
    fn larger_models_are_tried_only_where_smaller_ones_gain() {
        let tilted = |scene: &Scene| scene.modes.segment == SegmentModes::PistonTipTilt;
        let (made, best) = tried(|scene| Some(if tilted(scene) { 1.01 } else { 90.0 }));
        assert_eq!((made.len(), best.unwrap().as_str()), (2, "tip and tilt of each segment"));
        let (made, best) = tried(|scene| {
            Some(if last_noll(scene) >= 200 {
                1.0
            } else if last_noll(scene) >= 91 {
                50.0
            } else {
                99.0
            })
        });
        assert_eq!((made.len(), best.unwrap().as_str()), (4, "Zernikes to Noll 210"));
        // Both are needed.
        let (made, best) = tried(|scene| match (tilted(scene), last_noll(scene) >= 91) {
            (true, true) => Some(1.0),
            (true, false) => Some(40.0),
            (false, true) => Some(60.0),
            (false, false) => Some(100.0),
        });
        assert_eq!(made.len(), 5);
        assert_eq!(best.unwrap(), "tip and tilt of each segment + Zernikes to Noll 91");
        // Neither helps: no further model.
        let (made, _) = tried(|_| Some(97.0));
        assert_eq!(made.len(), 3);
        // Samples alone.
        let is_finer = |scene: &Scene| scene.estimate.samples == Some(200);
        let (made, best) = tried(|scene| Some(if is_finer(scene) { 1.01 } else { 90.0 }));
        assert_eq!((made.len(), best.unwrap().as_str()), (1, "more samples of the pupil (estimate.samples)"));
        assert_eq!(tried(|_| None), (Vec::new(), None));
    }

    #[test]
    fn parameters_without_a_gain_are_not_added() {
        let trial = |reduced_chi2, parameters, extension| Trial {
            extensions: vec![extension],
            scene: Scene::preset("keck-artificial").unwrap(),
            fit: fit(reduced_chi2, parameters),
        };
        // 119 parameters more at 10,000 pixels must lower χ² by 119 ln N = 1,096: reduced χ² by
        // more than 0.1.
        let (few, many) = (
            Extension::ZernikesTo { last: 91, own_samples: 120 },
            Extension::ZernikesTo { last: 210, own_samples: 120 },
        );
        let chosen = |chi2: [f64; 2]| {
            best(&[trial(chi2[0], 200, few.clone()), trial(chi2[1], 319, many.clone())], 1e4).unwrap().extensions[0]
                .clone()
        };
        assert_eq!(chosen([1.00, 1.00]), few);
        assert_eq!(chosen([1.08, 1.00]), few);
        assert_eq!(chosen([1.20, 1.00]), many);
        // Where no model is exact, the same ratio decides.
        assert_eq!(chosen([10.8, 10.0]), few);
        assert_eq!(chosen([12.0, 10.0]), many);
    }
}
