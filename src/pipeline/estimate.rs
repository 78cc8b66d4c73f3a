//! Estimate: the static wavefront behind images, with error bars, by either method.

use super::budget::ErrorTerm;
use super::images::TruthMaps;
use super::modal_errors::ModalErrors;
use super::outcome::ImageOutcome;
use super::policy::Policy;
use super::telemetry::TelemetryCheck;
use crate::loop_response::Corrections;
use crate::modal::ImageStatus;
use crate::modal::{self, FittedImage, PistonInteger};
use crate::modes::{Degeneracy, Group};
use crate::pupil::Pupil;
use crate::scene::{AoKnowledge, Combine, Method, Precision, Scene};
use crate::statics::Iteration;
use crate::{Error, Result};
use ndarray::{Array2, ArrayView2};
use std::sync::Arc;

/// Static wavefront behind one image or many: modes, maps, error bars, and the outcome of each image.
///
/// Maps are `[y, x]` on the grid of [`Estimate::pupil`], nm of wavefront, NaN outside the pupil. Modes are those of
/// [`Estimate::basis`]: segments first, then NCPA.
#[derive(Debug, Clone)]
pub struct Estimate {
    /// The scene that was used: with the choices of a plan and the optical parameters that were fitted; one with channels as it was given.
    pub scene: Scene,
    /// The policy that was followed.
    pub policy: Policy,
    /// Names and groups of the modes.
    pub basis: Basis,
    /// Coefficient of each mode, nm; pistons have zero mean over the pupil.
    pub coefficients_nm: Vec<f64>,
    /// Covariance of the coefficients, nm².
    pub covariance_nm2: Array2<f64>,
    /// Segment errors.
    pub phasing_nm: Array2<f64>,
    /// Non-common path aberrations.
    pub ncpa_nm: Array2<f64>,
    /// Error bar of the phasing map, 1σ.
    pub phasing_sigma_nm: Array2<f64>,
    /// Error bar of the NCPA map, 1σ.
    pub ncpa_sigma_nm: Array2<f64>,
    /// RMS over the pupil of the phasing, piston, tip and tilt removed, and its error bar.
    pub phasing: Figure,
    /// RMS of the NCPA, and its error bar.
    pub ncpa: Figure,
    /// RMS of the sum of both, and its error bar; the error bar is NaN in a MAP estimate, which does not compute it.
    pub wavefront: Figure,
    /// Contributions to the error bars of phasing and NCPA.
    pub error_budget: Vec<ErrorTerm>,
    /// Outcome of each image, in order.
    pub images: Vec<ImageOutcome>,
    /// Coefficients of each image, `[image, mode]`, nm, NaN for unusable ones; no rows in a MAP estimate.
    pub image_coefficients_nm: Array2<f64>,
    /// How the images were combined; `None` in a MAP estimate.
    pub combine: Option<Combine>,
    /// Median reduced χ² of the images that were used.
    pub reduced_chi2: f64,
    /// Whether error bars are from the scatter between images, as from eight images on.
    pub is_sequence: bool,
    /// Worst status of the images that the estimate depends on.
    pub status: ImageStatus,
    /// Description of the modes that were added to the scene's.
    pub model: String,
    /// Optical parameters that were fitted, or found to differ from the scene's.
    pub optics: Vec<OpticalParameter>,
    /// Warnings: sentences that a user should read before using the numbers.
    pub warnings: Vec<String>,
    /// Remarks that hold for every image of this scene.
    pub remarks: Vec<String>,
    /// The pupil on which the maps are.
    pub pupil: Pupil,
    /// Where it ran.
    pub device: String,
    /// Precision of the imaging chain.
    pub precision: Precision,
    /// Wall-clock time of the estimate, s, without building the model where that is apart.
    pub seconds: f64,
    /// Wall-clock time of building the model, s.
    pub model_seconds: f64,
    /// First image of each channel that was used, with its model, in the order of `channels`; none in a MAP estimate.
    pub compared: Vec<FittedImage>,
    /// Combinations of modes that change the images little or not at all; `None` in a MAP estimate.
    pub degeneracy: Option<Degeneracy>,
    /// Maps that simulated images were made with, and the residual against them.
    pub truth: Option<(TruthMaps, Comparison)>,
    /// Modal fitter with the model that the images were compared with; `None` in a MAP estimate.
    pub fitter: Option<Arc<modal::ModalFitter>>,
    /// Iterations and assumptions of a MAP estimate; `None` in a modal one.
    pub map: Option<MapSummary>,
    /// Whole wavelengths of each segment's piston, in the order of the segments; none where the channels have one wavelength.
    pub integers: Vec<PistonInteger>,
    /// Names of the channels whose images it is from, in order; none for a scene with one way of imaging.
    pub channels: Vec<String>,
}

