//! Pass after pass: phases about the static wavefront found so far, static errors from them, until nothing changes.

use super::calm_loop::CalmLoop;
use super::evidence::Family;
use super::ncpa::Ncpa;
use super::sensor::{Sensed, SensorModel};
use super::sequence::Sequence;
use super::statics::{StaticErrors, StaticModel};
use super::{LitSamples, ResidualCovariance, Spectrum};
use crate::optimize::CancelFlag;
use crate::scene::{Knows, Scene};
use crate::telescope::Telescope;
use crate::{Error, Result};
use ndarray::{Array1, Array2, Axis, s};
use std::sync::atomic::Ordering;

/// Phases behind the images of a sequence.
#[derive(Debug, Clone)]
pub struct Measured {
    /// `[image, sample]`, nm, static and dynamic; NaN for images that cannot be used.
    pub phase_nm: Array2<f64>,
    /// χ² per degree of freedom of each image; 1 where phases are known.
    pub reduced_chi2: Vec<f64>,
    /// What the wavefront sensor measured meanwhile, mean over each exposure, `[image, slope]`, mas; none without
    /// telemetry.
    pub slopes_mas: Option<Array2<f64>>,
}

/// The static wavefront found so far, about which phases are sought.
#[derive(Debug, Clone)]
pub struct StaticWavefront {
    /// Piston of each segment, nm.
    pub pistons_nm: Vec<f64>,
    /// All else that does not change, nm at each lit sample: NCPA, and what the mirror answers to the pistons.
    pub smooth_nm: Array1<f64>,
}

/// Where phases come from: a retrieval, or a simulation that knows them.
pub trait PhaseSource {
    /// The samples on which they are known.
    fn lit(&self) -> &LitSamples;

    /// The least spectrum that the wavefront really has, where the phases may show less.
    fn least(&self) -> Option<&Spectrum> {
        None
    }

    /// The highest spatial frequency that the phases show, 1/m.
    fn seen_to_per_m(&self) -> f64 {
        f64::INFINITY
    }

    /// The phases, sought about `found`; `None` where a source has nothing to gain from it and its phases stay as they
    /// were.
    ///
    /// # Errors
    /// Those of the source.
    fn phases(&mut self, found: Option<&StaticWavefront>) -> Result<Option<Measured>>;
}

/// How static errors are sought.
#[derive(Debug, Clone)]
pub struct PassRecipe {
    /// How the NCPA are described; the family with the highest evidence is taken.
    pub families: Vec<Family>,
    /// What is known of the loop.
    pub knows: Knows,
    /// Error of each sample of the mean phase beside the turbulence's, nm.
    pub floor_nm: f64,
    /// Most passes.
    pub max_passes: usize,
    /// The last pass changed phasing and NCPA by less than this fraction of their error bars. What is left to change is about
    /// as much again.
    pub settled: f64,
}

impl Default for PassRecipe {
    fn default() -> Self {
        Self { families: vec![Family::Zernike], knows: Knows::Telemetry, floor_nm: 3.0, max_passes: 8, settled: 0.25 }
    }
}

/// What a pass found.
#[derive(Debug, Clone)]
pub struct Pass {
    /// Static errors.
    pub errors: StaticErrors,
    /// The family of their NCPA.
    pub family: Family,
    /// Names of its modes.
    pub ncpa_names: Vec<String>,
    /// Segment errors, `[y, x]` on the scene's grid, nm, NaN outside the pupil.
    pub phasing_nm: Array2<f64>,
    /// Non-common path aberrations likewise.
    pub ncpa_nm: Array2<f64>,
    /// Error bar of each map, 1σ, nm.
    pub phasing_sigma_nm: Array2<f64>,
    /// Likewise.
    pub ncpa_sigma_nm: Array2<f64>,
    /// RMS over the pupil that the residuals are expected to have, phasing and NCPA, piston, tip and tilt removed, nm.
    pub expected_nm: [f64; 2],
    /// By how much both differ from the static wavefront about which the phases were sought, RMS, nm; NaN for the first.
    pub changed_nm: [f64; 2],
    /// The images that were used.
    pub used_images: Vec<usize>,
    /// Median χ² per degree of freedom.
    pub reduced_chi2: f64,
    /// RMS of the wavefront about its mean, nm.
    pub residual_rms_nm: f64,
}

impl Pass {
    /// Further images like these after which the expected residuals are `wanted_nm`, phasing and NCPA: the variance of a
    /// mean falls as their number.
    pub fn further_images(&self, wanted_nm: [f64; 2]) -> usize {
        let factor = (0..2).map(|i| (self.expected_nm[i] / wanted_nm[i]).powi(2)).fold(1.0, f64::max);
        ((factor - 1.0) * self.used_images.len() as f64).ceil() as usize
    }
}

