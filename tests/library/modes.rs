//! Mode bases through the public interface: on a segmented pupil, with the deformable mirror of
//! Keck.

use crate::common::assert_facts;
use cophase::modes::*;
use cophase::pupil::Grid;
use cophase::pupil::{Pupil, Segment};
use ndarray::{Array1, Array2, Array3, Axis};

/// 36 hexagons of side 0.9 m in three rings, the central one absent, 3 mm apart: amplitude by 8×8
/// sub-samples.
fn keck_like(samples: usize) -> Pupil {
    let (side_m, pitch_m) = (0.9f64, 3f64.sqrt() * 0.9 + 0.003);
    let grid = Grid::new(samples, 10.95).unwrap();
    let mut segments = Vec::new();
    for q in -3i32..=3 {
        for r in -3i32..=3 {
            let ring = q.abs().max(r.abs()).max((q + r).abs());
            if (1..=3).contains(&ring) {
                let (q, r) = (f64::from(q), f64::from(r));
                let (x_m, y_m) = (pitch_m * 3f64.sqrt() / 2.0 * q, pitch_m * (r + q / 2.0));
                let angle = y_m.atan2(x_m).rem_euclid(std::f64::consts::TAU);
                segments.push((ring, angle, Segment { x_m, y_m, label: 0 }));
            }
        }
    }
    segments.sort_by(|a, b| (a.0, a.1).partial_cmp(&(b.0, b.1)).unwrap());
    let segments: Vec<Segment> = segments.into_iter().map(|(_, _, segment)| segment).collect();
    // Vertices on ±x: |y| ≤ √3/2·side and √3·|x| + |y| ≤ √3·side.
    let owner_of = |x: f64, y: f64| {
        let inside = |s: &Segment| {
            let (dx, dy) = ((x - s.x_m).abs(), (y - s.y_m).abs());
            dy <= 3f64.sqrt() / 2.0 * side_m && 3f64.sqrt() * dx + dy <= 3f64.sqrt() * side_m
        };
        segments.iter().position(inside)
    };
    let mut amplitude = Array2::zeros((samples, samples));
    let mut owner = Array2::from_elem((samples, samples), -1);
    for row in 0..samples {
        for column in 0..samples {
            let mut shares = vec![0; segments.len()];
            for sub in 0..64 {
                let shift = |k: usize| (k as f64 - 3.5) / 8.0 * grid.pitch_m();
                let (x, y) = (grid.coordinate_m(column) + shift(sub % 8), grid.coordinate_m(row) + shift(sub / 8));
                if let Some(segment) = owner_of(x, y) {
                    shares[segment] += 1;
                }
            }
            let covered: i32 = shares.iter().sum();
            amplitude[[row, column]] = f64::from(covered) / 64.0;
            if covered > 0 {
                let largest = (0..shares.len()).max_by_key(|&s| shares[s]).unwrap();
                owner[[row, column]] = largest as i32;
            }
        }
    }
    Pupil { grid, amplitude, owner, segments }
}

fn keck_mirror() -> Mirror {
    Mirror::new(21, 0.5625, 0.1458).unwrap()
}

fn keck_kl(pupil: &Pupil, count: usize) -> KarhunenLoeve {
    let actuators = keck_mirror().near(pupil, Mirror::DEFAULT_MARGIN_PITCHES).unwrap();
    karhunen_loeve(&actuators, pupil, &VonKarman::new(0.16, 50.0).unwrap(), count).unwrap()
}

/// Means and mean products of modes over the samples of the pupil, weight A.
fn products(left: &SmoothBasis, right: &SmoothBasis, pupil: &Pupil) -> (Array1<f64>, Array2<f64>) {
    let samples = Samples::from_pupil(pupil).unwrap();
    let weights = Array1::from(samples.weights.clone());
    let left = left.evaluate(&samples.xs_m, &samples.ys_m).unwrap();
    let right = right.evaluate(&samples.xs_m, &samples.ys_m).unwrap();
    (left.dot(&weights), (&left * &weights).dot(&right.t()))
}

fn assert_orthonormal(basis: &SmoothBasis, pupil: &Pupil) {
    let (means, gram) = products(basis, basis, pupil);
    let worst = (&gram - &Array2::<f64>::eye(basis.len())).iter().chain(&means).fold(0f64, |w, e| w.max(e.abs()));
    // After the second Cholesky pass only rounding remains: sums over 1e4 samples of a combination
    // of some hundred functions whose coefficients reach a few hundred.
    assert!(worst < 1e-12, "worst error of the Gram matrix and the means: {worst:.1e}");
}

