//! Retriever: MAP wavefronts of the images of one scene, on every core or as a batch on a device.
//!
//! ```text
//! frame ─ prepare ─ weights ─ information ─ image preconditioner ┐
//!                                  y, u ─ free phase + coefficients ─ imaging chain ─ χ² + prior ─ L-BFGS
//! ```
//!
//! The objective is that of the modal fit, `Σ w·(S·h + b − d)²`, with an independent phase at each
//! illuminated sample ([`SpectralPreconditioner`](super::preconditioner::SpectralPreconditioner))
//! beside the coefficients of segments, tip and tilt, plus −2 log of the prior of each. The result
//! of an image depends on that image alone: on the CPU to the bit, in any batch and on any number
//! of threads; on a device to rounding, because small batches use other kernels than large ones.

use super::engine::RetrievalEngine;
use super::exposure_blur::ExposureBlur;
use super::illuminated_samples::IlluminatedSamples;
use super::information_probe::TypicalExposure;
use super::model::MapModel;
use super::prior::RadialPsd;
use super::results::RetrievedWavefronts;
use super::sampling::{highest_frequency_per_m, with_common_sampling, with_retrieval_sampling};
use super::settings::RetrievalSettings;
use super::static_wavefront::StaticWavefront;
use super::task::RetrievalTask;
use crate::control::Control;
use crate::imaging::{CpuChain, Precision};
use crate::machine;
use crate::modal::{Cube, Frame, Model, Recipe};
use crate::scene::{NcpaBasis, NollRange, Optimizer, System};
use crate::source::flux_e;
use crate::telescope::Telescope;
use crate::{Error, Result};
use ndarray::Array1;

/// Copies of the retrieved wavefronts: those of the last iteration and of this one, the selected
/// images, their residuals, and one for the blur of the exposures, which has twice as many numbers
/// of half the size.
const WAVEFRONT_COPIES: usize = 5;
/// Copies of the static modes at the illuminated samples: at all and at the bright ones, in
/// columns, times the inverse covariance, its residuals, and joined.
const MODE_COPIES: usize = 6;

/// Retriever of the wavefronts of images of one scene.
pub struct Retriever {
    model: Model,
    recipe: Recipe,
    settings: RetrievalSettings,
    read_noise_e: Option<f64>,
    points_m: Vec<(f64, f64)>,
    pitch_m: f64,
    highest_frequency_per_m: f64,
    engine: AnyEngine,
}

enum AnyEngine {
    Single(RetrievalEngine<f32>),
    Double(RetrievalEngine<f64>),
}

impl Retriever {
    /// For images of `scene` and `telescope`, which can differ from the scene's in the amplitudes
    /// of its segments, whose dynamic wavefront has the power spectral density `prior`. Samples and
    /// pixels are as many as the segments need, unless `estimate.samples` and `image.crop_pixels`
    /// give them.
    ///
    /// # Errors
    /// Those of [`Model::with_telescope`]; [`Error::Value`] for a setting out of range.
    pub fn new(scene: &System, telescope: Telescope, prior: &RadialPsd, settings: RetrievalSettings) -> Result<Self> {
        settings.check()?;
        let scene = with_retrieval_sampling(&free_phase(scene)?, &telescope, settings.cycles_across_a_segment)?;
        Self::by_recipe(&scene, Recipe::from_scene(&scene), telescope, prior, settings)
    }

