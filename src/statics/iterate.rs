//! Iterations of the static estimate: wavefronts about the last static wavefront, static errors
//! from them, until the change is small.

use super::anderson::AndersonAcceleration;
use super::covariance::ResidualCovariance;
use super::estimator::{StaticsEstimator, images_with_slopes};
use super::image_selection::SelectedImages;
use super::iteration::Iteration;
use super::ncpa_basis::NcpaFamily;
use super::segment_tilts::SegmentTilts;
use super::settings::{StaticsSettings, TiltSelection};
use super::static_modes::StaticModes;
use super::wavefront_source::{RetrievedSequence, WavefrontSource};
use crate::control::Control;
use crate::linear_algebra::combination;
use crate::retrieval::StaticWavefront;
use crate::scene::{AoKnowledge, System};
use crate::{Error, Result};
use ndarray::{Array1, ArrayView1, Axis};

/// Prior RMS of a mode of either of a basis's two highest groups beyond which the NCPA extend
/// beyond the basis, nm: noise and turbulence leave 0.1 to 0.3.
const EXTENDS_BEYOND_NM: f64 = 0.5;

/// Largest part of the estimated NCPA that a finer basis may leave out, as a fraction of the RMS
/// that is extrapolated beyond the coarser one: a half, because the extrapolation can be twice too
/// large. Modes of a mirror with few actuators do not hold the lowest polynomials.
const LARGEST_LEFT_OUT: f64 = 0.5;

/// Estimates static errors iteratively; returns all iterations, of which the last is the estimate.
///
/// # Errors
/// Those of the source, of the telescope and of the loop; [`Error::Image`] where fewer than two
/// images can be used; [`Error::Interrupted`].
pub fn estimate_static_errors(
    scene: &System,
    source: &mut dyn WavefrontSource,
    settings: &StaticsSettings,
    control: &Control,
) -> Result<Vec<Iteration>> {
    let mut estimate = IterativeEstimate::new(scene, source, settings, control)?;
    let (mut about, mut sequence) = (None, None);
    while estimate.iterations.len() < estimate.max_iterations {
        let count = estimate.iterations.len();
        control.check_with(|| format!("{count} iterations were made"))?;
        let new = source.retrieve(about.as_ref())?;
        // The same wavefronts would give the same estimate.
        let is_new = new.is_some() || count == 0;
        sequence = new.or(sequence);
        let Some(sequence) = &sequence else { return Err(Error::Internal("a source without wavefronts".into())) };
        if is_new {
            about = Some(estimate.iterate(sequence, source)?);
            if estimate.needs_iteration()? {
                continue;
            }
        }
        if !estimate.adopt_segment_tilts()? {
            break;
        }
        // With tilts they give another one.
        about = Some(estimate.iterate(sequence, source)?);
        estimate.needs_iteration()?;
    }
    estimate.finish()
}

/// State of the iterations.
struct IterativeEstimate<'a> {
    settings: &'a StaticsSettings,
    max_iterations: usize,
    estimator: StaticsEstimator<'a>,
    /// Families of the basis ladder that are finer than the current one.
    finer: std::slice::Iter<'a, NcpaFamily>,
    modes: StaticModes,
    acceleration: AndersonAcceleration,
    /// Coefficients about which the last wavefronts were retrieved; `None` in the first iteration.
    input: Option<Array1<f64>>,
    iterations: Vec<Iteration>,
    /// Tilts in the last residual in which they were sought.
    segment_tilts: Option<SegmentTilts>,
    /// Covariance of the last wavefronts.
    residual: Option<ResidualCovariance>,
    /// RMS of NCPA that coarser bases held and the current one does not, nm.
    left_out_nm: f64,
    /// RMS of NCPA beyond the modes, nm.
    beyond_modes_nm: f64,
}

