//! Pupils: exact geometry, maps from files, and the weights of the segments.

use cophase::Error;
use cophase::pupil::Grid;
use cophase::pupil::{Aperture, BandLimit, FinePupil, HexagonalParameters, SegmentWeights};
use ndarray::Array2;
use num_complex::Complex64;
use std::f64::consts::PI;

const KECK_WIDTH_M: f64 = 10.95;

fn grid(samples: usize, width_m: f64) -> Grid {
    Grid::new(samples, width_m).unwrap()
}

fn keck_grid() -> Grid {
    grid(120, KECK_WIDTH_M)
}

/// One hexagon of side 1 m in the centre.
fn single() -> HexagonalParameters {
    HexagonalParameters { rings: 0, segment_side_m: 1.0, central_segment: true, ..HexagonalParameters::keck() }
}

fn hexagon_area(side: f64) -> f64 {
    1.5 * 3f64.sqrt() * side * side
}

// Geometry

#[test]
fn segments_are_numbered_ring_by_ring_and_counter_clockwise() {
    let aperture = Aperture::keck();
    let pitch = 3f64.sqrt() * 0.9 + 0.003;
    assert_eq!(aperture.segments().len(), 36);
    let mut start = 0;
    for ring in 1..=3 {
        let angles: Vec<f64> = aperture.segments()[start..start + 6 * ring]
            .iter()
            .map(|s| s.y_m.atan2(s.x_m).rem_euclid(2.0 * PI).to_degrees())
            .collect();
        assert!(angles.windows(2).all(|pair| pair[0] < pair[1]), "ring {ring}: {angles:?}");
        start += 6 * ring;
    }
    // Vertices on ±x put the first neighbours at 30°, 90°, …; the second ring starts on +x itself.
    for (k, segment) in aperture.segments()[..6].iter().enumerate() {
        let angle = (30.0 + 60.0 * k as f64).to_radians();
        assert!((segment.x_m - pitch * angle.cos()).abs() < 1e-15 && (segment.y_m - pitch * angle.sin()).abs() < 1e-15);
    }
    assert_eq!((aperture.segments()[6].x_m, aperture.segments()[6].y_m), (pitch * 3f64.sqrt() / 2.0 * 2.0, 0.0));
}

#[test]
fn extents_are_those_of_the_outermost_vertices() {
    let aperture = Aperture::hexagonal(&single()).unwrap();
    assert!((aperture.extent_m() - 1.0).abs() < 1e-15);
    assert!((aperture.width_m() - 2.0).abs() < 1e-15);
    // Keck's flat edges at the top lie 3 pitches and an apothem up.
    let top = 3.0 * (3f64.sqrt() * 0.9 + 0.003) + 0.9 * 3f64.sqrt() / 2.0;
    assert!((Aperture::keck().width_m() - 2.0 * top).abs() < 1e-14);
}

#[test]
fn a_stop_and_dark_segments_take_light_away() {
    let stop = HexagonalParameters { stop_diameter_m: 1.0, stop_centre_m: [0.2, -0.1], ..single() };
    let area_m2 = Aperture::hexagonal(&stop).unwrap().segment_areas_m2()[0];
    assert!((area_m2 - 0.25 * std::f64::consts::PI).abs() < 1e-9, "{area_m2}");
    let dark = HexagonalParameters { dark_segments: vec![8, 20], ..HexagonalParameters::keck() };
    let (dark, whole) = (Aperture::hexagonal(&dark).unwrap(), Aperture::keck());
    for (number, (own, before)) in dark.segment_areas_m2().iter().zip(whole.segment_areas_m2()).enumerate() {
        assert_eq!(*own, if [8, 20].contains(&number) { 0.0 } else { before });
    }
    // The numbers of the others and the width stay.
    assert_eq!((dark.segments().len(), dark.width_m()), (36, whole.width_m()));
    let beyond = HexagonalParameters { dark_segments: vec![36], ..HexagonalParameters::keck() };
    assert!(Aperture::hexagonal(&beyond).unwrap_err().to_string().contains("0 to 35"));
}

