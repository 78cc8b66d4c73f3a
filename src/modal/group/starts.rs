//! Fits of a group from several starts. The wavefront that some of its images show alone is the
//! first, or the flat one; where the sign of the diversities is not known, that is tried with both.
//! While χ² of the best minimum is larger than noise explains, random wavefronts follow, and, in
//! turn with them, the best minimum with a random wavefront added, which finds its neighbours;
//! until three of the first end in the best. The turned wavefront W′(x) = −W(−x), whose images in
//! focus are the same, is tried last.

use crate::Result;
use crate::control::Control;
use crate::modal::assess::status::suspicion;
use crate::modal::group::fit::{Freedom, Group, Trial};
use crate::modal::model::Model;
use crate::modal::solve::restart::CONFIRMING;
use crate::optimize::Metric;
use ndarray::{Array1, s};
use rand::SeedableRng;
use rand_chacha::ChaCha12Rng;
use rand_distr::{Distribution, StandardNormal};

/// Differences of the objective up to which two fits have ended in one minimum; minima beyond it
/// are distinct.
const SAME: f64 = 25.0;
/// The same as a share of χ², which counts where the model does not explain the images.
const SAME_SHARE: f64 = 3e-3;
/// The turned wavefront is fitted where its objective, before the fit, is less than so many times
/// that of the best: the turned one of a twin has the same.
const SIMILAR: f64 = 4.0;
/// Standard deviations of χ² from which random starts are made: right minima are below 3.5, wrong
/// ones at 10 and more.
const SUSPICIOUS: f64 = 4.0;
/// Starts for each that `estimate.restarts` allows a fit of one image. Of five real images of a
/// bench in focus one random start in four ends in the best minimum.
const STARTS: usize = 4;
/// Eigenvalues of the modes' Gram matrix below this fraction of the largest are rounding.
const NULL_FLOOR: f64 = 1e-10;

/// The minima of a group.
#[derive(Debug, Clone, Copy, PartialEq)]
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

/// From how many starts a group is fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Search {
    /// The first.
    First,
    /// Further ones where the first does not explain the images: each of them determines the
    /// wavefront alone.
    IfNeeded,
    /// As many as it takes to know of other minima.
    All,
}

