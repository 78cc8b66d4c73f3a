//! One point: a session's evaluations and fits, timed, and held against the truth and the f64 CPU
//! chain.

use super::floor::{Floor, Rates};
use super::grid::{Grid, ModelPlan, Variant, device_name};
use super::point::{Point, Spread};
use super::reference::{fitted, place, write};
use super::set_up::SetUp;
use crate::experiment::statistics::{median, rms};
use crate::experiment::{Draw, Progress};
use cophase::Result;
use cophase::imaging::Chain;
use cophase::modal::{FitOptions, ModalFitter, Session, SessionOptions};
use ndarray::Array2;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Points in the space of coefficients between which evaluations change, so that nothing can be
/// reused.
const PLACES: usize = 4;
/// A timed round of evaluations lasts at least this long: a thousand times the clock's resolution.
const ROUND: Duration = Duration::from_millis(10);
/// Rounds of evaluations for each repeat of the fits, which take some fourteen times as long.
const ROUNDS: usize = 5;

/// Measures `variant` of a model.
pub(super) fn point(
    set_up: &SetUp,
    model: &ModelPlan,
    variant: &Variant,
    grid: &Grid,
    draws: &[Draw],
    progress: &Progress,
) -> Result<Point> {
    let estimator = &set_up.case.estimator;
    let started = Instant::now();
    let mut session = open(estimator, variant)?;
    let set_up_s = started.elapsed().as_secs_f64();
    let (evaluation, gradient_error) = evaluations(&mut session, set_up, variant, grid, draws, progress)?;
    let fits = fits(&mut session, set_up, variant, grid, draws, progress)?;
    let optics = &estimator.model().optics;
    let &Variant { device, precision, batch } = variant;
    let work = Chain::open(optics.clone(), device, precision, 1)?.shapes().work(precision, batch);
    let peak = Rates::of(device, precision, batch, work.bytes * batch as f64)?;
    Ok(Point {
        device: device_name(variant.device),
        precision: variant.precision,
        samples: optics.sampling().samples,
        pixels: estimator.model().preparation.pixels,
        budget_nm: model.budget_nm,
        cropped: matches!(model.crop, super::Crop::Pixels(_)),
        optimizer: model.optimizer.word(),
        modes: optics.modes(),
        batch: variant.batch,
        images: draws.len(),
        evaluation,
        estimate: fits.times,
        evaluations: fits.evaluations,
        phasing_nm: fits.residuals_nm[0],
        ncpa_nm: fits.residuals_nm[1],
        bound_nm: set_up.bound_nm,
        fitted: fits.fitted,
        reduced_chi2: fits.reduced_chi2,
        work,
        peak,
        floor: Floor::of(work, peak),
        model_set_up_s: set_up.seconds,
        session_set_up_s: set_up_s,
        gradient_error,
        estimate_error_nm: fits.estimate_error_nm,
    })
}

fn open(estimator: &Arc<ModalFitter>, variant: &Variant) -> Result<Session> {
    let &Variant { device, precision, batch } = variant;
    Session::new(
        estimator.clone(),
        &SessionOptions {
            capacity: batch,
            precision: Some(precision),
            device: Some(device),
            threads: 0,
            ..Default::default()
        },
    )
}

/// Times of one evaluation per image, and the largest deviation of a gradient from the reference's,
/// as a fraction of that gradient's largest element.
fn evaluations(
    session: &mut Session,
    set_up: &SetUp,
    variant: &Variant,
    grid: &Grid,
    draws: &[Draw],
    progress: &Progress,
) -> Result<(Spread, f64)> {
    let (batch, modes) = (variant.batch, session.fitters().first().model().optics.modes());
    write(session, draws, 0, batch)?;
    session.load(0, batch, None)?;
    let places: Vec<Array2<f64>> = (0..PLACES).map(|number| place(number, batch, modes)).collect();
    let (mut objectives, mut gradients) = (vec![0.0; batch], vec![0.0; batch * modes]);
    session.evaluate(0, places[0].view(), &mut objectives, &mut gradients)?;
    let error = |(found, reference): (&[f64], ndarray::ArrayView1<f64>)| {
        let largest = reference.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
        found.iter().zip(reference).fold(0.0, |worst: f64, (found, reference)| worst.max((found - reference).abs()))
            / largest
    };
    let gradient_error =
        gradients.chunks(modes).zip(set_up.reference.gradients.outer_iter()).map(error).fold(0.0, f64::max);
    let mut seconds = Vec::with_capacity(ROUNDS * grid.repeats);
    for _ in 0..ROUNDS * grid.repeats {
        progress.check()?;
        let (mut calls, started) = (0, Instant::now());
        while calls == 0 || started.elapsed() < ROUND {
            session.evaluate(0, places[calls % PLACES].view(), &mut objectives, &mut gradients)?;
            calls += 1;
        }
        seconds.push(started.elapsed().as_secs_f64() / (calls * batch) as f64);
    }
    Ok((Spread::of(&seconds), gradient_error))
}

/// What the fits of a point say.
struct Fits {
    times: Spread,
    /// Median.
    evaluations: f64,
    /// Root of the mean square over the draws: segment errors and NCPA, nm.
    residuals_nm: [f64; 2],
    /// Draws with an estimate.
    fitted: usize,
    /// Median.
    reduced_chi2: f64,
    /// Largest RMS over the modes of the difference to the reference's estimate, nm.
    estimate_error_nm: f64,
}

/// Fits every draw `grid.repeats` times, in batches.
fn fits(
    session: &mut Session,
    set_up: &SetUp,
    variant: &Variant,
    grid: &Grid,
    draws: &[Draw],
    progress: &Progress,
) -> Result<Fits> {
    let batch = variant.batch;
    let options = FitOptions::default();
    let mut seconds = Vec::new();
    let mut residuals_nm = [Vec::new(), Vec::new()];
    let (mut evaluations, mut chi2, mut errors_nm) = (Vec::new(), Vec::new(), Vec::new());
    for first in (0..draws.len()).step_by(batch) {
        write(session, draws, first, batch)?;
        // The first fit touches memory, and on a device compiles for shapes that it has not seen:
        // it is not timed.
        session.fit(batch, &options)?;
        for (image, draw) in draws[first..].iter().take(batch).enumerate() {
            let result = &session.channels()[0].results()[image].report;
            evaluations.push(result.evaluations as f64);
            let Some(found) = fitted(session, image) else { continue };
            chi2.push(result.reduced_chi2);
            for (all, one) in residuals_nm.iter_mut().zip(set_up.case.residuals_nm(&found, draw)?) {
                all.push(one);
            }
            if let Some(reference) = &set_up.reference.coefficients_nm[first + image] {
                let off: Vec<f64> = found.iter().zip(reference).map(|(found, reference)| found - reference).collect();
                errors_nm.push(rms(&off));
            }
        }
        for _ in 0..grid.repeats {
            progress.check()?;
            let started = Instant::now();
            session.fit(batch, &options)?;
            seconds.push(started.elapsed().as_secs_f64() / batch as f64);
        }
    }
    Ok(Fits {
        times: Spread::of(&seconds),
        evaluations: median(&evaluations),
        fitted: chi2.len(),
        residuals_nm: residuals_nm.map(|all| rms(&all)),
        reduced_chi2: median(&chi2),
        estimate_error_nm: errors_nm.into_iter().fold(0.0, f64::max),
    })
}
