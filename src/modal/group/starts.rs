//! Fits of a group from several starts. The wavefront that some of its images show alone is the
//! first, or the flat one; where the sign of the diversities is not known, that is tried with both.
//! While χ² of the best minimum is larger than noise explains, random wavefronts follow, and, in
//! turn with them, the best minimum with a random wavefront added, which finds its neighbours;
//! until three of the first end in the best. The turned wavefront W′(x) = −W(−x), whose images in
//! focus are the same, is tried last.

use crate::Result;
use crate::control::Control;
use crate::modal::assess::status::suspicion;
use crate::modal::group::fit::{Group, Precise, Trial};
use crate::modal::model::Model;
use crate::modal::solve::restart::CONFIRMING;
use crate::optimize::Metric;
use ndarray::{Array1, s};
use rand::SeedableRng;
use rand_chacha::ChaCha12Rng;
use rand_distr::{Distribution, StandardNormal};

/// Differences of χ² up to which two fits have ended in one minimum; minima beyond it are distinct.
const SAME: f64 = 25.0;
/// The same as a share of χ², which counts where the model does not explain the images.
const SAME_SHARE: f64 = 3e-3;
/// Standard deviations of χ² from which random starts are made: right minima are below 3.5, wrong
/// ones at 10 and more.
const SUSPICIOUS: f64 = 4.0;
/// Starts for each that `estimate.restarts` allows a fit of one image. Of five real images of a
/// bench in focus one random start in four ends in the best minimum.
const STARTS: usize = 4;
/// RMS of the first NCPA mode of a random start, waves; mode k of the NCPA has
/// this times k to the power [`NCPA_POWER`]. Together some 0.1 waves RMS.
const NCPA_WAVES: f64 = 0.06;
/// RMS of a segment mode of a random start, waves.
const SEGMENT_WAVES: f64 = 0.05;
/// See [`NCPA_WAVES`].
const NCPA_POWER: f64 = -0.75;
/// Eigenvalues of the modes' Gram matrix below this fraction of the largest are rounding.
const NULL_FLOOR: f64 = 1e-10;

/// The minima of a group.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Minima {
    /// Number of starts.
    pub(crate) starts: usize,
    /// Of those, how many ended in the best minimum.
    pub(crate) in_best: usize,
    /// How much larger χ² of the next one is.
    pub(crate) next: Option<f64>,
    /// Whether the turned wavefront explains the images as well.
    pub(crate) has_twin: bool,
    /// Whether χ² of the best is larger than noise explains.
    pub(crate) is_suspicious: bool,
}

/// Fits the group from `near_nm`, or the flat wavefront, and further starts; the best minimum, in
/// which the images of the group are left.
///
/// # Errors
/// As [`Group::fit`].
pub(super) fn fit_from_all(group: &mut Group, near_nm: Option<&[f64]>, control: &Control) -> Result<(Trial, Minima)> {
    let (unknowns, modes) = (group.unknowns.count(), group.members[0].fitter.model.optics.modes());
    let unit_nm = group.amplitude_unit_nm();
    let amplitude = group.unknowns.amplitude();
    let from = |modes_nm: &[f64], sign: f64| {
        let mut start = vec![0.0; unknowns];
        start[..modes].copy_from_slice(modes_nm);
        if let Some(place) = amplitude {
            start[place] = (sign - 1.0) * unit_nm;
        }
        start
    };
    let silent = &control.silent();
    let flat_nm = vec![0.0; modes];
    let (first, precision) = match near_nm {
        Some(near_nm) => (near_nm, Precise::Wavefront),
        None => (&flat_nm[..], Precise::Minimum),
    };
    let mut trials = vec![group.fit(&from(first, 1.0), precision, silent)?];
    if amplitude.is_some() && near_nm.is_none() {
        trials.push(group.fit(&from(&flat_nm, -1.0), Precise::Minimum, silent)?);
    }
    let fitter = group.members[0].fitter;
    let mut random = Vec::new();
    for attempt in 1..=STARTS * fitter.recipe.restarts {
        let best = best_of(&trials);
        let is_right = trials[best].has_converged() && deviations(&trials[best]) < SUSPICIOUS;
        let found = random.iter().filter(|&&place: &&usize| is_same(&trials[place], &trials[best])).count();
        if is_right || found > CONFIRMING {
            break;
        }
        let mut start = random_wavefront(&fitter.model, attempt);
        if attempt % 2 == 0 {
            start.iter_mut().zip(&trials[best].point).for_each(|(nm, best)| *nm += best);
        } else {
            random.push(trials.len());
        }
        let own = 1.0 + trials[best].amplitude(group);
        trials.push(group.fit(&from(&start, own), Precise::Minimum, silent)?);
    }
    let best = best_of(&trials);
    let turned = turned(&fitter.model, &trials[best].point[..modes])?;
    let own = 1.0 + trials[best].amplitude(group);
    let signs = if amplitude.is_some() { vec![own, -own] } else { vec![own] };
    for sign in signs {
        trials.push(group.fit(&from(&turned, sign), Precise::Minimum, silent)?);
    }
    let best = best_of(&trials);
    let chi2 = trials[best].chi2();
    let others = trials.iter().map(|trial| trial.chi2() - chi2);
    let information = {
        let again = trials[best].point.clone();
        group.information(&again)?
    };
    let is_twin = |trial: &Trial| {
        let off: Array1<f64> = trial.point.iter().zip(&trials[best].point).map(|(a, b)| a - b).collect();
        trial.chi2() - chi2 < SAME && off.dot(&information.dot(&off)) > SAME.max(unknowns as f64) * SAME
    };
    let minima = Minima {
        starts: trials.len(),
        in_best: in_minimum(&trials, best),
        next: others.filter(|off| *off >= SAME.max(SAME_SHARE * chi2)).reduce(f64::min),
        has_twin: trials.iter().any(is_twin),
        is_suspicious: deviations(&trials[best]) >= SUSPICIOUS,
    };
    // The weights and the outlier pixels of the images are those of the last fit.
    let best = trials.swap_remove(best);
    let again = group.fit(&best.point, Precise::Wavefront, silent)?;
    Ok((again, minima))
}

