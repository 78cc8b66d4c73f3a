//! Search for the optics of the images where those of the scene do not explain them.
//!
//! A pupil that is 1 % wider in the model than in the telescope moves the rim of the defocused spot by a third of a pixel all
//! round, and a vane that the model lacks is a line of shadow: no likely wavefront explains either. The minimum of a retrieval's
//! objective, χ² plus the prior's term, is a sharp function of the optics with its minimum at the right ones.
//!
//! Numbers of the scene are searched one by one, in steps that are halved. The amplitudes of the segments are unknowns of a
//! retrieval themselves (`segment_amplitudes`), so one retrieval of a few images estimates all of them. In each round the change
//! that lowers the objective most is adopted; the search ends where the images are explained.

use super::optics_estimate::RetrievedOptics;
use super::prior::RadialPsd;
use super::retriever::Retriever;
use super::settings::RetrievalSettings;
use crate::imaging::Choice;
use crate::modal::Cube;
use crate::optimize::CancelFlag;
use crate::scene::Scene;
use crate::statistics::upper_median;
use crate::telescope::Telescope;
use crate::{Error, Result};
use ndarray::{Array2, Array3, Axis};
use std::ops::RangeInclusive;

/// Images of the search: few, because the minima are sharp.
const SEARCH_IMAGES: usize = 6;

/// Reduced χ² above which other optics are searched for: frozen turbulence behind a bright star leaves 1.4 to 1.6, exposures of
/// 10 ms leave 4.2, and spiders of an inch that the scene lacks leave 5.
pub(crate) const OPTICS_SEARCH_CHI2: f64 = 3.0;

/// Largest ratio of the objectives with other optics and with the current ones at which the others are adopted.
const ADOPTION_RATIO: f64 = 0.8;

/// Ratio to the least objective at which a search in one direction ends.
const END_RATIO: f64 = 4.0;

/// Most rounds, each of which adopts one change of the optics.
const MAX_ROUNDS: usize = 4;

/// Prior RMS of the segments' amplitudes where they are unknowns; the data of a bright star dominate it.
const AMPLITUDE_RMS: f64 = 0.05;

/// A number of the scene that is searched for.
struct OpticsParameter {
    key: &'static str,
    /// Value in the scene.
    own: f64,
    range: RangeInclusive<f64>,
    /// About the half-width of the minimum.
    first_step: f64,
    /// Step at which the search ends: the remaining error raises χ² by some hundredths.
    last_step: f64,
}

impl OpticsParameter {
    /// Parameters that can be searched for in `scene`.
    fn all(scene: &Scene) -> Vec<Self> {
        let sampling = scene.image.samples_per_lambda_over_d;
        let mut all = vec![Self {
            key: "image.samples_per_lambda_over_d",
            own: sampling,
            range: 0.97 * sampling..=1.03 * sampling,
            first_step: 0.01 * sampling,
            last_step: 0.0003 * sampling,
        }];
        // A pupil from a file includes its shadows.
        if let Some(width_m) = scene.pupil.extent_m() {
            let shadow = |key, own: f64, farthest: f64, first_step, last_step| Self {
                key,
                own,
                range: 0.0..=(farthest * width_m).max(1.5 * own),
                first_step: first_step * width_m,
                last_step: last_step * width_m,
            };
            // As fractions of the pupil's width, for half a percent of its area and less: on Keck 10 cm of an obscuration's
            // diameter and 1 cm of the spider's width.
            all.push(shadow("pupil.central_obscuration_m", scene.pupil.central_obscuration_m, 0.5, 1e-2, 2.5e-4));
            all.push(shadow("pupil.spider_width_m", scene.pupil.spider_width_m, 0.01, 1e-3, 5e-5));
        }
        all
    }

    /// Finds the value within the range at which `merit` is least, and that merit, from a value with `known` merit.
    fn find_minimum(&self, known: (f64, f64), mut merit: impl FnMut(f64) -> Result<f64>) -> Result<(f64, f64)> {
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
                if found > END_RATIO * best.1 {
                    break;
                }
            }
        }
        let mut step = self.first_step / 2.0;
        // Half and quarter steps that lower nothing rule out an error that χ² would show.
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

/// Trial optics.
#[derive(Clone)]
struct TrialOptics {
    scene: Scene,
    /// Amplitudes of the segments; empty where all are alike.
    amplitudes: Vec<f64>,
}

impl TrialOptics {
    fn with(&self, key: &str, value: f64) -> Result<Self> {
        Ok(Self { scene: self.scene.with(&[(key, &value.to_string())])?, amplitudes: self.amplitudes.clone() })
    }

    fn telescope(&self) -> Result<Telescope> {
        let telescope = Telescope::new(&self.scene)?;
        if self.amplitudes.is_empty() { Ok(telescope) } else { telescope.with_amplitudes(self.amplitudes.clone()) }
    }
}

/// Merit of trial optics.
struct OpticsMerit {
    /// Median over the images.
    reduced_chi2: f64,
    /// Median over the images.
    reduced_objective: f64,
    /// Logarithm of the amplitude of each segment over that of the optics, where amplitudes were unknowns.
    ln_amplitudes: Vec<f64>,
}

