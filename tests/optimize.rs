//! The optimisers on functions whose minimum is known, and on a small phase retrieval.

#[path = "optimize/problems.rs"]
mod problems;

use cophase::control::CancelFlag;
use cophase::optimize::{
    Advance, ArgminBfgs, Metric, Objective, Outcome, QuasiNewton, RESOLUTION_F32, Scaling, Settings, StopReason,
    minimize,
};
use cophase::{Error, Result};
use ndarray::Array2;
use problems::{Quadratic, Retrieval, rosenbrock};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// χ² of the 256 noisy pixels at the right minimum: 256 ± 23, and weights from the data add some; a
/// wrong minimum has thousands.
const GOOD_CHI2: f64 = 400.0;

/// The reference with both tolerances equal to `tolerance`, from the identity as the inverse
/// Hessian.
fn argmin_bfgs(problem: &mut Objective, start: &[f64], tolerance: f64, max_evaluations: usize) -> Result<Outcome> {
    let reference = ArgminBfgs {
        gradient_tolerance: tolerance,
        cost_tolerance: tolerance,
        initial_scale: 1.0,
        max_evaluations,
        cancel: None,
    };
    reference.minimize(problem, start)
}

fn whitened(h: &Array2<f64>) -> Arc<Metric> {
    Arc::new(Metric::from_gauss_newton(h, 1e-12).unwrap())
}

fn identity(n: usize) -> Arc<Metric> {
    Arc::new(Metric::identity(n))
}

/// Stops where the predicted decrease of χ² is 1e-3.
fn chi2_settings() -> Settings {
    Settings {
        max_evaluations: 1000,
        decrement_tolerance: 1e-3,
        relative_decrement_tolerance: 0.0,
        ..Settings::default()
    }
}

fn retrieve(toy: &Retrieval, metric: Arc<Metric>, settings: Settings) -> Outcome {
    minimize(&mut |c: &[f64]| Ok(toy.evaluate(c)), metric, &vec![0.0; toy.len()], settings).unwrap()
}

// --- Convergence

#[test]
fn rosenbrock_is_minimised_from_the_usual_start() {
    for n in [2, 10] {
        let start: Vec<f64> = (0..n).map(|i| if i % 2 == 0 { -1.2 } else { 1.0 }).collect();
        let settings =
            Settings { decrement_tolerance: 1e-20, relative_decrement_tolerance: 0.0, ..Settings::default() };
        let out = minimize(&mut |x| rosenbrock(x), identity(n), &start, settings).unwrap();
        let error = out.x.iter().fold(0.0_f64, |m, x| m.max((x - 1.0).abs()));
        println!("Rosenbrock {n}: {} evaluations, error {error:e}: {}", out.evaluations, out.reason);
        assert!(out.reason.has_converged(), "{}", out.reason);
        // A decrement of 1e-20 with the smallest curvature near 0.4 leaves sqrt(2·1e-20/0.4) =
        // 2e-10; the model's curvature may be a hundred times off in the valley.
        assert!(error < 2e-8, "{error:e}");
        assert!(out.evaluations < 100, "{}", out.evaluations);
    }
}

#[test]
fn an_exact_metric_solves_any_quadratic_in_three_evaluations() {
    for (n, condition) in [(1, 1.0), (5, 1e2), (40, 1e4)] {
        let q = Quadratic::new(n, condition, 3);
        let settings = Settings { step_tolerance: 1e-3, relative_decrement_tolerance: 0.0, ..Settings::default() };
        let out =
            minimize(&mut |x: &[f64]| Ok(q.evaluate(x)), whitened(&q.gauss_newton()), &vec![0.0; n], settings).unwrap();
        println!(
            "n {n}, condition {condition:e}: {} evaluations, error {:e}",
            out.evaluations,
            q.largest_error(&out.x)
        );
        assert!(out.reason.has_converged(), "{}", out.reason);
        assert!(out.evaluations <= 3, "{}", out.evaluations);
        // The step left is the error left; 1e-3 is what was asked for.
        assert!(q.largest_error(&out.x) < 1e-3);
    }
}

