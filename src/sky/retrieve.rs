//! The whole wavefront behind each image of a sequence: maximum a posteriori, image by image, on every core.
//!
//! ```text
//! frame ─ prepare ─ weigh ─ information ─ Filter ┐
//!                                     y, u ─ field + coefficients ─ imaging's chain ─ χ² + prior ─ L-BFGS
//! ```
//!
//! The objective is that of the modal fit, `Σ w·(S·h + b − d)²`, over a phase of its own at each lit sample ([`Square`])
//! beside the coefficients of segments, tip and tilt, with what the prior says of each added. One image's result depends
//! on that image alone: the same bits in any batch, on any number of threads.

use super::prior::Spectrum;
use super::probe::Typical;
use super::sampling::{sampled, seen_to_per_m};
use super::worker::{Engine, Found};
use crate::estimate::{Cube, Frame, Model, Preparation, Recipe};
use crate::imaging::{CpuChain, Precision};
use crate::optimize::{CancelFlag, StopReason};
use crate::scene::Scene;
use crate::source::flux_e;
use crate::telescope::Telescope;
use crate::{Error, Result};
use ndarray::{Array1, Array2, Axis};
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// How a retrieval is done.
#[derive(Debug, Clone, PartialEq)]
pub struct RetrievalRecipe {
    /// Cycles across a segment (the root of its area) to which its edges are to be seen, where the scene leaves samples and
    /// pixels open. Behind Keck's loop 75 images leave 3.6 nm of phasing with 8; with 6, what edges are seen is worth 4.3 nm
    /// (one draw).
    pub cycles_across_a_segment: f64,
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
    /// Most evaluations for one image.
    pub max_evaluations: usize,
    /// Pairs of steps and changes of gradient that the optimiser remembers: 3 do what 10 do, to 5 % of the evaluations,
    /// and of 16,000 numbers each they are what an evaluation costs beside the optics.
    pub memory: usize,
    /// How often the weights, first those of the data, are renewed from the fitted model.
    pub renewals: usize,
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
            precision: Precision::F32,
            model_error: 0.003,
            decrement_tolerance: 3.0,
            misfit_tolerance: 0.015,
            max_evaluations: 200,
            memory: 4,
            renewals: 0,
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

/// What the images of a batch show.
#[derive(Debug, Clone)]
pub struct Phases {
    /// The whole wavefront, static and dynamic, piston, tip and tilt included, nm, `[image, lit sample]`; NaN for an image
    /// that cannot be used. Where a sample belongs to several segments it shows their mean by weight.
    pub phase_nm: Array2<f64>,
    /// Of it, what the coefficients hold: segments, then tip and tilt, nm, `[image, coefficient]`.
    pub coefficients_nm: Array2<f64>,
    /// Logarithm of each segment's amplitude over the model's, `[image, segment]`; no columns where amplitudes are known.
    pub ln_amplitudes: Array2<f64>,
    /// One for each image.
    pub reports: Vec<RetrievalReport>,
}

/// How one image's retrieval went.
#[derive(Debug, Clone, PartialEq)]
pub struct RetrievalReport {
    /// χ² per degree of freedom under the noise and the model error of the fitted model; NaN for an image that cannot be
    /// used.
    pub reduced_chi2: f64,
    /// What was minimised, χ² under the data's weights and what the prior adds, over the same degrees of freedom: a model that
    /// is not the instrument's shows here where wavefronts could be found that explain the image, and are improbable.
    pub reduced_objective: f64,
    /// Evaluations of objective and gradient.
    pub evaluations: usize,
    /// Why it stopped.
    pub reason: StopReason,
    /// Electrons of the star.
    pub flux_e: f64,
    /// Electrons per pixel of the background.
    pub background_e: f64,
    /// Why the image cannot be used.
    pub refusal: Option<String>,
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
        super::lit::shown_nm(&self.model.optics, coefficients_nm)
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
        let (lit, modes) = (self.points_m.len(), self.model.optics.modes());
        if let Some(statics) = statics {
            self.check_statics(statics)?;
        }
        let read_noise_e = cube.read_noise_e.unwrap_or(self.read_noise_e);
        let pairs = cube.images_e.outer_iter().zip(cube.bad.outer_iter());
        let frames: Vec<Frame> = pairs.map(|(data_e, bad)| Frame { data_e, bad, read_noise_e }).collect();
        let mut phase_nm = Array2::from_elem((frames.len(), lit), f64::NAN);
        let mut coefficients_nm = Array2::from_elem((frames.len(), modes), f64::NAN);
        let varied =
            if self.retrieval.segment_amplitude_rms > 0.0 { self.model.optics.parts().weights.segments } else { 0 };
        let mut ln_amplitudes = Array2::from_elem((frames.len(), varied), f64::NAN);
        let done = AtomicUsize::new(0);
        let rows = phase_nm.axis_iter_mut(Axis(0)).zip(coefficients_nm.axis_iter_mut(Axis(0)));
        let rows = rows.zip(ln_amplitudes.axis_iter_mut(Axis(0)));
        let jobs: Vec<_> = frames.iter().zip(rows).collect();
        let reports = jobs
            .into_par_iter()
            .map(|(frame, ((mut phase_nm, mut coefficients_nm), mut ln_amplitudes))| {
                if cancel.is_some_and(|flag| flag.load(Ordering::Relaxed)) {
                    let (done, all) = (done.load(Ordering::Relaxed), frames.len());
                    return Err(Error::Interrupted(format!("{done} of {all} wavefronts were retrieved")));
                }
                let report = match self.preparation().prepare(*frame, &self.recipe) {
                    Err(Error::Image(refusal)) => RetrievalReport::refused(refusal),
                    Err(error) => return Err(error),
                    Ok(prepared) => {
                        let found = match &self.engine {
                            AnyEngine::Single(engine) => engine.retrieve(prepared, statics)?,
                            AnyEngine::Double(engine) => engine.retrieve(prepared, statics)?,
                        };
                        let Found { phase_nm: phase, coefficients_nm: coefficients, ln_amplitudes: ln, report } = found;
                        phase_nm.iter_mut().zip(phase).for_each(|(out, phase)| *out = phase);
                        coefficients_nm.iter_mut().zip(coefficients).for_each(|(out, nm)| *out = nm);
                        ln_amplitudes.iter_mut().zip(ln).for_each(|(out, ln)| *out = ln);
                        report
                    }
                };
                watch(done.fetch_add(1, Ordering::Relaxed) + 1);
                Ok(report)
            })
            .collect::<Result<Vec<_>>>()?;
        Ok(Phases { phase_nm, coefficients_nm, ln_amplitudes, reports })
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

impl RetrievalReport {
    fn refused(refusal: String) -> Self {
        Self {
            reduced_chi2: f64::NAN,
            reduced_objective: f64::NAN,
            evaluations: 0,
            reason: StopReason::Unfinished,
            flux_e: f64::NAN,
            background_e: f64::NAN,
            refusal: Some(refusal),
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
