//! Search for the optics of the images where those of the scene do not explain them.
//!
//! A pupil that is 1 % wider in the model than in the telescope moves the rim of the defocused spot
//! by a third of a pixel all round, and a vane that the model lacks is a line of shadow: no likely
//! wavefront explains either. The minimum of a retrieval's objective, χ² plus the prior's term, is
//! a sharp function of the optics with its minimum at the right ones.
//!
//! Numbers of the scene are searched one by one, in steps that are halved. The amplitudes of the
//! segments are unknowns of a retrieval themselves (`segment_amplitudes`), so one retrieval of a
//! few images estimates all of them. In each round the change that lowers the objective most is
//! adopted; the search ends where the images are explained.

use super::optics_estimate::RetrievedOptics;
use super::optics_parameter::SearchedParameter;
use super::prior::RadialPsd;
use super::retriever::Retriever;
use super::settings::RetrievalSettings;
use crate::control::Control;
use crate::imaging::Choice;
use crate::modal::Cube;
use crate::scene::{Parameter, ParameterKind, System};
use crate::statistics::upper_median;
use crate::telescope::Telescope;
use crate::{Error, Result};
use ndarray::{Array2, Array3, Axis};
use rayon::prelude::*;

/// Images of the search: few, because the minima are sharp.
const SEARCH_IMAGES: usize = 6;

/// Reduced χ² above which other optics are searched for: frozen turbulence behind a bright star
/// leaves 1.4 to 1.6, exposures of 10 ms leave 4.2, and spiders of an inch that the scene lacks
/// leave 5.
pub(crate) const OPTICS_SEARCH_CHI2: f64 = 3.0;

/// Reduced χ² above which another filter or other pixels are searched for, which takes few
/// evaluations: a filter of 1.5 % that the scene lacks leaves 2.2.
const CAMERA_SEARCH_CHI2: f64 = 1.1;

/// Largest ratio of the objectives with other optics and with the current ones at which the others
/// are adopted,
const ADOPTION_RATIO: f64 = 0.8;
/// and where only cameras are searched for: with the right filter it is 0.66 to 0.70 (1.5 % on
/// Keck, 3 % on seven segments), with the right pixels 0.87 (seven segments). In images that lack
/// nothing the best filter lowers the objective to 0.97 to 0.99.
const CAMERA_ADOPTION_RATIO: f64 = 0.9;

/// Parameters that are searched at once: making the model of a trial takes one core and as long as
/// its retrievals, and each has one in memory.
const PARAMETERS_AT_ONCE: usize = 2;

/// Most rounds, each of which adopts one change of the optics.
const MAX_ROUNDS: usize = 4;

/// Prior RMS of the segments' amplitudes where they are unknowns; the data of a bright star
/// dominate it.
const AMPLITUDE_RMS: f64 = 0.05;

/// Trial optics.
#[derive(Clone)]
struct TrialOptics {
    scene: System,
    /// Amplitudes of the segments; empty where all are alike.
    amplitudes: Vec<f64>,
}

impl TrialOptics {
    fn with(&self, parameter: &Parameter, value: f64) -> Result<Self> {
        let scene = self.scene.with(|sections| parameter.set(sections, value))?;
        Ok(Self { scene, amplitudes: self.amplitudes.clone() })
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
    /// Logarithm of the amplitude of each segment over that of the optics, where amplitudes were
    /// unknowns.
    ln_amplitudes: Vec<f64>,
    /// Most evaluations of an image, where it began without a wavefront.
    evaluations: usize,
    /// Coordinates of the images' wavefronts, from which trials of other optics begin; empty for
    /// trials that begin without.
    coordinates: Vec<Vec<f32>>,
}

impl OpticsMerit {
    fn explains_images(&self) -> bool {
        self.reduced_chi2 <= OPTICS_SEARCH_CHI2
    }

    /// Most evaluations of an image with other optics: better ones need no more than the current
    /// optics did, and worse ones need not be followed to their minimum.
    fn most_of_a_trial(&self) -> usize {
        if self.coordinates.is_empty() { self.evaluations + self.evaluations / 2 } else { self.evaluations }
    }
}

/// Search on a few images.
struct OpticsSearch<'a> {
    images_e: Array3<f64>,
    bad: Array3<bool>,
    read_noise_e: Option<f64>,
    prior: &'a RadialPsd,
    settings: &'a RetrievalSettings,
    control: Control,
}