#[test]
fn many_small_components_of_a_step_add_up() {
    // In a hundred directions the model assumes four times the curvature of the parabola: each step
    // goes a quarter of the way in all of them, and its RMS over the hundred is ten times its
    // largest component.
    let mut parabola =
        |x: &[f64]| Ok((0.25 * x.iter().map(|x| x * x).sum::<f64>(), x.iter().map(|x| 0.5 * x).collect()));
    let largest = Settings {
        step_tolerance: 1.0,
        relative_decrement_tolerance: 0.0,
        memory: 0,
        scaling: Scaling::Metric,
        ..Settings::default()
    };
    let weighted = Settings { step_weights: Some(vec![1.0; 100].into()), ..largest.clone() };
    let mut end = |settings: Settings| {
        let out = minimize(&mut parabola, Arc::new(Metric::whitened(100)), &[100.0; 100], settings).unwrap();
        assert_eq!(out.reason, StopReason::StepBelowTolerance);
        out.x[0]
    };
    // A step of a component is a quarter of it: the first below 1, and the first below 0.1, from
    // within a factor of 3/4.
    let (alone, together) = (end(largest), end(weighted.clone()));
    assert!(alone < 4.0 && alone > 3.0 * 0.75, "{alone}");
    assert!(together < 0.4 && together > 0.3 * 0.75, "{together}");
    for (weights, reason) in [(vec![1.0; 99], "99 step weights"), (vec![f64::NAN; 100], "a step weight is NaN")] {
        let wrong = Settings { step_weights: Some(weights.into()), ..weighted.clone() };
        let error = minimize(&mut parabola, Arc::new(Metric::whitened(100)), &[1.0; 100], wrong).unwrap_err();
        assert!(error.to_string().contains(reason), "{error}");
    }
}

#[test]
fn the_metric_saves_most_evaluations_of_a_phase_retrieval() {
    for (rms_rad, saving) in [(0.3, 2.5), (0.6, 1.8), (1.2, 1.3)] {
        let (mut with, mut fixed, mut without) = (0, 0, 0);
        let mut right = 0;
        for seed in 0..16 {
            let toy = Retrieval::new(rms_rad, seed);
            let metric = whitened(&toy.gauss_newton());
            let out = retrieve(&toy, metric.clone(), chi2_settings());
            assert!(out.reason.has_converged(), "{}", out.reason);
            right += usize::from(out.f < GOOD_CHI2);
            with += out.evaluations;
            fixed += retrieve(&toy, metric, Settings { scaling: Scaling::Metric, ..chi2_settings() }).evaluations;
            without += retrieve(&toy, identity(toy.len()), chi2_settings()).evaluations;
        }
        let mean = |sum: usize| sum as f64 / 16.0;
        println!(
            "{rms_rad} rad: {:.1} evaluations ({:.1} with the metric's own scale, {:.1} without a metric), {right}/16",
            mean(with),
            mean(fixed),
            mean(without)
        );
        assert!(saving * mean(with) < mean(without));
        // The capture range is finite: at 1.2 rad one of sixteen ends elsewhere.
        assert!(right >= 15, "{right} of 16");
    }
}

#[test]
fn a_new_weighting_continues_where_the_old_one_ended() {
    let mut toy = Retrieval::new(0.6, 1);
    let metric = whitened(&toy.gauss_newton());
    let mut machine = QuasiNewton::new(metric.clone(), &vec![0.0; toy.len()], chi2_settings()).unwrap();
    let run = |toy: &Retrieval, machine: &mut QuasiNewton| loop {
        let (f, g) = toy.evaluate(machine.point());
        if machine.advance(f, &g) == Advance::Done {
            break machine.outcome().evaluations;
        }
    };
    let first = run(&toy, &mut machine);
    // The solution is lower than the last evaluated point, by the predicted decrease within a
    // factor of 2.
    let mut end = vec![0.0; toy.len()];
    machine.write_solution(&mut end);
    let gained = machine.outcome().f - toy.evaluate(&end).0;
    let predicted = machine.outcome().predicted_decrease;
    assert!((gained - predicted).abs() < 0.5 * predicted, "{gained} of {predicted}");
    toy.reweight(&machine.outcome().x.clone());
    assert_eq!(machine.restart_objective(), Advance::Continue);
    // It continues from the end of the step that was too small to be worth an evaluation.
    let outcome = machine.outcome();
    let moved = machine.point().iter().zip(&outcome.x).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    // The step's largest component, to the rounding of a sum of numbers of order one.
    assert!((moved - outcome.proposed_step).abs() < 1e-12 && moved > 0.0, "{moved} {}", outcome.proposed_step);
    let second = run(&toy, &mut machine) - first;
    let scratch = retrieve(&toy, metric, chi2_settings());
    println!("{first} evaluations, then {second}; {} from scratch", scratch.evaluations);
    assert!(machine.outcome().reason.has_converged());
    // 5 evaluations after the first 9, compared with 9 from the start.
    assert!(3 * second < 2 * scratch.evaluations);
    // Both stop within about their decrement of 1e-3 above the same minimum.
    assert!((machine.outcome().f - scratch.f).abs() < 2e-3, "{} {}", machine.outcome().f, scratch.f);
}

