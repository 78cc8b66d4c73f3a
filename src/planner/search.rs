//! Search for the cheapest model within the budget: one key after the other, each from the cheapest
//! value on.

use super::omission::omissions;
use super::plan::{FoundPlan, TriedValue};
use super::price::{Limit, Price};
use super::trial::{Trials, recipe};
use crate::control::Control;
use crate::modal::ModalFitter;
use crate::scene::{Crop, NcpaBasis, Optimizer, Precision, PupilModel, System};
use crate::{Error, Result};

/// Margin of the budget for wavefronts worse than those drawn, and for noise that is larger than
/// its mean: the residual of a hundred modes scatters by 7 %.
const HEADROOM: f64 = 1.15;
/// Error that a model may add where the noise alone is above the budget, as a fraction of the
/// noise.
const MODEL_SHARE: f64 = 0.1;
/// Samples across the pupil that are tried: steps of an eighth or so, which is a quarter in time,
/// and of half of that where most plans for a nanometre end.
const SAMPLES: [usize; 24] =
    [32, 36, 40, 48, 54, 60, 64, 72, 80, 84, 90, 96, 102, 108, 120, 136, 160, 180, 200, 240, 288, 320, 400, 480];
/// Pixels by which narrower crops differ.
const CROP_STEP: usize = 8;
/// Narrower crops that are tried.
const CROPS: usize = 4;
/// Largest work of a narrower crop, as a fraction of that of the wider one: a saving of less than a
/// twentieth does not outweigh the noise that it adds, and the further evaluations at a looser
/// tolerance.
const CROP_WORK: f64 = 0.95;
/// Step tolerances that are tried, nm, as fractions of the budget: a fit takes the step that is
/// below the tolerance, and its error is about a third of that step. Twice the budget would save a
/// twentieth of the evaluations of a plan of Keck for 1 nm, for a fifth more error.
const TOLERANCES: [f64; 5] = [1.0, 0.3, 0.1, 0.03, 0.01];

/// A candidate with its fitter, whose basis other candidates share.
pub(super) struct Candidate {
    scene: System,
    pub(super) fitter: ModalFitter,
    pub(super) price: Price,
}

/// State of the search.
pub(super) struct PlanSearch<'a> {
    given: &'a System,
    budget_nm: f64,
    control: &'a Control,
    pub(super) trials: Trials,
    choices: Vec<TriedValue>,
}

impl<'a> PlanSearch<'a> {
    pub(super) fn new(scene: &'a System, budget_nm: f64, control: &'a Control) -> Result<Self> {
        if scene.estimate.optimizer != Optimizer::GaussNewton {
            return Err(Error::Scene(
                "an error budget needs estimate.optimizer = \"gauss-newton\": the error of the paper's method does not depend \
                 on the choices of a plan"
                    .into(),
            ));
        }
        Ok(Self { given: scene, budget_nm, control, trials: Trials::new(scene, control)?, choices: Vec::new() })
    }

    pub(super) fn run(&mut self) -> Result<FoundPlan> {
        let first = self.reference()?;
        let reference = first.price;
        let limit = Limit::new(self.limit_nm(&first), &reference);
        let mut best = self.sampled(first, limit)?;
        best = self.fewer_wavelengths(best, limit)?;
        best = self.cropped(best, limit)?;
        best = self.single_precision(best, limit)?;
        best = self.stopped_early(best, limit)?;
        self.price_half_the_modes(&best)?;
        let omissions = omissions(self.given, &best.scene, &best.fitter, best.price, &self.trials, self.control)?;
        Ok(FoundPlan {
            system: best.scene,
            reference,
            chosen: best.price,
            choices: std::mem::take(&mut self.choices),
            omissions,
        })
    }

    /// Largest error of an acceptable candidate, nm.
    fn limit_nm(&self, reference: &Candidate) -> f64 {
        let noise_nm = reference.price.noise_nm.into_iter().fold(0.0, f64::max);
        (self.budget_nm / HEADROOM).max(noise_nm * (1.0 + MODEL_SHARE))
    }