/// Samples with less glass than this are left out: images hardly see their phase.
const LEAST_GLASS: f64 = 0.5;

/// Runs of the calm loop in a pass: its nonlinear part is a tenth of the linear one, and each takes that off what is left.
const ANSWERS: usize = 8;
/// Change of pistons below which the loop's answer stands, nm.
const ANSWERED_NM: f64 = 0.05;

/// Comparisons of phases with slopes in a pass: a quad cell is not linear, and each takes nine tenths off what is left.
const SENSED: usize = 6;
/// Change of the NCPA, RMS, below which they are enough, nm.
const SENSED_NM: f64 = 0.2;

/// Most that a pass is led beyond what it found, in steps from the pass before.
const FARTHEST: f64 = 2.0;

/// Seeks static errors pass after pass; returns all of them, the last one last.
///
/// # Errors
/// Those of the source, of the telescope and of the loop; [`Error::Image`] where fewer than two images can be used;
/// [`Error::Interrupted`].
pub fn find_statics(
    scene: &Scene,
    source: &mut dyn PhaseSource,
    recipe: &PassRecipe,
    cancel: Option<&CancelFlag>,
) -> Result<Vec<Pass>> {
    let telescope = Telescope::of(scene)?;
    let all = source.lit().clone();
    let kept = all.with_glass(LEAST_GLASS);
    let lit = all.selected(&kept);
    let mut answers = (recipe.knows >= Knows::Loop).then(|| Answers::of(scene, &all, &kept)).transpose()?;
    let families = recipe
        .families
        .iter()
        .map(|&family| Ncpa::of(family, scene, &telescope, &all, &kept))
        .collect::<Result<Vec<_>>>()?;
    let mut passes: Vec<Pass> = Vec::new();
    let mut found: Option<StaticWavefront> = None;
    let mut measured = None;
    let mut path: Vec<Step> = Vec::new();
    for _ in 0..recipe.max_passes {
        if cancel.is_some_and(|flag| flag.load(Ordering::Relaxed)) {
            return Err(Error::Interrupted(format!("{} passes were made", passes.len())));
        }
        match source.phases(found.as_ref())? {
            Some(new) => measured = Some(new),
            // The same phases say the same.
            None if !passes.is_empty() => break,
            None => {}
        }
        let Some(measured) = &measured else { return Err(Error::Internal("a source without phases".into())) };
        let sequence = Sequence::of(measured, &kept)?;
        let mut residual = ResidualCovariance::of_scatter(&lit, sequence.residuals_nm.view())?;
        if let Some(least) = source.least() {
            residual = residual.at_least(least, lit.pitch_m);
        }
        let residual = residual.seen_to(source.seen_to_per_m(), lit.pitch_m);
        let covariance = residual.of_mean(sequence.used.len(), recipe.floor_nm, &lit);
        let mut best: Option<(StaticErrors, &Ncpa)> = None;
        for ncpa in &families {
            let pistons = answers.as_ref().map_or(lit.pistons.clone(), |answers| &lit.pistons + &answers.linear);
            let model = StaticModel::new(pistons.view(), ncpa.at_kept.view(), &ncpa.groups, &covariance)?;
            let mut errors = behind(&model, &sequence.mean_nm, answers.as_mut(), None)?;
            if let Some(slopes_mas) = measured.slopes_mas.as_ref().filter(|_| recipe.knows >= Knows::Telemetry) {
                let slopes_mas = slopes_mas.select(Axis(0), &sequence.used);
                let phases_nm = &sequence.residuals_nm + &sequence.mean_nm;
                let mut sensor = SensorModel::of(scene, &telescope, &lit, &ncpa.basis)?;
                for _ in 0..SENSED {
                    let (pistons, before) = (&errors.pistons_nm, &errors.ncpa_nm);
                    let sensed = sensor.ncpa(&lit, phases_nm.view(), slopes_mas.view(), pistons, before)?;
                    let next = behind(&model, &sequence.mean_nm, answers.as_mut(), Some(&sensed))?;
                    let moved: f64 = next.ncpa_nm.iter().zip(before).map(|(now, then)| (now - then).powi(2)).sum();
                    errors = next;
                    if moved.sqrt() < SENSED_NM {
                        break;
                    }
                }
            }
            if best.as_ref().is_none_or(|(other, _)| errors.log_evidence > other.log_evidence) {
                best = Some((errors, ncpa));
            }
        }
        let Some((errors, ncpa)) = best else {
            return Err(Error::Value("no family of NCPA modes was given: at least 1 is needed".into()));
        };
        let about = path.last().map(|step| step.about.clone());
        let pass = ncpa.pass(errors, &telescope.pupil, about, &sequence, residual.rms_nm())?;
        let next = next_about(&mut path, coefficients(&pass.errors));
        let pistons_nm = next.slice(s![..lit.pistons.nrows()]).to_vec();
        let mut smooth_nm = next.slice(s![lit.pistons.nrows()..]).dot(&ncpa.at_all);
        if let Some(answers) = &mut answers {
            smooth_nm += &answers.calm.answer_nm(&pistons_nm)?;
        }
        found = Some(StaticWavefront { pistons_nm, smooth_nm });
        let settled = (0..2).all(|i| pass.changed_nm[i] < recipe.settled * pass.expected_nm[i]);
        passes.push(pass);
        if settled {
            break;
        }
    }
    Ok(passes)
}

