//! Check of scene and images before an estimate is believed: what was looked for, what was found, and the key to set.
//!
//! Causes compete by Schwarz's criterion, as models do in `model_selection`: a cause of k parameters that lowers χ² by Δχ² gains
//! Δχ²/s − k ln N with N pixels, where s, at least 1, is the smallest reduced χ² of all causes: where no model is exact, χ² counts in units
//! of what the best one leaves. A cause is a fault where its gain is positive, and the first is the one with the largest gain. For one
//! parameter and 10⁴ pixels it must be 3σ away.
//!
//! A defocused image of one wavelength does not determine everything:
//!
//! * The pixel's angle, the wavelength and the size of the pupil act through pixels per λ/D alone, and through the defocus in waves, which
//!   the modes reproduce. They are degenerate unless a card of the file states one of them.
//! * The amplitude of the defocus is that of a mode.
//! * Flips, turns and the sign of the defocus: see `turns`.
//!
//! The scene in a file, and its cards, are no evidence of their own: their values are fitted too, and compete as the others.

mod finding;
mod focus;
mod header;
mod optics;
mod orientation;
mod shapes;
mod turns;

pub use finding::{CheckedQuantity, Finding, Verdict};

use super::consistency::{Contradiction, Electrons, reconcile};
use super::control::{Control, Stage};
use super::images::{Images, Trust};
use super::misfit::{self, TOP};
use super::modal_task::{Fitted, ModalTask};
use super::orientation::Poke;
use super::policy::Policy;
use crate::io::Quantity as Card;
use crate::modal::{self, BasisCache, Cube, FittedImage, ImageStatus, ModalEstimate, OpticsMinimum};
use crate::scene::{Optic, Scene};
use crate::{Error, Result};
use finding::with;
use ndarray::Axis;
use std::borrow::Cow;

/// Images that are looked at, evenly from a sequence.
const MAX_IMAGES: usize = 6;
/// Part of the excess of χ² that a shape of the residual must explain where there is a misfit: see `misfit`.
const EXPLAINED_BY_SHAPE: f64 = 0.5;
/// Excess of χ² from which there is a misfit, in standard deviations of χ².
const MISFIT_SIGMA: f64 = 5.0;