/// Fits the group from `near_nm`, or the flat wavefront, and further starts; the best minimum, in
/// which the images of the group are left.
///
/// # Errors
/// As [`Group::fit`].
pub(super) fn fit_from_all(
    group: &mut Group,
    (near_nm, search): (Option<&[f64]>, Search),
    control: &Control,
) -> Result<(Trial, Minima)> {
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
        Some(near_nm) => (near_nm, Freedom::Wavefront),
        None if search != Search::All => (&flat_nm[..], Freedom::Whole),
        None => (&flat_nm[..], Freedom::Minimum),
    };
    let mut trials = vec![group.fit(&from(first, 1.0), precision, silent)?];
    if search == Search::First || (search == Search::IfNeeded && is_right(&trials[0])) {
        let only = trials.swap_remove(0);
        let is_suspicious = !is_right(&only);
        return Ok((only, Minima { starts: 1, in_best: 1, next: None, has_twin: false, is_suspicious }));
    }
    if group.has_unknown_sign() && near_nm.is_none() {
        trials.push(group.fit(&from(&flat_nm, -1.0), Freedom::Minimum, silent)?);
    }
    let fitter = group.members[0].fitter;
    let mut random = Vec::new();
    for attempt in 1..=STARTS * fitter.recipe.restarts {
        let best = best_of(&trials);
        let found = random.iter().filter(|&&place: &&usize| is_same(&trials[place], &trials[best])).count();
        if is_right(&trials[best]) || found > CONFIRMING {
            break;
        }
        let mut start = random_wavefront(&group.prior.sigma_nm(), attempt);
        if attempt % 2 == 0 {
            start.iter_mut().zip(&trials[best].point).for_each(|(nm, best)| *nm += best);
        } else {
            random.push(trials.len());
        }
        let own = 1.0 + trials[best].amplitude(group);
        trials.push(group.fit(&from(&start, own), Freedom::Minimum, silent)?);
    }
    let best = best_of(&trials);
    let turned = turned(&fitter.model, &trials[best].point[..modes])?;
    let own = 1.0 + trials[best].amplitude(group);
    let signs = if group.has_unknown_sign() { vec![own, -own] } else { vec![own] };
    for sign in signs {
        let mut start = from(&turned, sign);
        // Tips and tilts are the same in the turned wavefront.
        let shared = group.unknowns.shared();
        start[shared..].copy_from_slice(&trials[best].point[shared..]);
        let [other, own] = [&start, &trials[best].point].map(|point| group.evaluate(point).0);
        if other < SIMILAR * own {
            trials.push(group.fit(&start, Freedom::Minimum, silent)?);
        }
    }
    let best = best_of(&trials);
    let (chi2, least) = (trials[best].chi2(), trials[best].objective());
    let others = trials.iter().map(|trial| trial.objective() - least);
    let alike = |&(place, trial): &(usize, &Trial)| place != best && trial.objective() - least < SAME;
    let others_alike: Vec<&Trial> = trials.iter().enumerate().filter(alike).map(|(_, trial)| trial).collect();
    let has_twin = !others_alike.is_empty() && {
        let information = group.information(&trials[best].point);
        others_alike.iter().any(|trial| {
            let off: Array1<f64> = trial.point.iter().zip(&trials[best].point).map(|(a, b)| a - b).collect();
            off.dot(&information.dot(&off)) > SAME.max(unknowns as f64) * SAME
        })
    };
    let minima = Minima {
        starts: trials.len(),
        in_best: in_minimum(&trials, best),
        next: others.filter(|off| *off >= SAME.max(SAME_SHARE * chi2)).reduce(f64::min),
        has_twin,
        is_suspicious: deviations(&trials[best]) >= SUSPICIOUS,
    };
    // The weights and the outlier pixels of the images are those of the last fit.
    let best = trials.swap_remove(best);
    let again = group.fit(&best.point, Freedom::Wavefront, silent)?;
    Ok((again, minima))
}

/// The trial with the smallest objective among those that converged, or among all.
fn best_of(trials: &[Trial]) -> usize {
    let key = |trial: &Trial| (!trial.has_converged(), trial.objective());
    let order = |a: &usize, b: &usize| {
        let ((stopped_a, a), (stopped_b, b)) = (key(&trials[*a]), key(&trials[*b]));
        stopped_a.cmp(&stopped_b).then(a.total_cmp(&b))
    };
    (0..trials.len()).min_by(order).unwrap_or(0)
}

/// Whether two trials ended in one minimum.
fn is_same(one: &Trial, other: &Trial) -> bool {
    (one.objective() - other.objective()).abs() < SAME.max(SAME_SHARE * other.chi2())
}

/// Number of trials in the minimum of the trial `best`.
fn in_minimum(trials: &[Trial], best: usize) -> usize {
    trials.iter().filter(|trial| is_same(trial, &trials[best])).count()
}

/// Whether the fit has converged, and noise explains χ² of all images.
pub(super) fn is_right(trial: &Trial) -> bool {
    trial.has_converged() && deviations(trial) < SUSPICIOUS
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

/// Coefficients of a random wavefront with the standard deviations `sigma_nm`, nm: the same for
/// every group.
fn random_wavefront(sigma_nm: &Array1<f64>, attempt: usize) -> Vec<f64> {
    let mut rng = ChaCha12Rng::seed_from_u64(attempt as u64);
    let normal = |sigma_nm: &f64| -> f64 {
        let unit: f64 = StandardNormal.sample(&mut rng);
        unit * sigma_nm
    };
    sigma_nm.iter().map(normal).collect()
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