    /// One for each of the `scenes` of the channels of one telescope, on the same samples of the
    /// pupil.
    ///
    /// # Errors
    /// As [`Retriever::new`]; [`Error::Scene`] for channels that cannot have the same samples.
    pub fn of_channels(
        scenes: &[System],
        telescope: &Telescope,
        prior: &RadialPsd,
        settings: &RetrievalSettings,
    ) -> Result<Vec<Self>> {
        if let [scene] = scenes {
            return Ok(vec![Self::new(scene, telescope.clone(), prior, settings.clone())?]);
        }
        settings.check()?;
        let scenes = scenes.iter().map(free_phase).collect::<Result<Vec<_>>>()?;
        let (scenes, least_pass_cycles) = with_common_sampling(&scenes, telescope, settings.cycles_across_a_segment)?;
        let each = scenes.iter().map(|scene| {
            let recipe = Recipe { least_pass_cycles, ..Recipe::from_scene(scene) };
            Self::by_recipe(scene, recipe, telescope.clone(), prior, settings.clone())
        });
        let retrievers = each.collect::<Result<Vec<_>>>()?;
        let different = retrievers.iter().position(|retriever| !retriever.has_samples_of(&retrievers[0]));
        match different.map(|channel| &scenes[channel]) {
            None => Ok(retrievers),
            Some(scene) => Err(Error::Scene(format!(
                "{}: its wavefronts have other samples of the pupil than those of the first channel, and a full-phase estimate needs the \
                 same ones: leave estimate.samples, pupil.band_pass_cycles and image.crop_pixels out",
                scene.name()
            ))),
        }
    }

    /// By a scene with the samples and pixels of a retrieval.
    fn by_recipe(
        scene: &System,
        recipe: Recipe,
        telescope: Telescope,
        prior: &RadialPsd,
        settings: RetrievalSettings,
    ) -> Result<Self> {
        let model = Model::with_telescope(scene, &recipe, telescope)?;
        let samples = model.optics.sampling().samples;
        let pitch_m = model.width_ratio() * model.telescope.pupil.grid.width_m() / samples as f64;
        let at = |i: usize| (i as f64 - (samples as f64 - 1.0) / 2.0) * pitch_m;
        let illuminated = &model.optics.parts().weights.illuminated;
        let points_m = illuminated.iter().map(|&p| (at(p as usize % samples), at(p as usize / samples))).collect();
        // Behind a loop wavefronts two actuators apart are independent.
        let margin_m = 2.0 * scene.mirror.pitch_m;
        let area = model.preparation.native_pixels();
        let flat = CpuChain::<f64>::new(model.optics.clone()).psf(Array1::zeros(model.optics.modes()).view());
        let typical = TypicalExposure {
            flux_e: flux_e(&scene.image, flat.iter().copied().fold(0.0, f64::max) / area),
            background_e: scene.image.background_e * area,
            pixel_variance_e2: (scene.image.read_noise_e.unwrap_or(0.0).powi(2) + scene.image.background_e).max(1.0)
                * area,
        };
        let blur = match settings.has_known_turbulence {
            true => {
                let sampling = model.optics.sampling();
                let reach_m = sampling.pixels_per_lambda_over_d * pitch_m * samples as f64;
                ExposureBlur::new(scene, sampling.pixels, reach_m)?
            }
            false => None,
        };
        let engine = match settings.precision {
            Precision::F32 => {
                let map = MapModel::new(&model, prior, pitch_m, margin_m, &settings, typical)?;
                AnyEngine::Single(RetrievalEngine::new(map.blurred_by(blur))?)
            }
            Precision::F64 => {
                let map = MapModel::new(&model, prior, pitch_m, margin_m, &settings, typical)?;
                AnyEngine::Double(RetrievalEngine::new(map.blurred_by(blur))?)
            }
        };
        let highest_frequency_per_m = highest_frequency_per_m(scene, &model)?;
        let read_noise_e = scene.image.read_noise_e;
        Ok(Self { read_noise_e, model, recipe, settings, points_m, pitch_m, highest_frequency_per_m, engine })
    }

    /// Whether wavefronts of both are on the same samples, with the same shares of the segments in
    /// each.
    fn has_samples_of(&self, other: &Self) -> bool {
        let [own, others] = [self, other].map(|retriever| &retriever.model.optics.parts().weights);
        self.pitch_m == other.pitch_m
            && own.illuminated == others.illuminated
            && own.offsets == others.offsets
            && own.segment == others.segment
            && own.weight == others.weight
    }

