//! Pass after pass: phases about the static wavefront found so far, static errors from them, until nothing changes.

use super::anderson::Path;
use super::covariance::ResidualCovariance;
use super::empirical_bayes::Family;
use super::image_selection::Sequence;
use super::least_squares::{StaticErrors, StaticModel};
use super::segment_tilts::SegmentTilts;
use super::static_modes::Ncpa;
use crate::estimate::{HeldDiversity, within_reach};
use crate::loop_response::CalmLoop;
use crate::loop_response::Sensed;
use crate::loop_response::SensorModel;
use crate::modes::SegmentModes;
use crate::optimize::CancelFlag;
use crate::retrieval::{LitSamples, Spectrum};
use crate::scene::{Knows, Scene};
use crate::telescope::Telescope;
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1, Axis};
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
    /// How the NCPA are described, from coarse to fine: the next family is taken where the strength of the last one's highest
    /// modes says that the NCPA go on beyond them.
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
        // To order 13, 104 polynomials of up to 26 zeros around the pupil: few, so that NCPA which end there are known well. Of
        // what Keck's mirror holds of three measured maps they leave 29, 33 and 16 nm, those to order 20 (230 of them) 14, 16
        // and 8, to 24 of the second map 13; the mirror's own 274 leave nothing.
        let families = vec![Family::Zernike { highest_order: 13 }, Family::Mirror];
        Self { families, knows: Knows::Telemetry, floor_nm: 3.0, max_passes: 8, settled: 0.25 }
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
    /// Likewise without what all images and passes share: an error of the diversity (`estimate.diversity_error`),
    /// [`Pass::beyond_nm`] and [`Pass::answer_nm`].
    pub averaged_nm: [f64; 2],
    /// RMS of NCPA that go on beyond the finest modes that there are, nm, as these fall; 0 where they do not go on.
    pub beyond_nm: f64,
    /// RMS of what a loop that is not known is expected to have made of the pistons, nm, which counts as NCPA; 0 where the loop
    /// is known.
    pub answer_nm: f64,
    /// By how much both differ from the static wavefront about which the phases were sought, RMS, nm; NaN for the first.
    pub changed_nm: [f64; 2],
    /// The images that were used.
    pub used_images: Vec<usize>,
    /// Median χ² per degree of freedom.
    pub reduced_chi2: f64,
    /// RMS of the wavefront about its mean, nm.
    pub residual_rms_nm: f64,
    /// The diversity as the NCPA's modes hold it.
    pub diversity: HeldDiversity,
    /// What the mean phase still holds of tilts of single segments; of the last pass.
    pub segment_tilts: Option<SegmentTilts>,
}

impl Pass {
    /// Names of the static modes: pistons, then NCPA.
    pub fn mode_names(&self) -> Vec<String> {
        let mut names = SegmentModes::Piston.names(self.errors.pistons_nm.len());
        names.extend_from_slice(&self.ncpa_names);
        names
    }

    /// Their coefficients, nm.
    pub fn coefficients_nm(&self) -> Vec<f64> {
        coefficients(&self.errors).to_vec()
    }

    /// Error bars of these, 1σ, nm.
    pub fn sigma_nm(&self) -> Vec<f64> {
        self.errors.covariance_nm2.diag().iter().map(|nm2| nm2.max(0.0).sqrt()).collect()
    }

    /// Further images like these after which the expected residuals are `wanted_nm`, phasing and NCPA: the variance of a
    /// mean falls as their number.
    ///
    /// # Errors
    /// [`Error::Value`] where no number of them gets there, for what all share.
    pub fn further_images(&self, wanted_nm: [f64; 2]) -> Result<usize> {
        let mut factor = 1.0f64;
        for (i, wanted_nm) in wanted_nm.into_iter().enumerate() {
            let averaged_nm = self.averaged_nm[i];
            let shared_nm2 = (self.expected_nm[i].powi(2) - averaged_nm.powi(2)).max(0.0);
            within_reach(wanted_nm, shared_nm2)?;
            factor = factor.max((averaged_nm / (wanted_nm.powi(2) - shared_nm2).sqrt()).powi(2));
        }
        Ok(((factor - 1.0) * self.used_images.len() as f64).ceil() as usize)
    }

    /// Has the error bars of the NCPA hold as much that no mode describes, in the whole pupil alike.
    pub(super) fn go_beyond(&mut self, beyond_nm: f64) {
        self.beyond_nm = beyond_nm;
        self.expected_nm[1] = self.expected_nm[1].hypot(beyond_nm);
        self.ncpa_sigma_nm.mapv_inplace(|nm| nm.hypot(beyond_nm));
    }