#[test]
fn batch_in_lock_step_has_the_bits_of_single_runs() {
    let toys: Vec<_> = (0..6).map(|seed| Retrieval::new(0.9, seed)).collect();
    let metric = whitened(&toys[0].gauss_newton());
    let alone: Vec<_> = toys.iter().map(|toy| retrieve(toy, metric.clone(), chi2_settings())).collect();
    let start = vec![0.0; toys[0].len()];
    let mut batch: Vec<_> =
        toys.iter().map(|_| QuasiNewton::new(metric.clone(), &start, chi2_settings()).unwrap()).collect();
    loop {
        // One call for all; those that are done are evaluated too, without effect.
        let answers: Vec<_> = toys.iter().zip(&batch).map(|(toy, machine)| toy.evaluate(machine.point())).collect();
        let done =
            batch.iter_mut().zip(&answers).filter_map(|(m, (f, g))| (m.advance(*f, g) == Advance::Done).then_some(()));
        if done.count() == toys.len() {
            break;
        }
    }
    for (alone, machine) in alone.iter().zip(&batch) {
        let together = machine.outcome();
        let bits = |x: &[f64]| x.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&alone.x), bits(&together.x));
        assert_eq!(alone.f.to_bits(), together.f.to_bits());
        assert_eq!((alone.evaluations, alone.reason), (together.evaluations, together.reason));
    }
}

#[test]
fn an_optimiser_restarted_with_begin_is_bitwise_a_new_one() {
    let toys: Vec<_> = (0..3).map(|seed| Retrieval::new(0.9, seed)).collect();
    let metric = whitened(&toys[0].gauss_newton());
    let start = vec![0.0; toys[0].len()];
    let mut machine = QuasiNewton::new(metric.clone(), &start, chi2_settings()).unwrap();
    for toy in &toys {
        machine.begin(&metric, 1.0, &start).unwrap();
        while {
            let (f, g) = toy.evaluate(machine.point());
            machine.advance(f, &g) == Advance::Continue
        } {}
        let alone = retrieve(toy, metric.clone(), chi2_settings());
        let (x, y) = (&alone.x, &machine.outcome().x);
        assert!(x.iter().zip(y).all(|(x, y)| x.to_bits() == y.to_bits()));
        assert_eq!((alone.evaluations, alone.reason), (machine.outcome().evaluations, machine.outcome().reason));
    }
    assert!(machine.begin(&metric, 0.0, &start).unwrap_err().to_string().contains("scale of the metric is 0"));
    assert!(machine.begin(&identity(2), 1.0, &[0.0; 2]).unwrap_err().to_string().contains("2 dimensions"));
    assert!(machine.begin(&metric, 1.0, &[0.0]).unwrap_err().to_string().contains("1 components"));
}