    /// The scene's own model in double precision.
    pub(super) fn reference(&self) -> Result<Candidate> {
        let scene = self.given.with(|sections| sections.estimate.precision = Some(Precision::F64))?;
        let fitter = ModalFitter::with_recipe(&scene, recipe(&scene), false)?;
        let price = self.trials.price(&fitter, self.control)?;
        Ok(Candidate { scene, fitter, price })
    }

    /// The fewest samples within the limit, by bisection: the error falls with the number of
    /// samples.
    fn sampled(&mut self, from: Candidate, limit: Limit) -> Result<Candidate> {
        if from.fitter.recipe().pupil_model != PupilModel::BandLimited || !from.fitter.model().telescope.is_fine() {
            // The samples of a map are fixed.
            return Ok(from);
        }
        if self.given.estimate.samples.is_some() {
            return Ok(from);
        }
        let own = from.scene.pupil.samples;
        let truth = from.scene.aberrations.as_ref().and_then(|aberrations| aberrations.truth_samples);
        let most = truth.unwrap_or(usize::MAX).min(4 * own);
        let sizes: Vec<usize> = SAMPLES.into_iter().filter(|&samples| samples <= most).collect();
        let (mut good, mut too_few, mut enough) = (None, 0, sizes.len());
        while too_few < enough {
            let middle = (too_few + enough) / 2;
            let scene = from.scene.with(|sections| sections.estimate.samples = Some(sizes[middle]))?;
            let candidate = self.candidate(&from.fitter, &scene)?;
            let fits = limit.allows(&candidate.price);
            self.note("estimate.samples", sizes[middle].to_string(), candidate.price);
            if fits {
                (good, enough) = (Some(candidate), middle);
            } else {
                too_few = middle + 1;
            }
        }
        let best = good.unwrap_or(from);
        // Those that a larger defocus needs are more than the pupil's.
        let kept = best.fitter.model().optics.sampling().samples.to_string();
        self.keep("estimate.samples", &kept);
        Ok(best)
    }

    /// The fewest wavelengths within the limit: the work is proportional to their number.
    fn fewer_wavelengths(&mut self, from: Candidate, limit: Limit) -> Result<Candidate> {
        let own = from.fitter.model().optics.parts().colours.len();
        if own == 1 || self.given.estimate.wavelengths.is_some() {
            return Ok(from);
        }
        for count in 1..own {
            let scene = from.scene.with(|sections| sections.estimate.wavelengths = Some(count))?;
            let candidate = self.candidate(&from.fitter, &scene)?;
            self.note("estimate.wavelengths", count.to_string(), candidate.price);
            if limit.allows(&candidate.price) && candidate.price.megaflops < from.price.megaflops {
                self.keep("estimate.wavelengths", &count.to_string());
                return Ok(candidate);
            }
        }
        Ok(from)
    }

    /// The narrowest crop within the limit.
    fn cropped(&mut self, from: Candidate, limit: Limit) -> Result<Candidate> {
        if !matches!(self.given.image.crop_pixels, Crop::Auto) {
            return Ok(from);
        }
        let preparation = from.fitter.model().preparation;
        let native = |pixels: usize| (pixels as f64 * preparation.native_along(0)).round() as usize;
        let own = native(preparation.pixels);
        // The crop that the model chose by itself is written into the plan, so that it is the same
        // when it is read again.
        let cropped =
            |scene: &System, pixels: usize| scene.with(|sections| sections.image.crop_pixels = Crop::Pixels(pixels));
        let scene = cropped(&from.scene, own)?;
        self.note("image.crop_pixels", own.to_string(), from.price);
        let mut best = Candidate { scene, ..from };
        for step in 1..=CROPS {
            let Some(pixels) = preparation.pixels.checked_sub(step * CROP_STEP).filter(|&pixels| pixels >= 16) else {
                break;
            };
            let scene = cropped(&best.scene, native(pixels))?;
            let candidate = self.candidate(&best.fitter, &scene)?;
            self.note("image.crop_pixels", native(pixels).to_string(), candidate.price);
            if !limit.allows(&candidate.price) {
                break;
            }
            if candidate.price.megaflops < CROP_WORK * best.price.megaflops {
                best = candidate;
            }
        }
        if let Crop::Pixels(pixels) = best.scene.image.crop_pixels {
            self.keep("image.crop_pixels", &pixels.to_string());
        }
        Ok(best)
    }

