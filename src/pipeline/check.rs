//! Check of scene and images before an estimate is believed: what was looked for, what was found,
//! and the key to set.
//!
//! Causes compete by Schwarz's criterion, as models do in `model_selection`: a cause of k
//! parameters that lowers χ² by Δχ² gains Δχ²/s − k ln N with N pixels, where s, at least 1, is the
//! smallest reduced χ² of all causes: where no model is exact, χ² counts in units of what the best
//! one leaves. A cause is a fault where its gain is positive, and the first is the one with the
//! largest gain. For one parameter and 10⁴ pixels it must be 3σ away.
//!
//! A defocused image of one wavelength does not determine everything:
//!
//! * The pixel's angle, the wavelength and the size of the pupil act through pixels per λ/D alone,
//!   and through the defocus in waves, which the modes reproduce. They are degenerate unless a card
//!   of the file states one of them.
//! * The amplitude of the defocus is that of a mode.
//! * Flips, turns and the sign of the defocus: see `turns`.
//!
//! The scene in a file, and its cards, are no evidence of their own: their values are fitted too,
//! and compete as the others.

mod causes;
mod finding;
mod focus;
mod header;
mod optics;
mod orientation;
mod shapes;
mod turns;

pub use finding::{CheckedQuantity, Finding, Verdict};

use super::consistency::{Contradiction, Electrons, reconcile};
use super::cut_out::scene_of_cut_out;
use super::images::{Images, Trust};
use super::misfit::{self, TOP};
use super::modal_task::{Fitted, ModalTask};
use super::orientation::Poke;
use super::policy::Policy;
use crate::control::{Control, Stage};
use crate::io::Quantity as Card;
use crate::modal::{FittedImage, ModalEstimate, ModelCache};
use crate::scene::{Method, ModelChoice, Optic, Scene, Setting, Telemetry};
use crate::{Error, Result};
use ndarray::Axis;
use std::borrow::Cow;

/// Images that are looked at, evenly from a sequence.
const MAX_IMAGES: usize = 6;
/// Ratio of reduced χ² above which a setting raises it. Fits of images that are not explained end
/// in minima that differ by some per cent.
const RAISED: f64 = 1.05;

/// What a check found.
#[derive(Debug, Clone)]
pub struct Check {
    /// Findings: faults first, the likeliest cause before the others; then what agrees, then what
    /// these images do not determine.
    pub findings: Vec<Finding>,
    /// Median reduced χ² of the images with the scene, and with the settings of the first fault
    /// where it has some.
    pub reduced_chi2: [f64; 2],
    /// The first image with the scene's model, and with that of the settings of the first fault.
    pub compared: (FittedImage, Option<FittedImage>),
    /// The scene with the settings of the first fault.
    pub corrected: Scene,
}

impl Check {
    /// The likeliest cause; `None` where scene and images agree.
    pub fn cause(&self) -> Option<&Finding> {
        self.findings.first().filter(|finding| finding.verdict == Verdict::Fault)
    }
}