    /// Refuses a sequence of `images` images whose wavefronts, and the static modes that are
    /// estimated from them (`per_segment` of each segment and `ncpa_modes`), are more than the
    /// machine's memory can hold.
    ///
    /// # Errors
    /// [`Error::Value`].
    pub(crate) fn check_images(&self, images: usize, per_segment: usize, ncpa_modes: usize) -> Result<()> {
        let (samples, segments) = (self.points_m.len(), self.model.optics.parts().weights.segments);
        let rows = WAVEFRONT_COPIES * images + MODE_COPIES * (per_segment * segments + ncpa_modes);
        machine::check_memory(
            format_args!("the static errors of {segments} segments from {images} wavefronts of {samples} samples"),
            (size_of::<f64>() * samples).saturating_mul(rows) as u64,
            "take fewer images, or set fewer estimate.samples",
        )
    }

    /// Highest spatial frequency that the images resolve, 1/m; beyond it a retrieved wavefront is
    /// the prior's.
    pub fn highest_frequency_per_m(&self) -> f64 {
        self.highest_frequency_per_m
    }

    /// Name of the device on which the last images were retrieved, and the failure with which it
    /// was lost, where `auto` chose it.
    pub fn device(&self) -> (String, Option<String>) {
        match &self.engine {
            AnyEngine::Single(engine) => engine.device(),
            AnyEngine::Double(engine) => engine.device(),
        }
    }

    /// Illuminated samples of the wavefronts.
    ///
    /// # Errors
    /// Those of [`IlluminatedSamples::new`].
    pub fn illuminated_samples(&self) -> Result<IlluminatedSamples> {
        let samples = self.model.optics.sampling().samples;
        IlluminatedSamples::new(samples, self.pitch_m, &self.model.optics.parts().weights)
    }

    /// Retrieves the wavefront of every image of `cube` (`[image, y, x]`, electrons) about the
    /// static wavefront `about`, without the blur of each exposure that an earlier retrieval found
    /// ([`RetrievedWavefronts::blur_e`]; empty of none). Each image is a step of the progress.
    ///
    /// # Errors
    /// [`Error::Shape`] for frames of another size than the scene's, or a static wavefront of
    /// another model; [`Error::Interrupted`] where `control` is cancelled.
    pub fn retrieve_without(
        &self,
        blur_e: &[Vec<f32>],
        cube: Cube,
        about: Option<&StaticWavefront>,
        control: &Control,
    ) -> Result<RetrievedWavefronts> {
        if let Some(about) = about {
            self.check_static_wavefront(about)?;
        }
        self.run((about, blur_e), None, cube, control)
    }

    /// Retrieves the wavefronts of the images of `cube` from those of the same images with next to
    /// the same optics: `starts`, their [`RetrievedWavefronts::coordinates`], empty for the first.
    /// It takes 1 to 12 evaluations in place of 35. The optimisation ends before it has followed
    /// directions of which images hold little, so the result depends on its start: the iterations
    /// of static errors, each from the last one's wavefronts, did not converge (TMT, 25 images:
    /// 14.7 nm of phasing in place of 10.6).
    ///
    /// # Errors
    /// As [`Retriever::retrieve_without`].
    pub(super) fn retrieve_from(
        &self,
        starts: &[Vec<f32>],
        cube: Cube,
        control: &Control,
    ) -> Result<RetrievedWavefronts> {
        self.run((None, &[]), Some(starts), cube, control)
    }