#[test]
fn a_scale_replaces_a_scaled_metric() {
    // Sixteen times as curved: every length in whitened coordinates is a quarter, exactly so in
    // binary.
    let q = Quadratic::new(12, 1e3, 4);
    let metric = whitened(&q.gauss_newton());
    let settings = Settings { step_tolerance: 1e-3, relative_decrement_tolerance: 0.0, ..Settings::default() };
    let mut machine = QuasiNewton::new(metric.clone(), &[0.0; 12], settings).unwrap();
    machine.begin(&metric, 0.25, &[0.0; 12]).unwrap();
    while {
        let (f, g) = q.evaluate(machine.point());
        let g: Vec<f64> = g.iter().map(|g| 16.0 * g).collect();
        machine.advance(16.0 * f, &g) == Advance::Continue
    } {}
    // As with an exact metric: the start, the minimum, and the evaluation that confirms it.
    assert!(machine.outcome().evaluations <= 3, "{}", machine.outcome().evaluations);
}

#[test]
fn deadline_ends_a_run_at_the_best_point_without_a_restart() {
    let toy = Retrieval::new(0.9, 1);
    let metric = whitened(&toy.gauss_newton());
    let start = vec![0.0; toy.len()];
    let settings = Settings { deadline: Some(Instant::now()), ..chi2_settings() };
    let mut machine = QuasiNewton::new(metric, &start, settings).unwrap();
    let (f, g) = toy.evaluate(machine.point());
    assert_eq!(machine.advance(f, &g), Advance::Done);
    assert_eq!((machine.outcome().reason, machine.outcome().evaluations), (StopReason::DeadlineReached, 1));
    assert!(!machine.outcome().reason.has_converged());
    assert_eq!(machine.restart_objective(), Advance::Done);
    machine.set_deadline(None);
    assert_eq!(machine.restart_objective(), Advance::Continue);
}

// --- The metric

/// An objective that does not depend on the sum of x and on x₀ − x₁: a quadratic, the projection,
/// and the null directions.
fn blind(n: usize) -> (Quadratic, Array2<f64>, [Vec<f64>; 2]) {
    let q = Quadratic::new(n, 10.0, 5);
    let unit = |v: Vec<f64>| {
        let norm = v.iter().map(|v| v * v).sum::<f64>().sqrt();
        v.into_iter().map(|v| v / norm).collect::<Vec<_>>()
    };
    let null = [unit(vec![1.0; n]), unit((0..n).map(|i| [1.0, -1.0].get(i).copied().unwrap_or(0.0)).collect())];
    let mut seen = Array2::<f64>::eye(n);
    for v in &null {
        seen = seen - Array2::from_shape_fn((n, n), |(i, j)| v[i] * v[j]);
    }
    (q, seen, null)
}

#[test]
fn null_directions_are_never_moved() {
    let n = 12;
    let (q, seen, null) = blind(n);
    let h = seen.dot(&q.gauss_newton()).dot(&seen);
    let metric = whitened(&(0.5 * (&h + &h.t())));
    assert_eq!((metric.rank(), metric.dimension()), (n - 2, n));
    let project = |x: &[f64]| seen.dot(&ndarray::ArrayView1::from(x)).to_vec();
    let start: Vec<f64> = (0..n).map(|i| 30.0 + 7.0 * i as f64).collect();
    let mut problem = |x: &[f64]| {
        let (f, g) = q.evaluate(&project(x));
        Ok((f, project(&g)))
    };
    let settings = Settings { step_tolerance: 1e-6, ..Settings::default() };
    let out = minimize(&mut problem, metric, &start, settings).unwrap();
    assert!(out.reason.has_converged() && out.evaluations <= 3, "{} after {}", out.reason, out.evaluations);
    let travelled = out.x.iter().zip(&start).map(|(x, s)| (x - s).powi(2)).sum::<f64>().sqrt();
    assert!(travelled > 10.0, "the other directions must move: {travelled}");
    for v in &null {
        let moved: f64 = v.iter().zip(out.x.iter().zip(&start)).map(|(v, (x, s))| v * (x - s)).sum();
        // Rounding of V over a travel of a few hundred: the eigenvectors are orthogonal to some 10
        // epsilon, 1e-15·1e3.
        assert!(moved.abs() < 1e-11, "{moved:e}");
    }
}