impl OpticsMerit {
    fn explains_images(&self) -> bool {
        self.reduced_chi2 <= OPTICS_SEARCH_CHI2
    }
}

/// Search on a few images.
struct OpticsSearch<'a> {
    images_e: Array3<f64>,
    bad: Array3<bool>,
    read_noise_e: Option<f64>,
    prior: &'a RadialPsd,
    settings: &'a RetrievalSettings,
    cancel: Option<&'a CancelFlag>,
}

impl OpticsSearch<'_> {
    /// Retrieves the images with trial optics.
    fn evaluate(&self, optics: &TrialOptics, segment_amplitude_rms: f64) -> Result<OpticsMerit> {
        // Compiling kernels for six images of optics that are used once does not pay.
        let settings = RetrievalSettings { segment_amplitude_rms, device: Choice::Cpu, ..self.settings.clone() };
        let retriever = Retriever::new(&optics.scene, optics.telescope()?, self.prior, settings)?;
        let cube = Cube { images_e: self.images_e.view(), bad: self.bad.view(), read_noise_e: self.read_noise_e };
        let wavefronts = retriever.retrieve(cube, None, self.cancel, &|_| {})?;
        let unusable = || Error::Image("no image can be used".into());
        let reports = &wavefronts.reports;
        Ok(OpticsMerit {
            reduced_chi2: finite_median(reports.iter().map(|report| report.reduced_chi2)).ok_or_else(unusable)?,
            reduced_objective: finite_median(reports.iter().map(|report| report.reduced_objective))
                .ok_or_else(unusable)?,
            ln_amplitudes: column_medians(&wavefronts.ln_amplitudes).ok_or_else(unusable)?,
        })
    }

    /// Finds, among optics that differ from `optics` in one parameter, those of least objective, or the first that explain the
    /// images.
    fn best_change(&self, optics: &TrialOptics, merit: &OpticsMerit) -> Result<(TrialOptics, OpticsMerit)> {
        let amplitudes = self.with_amplitudes(optics)?;
        let trial = self.evaluate(&amplitudes, 0.0)?;
        let mut best = (amplitudes, trial);
        for parameter in OpticsParameter::all(&optics.scene) {
            if best.1.explains_images() {
                break;
            }
            let tried = self.with_best_value(optics, &parameter, merit.reduced_objective)?;
            let trial = self.evaluate(&tried, 0.0)?;
            if trial.reduced_objective < best.1.reduced_objective {
                best = (tried, trial);
            }
        }
        Ok(best)
    }

    /// `optics`, whose objective is `merit`, with the best value of `parameter`.
    fn with_best_value(&self, optics: &TrialOptics, parameter: &OpticsParameter, merit: f64) -> Result<TrialOptics> {
        let amplitude = optics.telescope()?.pupil.amplitude;
        let (value, _) = parameter.find_minimum((parameter.own, merit), |value| {
            let tried = optics.with(parameter.key, value)?;
            // An obscuration within the missing segment changes nothing.
            if parameter.key.starts_with("pupil.") && tried.telescope()?.pupil.amplitude == amplitude {
                return Ok(merit);
            }
            Ok(self.evaluate(&tried, 0.0)?.reduced_objective)
        })?;
        optics.with(parameter.key, value)
    }

    /// `optics` with the amplitudes of the segments estimated from the images.
    fn with_amplitudes(&self, optics: &TrialOptics) -> Result<TrialOptics> {
        let ln = self.evaluate(optics, AMPLITUDE_RMS)?.ln_amplitudes;
        let known = optics.amplitudes.iter().copied().chain(std::iter::repeat(1.0));
        let amplitudes = ln.iter().zip(known).map(|(ln, known)| known * ln.exp()).collect();
        Ok(TrialOptics { amplitudes, scene: optics.scene.clone() })
    }
}

/// Estimates the optics of the images of `cube` where those of `scene` do not explain them and others do.
///
/// # Errors
/// Those of making retrievers; [`Error::Interrupted`].
pub(crate) fn estimate_optics(
    scene: &Scene,
    prior: &RadialPsd,
    settings: &RetrievalSettings,
    cube: Cube,
    cancel: Option<&CancelFlag>,
) -> Result<RetrievedOptics> {
    let count = cube.images_e.dim().0;
    let chosen: Vec<usize> = (0..SEARCH_IMAGES.min(count)).map(|i| i * count / SEARCH_IMAGES.min(count)).collect();
    let (images_e, bad) = (cube.images_e.select(Axis(0), &chosen), cube.bad.select(Axis(0), &chosen));
    let search = OpticsSearch { images_e, bad, read_noise_e: cube.read_noise_e, prior, settings, cancel };
    let mut optics = TrialOptics { scene: scene.clone(), amplitudes: Vec::new() };
    let mut merit = match search.evaluate(&optics, 0.0) {
        // The retrieval of all images reports why they are unusable.
        Err(Error::Image(_)) => return RetrievedOptics::new(scene, optics.scene, optics.amplitudes),
        merit => merit?,
    };
    for _ in 0..MAX_ROUNDS {
        if merit.explains_images() {
            break;
        }
        let (tried, trial) = search.best_change(&optics, &merit)?;
        if trial.reduced_objective >= ADOPTION_RATIO * merit.reduced_objective {
            break;
        }
        (optics, merit) = (tried, trial);
    }
    RetrievedOptics::new(scene, optics.scene, optics.amplitudes)
}

