//! Motion that is no step: of the star, and of a focus that breathes.

use super::walk::{INTERVAL_S, Walk, settings};
use cophase::tracking::{NIGHT_S, TimedEstimate, Tracker, TrackerSettings, TrackerVerdict, Update};
use ndarray::{Array1, Array2};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

const SEGMENTS: usize = 36;
const NCPA: usize = 20;
/// Tip, tilt and focus among the modes.
const TIP: usize = SEGMENTS;
const FOCUS: usize = SEGMENTS + 2;

/// Settings with tip and tilt, the first NCPA modes, as the pointing.
fn with_pointing(false_alarms_per_night: f64) -> TrackerSettings {
    let pointing_modes =
        Array2::from_shape_fn((2, SEGMENTS + NCPA), |(axis, mode)| f64::from(u8::from(mode == TIP + axis)));
    TrackerSettings { pointing_modes, ..settings(SEGMENTS, false_alarms_per_night) }
}

/// A telescope in front of which the star moves.
struct Night {
    walk: Walk,
    tracker: Tracker,
    random: ChaCha8Rng,
    images: usize,
}

impl Night {
    /// Estimates with error bars of 3 nm.
    fn new(false_alarms_per_night: f64, seed: u64) -> Self {
        let walk = Walk::correlated(SEGMENTS, NCPA, 9.0, seed);
        let tracker = Tracker::new(with_pointing(false_alarms_per_night)).unwrap();
        Self { walk, tracker, random: ChaCha8Rng::seed_from_u64(100 + seed), images: 0 }
    }

    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.random)
    }

    /// An image with the star at `place_nm` and `focus_nm` more than the walk has.
    fn image(&mut self, place_nm: [f64; 2], focus_nm: f64) -> Update {
        self.walk.drift([5.0, 2.0]);
        let mut seen_nm = self.walk.observe();
        seen_nm[FOCUS] += focus_nm;
        (0..2).for_each(|axis| seen_nm[TIP + axis] += place_nm[axis]);
        self.images += 1;
        let time_s = self.images as f64 * INTERVAL_S;
        self.tracker
            .update(TimedEstimate { pointing_nm: Some(place_nm), ..self.walk.observation(time_s, &seen_nm) })
            .unwrap()
    }

    /// The star about the axis, nm RMS along each axis.
    fn star(&mut self, rms_nm: f64) -> [f64; 2] {
        [rms_nm * self.normal(), rms_nm * self.normal()]
    }
}

#[test]
fn star_that_moves_changes_no_alarm() {
    // Four pixels of a quarter of λ/D at 2 µm are 540 nm; an estimate knows them to 3 nm.
    let run = |rms_nm: f64| {
        let mut night = Night::new(0.1, 1);
        let mut updates = Vec::new();
        for image in 0..120 {
            if image == 60 {
                night.walk.truth_nm[7] += 40.0;
            }
            let star = night.star(rms_nm);
            updates.push(Update { pointing: None, ..night.image(star, 0.0) });
        }
        (updates, night.tracker.coefficients_nm().unwrap(), night.tracker.covariance_nm2().unwrap())
    };
    let (still, still_nm, still_nm2) = run(0.0);
    let (moving, moving_nm, moving_nm2) = run(540.0);
    let named: Vec<(usize, Option<usize>)> = (still.iter().enumerate())
        .flat_map(|(at, update)| update.changes.iter().map(move |c| (at, c.segment)))
        .collect();
    assert!(matches!(named[..], [(60..62, Some(7))]), "{named:?}");
    for (one, other) in still.iter().zip(&moving) {
        let of =
            |update: &Update| (update.verdict == TrackerVerdict::Accepted, update.changes.first().map(|c| c.segment));
        assert_eq!(of(one), of(other));
    }
    // What is left of 540 nm is rounding.
    assert!((&still_nm - &moving_nm).iter().all(|nm| nm.abs() < 1e-9) && still_nm2 == moving_nm2);
    assert!([0, 1].iter().all(|axis| moving_nm[TIP + axis] == 0.0 && moving_nm2[[TIP + axis, TIP + axis]] == 0.0));
}

