//! A minute of sky, again and again: images behind a loop, read the paper's way and ours.
//!
//! ```text
//! (row, seed) ─ Simulator ─ Sequence ─ Reader ─ Reading     one sequence is made while the one before it is read
//! ```

use super::table_rows::{Conditions, Row};
use super::{KeptDraw, Progress, Way};
use cophase::ao::{Shot, Simulator};
use cophase::imaging::{Chain, Precision};
use cophase::metrics::residual_nm;
use cophase::modal::Cube;
use cophase::modal::{ModalEstimate, ModalFitter, Recipe};
use cophase::pipeline::{Estimate, Estimator, Images, Policy};
use cophase::scene::{AoKnowledge, Scene};
use cophase::source;
use cophase::{Error, Result};
use ndarray::{Array2, Array3, ArrayView2, Axis, s};
use std::sync::mpsc::sync_channel;

/// Images of turbulence are fitted in single precision until no coefficient moves by more than
/// this, nm: it moves a residual of 30 nm by less than 0.01, takes half of the evaluations that
/// 0.001 nm does, and each takes half the time.
const TURBULENT_STEP_NM: f64 = 0.1;

/// How a loop did.
#[derive(Debug, Clone, PartialEq)]
pub struct LoopRun {
    /// Modes that it controls.
    pub controlled: usize,
    /// Subapertures that are masked.
    pub masked: usize,
    /// Whether its poles say that it is stable.
    pub stable: bool,
    /// Time in which they say that it grows e-fold, s; NaN for a stable one.
    pub e_folding_s: f64,
    /// The gain up to which they say that it is stable.
    pub largest_stable_gain: f64,
    /// When it diverged, s.
    pub diverged_at_s: Option<f64>,
    /// RMS of the residual wavefront after settling, nm.
    pub residual_rms_nm: f64,
    /// Strehl ratio at the images' wavelength, without NCPA and defocus.
    pub strehl: f64,
    /// Frames for each second of wall-clock time, on a machine that may have other work.
    pub frames_per_s: f64,
}

/// Images with one static truth behind them.
pub struct Sequence {
    /// Electrons, `[image, y, x]`; none where the loop was lost before the first.
    pub images_e: Array3<f64>,
    /// Mean slopes of the sensor over each exposure, `[image, slope]`, mas; none for an image
    /// without a loop.
    pub slopes_mas: Array2<f64>,
    /// Segment errors, `[y, x]`, nm, NaN outside the pupil.
    pub phasing_nm: Array2<f64>,
    /// The same of non-common path aberrations.
    pub ncpa_nm: Array2<f64>,
    /// How the loop did; none without a loop.
    pub run: Option<LoopRun>,
}

impl Sequence {
    /// The images of `row` with draw `seed` of aberrations, turbulence and noise.
    ///
    /// # Errors
    /// Those of the simulator; [`Error::Interrupted`].
    pub fn make(row: &Row, conditions: &Conditions, seed: usize, progress: &Progress) -> Result<Self> {
        progress.check()?;
        let scene = row.scene(conditions)?;
        let seed = seed.to_string();
        if !row.has_loop() {
            let drawn = scene.with_override("aberrations.seed", &seed)?;
            let made = source::simulate(&drawn)?.remove(0);
            let slopes_mas = Array2::zeros((made.images_e.len_of(Axis(0)), 0));
            let (phasing_nm, ncpa_nm) = (made.truth.phasing_nm, made.truth.ncpa_nm);
            return Ok(Self { images_e: made.images_e, slopes_mas, phasing_nm, ncpa_nm, run: None });
        }
        let drawn = scene.with(&[("aberrations.seed", &seed), ("turbulence.seed", &seed)])?;
        Self::behind(Simulator::new(&drawn)?, progress)
    }

    /// The images that `simulator` is set to take.
    ///
    /// # Errors
    /// As [`Sequence::make`].
    pub fn behind(mut simulator: Simulator, progress: &Progress) -> Result<Self> {
        progress.check()?;
        let mut shots: Vec<Shot> = Vec::new();
        let summary = simulator.run(&mut shots, progress.control())?;
        let (rows, columns) = simulator.scene().image.frame_shape();
        let mut images_e = Array3::zeros((shots.len(), rows, columns));
        for (mut image, shot) in images_e.outer_iter_mut().zip(&shots) {
            image.zip_mut_with(&shot.image_e, |out, &electrons| *out = f64::from(electrons));
        }
        let slopes = shots.first().map_or(0, |shot| shot.mean_slopes_mas.len());
        let slopes_mas = Array2::from_shape_fn((shots.len(), slopes), |(i, k)| f64::from(shots[i].mean_slopes_mas[k]));
        let poles = simulator.stability();
        let run = LoopRun {
            controlled: poles.controlled,
            masked: simulator.mask().iter().filter(|masked| **masked).count(),
            stable: poles.stable,
            e_folding_s: poles.e_folding_s.unwrap_or(f64::NAN),
            largest_stable_gain: poles.largest_stable_gain,
            diverged_at_s: summary.divergence.map(|divergence| divergence.time_s),
            residual_rms_nm: summary.residual_rms_nm,
            strehl: summary.strehl,
            frames_per_s: summary.frames_per_s(),
        };
        let truth = simulator.truth();
        let (phasing_nm, ncpa_nm) = (truth.phasing_nm.clone(), truth.ncpa_nm.clone());
        Ok(Self { images_e, slopes_mas, phasing_nm, ncpa_nm, run: Some(run) })
    }

