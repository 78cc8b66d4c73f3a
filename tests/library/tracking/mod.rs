//! Tracking: the filter against closed formulas, rates and alarms against simulated nights.

mod applied;
mod corrections;
mod pointing;
mod walk;

use cophase::Error;
use cophase::tracking::{NIGHT_S, TimedEstimate, Tracker, TrackerSettings, TrackerVerdict, change_threshold};
use ndarray::{Array1, Array2};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use walk::{INTERVAL_S, Walk, settings};

/// The variance of a random walk that gains `q` between observations of variance `r`, in the steady
/// state after an observation: the positive root of the Riccati equation p² = q·(p + r) for the
/// variance p before it, less q (Kalman 1960).
fn steady_variance(q: f64, r: f64) -> f64 {
    0.5 * (q + (q * q + 4.0 * q * r).sqrt()) - q
}

#[test]
fn the_steady_state_is_that_of_the_riccati_equation() {
    let (rate, r) = (30.0, 4.0);
    let walk = Walk::white(12, 5, r);
    let settings = TrackerSettings {
        drift_segments_nm_per_sqrt_hour: Some(rate),
        drift_ncpa_nm_per_sqrt_hour: Some(2.0 * rate),
        ..settings(12, 1.0)
    };
    let mut tracker = Tracker::new(settings).unwrap();
    // The gain is 0.36 and more: after 100 estimates the start has a weight of 0.64^200.
    for step in 0..100 {
        let still = Array1::zeros(17);
        tracker.update(walk.observation(step as f64 * INTERVAL_S, &still)).unwrap();
    }
    let per_step = INTERVAL_S / 3600.0;
    let pistons = steady_variance(rate * rate * per_step, r);
    let ncpa = steady_variance(4.0 * rate * rate * per_step, r);
    let covariance = tracker.covariance_nm2().unwrap();
    for ((i, j), value) in covariance.indexed_iter() {
        let expected = match (i < 12, j < 12) {
            // About the mean of all pistons.
            (true, true) => pistons * (f64::from(u8::from(i == j)) - 1.0 / 12.0),
            (false, false) => ncpa * f64::from(u8::from(i == j)),
            _ => 0.0,
        };
        // A hundred steps of rounding of numbers of order 1.
        assert!((value - expected).abs() < 1e-11, "{i} {j}: {value} {expected}");
    }
}

/// Standard deviation of the logarithm of a rate of `modes` modes that `steps` estimates determine:
/// Whittle's information of a random walk with white noise, whose differences have the spectrum q +
/// 2·r·(1 − cos ω). For q ≪ r it is √(q/r)/8 for ln q, an estimate and mode.
fn rate_error(rate: f64, r: f64, modes: usize, steps: usize) -> f64 {
    let q = rate * rate * INTERVAL_S / 3600.0;
    let information = (q / r).sqrt() / 8.0 * (modes * steps) as f64;
    0.5 / information.sqrt()
}

#[test]
fn the_rates_are_learnt() {
    let (steps, rates, r) = (2880, [5.0, 2.0], 9.0);
    let mut walk = Walk::correlated(36, 20, r, 1);
    let mut tracker = Tracker::new(settings(36, 1.0)).unwrap();
    for step in 0..steps {
        // Jumps are no drift.
        match step {
            700 => walk.truth_nm[3] += 20.0,
            1400 => walk.truth_nm[20] -= 40.0,
            2100 => walk.truth_nm[35] += 80.0,
            _ => {}
        }
        walk.drift(rates);
        let seen_nm = walk.observe();
        tracker.update(walk.observation(step as f64 * INTERVAL_S, &seen_nm)).unwrap();
    }
    let (segments, ncpa) = tracker.drift_nm_per_sqrt_hour();
    let [segments_error, ncpa_error] = [rate_error(rates[0], r, 35, steps), rate_error(rates[1], r, 20, steps)];
    // Four standard deviations, and 2 % for each jump, of which the estimates before it was
    // declared are a part.
    assert!((segments / rates[0]).ln().abs() < 4.0 * segments_error + 0.06, "{segments} {segments_error}");
    assert!((ncpa / rates[1]).ln().abs() < 4.0 * ncpa_error, "{ncpa} {ncpa_error}");
}

#[test]
fn false_alarms_have_the_requested_rate() {
    for (dimension, steps, rate) in [(1, 2_000_000, 5e-5), (50, 100_000, 1e-3)] {
        let mut random = ChaCha8Rng::seed_from_u64(4);
        let threshold = change_threshold(dimension, [2, 16], rate);
        let mut last: Vec<Vec<f64>> = Vec::new();
        let mut alarms = 0;
        for _ in 0..steps {
            let new: Vec<f64> = (0..dimension).map(|_| StandardNormal.sample(&mut random)).collect();
            last.insert(0, new);
            last.truncate(16);
            let mut sum = vec![0.0; dimension];
            let is_alarm = last.iter().enumerate().any(|(before, vector)| {
                sum.iter_mut().zip(vector).for_each(|(sum, value)| *sum += value);
                before > 0 && sum.iter().map(|sum| sum * sum).sum::<f64>() > threshold * (before + 1) as f64
            });
            if is_alarm {
                alarms += 1;
                last.clear();
            }
        }
        // 100 alarms: three standard deviations are 30 %; the formula is an asymptotic one, good to
        // some 20 % here.
        let ratio = f64::from(alarms) / (rate * f64::from(steps));
        assert!((0.55..1.6).contains(&ratio), "{dimension}: {ratio}");
    }
}