/// Names and groups of modes, in order: segments first, then NCPA.
#[derive(Debug, Clone, PartialEq)]
pub struct Basis {
    /// Name of each mode.
    pub names: Vec<String>,
    /// Group of each mode.
    pub groups: Vec<Group>,
}

/// RMS over the pupil, piston, tip and tilt removed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Figure {
    /// RMS of the map, nm.
    pub rms_nm: f64,
    /// Expected RMS of its error, nm.
    pub sigma_nm: f64,
}

/// An optical parameter that was fitted together with the modes.
#[derive(Debug, Clone, PartialEq)]
pub struct OpticalParameter {
    /// Key of the scene, or `reflectivity N` of segment N.
    pub key: String,
    /// The segment whose reflectivity it is, from 0; `None` for a number of the scene.
    pub segment: Option<usize>,
    /// Value in the scene, in the unit of the key.
    pub scene: f64,
    /// Fitted value.
    pub value: f64,
    /// Error bar, 1σ: infinite where the modes reproduce its effect, NaN where it is not known.
    pub sigma: f64,
    /// Share of the parameter's effect on the image that neither the modes nor other parameters reproduce; NaN where it is
    /// not known.
    pub identifiable: f64,
}

/// Estimate minus truth, piston, tip and tilt removed.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// Residual map of the phasing, `[y, x]`, nm.
    pub phasing_nm: Array2<f64>,
    /// Residual map of the NCPA.
    pub ncpa_nm: Array2<f64>,
    /// RMS of the residual of phasing, NCPA and their sum, nm.
    pub rms_nm: [f64; 3],
}

/// Iterations of a MAP estimate, and what was assumed of the adaptive optics.
#[derive(Debug, Clone)]
pub struct MapSummary {
    /// What was assumed of the adaptive optics.
    pub ao_knowledge: AoKnowledge,
    /// Measured slopes against those of the retrieved wavefronts; `None` without telemetry.
    pub telemetry: Option<TelemetryCheck>,
    /// All iterations; the last one is the estimate.
    pub iterations: Vec<Iteration>,
    /// Whether they ended because the last one changed less than the tolerance.
    pub has_settled: bool,
    /// Wall-clock time in retrievals, s.
    pub retrieval_seconds: f64,
    /// Reflectivity of each segment over the mean; empty where all are taken to be equal.
    pub segment_reflectivities: Vec<f64>,
}

impl Figure {
    /// RMS of `map` over the pupil, piston, tip and tilt removed, with this error bar.
    pub(super) fn from_map(pupil: &Pupil, map: ArrayView2<f64>, sigma_nm: f64) -> Result<Self> {
        Ok(Self { rms_nm: detrended(pupil, map)?.1, sigma_nm })
    }
}

/// `map` without piston, tip and tilt, and its RMS over the pupil.
fn detrended(pupil: &Pupil, map: ArrayView2<f64>) -> Result<(Array2<f64>, f64)> {
    let map = pupil.remove_piston_tip_tilt(map)?;
    let rms = pupil.rms(map.view())?;
    Ok((map, rms))
}