/// RMS of each mode of `basis` outside the span of the orthonormal `span`.
fn outside(basis: &SmoothBasis, span: &SmoothBasis, pupil: &Pupil) -> Vec<f64> {
    let (_, cross) = products(basis, span, pupil);
    let (_, own) = products(basis, basis, pupil);
    cross.rows().into_iter().zip(own.diag()).map(|(row, total)| (total - row.dot(&row)).max(0.0).sqrt()).collect()
}

#[test]
fn zernike_modes_are_orthonormal_over_the_pupil_and_triangular() {
    let pupil = keck_like(60);
    let basis = zernike_basis(2, 105, &pupil).unwrap();
    assert_orthonormal(&basis, &pupil);
    // Each mode is its own polynomial with a positive coefficient, plus earlier ones.
    for ((mode, function), &value) in basis.matrix().indexed_iter() {
        assert!(if function > mode { value == 0.0 } else { function < mode || value > 0.0 }, "[{mode}, {function}]");
    }
    // A later start only omits modes.
    let later = zernike_basis(4, 18, &pupil).unwrap();
    assert_eq!(later.names().first().unwrap(), "noll-4");
    assert_eq!(later.len(), 15);
    let point = |basis: &SmoothBasis| basis.evaluate(&[1.3, 5.6], &[-2.0, 0.4]).unwrap();
    let (all, some) = (point(&zernike_basis(2, 18, &pupil).unwrap()), point(&later));
    assert_eq!(all.slice(ndarray::s![2.., ..]), some);
}

#[test]
fn zernike_modes_do_not_depend_on_the_disc_of_the_polynomials() {
    // The same spans from a disc half as wide again: only rounding, amplified by that basis' poorer
    // condition (1.5^-5 per polynomial of order 5, squared in the Gram matrix and repaired by the
    // second pass).
    let pupil = keck_like(60);
    let wide = SmoothBasis::zernike(Zernikes::new(2..=21, 8.0).unwrap());
    let wide = orthonormalise(&wide, &pupil, 1e-6).unwrap().basis;
    let usual = zernike_basis(2, 21, &pupil).unwrap();
    let (_, cross) = products(&wide, &usual, &pupil);
    let worst = (&cross - &Array2::<f64>::eye(20)).iter().fold(0f64, |worst, e| worst.max(e.abs()));
    assert!(worst < 1e-11, "{worst:.1e}");
}

#[test]
fn a_mode_is_the_same_function_on_every_grid() {
    let pupil = keck_like(60);
    let basis = keck_kl(&pupil, 10).basis;
    let maps = basis.sampled(&pupil).unwrap();
    assert!(maps.groups().iter().all(|&group| group == Group::Ncpa));
    let fine = Grid::new(3 * pupil.grid.samples(), pupil.grid.width_m()).unwrap();
    // Sample (20, 33) of the coarse grid is the centre of a 3×3 cell: sample (61, 100) of the fine
    // one.
    let (x, y) = (fine.coordinate_m(100), fine.coordinate_m(61));
    let value = basis.evaluate(&[x], &[y]).unwrap();
    for mode in 0..basis.len() {
        // The coordinates differ by rounding, 1e-15, times the modes' slope, a few per metre.
        assert!((value[[mode, 0]] - maps.maps()[[mode, 20, 33]]).abs() < 1e-13);
        assert_eq!(maps.maps()[[mode, 0, 0]], 0.0);
    }
    // The values do not depend on blocks, threads and the order of the points.
    let samples = Samples::from_pupil(&pupil).unwrap();
    let all = basis.evaluate(&samples.xs_m, &samples.ys_m).unwrap();
    let last = samples.xs_m.len() - 1;
    let one = basis.evaluate(&samples.xs_m[last..], &samples.ys_m[last..]).unwrap();
    let difference = (&all.column(last) - &one.column(0)).iter().fold(0f64, |worst, e| worst.max(e.abs()));
    assert!(difference < 1e-13, "{difference:.1e}");
    assert!(basis.evaluate(&[0.0, 1.0], &[0.0]).is_err());
}

