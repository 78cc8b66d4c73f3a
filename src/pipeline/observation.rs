//! Plan of an observation of an artificial source: which defocuses, wavelengths and exposures reach
//! an error.
//!
//! Each candidate is simulated once, with the star of the scene at the same number of electrons an
//! exposure, and estimated as its images would be. Its error bars are from the Fisher information
//! of its images, and fall with the root of the number of exposures; errors that all images share
//! (`tolerance.defocus_fraction`) do not. A candidate whose estimate is flagged, or whose residual
//! is beyond three error bars, is not recommended: it does not find the wavefront of the scene's
//! `[aberrations]`.

use super::estimate::Estimate;
use super::estimator::Estimator;
use super::images::Images;
use super::modal::NOT_FITTED;
use super::policy::Policy;
use crate::control::{Control, Stage};
use crate::scene::{Method, Optic, Scene};
use crate::statics::ErrorTerm;
use crate::{Error, Result, source};
use std::path::Path;

/// Defocuses that are tried, waves RMS over the pupil. For Keck at one number of electrons, error
/// bars from 0.5 to 2 are within a fifth of each other; at 3 the light spreads beyond what 120
/// samples of the pupil hold.
const DEFOCUS_WAVES: [f64; 5] = [0.5, 1.0, 1.5, 2.0, 3.0];
/// Most exposures of a channel that are proposed.
const MOST_EXPOSURES: f64 = 10_000.0;
/// Error bars beyond which a residual is not that of its noise.
const BEYOND: f64 = 3.0;
/// Least difference of two combinations of whole wavelengths, in standard deviations, at which they
/// count as distinct: noise takes one for the other beyond half of it, in seven of a million
/// segments.
const DISTINCT: f64 = 9.0;

/// One way to observe.
#[derive(Debug, Clone)]
pub struct Observation {
    /// Wavelength, nm, and defocus, waves RMS, of each channel.
    pub channels: Vec<(f64, f64)>,
    /// Exposures of each channel that reach the budget; `None` where no number up to 10,000 does.
    pub exposures: Option<usize>,
    /// Electrons of the star in all exposures of all channels; of one exposure each where the
    /// budget is not reached.
    pub electrons: f64,
    /// Electrons of the brightest pixel of an exposure.
    pub peak_e: f64,
    /// Expected errors of phasing and NCPA, nm RMS, of these exposures.
    pub expected_nm: [f64; 2],
    /// Pistons about their mean within which whole wavelengths are determined, nm.
    pub piston_range_nm: f64,
    /// Why it does not find the wavefront of the scene, where it does not.
    pub flaw: Option<String>,
    /// The scene of the observation.
    pub scene: Scene,
}

impl Observation {
    /// Exposures of all channels together.
    pub fn total_exposures(&self) -> Option<usize> {
        self.exposures.map(|exposures| exposures * self.channels.len())
    }

    /// Writes the scene of the observation.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn write(&self, path: &Path) -> Result<()> {
        crate::atomic::write(path, self.scene.text().as_bytes())
    }

    fn is_recommended(&self) -> bool {
        self.exposures.is_some() && self.flaw.is_none()
    }
}

/// Ways to observe, the recommended one first.
#[derive(Debug, Clone)]
pub struct ObservationPlan {
    /// Error that is allowed to the phasing and to the NCPA, nm RMS.
    pub budget_nm: f64,
    /// The candidates: those that reach the budget, by their number of exposures, then the others.
    pub observations: Vec<Observation>,
}

impl ObservationPlan {
    /// The observation that reaches the budget with the fewest exposures.
    pub fn recommended(&self) -> Option<&Observation> {
        self.observations.first().filter(|observation| observation.is_recommended())
    }
}

/// Plans the observation of an artificial source: of the telescope, star and camera of `scene`,
/// through filters of `wavelengths_nm` (those of the scene's channels where there are none), so
/// that phasing and NCPA are each known to `budget_nm`. A candidate is a step of the progress.
///
/// # Errors
/// [`Error::Value`] for a budget or a wavelength that is not positive, [`Error::Scene`] for a scene
/// with an AO loop or with a diversity from a file, [`Error::Interrupted`] where `control` was
/// cancelled, and those of the estimator.
pub fn plan_observation(
    scene: &Scene,
    wavelengths_nm: &[f64],
    budget_nm: f64,
    control: &Control,
) -> Result<ObservationPlan> {
    if !(budget_nm.is_finite() && budget_nm > 0.0) {
        return Err(Error::Value(format!("a budget of {budget_nm} nm is not accepted: a positive number is needed")));
    }
    if let Some(odd) = wavelengths_nm.iter().find(|nm| !(nm.is_finite() && **nm > 0.0)) {
        return Err(Error::Value(format!("a wavelength of {odd} nm is not accepted: a positive number is needed")));
    }
    let base = Base::new(scene)?;
    let given = if wavelengths_nm.is_empty() { &base.wavelengths_nm } else { wavelengths_nm };
    let candidates = candidates(given);
    control.enter(Stage::Planning, candidates.len());
    let mut observations = Vec::new();
    for channels in &candidates {
        control.check("no observation was planned")?;
        observations.push(base.observation(channels, budget_nm, &control.silent())?);
        control.step(1);
    }
    let error_nm = |observation: &Observation| observation.expected_nm[0].max(observation.expected_nm[1]);
    observations.sort_by(|a, b| {
        let rank = |one: &Observation| (!one.is_recommended(), one.flaw.is_some(), one.total_exposures());
        rank(a).cmp(&rank(b)).then(error_nm(a).total_cmp(&error_nm(b)))
    });
    Ok(ObservationPlan { budget_nm, observations })
}