impl OpticsSearch<'_> {
    /// Retrieves the images with optics of which nothing is known yet.
    fn evaluate(&self, optics: &TrialOptics, segment_amplitude_rms: f64) -> Result<OpticsMerit> {
        self.evaluate_from(&[], optics, optics.telescope()?, segment_amplitude_rms, usize::MAX)
    }

    /// Retrieves the images with trial optics, from the wavefronts of `merit` if it has some.
    fn evaluate_trial(&self, optics: &TrialOptics, telescope: Telescope, merit: &OpticsMerit) -> Result<OpticsMerit> {
        let trial = self.evaluate_from(&merit.coordinates, optics, telescope, 0.0, merit.most_of_a_trial())?;
        let evaluations = if merit.coordinates.is_empty() { trial.evaluations } else { merit.evaluations };
        Ok(OpticsMerit { evaluations, ..trial })
    }

    /// Retrieves the images with the trial optics `optics` of `telescope`, from `starts`, in `most`
    /// evaluations each.
    fn evaluate_from(
        &self,
        starts: &[Vec<f32>],
        optics: &TrialOptics,
        telescope: Telescope,
        segment_amplitude_rms: f64,
        most: usize,
    ) -> Result<OpticsMerit> {
        // Compiling kernels for six images of optics that are used once does not pay.
        let max_evaluations = most.min(self.settings.max_evaluations);
        let device = Choice::Cpu;
        let settings = RetrievalSettings {
            segment_amplitude_rms,
            device,
            max_evaluations,
            has_known_turbulence: false,
            ..self.settings.clone()
        };
        let retriever = Retriever::new(&optics.scene, telescope, self.prior, settings)?;
        let cube = Cube { images_e: self.images_e.view(), bad: self.bad.view(), read_noise_e: self.read_noise_e };
        let mut wavefronts = retriever.retrieve_from(starts, cube, &self.control)?;
        let unusable = || Error::Image("no image can be used".into());
        let reports = &wavefronts.reports;
        Ok(OpticsMerit {
            reduced_chi2: finite_median(reports.iter().map(|report| report.reduced_chi2)).ok_or_else(unusable)?,
            reduced_objective: finite_median(reports.iter().map(|report| report.reduced_objective))
                .ok_or_else(unusable)?,
            ln_amplitudes: column_medians(&wavefronts.ln_amplitudes).ok_or_else(unusable)?,
            evaluations: reports.iter().map(|report| report.evaluations).max().unwrap_or(0),
            coordinates: std::mem::take(&mut wavefronts.coordinates),
        })
    }

    /// Finds, among optics that differ from `optics` in one parameter, those of least objective, or
    /// the first that explain the images; `None` where none lowers the objective enough. Images
    /// that are explained but for a blur are tried with other cameras only.
    fn best_change(&self, optics: &TrialOptics, merit: &OpticsMerit) -> Result<Option<(TrialOptics, OpticsMerit)>> {
        if merit.reduced_chi2 <= CAMERA_SEARCH_CHI2 {
            return Ok(None);
        }
        let is_explained = merit.explains_images();
        let mut best: Option<(TrialOptics, OpticsMerit)> = None;
        if !is_explained {
            let amplitudes = self.with_amplitudes(optics)?;
            let trial = self.evaluate_trial(&amplitudes, amplitudes.telescope()?, merit)?;
            best = Some((amplitudes, trial));
        }
        let is_found = |best: &Option<(TrialOptics, OpticsMerit)>| {
            !is_explained && best.as_ref().is_some_and(|(_, trial)| trial.explains_images())
        };
        let mut parameters = SearchedParameter::all(&optics.scene);
        parameters.retain(|parameter| !is_explained || parameter.search.kind == ParameterKind::Camera);
        for some in parameters.chunks(PARAMETERS_AT_ONCE) {
            let changed: Vec<_> =
                some.par_iter().map(|parameter| self.with_best_value(optics, parameter, merit)).collect();
            for change in changed {
                if is_found(&best) {
                    break;
                }
                let Some((tried, trial)) = change? else { continue };
                if best.as_ref().is_none_or(|(_, least)| trial.reduced_objective < least.reduced_objective) {
                    best = Some((tried, trial));
                }
            }
            if is_found(&best) {
                break;
            }
        }
        let ratio = if is_explained { CAMERA_ADOPTION_RATIO } else { ADOPTION_RATIO };
        Ok(best.filter(|(_, trial)| trial.reduced_objective < ratio * merit.reduced_objective))
    }

    /// `optics` with the best value of `parameter`, and their merit; `None` where its own value, of
    /// `merit`, is the best.
    fn with_best_value(
        &self,
        optics: &TrialOptics,
        parameter: &SearchedParameter,
        merit: &OpticsMerit,
    ) -> Result<Option<(TrialOptics, OpticsMerit)>> {
        // Its pupil serves all trials with another camera or scale.
        let own = optics.telescope()?;
        let mut trials: Vec<(f64, OpticsMerit)> = Vec::new();
        let (value, _) = parameter.find_minimum((parameter.own, merit.reduced_objective), |value| {
            let tried = optics.with(parameter.parameter, value)?;
            let is_shadow = parameter.parameter.key.starts_with("pupil.");
            // An obscuration within the missing segment changes nothing.
            let telescope = if is_shadow { tried.telescope()? } else { own.clone() };
            if is_shadow && telescope.pupil.amplitude == own.pupil.amplitude {
                return Ok(merit.reduced_objective);
            }
            let trial = self.evaluate_trial(&tried, telescope, merit)?;
            let objective = trial.reduced_objective;
            trials.push((value, trial));
            Ok(objective)
        })?;
        let best = trials.into_iter().find(|(tried, _)| *tried == value);
        best.map(|(value, trial)| Ok((optics.with(parameter.parameter, value)?, trial))).transpose()
    }

    /// `optics` with the amplitudes of the segments estimated from the images.
    fn with_amplitudes(&self, optics: &TrialOptics) -> Result<TrialOptics> {
        let ln = self.evaluate(optics, AMPLITUDE_RMS)?.ln_amplitudes;
        let known = optics.amplitudes.iter().copied().chain(std::iter::repeat(1.0));
        let amplitudes = ln.iter().zip(known).map(|(ln, known)| known * ln.exp()).collect();
        Ok(TrialOptics { amplitudes, scene: optics.scene.clone() })
    }
}

