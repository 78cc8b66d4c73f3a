//! The whole wavefront behind each image of a sequence: maximum a posteriori, image by image on every core, or all together
//! on a device.
//!
//! ```text
//! frame ─ prepare ─ weigh ─ information ─ Filter ┐
//!                                     y, u ─ field + coefficients ─ imaging's chain ─ χ² + prior ─ L-BFGS
//! ```
//!
//! The objective is that of the modal fit, `Σ w·(S·h + b − d)²`, over a phase of its own at each lit sample ([`Square`])
//! beside the coefficients of segments, tip and tilt, with what the prior says of each added. One image's result depends
//! on that image alone: on the CPU the same bits in any batch, on any number of threads; on a device to rounding, where small
//! batches take other kernels than large ones.

use super::device_batch::Asked;
use super::engine::Engine;
use super::information_probe::Typical;
use super::prior::Spectrum;
use super::results::Phases;
use super::sampling::{sampled, seen_to_per_m};
use crate::estimate::{Cube, Frame, Model, Preparation, Recipe};
use crate::imaging::{Choice, CpuChain, Polynomial, Precision};
use crate::optimize::CancelFlag;
use crate::scene::Scene;
use crate::source::flux_e;
use crate::telescope::Telescope;
use crate::{Error, Result};
use ndarray::Array1;
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// How a retrieval is done.
#[derive(Debug, Clone, PartialEq)]
pub struct RetrievalRecipe {
    /// Cycles across a segment (the root of its area) to which its edges are to be seen, where the scene leaves samples and
    /// pixels open. Behind Keck's loop 75 images leave 3.6 nm of phasing with 8; with 6, what edges are seen is worth 4.3 nm
    /// (one draw).
    pub cycles_across_a_segment: f64,
    /// Where the chain runs. On the CPU every thread has an image of its own; on a device a batch goes in lock-step. Where
    /// amplitudes of segments vary it is the CPU all the same.
    pub device: Choice,
    /// Precision of the chain; the steps are always taken in double.
    pub precision: Precision,
    /// What the model does not know (motion in an exposure, flat field), as a fraction of a pixel's signal: its square
    /// joins the variance of the noise, so that the brightest pixels do not rule.
    pub model_error: f64,
    /// A retrieval stops where the next step promises to lower the objective by no more than this, in units of χ²: a
    /// direction or two known to a deviation. A hundred times as much leaves an image of peak signal over noise 50 with
    /// 19 nm of error at the mirror's frequencies in place of 6.6.
    pub decrement_tolerance: f64,
    /// ... and this fraction of what χ² is above its degrees of freedom: what the model cannot explain (turbulence finer
    /// than its samples, motion) even a perfect retrieval leaves, and to follow it is to fit it. A fifth of this takes two
    /// thirds more evaluations of a bright star's images, for 2.7 nm of error at the mirror's frequencies in place of 3.0.
    pub misfit_tolerance: f64,
    /// Most images that go together on a device: fewer leave it idle, more gain nothing.
    pub most_together: usize,
    /// Most evaluations for one image.
    pub max_evaluations: usize,
    /// Pairs of steps and changes of gradient that the optimiser remembers: 3 do what 10 do, to 5 % of the evaluations,
    /// and of 16,000 numbers each they are what an evaluation costs beside the optics.
    pub memory: usize,
    /// RMS that each segment's piston is expected to have beside [`Statics`], nm. 0 leaves pistons to the field, whose
    /// spectrum has room for them: then a mean over images is what the images show, and not where a field that is nearly
    /// an edge was traded for one. A single image's error is the same, 23 nm, either way.
    pub piston_rms_nm: f64,
    /// The same of segments' tilts, where the scene estimates them.
    pub segment_tilt_rms_nm: f64,
    /// RMS that the amplitudes of the segments are expected to have about those of the model, as a fraction; 0 takes them
    /// for known.
    pub segment_amplitude_rms: f64,
}

impl Default for RetrievalRecipe {
    fn default() -> Self {
        Self {
            cycles_across_a_segment: 8.0,
            device: Choice::Cpu,
            precision: Precision::F32,
            model_error: 0.003,
            decrement_tolerance: 3.0,
            misfit_tolerance: 0.015,
            most_together: 128,
            max_evaluations: 200,
            memory: 4,
            piston_rms_nm: 0.0,
            segment_tilt_rms_nm: 0.0,
            segment_amplitude_rms: 0.0,
        }
    }
}

/// The static wavefront about which the dynamic one is sought.
#[derive(Debug, Clone, PartialEq)]
pub struct Statics {
    /// Pistons (and tips and tilts) of the segments, nm: the first coefficients of [`Retriever::model`].
    pub segments_nm: Vec<f64>,
    /// The rest, nm at each lit sample.
    pub map_nm: Vec<f64>,
}