#[test]
fn settings_and_starts_out_of_range_are_refused_with_a_sentence() {
    let refuse = |start: &[f64], settings: Settings| QuasiNewton::new(identity(2), start, settings).unwrap_err();
    assert!(matches!(refuse(&[0.0], Settings::default()), Error::Shape(_)));
    assert!(refuse(&[0.0, f64::NAN], Settings::default()).to_string().contains("component 1"));
    let bad = Settings { step_tolerance: -1.0, ..Settings::default() };
    assert!(refuse(&[0.0, 0.0], bad).to_string().contains("step_tolerance is -1"));
    let bad = Settings { max_step: 0.0, ..Settings::default() };
    assert!(refuse(&[0.0, 0.0], bad).to_string().contains("max_step is 0"));
    let bad = Settings { max_evaluations: 0, ..Settings::default() };
    assert!(refuse(&[0.0, 0.0], bad).to_string().contains("max_evaluations"));
    let mut short = |_: &[f64]| Ok((0.0, vec![0.0]));
    assert!(matches!(minimize(&mut short, identity(2), &[0.0; 2], Settings::default()), Err(Error::Shape(_))));
    assert!(matches!(argmin_bfgs(&mut short, &[0.0; 2], 1e-6, 10), Err(Error::Shape(_))));
    assert!(argmin_bfgs(&mut short, &[0.0; 2], -1.0, 10).unwrap_err().to_string().contains("gradient_tolerance is -1"));
}

// --- Stopping

#[test]
fn in_f32_it_stops_where_the_objective_no_longer_resolves() {
    let n = 20;
    let mut q = Quadratic::new(n, 30.0, 11);
    q.floor = 1e4;
    let exact = q.gauss_newton();
    let rough = &exact + &(0.3 * Array2::from_diag(&exact.diag()));
    // Only the resolution of the objective can stop the run.
    let bare = |resolution| Settings { relative_decrement_tolerance: 0.0, resolution, ..Settings::default() };
    for (name, metric, most, bound) in [
        ("exact metric", whitened(&exact), 4, 1e-2),
        ("rough metric", whitened(&rough), 12, 1e-2),
        ("no metric", identity(n), 120, 1.0),
    ] {
        let mut problem = |x: &[f64]| Ok(q.evaluate_f32(x));
        let out = minimize(&mut problem, metric.clone(), &vec![0.0; n], bare(RESOLUTION_F32)).unwrap();
        let blind = minimize(&mut problem, metric, &vec![0.0; n], bare(0.0)).unwrap();
        let (left, _) = q.evaluate(&out.x);
        println!(
            "{name}: {} evaluations, {:e} left; {} with resolution 0: {}",
            out.evaluations,
            left - 1e4,
            blind.evaluations,
            blind.reason
        );
        assert_eq!(out.reason, StopReason::ResolutionReached);
        assert!(out.evaluations <= most && out.evaluations <= blind.evaluations, "{}", out.evaluations);
        // Below the resolution of 1e-6 of 1e4 with a metric; without one the model consists of
        // twenty pairs, and its prediction may be wrong by a factor of a hundred.
        assert!(left - 1e4 < bound, "{:e}", left - 1e4);
    }
}

#[test]
fn the_search_backs_out_of_regions_that_are_not_finite() {
    // x − ln x, NaN for x < 0; the metric's curvature of 0.01 overshoots to −30.
    let mut problem = |x: &[f64]| Ok((x[0] - x[0].ln(), vec![if x[0] > 0.0 { 1.0 - 1.0 / x[0] } else { f64::NAN }]));
    let metric = whitened(&ndarray::array![[0.01]]);
    let settings = Settings { decrement_tolerance: 1e-16, ..Settings::default() };
    let out = minimize(&mut problem, metric.clone(), &[3.0], settings).unwrap();
    // f = 1 near the minimum, where the relative decrement tolerance of 1e-10 leaves sqrt(2e-10) =
    // 1.4e-5.
    assert!(out.reason.has_converged() && (out.x[0] - 1.0).abs() < 2e-5, "{} at {}", out.reason, out.x[0]);
    let out = minimize(&mut problem, metric.clone(), &[-1.0], Settings::default()).unwrap();
    assert_eq!((out.reason, out.evaluations), (StopReason::NotFinite, 1));
    // Finite at the start only: the start is returned after the 30 halvings from 1 to 1e-9.
    let mut point = |x: &[f64]| Ok((if x[0] == 3.0 { 1.0 } else { f64::INFINITY }, vec![1.0]));
    let out = minimize(&mut point, metric, &[3.0], Settings::default()).unwrap();
    assert_eq!((out.reason, out.evaluations, out.x[0], out.f), (StopReason::NotFinite, 32, 3.0, 1.0));
}

