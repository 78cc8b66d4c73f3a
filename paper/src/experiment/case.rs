//! One way to estimate, tried on many draws: residuals, bounds, pulls, time.

use super::{Draw, KeptDraw, Progress, statistics, to_cells, to_numbers};
use cophase::imaging::{Chain, Precision};
use cophase::metrics::{MapGram, residual_nm};
use cophase::modal::{Cube, Frame, ModalEstimate, ModalFitter};
use cophase::modes::Group;
use cophase::optimize::Metric;
use cophase::scene::Scene;
use cophase::source::Truth;
use cophase::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1, Axis, s, stack};
use rayon::prelude::*;
use std::borrow::Cow;
use std::sync::Arc;
use std::time::Instant;
use twox_hash::XxHash3_128;

/// Images that are fitted in one batch. A fixed number, so that results do not depend on how many
/// cores there are; small, so that all cores have something to do.
const BATCH: usize = 4;
/// Directions of a covariance below this fraction of the largest variance are null: global piston
/// alone, at rounding. The strongest and the weakest direction that an image sees differ by less
/// than 1e6 in variance.
const NULL_FLOOR: f64 = 1e-10;
/// Evaluations that are timed; the median of this many ignores a machine that is busy for a moment.
const TIMED: usize = 15;

/// Whose choices a fit makes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Way {
    /// As published: hard-edged pupil, the scene's modes alone, no weights, BFGS from zero.
    Paper,
    /// What the scene's defaults do.
    Ours,
}

impl Way {
    /// The paper's, then ours.
    pub const BOTH: [Way; 2] = [Way::Paper, Way::Ours];

    /// One word for tables.
    pub fn name(self) -> &'static str {
        match self {
            Way::Paper => "paper",
            Way::Ours => "ours",
        }
    }

    /// `scene` made to be fitted this way.
    ///
    /// # Errors
    /// Those of [`Scene::with_override`].
    pub fn of(self, scene: &Scene) -> Result<Scene> {
        let optimizer = match self {
            Way::Paper => "bfgs",
            Way::Ours => "gauss-newton",
        };
        scene.with_override("estimate.optimizer", optimizer)
    }
}

/// An estimator and what its maps weigh.
pub struct Case {
    /// The estimator; a [`cophase::modal::Session`] shares it.
    pub estimator: Arc<ModalFitter>,
    phasing: MapGram,
    ncpa: MapGram,
}

/// What became of one draw.
#[derive(Debug, Clone)]
pub struct Trial {
    /// The draw's seed.
    pub seed: usize,
    /// Residual of the segment errors, nm.
    pub phasing_nm: f64,
    /// Residual of the NCPA, nm.
    pub ncpa_nm: f64,
    /// χ² per degree of freedom.
    pub reduced_chi2: f64,
    /// Evaluations of objective and gradient.
    pub evaluations: usize,
    /// Wall-clock time for this image: that of its batch, shared out.
    pub seconds: f64,
    /// One word: `ok`, `misfit`, `wrong-minimum`, `not-converged`.
    pub status: Cow<'static, str>,
    /// The estimate, nm.
    pub coefficients_nm: Vec<f64>,
}

/// What noise alone would leave: the Cramér-Rao bound of one draw.
#[derive(Debug, Clone)]
pub struct Bound {
    /// Root of the mean square residual of the segment errors, nm.
    pub phasing_nm: f64,
    /// The same of the NCPA.
    pub ncpa_nm: f64,
    /// `[mode, mode]`, nm².
    pub covariance_nm2: Array2<f64>,
}

/// (estimate − truth) in standard deviations.
#[derive(Debug, Clone, Default)]
pub struct Pulls {
    /// One for each segment mode.
    pub phasing: Vec<f64>,
    /// One for each NCPA mode.
    pub ncpa: Vec<f64>,
    /// Along the principal directions of the covariance, where pulls are independent; global piston
    /// is none.
    pub white: Vec<f64>,
}

impl Case {
    /// Builds the estimator of `scene`.
    ///
    /// # Errors
    /// Those of [`ModalFitter::new`].
    pub fn new(scene: &Scene) -> Result<Self> {
        let estimator = Arc::new(ModalFitter::new(scene, false)?);
        let model = estimator.model();
        let (pupil, maps) = (&model.telescope.pupil, model.basis.maps());
        let phasing = MapGram::new(pupil, maps.slice(s![..model.segment_modes, .., ..]))?;
        let ncpa = MapGram::new(pupil, maps.slice(s![model.segment_modes.., .., ..]))?;
        Ok(Self { phasing, ncpa, estimator })
    }