    /// Number of images.
    pub fn images(&self) -> usize {
        self.images_e.len_of(Axis(0))
    }

    /// The full-phase estimate of the first `count` images, with their slopes unless `reader` knows
    /// less of the loop.
    ///
    /// # Errors
    /// Those of the estimator; [`Error::Interrupted`].
    pub(super) fn full_phase(&self, reader: &Scene, count: usize, progress: &Progress) -> Result<Estimate> {
        let images_e = self.images_e.slice(s![..count, .., ..]).to_owned();
        let has_slopes = reader.estimate.ao_knowledge.is_none_or(|level| level >= AoKnowledge::Telemetry);
        let slopes_mas = has_slopes.then(|| self.slopes_mas.slice(s![..count, ..]).to_owned());
        let images = Images { slopes_mas, ..Images::new(images_e) };
        Estimator::with_policy(reader, Policy::default(), progress.control().clone())?.estimate(&images)
    }
}

/// Draws of the sequences of `rows` and seeds 1 to `seeds`, row by row: those that are kept, and
/// those that `read` makes of a sequence while the next is simulated; without those of other
/// processes' parts. Each draw takes `steps` steps.
///
/// # Errors
/// Those of [`Sequence::make`] and of `read`.
pub(super) fn sequence_draws<'r, D: KeptDraw>(
    (rows, seeds): (&[&'r Row], usize),
    conditions: &Conditions,
    (progress, steps): (&Progress, usize),
    mut read: impl FnMut(&'r Row, usize, Sequence) -> Result<D>,
) -> Result<Vec<(&'r Row, D)>> {
    let job = |place: usize| (rows[place / seeds], 1 + place % seeds);
    let (mut draws, mut missing): (Vec<Option<D>>, Vec<usize>) = Default::default();
    for place in 0..rows.len() * seeds {
        let (row, seed) = job(place);
        let draw = progress.shares().and_then(|shares| shares.kept(row.name, seed));
        if draw.is_none() && progress.shares().is_none_or(|shares| shares.is_own(place)) {
            missing.push(place);
        } else {
            progress.add(steps);
        }
        draws.push(draw);
    }
    let jobs: Vec<(&Row, usize)> = missing.iter().map(|&place| job(place)).collect();
    let mut places = missing.into_iter();
    each_sequence(&jobs, conditions, progress, |row, seed, sequence| {
        let draw = read(row, seed, sequence)?;
        progress.shares().map_or(Ok(()), |shares| shares.keep(row.name, seed, &draw))?;
        if let Some(place) = places.next() {
            draws[place] = Some(draw);
        }
        Ok(())
    })?;
    Ok(draws.into_iter().enumerate().filter_map(|(place, draw)| Some((job(place).0, draw?))).collect())
}

/// Makes the sequences of `jobs` (row and seed) one after another, and hands each to `read` while
/// the next is made.
///
/// # Errors
/// Those of [`Sequence::make`] and of `read`.
fn each_sequence<'r>(
    jobs: &[(&'r Row, usize)],
    conditions: &Conditions,
    progress: &Progress,
    mut read: impl FnMut(&'r Row, usize, Sequence) -> Result<()>,
) -> Result<()> {
    std::thread::scope(|scope| {
        // No room: a minute of images is 90 MB, and one that is read, one ready and no more are
        // there at a time.
        let (made, ready) = sync_channel(0);
        scope.spawn(move || {
            for &(row, seed) in jobs {
                let sequence = Sequence::make(row, conditions, seed, progress);
                let failed = sequence.is_err();
                if made.send(sequence).is_err() || failed {
                    break;
                }
            }
        });
        for &(row, seed) in jobs {
            let panicked = |_| Error::Internal("the thread of the simulator panicked".into());
            read(row, seed, ready.recv().map_err(panicked)??)?;
        }
        Ok(())
    })
}

/// An estimator of sequences, one way. It depends on the telescope, not on what is behind it: one
/// serves all rows.
pub struct Reader {
    /// Whose choices it makes: the paper's objective (with our optimiser, which finds its minimum
    /// in a fraction of the evaluations) and the mean over the images, or the scene's defaults.
    pub way: Way,
    /// The estimator.
    pub estimator: ModalFitter,
    precision: Precision,
}

/// What one way made of a sequence.
#[derive(Debug, Clone, PartialEq)]
pub struct Reading {
    /// Whose.
    pub way: Way,
    /// Residual of the segment errors, nm; NaN where nothing could be fitted.
    pub phasing_nm: f64,
    /// Residual of the NCPA, nm.
    pub ncpa_nm: f64,
    /// Images that were combined.
    pub used: usize,
    /// Median χ² per degree of freedom.
    pub reduced_chi2: f64,
    /// Mean evaluations for an image.
    pub evaluations: f64,
    /// Wall-clock time, s.
    pub seconds: f64,
}

impl Reader {
    /// Of `scene`, which may be that of any seed.
    ///
    /// # Errors
    /// Those of [`ModalFitter::with_recipe`].
    pub fn new(way: Way, scene: &Scene) -> Result<Self> {
        let mut recipe = match way {
            Way::Paper => Recipe::paper_objective(scene),
            Way::Ours => Recipe::from_scene(scene),
        };
        let precision = if scene.image.count > 1 {
            recipe.step_tolerance_nm = recipe.step_tolerance_nm.max(TURBULENT_STEP_NM);
            Precision::F32
        } else {
            Precision::F64
        };
        Ok(Self { way, estimator: ModalFitter::with_recipe(scene, recipe, false)?, precision })
    }

    /// The readers of both ways.
    ///
    /// # Errors
    /// As [`Reader::new`].
    pub(super) fn both(scene: &Scene) -> Result<Vec<Self>> {
        Way::BOTH.into_iter().map(|way| Self::new(way, scene)).collect()
    }

    /// Fits every image of `sequence` and combines them; `None` where none can be fitted.
    ///
    /// # Errors
    /// Those of [`ModalFitter::estimate`]; [`Error::Interrupted`].
    pub fn fit(&self, sequence: &Sequence, progress: &Progress) -> Result<Option<ModalEstimate>> {
        progress.check()?;
        let found = if sequence.images() == 0 {
            Err(Error::Image("the loop was lost before the first image".into()))
        } else {
            let bad = sequence.images_e.mapv(|_| false);
            let mut chain = Chain::cpu(self.estimator.model().optics.clone(), self.precision);
            let cube = Cube { images_e: sequence.images_e.view(), bad: bad.view(), read_noise_e: None };
            self.estimator.estimate(&mut chain, cube, progress.control())
        };
        // The whole expects all images of each part.
        progress.add(self.estimator.scene().image.count);
        match found {
            Ok(estimate) => Ok(Some(estimate)),
            // A lost loop leaves nothing that can be fitted: that is a result too.
            Err(Error::Image(_)) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// [`Reader::fit`], held against the truth.
    ///
    /// # Errors
    /// As [`Reader::fit`].
    pub fn read(&self, sequence: &Sequence, progress: &Progress) -> Result<Reading> {
        let Some(found) = self.fit(sequence, progress)? else {
            let none = f64::NAN;
            let (way, used, seconds) = (self.way, 0, 0.0);
            return Ok(Reading {
                way,
                phasing_nm: none,
                ncpa_nm: none,
                used,
                reduced_chi2: none,
                evaluations: none,
                seconds,
            });
        };
        let [phasing_nm, ncpa_nm] =
            self.residuals_nm(sequence, found.combined.maps.phasing_nm.view(), found.combined.maps.ncpa_nm.view())?;
        let evaluations: usize = found.images.iter().map(|image| image.evaluations).sum();
        Ok(Reading {
            way: self.way,
            phasing_nm,
            ncpa_nm,
            used: found.used(),
            reduced_chi2: found.reduced_chi2(),
            evaluations: evaluations as f64 / found.images.len() as f64,
            seconds: found.seconds,
        })
    }

    /// Residuals against the truth of `sequence`, phasing and NCPA, nm, for an estimate with these
    /// maps.
    ///
    /// # Errors
    /// As [`residual_nm`].
    pub fn residuals_nm(
        &self,
        sequence: &Sequence,
        phasing_nm: ArrayView2<f64>,
        ncpa_nm: ArrayView2<f64>,
    ) -> Result<[f64; 2]> {
        let pupil = &self.estimator.model().telescope.pupil;
        let phasing_nm = residual_nm(pupil, phasing_nm, sequence.phasing_nm.view())?;
        Ok([phasing_nm, residual_nm(pupil, ncpa_nm, sequence.ncpa_nm.view())?])
    }
}
