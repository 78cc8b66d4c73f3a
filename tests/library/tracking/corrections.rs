//! Corrections: what they gain, and that they do no harm.

use cophase::tracking::{Correctable, Correction, CorrectionPolicy, HoldReason, SegmentConvention, correction};
use ndarray::{Array1, Array2};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

const SEGMENTS: usize = 36;
/// A ring of segments.
fn edges() -> Vec<(usize, usize)> {
    (0..SEGMENTS).map(|segment| (segment, (segment + 1) % SEGMENTS)).collect()
}

fn correct(policy: &CorrectionPolicy, estimate_nm: &Array1<f64>, covariance_nm2: &Array2<f64>) -> Correction {
    let segments: Vec<usize> = (0..SEGMENTS).collect();
    let errors = Correctable {
        coefficients_nm: estimate_nm.view(),
        covariance_nm2: covariance_nm2.view(),
        segment_modes: &(0..SEGMENTS),
        segment_of_mode: &segments,
        edges: &edges(),
        left_modes: &[SEGMENTS],
    };
    correction(policy, &errors).unwrap()
}

/// Mean squares of errors before and after, of `draws` estimates with error bars of 3 nm of errors
/// of `rms_nm`.
fn before_and_after(policy: &CorrectionPolicy, rms_nm: f64, draws: usize) -> [f64; 2] {
    let (count, sigma_nm) = (SEGMENTS + 10, 3.0);
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let covariance_nm2 = Array2::eye(count) * (sigma_nm * sigma_nm);
    let mut sums = [0.0; 2];
    for _ in 0..draws {
        let mut normals = |nm: f64| -> Array1<f64> {
            let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
            (0..count).map(|_| nm * normal()).collect()
        };
        let truth_nm = normals(rms_nm);
        let estimate_nm = &truth_nm + &normals(sigma_nm);
        let after_nm = &truth_nm - &correct(policy, &estimate_nm, &covariance_nm2).coefficients_nm;
        let squares = |nm: &Array1<f64>| nm.dot(nm) / (count * draws) as f64;
        sums[0] += squares(&truth_nm);
        sums[1] += squares(&after_nm);
    }
    sums
}

#[test]
fn corrections_do_no_harm() {
    for convention in [SegmentConvention::LeastSquares, SegmentConvention::EdgeMinimising] {
        // Errors far below the error bars. A deadband of k error bars alone adds 2·(k·φ(k) + Φ(−k))
        // of the 9 nm²: all, 80 %, 26 % and 2.9 %. With the rule one per cent may remain, the part
        // of draws of noise that are sent (correction.rs) times what they add to a few modes; of
        // the largest deadband, beyond which the rule is applied to single modes, two thirds.
        for (deadband_sigma, part) in [(0.0, 0.01), (1.0, 0.01), (2.0, 0.01), (3.0, 0.02)] {
            let policy = CorrectionPolicy { deadband_sigma, convention, ..Default::default() };
            let [before, after] = before_and_after(&policy, 0.3, 1000);
            assert!(after - before < part * 9.0, "{policy:?}: {before} {after}");
            // Errors of three error bars: 9 nm² are left of 81, and 4·9 of those in a deadband of
            // two.
            let [before, after] = before_and_after(&policy, 9.0, 100);
            assert!(after < 0.45 * before, "{policy:?}: {before} {after}");
        }
    }
}