#[test]
fn karhunen_loeve_modes_are_orthonormal_and_fall_in_variance() {
    let pupil = keck_like(120);
    let kl = keck_kl(&pupil, 66);
    assert_orthonormal(&kl.basis, &pupil);
    assert_eq!((kl.basis.names()[0].as_str(), kl.basis.names()[65].as_str()), ("kl-00", "kl-65"));
    assert!(kl.variances_nm2.windows(2).all(|pair| pair[0] >= pair[1]) && kl.variances_nm2[65] > 0.0);
    // The first two are nearly tip and tilt, as on every pupil; the difference is the ripple of the
    // mirror.
    let tip_tilt = zernike_basis(2, 3, &pupil).unwrap();
    let (_, cross) = products(&tip_tilt, &kl.basis, &pupil);
    for row in cross.rows() {
        assert!(row[0].hypot(row[1]) > 0.98, "{row}");
    }
}

#[test]
fn the_modes_do_not_depend_on_the_sampling_of_the_pupil() {
    // 96 samples are used as they are, 180 are averaged to a grid of 118. The edges are accurate to
    // a fraction of a sample, about 1 % of the area, and modes of similar variance mix: so the
    // spans are compared, which may differ in the 66th mode, whose variance is close to that of the
    // 67th.
    let (coarse, fine) = (keck_like(96), keck_like(180));
    let (first, second) = (keck_kl(&coarse, 66), keck_kl(&fine, 66));
    for (a, b) in first.variances_nm2.iter().zip(&second.variances_nm2) {
        assert!((a / b - 1.0).abs() < 0.01, "{a} {b}");
    }
    let (_, cross) = products(&first.basis, &second.basis, &fine);
    let overlap: f64 = cross.iter().map(|value| value * value).sum::<f64>() / 66.0;
    assert!((overlap - 1.0).abs() < 0.01, "{overlap}");
}

#[test]
fn karhunen_loeve_modes_are_uncorrelated_in_turbulence() {
    // By the definition, over all pairs of samples. A mirror of twice the pitch has enough samples
    // on this grid, so the modes must be exact on it.
    let pupil = keck_like(40);
    let actuators = Mirror::new(11, 1.125, 0.1458).unwrap().near(&pupil, Mirror::DEFAULT_MARGIN_PITCHES).unwrap();
    let kl = karhunen_loeve(&actuators, &pupil, &VonKarman::new(0.16, 50.0).unwrap(), 20).unwrap();
    let samples = Samples::from_pupil(&pupil).unwrap();
    let modes = kl.basis.evaluate(&samples.xs_m, &samples.ys_m).unwrap() * &Array1::from(samples.weights.clone());
    let turbulence = VonKarman::new(0.16, 50.0).unwrap();
    let points = samples.weights.len();
    let covariance = Array2::from_shape_fn((points, points), |(p, q)| {
        let r_m = (samples.xs_m[p] - samples.xs_m[q]).hypot(samples.ys_m[p] - samples.ys_m[q]);
        -0.5 * turbulence.structure_nm2(r_m)
    });
    let statistics = modes.dot(&covariance).dot(&modes.t());
    for i in 0..20 {
        // Rounding of a double sum dominated by tip and tilt, 1e3 times the variance of mode 20,
        // and the condition of the influence functions.
        let ratio = statistics[[i, i]] / kl.variances_nm2[i];
        assert!((ratio - 1.0).abs() < 1e-9, "variance of mode {i}: ratio {ratio}");
        for j in 0..i {
            let correlation = statistics[[i, j]] / (statistics[[i, i]] * statistics[[j, j]]).sqrt();
            assert!(correlation.abs() < 1e-9, "modes {i} and {j}: {correlation}");
        }
    }
}

#[test]
fn sixty_modes_contain_most_of_the_variance() {
    let pupil = keck_like(40);
    let kl = keck_kl(&pupil, 60);
    let turbulence = VonKarman::new(0.16, 50.0).unwrap();
    let samples = Samples::from_pupil(&pupil).unwrap();
    let mut total = 0.0;
    for p in 0..samples.weights.len() {
        for q in 0..samples.weights.len() {
            let r_m = (samples.xs_m[p] - samples.xs_m[q]).hypot(samples.ys_m[p] - samples.ys_m[q]);
            total += 0.5 * samples.weights[p] * samples.weights[q] * turbulence.structure_nm2(r_m);
        }
    }
    let contained: f64 = kl.variances_nm2.iter().sum();
    // Noll's residual after 61 modes (with piston) is 0.2944·61^(−√3/2) = 0.0084 (D/r0)^(5/3) of
    // about 0.7 in all for D/L0 = 0.2: 98 to 99 % of the variance, slightly less for a mirror than
    // for free modes.
    assert!((0.97..1.0).contains(&(contained / total)), "{}", contained / total);
}

