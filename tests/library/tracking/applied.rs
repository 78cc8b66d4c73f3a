//! Corrections that somebody applies, or not: what the estimates alone show.

use super::walk::{INTERVAL_S, Walk, settings};
use cophase::tracking::{AppliedPart, NIGHT_S, Tracker, TrackerVerdict, Update};
use ndarray::{Array1, s};

const SEGMENTS: usize = 12;
const NCPA: usize = 6;
/// Drift, nm/√h.
const RATE: f64 = 5.0;
/// Error bar of an estimate, nm.
const SIGMA_NM: f64 = 3.0;

/// A telescope that drifts, with its tracker, after `images` images.
struct Night {
    walk: Walk,
    tracker: Tracker,
    images: usize,
}

impl Night {
    fn after(images: usize, seed: u64) -> Self {
        let walk = Walk::correlated(SEGMENTS, NCPA, SIGMA_NM * SIGMA_NM, seed);
        let mut night = Self { walk, tracker: Tracker::new(settings(SEGMENTS, 0.1)).unwrap(), images: 0 };
        (0..images).for_each(|_| drop(night.image()));
        night
    }

    fn image(&mut self) -> Update {
        self.walk.drift([RATE; 2]);
        let observed = self.walk.observe();
        self.images += 1;
        self.tracker.update(self.walk.observation(self.images as f64 * INTERVAL_S, &observed)).unwrap()
    }

    /// Images until one shows a correction to be applied; nothing else may be seen in them.
    fn until_applied(&mut self, most: usize) -> Option<(usize, Update)> {
        for image in 1..=most {
            let update = self.image();
            if update.applied.is_some() {
                assert!(update.changes.is_empty() && update.verdict == TrackerVerdict::Accepted);
                return Some((image, update));
            }
            assert!(update.changes.is_empty(), "image {image}: {:?}", update.changes);
        }
        None
    }

    /// RMS of the tracked state's error, in terms of the error bar of one image.
    fn error(&self) -> f64 {
        let off = self.tracker.coefficients_nm().unwrap() - self.walk.centred();
        (off.dot(&off) / off.len() as f64).sqrt() / SIGMA_NM
    }
}

/// A correction of `nm` RMS of segments and of NCPA, pistons about their mean.
fn correction(walk: &Walk, [segments_nm, ncpa_nm]: [f64; 2]) -> Array1<f64> {
    let size = |mode: usize| if mode < SEGMENTS { segments_nm } else { ncpa_nm };
    let sign = |mode: usize| if mode.is_multiple_of(2) { 1.0 } else { -1.0 };
    walk.centre(&(0..SEGMENTS + NCPA).map(|mode| sign(mode) * size(mode)).collect())
}

#[test]
fn an_applied_correction_is_recognised_and_is_no_alarm() {
    // From a sixth of an error bar in each mode, of which it takes some ten images, to twenty.
    for (rms_nm, most) in [(3.0, 12), (10.0, 1), (60.0, 1)] {
        for seed in 0..10 {
            let mut night = Night::after(40, seed);
            let change = correction(&night.walk, [rms_nm; 2]);
            night.tracker.expect(7, change.view()).unwrap();
            assert_eq!(night.tracker.expected_corrections(), [7]);
            assert!((0..5).all(|_| night.image().applied.is_none()));
            // Actuators move by 5 % too little.
            night.walk.truth_nm.scaled_add(0.95, &change);
            let (images, update) = night.until_applied(most).expect("the correction was applied");
            let applied = update.applied.unwrap();
            assert_eq!((applied.number, applied.part), (7, AppliedPart::Whole), "{rms_nm} nm, image {images}");
            assert!((applied.fraction - 0.95).abs() < 4.0 * applied.fraction_error, "{applied:?}");
            assert!(night.tracker.expected_corrections().is_empty());
            // The state follows at once, as well as before: some images make it better than one.
            assert!(night.error() < 1.0, "{rms_nm} nm, seed {seed}: {}", night.error());
            (0..20).for_each(|_| assert_eq!((night.image().changes.len(), night.image().applied), (0, None)));
            assert!(night.error() < 0.8, "{rms_nm} nm, seed {seed}: {}", night.error());
        }
    }
}

#[test]
fn one_part_and_then_the_other_may_be_applied() {
    let mut night = Night::after(40, 3);
    let change = correction(&night.walk, [30.0, 20.0]);
    night.tracker.expect(1, change.view()).unwrap();
    for (range, part) in [(0..SEGMENTS, AppliedPart::Segments), (SEGMENTS..SEGMENTS + NCPA, AppliedPart::Whole)] {
        let mut moved = Array1::zeros(change.len());
        moved.slice_mut(s![range.clone()]).assign(&change.slice(s![range]));
        night.walk.truth_nm += &moved;
        let (_, update) = night.until_applied(2).expect("a part was applied");
        // What is left of it is one part alone.
        let expected = if part == AppliedPart::Whole { AppliedPart::Ncpa } else { part };
        assert_eq!(update.applied.unwrap().part, expected);
    }
    assert!(night.tracker.expected_corrections().is_empty());
}