/// Checks `images` of a static wavefront against `scene`. `poke` is a known change of the
/// wavefront, with the images before it: `images` are then those behind it.
///
/// # Errors
/// Those of [`Estimator::estimate`](super::Estimator::estimate), except that a file that
/// contradicts the scene is a finding; [`Error::Scene`] for a scene with channels.
pub fn check(
    scene: &Scene,
    images: &Images,
    poke: Option<(Option<&Images>, Poke)>,
    control: &Control,
) -> Result<Check> {
    scene.refuse_channels("a check of images")?;
    images.check()?;
    control.reset_progress();
    let cut_out = scene_of_cut_out(scene, &[images])?;
    let scene = cut_out.as_ref().map_or(scene, |(cut_out, _)| cut_out);
    let (images, _) = images.without_odd_edge(scene.image.frame_shape());
    let trusting = Images { trust: Trust::Scene, ..images.into_owned() };
    let plain = scene.changed(|sections| {
        let estimate = &mut sections.estimate;
        (estimate.method, estimate.model) = (Method::Modal, ModelChoice::Scene);
        (estimate.ao_knowledge, estimate.telemetry) = (None, Telemetry::Check);
        estimate.fit_optics.clear();
        estimate.budget_nm = None;
        sections.leave_out_posterior();
    })?;
    let consistent = reconcile(&trusting, &plain)?;
    let mut work = Work {
        images: selected(&consistent.images),
        policy: Policy { select_model: false, ..Policy::default() },
        control,
        contradictions: consistent.contradictions,
        has_wavelength: trusting.facts.iter().any(|fact| fact.quantity == Card::WavelengthNm),
    };
    let before = poke.and_then(|(before, _)| before).map(|before| Images { trust: Trust::Scene, ..before.clone() });
    let found = work.run(scene, &plain, poke.map(|(_, poke)| (before.as_ref(), &trusting, poke)));
    control.enter(Stage::Idle, 0);
    found.inspect_err(|error| {
        if matches!(error, Error::Interrupted(_)) {
            control.acknowledge();
        }
    })
}

/// Up to [`MAX_IMAGES`] images, evenly from all.
fn selected(images: &Electrons) -> Electrons<'static> {
    let (count, fewer) = (images.len(), MAX_IMAGES.min(images.len()));
    let at: Vec<usize> = (0..fewer).map(|i| (2 * i + 1) * count / (2 * fewer)).collect();
    Electrons {
        images_e: Cow::Owned(images.images_e.select(Axis(0), &at)),
        bad: Cow::Owned(images.bad.select(Axis(0), &at)),
        read_noise_e: images.read_noise_e,
        slopes_mas: None,
        moved_reference_mas: None,
    }
}

struct Work<'a> {
    images: Electrons<'a>,
    policy: Policy,
    control: &'a Control,
    contradictions: Vec<Contradiction>,
    has_wavelength: bool,
}