/// Retrieves wavefronts behind images of one scene.
pub struct Retriever {
    model: Model,
    recipe: Recipe,
    retrieval: RetrievalRecipe,
    read_noise_e: f64,
    points_m: Vec<(f64, f64)>,
    seen_to_per_m: f64,
    engine: AnyEngine,
}

enum AnyEngine {
    Single(Engine<f32>),
    Double(Engine<f64>),
}

impl Retriever {
    /// For images of `scene` whose dynamic wavefront has the spectrum `prior`, on as many samples and pixels as its segments
    /// want unless `estimate.samples` and `image.crop_pixels` say.
    ///
    /// # Errors
    /// Those of [`Model::of`]; [`Error::Value`] for a recipe out of range.
    pub fn new(scene: &Scene, prior: &Spectrum, retrieval: RetrievalRecipe) -> Result<Self> {
        Self::with_telescope(scene, Telescope::of(scene)?, prior, retrieval)
    }

    /// As [`Retriever::new`], for a telescope that is the scene's but for the amplitudes of its segments.
    ///
    /// # Errors
    /// As [`Retriever::new`].
    pub fn with_telescope(
        scene: &Scene,
        telescope: Telescope,
        prior: &Spectrum,
        retrieval: RetrievalRecipe,
    ) -> Result<Self> {
        check(&retrieval)?;
        // The field holds what the NCPA modes would; tip and tilt can be larger than any spectrum says.
        let scene = scene.with(&[
            ("modes.file", ""),
            ("modes.ncpa", "none"),
            ("modes.exact_zernikes", "[2, 3]"),
            ("estimate.optimizer", "gauss-newton"),
        ])?;
        let scene = sampled(&scene, &telescope, retrieval.cycles_across_a_segment)?;
        let recipe = Recipe::of(&scene);
        let model = Model::of_telescope(&scene, &recipe, telescope)?;
        let samples = model.optics.sampling().samples;
        let pitch_m = model.width_ratio() * model.telescope.pupil.grid.width_m() / samples as f64;
        let at = |i: usize| (i as f64 - (samples as f64 - 1.0) / 2.0) * pitch_m;
        let lit = &model.optics.parts().weights.lit;
        let points_m = lit.iter().map(|&p| (at(p as usize % samples), at(p as usize / samples))).collect();
        // Behind a loop wavefronts are strangers where they are two actuators apart.
        let margin_m = 2.0 * scene.mirror.pitch_m;
        let area = model.preparation.native_pixels();
        let flat = CpuChain::<f64>::new(model.optics.clone()).psf(Array1::zeros(model.optics.modes()).view());
        let typical = Typical {
            flux_e: flux_e(&scene.image, flat.iter().copied().fold(0.0, f64::max) / area),
            background_e: scene.image.background_e * area,
            floor_e2: (scene.image.read_noise_e.powi(2) + scene.image.background_e).max(1.0) * area,
        };
        let engine = match retrieval.precision {
            Precision::F32 => AnyEngine::Single(Engine::new(&model, prior, pitch_m, margin_m, &retrieval, typical)?),
            Precision::F64 => AnyEngine::Double(Engine::new(&model, prior, pitch_m, margin_m, &retrieval, typical)?),
        };
        let seen_to_per_m = seen_to_per_m(&scene, &model)?;
        let read_noise_e = scene.image.read_noise_e;
        Ok(Self { read_noise_e, model, recipe, retrieval, points_m, seen_to_per_m, engine })
    }

    /// The model that is compared with the images: its segments' modes, then tip and tilt.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// The highest spatial frequency that the images show, 1/m: beyond it a wavefront is what the prior says.
    pub fn seen_to_per_m(&self) -> f64 {
        self.seen_to_per_m
    }

    /// What reports call the device on which the last images were retrieved, and why it does not compute any more, where
    /// `auto` took one and it was lost.
    pub fn device(&self) -> (String, Option<String>) {
        match &self.engine {
            AnyEngine::Single(engine) => engine.device(),
            AnyEngine::Double(engine) => engine.device(),
        }
    }

    /// How it is done.
    pub fn retrieval(&self) -> &RetrievalRecipe {
        &self.retrieval
    }

    /// Where the lit samples are, (x, y), m.
    pub fn points_m(&self) -> &[(f64, f64)] {
        &self.points_m
    }

    /// How much glass is in each lit sample: the sum of the segments' weights, which are low-passed: a little below 0 to
    /// a little above 1.
    pub fn glass(&self) -> Vec<f64> {
        self.model.optics.parts().weights.rows().map(|(.., weights)| weights.iter().sum()).collect()
    }

    /// The wavefront at each lit sample that coefficients of [`Retriever::model`] make, nm; fewer leave the others at 0.
    pub fn shown_nm(&self, coefficients_nm: &[f64]) -> Vec<f64> {
        super::illuminated_samples::shown_nm(&self.model.optics, coefficients_nm)
    }