#[test]
fn half_a_correction_and_another_movement_are_alarms() {
    for part in [0.5, -1.0] {
        let mut night = Night::after(40, 5);
        let change = correction(&night.walk, [40.0; 2]);
        night.tracker.expect(1, change.view()).unwrap();
        night.walk.truth_nm.scaled_add(part, &change);
        let updates: Vec<Update> = (0..4).map(|_| night.image()).collect();
        assert!(updates.iter().all(|update| update.applied.is_none()), "{part}: {updates:?}");
        assert!(updates.iter().any(|update| !update.changes.is_empty()), "{part}: {updates:?}");
        // It may be applied still.
        assert_eq!(night.tracker.expected_corrections(), [1]);
    }
    // One segment that jumps is named, though a correction that moves it is expected.
    let mut night = Night::after(40, 6);
    let change = correction(&night.walk, [40.0; 2]);
    night.tracker.expect(1, change.view()).unwrap();
    night.walk.truth_nm[4] += 40.0;
    let named: Vec<_> = (0..3).flat_map(|_| night.image().changes).map(|change| change.segment).collect();
    assert_eq!(named, [Some(4)]);
}

#[test]
fn a_bad_estimate_shows_no_application() {
    let mut night = Night::after(40, 8);
    let change = correction(&night.walk, [10.0; 2]);
    night.tracker.expect(1, change.view()).unwrap();
    for seed in 0..50 {
        // Some hundred error bars in every mode: its part along the correction is as large as the
        // correction, or larger, in most.
        let mut wild = Walk::correlated(SEGMENTS, NCPA, (100.0 * SIGMA_NM).powi(2), seed);
        let observed = wild.observe();
        night.images += 1;
        let update = night.tracker.update(night.walk.observation(night.images as f64 * INTERVAL_S, &observed)).unwrap();
        assert_eq!(update.applied, None);
        night.image();
    }
}

#[test]
fn the_newest_corrections_may_be_applied() {
    let mut night = Night::after(40, 9);
    // Each moves another segment most: sizes alone would be the error of actuators.
    let of = |segment: usize| {
        let mut change = correction(&night.walk, [20.0, 10.0]);
        change[segment] += 60.0;
        night.walk.centre(&change)
    };
    let changes: Vec<Array1<f64>> = (0..6).map(of).collect();
    for (place, change) in changes.iter().enumerate() {
        night.tracker.expect(place as i64 + 1, change.view()).unwrap();
    }
    assert_eq!(night.tracker.expected_corrections(), [3, 4, 5, 6]);
    // Somebody applies one that was replaced. A tracker that was stored meanwhile goes on to the
    // same bits.
    let settings = night.tracker.settings().clone();
    night.tracker = Tracker::from_bytes(settings, &night.tracker.to_bytes()).unwrap();
    night.walk.truth_nm += &changes[3];
    let (_, update) = night.until_applied(1).unwrap();
    assert_eq!(update.applied.unwrap().number, 4);
    assert!(night.tracker.expected_corrections().is_empty());
}

#[test]
#[ignore = "merge: 10 s"]
fn unapplied_corrections_are_not_recognised() {
    // 20 nights at ten false ones a night that are accepted, of two corrections, each as a whole
    // and in parts: the bound is 200. Lorden's bound is not sharp; a few would show that the
    // weights are no likelihood ratios where none are far beyond it.
    let mut found = 0;
    let nights = 20;
    for seed in 0..nights {
        let mut night = Night::after(0, 100 + seed);
        night.tracker = Tracker::new(settings(SEGMENTS, 10.0)).unwrap();
        night.image();
        let changes = [[3.0, 0.0], [0.0, 4.0]].map(|rms_nm| correction(&night.walk, rms_nm));
        for _ in 0..(NIGHT_S / INTERVAL_S) as usize {
            if night.tracker.expected_corrections().is_empty() {
                (1..).zip(&changes).for_each(|(number, change)| night.tracker.expect(number, change.view()).unwrap());
            }
            found += usize::from(night.image().applied.is_some());
        }
    }
    println!("{found} of {nights} nights at 10 a night");
    assert!(found <= 10 * nights as usize, "{found}");
}

#[test]
fn corrections_that_do_not_fit_are_refused() {
    let mut tracker = Tracker::new(settings(SEGMENTS, 0.1)).unwrap();
    assert!(
        tracker
            .expect(1, Array1::zeros(SEGMENTS + NCPA).view())
            .unwrap_err()
            .to_string()
            .contains("nothing to correct")
    );
    let mut night = Night::after(1, 1);
    assert!(night.tracker.expect(1, Array1::zeros(3).view()).unwrap_err().to_string().contains("18 are needed"));
    let bad = Array1::from_elem(SEGMENTS + NCPA, f64::NAN);
    assert!(night.tracker.expect(1, bad.view()).unwrap_err().to_string().contains("finite"));
    // One that changes nothing is none.
    night.tracker.expect(1, Array1::zeros(SEGMENTS + NCPA).view()).unwrap();
    assert!(night.tracker.expected_corrections().is_empty());
}