    /// Fits every draw on its own. Batches of other processes' parts have trials without an
    /// estimate.
    ///
    /// # Errors
    /// Those of [`ModalFitter::estimate`]; a fit that fails is no error but a [`Trial::status`].
    pub fn fit(&self, draws: &[Draw], progress: &Progress) -> Result<Vec<Trial>> {
        self.fit_changed("", draws, progress)
    }

    /// As [`Case::fit`], of draws whose images were changed in a way of this name.
    ///
    /// # Errors
    /// As [`Case::fit`].
    pub fn fit_changed(&self, change: &str, draws: &[Draw], progress: &Progress) -> Result<Vec<Trial>> {
        let key = XxHash3_128::oneshot(format!("{:?}{change}", **self.estimator.scene()).as_bytes());
        let batches = draws.par_chunks(BATCH).enumerate().map(|(number, batch)| {
            let (row, first) = (format!("{key:032x}, {} draws", batch.len()), batch[0].seed);
            // The first batch of each case is of another part, so that many small cases are spread.
            let place = number + (key % 1000) as usize;
            let trials = progress.draw((&row, first, place), batch.len(), || {
                let trials = self.fit_batch(batch, progress)?;
                progress.add(batch.len());
                Ok(Trials(trials))
            })?;
            let absent = || batch.iter().map(|draw| failed(draw, f64::NAN)).collect();
            Ok(trials.map_or_else(absent, |trials| trials.0))
        });
        Ok(batches.collect::<Result<Vec<_>>>()?.into_iter().flatten().collect())
    }

    fn fit_batch(&self, draws: &[Draw], progress: &Progress) -> Result<Vec<Trial>> {
        progress.check()?;
        let started = Instant::now();
        let views: Vec<_> = draws.iter().map(|draw| draw.image_e.view()).collect();
        let images_e = stack(Axis(0), &views).map_err(|error| Error::Shape(format!("the draws differ: {error}")))?;
        let bad = images_e.mapv(|_| false);
        let mut chain = Chain::cpu(self.estimator.model().optics.clone(), Precision::F64);
        let cube = Cube { images_e: images_e.view(), bad: bad.view(), read_noise_e: None };
        let found = self.estimator.estimate(&mut chain, cube, progress.control());
        let seconds = started.elapsed().as_secs_f64() / draws.len() as f64;
        match found {
            Ok(found) => draws.iter().enumerate().map(|(i, draw)| self.trial(&found, i, draw, seconds)).collect(),
            // Nothing of this batch converged: that is a result too.
            Err(Error::Image(_)) => Ok(draws.iter().map(|draw| failed(draw, seconds)).collect()),
            Err(error) => Err(error),
        }
    }

    fn trial(&self, found: &ModalEstimate, image: usize, draw: &Draw, seconds: f64) -> Result<Trial> {
        let report = &found.images[image];
        let coefficients_nm = found.image_coefficients_nm.row(image).to_vec();
        let [phasing_nm, ncpa_nm] = self.residuals_nm(&coefficients_nm, draw)?;
        Ok(Trial {
            seed: draw.seed,
            phasing_nm,
            ncpa_nm,
            reduced_chi2: report.reduced_chi2,
            evaluations: report.evaluations,
            seconds,
            status: report.status.word().into(),
            coefficients_nm,
        })
    }

    /// How far an estimate of one draw is from its truth: segment errors and NCPA, nm.
    ///
    /// # Errors
    /// Those of [`Draw::truth_on`] and [`residual_nm`].
    pub fn residuals_nm(&self, coefficients_nm: &[f64], draw: &Draw) -> Result<[f64; 2]> {
        let model = self.estimator.model();
        let [phasing, ncpa] = draw.truth_on(&model.telescope.pupil)?;
        let residual = |group, truth: &Array2<f64>| {
            residual_nm(&model.telescope.pupil, model.map_nm(coefficients_nm, group).view(), truth.view())
        };
        Ok([residual(Group::Segment, &phasing)?, residual(Group::Ncpa, &ncpa)?])
    }

    /// RMS over the pupil of an error of the coefficients, nm: of its segment errors and of its
    /// NCPA, piston, tip and tilt removed.
    ///
    /// # Errors
    /// [`Error::Shape`] for another number of modes.
    pub fn error_rms_nm(&self, error_nm: &[f64]) -> Result<[f64; 2]> {
        let rms = |gram: &MapGram, part: &[f64]| {
            let column = ArrayView1::from(part).insert_axis(Axis(1));
            gram.expected_rms_nm(column.dot(&column.t()).view())
        };
        let (segments, ncpa) = error_nm.split_at(self.estimator.model().segment_modes.min(error_nm.len()));
        Ok([rms(&self.phasing, segments)?, rms(&self.ncpa, ncpa)?])
    }