#[test]
fn nolls_residuals_come_out_of_the_structure_function() {
    // Kolmogorov over a disc: 1.0299, 0.582 and 0.134 (D/r0)^(5/3) rad² without piston, tip, tilt
    // (Noll 1976, table IV).
    let grid = Grid::new(48, 2.0).unwrap();
    let inside = |(y, x): (usize, usize)| f64::from(grid.coordinate_m(x).hypot(grid.coordinate_m(y)) <= 1.0);
    let amplitude = Array2::from_shape_fn((48, 48), inside);
    let pupil = Pupil {
        grid,
        amplitude,
        owner: Array2::zeros((48, 48)),
        segments: vec![Segment { x_m: 0.0, y_m: 0.0, label: 0 }],
    };
    let samples = Samples::from_pupil(&pupil).unwrap();
    let kolmogorov = VonKarman::new(1.0, f64::INFINITY).unwrap();
    let tip_tilt = zernike_basis(2, 3, &pupil).unwrap().evaluate(&samples.xs_m, &samples.ys_m).unwrap();
    let (mut residual, mut tip, mut tilt) = (0.0, 0.0, 0.0);
    for p in 0..samples.weights.len() {
        for q in 0..samples.weights.len() {
            let r_m = (samples.xs_m[p] - samples.xs_m[q]).hypot(samples.ys_m[p] - samples.ys_m[q]);
            let half = 0.5 * samples.weights[p] * samples.weights[q] * kolmogorov.structure_nm2(r_m);
            residual += half;
            tip -= half * tip_tilt[[0, p]] * tip_tilt[[0, q]];
            tilt -= half * tip_tilt[[1, p]] * tip_tilt[[1, q]];
        }
    }
    let rad2 = (2.0 * std::f64::consts::PI / R0_WAVELENGTH_NM).powi(2) / 2f64.powf(5.0 / 3.0);
    for (value, noll) in [(residual, 1.0299), (residual - tip, 0.582), (residual - tip - tilt, 0.134)] {
        // 48 samples a side: the cells' own structure, of order (1/48)^(5/3) = 0.2 %, and a rim of
        // squares, 1 %, weigh on the differences by the ratio 1/0.134 at most.
        assert!((value * rad2 - noll).abs() < 0.01, "{} against {noll}", value * rad2);
    }
}

#[test]
fn exact_modes_come_first_and_the_join_spans_both() {
    let pupil = keck_like(60);
    let exact = zernike_basis(4, 18, &pupil).unwrap();
    let kl = keck_kl(&pupil, 66).basis;
    // The KL modes do not span the Zernike modes, which is the reason for the join.
    let missed = outside(&exact, &kl, &pupil);
    assert!(missed.iter().all(|&rms| rms > 0.01), "{missed:?}");
    let joined = join_exact(&exact, &kl, &pupil, 1e-3).unwrap();
    assert_orthonormal(&joined.basis, &pupil);
    assert_eq!(joined.basis.len() + joined.dropped.len(), 81);
    assert_eq!(joined.basis.names()[..15], exact.names()[..]);
    assert_eq!(joined.basis.names()[15], "kl-00");
    // √(1 − sum) of numbers close to 1 keeps half the digits.
    assert!(outside(&exact, &joined.basis, &pupil).iter().all(|&rms| rms < 1e-6));
    for (rms, name) in outside(&kl, &joined.basis, &pupil).iter().zip(kl.names()) {
        let allowed = if joined.dropped.iter().any(|dropped| &dropped.name == name) { 1e-3 } else { 1e-6 };
        assert!(*rms <= allowed, "{name}: {rms}");
    }
}

#[test]
fn modes_in_the_span_of_others_are_dropped_and_reported() {
    let pupil = keck_like(40);
    let exact = zernike_basis(4, 10, &pupil).unwrap();
    // Noll 1 is piston; 5 is in the span; 2 and 12 are new.
    let other = SmoothBasis::zernike(Zernikes::new([1, 2, 5, 12], 5.5).unwrap());
    let other = orthonormalise(&other, &pupil, 1e-3).unwrap();
    assert_eq!(other.dropped.len(), 1);
    assert_eq!(other.dropped[0].name, "noll-1");
    let other = SmoothBasis::zernike(Zernikes::new([4, 12], 5.5).unwrap());
    let tilts = zernike_basis(2, 3, &pupil).unwrap();
    let joined = join_exact(&tilts.followed_by(&exact), &other, &pupil, 1e-3).unwrap();
    assert_eq!(joined.dropped.len(), 1);
    assert_eq!(joined.dropped[0].name, "noll-4");
    // The Gram matrix determines a remainder to √ε.
    assert!(joined.dropped[0].remainder < 1e-6);
    assert_eq!(joined.basis.names().last().unwrap(), "noll-12");
    assert!(join_exact(&exact, &other, &pupil, 0.0).is_err());
}