/// The trial with the smallest χ² among those that converged, or among all.
fn best_of(trials: &[Trial]) -> usize {
    let key = |trial: &Trial| (!trial.has_converged(), trial.chi2());
    let order = |a: &usize, b: &usize| {
        let ((stopped_a, a), (stopped_b, b)) = (key(&trials[*a]), key(&trials[*b]));
        stopped_a.cmp(&stopped_b).then(a.total_cmp(&b))
    };
    (0..trials.len()).min_by(order).unwrap_or(0)
}

/// Whether two trials ended in one minimum.
fn is_same(one: &Trial, other: &Trial) -> bool {
    (one.chi2() - other.chi2()).abs() < SAME.max(SAME_SHARE * other.chi2())
}

/// Number of trials in the minimum of the trial `best`.
fn in_minimum(trials: &[Trial], best: usize) -> usize {
    trials.iter().filter(|trial| is_same(trial, &trials[best])).count()
}

/// χ² of all images above its expectation, in standard deviations.
fn deviations(trial: &Trial) -> f64 {
    let (mut above, mut variance) = (0.0, 0.0);
    for minimum in &trial.minima {
        let (own, scatter) = suspicion(&minimum.chi2);
        above += own * minimum.chi2.freedom;
        variance += (scatter * minimum.chi2.freedom).powi(2);
    }
    above / variance.sqrt()
}

/// Coefficients of a random wavefront, nm: the same for every group.
fn random_wavefront(model: &Model, attempt: usize) -> Vec<f64> {
    let mut rng = ChaCha12Rng::seed_from_u64(attempt as u64);
    let rms_waves = |mode: usize| match mode.checked_sub(model.segment_modes) {
        None => SEGMENT_WAVES,
        Some(ncpa) => NCPA_WAVES * (ncpa as f64 + 1.0).powf(NCPA_POWER),
    };
    let wavelength_nm = model.optics.parts().wavelength_nm;
    let normal = |mode: usize| -> f64 {
        let unit: f64 = StandardNormal.sample(&mut rng);
        unit * rms_waves(mode) * wavelength_nm
    };
    (0..model.optics.modes()).map(normal).collect()
}

/// Coefficients of −W(−x) for those of W, by least squares over the pupil.
fn turned(model: &Model, coefficients_nm: &[f64]) -> Result<Vec<f64>> {
    let (basis, pupil) = (&model.basis, &model.telescope.pupil);
    let map = basis.combined(coefficients_nm, 0..basis.len());
    let turned = -map.slice(s![..;-1, ..;-1]).to_owned();
    let along = basis.along(&(&turned * &pupil.amplitude))?;
    let metric = Metric::from_gauss_newton(&basis.gram(&pupil.amplitude)?, NULL_FLOOR)?;
    let (mut unit, mut found) = (vec![0.0; metric.rank()], vec![0.0; basis.len()]);
    metric.gradient_to_z(&along, &mut unit);
    metric.to_x(&unit, &mut found);
    Ok(found)
}