#[test]
fn staircase_of_pistons_is_no_pointing() {
    let mut night = Night::new(0.1, 2);
    for _ in 0..40 {
        let star = night.star(200.0);
        assert!(night.image(star, 0.0).changes.is_empty());
    }
    let stairs = |segment: usize| 20.0 * (segment as f64 / 17.5 - 1.0);
    (0..SEGMENTS).for_each(|segment| night.walk.truth_nm[segment] += stairs(segment));
    let changes: usize = (0..3)
        .map(|_| {
            let star = night.star(200.0);
            night.image(star, 0.0).changes.len()
        })
        .sum();
    assert!(changes > 0);
    let state_nm = night.tracker.coefficients_nm().unwrap();
    let error_nm = (0..SEGMENTS).map(|at| (state_nm[at] - night.walk.centred()[at]).powi(2)).sum::<f64>() / 36.0;
    assert!(error_nm.sqrt() < 3.0, "{error_nm} nm²");
}

#[test]
fn star_that_goes_elsewhere_is_an_alarm_of_its_own() {
    let mut night = Night::new(0.1, 3);
    for image in 0..100 {
        let mut star = night.star(40.0);
        // Flexure, and one image in which the telescope was bumped.
        star[0] += 2.0 * f64::from(image);
        if image == 50 {
            star[1] += 2000.0;
        }
        let update = night.image(star, 0.0);
        assert!(update.pointing.is_none() && update.changes.is_empty(), "image {image}: {update:?}");
    }
    let rms_nm = night.tracker.pointing_rms_nm().unwrap();
    assert!((rms_nm / 40.0 - 1.0).abs() < 0.3, "{rms_nm}");
    let mut found = None;
    for image in 0..4 {
        let star = night.star(40.0);
        let update = night.image([star[0] + 200.0 - 300.0, star[1]], 0.0);
        assert!(update.changes.is_empty());
        found = found.or(update.pointing.map(|change| (image, change)));
    }
    let (image, change) = found.expect("the star moved by 300 nm");
    assert!((1..=2).contains(&image) && change.since_s == 101.0 * INTERVAL_S, "{image}: {change:?}");
    // Against the mean of a drifting star.
    assert!((change.moved_nm[0] + 300.0).abs() < 120.0 && change.moved_nm[1].abs() < 120.0, "{change:?}");
}

#[test]
fn focus_that_breathes_is_no_step_and_hides_none() {
    // Slowly, with a period of 25 minutes, or anew in each image: 5 nm RMS.
    for (number, is_slow) in [(4, true), (5, false)] {
        let mut night = Night::new(0.1, number);
        let mut random = ChaCha8Rng::seed_from_u64(number);
        let mut breath = |image: usize| {
            let normal: f64 = StandardNormal.sample(&mut random);
            if is_slow { 5.0 * 2f64.sqrt() * (image as f64 / 24.0).sin() } else { 5.0 * normal }
        };
        for image in 0..400 {
            let star = night.star(70.0);
            let update = night.image(star, breath(image));
            assert!(
                update.changes.is_empty() && update.verdict == TrackerVerdict::Accepted,
                "slow {is_slow}, image {image}: {update:?}"
            );
        }
        night.walk.truth_nm[30] -= 40.0;
        let named = (400..402).any(|image| {
            let star = night.star(70.0);
            night.image(star, breath(image)).changes.iter().any(|change| change.segment == Some(30))
        });
        assert!(named, "slow {is_slow}");
    }
}

#[test]
fn night_of_a_moving_star_has_the_requested_alarm_rate() {
    let asked = 40.0;
    let mut night = Night::new(asked, 6);
    let (mut changes, mut moves) = (0, 0);
    for image in 0..(NIGHT_S / INTERVAL_S) as usize {
        let star = night.star(70.0);
        let update = night.image(star, 5.0 * 2f64.sqrt() * (image as f64 / 24.0).sin());
        changes += update.changes.len();
        moves += usize::from(update.pointing.is_some());
    }
    // As of a night without motion; one detector of 38 is the pointing's, which raises one alarm.
    assert!((20..=80).contains(&changes) && moves <= 5, "{changes} changes, {moves} moves");
}

#[test]
fn pointing_of_other_modes_is_refused() {
    let walk = Walk::white(6, 3, 1.0);
    let pointing_modes = Array2::zeros((2, 7));
    let mut tracker = Tracker::new(TrackerSettings { pointing_modes, ..settings(6, 1.0) }).unwrap();
    assert!(tracker.update(walk.observation(0.0, &Array1::zeros(9))).is_err());
    let pointing_modes = Array2::from_elem((2, 9), f64::NAN);
    assert!(Tracker::new(TrackerSettings { pointing_modes, ..settings(6, 1.0) }).is_err());
}