#[test]
fn a_rotated_mirror_has_a_rotated_spectrum() {
    let shadows = HexagonalParameters {
        obscuration_diameter_m: 1.4,
        spider_width_m: 0.11,
        spider_angles_deg: vec![10.0, 75.0],
        ..HexagonalParameters::keck()
    };
    let own = Aperture::hexagonal(&shadows).unwrap();
    let turned = Aperture::hexagonal(&HexagonalParameters { rotation_deg: 7.0, ..shadows }).unwrap();
    let (sin, cos) = 7f64.to_radians().sin_cos();
    for segment in [0, 5, 17, 35] {
        for (fx, fy) in [(0.1, 0.0), (0.3, -0.2), (-0.7, 1.1)] {
            let there = turned.spectrum_m2(segment, cos * fx - sin * fy, sin * fx + cos * fy).unwrap();
            // The disc is a polygon, whose 256 sides do not turn into each other: a few 1e-5 of its
            // area.
            assert!((there - own.spectrum_m2(segment, fx, fy).unwrap()).norm() < 1e-4, "{segment} {fx} {fy}");
        }
    }
    assert!(
        Aperture::hexagonal(&HexagonalParameters { rotation_deg: f64::NAN, ..HexagonalParameters::keck() }).is_err()
    );
}

#[test]
fn coverage_conserves_each_segments_area() {
    let aperture = Aperture::keck();
    for samples in [37, 120, 960] {
        let grid = grid(samples, KECK_WIDTH_M);
        let weights = SegmentWeights::area(&aperture, &grid).unwrap();
        let mut areas = vec![0.0; 36];
        for (_, segments, shares) in weights.rows() {
            for (&segment, share) in segments.iter().zip(shares) {
                areas[segment as usize] += share * grid.pitch_m().powi(2);
            }
        }
        // Shares of some 600 border cells, each a few roundings of 1 (they are dropped below
        // 1e-12): 1e-11 at most.
        for area in areas {
            assert!((area - hexagon_area(0.9)).abs() < 1e-11, "{samples}: {area}");
        }
        let pupil = aperture.pupil(&grid).unwrap();
        assert!((pupil.weight_sum() * grid.pitch_m().powi(2) - 36.0 * hexagon_area(0.9)).abs() < 4e-10);
        assert!((pupil.segment_areas().iter().sum::<f64>() - 36.0 * hexagon_area(0.9)).abs() < 4e-10);
        assert!(pupil.amplitude.iter().zip(&pupil.owner).all(|(a, owner)| (*a > 0.0) == (*owner >= 0)));
    }
}

#[test]
fn coverage_has_the_mirrors_symmetries() {
    let aperture = Aperture::keck();
    let amplitude = aperture.pupil(&keck_grid()).unwrap().amplitude;
    for ((y, x), a) in amplitude.indexed_iter() {
        // Mirrored cells see mirrored polygons: only roundings differ.
        assert!((a - amplitude[[119 - y, x]]).abs() < 1e-12 && (a - amplitude[[y, 119 - x]]).abs() < 1e-12);
    }
    // A square grid has no 60° symmetry, the spectrum has.
    let total = |fx, fy| (0..36).map(|s| aperture.spectrum_m2(s, fx, fy).unwrap()).sum::<Complex64>();
    let (sin, cos) = (PI / 3.0).sin_cos();
    for (fx, fy) in [(0.1, 0.0), (0.37, -0.21), (1.3, 2.9)] {
        let turned = total(cos * fx - sin * fy, sin * fx + cos * fy);
        // 216 edges, each a few roundings of |e|/|k| ≤ 1.5 m².
        assert!((total(fx, fy) - turned).norm() < 1e-12);
    }
}

/// Fraction of the sub-samples of a cell for which `is_illuminated` is true.
fn sub_sampled(grid: &Grid, y: usize, x: usize, is_illuminated: impl Fn(f64, f64) -> bool) -> f64 {
    let offset = |i: usize| ((i as f64 + 0.5) / 16.0 - 0.5) * grid.pitch_m();
    let point = |i: usize| (grid.coordinate_m(x) + offset(i % 16), grid.coordinate_m(y) + offset(i / 16));
    (0..256).map(point).filter(|&(px, py)| is_illuminated(px, py)).count() as f64 / 256.0
}