impl Work<'_> {
    fn fit(&self, scene: &Scene, cache: &ModelCache) -> Result<Fitted> {
        let (policy, control) = (&self.policy, self.control);
        ModalTask { scene, policy, control, cache, images: &self.images }.fit(None)
    }

    /// Reduced χ² of image `image` with `scene`, without restarts, which a scene that explains it
    /// does not need; `None` where the fit fails.
    fn trial_chi2(&self, scene: &Scene, image: usize) -> Result<Option<f64>> {
        let (policy, control, cache) = (&self.policy, self.control, &ModelCache::default());
        match (ModalTask { scene, policy, control, cache, images: &self.images }).fit_one(scene, image) {
            // Near the right scene a fit may end at the limit of its evaluations, with a χ² that is
            // lower than elsewhere.
            Ok(fit) => Ok(fit.and_then(|(_, found)| found.images.first().map(|image| image.reduced_chi2))),
            Err(error @ Error::Interrupted(_)) => Err(error),
            Err(_) => Ok(None),
        }
    }

    /// Checks the images against `given`, the scene `own` without what only an estimate does.
    fn run(&mut self, own: &Scene, given: &Scene, poke: Option<(Option<&Images>, &Images, Poke)>) -> Result<Check> {
        let cache = ModelCache::default();
        let (mut fitted, focus) = self.first_fit(given, &cache)?;
        let (first_chi2, first) = (chi2_of(&fitted), fitted.fit.1.compared.clone());
        let mut findings: Vec<_> = focus.into_iter().collect();
        findings.push(self.saturation(given, &cache, &mut fitted)?);
        let (scene, orientation) = self.orientation((own, given), &cache, &mut fitted, poke)?;
        findings.extend(orientation);
        let mut causes = self.causes(&scene, &cache.for_scene(given, &scene), &fitted)?;
        if let Some(found) = causes.iter_mut().find(|one| one.quantity == CheckedQuantity::PlateScaleOrWavelength) {
            optics::with_header(found, &scene, self.has_wavelength, &mut self.contradictions);
        }
        findings.extend(causes);
        let has_fault_of_focus =
            findings.iter().any(|finding| finding.quantity == CheckedQuantity::Optic(Optic::DEFOCUS));
        findings.extend(shapes::noise(&fitted));
        findings.extend(shapes::photometry(&scene, &fitted, has_fault_of_focus)?);
        findings.extend(self.header(&scene, &cache.for_scene(given, &scene), &fitted));
        sort(&mut findings);
        findings.iter_mut().for_each(|finding| finding.take_form_of(given));
        let corrected = self.correct(given, &cache, first_chi2, &mut findings)?;
        let settings = findings.first().map(|finding| finding.settings.clone()).unwrap_or_default();
        let last_chi2 = corrected.as_ref().map_or(first_chi2, |(chi2, _)| *chi2);
        let compared = (first, corrected.map(|(_, image)| image));
        Ok(Check {
            findings,
            reduced_chi2: [first_chi2, last_chi2],
            compared,
            corrected: own.with_settings(&settings)?,
        })
    }

    /// Reduced χ² and first image of the fit with the settings of the first fault, where it has
    /// some. A fault whose settings raise χ² is none that was found: it is not proposed, and the
    /// next one takes its place. An image in focus is known by its shape: NCPA of the opposite
    /// focus explain it as well as no defocus does, and the fit without, whose even aberrations
    /// have no sign, may end beside its minimum.
    fn correct(
        &self,
        given: &Scene,
        cache: &ModelCache,
        own_chi2: f64,
        findings: &mut [Finding],
    ) -> Result<Option<(f64, FittedImage)>> {
        // Each time one fault less.
        while let Some(first) = findings.first_mut().filter(|first| !first.settings.is_empty()) {
            let scene = given.with_settings(&first.settings)?;
            let again = self.fit(&scene, &cache.for_scene(given, &scene))?;
            let chi2 = chi2_of(&again);
            if first.quantity == CheckedQuantity::Optic(Optic::DEFOCUS) || !is_raised(chi2, own_chi2) {
                return Ok(Some((chi2, again.fit.1.compared)));
            }
            first.explanation += &format!("; {}", raised(&first.settings, chi2, own_chi2));
            (first.verdict, first.gain) = (Verdict::NotDetermined, 0.0);
            first.settings.clear();
            sort(findings);
        }
        Ok(None)
    }

    /// Fits the images, and finds where one is in focus and the scene has a defocus, which NCPA of
    /// the opposite focus may explain; or the reverse, if the scene does not explain them. Where
    /// they cannot be fitted for that, they are with the defocus that is seen.
    fn first_fit(&self, scene: &Scene, cache: &ModelCache) -> Result<(Fitted, Option<Finding>)> {
        let first = self.fit(scene, cache);
        let image = match &first {
            Ok(fitted) => first_used(fitted),
            Err(Error::Image(_)) => 0,
            Err(_) => return first.map(|fitted| (fitted, None)),
        };
        let mut frame_e = self.images.images_e.index_axis(Axis(0), image).to_owned();
        frame_e
            .zip_mut_with(&self.images.bad.index_axis(Axis(0), image), |e, bad| *e = if *bad { f64::NAN } else { *e });
        let Some(fault) = focus::fault(scene, frame_e.view())? else {
            return first.map(|fitted| (fitted, None));
        };
        let fitted = match first {
            // Aberrations alone may blur an image in focus.
            Ok(fitted) if fault.settings.is_empty() && fitted.is_explained() => return Ok((fitted, None)),
            Ok(fitted) => fitted,
            Err(error) if fault.settings.is_empty() => {
                return Err(Error::Image(format!("{error}; {}", fault.explanation)));
            }
            Err(error) => {
                let other = scene.with_settings(&fault.settings)?;
                self.fit(&other, &cache.for_scene(scene, &other))
                    .map_err(|_| Error::Image(format!("{error}; {}", fault.explanation)))?
            }
        };
        let gain = (chi2_of(&fitted) - 1.0).max(0.0) * pixels_of(&fitted);
        Ok((fitted, Some(Finding { gain, ..fault })))
    }

    /// Saturated pixels; they are bad from then on.
    fn saturation(&mut self, scene: &Scene, cache: &ModelCache, fitted: &mut Fitted) -> Result<Finding> {
        let image = first_used(fitted);
        let frame_e = self.images.images_e.index_axis(Axis(0), image);
        let Some(sentence) =
            misfit::saturation(&fitted.fit.1.compared, frame_e, self.images.bad.index_axis(Axis(0), image))
        else {
            return Ok(Finding::new(
                CheckedQuantity::Saturation,
                Verdict::Agrees,
                "one peak, no plateau of largest values",
            ));
        };
        let mut bad = self.images.bad.clone().into_owned();
        for (frame_e, mut marks) in self.images.images_e.outer_iter().zip(bad.outer_iter_mut()) {
            let good = frame_e.iter().zip(&marks).filter(|(_, bad)| !**bad).map(|(e, _)| *e);
            let largest = good.fold(f64::MIN, f64::max);
            marks.zip_mut_with(&frame_e, |bad, e| *bad |= *e >= TOP * largest);
        }
        self.images.bad = Cow::Owned(bad);
        let before = chi2_of(fitted);
        *fitted = self.fit(scene, cache)?;
        let pixels = pixels_of(fitted);
        let gain = ((before - chi2_of(fitted)) * pixels).max(0.0) / chi2_of(fitted).max(1.0);
        Ok(Finding { gain, ..Finding::new(CheckedQuantity::Saturation, Verdict::Fault, sentence) })
    }

    /// What `of` finds of the first image that is used.
    fn with_case<T>(
        &self,
        fitted: &Fitted,
        cache: &ModelCache,
        of: impl FnOnce(&misfit::Case, &ModalEstimate) -> Result<T>,
    ) -> Result<T> {
        let (fitter, found) = &fitted.fit;
        let image = first_used(fitted);
        let diversity = fitter.diversity_projection()?;
        let (scene, policy, control) = (&fitted.scene, &self.policy, self.control);
        let task = ModalTask { scene, policy, control, cache, images: &self.images };
        let (model, chain) = (fitter.model(), fitter.reference_chain());
        of(&misfit::Case { task, image, model, chain, diversity: &diversity }, found)
    }
}

