//! Optics that are not the scene's, found from a few of the images where these say so.
//!
//! A pupil that is 1 % wider in the model than it is puts the rim of the defocused spot a third of a pixel off, all round;
//! a vane that the model does not have is a line of shadow: no likely wavefront explains that. What is minimised by each
//! retrieval, χ² and how improbable its wavefront is, has a sharp minimum where the optics are right.
//!
//! Numbers of the scene are sought one by one, in steps. The amplitudes of the segments are among the unknowns of a
//! retrieval (`amplitudes`): one look at a few images tells them all. Whatever explains the images best is taken first;
//! what explains them ends the search.

use super::optics_estimate::OpticsFound;
use super::prior::Spectrum;
use super::retriever::{RetrievalRecipe, Retriever};
use crate::estimate::Cube;
use crate::imaging::Choice;
use crate::optimize::CancelFlag;
use crate::scene::Scene;
use crate::telescope::Telescope;
use crate::{Error, Result};
use ndarray::{Array2, Array3, Axis};
use std::ops::RangeInclusive;

/// Images that are asked: the minima are sharp.
const ASKED: usize = 6;

/// χ² per degree of freedom from which on optics are sought: 1.4 to 1.6 is what frozen turbulence leaves of a bright star,
/// 4.2 what exposures of 10 ms do, spiders of an inch that the scene does not have 5.
pub(crate) const CALLS: f64 = 3.0;

/// Optics that lower what is minimised by less are no better than the scene's.
const WORTH: f64 = 0.8;

/// A search that has met this many times the least goes no farther that way.
const STEEP: f64 = 4.0;

/// Most unknowns that are taken up, one after another.
const ROUNDS: usize = 4;

/// RMS that amplitudes of segments are expected to have where they scatter; how much hardly matters to a bright star.
const AMPLITUDE_RMS: f64 = 0.05;

/// A number of the scene that may be another.
struct Unknown {
    key: &'static str,
    /// What the scene says.
    own: f64,
    range: RangeInclusive<f64>,
    /// The minimum is about as wide to either side as the first step.
    first_step: f64,
    /// Where the search ends: the error that it leaves raises χ² by some hundredths.
    last_step: f64,
}

impl Unknown {
    fn all(scene: &Scene) -> Vec<Self> {
        let sampling = scene.image.samples_per_lambda_over_d;
        let mut all = vec![Self {
            key: "image.samples_per_lambda_over_d",
            own: sampling,
            range: 0.97 * sampling..=1.03 * sampling,
            first_step: 0.01 * sampling,
            last_step: 0.0003 * sampling,
        }];
        // A pupil from a file has its shadows in it.
        if let Some(width_m) = scene.pupil.extent_m() {
            let shadow = |key, own: f64, farthest: f64, first_step, last_step| Self {
                key,
                own,
                range: 0.0..=(farthest * width_m).max(1.5 * own),
                first_step: first_step * width_m,
                last_step: last_step * width_m,
            };
            // As fractions of the pupil's width, for half a percent of its light and less: 10 cm of an obscuration's
            // diameter on Keck, and 1 cm of the spider's width.
            all.push(shadow("pupil.central_obscuration_m", scene.pupil.central_obscuration_m, 0.5, 1e-2, 2.5e-4));
            all.push(shadow("pupil.spider_width_m", scene.pupil.spider_width_m, 0.01, 1e-3, 5e-5));
        }
        all
    }

    /// The place of the least `merit` within the range, and its value, from where it is known.
    fn minimum(&self, known: (f64, f64), mut merit: impl FnMut(f64) -> Result<f64>) -> Result<(f64, f64)> {
        let mut best = known;
        for side in [-1.0, 1.0] {
            for step in 1.. {
                let value = known.0 + side * f64::from(step) * self.first_step;
                if !self.range.contains(&value) {
                    break;
                }
                let found = merit(value)?;
                if found < best.1 {
                    best = (value, found);
                }
                if found > STEEP * best.1 {
                    break;
                }
            }
        }
        let mut step = self.first_step / 2.0;
        // Where half and quarter steps lead nowhere nothing is off that χ² would call for.
        while step > self.last_step && (best.0 != known.0 || step > self.first_step / 5.0) {
            for value in [best.0 - step, best.0 + step] {
                if !self.range.contains(&value) {
                    continue;
                }
                let found = merit(value)?;
                if found < best.1 {
                    best = (value, found);
                    break;
                }
            }
            step /= 2.0;
        }
        Ok(best)
    }
}

/// Optics on trial.
#[derive(Clone)]
struct Optics {
    scene: Scene,
    /// Of the segments; none where all are alike.
    amplitudes: Vec<f64>,
}

impl Optics {
    fn with(&self, key: &str, value: f64) -> Result<Self> {
        Ok(Self { scene: self.scene.with(&[(key, &value.to_string())])?, amplitudes: self.amplitudes.clone() })
    }