#[test]
fn coverage_and_owners_agree_with_sub_samples() {
    let parameters = HexagonalParameters {
        rings: 2,
        central_segment: true,
        gap_m: 0.05,
        obscuration_diameter_m: 1.4,
        spider_width_m: 0.11,
        spider_angles_deg: vec![10.0, 75.0],
        ..HexagonalParameters::keck()
    };
    let aperture = Aperture::hexagonal(&parameters).unwrap();
    let grid = grid(61, 8.2);
    let pupil = aperture.pupil(&grid).unwrap();
    let inside = |x: f64, y: f64, side: f64| {
        let apothem = side * 3f64.sqrt() / 2.0;
        y.abs() < apothem && (0.75f64.sqrt() * x.abs() + 0.5 * y.abs()) < apothem
    };
    let hexagon = |x: f64, y: f64| aperture.segments().iter().position(|s| inside(x - s.x_m, y - s.y_m, 0.9));
    let shadow = |x: f64, y: f64| {
        let arm = |degrees: f64| {
            let (sin, cos) = degrees.to_radians().sin_cos();
            (cos * y - sin * x).abs() < 0.055
        };
        x.hypot(y) < 0.7 || arm(10.0) || arm(75.0)
    };
    let mut squares = 0.0;
    for ((y, x), &amplitude) in pupil.amplitude.indexed_iter() {
        let expected = sub_sampled(&grid, y, x, |x, y| hexagon(x, y).is_some() && !shadow(x, y));
        // An edge along a line of sub-samples is half a line out, 1/32; at most four edges (a gap,
        // an arm) share a cell.
        assert!((amplitude - expected).abs() < 4.0 / 32.0, "row {y}, column {x}: {amplitude} against {expected}");
        squares += (amplitude - expected).powi(2);
        let centre = hexagon(grid.coordinate_m(x), grid.coordinate_m(y));
        if let (Some(centre), true) = (centre, amplitude > 0.0 && pupil.owner[[y, x]] >= 0) {
            assert_eq!(pupil.owner[[y, x]], centre as i32, "row {y}, column {x}");
        }
    }
    // Over all cells the errors are random, below 1/32/√3 on the third of the cells that an edge
    // crosses.
    let rms = (squares / 61.0f64.powi(2)).sqrt();
    assert!(rms < 0.01, "{rms}");
}

#[test]
fn shadows_take_their_exact_area() {
    let whole = hexagon_area(1.0);
    let shadowed = |diameter: f64, width: f64, angles: &[f64]| {
        let parameters = HexagonalParameters {
            obscuration_diameter_m: diameter,
            spider_width_m: width,
            spider_angles_deg: angles.to_vec(),
            ..single()
        };
        let aperture = Aperture::hexagonal(&parameters).unwrap();
        let grid = grid(50, 2.5);
        let on_grid = aperture.pupil(&grid).unwrap().weight_sum() * grid.pitch_m().powi(2);
        let exact = aperture.segment_areas_m2()[0];
        assert!((on_grid - exact).abs() < 1e-11, "{on_grid} against {exact}");
        exact
    };
    assert!((shadowed(1.2, 0.0, &[]) - (whole - PI * 0.36)).abs() < 1e-13);
    // A level arm of half width h leaves out 2·∫₀ʰ (2 − 2t/√3) dt; the same arm named backwards is
    // the same arm.
    let h: f64 = 0.1;
    let arm = 4.0 * h - 2.0 * h * h / 3f64.sqrt();
    assert!((shadowed(0.0, 2.0 * h, &[0.0, 180.0]) - (whole - arm)).abs() < 1e-13);
    // Crossed, an upright arm (2h wide, √3 long) shares the central square.
    let crossed = arm + 2.0 * h * (3f64.sqrt() - 2.0 * h);
    assert!((shadowed(0.0, 2.0 * h, &[0.0, 90.0]) - (whole - crossed)).abs() < 1e-13);
}

#[test]
fn impossible_mirrors_are_refused() {
    let keck = HexagonalParameters::keck();
    let refused = [
        HexagonalParameters { rings: 0, ..keck.clone() },
        HexagonalParameters { rings: 1000, ..keck.clone() },
        HexagonalParameters { segment_side_m: 0.0, ..keck.clone() },
        HexagonalParameters { gap_m: -0.001, ..keck.clone() },
        HexagonalParameters { gap_m: f64::NAN, ..keck.clone() },
        HexagonalParameters { obscuration_diameter_m: 5.5, ..keck.clone() },
        HexagonalParameters { obscuration_diameter_m: f64::INFINITY, ..keck.clone() },
        HexagonalParameters { spider_width_m: 0.1, spider_angles_deg: vec![f64::NAN], ..keck.clone() },
        HexagonalParameters { spider_width_m: 100.0, spider_angles_deg: vec![0.0], ..keck },
    ];
    for parameters in refused {
        assert!(matches!(Aperture::hexagonal(&parameters), Err(Error::Value(_))), "{parameters:?}");
    }
    assert!(Aperture::keck().pupil(&grid(120, 10.9)).unwrap_err().to_string().contains("10.9299"));
    assert!(Aperture::keck().spectrum_m2(36, 0.0, 0.0).is_err());
    // A mirror far smaller than the rounding of the grid's coordinates is not an error.
    let speck = Aperture::hexagonal(&HexagonalParameters { segment_side_m: 1e-30, ..single() }).unwrap();
    assert_eq!(speck.pupil(&grid(10, 10.0)).unwrap().weight_sum(), 0.0);
}