    /// Whether it changed phasing or NCPA by no less than the fraction `settled` of what is averaged in their error bars: what
    /// all passes share says nothing of what further ones change.
    pub(crate) fn moved(&self, settled: f64) -> bool {
        (0..2).any(|i| self.changed_nm[i] >= settled * self.averaged_nm[i])
    }
}

/// Samples with less glass than this are left out: images hardly see their phase.
const LEAST_GLASS: f64 = 0.5;

/// Runs of the calm loop in a pass: its nonlinear part is a tenth of the linear one, and each takes that off what is left.
const ANSWERS: usize = 8;
/// Change of pistons below which the loop's answer stands, nm.
const ANSWERED_NM: f64 = 0.05;

/// Strength of the modes of one of a family's two highest groups, nm RMS of a mode, beyond which the NCPA go on: noise and
/// turbulence leave 0.1 to 0.3.
const GOES_ON_NM: f64 = 0.5;

/// Comparisons of phases with slopes in a pass: a quad cell is not linear, and each takes nine tenths off what is left.
const SENSED: usize = 6;
/// Change of the NCPA, RMS, below which they are enough, nm.
const SENSED_NM: f64 = 0.2;

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
    let mut search = Search::of(scene, source.lit(), recipe)?;
    let telemetry = recipe.knows >= Knows::Telemetry;
    let mut families = recipe.families.iter();
    let mut ncpa = search.family(families.next())?;
    let mut passes: Vec<Pass> = Vec::new();
    let mut found: Option<StaticWavefront> = None;
    let mut measured = None;
    let (mut path, mut scatter, mut beyond_nm) = (Path::default(), None, 0.0);
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
        let sequence = Sequence::of(measured, &search.kept)?;
        let mut residual = ResidualCovariance::of_scatter(&search.lit, sequence.residuals_nm.view())?;
        if let Some(least) = source.least() {
            residual = residual.at_least(least, search.lit.pitch_m);
        }
        let residual = residual.seen_to(source.seen_to_per_m(), search.lit.pitch_m);
        let slopes_mas = measured.slopes_mas.as_ref().filter(|_| telemetry);
        let slopes_mas = slopes_mas.map(|slopes_mas| slopes_mas.select(Axis(0), &sequence.used));
        let errors = search.statics(&ncpa, &sequence, &residual, slopes_mas)?;
        let about = path.about().cloned();
        path.arrive(coefficients(&errors));
        // Pistons are weighed by the spectrum S of the whole residual, of which phases show the share a: about their mean
        // they scatter by a·S, and after all passes by a·S/a². What slopes do not see is weighed as it scatters.
        let segments = search.lit.pistons.nrows();
        let shares = [path.recovered(0..segments).sqrt(), path.recovered(segments..usize::MAX)];
        let errors = errors.widened(shares);
        let pass = ncpa.pass(errors, &search.telescope.pupil, about, &sequence, residual.rms_nm())?;
        found = Some(search.shown(&ncpa, &path.depart(), &pass.errors)?);
        // The first changed nothing that was there before.
        let settled = !pass.changed_nm.iter().any(|nm| nm.is_nan()) && !pass.moved(recipe.settled);
        // Without telemetry turbulence that did not average out goes on, too.
        let goes_on = telemetry && pass.errors.highest_nm(ncpa.groups.len()) > GOES_ON_NM;
        let orders = ncpa.groups.len();
        // NCPA that went on beyond the coarsest family fall slowly: they go on beyond the next, however little is seen of it.
        let finest = pass.family != recipe.families[0];
        beyond_nm = if goes_on || finest { pass.errors.beyond_nm(orders) } else { 0.0 };
        passes.push(pass);
        scatter = Some((residual, sequence.used.len()));
        let finer = if goes_on { families.next().map(|next| search.family(Some(next))).transpose()? } else { None };
        match finer.filter(|finer| finer.groups.len() > orders) {
            Some(finer) => ncpa = finer,
            None if settled => break,
            None => {}
        }
    }
    if let (Some(last), Some((residual, images))) = (passes.last_mut(), scatter) {
        let covariance = residual.of_mean(images, recipe.floor_nm, &search.lit);
        last.segment_tilts = Some(SegmentTilts::of(last.errors.unexplained_nm.view(), &covariance, &search.lit)?);
        last.go_beyond(beyond_nm);
    }
    Ok(passes)
}