impl Comparison {
    /// Compares maps on the grid of `pupil` with the truth.
    ///
    /// # Errors
    /// [`Error::Shape`] or [`Error::Value`] where a map is not one of this pupil.
    pub fn new(pupil: &Pupil, phasing_nm: &Array2<f64>, ncpa_nm: &Array2<f64>, truth: &TruthMaps) -> Result<Self> {
        let maps = [
            ("the estimate's phasing", phasing_nm),
            ("the estimate's NCPA", ncpa_nm),
            ("the true phasing", &truth.phasing_nm),
            ("the true NCPA", &truth.ncpa_nm),
        ];
        maps.into_iter().try_for_each(|(name, map)| check_on_pupil(pupil, name, map))?;
        let (phasing_nm, phasing) = detrended(pupil, (phasing_nm - &truth.phasing_nm).view())?;
        let (ncpa_nm, ncpa) = detrended(pupil, (ncpa_nm - &truth.ncpa_nm).view())?;
        let wavefront = pupil.rms((&phasing_nm + &ncpa_nm).view())?;
        Ok(Self { phasing_nm, ncpa_nm, rms_nm: [phasing, ncpa, wavefront] })
    }
}

/// Refuses a map of another grid or of another pupil than `pupil`.
pub(super) fn check_on_pupil(pupil: &Pupil, name: &str, map: &Array2<f64>) -> Result<()> {
    let (rows, columns) = map.dim();
    let samples = pupil.grid.samples();
    if (rows, columns) != (samples, samples) {
        return Err(Error::Shape(format!(
            "{name} has {columns}x{rows} samples where the estimate's pupil has {samples}x{samples}: they cannot be compared"
        )));
    }
    let illuminated = || pupil.amplitude.iter().zip(map).filter(|(amplitude, _)| **amplitude > 0.0);
    let (all, missing) = (illuminated().count(), illuminated().filter(|(_, nm)| !nm.is_finite()).count());
    if missing > 0 {
        return Err(Error::Value(format!(
            "{name} has no value at {missing} of the {all} samples of the estimate's pupil: maps of the same pupil on the same \
             grid can be compared"
        )));
    }
    Ok(())
}

impl OpticalParameter {
    /// Whether the images distinguish it from the modes.
    pub fn is_identifiable(&self) -> bool {
        !self.sigma.is_infinite()
    }

    /// Takes the key and the unit by which `scene` names the quantity.
    pub(super) fn take_form_of(&mut self, scene: &Scene) {
        let own = |value: f64| scene.own_form(&self.key, value);
        let (key, value) = own(self.value);
        if key != self.key {
            let [of_scene, beyond] = [self.scene, self.value + self.sigma].map(|value| own(value).1);
            let sigma = if self.sigma.is_finite() { (beyond - value).abs() } else { self.sigma };
            (self.key, self.value, self.scene, self.sigma) = (key, value, of_scene, sigma);
        }
    }
}

impl Estimate {
    /// Method of the estimate.
    pub fn method(&self) -> Method {
        if self.map.is_some() { Method::FullPhase } else { Method::Modal }
    }

    /// Whether there is no warning, and the status is ok.
    pub fn is_sound(&self) -> bool {
        self.warnings.is_empty() && self.status == ImageStatus::Ok
    }

    /// Standard deviation of each mode, nm.
    pub fn sigma_nm(&self) -> Vec<f64> {
        self.covariance_nm2.diag().iter().map(|nm2| nm2.max(0.0).sqrt()).collect()
    }

    /// Phasing and NCPA together, `[y, x]`, nm.
    pub fn wavefront_nm(&self) -> Array2<f64> {
        &self.phasing_nm + &self.ncpa_nm
    }

    /// Number of modes that move segments; they come first.
    pub fn segment_modes(&self) -> usize {
        self.basis.groups.iter().filter(|group| **group == Group::Segment).count()
    }