// Weights

/// Focal field of segments with pistons of `phases` and a focus of `waves` RMS over the central 48
/// λ/D, `[v, u]`, m².
fn focal_field(weights: &SegmentWeights, grid: &Grid, phases: &[f64], waves: f64) -> Array2<Complex64> {
    let samples = grid.samples();
    let mut field = Array2::<Complex64>::zeros((samples, samples));
    for (cell, segments, values) in weights.rows() {
        let (y, x) = (grid.coordinate_m(cell / samples), grid.coordinate_m(cell % samples));
        let focus = 3f64.sqrt() * (2.0 * (x * x + y * y) / (KECK_WIDTH_M / 2.0).powi(2) - 1.0);
        let phasors = segments.iter().zip(values).map(|(&s, &w)| Complex64::from_polar(w, phases[s as usize]));
        let sum: Complex64 = phasors.sum();
        field[[cell / samples, cell % samples]] = sum * Complex64::from_polar(1.0, 2.0 * PI * waves * focus);
    }
    let wave = |(u, j): (usize, usize)| Complex64::from_polar(1.0, -2.0 * PI * frequency(u) * grid.coordinate_m(j));
    let waves = Array2::from_shape_fn((97, samples), wave);
    waves.dot(&field).dot(&waves.t()) * grid.pitch_m().powi(2)
}

/// Half a λ/D per pixel, cycles per metre.
fn frequency(pixel: usize) -> f64 {
    (pixel as f64 - 48.0) / 2.0 / KECK_WIDTH_M
}

fn relative_error(field: &Array2<Complex64>, truth: &Array2<Complex64>) -> f64 {
    let norm = |f: &Array2<Complex64>| f.iter().map(|v| v.norm_sqr()).sum::<f64>();
    (norm(&(field - truth)) / norm(truth)).sqrt()
}

/// Pseudo-random pistons, the same on every machine.
fn phases() -> Vec<f64> {
    (0..36).map(|k| f64::from((k * 7919 + 13) % 101) / 101.0 * 2.0 * PI).collect()
}

#[test]
fn hard_weights_are_the_basic_model() {
    let pupil = Aperture::keck().pupil(&keck_grid()).unwrap();
    let weights = SegmentWeights::hard(&pupil);
    assert_eq!(weights.illuminated.len(), pupil.amplitude.iter().filter(|a| **a > 0.0).count());
    for (cell, segments, values) in weights.rows() {
        let at = [cell / 120, cell % 120];
        assert_eq!((segments, values), (&[pupil.owner[at] as u32][..], &[pupil.amplitude[at]][..]));
    }
    assert_eq!(weights.energy, pupil.amplitude.iter().map(|a| a * a).sum::<f64>());
}

#[test]
fn band_limited_weights_carry_the_exact_low_frequencies() {
    let aperture = Aperture::keck();
    // 20 spare samples on every side, so that all ringing is inside: the error is that of the
    // dropped weights.
    let grid = grid(160, KECK_WIDTH_M * 160.0 / 120.0);
    let pass = 50.0 * 160.0 / 120.0;
    let limit = BandLimit { drop_below: 1e-6, ..BandLimit::new(pass, 160).unwrap() };
    let weights = SegmentWeights::band_limited(&aperture, &grid, &limit).unwrap();
    let mut worst = 0f64;
    for segment in [0, 8, 20, 35] {
        let map = weights.map(segment, 160);
        for (fx, fy) in [(0.0, 0.0), (0.3, 1.0), (-pass, 3.7), (17.25, -44.1), (pass, pass), (30.0, 0.0)] {
            let (fx, fy) = (fx / grid.width_m(), fy / grid.width_m());
            let wave = |y, x| {
                let angle = -2.0 * PI * (fx * grid.coordinate_m(x) + fy * grid.coordinate_m(y));
                Complex64::from_polar(grid.pitch_m().powi(2), angle)
            };
            let sampled: Complex64 = map.indexed_iter().map(|((y, x), w)| *w * wave(y, x)).sum();
            let exact = aperture.spectrum_m2(segment, fx, fy).unwrap();
            worst = worst.max((sampled - exact).norm() / hexagon_area(0.9));
        }
    }
    println!("low frequencies: within {worst:.1e} of the peak");
    // Some 5,000 weights below 1e-6 of random sign are dropped around the 253 samples of a segment:
    // 3e-7, and the filter's own ringing is designed for 1e-6.
    assert!(worst < 1e-6, "{worst:e}");
    let total: f64 = weights.weight.iter().sum();
    assert!((total / weights.energy - 1.0).abs() < 1e-6, "{total} against {}", weights.energy);
    assert!((weights.energy * grid.pitch_m().powi(2) - 36.0 * hexagon_area(0.9)).abs() < 1e-10);
}