/// What all passes over a sequence share.
struct Search<'a> {
    scene: &'a Scene,
    telescope: Telescope,
    all: LitSamples,
    /// The samples that count, of all.
    kept: Vec<usize>,
    lit: LitSamples,
    answers: Option<Answers>,
    floor_nm: f64,
}

impl<'a> Search<'a> {
    fn of(scene: &'a Scene, all: &LitSamples, recipe: &PassRecipe) -> Result<Self> {
        let kept = all.with_glass(LEAST_GLASS);
        let answers = (recipe.knows >= Knows::Loop).then(|| Answers::of(scene, all, &kept)).transpose()?;
        let (telescope, lit) = (Telescope::of(scene)?, all.selected(&kept));
        Ok(Self { scene, telescope, all: all.clone(), kept, lit, answers, floor_nm: recipe.floor_nm })
    }

    fn family(&self, family: Option<&Family>) -> Result<Ncpa> {
        let Some(&family) = family else {
            return Err(Error::Value("no family of NCPA modes was given: at least 1 is needed".into()));
        };
        Ncpa::of(family, self.scene, &self.telescope, (&self.all, &self.kept), self.answers.is_some())
    }

    /// The static errors behind phases that scatter with `residual`, and slopes measured meanwhile (`[image, slope]`, mas).
    fn statics(
        &mut self,
        ncpa: &Ncpa,
        sequence: &Sequence,
        residual: &ResidualCovariance,
        slopes_mas: Option<Array2<f64>>,
    ) -> Result<StaticErrors> {
        let covariance = residual.of_mean(sequence.used.len(), self.floor_nm, &self.lit);
        let pistons = match &self.answers {
            Some(answers) => &self.lit.pistons + &answers.linear,
            None => self.lit.pistons.clone(),
        };
        let groups = (&ncpa.groups[..], slopes_mas.is_some());
        let model = StaticModel::new(pistons.view(), ncpa.at_kept.view(), groups, &covariance)?;
        let mut answers = self.answers.as_mut();
        let mut errors = behind(&model, &sequence.mean_nm, answers.as_deref_mut(), None, None)?;
        let Some(slopes_mas) = slopes_mas else { return Ok(errors) };
        let phases_nm = &sequence.residuals_nm + &sequence.mean_nm;
        let mut sensor = SensorModel::of(self.scene, &self.telescope, &self.lit, &ncpa.basis)?;
        for comparison in 0..SENSED {
            let (pistons, before) = (&errors.pistons_nm, &errors.ncpa_nm);
            let sensed = sensor.ncpa(&self.lit, phases_nm.view(), slopes_mas.view(), pistons, before)?;
            // What phases alone support says little of what they do with slopes.
            let start = (comparison > 0).then_some(&errors);
            let next = behind(&model, &sequence.mean_nm, answers.as_deref_mut(), Some(&sensed), start)?;
            let moved: f64 = next.ncpa_nm.iter().zip(before).map(|(now, then)| (now - then).powi(2)).sum();
            errors = next;
            if moved.sqrt() < SENSED_NM {
                break;
            }
        }
        Ok(errors)
    }

    /// The wavefront that coefficients `about` (pistons and NCPA) and what the sensor saw of `errors` make.
    fn shown(&mut self, ncpa: &Ncpa, about: &Array1<f64>, errors: &StaticErrors) -> Result<StaticWavefront> {
        let (pistons, smooth) = about.view().split_at(Axis(0), errors.pistons_nm.len());
        let pistons_nm = pistons.to_vec();
        let mut smooth_nm = (&smooth + &ArrayView1::from(&errors.followed_nm)).dot(&ncpa.at_all);
        if let Some(answers) = &mut self.answers {
            smooth_nm += &answers.calm.answer_nm(&pistons_nm)?;
        }
        Ok(StaticWavefront { pistons_nm, smooth_nm })
    }
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
    before: Option<&StaticErrors>,
) -> Result<StaticErrors> {
    let mut errors = model.estimate(mean_nm.view(), sensed, before)?;
    let Some(answers) = answers else { return Ok(errors) };
    for _ in 0..ANSWERS {
        let pistons_nm = Array1::from(errors.pistons_nm.clone());
        let nonlinear_nm = answers.at_kept(&errors.pistons_nm)? - pistons_nm.dot(&answers.linear);
        errors = model.estimate((mean_nm - &nonlinear_nm).view(), sensed, Some(&errors))?;
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