    fn telescope(&self) -> Result<Telescope> {
        let telescope = Telescope::of(&self.scene)?;
        if self.amplitudes.is_empty() { Ok(telescope) } else { telescope.with_amplitudes(self.amplitudes.clone()) }
    }
}

/// What the images say of optics.
struct Answer {
    /// Medians over the images.
    reduced_chi2: f64,
    reduced_objective: f64,
    /// Logarithm of the amplitude of each segment over that of the optics, if asked.
    ln_amplitudes: Vec<f64>,
}

impl Answer {
    fn explains(&self) -> bool {
        self.reduced_chi2 <= CALLS
    }
}

/// The images that are asked.
struct Witness<'a> {
    images_e: Array3<f64>,
    bad: Array3<bool>,
    read_noise_e: Option<f64>,
    prior: &'a Spectrum,
    recipe: &'a RetrievalRecipe,
    cancel: Option<&'a CancelFlag>,
}

impl Witness<'_> {
    fn ask(&self, optics: &Optics, segment_amplitude_rms: f64) -> Result<Answer> {
        // Six images of optics that are never asked again are not worth compiling kernels for.
        let recipe = RetrievalRecipe { segment_amplitude_rms, device: Choice::Cpu, ..self.recipe.clone() };
        let retriever = Retriever::with_telescope(&optics.scene, optics.telescope()?, self.prior, recipe)?;
        let cube = Cube { images_e: self.images_e.view(), bad: self.bad.view(), read_noise_e: self.read_noise_e };
        let phases = retriever.retrieve(cube, None, self.cancel, &|_| {})?;
        let unusable = || Error::Image("no image can be used".into());
        let reports = &phases.reports;
        Ok(Answer {
            reduced_chi2: median(reports.iter().map(|report| report.reduced_chi2)).ok_or_else(unusable)?,
            reduced_objective: median(reports.iter().map(|report| report.reduced_objective)).ok_or_else(unusable)?,
            ln_amplitudes: medians(&phases.ln_amplitudes).ok_or_else(unusable)?,
        })
    }

    /// Of optics that differ from `optics` in one thing, those that explain the images best, or the first that explain them.
    fn best(&self, optics: &Optics, answer: &Answer) -> Result<(Optics, Answer)> {
        let amplitudes = self.amplitudes(optics)?;
        let its = self.ask(&amplitudes, 0.0)?;
        let mut best = (amplitudes, its);
        for unknown in Unknown::all(&optics.scene) {
            if best.1.explains() {
                break;
            }
            let tried = self.number(optics, &unknown, answer.reduced_objective)?;
            let its = self.ask(&tried, 0.0)?;
            if its.reduced_objective < best.1.reduced_objective {
                best = (tried, its);
            }
        }
        Ok(best)
    }

    /// A telescope otherwise like `optics`, whose merit is known, with the best value of `unknown`.
    fn number(&self, optics: &Optics, unknown: &Unknown, merit: f64) -> Result<Optics> {
        let glass = optics.telescope()?.pupil.amplitude;
        let (value, _) = unknown.minimum((unknown.own, merit), |value| {
            let tried = optics.with(unknown.key, value)?;
            // An obscuration within the segment that is missing obscures nothing.
            if unknown.key.starts_with("pupil.") && tried.telescope()?.pupil.amplitude == glass {
                return Ok(merit);
            }
            Ok(self.ask(&tried, 0.0)?.reduced_objective)
        })?;
        optics.with(unknown.key, value)
    }

    /// A telescope otherwise like `optics` with the amplitudes of the segments that the images show.
    fn amplitudes(&self, optics: &Optics) -> Result<Optics> {
        let ln = self.ask(optics, AMPLITUDE_RMS)?.ln_amplitudes;
        let known = optics.amplitudes.iter().copied().chain(std::iter::repeat(1.0));
        let amplitudes = ln.iter().zip(known).map(|(ln, known)| known * ln.exp()).collect();
        Ok(Optics { amplitudes, scene: optics.scene.clone() })
    }
}

/// The optics of `scene` that explain `images`, where its own do not and others do.
///
/// # Errors
/// Those of making retrievers; [`Error::Interrupted`].
pub(crate) fn found(
    scene: &Scene,
    prior: &Spectrum,
    recipe: &RetrievalRecipe,
    cube: Cube,
    cancel: Option<&CancelFlag>,
) -> Result<OpticsFound> {
    let count = cube.images_e.dim().0;
    let asked: Vec<usize> = (0..ASKED.min(count)).map(|i| i * count / ASKED.min(count)).collect();
    let (images_e, bad) = (cube.images_e.select(Axis(0), &asked), cube.bad.select(Axis(0), &asked));
    let witness = Witness { images_e, bad, read_noise_e: cube.read_noise_e, prior, recipe, cancel };
    let mut optics = Optics { scene: scene.clone(), amplitudes: Vec::new() };
    let mut answer = match witness.ask(&optics, 0.0) {
        // What is wrong with images is told where all of them are read.
        Err(Error::Image(_)) => return OpticsFound::of(scene, optics.scene, optics.amplitudes),
        answer => answer?,
    };
    for _ in 0..ROUNDS {
        if answer.explains() {
            break;
        }
        let (tried, its) = witness.best(&optics, &answer)?;
        if its.reduced_objective >= WORTH * answer.reduced_objective {
            break;
        }
        (optics, answer) = (tried, its);
    }
    OpticsFound::of(scene, optics.scene, optics.amplitudes)
}