impl<'a> IterativeEstimate<'a> {
    fn new(
        scene: &'a System,
        source: &dyn WavefrontSource,
        settings: &'a StaticsSettings,
        control: &'a Control,
    ) -> Result<Self> {
        let mut estimator = StaticsEstimator::new(scene, source, settings, control)?;
        if settings.tilts == TiltSelection::Always {
            estimator.add_tilts()?;
        }
        let mut finer = settings.families.iter();
        let Some(&coarsest) = finer.next() else {
            return Err(Error::Value("no family of NCPA modes was given: at least 1 is needed".into()));
        };
        Ok(Self {
            settings,
            max_iterations: settings.max_iterations,
            modes: estimator.static_modes(coarsest)?,
            estimator,
            finer,
            acceleration: AndersonAcceleration::default(),
            input: None,
            iterations: Vec::new(),
            segment_tilts: None,
            residual: None,
            left_out_nm: 0.0,
            beyond_modes_nm: 0.0,
        })
    }

    fn has_telemetry(&self) -> bool {
        self.settings.ao_knowledge >= AoKnowledge::Telemetry
    }

    /// Makes an iteration from the wavefronts of `sequence`; returns the static wavefront of the
    /// next one.
    fn iterate(&mut self, sequence: &RetrievedSequence, source: &dyn WavefrontSource) -> Result<StaticWavefront> {
        let images = SelectedImages::new(sequence, &self.estimator.kept)?;
        let residual = self.residual_covariance(&images, source)?;
        let slopes_mas = sequence.slopes_mas.as_ref().filter(|_| self.has_telemetry());
        let slopes_mas = slopes_mas.map(|slopes_mas| slopes_mas.select(Axis(0), &images.used));
        // One image has no scatter by which slopes are weighed.
        let slopes_mas = slopes_mas.filter(|slopes_mas| images_with_slopes(slopes_mas.view()).len() > 1);
        let errors = self.estimator.estimate(&self.modes, &images, &residual, slopes_mas)?;
        self.input = self.acceleration.input().cloned();
        self.acceleration.record(errors.coefficients_nm());
        // Segments are weighted by the power spectrum S of the whole residual, of which wavefronts
        // recover the fraction a: about their mean they scatter by a·S, and after all iterations by
        // a·S/a² = S/a, where the estimate assumes S. NCPA are weighted by their own scatter, which
        // grows to 1/a² of itself.
        let segment_modes = errors.segment_modes();
        let segments = self.acceleration.recovered_fraction(0..segment_modes).sqrt();
        let ncpa = self.acceleration.recovered_fraction(segment_modes..usize::MAX);
        let errors = errors.with_recovered_fractions([segments, ncpa]);
        let pupil = &self.estimator.telescope.pupil;
        let uncompensated_nm = self.estimator.uncompensated_nm(&errors);
        let iteration =
            self.modes.iteration((errors, uncompensated_nm), pupil, self.input.clone(), &images, residual.rms_nm())?;
        let next = self.acceleration.next_input();
        let about = self.estimator.static_wavefront(&self.modes, &next, &iteration.errors)?;
        self.iterations.push(iteration);
        self.residual = Some(residual);
        Ok(about)
    }

    /// Covariance of the residuals of the selected images: no less than the prior, by which
    /// retrieved wavefronts are shrunk, and unknown beyond the frequencies that they resolve.
    fn residual_covariance(&self, images: &SelectedImages, source: &dyn WavefrontSource) -> Result<ResidualCovariance> {
        let samples = &self.estimator.samples;
        let mut residual = ResidualCovariance::from_residuals(samples, images.residuals_nm.view())?;
        if let Some(prior) = source.prior() {
            residual = residual.with_lower_bound(prior, samples.pitch_m);
        }
        Ok(residual.with_unresolved_beyond(source.highest_frequency_per_m(), samples.pitch_m))
    }

    /// Whether the last iteration changed little; the first one in a basis has no change to
    /// compare.
    fn is_settled(&self) -> bool {
        let is_small = |last: &Iteration| {
            !last.change_nm.iter().any(|nm| nm.is_nan()) && !last.has_changed(self.settings.tolerance)
        };
        self.iterations.last().is_some_and(is_small)
    }