#[test]
fn deadband_limit_gain_and_reasons() {
    let mut estimate_nm = Array1::zeros(SEGMENTS + 10);
    for (mode, nm) in [(0, 40.0), (5, -300.0), (9, 5.0), (SEGMENTS, 90.0), (SEGMENTS + 1, 50.0), (SEGMENTS + 2, 3.0)] {
        estimate_nm[mode] = nm;
    }
    let covariance_nm2 = Array2::eye(SEGMENTS + 10) * 9.0;
    let policy =
        CorrectionPolicy { gain: 0.5, deadband_sigma: 2.0, stroke_limit_nm: Some(100.0), ..Default::default() };
    let sent = correct(&policy, &estimate_nm, &covariance_nm2);
    let moved: Vec<(usize, f64)> =
        sent.coefficients_nm.iter().copied().enumerate().filter(|(_, nm)| *nm != 0.0).collect();
    // Pointing, mode 36, is left; 150 nm are cut at 100.
    assert_eq!(moved, [(0, 20.0), (5, -100.0), (SEGMENTS + 1, 25.0)]);
    assert_eq!(sent.limited, [5]);
    assert_eq!(sent.held.len(), SEGMENTS + 10 - 4);
    assert!(
        sent.held.iter().all(|held| held.reason == HoldReason::Deadband && held.segment.is_some() == (held.mode < 36))
    );
    // Of noise alone the largest is beyond two error bars, and is not worth correcting.
    let mut noise_nm = Array1::zeros(SEGMENTS + 10);
    noise_nm[3] = 7.0;
    let policy = CorrectionPolicy { deadband_sigma: 2.0, ..Default::default() };
    let sent = correct(&policy, &noise_nm, &covariance_nm2);
    assert!(sent.coefficients_nm.iter().all(|nm| *nm == 0.0));
    let held = sent.held.iter().find(|held| held.mode == 3).unwrap();
    assert_eq!((held.segment, held.reason), (Some(3), HoldReason::NoBenefit));
}

#[test]
fn uncertain_mode_does_not_block_the_others() {
    let mut estimate_nm = Array1::from_elem(SEGMENTS + 10, 12.0);
    let mut covariance_nm2 = Array2::eye(SEGMENTS + 10) * 9.0;
    // As a focus beside an error of the diversity; in one block its variance would exceed all that
    // the others gain.
    covariance_nm2[[SEGMENTS + 3, SEGMENTS + 3]] = 90_000.0;
    estimate_nm[SEGMENTS + 3] = 100.0;
    let sent = correct(&CorrectionPolicy::default(), &estimate_nm, &covariance_nm2);
    let stays: Vec<usize> = (0..SEGMENTS + 10).filter(|mode| sent.coefficients_nm[*mode] == 0.0).collect();
    assert_eq!(stays, [SEGMENTS, SEGMENTS + 3]);
    assert_eq!((sent.held.len(), sent.held[0].reason), (1, HoldReason::Deadband));
}

#[test]
fn moved_segments_meet_those_that_stay_by_the_edge_convention() {
    let mut estimate_nm = Array1::zeros(SEGMENTS + 10);
    // Segments 4 and 5 move; their neighbours 3 and 6 stay, at 3 and −3 nm.
    for (mode, nm) in [(3, 3.0), (4, 200.0), (5, 100.0), (6, -3.0)] {
        estimate_nm[mode] = nm;
    }
    let covariance_nm2 = Array2::eye(SEGMENTS + 10) * 4.0;
    let of = |convention| {
        let policy = CorrectionPolicy { deadband_sigma: 2.0, convention, ..Default::default() };
        let sent = correct(&policy, &estimate_nm, &covariance_nm2);
        &estimate_nm - &sent.coefficients_nm
    };
    let (plain, meeting) = (of(SegmentConvention::LeastSquares), of(SegmentConvention::EdgeMinimising));
    assert_eq!((plain[4], plain[5]), (0.0, 0.0));
    // In three equal steps from 3 to −3; the regularisation of the solution is 1e-9.
    assert!((meeting[4] - 1.0).abs() < 1e-6 && (meeting[5] + 1.0).abs() < 1e-6, "{meeting}");
    let steps = |nm: &Array1<f64>| edges().iter().map(|&(i, j)| (nm[i] - nm[j]).powi(2)).sum::<f64>();
    assert!(steps(&meeting) < steps(&plain));
}

#[test]
fn policies_out_of_range_are_refused() {
    for policy in [
        CorrectionPolicy { gain: 0.0, ..Default::default() },
        CorrectionPolicy { gain: 1.5, ..Default::default() },
        CorrectionPolicy { deadband_sigma: -1.0, ..Default::default() },
        CorrectionPolicy { stroke_limit_nm: Some(0.0), ..Default::default() },
    ] {
        let (estimate_nm, covariance_nm2) = (Array1::zeros(2), Array2::eye(2));
        let errors = Correctable {
            coefficients_nm: estimate_nm.view(),
            covariance_nm2: covariance_nm2.view(),
            segment_modes: &(0..1),
            segment_of_mode: &[0],
            edges: &[],
            left_modes: &[],
        };
        assert!(correction(&policy, &errors).is_err(), "{policy:?}");
    }
}