/// The sets of channels that are tried: one image, a pair on both sides of the focus, one image of
/// each wavelength.
fn candidates(wavelengths_nm: &[f64]) -> Vec<Vec<(f64, f64)>> {
    let first_nm = wavelengths_nm[0];
    let mut found = Vec::new();
    for waves in DEFOCUS_WAVES {
        found.push(vec![(first_nm, waves)]);
        found.push(vec![(first_nm, waves), (first_nm, -waves)]);
        if wavelengths_nm.len() > 1 {
            found.push(wavelengths_nm.iter().map(|&nm| (nm, waves)).collect());
        }
    }
    found
}

/// What the candidates share.
struct Base {
    /// The scene without channels, with the electrons of its star.
    scene: Scene,
    wavelengths_nm: Vec<f64>,
    flux_e: f64,
}

impl Base {
    fn new(scene: &Scene) -> Result<Self> {
        if scene.control.is_some() {
            return Err(Error::Scene(format!(
                "{}: an observation behind an AO loop is not planned, because its error bars are from the turbulence: a scene without \
                 [control] is accepted",
                scene.name()
            )));
        }
        if scene.image.diversity_file.is_some() {
            return Err(Error::Scene(format!(
                "{}: image.diversity_file is not planned: a scene with image.diversity_focus_waves_rms is accepted",
                scene.name()
            )));
        }
        let channels = scene.each_channel();
        let mut wavelengths_nm = Vec::new();
        for (_, own) in &channels {
            let nm = own.image.wavelength_nm;
            if !wavelengths_nm.contains(&nm) {
                wavelengths_nm.push(nm);
            }
        }
        let (_, one) = channels[0];
        let one = one.changed(|sections| {
            sections.image.count = 1;
            (sections.estimate.budget_nm, sections.estimate.method) = (None, Method::Modal);
        })?;
        let flux_e = source::simulate(&one)?[0].flux_e;
        let scene = one.changed(|sections| (sections.image.flux_e, sections.image.peak_snr) = (Some(flux_e), None))?;
        Ok(Self { scene, wavelengths_nm, flux_e })
    }

    /// The scene of some channels.
    fn scene_of(&self, channels: &[(f64, f64)]) -> Result<Scene> {
        // A pixel keeps its angle on the sky.
        let sampling = |nm: f64| self.scene.image.samples_per_lambda_over_d * nm / self.scene.image.wavelength_nm;
        let (nm, waves) = channels[0];
        let first = self.scene.changed(|sections| {
            sections.image.wavelength_nm = nm;
            for (optic, value) in [(Optic::PLATE_SCALE, sampling(nm)), (Optic::DEFOCUS, waves)] {
                optic.parameters().iter().for_each(|parameter| parameter.set(sections, value));
            }
        })?;
        if channels.len() == 1 {
            return Ok(first);
        }
        let each = channels.iter().enumerate().map(|(number, &(nm, waves))| {
            let values = [(Optic::PLATE_SCALE, sampling(nm)), (Optic::DEFOCUS, waves)];
            let of_optics = values.into_iter().filter_map(|(optic, value)| Some((optic.key()?, value)));
            ((number + 1).to_string(), [("image.wavelength_nm", nm)].into_iter().chain(of_optics).collect())
        });
        first.with_channels(&each.collect::<Vec<_>>())
    }