/// Faults first, those with the largest gain before the others; then what agrees, then what is not
/// determined.
fn sort(findings: &mut [Finding]) {
    let rank = |finding: &Finding| match finding.verdict {
        Verdict::Fault => 0,
        Verdict::Agrees => 1,
        Verdict::NotDetermined => 2,
    };
    findings.sort_by(|a, b| {
        let gains = if rank(a) == 0 { b.gain.total_cmp(&a.gain) } else { std::cmp::Ordering::Equal };
        rank(a).cmp(&rank(b)).then(gains)
    });
}

/// Whether a reduced χ² is higher than before: more than fits of an image that the model does not
/// explain differ by. Below 1 the noise is stated too large, and its right value raises χ² to 1.
fn is_raised(chi2: f64, before: f64) -> bool {
    chi2 > RAISED * before.max(1.0)
}

/// Why settings are not proposed.
fn raised(settings: &[Setting], chi2: f64, before: f64) -> String {
    let settings: Vec<String> = settings.iter().map(Setting::to_string).collect();
    format!("not proposed: with {} the reduced χ² rises from {before:.3} to {chi2:.3}", settings.join(" and "))
}

/// Median reduced χ² of the images that are used.
fn chi2_of(fitted: &Fitted) -> f64 {
    fitted.fit.1.reduced_chi2()
}

/// The first image that is used.
fn first_used(fitted: &Fitted) -> usize {
    fitted.fit.1.combined.used_images.first().copied().unwrap_or_default()
}

/// Pixels that are fitted.
fn pixels_of(fitted: &Fitted) -> f64 {
    (fitted.fit.0.model().optics.sampling().pixels as f64).powi(2)
}
