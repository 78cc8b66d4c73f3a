//! One point: a session's evaluations and fits, timed, and held against the truth and the f64 CPU chain.

use super::SetUp;
use super::floor::{Floor, Rates};
use super::grid::{Grid, ModelPlan, Variant, device_name};
use super::point::{Point, Spread};
use crate::Result;
use crate::estimate::{Estimator, FitOptions, Session, SessionOptions};
use crate::experiment::statistics::{median, rms};
use crate::experiment::{Case, Draw, Progress};
use crate::imaging::Chain;
use ndarray::Array2;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Points in the space of coefficients between which evaluations change, so that nothing can be reused.
const PLACES: usize = 4;
/// RMS of their coefficients, nm: within the capture range of every scene, and not flat.
const PLACE_NM: f64 = 40.0;
/// A timed round of evaluations lasts at least this long: a thousand times the clock's resolution.
const ROUND: Duration = Duration::from_millis(10);
/// Rounds of evaluations for each repeat of the fits, which take some fourteen times as long.
const ROUNDS: usize = 5;

/// What the f64 CPU chain says of each draw: the judge of every variant.
pub(super) struct Judge {
    /// The estimates, nm; `None` where a fit gave none.
    pub coefficients_nm: Vec<Option<Vec<f64>>>,
    /// Gradients at the first place, `[draw, mode]`, per nm.
    gradients: Array2<f64>,
}

impl Judge {
    pub fn new(case: &Case, draws: &[Draw]) -> Result<Self> {
        let options = SessionOptions { capacity: draws.len(), threads: 0, ..SessionOptions::default() };
        let mut session = Session::new(case.estimator.clone(), &options)?;
        write(&mut session, draws, 0, draws.len())?;
        session.load(draws.len(), None)?;
        let modes = case.estimator.model().optics.modes();
        let (mut objectives, mut gradients) = (vec![0.0; draws.len()], Array2::zeros((draws.len(), modes)));
        let at = place(0, draws.len(), modes);
        session.evaluate(at.view(), &mut objectives, gradients.as_slice_mut().unwrap_or_default())?;
        session.fit(draws.len(), &FitOptions::default())?;
        let coefficients_nm = (0..draws.len()).map(|image| fitted(&session, image)).collect();
        Ok(Self { coefficients_nm, gradients })
    }
}

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

fn open(estimator: &Arc<Estimator>, variant: &Variant) -> Result<Session> {
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

/// Writes `count` frames: the draws from number `first` on, over and over.
fn write(session: &mut Session, draws: &[Draw], first: usize, count: usize) -> Result<()> {
    for image in 0..count {
        let (mut frame_e, mut bad) = session.frame_mut(image)?;
        frame_e.assign(&draws[(first + image) % draws.len()].image_e);
        bad.fill(false);
    }
    Ok(())
}

/// Place `number` for each of `images`, `[image, mode]`, nm.
fn place(number: usize, images: usize, modes: usize) -> Array2<f64> {
    // Of unit variance, and no two images or modes alike.
    let value = |image: usize, mode: usize| ((7 * image + 3 * mode + 11 * number) as f64).sin() * 2f64.sqrt();
    Array2::from_shape_fn((images, modes), |(image, mode)| PLACE_NM * value(image, mode))
}

/// Times of one evaluation per image, and the largest deviation of a gradient from the judge's, as a fraction of that
/// gradient's largest element.
fn evaluations(
    session: &mut Session,
    set_up: &SetUp,
    variant: &Variant,
    grid: &Grid,
    draws: &[Draw],
    progress: &Progress,
) -> Result<(Spread, f64)> {
    let (batch, modes) = (variant.batch, session.estimator().model().optics.modes());
    write(session, draws, 0, batch)?;
    session.load(batch, None)?;
    let places: Vec<Array2<f64>> = (0..PLACES).map(|number| place(number, batch, modes)).collect();
    let (mut objectives, mut gradients) = (vec![0.0; batch], vec![0.0; batch * modes]);
    session.evaluate(places[0].view(), &mut objectives, &mut gradients)?;
    let error = |(found, judge): (&[f64], ndarray::ArrayView1<f64>)| {
        let largest = judge.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
        found.iter().zip(judge).fold(0.0, |worst: f64, (found, judge)| worst.max((found - judge).abs())) / largest
    };
    let gradient_error =
        gradients.chunks(modes).zip(set_up.judge.gradients.outer_iter()).map(error).fold(0.0, f64::max);
    let mut seconds = Vec::with_capacity(ROUNDS * grid.repeats);
    for _ in 0..ROUNDS * grid.repeats {
        progress.check()?;
        let (mut calls, started) = (0, Instant::now());
        while calls == 0 || started.elapsed() < ROUND {
            session.evaluate(places[calls % PLACES].view(), &mut objectives, &mut gradients)?;
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
    /// Largest RMS over the modes of the difference to the judge's estimate, nm.
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
        // The first fit touches memory, and on a device compiles for shapes that it has not seen: it is not timed.
        session.fit(batch, &options)?;
        for (image, draw) in draws[first..].iter().take(batch).enumerate() {
            let result = &session.results()[image].report;
            evaluations.push(result.evaluations as f64);
            let Some(found) = fitted(session, image) else { continue };
            chi2.push(result.reduced_chi2);
            for (all, one) in residuals_nm.iter_mut().zip(set_up.case.residuals_nm(&found, draw)?) {
                all.push(one);
            }
            if let Some(judge) = &set_up.judge.coefficients_nm[first + image] {
                let off: Vec<f64> = found.iter().zip(judge).map(|(found, judge)| found - judge).collect();
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

/// The estimate of an image of the last fit, nm; `None` where the image could not be used.
fn fitted(session: &Session, image: usize) -> Option<Vec<f64>> {
    let found = &session.results()[image].coefficients_nm;
    found.iter().all(|nm| nm.is_finite()).then(|| found.clone())
}