    fn run(
        &self,
        (about, blur_e): (Option<&StaticWavefront>, &[Vec<f32>]),
        starts: Option<&[Vec<f32>]>,
        cube: Cube,
        control: &Control,
    ) -> Result<RetrievedWavefronts> {
        let read_noise_e = cube.read_noise_e.or(self.read_noise_e);
        let pairs = cube.images_e.outer_iter().zip(cube.bad.outer_iter());
        let frames: Vec<Frame> = pairs.map(|(data_e, bad)| Frame { data_e, bad, read_noise_e }).collect();
        let prepare = |image: usize| self.model.preparation.attempt(frames[image], &self.recipe);
        let parts = self.model.optics.parts();
        let amplitudes = if self.settings.segment_amplitude_rms > 0.0 { parts.weights.segments } else { 0 };
        let sizes = [parts.weights.illuminated.len(), parts.modes.len(), amplitudes];
        let mut wavefronts = RetrievedWavefronts::unfinished(frames.len(), sizes);
        let task = RetrievalTask { images: frames.len(), prepare: &prepare, about, blur_e, starts, control };
        match &self.engine {
            AnyEngine::Single(engine) => engine.retrieve(&task, &mut wavefronts)?,
            AnyEngine::Double(engine) => engine.retrieve(&task, &mut wavefronts)?,
        }
        Ok(wavefronts)
    }

    fn check_static_wavefront(&self, about: &StaticWavefront) -> Result<()> {
        let (segments, samples) = (self.model.segment_modes, self.points_m.len());
        let given = (about.segments_nm.len(), about.smooth_nm.len());
        if given != (segments, samples) {
            return Err(Error::Shape(format!(
                "a static wavefront of {} segment modes and {} samples was given, where the model has {segments} and \
                 {samples}",
                given.0, given.1
            )));
        }
        match about.segments_nm.iter().chain(&about.smooth_nm).find(|nm| !nm.is_finite()) {
            Some(nm) => Err(Error::Value(format!("a static wavefront of {nm} nm was given: finite values are needed"))),
            None => Ok(()),
        }
    }
}

/// `scene` with segment modes, tip and tilt only: the free phase includes the NCPA, and tip and
/// tilt can exceed any power spectrum.
fn free_phase(scene: &System) -> Result<System> {
    scene.with(|sections| {
        let modes = &mut sections.modes;
        (modes.file, modes.ncpa) = (None, NcpaBasis::None);
        modes.exact_zernikes = Some(NollRange::Span { first: 2, last: 3 });
        sections.estimate.optimizer = Optimizer::GaussNewton;
    })
}

/// What the tests ask of a retriever.
#[cfg(test)]
impl Retriever {
    /// [`Retriever::retrieve_without`] for the first time.
    pub(crate) fn retrieve(
        &self,
        cube: Cube,
        about: Option<&StaticWavefront>,
        control: &Control,
    ) -> Result<RetrievedWavefronts> {
        self.retrieve_without(&[], cube, about, control)
    }

    /// Model of the images: the segments' modes, then tip and tilt.
    pub(crate) fn model(&self) -> &Model {
        &self.model
    }

    /// Positions of the illuminated samples, (x, y), m.
    pub(crate) fn points_m(&self) -> &[(f64, f64)] {
        &self.points_m
    }

    /// Pupil amplitude of each illuminated sample: the sum of the segments' weights, which are
    /// band-limited, so from a little below 0 to a little above 1.
    pub(crate) fn amplitude(&self) -> Vec<f64> {
        self.model.optics.parts().weights.rows().map(|(.., weights)| weights.iter().sum()).collect()
    }

    /// Evaluates the wavefront of coefficients of [`Retriever::model`], nm at each illuminated
    /// sample; missing ones are 0.
    pub(crate) fn modal_wavefront_nm(&self, coefficients_nm: &[f64]) -> Vec<f64> {
        super::illuminated_samples::modal_wavefront_nm(&self.model.optics, coefficients_nm)
    }

    /// Draws a wavefront of power spectral density `psd`, nm at each illuminated sample.
    pub(crate) fn draw_nm(&self, psd: &RadialPsd, seed: u64) -> Vec<f64> {
        match &self.engine {
            AnyEngine::Single(engine) => engine.model().draw_nm(psd, seed),
            AnyEngine::Double(engine) => engine.model().draw_nm(psd, seed),
        }
    }
}