/// What a check found.
#[derive(Debug, Clone)]
pub struct Check {
    /// Findings: faults first, the likeliest cause before the others; then what agrees, then what these images do not determine.
    pub findings: Vec<Finding>,
    /// Median reduced χ² of the images with the scene, and with the settings of the first fault where it has some.
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

/// Checks `images` of a static wavefront against `scene`. `poke` is a known change of the wavefront, with the images before it: `images` are
/// then those behind it.
///
/// # Errors
/// Those of [`Estimator::estimate`](super::Estimator::estimate), except that a file that contradicts the scene is a finding;
/// [`Error::Scene`] for a scene with channels.
pub fn check(
    scene: &Scene,
    images: &Images,
    poke: Option<(Option<&Images>, Poke)>,
    control: &Control,
) -> Result<Check> {
    scene.refuse_channels("a check of images")?;
    images.check()?;
    control.reset_progress();
    let (images, _) = images.without_odd_edge(scene.image.frame_shape());
    let trusting = Images { trust: Trust::Scene, ..images.into_owned() };
    let mut settings = vec![("estimate.fit_optics", "[]"), ("estimate.method", "modal"), ("estimate.model", "scene")];
    if scene.estimate.budget_nm.is_some() {
        settings.push(("estimate.budget_nm", ""));
    }
    let plain = scene.with(&settings)?;
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
    fn fit(&self, scene: &Scene, cache: &BasisCache) -> Result<Fitted> {
        let (policy, control) = (&self.policy, self.control);
        ModalTask { scene, policy, control, cache, images: &self.images, kept: None }.fit()
    }

    /// Checks the images against `given`, the scene `own` without what only an estimate does.
    fn run(&mut self, own: &Scene, given: &Scene, poke: Option<(Option<&Images>, &Images, Poke)>) -> Result<Check> {
        let cache = BasisCache::default();
        let (mut fitted, focus) = self.first_fit(given, &cache)?;
        let (first_chi2, first) = (chi2_of(&fitted), fitted.fit.1.compared.clone());
        let mut findings: Vec<_> = focus.into_iter().collect();
        findings.push(self.saturation(given, &cache, &mut fitted)?);
        let (scene, orientation) = self.orientation(given, &cache, &mut fitted, poke)?;
        findings.extend(orientation);
        findings.extend(self.optics_and_shapes(&scene, &cache.for_scene(given, &scene), &fitted)?);
        let has_fault_of_focus = findings.iter().any(|finding| finding.quantity == CheckedQuantity::Defocus);
        findings.extend(shapes::noise(&fitted));
        findings.extend(shapes::photometry(&scene, &fitted, has_fault_of_focus)?);
        findings.extend(self.header(&scene, &cache.for_scene(given, &scene), &fitted));
        sort(&mut findings);
        findings.iter_mut().for_each(|finding| finding.take_form_of(given));
        let settings = findings.first().map(|finding| finding.settings.clone()).unwrap_or_default();
        let mut corrected = None;
        if !settings.is_empty() {
            let scene = with(given, &settings)?;
            let again = self.fit(&scene, &cache.for_scene(given, &scene))?;
            corrected = Some((chi2_of(&again), again.fit.1.compared));
        }
        let last_chi2 = corrected.as_ref().map_or(first_chi2, |(chi2, _)| *chi2);
        let compared = (first, corrected.map(|(_, image)| image));
        Ok(Check { findings, reduced_chi2: [first_chi2, last_chi2], compared, corrected: with(own, &settings)? })
    }

    /// Fits the images, and finds where one is in focus and the scene has a defocus, which NCPA of the opposite focus may explain; or the reverse,
    /// if the scene does not explain them. Where they cannot be fitted for that, they are with the defocus that is seen.
    fn first_fit(&self, scene: &Scene, cache: &BasisCache) -> Result<(Fitted, Option<Finding>)> {
        let first = self.fit(scene, cache);
        let image = match &first {
            Ok(fitted) => fitted.fit.1.used_images.first().copied().unwrap_or_default(),
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
                let other = with(scene, &fault.settings)?;
                self.fit(&other, &cache.for_scene(scene, &other))
                    .map_err(|_| Error::Image(format!("{error}; {}", fault.explanation)))?
            }
        };
        let gain = (chi2_of(&fitted) - 1.0).max(0.0) * pixels_of(&fitted);
        Ok((fitted, Some(Finding { gain, ..fault })))
    }