/// Median of the finite values; `None` of none.
fn finite_median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
    if values.is_empty() { None } else { Some(upper_median(&values)) }
}

/// Median of each column: an image at a wrong minimum has no influence.
fn column_medians(values: &Array2<f64>) -> Option<Vec<f64>> {
    values.columns().into_iter().map(|column| finite_median(column.iter().copied())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::retrieval::tests::{draw, prior, scene};
    use std::cell::Cell;

    /// Optics that a retrieval of the scene `read` estimates from three images of a telescope with `made` and segments of `amplitudes`.
    fn estimated(made: &[(&str, &str)], amplitudes: &[f64], read: &[(&str, &str)]) -> RetrievedOptics {
        let (settings, made, read) =
            (RetrievalSettings::default(), scene().with(made).unwrap(), scene().with(read).unwrap());
        let telescope = TrialOptics { scene: made.clone(), amplitudes: amplitudes.to_vec() }.telescope().unwrap();
        let retriever = Retriever::new(&made, telescope, &prior(), settings.clone()).unwrap();
        let images_e = draw(&retriever, &prior(), 3, true).images_e;
        let bad = images_e.mapv(|_| false);
        let images = Cube { images_e: images_e.view(), bad: bad.view(), read_noise_e: None };
        let psd = RadialPsd::ao_residual(
            &read,
            crate::retrieval::StaticAberrationRms { piston_rms_nm: 0.0, ncpa_rms_nm: 40.0 },
        )
        .unwrap();
        estimate_optics(&read, &psd, &settings, images, None).unwrap()
    }

    #[test]
    fn optics_of_the_scene_are_left_unchanged() {
        let found = estimated(&[], &[], &[]);
        assert_eq!((found.plate_scale, &found.segment_reflectivities[..]), (1.0, &[][..]));
        assert_eq!((found.central_obscuration_m, found.spider_width_m), (None, None));
        assert!(found.warnings().is_empty());
    }

    #[test]
    fn another_plate_scale_is_estimated() {
        let found = estimated(&[], &[], &[("image.samples_per_lambda_over_d", "2.04")]);
        // The last step is 0.03 % or more, and so is the noise of three images of a pupil half as wide as Keck's.
        assert!((1.02 * found.plate_scale - 1.0).abs() < 1e-3, "{found:?}");
        assert_eq!(found.warnings().len(), 1, "{:?}", found.warnings());
    }

    #[test]
    fn a_missing_obscuration_is_estimated() {
        let found = estimated(&[("pupil.central_obscuration_m", "0.7")], &[], &[]);
        let metres = found.central_obscuration_m.unwrap();
        // Some steps of 1.3 mm, the last one on a pupil of 5 m.
        assert!((metres - 0.7).abs() < 0.01, "{metres}");
        assert_eq!((found.plate_scale, found.spider_width_m), (1.0, None));
    }

    #[test]
    fn segment_reflectivities_are_estimated() {
        let amplitudes = [1.03, 0.98, 1.0, 0.97, 1.02, 0.99, 1.01];
        let found = estimated(&[], &amplitudes, &[]);
        let known = Telescope::new(&scene()).unwrap().with_amplitudes(amplitudes.to_vec()).unwrap();
        for (found, amplitude) in found.segment_reflectivities.iter().zip(known.amplitudes()) {
            // Three images behind turbulence that the model's samples are too coarse for; the amplitudes scatter by 0.02.
            assert!((found.sqrt() - amplitude).abs() < 0.005, "{found} {amplitude}");
        }
        assert_eq!(found.segment_reflectivities.len(), 7);
        assert_eq!((found.plate_scale, found.central_obscuration_m, found.spider_width_m), (1.0, None, None));
    }

    #[test]
    fn the_search_ends_at_the_minimum_or_at_a_steep_rise() {
        let parameter = OpticsParameter { key: "", own: 0.0, range: 0.0..=9.0, first_step: 1.0, last_step: 0.01 };
        let tries = Cell::new(0);
        let bowl = |at: f64| move |value: f64| Ok(1.0 + (value - at).powi(2));
        // Within the last step.
        let near = parameter.find_minimum((0.0, 17.0), bowl(4.0 / 1.3)).unwrap();
        assert!((near.0 - 4.0 / 1.3).abs() < 0.01, "{near:?}");
        let steep = |value: f64| {
            tries.set(tries.get() + 1);
            bowl(0.0)(value)
        };
        assert_eq!(parameter.find_minimum((0.0, 1.0), steep).unwrap(), (0.0, 1.0));
        // Steps of 1 and 2 up the wall, then a half and a quarter.
        assert_eq!(tries.get(), 4);
    }
}