    /// Number of images that were combined.
    pub fn used(&self) -> usize {
        self.images.iter().filter(|image| image.is_used).count()
    }

    /// Number of images that were fitted and left out as outliers.
    pub fn clipped(&self) -> usize {
        self.images.iter().filter(|image| image.is_clipped).count()
    }

    /// Evaluations of objective and gradient, all images together.
    pub fn evaluations(&self) -> usize {
        self.images.iter().map(|image| image.evaluations).sum()
    }

    /// Residual against the aberrations that simulated images were made with.
    ///
    /// # Errors
    /// [`Error::Shape`] for a truth on another grid.
    pub fn compare(&self, truth: &TruthMaps) -> Result<Comparison> {
        Comparison::new(&self.pupil, &self.phasing_nm, &self.ncpa_nm, truth)
    }

    /// Corrections of segments, mirror and reference slopes by the policy of the scene's section `[commands]`, also in the terms of the controllers
    /// that it describes. No increment is larger than `limit_nm`; `None` takes the mirror's stroke and, for segments, a quarter of the wavelength
    /// (half of the distance to the next fringe), and no limit where the whole wavelengths are known. Of a modal estimate tips and tilts of
    /// segments are not corrected, and it has no reference slopes.
    ///
    /// # Errors
    /// [`Error::Value`] for a limit that is not positive, for segment modes from a file, which are not pistons, and for steps at edges where
    /// segments are tilted; [`Error::File`] for a controller's table or matrix that cannot be read or does not fit.
    pub fn corrections(&self, limit_nm: Option<f64>) -> Result<Corrections> {
        let segment_limit_nm =
            if self.integers.is_empty() { self.scene.image.wavelength_nm / 4.0 } else { f64::INFINITY };
        let mut corrections = match self.map.as_ref().and_then(|map| map.iterations.last()) {
            Some(iteration) => iteration.corrections(&self.scene, limit_nm, segment_limit_nm)?,
            None => {
                let Some(fitter) = &self.fitter else {
                    return Err(Error::Internal("a modal estimate has no fitter".into()));
                };
                let modes = ModalErrors {
                    scene: &self.scene,
                    model: fitter.model(),
                    coefficients_nm: &self.coefficients_nm,
                    covariance_nm2: self.covariance_nm2.view(),
                    segment_limit_nm,
                };
                modes.corrections(limit_nm)?
            }
        };
        let status = (self.status != ImageStatus::Ok).then(|| format!("the status is {}", self.status.word()));
        let said = status.into_iter().chain(self.warnings.iter().cloned()).chain(self.remarks.iter().cloned());
        corrections.estimate_warnings = said.collect();
        // In the unit of the slopes that were measured.
        if let Some(check) = self.map.as_ref().and_then(|map| map.telemetry.as_ref()) {
            corrections.slopes_mas.iter_mut().for_each(|mas| *mas *= check.divided_by);
        }
        Ok(corrections)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fitted_defocus_has_the_unit_of_the_scene() {
        let scene = Scene::preset("keck-artificial").unwrap();
        let waves = || OpticalParameter {
            key: "image.diversity_focus_waves_rms".into(),
            segment: None,
            scene: 1.5,
            value: 1.47,
            sigma: 0.001,
            identifiable: 0.1,
        };
        let mut same = waves();
        same.take_form_of(&scene);
        assert_eq!(same, waves());
        let mut converted = waves();
        // 1.5 waves of 2168.6 nm.
        converted.take_form_of(&scene.with(&[("image.diversity_focus_nm_rms", "3252.9")]).unwrap());
        let OpticalParameter { key, scene, value, sigma, .. } = &converted;
        assert_eq!(key, "image.diversity_focus_nm_rms");
        for (found, expected) in [(scene, 1.5), (value, 1.47), (sigma, 0.001)] {
            assert!((found / 2168.6 - expected).abs() < 1e-9 * expected, "{converted:?}");
        }
    }
}