#[test]
fn segment_modes_follow_the_owner_map() {
    let pupil = keck_like(60);
    let basis = SegmentModes::PistonTipTilt.maps(&pupil).unwrap();
    assert_eq!(basis.len(), 108);
    assert_eq!(basis.names()[0], "segment-00-piston");
    assert_eq!(basis.names()[36], "segment-00-tip");
    assert_eq!(basis.names()[107], "segment-35-tilt");
    assert!(basis.groups().iter().all(|&group| group == Group::Segment));
    let maps = basis.maps();
    for mode in 0..108 {
        let (segment, map) = (mode % 36, maps.index_axis(Axis(0), mode));
        let (mut light, mut mean, mut square) = (0.0, 0.0, 0.0);
        for (index, &value) in map.indexed_iter() {
            if pupil.owner[index] != segment as i32 {
                assert_eq!(value, 0.0);
            } else {
                light += pupil.amplitude[index];
                mean += pupil.amplitude[index] * value;
                square += pupil.amplitude[index] * value * value;
            }
        }
        // Some 70 samples a segment: rounding of such sums.
        let expected = if mode < 36 { 1.0 } else { 0.0 };
        assert!((mean / light - expected).abs() < 1e-13 && (square / light - 1.0).abs() < 1e-13, "mode {mode}");
    }
    // Tip grows along +x, tilt along +y.
    let centre = |mode: usize, dx: f64, dy: f64| {
        let at = |v: f64| ((v / pupil.grid.pitch_m()) + 29.5).round() as usize;
        maps[[mode, at(pupil.segments[0].y_m + dy), at(pupil.segments[0].x_m + dx)]]
    };
    assert!(centre(36, 0.5, 0.0) > 0.5 && centre(36, -0.5, 0.0) < -0.5);
    assert!(centre(72, 0.0, 0.5) > 0.5 && centre(72, 0.0, -0.5) < -0.5);
}

#[test]
fn joint_basis_report_names_global_piston_and_tilts() {
    let pupil = keck_like(60);
    let kl = keck_kl(&pupil, 66).basis.sampled(&pupil).unwrap();
    let joint = SegmentModes::Piston.maps(&pupil).unwrap().followed_by(kl).unwrap();
    let gram = joint.visible_gram(&pupil.amplitude).unwrap();
    let report = Degeneracy::from_matrix(&gram, joint.names(), WEAK_BELOW).unwrap();
    assert_eq!(report.null.len(), 1, "{report}");
    assert_facts(&report.null[0].description, "36 segment pistons | global piston");
    // An independent program found singular values of 1.41 … 0.10 for such a basis. The bound is
    // √(1 + 36/35): a mode shared by both spaces, where equal pistons without their mean correlate
    // by −1/35.
    let (first, last) = (report.singular_values[0], report.singular_values[100]);
    assert!((1.40..1.4244).contains(&first) && (0.08..0.12).contains(&last), "{first} … {last}");
    // The weak directions are tip and tilt, which both spaces contain.
    assert!(report.weak.len() >= 2);
    assert!(report.to_string().lines().count() == 2 + report.weak.len(), "{report}");
}

#[test]
fn bases_from_files_are_checked() {
    let cube = |modes| Array3::<f64>::ones((modes, 4, 4));
    let names = |names: &[&str]| names.iter().map(|&name| name.to_owned()).collect::<Vec<_>>();
    let basis = Basis::from_cube(names(&["a ", "b"]), vec![Group::Segment, Group::Ncpa], cube(2)).unwrap();
    assert_eq!(basis.names(), ["a", "b"]);
    assert!(Basis::from_cube(names(&["a"]), vec![Group::Ncpa; 2], cube(2)).is_err());
    assert!(Basis::from_cube(names(&["a", "a"]), vec![Group::Ncpa; 2], cube(2)).is_err());
    assert!(Basis::from_cube(names(&["a", " "]), vec![Group::Ncpa; 2], cube(2)).is_err());
    assert!(Basis::from_cube(names(&["a"]), vec![Group::Ncpa], Array3::ones((1, 4, 5))).is_err());
    let mut broken = cube(1);
    broken[[0, 1, 2]] = f64::NAN;
    let message = Basis::from_cube(names(&["a"]), vec![Group::Ncpa], broken).unwrap_err().to_string();
    assert!(message.contains("[1, 2]") && message.contains("NaN"), "{message}");
    assert!(basis.clone().followed_by(basis.clone()).is_err());
    assert!(basis.visible_gram(&Array2::ones((5, 5))).is_err());
    assert!(basis.visible_gram(&Array2::zeros((4, 4))).is_err());
    assert_eq!(Group::parse(" ncpa  ").unwrap(), Group::Ncpa);
    assert!(Group::parse("both").is_err());
}