/// Those that are finite; none of none.
fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

/// Of each column: an image that met a wrong minimum has no say.
fn medians(values: &Array2<f64>) -> Option<Vec<f64>> {
    values.columns().into_iter().map(|column| median(column.iter().copied())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::retrieval::tests::{draw, prior, scene};
    use std::cell::Cell;

    /// What a reader with `read` makes of three images of a telescope with `made` and segments of `amplitudes`.
    fn told(made: &[(&str, &str)], amplitudes: &[f64], read: &[(&str, &str)]) -> OpticsFound {
        let (recipe, made, read) =
            (RetrievalRecipe::default(), scene().with(made).unwrap(), scene().with(read).unwrap());
        let telescope = Optics { scene: made.clone(), amplitudes: amplitudes.to_vec() }.telescope().unwrap();
        let retriever = Retriever::with_telescope(&made, telescope, &prior(), recipe.clone()).unwrap();
        let images_e = draw(&retriever, &prior(), 3, true).images_e;
        let bad = images_e.mapv(|_| false);
        let images = Cube { images_e: images_e.view(), bad: bad.view(), read_noise_e: None };
        let spectrum =
            Spectrum::of_scene(&read, crate::retrieval::Unknown { piston_rms_nm: 0.0, ncpa_rms_nm: 40.0 }).unwrap();
        found(&read, &spectrum, &recipe, images, None).unwrap()
    }

    #[test]
    fn optics_that_are_the_scenes_are_left_alone() {
        let found = told(&[], &[], &[]);
        assert_eq!((found.plate_scale, &found.segment_reflectivities[..]), (1.0, &[][..]));
        assert_eq!((found.central_obscuration_m, found.spider_width_m), (None, None));
        assert!(found.warnings().is_empty());
    }

    #[test]
    fn a_plate_scale_that_is_not_the_scenes_is_found() {
        let found = told(&[], &[], &[("image.samples_per_lambda_over_d", "2.04")]);
        // The last step is 0.03 % or more, and so is the noise of three images of a pupil half as wide as Keck's.
        assert!((1.02 * found.plate_scale - 1.0).abs() < 1e-3, "{found:?}");
        assert_eq!(found.warnings().len(), 1, "{:?}", found.warnings());
    }

    #[test]
    fn an_obscuration_that_the_scene_does_not_have_is_found() {
        let found = told(&[("pupil.central_obscuration_m", "0.7")], &[], &[]);
        let metres = found.central_obscuration_m.unwrap();
        // Some steps of 1.3 mm, the last one on a pupil of 5 m.
        assert!((metres - 0.7).abs() < 0.01, "{metres}");
        assert_eq!((found.plate_scale, found.spider_width_m), (1.0, None));
    }

    #[test]
    fn segments_that_reflect_differently_are_found() {
        let amplitudes = [1.03, 0.98, 1.0, 0.97, 1.02, 0.99, 1.01];
        let found = told(&[], &amplitudes, &[]);
        let known = Telescope::of(&scene()).unwrap().with_amplitudes(amplitudes.to_vec()).unwrap();
        for (found, amplitude) in found.segment_reflectivities.iter().zip(known.amplitudes()) {
            // Three images behind turbulence that the model's samples are too coarse for; the amplitudes scatter by 0.02.
            assert!((found.sqrt() - amplitude).abs() < 0.005, "{found} {amplitude}");
        }
        assert_eq!(found.segment_reflectivities.len(), 7);
        assert_eq!((found.plate_scale, found.central_obscuration_m, found.spider_width_m), (1.0, None, None));
    }

    #[test]
    fn a_search_ends_at_the_minimum_and_beyond_no_wall() {
        let unknown = Unknown { key: "", own: 0.0, range: 0.0..=9.0, first_step: 1.0, last_step: 0.01 };
        let tries = Cell::new(0);
        let bowl = |at: f64| move |value: f64| Ok(1.0 + (value - at).powi(2));
        // Within the last step.
        let near = unknown.minimum((0.0, 17.0), bowl(4.0 / 1.3)).unwrap();
        assert!((near.0 - 4.0 / 1.3).abs() < 0.01, "{near:?}");
        let steep = |value: f64| {
            tries.set(tries.get() + 1);
            bowl(0.0)(value)
        };
        assert_eq!(unknown.minimum((0.0, 1.0), steep).unwrap(), (0.0, 1.0));
        // Steps of 1 and 2 up the wall, then a half and a quarter.
        assert_eq!(tries.get(), 4);
    }
}