    /// Whether further iterations are to be made: the last one has changed much, or another basis
    /// is taken.
    fn needs_iteration(&mut self) -> Result<bool> {
        let is_unsettled = !self.is_settled() && self.iterations.len() < self.max_iterations;
        Ok(self.take_finer_basis()? || is_unsettled)
    }

    /// Seeks tilts of single segments in the residual of the last iteration, where they are not
    /// estimated; returns whether it is to be made again with them. They are sought at the end
    /// alone: only then is the residual that of turbulence where there are none, and a sequence
    /// without them loses no time.
    fn adopt_segment_tilts(&mut self) -> Result<bool> {
        if self.estimator.has_tilts() {
            return Ok(false);
        }
        self.segment_tilts = self.find_segment_tilts()?;
        let is_significant = self.segment_tilts.as_ref().is_some_and(SegmentTilts::is_significant);
        if self.settings.tilts != TiltSelection::WhereSignificant || !is_significant {
            return Ok(false);
        }
        let family = self.modes.family;
        self.estimator.add_tilts()?;
        self.modes = self.estimator.static_modes(family)?;
        self.iterations.pop();
        self.max_iterations = self.iterations.len() + self.settings.max_iterations;
        let segments = self.estimator.samples.pistons.nrows();
        let with_tilts = |input: Array1<f64>| {
            let (pistons_nm, ncpa_nm) = input.view().split_at(Axis(0), segments);
            pistons_nm
                .iter()
                .copied()
                .chain(std::iter::repeat_n(0.0, 2 * segments))
                .chain(ncpa_nm.iter().copied())
                .collect()
        };
        self.acceleration = AndersonAcceleration::from_input(self.input.take().map(with_tilts));
        Ok(true)
    }

    /// Tilts of single segments in the residual of the last iteration.
    fn find_segment_tilts(&self) -> Result<Option<SegmentTilts>> {
        let (Some(last), Some(residual)) = (self.iterations.last(), &self.residual) else { return Ok(None) };
        self.estimator.tilts_in_residual(last.errors.residual_nm.view(), residual, last.used_images.len())
    }

    /// Takes the next basis of the ladder where the NCPA extend beyond the current one and the next
    /// one holds more of them; returns whether it did.
    fn take_finer_basis(&mut self) -> Result<bool> {
        let Some(last) = self.iterations.last() else { return Ok(false) };
        let orders = self.modes.orders;
        // Without telemetry turbulence that did not average extends beyond the modes, too.
        let extends_beyond = self.has_telemetry() && last.errors.highest_groups_rms_nm(orders) > EXTENDS_BEYOND_NM;
        // NCPA that extend beyond the coarsest basis fall slowly: they extend beyond the next, even
        // where its highest modes show little.
        let is_refined = last.family != self.settings.families[0];
        let extrapolated_nm = if extends_beyond || is_refined { last.errors.extrapolated_ncpa_nm(orders) } else { 0.0 };
        self.beyond_modes_nm = extrapolated_nm.hypot(self.left_out_nm);
        if extends_beyond && let Some(&family) = self.finer.next() {
            let modes = self.estimator.static_modes(family)?;
            let found_nm = combination(ArrayView1::from(&last.errors.ncpa_nm), self.modes.at_kept.view());
            let left_out_nm = modes.remainder_nm(found_nm.view())?;
            if modes.orders > orders && left_out_nm < LARGEST_LEFT_OUT * extrapolated_nm {
                self.left_out_nm = self.left_out_nm.hypot(left_out_nm);
                self.modes = modes;
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Returns the iterations, with the segment tilts, the NCPA beyond the modes and the reference
    /// slopes in the last.
    fn finish(mut self) -> Result<Vec<Iteration>> {
        if self.segment_tilts.is_none() && !self.estimator.has_tilts() {
            self.segment_tilts = self.find_segment_tilts()?;
        }
        if let Some(last) = self.iterations.last_mut() {
            last.segment_tilts = self.segment_tilts;
            last.reference_mas_per_nm = self.estimator.reference_mas_per_nm();
            last.add_beyond_modes(self.beyond_modes_nm);
        }
        Ok(self.iterations)
    }
}