#[test]
fn a_gradient_of_the_wrong_sign_is_detected() {
    let mut problem = |x: &[f64]| Ok((x[0] * x[0], vec![-2.0 * x[0]]));
    let out = minimize(&mut problem, identity(1), &[1.0], Settings::default()).unwrap();
    assert_eq!(out.reason, StopReason::NoDescent);
    // The start, ten steps back, and the last point.
    assert!(out.evaluations <= 12 && out.x == [1.0], "{}", out.evaluations);
}

#[test]
fn a_start_at_the_minimum_stays_there() {
    let q = Quadratic::new(3, 2.0, 1);
    for metric in [identity(3), whitened(&q.gauss_newton())] {
        let start = q.truth.to_vec();
        let out = minimize(&mut |x: &[f64]| Ok(q.evaluate(x)), metric, &start, Settings::default()).unwrap();
        assert_eq!((out.reason, out.evaluations), (StopReason::DecrementBelowTolerance, 1));
        assert_eq!(out.x, start);
    }
}

#[test]
fn the_limits_of_evaluations_and_of_steps_hold() {
    let settings = Settings { max_evaluations: 7, max_step: 0.05, ..Settings::default() };
    let start = [-1.2, 1.0];
    let mut evaluated = Vec::new();
    let out = minimize(
        &mut |x: &[f64]| {
            evaluated.push(x.to_vec());
            rosenbrock(x)
        },
        identity(2),
        &start,
        settings,
    )
    .unwrap();
    assert_eq!((out.reason, out.evaluations, evaluated.len()), (StopReason::EvaluationLimit, 7, 7));
    let values: Vec<f64> = evaluated.iter().map(|x| rosenbrock(x).unwrap().0).collect();
    assert_eq!(out.f, values.iter().copied().fold(f64::INFINITY, f64::min), "the best of {values:?}");
    assert_eq!(out.f, rosenbrock(&out.x).unwrap().0);
    for pair in evaluated.windows(2) {
        let step = pair[0].iter().zip(&pair[1]).fold(0.0_f64, |m, (a, b)| m.max((a - b).abs()));
        // Each of these was accepted, so each step starts from the one before; one rounding of 1.2.
        assert!(step <= 0.05 + 3e-16, "{step}");
    }
}

#[test]
fn the_cancel_flag_ends_either_optimiser_within_one_evaluation() {
    let flag: CancelFlag = Arc::new(AtomicBool::new(false));
    let count = Cell::new(0);
    let mut problem = |x: &[f64]| {
        count.set(count.get() + 1);
        flag.store(count.get() == 5, Ordering::Relaxed);
        rosenbrock(x)
    };
    let settings = Settings { cancel: Some(flag.clone()), ..Settings::default() };
    let out = minimize(&mut problem, identity(2), &[-1.2, 1.0], settings).unwrap();
    assert_eq!((out.reason, out.evaluations), (StopReason::Cancelled, 5));
    count.set(0);
    flag.store(false, Ordering::Relaxed);
    let reference = ArgminBfgs {
        gradient_tolerance: 1e-6,
        cost_tolerance: 1e-6,
        initial_scale: 1.0,
        max_evaluations: 100,
        cancel: Some(flag.clone()),
    };
    let out = reference.minimize(&mut problem, &[-1.2, 1.0]).unwrap();
    assert_eq!((out.reason, out.evaluations), (StopReason::Cancelled, 5));
    assert!(out.f <= rosenbrock(&[-1.2, 1.0]).unwrap().0);
}

// --- The reference