#[test]
fn focal_field_is_exact_with_band_limited_weights_only() {
    let (aperture, phases) = (Aperture::keck(), phases());
    let fine = grid(960, KECK_WIDTH_M * 1.2);
    let fine_weights = SegmentWeights::band_limited(&aperture, &fine, &BandLimit::new(200.0, 960).unwrap()).unwrap();
    // The fine field is itself compared with the closed form, without grid and filter.
    let exact = Array2::from_shape_fn((97, 97), |(v, u)| {
        let piston = |s: usize| Complex64::from_polar(1.0, phases[s]);
        (0..36).map(|s| aperture.spectrum_m2(s, frequency(u), frequency(v)).unwrap() * piston(s)).sum()
    });
    let reference_error = relative_error(&focal_field(&fine_weights, &fine, &phases, 0.0), &exact);
    assert!(reference_error < 1e-5, "{reference_error:e}");
    let truth = focal_field(&fine_weights, &fine, &phases, 1.5);

    // The limits are the measured errors with a third to spare. 120 samples leave 0.2 of a sample
    // beside Keck, so the ringing beyond the grid is lost; eight more samples of the same pitch
    // keep most of it.
    for (samples, width, pass, limit) in
        [(120, KECK_WIDTH_M, 50.0, 4e-4), (136, KECK_WIDTH_M * 136.0 / 120.0, 56.6, 4e-5)]
    {
        let grid = grid(samples, width);
        let error = |weights: &SegmentWeights| relative_error(&focal_field(weights, &grid, &phases, 1.5), &truth);
        let hard = error(&SegmentWeights::hard(&aperture.pupil(&grid).unwrap()));
        let area = error(&SegmentWeights::area(&aperture, &grid).unwrap());
        let low_pass = BandLimit::new(pass, samples).unwrap();
        let limited = error(&SegmentWeights::band_limited(&aperture, &grid, &low_pass).unwrap());
        println!("{samples} samples: hard {hard:.1e}, area {area:.1e}, band-limited {limited:.1e}");
        assert!(limited < limit, "{samples}: {limited:e}");
        assert!(hard > 1e-2 && area > 5e-3, "the filter must be more accurate than the basic model");
    }
}

#[test]
fn fine_maps_give_the_weights_of_the_geometry() {
    let aperture = Aperture::keck();
    let grid = keck_grid();
    let limit = BandLimit::new(50.0, 120).unwrap();
    let geometric = SegmentWeights::band_limited(&aperture, &grid, &limit).unwrap();
    let total =
        |weights: &SegmentWeights| (0..36).map(|s| weights.map(s, 120)).fold(Array2::zeros((120, 120)), |a, b| a + b);
    let largest = |map: Array2<f64>| map.iter().fold(0f64, |largest, d| largest.max(d.abs()));
    // 8 times as fine, finer by a non-integer factor over another width, and barely fine enough.
    for (samples, width) in [(960, KECK_WIDTH_M), (1111, 11.3), (300, KECK_WIDTH_M)] {
        let pupil = aperture.pupil(&Grid::new(samples, width).unwrap()).unwrap();
        let fine = FinePupil::new(pupil.grid, pupil.amplitude, Some(pupil.owner)).unwrap();
        let weights = SegmentWeights::band_limited_maps(&fine, &grid, &limit).unwrap();
        let sum = largest(total(&weights) - total(&geometric));
        let each = (0..36).map(|s| largest(weights.map(s, 120) - geometric.map(s, 120))).fold(0.0, f64::max);
        println!("{samples} fine samples: the sum within {sum:.1e}, one segment within {each:.1e}");
        // A partially illuminated sample does not define the position of the edge in it: its first
        // moment is wrong by up to 1/8 of a sample squared, and the low pass turns that into weight
        // with a slope of at most 2 per coarse sample.
        let ratio = fine.grid().pitch_m() / grid.pitch_m();
        assert!(sum < 0.25 * ratio * ratio, "{samples}: {sum:e}");
        // A fine sample across a gap goes to one of its two segments: at most half of it is on the
        // wrong side, along the whole edge.
        assert!(each < 0.5 * ratio + 0.25 * ratio * ratio, "{samples}: {each:e}");
    }
    let coarse = aperture.pupil(&Grid::new(200, KECK_WIDTH_M).unwrap()).unwrap();
    let coarse = FinePupil::new(coarse.grid, coarse.amplitude, Some(coarse.owner)).unwrap();
    assert!(matches!(SegmentWeights::band_limited_maps(&coarse, &grid, &limit), Err(Error::Value(_))));
}