/// Estimates the optics of the images of `cube` where those of `scene` do not explain them and
/// others do.
///
/// # Errors
/// Those of making retrievers; [`Error::Interrupted`].
pub(crate) fn estimate_optics(
    scene: &System,
    prior: &RadialPsd,
    settings: &RetrievalSettings,
    cube: Cube,
    control: &Control,
) -> Result<RetrievedOptics> {
    let count = cube.images_e.dim().0;
    let chosen: Vec<usize> = (0..SEARCH_IMAGES.min(count)).map(|i| i * count / SEARCH_IMAGES.min(count)).collect();
    let (images_e, bad) = (cube.images_e.select(Axis(0), &chosen), cube.bad.select(Axis(0), &chosen));
    let search =
        OpticsSearch { images_e, bad, read_noise_e: cube.read_noise_e, prior, settings, control: control.silent() };
    let mut optics = TrialOptics { scene: scene.clone(), amplitudes: Vec::new() };
    let mut merit = match search.evaluate(&optics, 0.0) {
        // The retrieval of all images reports why they are unusable.
        Err(Error::Image(_)) => return RetrievedOptics::new(scene, optics.scene, optics.amplitudes),
        merit => merit?,
    };
    for _ in 0..MAX_ROUNDS {
        if merit.reduced_chi2 <= CAMERA_SEARCH_CHI2 {
            break;
        }
        // Most often no other optics explain the images better, which trials show in 1 to 12
        // evaluations of an image from the wavefronts that were retrieved. These descend a little
        // further first, as those of all trials do.
        let descended = search.evaluate_trial(&optics, optics.telescope()?, &merit)?;
        if search.best_change(&optics, &descended)?.is_none() {
            break;
        }
        // From wavefronts with the wrong optics the best value would be off: a plate scale by 0.08
        // %.
        let without_wavefronts = OpticsMerit { coordinates: Vec::new(), ..merit };
        let Some(better) = search.best_change(&optics, &without_wavefronts)? else { break };
        (optics, merit) = better;
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

    /// Optics that a retrieval of the scene `read` estimates from three images of a telescope with
    /// `made` and segments of `amplitudes`.
    fn estimated(made: &[(&str, &str)], amplitudes: &[f64], read: &[(&str, &str)]) -> RetrievedOptics {
        let (settings, made, read) =
            (RetrievalSettings::default(), scene().with(made).unwrap(), scene().with(read).unwrap());
        let telescope =
            TrialOptics { scene: made.system().clone(), amplitudes: amplitudes.to_vec() }.telescope().unwrap();
        let retriever = Retriever::new(&made, telescope, &prior(), settings.clone()).unwrap();
        let images_e = draw(&retriever, &prior(), 3, true).images_e;
        let bad = images_e.mapv(|_| false);
        let images = Cube { images_e: images_e.view(), bad: bad.view(), read_noise_e: None };
        let psd = RadialPsd::ao_residual(
            &read,
            crate::retrieval::StaticAberrationRms { piston_rms_nm: 0.0, ncpa_rms_nm: 40.0 },
        )
        .unwrap();
        estimate_optics(&read, &psd, &settings, images, &Control::default()).unwrap()
    }

    /// The key and the estimate of the only number that differs.
    fn only_change(found: &RetrievedOptics) -> (String, f64) {
        assert_eq!((found.changes.len(), found.warnings().len()), (1, 1), "{:?}", found.warnings());
        assert!(found.segment_reflectivities.is_empty());
        (found.changes[0].key.clone(), found.changes[0].value)
    }

    #[test]
    #[ignore = "merge: 4 s"]
    fn optics_of_the_scene_are_left_unchanged() {
        let found = estimated(&[], &[], &[]);
        assert!(found.changes.is_empty() && found.segment_reflectivities.is_empty() && found.warnings().is_empty());
    }

    #[test]
    #[ignore = "merge: 32 s"]
    fn another_plate_scale_is_estimated() {
        let (key, sampling) = only_change(&estimated(&[], &[], &[("image.samples_per_lambda_over_d", "2.04")]));
        // The last step is 0.03 % or more, and so is the noise of three images of a pupil half as
        // wide as Keck's.
        assert!(key == "image.samples_per_lambda_over_d" && (sampling / 2.0 - 1.0).abs() < 1e-3, "{key} {sampling}");
    }

    #[test]
    #[ignore = "merge: 30 s"]
    fn a_missing_obscuration_is_estimated() {
        let (key, metres) = only_change(&estimated(&[("pupil.central_obscuration_m", "0.7")], &[], &[]));
        // Some steps of 1.3 mm, the last one on a pupil of 5 m.
        assert!(key == "pupil.central_obscuration_m" && (metres - 0.7).abs() < 0.01, "{key} {metres}");
    }

    #[test]
    #[ignore = "merge: 10 s"]
    fn the_width_of_the_filter_and_the_area_of_pixels_are_estimated() {
        for (key, value, tolerance) in [("image.bandwidth_fraction", 0.03, 0.003), ("image.pixel_fill", 1.0, 0.1)] {
            let (found, estimate) = only_change(&estimated(&[(key, &value.to_string())], &[], &[]));
            // Some steps of the search, the last one of 0.001 and 0.05 or more.
            assert!(found == key && (estimate - value).abs() <= tolerance, "{found} {estimate}");
        }
    }

    #[test]
    #[ignore = "merge: 9 s"]
    fn segment_reflectivities_are_estimated() {
        let amplitudes = [1.03, 0.98, 1.0, 0.97, 1.02, 0.99, 1.01];
        let found = estimated(&[], &amplitudes, &[]);
        let known = Telescope::new(&scene()).unwrap().with_amplitudes(amplitudes.to_vec()).unwrap();
        for (found, amplitude) in found.segment_reflectivities.iter().zip(known.amplitudes()) {
            // Three images behind turbulence that the model's samples are too coarse for; the
            // amplitudes scatter by 0.02.
            assert!((found.sqrt() - amplitude).abs() < 0.005, "{found} {amplitude}");
        }
        assert_eq!(found.segment_reflectivities.len(), 7);
        assert!(found.changes.is_empty(), "{found:?}");
    }
}