#[test]
fn the_reference_minimises_quadratics_and_rosenbrock() {
    let q = Quadratic::new(8, 3.0, 2);
    let count = Cell::new(0);
    let mut problem = |x: &[f64]| {
        count.set(count.get() + 1);
        Ok(q.evaluate(x))
    };
    let out = argmin_bfgs(&mut problem, &[0.0; 8], 1e-6, 200).unwrap();
    println!("quadratic: {} evaluations, error {:e}: {}", out.evaluations, q.largest_error(&out.x), out.reason);
    assert!(out.reason.has_converged(), "{}", out.reason);
    assert_eq!(out.evaluations, count.get(), "one evaluation serves value and gradient");
    // A change below 1e-6 leaves about as much in J, with curvatures of 0.5 and more:
    // sqrt(1e-6/0.25), five times.
    assert!(q.largest_error(&out.x) < 1e-2);
    let out = argmin_bfgs(&mut |x| rosenbrock(x), &[-1.2, 1.0], 1e-6, 200).unwrap();
    println!("Rosenbrock: {} evaluations at {:?}: {}", out.evaluations, out.x, out.reason);
    // The same with the smallest curvature 0.4 of Rosenbrock's valley.
    assert!(out.reason.has_converged() && out.x.iter().all(|x| (x - 1.0).abs() < 1e-2));
}

#[test]
fn the_reference_ends_with_a_reason_and_the_best_point() {
    let mut q = Quadratic::new(6, 10.0, 4);
    q.floor = 1e3;
    // No tolerance can be met in f32: the run must end with a reason and at the minimum.
    let out = argmin_bfgs(&mut |x: &[f64]| Ok(q.evaluate_f32(x)), &[0.0; 6], 0.0, 500).unwrap();
    println!("f32: {} evaluations: {}", out.evaluations, out.reason);
    assert!(matches!(out.reason, StopReason::NoDescent | StopReason::EvaluationLimit | StopReason::NotFinite));
    // Some roundings (6e-8 each) of f = 1e3.
    assert!(q.evaluate(&out.x).0 - 1e3 < 1e-2, "{:e}", q.evaluate(&out.x).0 - 1e3);
    let out = argmin_bfgs(&mut |x| rosenbrock(x), &[-1.2, 1.0], 1e-6, 4).unwrap();
    assert_eq!((out.reason, out.evaluations), (StopReason::EvaluationLimit, 4));
    let mut nan = |x: &[f64]| Ok((if x[0] < 0.5 { f64::NAN } else { x[0] }, vec![1.0]));
    let out = argmin_bfgs(&mut nan, &[1.0], 1e-6, 100).unwrap();
    assert_eq!((out.reason, out.x[0]), (StopReason::NotFinite, 1.0));
    let out = argmin_bfgs(&mut |x| rosenbrock(x), &[1.0, 1.0], 1e-6, 4).unwrap();
    assert_eq!((out.reason, out.evaluations), (StopReason::GradientBelowTolerance, 1));
    let mut broken = |_: &[f64]| -> Result<(f64, Vec<f64>)> { Err(Error::Device("the device is gone".into())) };
    assert!(matches!(argmin_bfgs(&mut broken, &[1.0], 1e-6, 4), Err(Error::Device(_))));
}

// --- Allocation

thread_local! {
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

/// Counts what each thread allocates.
struct Counting;

// SAFETY: every call goes to the system's allocator as it came; the counter is a
// constant-initialised thread local without a destructor, which neither allocates nor unwinds.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.with(|n| n.set(n.get() + 1));
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn nothing_is_allocated_after_construction() {
    let toy = Retrieval::new(1.2, 7);
    let settings = Settings { memory: 3, ..chi2_settings() };
    let mut machine = QuasiNewton::new(whitened(&toy.gauss_newton()), &vec![0.0; toy.len()], settings).unwrap();
    let mut allocated = 0;
    for _ in 0..40 {
        let (f, g) = toy.evaluate(machine.point());
        let before = ALLOCATIONS.with(Cell::get);
        let progress = machine.advance(f, &g);
        allocated += ALLOCATIONS.with(Cell::get) - before;
        if progress == Advance::Done {
            break;
        }
    }
    assert!(ALLOCATIONS.with(Cell::get) > 0 && machine.outcome().evaluations > 10);
    assert_eq!(allocated, 0);
}