#[test]
#[ignore = "merge: 9 s"]
fn the_largest_number_of_modes_is_limited_by_the_samples() {
    let turbulence = VonKarman::new(0.16, 50.0).unwrap();
    let all = |samples: usize, most: usize| {
        let pupil = keck_like(samples);
        let actuators = keck_mirror().near(&pupil, Mirror::DEFAULT_MARGIN_PITCHES).unwrap();
        let kl = karhunen_loeve_at_most(&actuators, &pupil, &turbulence, most).unwrap();
        (kl, pupil, actuators)
    };
    let (few, pupil, actuators) = all(40, 12);
    let exact = karhunen_loeve(&actuators, &pupil, &turbulence, 12).unwrap();
    assert_eq!((few.basis.matrix(), &few.variances_nm2), (exact.basis.matrix(), &exact.variances_nm2));
    let whole = karhunen_loeve_complete(&actuators, &pupil, &turbulence).unwrap();
    assert_eq!(all(40, 10_000).0.basis.len(), whole.basis.len());
    // One sample per pitch: some modes differ only between the samples. The request for all modes
    // is an error; the request for at most all gives the resolved modes, with as many variances.
    let (coarse, pupil, actuators) = all(20, 10_000);
    assert!(karhunen_loeve_complete(&actuators, &pupil, &turbulence).is_err());
    assert!((100..whole.basis.len()).contains(&coarse.basis.len()), "{}", coarse.basis.len());
    assert_eq!(coarse.basis.len(), coarse.variances_nm2.len());
}

#[test]
fn impossible_requests_are_refused_with_a_sentence() {
    let pupil = keck_like(40);
    let turbulence = VonKarman::new(0.16, 50.0).unwrap();
    let actuators = keck_mirror().near(&pupil, Mirror::DEFAULT_MARGIN_PITCHES).unwrap();
    assert!(karhunen_loeve(&actuators, &pupil, &turbulence, 0).is_err());
    let message = karhunen_loeve(&actuators, &pupil, &turbulence, 1000).unwrap_err().to_string();
    assert!(message.contains("1000") && message.contains("1 to "), "{message}");
    assert!(keck_mirror().near(&pupil, f64::NAN).is_err());
    assert!(zernike_basis(1, 5, &pupil).is_err() && zernike_basis(5, 4, &pupil).is_err());
    assert!(zernike_basis(2, 1_000_000, &pupil).is_err());
    // More polynomials than samples are not independent.
    let tiny = Pupil {
        grid: Grid::new(3, 1.0).unwrap(),
        amplitude: Array2::ones((3, 3)),
        owner: Array2::zeros((3, 3)),
        segments: vec![],
    };
    assert!(zernike_basis(2, 21, &tiny).is_err());
    assert!(SegmentModes::Piston.maps(&tiny).is_err());
    let mut dark = tiny.clone();
    dark.amplitude.fill(0.0);
    assert!(zernike_basis(2, 4, &dark).is_err());
    dark.amplitude[[1, 1]] = f64::NAN;
    assert!(zernike_basis(2, 4, &dark).is_err());
    let mut misfit = tiny.clone();
    misfit.amplitude = Array2::ones((4, 3));
    assert!(zernike_basis(2, 4, &misfit).is_err() && karhunen_loeve(&actuators, &misfit, &turbulence, 2).is_err());
    // One illuminated sample: only piston.
    let mut point = tiny;
    point.amplitude.fill(0.0);
    point.amplitude[[1, 1]] = 1.0;
    assert!(zernike_basis(2, 4, &point).is_err());
    assert!(karhunen_loeve(&actuators, &point, &turbulence, 2).is_err());
}