    fn single_precision(&mut self, from: Candidate, limit: Limit) -> Result<Candidate> {
        let scene = from.scene.with(|sections| sections.estimate.precision = Some(Precision::F32))?;
        self.change_if_cheaper(from, &scene, ("estimate.precision", "\"f32\""), limit)
    }

    /// The loosest step tolerance within the limit.
    fn stopped_early(&mut self, mut best: Candidate, limit: Limit) -> Result<Candidate> {
        if self.given.estimate.step_tolerance_nm.is_some() {
            return Ok(best);
        }
        for fraction in TOLERANCES {
            let value_nm = rounded(fraction * self.budget_nm);
            let scene = best.scene.with(|sections| sections.estimate.step_tolerance_nm = Some(value_nm))?;
            best =
                self.change_if_cheaper(best, &scene, ("estimate.step_tolerance_nm", &value_nm.to_string()), limit)?;
            if self.choices.last().is_some_and(|choice| choice.kept) {
                break;
            }
        }
        Ok(best)
    }

    /// The cost with half of the Karhunen-Loève modes, which is reported and never chosen: the
    /// wavefronts that are drawn have few of the modes that a telescope may have.
    fn price_half_the_modes(&mut self, best: &Candidate) -> Result<()> {
        let modes = &best.scene.modes;
        if modes.ncpa != NcpaBasis::Kl || modes.ncpa_count < 2 {
            return Ok(());
        }
        let half = modes.ncpa_count / 2;
        let scene = best.scene.with(|sections| sections.modes.ncpa_count = half)?;
        let candidate = self.candidate(&best.fitter, &scene)?;
        self.note("modes.ncpa_count", half.to_string(), candidate.price);
        Ok(())
    }

    /// `scene`, which is that of `best` with another value of a key, where that is within the limit
    /// and less work; else `best`.
    fn change_if_cheaper(
        &mut self,
        best: Candidate,
        scene: &System,
        (key, value): (&'static str, &str),
        limit: Limit,
    ) -> Result<Candidate> {
        let candidate = self.candidate(&best.fitter, scene)?;
        self.note(key, value.to_string(), candidate.price);
        // Single precision takes as many operations, each of half the time.
        let cheaper = candidate.price.megaflops < best.price.megaflops || key == "estimate.precision";
        if limit.allows(&candidate.price) && cheaper {
            self.keep(key, value);
            return Ok(candidate);
        }
        Ok(best)
    }

    fn candidate(&self, like: &ModalFitter, scene: &System) -> Result<Candidate> {
        let fitter = like.variant(scene, recipe(scene))?;
        let price = self.trials.price(&fitter, self.control)?;
        Ok(Candidate { scene: scene.clone(), fitter, price })
    }

    fn note(&mut self, key: &'static str, value: String, price: Price) {
        self.choices.push(TriedValue { channel: None, key, value, kept: false, price });
    }

    /// Marks the value of `key` that is kept.
    fn keep(&mut self, key: &str, value: &str) {
        for choice in self.choices.iter_mut().filter(|choice| choice.key == key) {
            choice.kept = choice.value == value;
        }
    }
}

/// Rounds to one significant digit, so that the tolerance is readable in a scene.
fn rounded(value: f64) -> f64 {
    let unit = 10f64.powf(value.log10().floor());
    // Through text, so that 3 × 0.1 is 0.3.
    format!("{:e}", (value / unit).round() * unit).parse().map_or(value, |v: f64| (v * 1e12).round() / 1e12)
}