    /// An error of the coefficients in standard deviations along the principal directions of their
    /// covariance, where it is independent; global piston is none.
    ///
    /// # Errors
    /// [`Error::Value`] for a covariance that has no such directions.
    pub fn whitened(&self, error_nm: &[f64], covariance_nm2: &Array2<f64>) -> Result<Vec<f64>> {
        let metric = Metric::from_gauss_newton(covariance_nm2, NULL_FLOOR)?;
        let mut white = vec![0.0; metric.rank()];
        // With C = V Λ Vᵀ this is Λ^(−1/2) Vᵀ: what takes a gradient to whitened coordinates takes
        // an error there.
        metric.gradient_to_z(error_nm, &mut white);
        Ok(white)
    }

    /// The bound at the estimate of one draw; NaN where there is no estimate.
    ///
    /// # Errors
    /// Those of [`ModalFitter::bound`].
    pub fn bound(&self, trial: &Trial, draw: &Draw) -> Result<Bound> {
        if trial.coefficients_nm.is_empty() {
            return Ok(Bound { phasing_nm: f64::NAN, ncpa_nm: f64::NAN, covariance_nm2: Array2::zeros((0, 0)) });
        }
        self.bound_at(&trial.coefficients_nm, draw)
    }

    /// The bound for the image of one draw, at some wavefront, nm.
    ///
    /// # Errors
    /// Those of [`ModalFitter::bound`].
    pub fn bound_at(&self, coefficients_nm: &[f64], draw: &Draw) -> Result<Bound> {
        let background_e = self.estimator.scene().image.background_e;
        let covariance_nm2 = self.estimator.bound(ArrayView1::from(coefficients_nm), draw.flux_e, background_e)?;
        let n = self.estimator.model().segment_modes;
        Ok(Bound {
            phasing_nm: self.phasing.expected_rms_nm(covariance_nm2.slice(s![..n, ..n]))?,
            ncpa_nm: self.ncpa.expected_rms_nm(covariance_nm2.slice(s![n.., n..]))?,
            covariance_nm2,
        })
    }

    /// The bounds of all draws.
    ///
    /// # Errors
    /// As [`Case::bound`]; [`Error::Interrupted`].
    pub fn bounds(&self, trials: &[Trial], draws: &[Draw], progress: &Progress) -> Result<Vec<Bound>> {
        let bound = |(trial, draw)| progress.check().and_then(|()| self.bound(trial, draw));
        trials.iter().zip(draws).map(bound).collect()
    }

    /// How far the estimate of one draw is from the truth. The truth must lie in the span of the
    /// modes, as that of the artificial source does in ours.
    ///
    /// # Errors
    /// [`Error::Value`] for modes that are not independent.
    pub fn pulls(&self, trial: &Trial, draw: &Draw, bound: &Bound) -> Result<Pulls> {
        let truth = self.truth_coefficients_nm(&draw.truth)?;
        let error: Vec<f64> =
            trial.coefficients_nm.iter().zip(&truth).map(|(estimate, truth)| estimate - truth).collect();
        let each = |(error, variance): (&f64, &f64)| error / variance.sqrt();
        let all: Vec<f64> = error.iter().zip(bound.covariance_nm2.diag()).map(each).collect();
        let (phasing, ncpa) = all.split_at(self.estimator.model().segment_modes);
        let white = self.whitened(&error, &bound.covariance_nm2)?;
        Ok(Pulls { phasing: phasing.to_vec(), ncpa: ncpa.to_vec(), white })
    }