#[test]
fn night_without_jumps_has_the_requested_alarm_rate() {
    let (asked, steps) = (40.0, (NIGHT_S / INTERVAL_S) as usize);
    let mut walk = Walk::correlated(36, 20, 9.0, 2);
    let mut tracker = Tracker::new(settings(36, asked)).unwrap();
    let (mut alarms, mut outliers) = (0, 0);
    for step in 0..steps {
        walk.drift([5.0, 2.0]);
        let seen_nm = walk.observe();
        let update = tracker.update(walk.observation(step as f64 * INTERVAL_S, &seen_nm)).unwrap();
        alarms += update.changes.len();
        outliers += usize::from(update.verdict != TrackerVerdict::Accepted);
    }
    // A factor of two either way: 40 alarms scatter by 6, so that this is three standard deviations
    // and the error of the formula.
    assert!((20..=80).contains(&alarms), "{alarms} alarms, {outliers} outliers");
}

#[test]
fn jumps_are_named_with_size_and_time() {
    let interval_s = INTERVAL_S;
    let mut walk = Walk::correlated(36, 20, 9.0, 3);
    let mut tracker = Tracker::new(settings(36, 0.1)).unwrap();
    let mut step = 0;
    let mut next = |walk: &mut Walk, tracker: &mut Tracker| {
        walk.drift([5.0, 2.0]);
        let seen_nm = walk.observe();
        step += 1;
        (step as f64 * interval_s, tracker.update(walk.observation(step as f64 * interval_s, &seen_nm)).unwrap())
    };
    // Estimates until it is named: a jump of 20 nm is 5.5 error bars of each of them, and the
    // threshold is at 5.2.
    for (segment, jump_nm, most) in [(7, 20.0, 10), (30, -40.0, 2), (0, 80.0, 2)] {
        for _ in 0..100 {
            assert!(next(&mut walk, &mut tracker).1.changes.is_empty());
        }
        walk.truth_nm[segment] += jump_nm;
        let mut since_s = None;
        for count in 1..=most {
            let (time_s, update) = next(&mut walk, &mut tracker);
            since_s = since_s.or(Some(time_s));
            let [change] = update.changes.as_slice() else { continue };
            assert_eq!((change.segment, change.mode), (Some(segment), Some(segment)));
            // The jump less what its segment is of the mean of all, within four error bars.
            let off = (change.size_nm - jump_nm) / change.size_error_nm;
            assert!(off.abs() < 4.0 && change.size_error_nm < 4.0, "{change:?}");
            assert!((change.since_s - since_s.unwrap()).abs() <= 2.0 * interval_s && change.detected_s == time_s);
            assert!(change.statistic > change.threshold);
            since_s = None;
            assert!(count <= most);
            break;
        }
        assert!(since_s.is_none(), "a jump of {jump_nm} nm was not named in {most} estimates");
        // The state follows: two estimates later its error is that of the filter.
        (0..2).for_each(|_| _ = next(&mut walk, &mut tracker));
        let error_nm = tracker.coefficients_nm().unwrap()[segment] - walk.centred()[segment];
        let sigma_nm = tracker.covariance_nm2().unwrap()[[segment, segment]].sqrt();
        assert!(error_nm.abs() < 4.0 * sigma_nm && sigma_nm < 3.0, "{error_nm} {sigma_nm}");
    }
}

#[test]
fn an_outlier_leaves_the_state_and_a_shift_of_all_is_a_change() {
    let walk = Walk::white(10, 8, 4.0);
    let mut tracker = Tracker::new(settings(10, 0.1)).unwrap();
    let still = Array1::zeros(18);
    (0..20).for_each(|step| _ = tracker.update(walk.observation(f64::from(step), &still)).unwrap());
    let before = tracker.coefficients_nm().unwrap();
    let bad: Array1<f64> = (0..18).map(|mode| if mode < 9 { 0.0 } else { 40.0 }).collect();
    let other_bad: Array1<f64> = bad.iter().rev().map(|nm| -3.0 * nm).collect();
    for (time_s, seen_nm) in [(20.0, &bad), (21.0, &other_bad)] {
        let update = tracker.update(walk.observation(time_s, seen_nm)).unwrap();
        assert!(matches!(update.verdict, TrackerVerdict::Outlier { chi2, limit, .. } if chi2 > limit), "{update:?}");
        assert_eq!(tracker.coefficients_nm().unwrap(), before);
    }
    let update = tracker.update(walk.observation(22.0, &still)).unwrap();
    assert!(update.verdict == TrackerVerdict::Accepted && update.changes.is_empty());
    // The same twice is no outlier.
    tracker.update(walk.observation(23.0, &bad)).unwrap();
    let update = tracker.update(walk.observation(24.0, &bad)).unwrap();
    let [change] = update.changes.as_slice() else { panic!("{update:?}") };
    assert_eq!((change.segment, change.since_s, change.detected_s), (None, 23.0, 24.0));
    let moved_nm = tracker.coefficients_nm().unwrap();
    // Opened to a hundred error bars, the state keeps 1e-4 of what was before.
    assert!((&moved_nm - &walk.centre(&bad)).iter().all(|off| off.abs() < 0.02), "{moved_nm}");
}