#[test]
fn shadows_are_band_limited_like_segments() {
    let parameters = HexagonalParameters {
        obscuration_diameter_m: 0.5,
        spider_width_m: 0.04,
        spider_angles_deg: vec![20.0, 110.0],
        ..single()
    };
    let aperture = Aperture::hexagonal(&parameters).unwrap();
    let grid = grid(60, 3.0);
    let limit = BandLimit::new(24.0, 60).unwrap();
    let geometric = SegmentWeights::band_limited(&aperture, &grid, &limit).unwrap();
    let fine = aperture.pupil(&Grid::new(8 * grid.samples(), grid.width_m()).unwrap()).unwrap();
    let fine = FinePupil::new(fine.grid, fine.amplitude, None).unwrap();
    let maps = SegmentWeights::band_limited_maps(&fine, &grid, &limit).unwrap();
    let worst = (geometric.map(0, 60) - maps.map(0, 60)).iter().fold(0f64, |worst, d| worst.max(d.abs()));
    println!("shadows: within {worst:.1e}");
    // The first moment of a partially illuminated sample, as above; without labels there is no
    // error at borders.
    assert!(worst < 0.25 / 64.0, "{worst:e}");
}

#[test]
fn impossible_band_limits_are_refused() {
    for (pass, samples) in [(0.0, 120), (-1.0, 120), (60.0, 120), (f64::NAN, 120), (f64::INFINITY, 120), (50.0, 0)] {
        assert!(matches!(BandLimit::new(pass, samples), Err(Error::Value(_))), "{pass} {samples}");
    }
    // A nearly abrupt transition is accepted; its ringing only decreases slowly.
    let abrupt = BandLimit::new(59.999, 120).unwrap();
    assert!(SegmentWeights::band_limited(&Aperture::keck(), &keck_grid(), &abrupt).is_ok());
    let good = BandLimit::new(50.0, 120).unwrap();
    for bad in [BandLimit { drop_below: 0.0, ..good }, BandLimit { stop: 130.0, ..good }] {
        assert!(SegmentWeights::band_limited(&Aperture::keck(), &keck_grid(), &bad).is_err(), "{bad:?}");
    }
}

#[test]
fn two_opposite_vanes_are_a_line_and_one_shadows_half_of_it() {
    let with = |angles: &[f64], vanes: &[f64]| {
        let shadows = HexagonalParameters {
            spider_width_m: 0.12,
            spider_angles_deg: angles.to_vec(),
            spider_vanes_deg: vanes.to_vec(),
            ..HexagonalParameters::keck()
        };
        Aperture::hexagonal(&shadows).unwrap()
    };
    let [line, both, one, none] = [with(&[90.0], &[]), with(&[], &[90.0, -90.0]), with(&[], &[90.0]), with(&[], &[])];
    for segment in 0..36 {
        let [of_line, of_both] = [&line, &both].map(|aperture| aperture.spectrum_m2(segment, 0.3, -0.2).unwrap());
        // The pieces are cut along other lines: roundings of their areas.
        assert!((of_line - of_both).norm() < 1e-13, "{segment}");
        let half = if one.segments()[segment].y_m > 0.0 { &line } else { &none };
        let (found, wanted) = (one.segment_areas_m2()[segment], half.segment_areas_m2()[segment]);
        // A segment on the x axis would be in both halves; the vane along y meets none.
        assert!((found - wanted).abs() < 1e-13, "{segment}: {found} {wanted}");
    }
    assert!(one.segment_areas_m2().iter().sum::<f64>() < none.segment_areas_m2().iter().sum::<f64>() - 0.5);
}