    /// The truth in the estimated modes: its pistons, and the least-squares coefficients of its
    /// NCPA map (weight A, piston removed).
    ///
    /// # Errors
    /// [`Error::Value`] for modes that are not independent.
    pub fn truth_coefficients_nm(&self, truth: &Truth) -> Result<Vec<f64>> {
        let model = self.estimator.model();
        let (pupil, n) = (&model.telescope.pupil, model.segment_modes);
        let gram = model.basis.visible_gram(&pupil.amplitude)?.slice_move(s![n.., n..]);
        let [_, ncpa_nm] = truth.maps_on(pupil)?;
        let weight = &pupil.amplitude / pupil.weight_sum();
        let weighted_nm = pupil.remove_piston(ncpa_nm.view())?.mapv(|v| if v.is_nan() { 0.0 } else { v }) * weight;
        let maps = model.basis.maps();
        let along: Array1<f64> =
            maps.slice(s![n.., .., ..]).outer_iter().map(|map| (&map * &weighted_nm).sum()).collect();
        let metric = Metric::from_gauss_newton(&gram, NULL_FLOOR)?;
        let (mut unit, mut ncpa) = (vec![0.0; metric.rank()], vec![0.0; along.len()]);
        metric.gradient_to_z(along.as_slice().unwrap_or_default(), &mut unit);
        metric.to_x(&unit, &mut ncpa);
        Ok(truth.piston_nm.iter().copied().chain(ncpa).collect())
    }

    /// Median wall-clock time of one objective with its gradient, s, one image on one core.
    ///
    /// # Errors
    /// Those of the chain.
    pub fn evaluation_s(&self, draw: &Draw) -> Result<f64> {
        let (model, recipe) = (self.estimator.model(), self.estimator.recipe());
        let bad = draw.image_e.mapv(|_| false);
        let read_noise_e = self.estimator.scene().image.read_noise_e;
        let frame = Frame { data_e: draw.image_e.view(), bad: bad.view(), read_noise_e };
        let mut chain = Chain::cpu(model.optics.clone(), Precision::F64);
        chain.load(&[model.preparation.prepare(frame, recipe)?.exposure])?;
        let at = Array2::zeros((1, model.optics.modes()));
        chain.evaluate(&[0], at.view())?;
        let mut seconds = Vec::with_capacity(TIMED);
        for _ in 0..TIMED {
            let started = Instant::now();
            chain.evaluate(&[0], at.view())?;
            seconds.push(started.elapsed().as_secs_f64());
        }
        Ok(statistics::median(&seconds))
    }
}

/// The trials of a batch.
#[derive(Debug)]
struct Trials(Vec<Trial>);

/// Cells of a trial before its coefficients.
const TRIAL_CELLS: usize = 8;

impl KeptDraw for Trials {
    fn cells(&self) -> Vec<String> {
        let cells = |trial: &Trial| {
            let Trial { seed, phasing_nm, ncpa_nm, reduced_chi2, evaluations, seconds, status, coefficients_nm } =
                trial;
            let figures = [*phasing_nm, *ncpa_nm, *reduced_chi2, *seconds];
            let counts = [*seed, *evaluations, coefficients_nm.len()].map(|count| count.to_string());
            let head = [status.to_string()].into_iter().chain(counts).chain(to_cells(&figures));
            head.chain(to_cells(coefficients_nm)).collect::<Vec<_>>()
        };
        self.0.iter().flat_map(cells).collect()
    }

    fn from_cells(mut cells: &[&str]) -> Option<Self> {
        let mut trials = Vec::new();
        while let Some((&[status, seed, evaluations, modes, figures @ ..], rest)) =
            cells.split_first_chunk::<TRIAL_CELLS>()
        {
            let [phasing_nm, ncpa_nm, reduced_chi2, seconds] = to_numbers(&figures)?[..] else { return None };
            let (coefficients_nm, next) = rest.split_at_checked(modes.parse().ok()?)?;
            trials.push(Trial {
                seed: seed.parse().ok()?,
                phasing_nm,
                ncpa_nm,
                reduced_chi2,
                evaluations: evaluations.parse().ok()?,
                seconds,
                status: status.to_owned().into(),
                coefficients_nm: to_numbers(coefficients_nm)?,
            });
            cells = next;
        }
        cells.is_empty().then_some(Self(trials))
    }
}

fn failed(draw: &Draw, seconds: f64) -> Trial {
    Trial {
        seed: draw.seed,
        phasing_nm: f64::NAN,
        ncpa_nm: f64::NAN,
        reduced_chi2: f64::NAN,
        evaluations: 0,
        seconds,
        status: "not-converged".into(),
        coefficients_nm: Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trials_are_kept_to_the_bit() {
        let trial = |seed: usize| Trial {
            seed,
            phasing_nm: 1.0 / 3.0,
            ncpa_nm: f64::NAN,
            reduced_chi2: 1.1,
            evaluations: 17,
            seconds: 0.1,
            status: "wrong-minimum".into(),
            coefficients_nm: vec![0.1; seed],
        };
        crate::experiment::assert_survives(&Trials((0..4).map(trial).collect()));
    }
}