#[test]
fn outliers_without_end_are_a_new_state() {
    let walk = Walk::white(10, 8, 4.0);
    let mut tracker = Tracker::new(settings(10, 0.1)).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(1);
    tracker.update(walk.observation(0.0, &Array1::zeros(18))).unwrap();
    // Errors of 100 nm where 2 nm are stated.
    let mut changes = 0;
    for step in 1..30 {
        let seen_nm: Array1<f64> = (0..18).map(|_| 100.0 * random_normal(&mut random)).collect();
        changes += tracker.update(walk.observation(f64::from(step), &seen_nm)).unwrap().changes.len();
    }
    assert!((1..=3).contains(&changes), "{changes}");
}

fn random_normal(random: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(random)
}

#[test]
fn a_saved_tracker_goes_on_to_the_same_bits() {
    let mut walk = Walk::correlated(12, 5, 9.0, 5);
    let mut tracker = Tracker::new(settings(12, 1.0)).unwrap();
    for step in 0..60 {
        walk.drift([5.0, 2.0]);
        let mut seen_nm = walk.observe();
        // A suspect is part of the state, too.
        if step % 20 == 9 {
            seen_nm[2] += 50.0;
        }
        let bytes = tracker.to_bytes();
        let mut restored = Tracker::from_bytes(settings(12, 1.0), &bytes).unwrap();
        assert_eq!(restored.to_bytes(), bytes);
        let observation = walk.observation(f64::from(step) * INTERVAL_S, &seen_nm);
        assert_eq!(tracker.update(observation).unwrap(), restored.update(observation).unwrap());
        assert_eq!(tracker.to_bytes(), restored.to_bytes());
    }
    let bytes = tracker.to_bytes();
    let refused = |bytes: &[u8]| {
        let error = Tracker::from_bytes(settings(12, 1.0), bytes).unwrap_err();
        assert!(matches!(error, Error::Value(_)), "{error}");
    };
    (0..bytes.len()).step_by(97).for_each(|length| refused(&bytes[..length]));
    refused(&[bytes.as_slice(), &[0]].concat());
    refused(b"CPTRACK9");
    assert!(Tracker::from_bytes(settings(11, 1.0), &bytes).is_err());
}

#[test]
fn odd_times_and_bad_input_do_no_harm() {
    let walk = Walk::white(6, 3, 1.0);
    let mut tracker = Tracker::new(settings(6, 1.0)).unwrap();
    assert!(tracker.coefficients_nm().is_none());
    let still = Array1::zeros(9);
    for time_s in [100.0, 100.0, 50.0, -3.0, 1e9, 0.0] {
        assert_eq!(tracker.update(walk.observation(time_s, &still)).unwrap().verdict, TrackerVerdict::Accepted);
    }
    let before = tracker.to_bytes();
    let (covariance, mut negative) = (walk.covariance_nm2.clone(), walk.covariance_nm2.clone());
    negative[[8, 8]] = -10.0;
    let [short, nan] = [Array1::zeros(8), Array1::from_elem(9, f64::NAN)];
    for (time_s, seen_nm, covariance_nm2) in [
        (0.0, &short, &covariance),
        (0.0, &nan, &covariance),
        (f64::INFINITY, &still, &covariance),
        (0.0, &still, &negative),
        (0.0, &still, &Array2::zeros((8, 8))),
    ] {
        let (coefficients_nm, covariance_nm2) = (seen_nm.view(), covariance_nm2.view());
        let pointing_nm = None;
        assert!(tracker.update(TimedEstimate { time_s, coefficients_nm, covariance_nm2, pointing_nm }).is_err());
        assert_eq!(tracker.to_bytes(), before);
    }
    for bad in [
        TrackerSettings { false_alarms_per_night: 0.0, ..settings(6, 1.0) },
        TrackerSettings { nominal_interval_s: f64::NAN, ..settings(6, 1.0) },
        TrackerSettings { drift_ncpa_nm_per_sqrt_hour: Some(-1.0), ..settings(6, 1.0) },
        TrackerSettings { segment_of_mode: vec![0], ..settings(6, 1.0) },
    ] {
        assert!(Tracker::new(bad).is_err());
    }
}