    /// A wavefront drawn from `spectrum`, nm at each lit sample: for simulations.
    pub fn draw_nm(&self, spectrum: &Spectrum, seed: u64) -> Vec<f64> {
        match &self.engine {
            AnyEngine::Single(engine) => engine.draw_nm(spectrum, seed),
            AnyEngine::Double(engine) => engine.draw_nm(spectrum, seed),
        }
    }

    /// Retrieves the wavefront behind every image of `cube` (`[image, y, x]`, electrons). `watch` is told how many are
    /// done.
    ///
    /// # Errors
    /// [`Error::Shape`] for frames of another size than the scene's, or statics of another model; [`Error::Interrupted`]
    /// where `cancel` went up.
    pub fn retrieve(
        &self,
        cube: Cube,
        statics: Option<&Statics>,
        cancel: Option<&CancelFlag>,
        watch: &(dyn Fn(usize) + Sync),
    ) -> Result<Phases> {
        if let Some(statics) = statics {
            self.check_statics(statics)?;
        }
        let read_noise_e = cube.read_noise_e.unwrap_or(self.read_noise_e);
        let pairs = cube.images_e.outer_iter().zip(cube.bad.outer_iter());
        let frames: Vec<Frame> = pairs.map(|(data_e, bad)| Frame { data_e, bad, read_noise_e }).collect();
        let take = |image: usize| match self.preparation().prepare(frames[image], &self.recipe) {
            Ok(prepared) => Ok(Ok(prepared)),
            Err(Error::Image(refusal)) => Ok(Err(refusal)),
            Err(error) => Err(error),
        };
        let asked = Asked { images: frames.len(), take: &take, statics, cancel };
        match &self.engine {
            AnyEngine::Single(engine) => self.retrieve_with(engine, &asked, watch),
            AnyEngine::Double(engine) => self.retrieve_with(engine, &asked, watch),
        }
    }

    fn retrieve_with<T: Polynomial>(
        &self,
        engine: &Engine<T>,
        asked: &Asked,
        watch: &(dyn Fn(usize) + Sync),
    ) -> Result<Phases> {
        let parts = self.model.optics.parts();
        let varied = if self.retrieval.segment_amplitude_rms > 0.0 { parts.weights.segments } else { 0 };
        let mut phases = Phases::unfinished(asked.images, [parts.weights.lit.len(), parts.modes.len(), varied]);
        let mut done = 0;
        // A batch ends its images one after the other, in whatever order.
        let on_device = engine.retrieve_on_device(asked, &mut |image, found| {
            phases.keep(image, found);
            done += 1;
            watch(done);
        })?;
        if on_device {
            return Ok(phases);
        }
        let done = AtomicUsize::new(0);
        let rows: Vec<_> = phases.rows().enumerate().collect();
        rows.into_par_iter().try_for_each(|(image, row)| {
            if asked.cancel.is_some_and(|flag| flag.load(Ordering::Relaxed)) {
                let (done, all) = (done.load(Ordering::Relaxed), asked.images);
                return Err(Error::Interrupted(format!("{done} of {all} wavefronts were retrieved")));
            }
            let found = match (asked.take)(image)? {
                Ok(prepared) => Ok(engine.retrieve(prepared, asked.statics)?),
                Err(refusal) => Err(refusal),
            };
            row.keep(found);
            watch(done.fetch_add(1, Ordering::Relaxed) + 1);
            Ok(())
        })?;
        Ok(phases)
    }

    fn preparation(&self) -> &Preparation {
        &self.model.preparation
    }

    fn check_statics(&self, statics: &Statics) -> Result<()> {
        let (segments, lit) = (self.model.segment_modes, self.points_m.len());
        let given = (statics.segments_nm.len(), statics.map_nm.len());
        if given != (segments, lit) {
            return Err(Error::Shape(format!(
                "statics of {} segment modes and {} samples were given, where the model has {segments} and {lit}",
                given.0, given.1
            )));
        }
        match statics.segments_nm.iter().chain(&statics.map_nm).find(|nm| !nm.is_finite()) {
            Some(nm) => Err(Error::Value(format!("a static wavefront of {nm} nm was given: finite values are needed"))),
            None => Ok(()),
        }
    }
}

/// # Errors
/// [`Error::Value`] for the first number out of range.
fn check(recipe: &RetrievalRecipe) -> Result<()> {
    let numbers = [
        ("cycles_across_a_segment", recipe.cycles_across_a_segment),
        ("model_error", recipe.model_error),
        ("decrement_tolerance", recipe.decrement_tolerance),
        ("misfit_tolerance", recipe.misfit_tolerance),
        ("piston_rms_nm", recipe.piston_rms_nm),
        ("segment_tilt_rms_nm", recipe.segment_tilt_rms_nm),
        ("segment_amplitude_rms", recipe.segment_amplitude_rms),
    ];
    match numbers.iter().find(|(_, value)| !(value.is_finite() && *value >= 0.0)) {
        Some((name, value)) => {
            Err(Error::Value(format!("{name} is {value}, where a finite number of 0 or more is needed")))
        }
        None => Ok(()),
    }
}