/// A pass on the way: where its phases were sought, and what came of it; nm, pistons and NCPA.
struct Step {
    about: Array1<f64>,
    found: Array1<f64>,
}

/// Where the next pass looks. A pass that recovers a part of what its static wavefront still lacks approaches the answer
/// as a geometric series, which two passes determine (Anderson's acceleration of depth one); `path` ends in the place for
/// the next step.
fn next_about(path: &mut Vec<Step>, found: Array1<f64>) -> Array1<f64> {
    let last = match path.last_mut() {
        None => {
            path.push(Step { about: Array1::zeros(found.len()), found: found.clone() });
            0
        }
        Some(step) => {
            step.found = found.clone();
            path.len() - 1
        }
    };
    let mut next = found;
    if last > 0 && path[last].found.len() == path[last - 1].found.len() {
        let [before, now] = [&path[last - 1], &path[last]].map(|step| &step.found - &step.about);
        let turn = &now - &before;
        let share = now.dot(&turn) / turn.dot(&turn).max(f64::MIN_POSITIVE);
        // Beyond three times the last step the series is not geometric.
        next.scaled_add(-share.clamp(-FARTHEST, 0.5), &(&path[last].found - &path[last - 1].found));
    }
    path.push(Step { about: next.clone(), found: next.clone() });
    next
}

/// Pistons and NCPA in turn.
pub(super) fn coefficients(errors: &StaticErrors) -> Array1<f64> {
    errors.pistons_nm.iter().chain(&errors.ncpa_nm).copied().collect()
}

/// The static errors behind a mean phase, the loop's answer to them run again until it stands.
fn behind(
    model: &StaticModel,
    mean_nm: &Array1<f64>,
    answers: Option<&mut Answers>,
    sensed: Option<&Sensed>,
) -> Result<StaticErrors> {
    let mut errors = model.estimate(mean_nm.view(), sensed)?;
    let Some(answers) = answers else { return Ok(errors) };
    for _ in 0..ANSWERS {
        let pistons_nm = Array1::from(errors.pistons_nm.clone());
        let nonlinear_nm = answers.at_kept(&errors.pistons_nm)? - pistons_nm.dot(&answers.linear);
        errors = model.estimate((mean_nm - &nonlinear_nm).view(), sensed)?;
        let moved = errors.pistons_nm.iter().zip(&pistons_nm).map(|(now, then)| (now - then).abs());
        if moved.fold(0.0, f64::max) < ANSWERED_NM {
            break;
        }
    }
    Ok(errors)
}

/// The calm loop and its linear part at the samples that are kept.
struct Answers {
    calm: CalmLoop,
    kept: Vec<usize>,
    linear: Array2<f64>,
}

impl Answers {
    fn of(scene: &Scene, lit: &LitSamples, kept: &[usize]) -> Result<Self> {
        let mut calm = CalmLoop::of(scene, lit)?;
        let linear = calm.linear_answer()?.select(Axis(1), kept);
        Ok(Self { calm, kept: kept.to_vec(), linear })
    }

    fn at_kept(&mut self, pistons_nm: &[f64]) -> Result<Array1<f64>> {
        Ok(self.calm.answer_nm(pistons_nm)?.select(Axis(0), &self.kept))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_geometric_series_is_at_its_end_in_three_passes() {
        // Each pass recovers 55 % of what its static wavefront lacks.
        let truth = Array1::from(vec![30.0, -12.0, 5.0]);
        let pass = |about: &Array1<f64>| about + &((&truth - about) * 0.55);
        let (mut path, mut about) = (Vec::new(), Array1::zeros(3));
        for _ in 0..2 {
            about = next_about(&mut path, pass(&about));
        }
        // 45 % of 45 % would be left without the extrapolation; rounding is with it.
        assert!((&about - &truth).iter().all(|off| off.abs() < 1e-10), "{about}");
    }
}