    fn observation(&self, channels: &[(f64, f64)], budget_nm: f64, control: &Control) -> Result<Observation> {
        let scene = self.scene_of(channels)?;
        let images = Images::simulated(&scene)?;
        let peak_e = images.iter().flat_map(|images| &images.images_e).copied().fold(0.0, f64::max);
        // A larger model is no remedy for a defocus that is too small.
        let policy = Policy { select_model: false, ..Policy::default() };
        let estimator = Estimator::with_policy(&scene, policy, control.clone())?;
        let (squares, flaw) = match estimator.estimate(&images) {
            Ok(found) => (split(&found.error_budget), flaw(&found)),
            // A star whose light fills the frame, for one.
            Err(Error::Image(sentence)) => ([[f64::INFINITY; 2], [0.0; 2]], Some(sentence)),
            Err(error) => return Err(error),
        };
        let [averaged, shared] = squares;
        let needed = (0..2).map(|part| averaged[part] / (budget_nm * budget_nm - shared[part]).max(0.0));
        let needed = needed.fold(1.0, f64::max).ceil();
        let exposures = (needed <= MOST_EXPOSURES).then_some(needed as usize);
        let count = exposures.unwrap_or(1);
        let expected_nm = [0, 1].map(|part: usize| (averaged[part] / count as f64 + shared[part]).sqrt());
        let wavelengths_nm: Vec<f64> = channels.iter().map(|(nm, _)| *nm).collect();
        Ok(Observation {
            channels: channels.to_vec(),
            exposures,
            electrons: self.flux_e * (count * channels.len()) as f64,
            peak_e,
            expected_nm,
            piston_range_nm: piston_range_nm(&wavelengths_nm, expected_nm[0]),
            flaw,
            scene: scene.changed(|sections| sections.image.count = count)?,
        })
    }
}

/// Why an estimate of a simulated image is no answer, where it is none.
fn flaw(found: &Estimate) -> Option<String> {
    if let Some(warning) = found.warnings.first() {
        return Some(warning.clone());
    }
    if !found.is_sound() {
        return Some(format!("the status is {}", found.status.word()));
    }
    let (_, residual) = found.truth.as_ref()?;
    let bars_nm = [found.figures.phasing.sigma_nm, found.figures.ncpa.sigma_nm];
    let is_beyond = (0..2).any(|part| residual.rms_nm[part] > BEYOND * bars_nm[part]);
    is_beyond.then(|| "the residual is beyond three error bars".into())
}

/// Squares of the errors of phasing and NCPA that exposures average, and of those that they share,
/// nm².
fn split(terms: &[ErrorTerm]) -> [[f64; 2]; 2] {
    let square = |term: &ErrorTerm| [term.phasing_nm.powi(2), term.ncpa_nm.powi(2)];
    let mut averaged = terms.first().map_or([0.0; 2], square);
    let (noise, mut shared) = (averaged, [0.0; 2]);
    for term in terms.iter().skip(1) {
        for (part, own) in square(term).into_iter().enumerate() {
            // Below the noise it is what images cannot exclude, which falls with that; above it
            // what tolerances alone divide.
            let falls = term.name == NOT_FITTED && own < noise[part];
            let sum = if falls { &mut averaged } else { &mut shared };
            sum[part] += own;
        }
    }
    [averaged, shared]
}

/// Largest pistons about their mean whose whole wavelengths are determined by `wavelengths_nm`
/// where each colour knows a piston to about `sigma_nm`: half a wavelength for one, and else up to
/// where multiples of two of them come closer than nine standard deviations of their difference.
fn piston_range_nm(wavelengths_nm: &[f64], sigma_nm: f64) -> f64 {
    let first_nm = wavelengths_nm[0];
    let Some(other_nm) = wavelengths_nm.iter().copied().find(|nm| *nm != first_nm) else { return first_nm / 2.0 };
    // The joint error bar is of both colours; the difference of two has twice its standard
    // deviation.
    let least_nm = DISTINCT * 2.0 * sigma_nm;
    let miss_nm = |k: f64| (k * first_nm - other_nm * (k * first_nm / other_nm).round()).abs();
    // Two segments differ by up to twice the range.
    let ambiguous = (1..1000).map(f64::from).find(|k| miss_nm(*k) < least_nm);
    ambiguous.map_or(f64::INFINITY, |k| k * first_nm / 2.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_colours_reach_to_where_their_multiples_meet() {
        assert_eq!(piston_range_nm(&[2000.0, 2000.0], 1.0), 1000.0);
        // 3·2168.6 and 4·1640 nm differ by 54 nm: seen with 1 nm, not with 5 nm. 31·2168.6 and
        // 41·1640 nm differ by 13.4 nm.
        assert!((piston_range_nm(&[2168.6, 1640.0], 5.0) - 1.5 * 2168.6).abs() < 1e-9);
        assert!((piston_range_nm(&[2168.6, 1640.0], 1.2) - 15.5 * 2168.6).abs() < 1e-9);
    }

    #[test]
    fn candidates_have_every_wavelength_once() {
        assert_eq!(candidates(&[2000.0]).len(), 2 * DEFOCUS_WAVES.len());
        let two = candidates(&[2000.0, 1600.0]);
        assert_eq!(two.len(), 3 * DEFOCUS_WAVES.len());
        assert_eq!(two[2], [(2000.0, 0.5), (1600.0, 0.5)]);
    }
}