    /// Saturated pixels; they are bad from then on.
    fn saturation(&mut self, scene: &Scene, cache: &BasisCache, fitted: &mut Fitted) -> Result<Finding> {
        let image = fitted.fit.1.used_images.first().copied().unwrap_or_default();
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

    /// Optical parameters, fitted together, and shapes of the residual.
    fn optics_and_shapes(&mut self, scene: &Scene, cache: &BasisCache, fitted: &Fitted) -> Result<Vec<Finding>> {
        let (excess, shapes) = self.with_case(fitted, cache, |case, found| {
            Ok(case.residual(found).map_or((0.0, Vec::new()), |residual| (residual.excess(), residual.shapes())))
        })?;
        let pixels = pixels_of(fitted);
        let is_misfit = excess > MISFIT_SIGMA * (2.0 * pixels).sqrt();
        // Beyond some per cent the fit of all parameters does not reach a plate scale that one alone finds.
        let plate_scale =
            if is_misfit { self.with_case(fitted, cache, |case, found| case.plate_scale(found))? } else { None };
        let start = plate_scale.map(|other| other.fitted);
        let mut parameters = optics::parameters(scene);
        let mut minimum = self.minimum(scene, cache, &parameters, start)?;
        if minimum.is_none() && parameters.contains(&Optic::Rotation) {
            // A turned pupil may be larger than its grid.
            parameters.retain(|optic| *optic != Optic::Rotation);
            minimum = self.minimum(scene, cache, &parameters, start)?;
        }
        let own_chi2 = chi2_of(fitted);
        let best_chi2 = minimum.as_ref().map_or(own_chi2, |minimum| own_chi2.min(minimum.reduced_chi2[1]));
        // What the best shape leaves.
        let left_by_shape =
            shapes.iter().map(|shape| 1.0 + (excess - shape.decrease) / pixels).fold(own_chi2, f64::min);
        let scale = best_chi2.min(left_by_shape).max(1.0);
        let mut findings = Vec::new();
        if let Some(minimum) = &minimum {
            let [own, least] = minimum.reduced_chi2;
            let is_explained = !is_misfit || (least - 1.0).max(0.0) < optics::MOST_LEFT * (own - 1.0);
            findings = optics::findings((scene, &parameters), minimum, scale, is_explained);
            if let Some(first) = findings.first_mut() {
                optics::with_header(first, scene, self.has_wavelength, &mut self.contradictions);
            }
        } else {
            findings.push(Finding::open(
                CheckedQuantity::PlateScaleOrWavelength,
                "the fit of plate scale and illumination does not converge: their values are far from the scene's, or \
                 something else is wrong",
            ));
        }
        if scene.pupil.extent_m().is_some() && !parameters.contains(&Optic::Rotation) {
            findings.push(Finding::open(
                CheckedQuantity::Rotation,
                "its fit does not converge, or the turned pupil is larger than pupil.grid_m: give a wider grid",
            ));
        }
        let log_pixels = pixels.max(2.0).ln();
        for shape in shapes {
            let gain = shape.decrease / scale - shape.parameters as f64 * log_pixels;
            let is_large = shape.value.abs() > shapes::least(shape.kind);
            let is_fault = gain > 0.0 && is_large && (!is_misfit || shape.share > EXPLAINED_BY_SHAPE);
            findings.push(shapes::finding(&shape, gain, is_fault));
        }
        if is_misfit && !findings.iter().any(|finding| finding.verdict == Verdict::Fault) {
            let status = fitted.fit.1.status().kind();
            if status != ImageStatus::Ok || own_chi2 > 2.0 {
                findings.push(Finding::new(
                    CheckedQuantity::Unexplained,
                    Verdict::Fault,
                    format!(
                        "a reduced χ² of {own_chi2:.2} that none of these explains: 'cophase estimate' tries tilts of the segments, more \
                         NCPA and reflectivities; an exposure that averages turbulence is no image of a static wavefront"
                    ),
                ));
            }
        }
        Ok(findings)
    }

    /// Minimum of `parameters` and the modes, from the plate scale `start` on where there is one; `None` where the fit does not converge or
    /// leads to values that the scene does not accept.
    fn minimum(
        &self,
        scene: &Scene,
        cache: &BasisCache,
        parameters: &[Optic],
        start: Option<f64>,
    ) -> Result<Option<OpticsMinimum>> {
        // A scene without weights fits no optics.
        let Ok(fitting) = scene.with(&[("estimate.fit_optics", &optics::listed(parameters))]) else { return Ok(None) };
        let images = &self.images;
        let cube = Cube { images_e: images.images_e.view(), bad: images.bad.view(), read_noise_e: images.read_noise_e };
        let flag = Some(self.control.flag());
        match modal::fit_together(&fitting, &self.policy.recipe(scene), cache, cube, start, flag) {
            Ok(minimum) => Ok(Some(minimum)),
            Err(error @ Error::Interrupted(_)) => Err(error),
            Err(_) => Ok(None),
        }
    }

    /// What `of` finds of the first image that is used.
    fn with_case<T>(
        &self,
        fitted: &Fitted,
        cache: &BasisCache,
        of: impl FnOnce(&misfit::Case, &ModalEstimate) -> Result<T>,
    ) -> Result<T> {
        let (fitter, found) = &fitted.fit;
        let image = found.used_images.first().copied().unwrap_or_default();
        let diversity = fitter.diversity_projection()?;
        let (scene, policy, control) = (fitter.scene(), &self.policy, self.control);
        let task = ModalTask { scene, policy, control, cache, images: &self.images, kept: None };
        let (model, chain) = (fitter.model(), fitter.reference_chain());
        of(&misfit::Case { task, image, model, chain, diversity: &diversity }, found)
    }
}

/// Faults first, those with the largest gain before the others; then what agrees, then what is not determined.
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

/// Median reduced χ² of the images that are used.
fn chi2_of(fitted: &Fitted) -> f64 {
    fitted.fit.1.reduced_chi2()
}

/// Pixels that are fitted.
fn pixels_of(fitted: &Fitted) -> f64 {
    (fitted.fit.0.model().optics.sampling().pixels as f64).powi(2)
}
