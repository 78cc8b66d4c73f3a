//! Power spectra of known wavefronts.

use super::{keck, map};
use cophase::modes::VonKarman;
use cophase::pupil::{Grid, Pupil};
use cophase_numerics::fft::{FftDirection, FftReal};
use cophase_paper::experiment::metrics::{LARGEST_PADDING, Psd, PsdAverage, control_half_width_per_m};
use ndarray::{Array2, s};
use num_complex::Complex64;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::PI;

fn random() -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(11)
}

/// Fraction of the variance within the box |fx|, |fy| ≤ `half_width_per_m`.
fn fraction_within(psd: &Psd, half_width_per_m: f64) -> f64 {
    psd.variance_within_nm2(half_width_per_m).unwrap() / psd.variance_nm2()
}

fn noise(side: usize, random: &mut ChaCha8Rng) -> Array2<f64> {
    Array2::from_shape_simple_fn((side, side), || StandardNormal.sample(random))
}

/// Pupil that fills the grid: a window without edges for waves that are periodic over the grid.
fn full_square(samples: usize, width_m: f64) -> Pupil {
    Pupil::from_maps(Grid::new(samples, width_m).unwrap(), Array2::ones((samples, samples)), None).unwrap()
}

fn spectrum(pupil: &Pupil, padding: usize, maps: &[Array2<f64>]) -> Psd {
    let mut average = PsdAverage::new(pupil, padding).unwrap();
    maps.iter().for_each(|map| average.add(map.view()).unwrap());
    average.mean().unwrap()
}

/// `amplitude_nm`·cos with `ky`, `kx` periods over the grid and a phase of 0.7 rad.
fn sine(pupil: &Pupil, amplitude_nm: f64, [ky, kx]: [f64; 2]) -> Array2<f64> {
    let width = pupil.grid.width_m();
    map(pupil, |x, y| amplitude_nm * (2.0 * PI * (kx * x + ky * y) / width + 0.7).cos())
}

#[test]
fn the_integral_is_the_variance_over_the_pupil_exactly() {
    let pupil = keck();
    let mut random = random();
    for (padding, maps) in [(1, 1), (1, 2), (2, 3)] {
        let maps: Vec<_> = (0..maps).map(|_| noise(240, &mut random) * 80.0 + 1e3).collect();
        let variance = |map: &Array2<f64>| {
            pupil.rms(pupil.remove_piston(map.view()).unwrap().view()).unwrap().powi(2) / maps.len() as f64
        };
        let expected: f64 = maps.iter().map(variance).sum();
        let psd = spectrum(&pupil, padding, &maps);
        // Parseval on 57600 samples and as many frequencies; the mean of 1000 nm rounds to 1e-13
        // nm.
        assert!((psd.variance_nm2() / expected - 1.0).abs() < 1e-13, "{padding} {}", maps.len());
        assert!((psd.step_per_m() * pupil.grid.width_m() * padding as f64 - 1.0).abs() < 1e-15);
    }
}

#[test]
fn the_average_of_pairs_equals_the_average_of_single_maps() {
    let (pupil, mut random) = (full_square(15, 3.0), random());
    let maps: Vec<_> = (0..5).map(|_| noise(15, &mut random)).collect();
    let single: Vec<Psd> = maps.iter().map(|map| spectrum(&pupil, 2, std::slice::from_ref(map))).collect();
    for count in 1..=5 {
        let together = spectrum(&pupil, 2, &maps[..count]);
        let sum = single[..count].iter().fold(Array2::<f64>::zeros((30, 30)), |sum, psd| sum + psd.density_nm2_m2());
        let difference: Array2<f64> = together.density_nm2_m2() - sum / count as f64;
        let worst = difference.iter().fold(0.0f64, |worst, d| worst.max(d.abs()));
        // Densities here are about pitch² = 0.04; the transforms have errors of a few 1e-16.
        assert!(worst < 1e-16, "{count}: {worst:.1e}");
    }
}

#[test]
fn average_is_unchanged_by_reading_and_exact_for_f32_maps() {
    let (pupil, mut random) = (full_square(16, 2.0), random());
    let maps: Vec<Array2<f32>> = (0..4).map(|_| noise(16, &mut random).mapv(|value| value as f32)).collect();
    let (mut read, mut unread) = (PsdAverage::new(&pupil, 1).unwrap(), PsdAverage::new(&pupil, 1).unwrap());
    for (index, map) in maps.iter().enumerate() {
        read.add(map.view()).unwrap();
        read.mean().unwrap();
        unread.add(map.mapv(f64::from).view()).unwrap();
        assert_eq!(read.maps(), index + 1);
    }
    assert_eq!(read.mean().unwrap().density_nm2_m2(), unread.mean().unwrap().density_nm2_m2());
}

#[test]
fn a_sine_has_two_lines_of_half_its_variance_each() {
    for samples in [24, 25] {
        let pupil = full_square(samples, 6.0);
        let map = sine(&pupil, 30.0, [-3.0, 5.0]);
        let psd = spectrum(&pupil, 1, &[map]);
        let axis = samples / 2;
        for ((y, x), density) in psd.density_nm2_m2().indexed_iter() {
            let on_line = [(axis - 3, axis + 5), (axis + 3, axis - 5)].contains(&(y, x));
            let expected = if on_line { 30.0f64.powi(2) / 4.0 / psd.step_per_m().powi(2) } else { 0.0 };
            // Lines of 8100 nm²·m², rounding in the last two or three digits; elsewhere that
            // squared, 1e-26.
            assert!((density - expected).abs() < 1e-10, "{y} {x}: {density}");
        }
        assert!((psd.frequency_per_m(axis + 5) - 5.0 / 6.0).abs() < 1e-15 && psd.frequency_per_m(axis) == 0.0);
    }
}

#[test]
fn a_sine_over_the_segmented_pupil_peaks_at_its_frequency() {
    let pupil = keck();
    for padding in [1, 2] {
        let psd = spectrum(&pupil, padding, &[sine(&pupil, 50.0, [7.0, -12.0])]);
        let axis = 240 * padding / 2;
        let top = psd.density_nm2_m2().indexed_iter().max_by(|a, b| a.1.total_cmp(b.1)).unwrap();
        let lines = [(axis + 7 * padding, axis - 12 * padding), (axis - 7 * padding, axis + 12 * padding)];
        assert!(lines.contains(&top.0), "{:?}", top.0);
        // The peak of the window's own transform: (Σ A)²/Σ A samples, of pitch² each.
        let expected = 50.0f64.powi(2) / 4.0 * pupil.weight_sum() * pupil.grid.pitch_m().powi(2);
        // The wing of the other line, 28 steps away, has an amplitude below 1 % of the peak.
        assert!((top.1 / expected - 1.0).abs() < 0.02, "{} {expected}", top.1);
    }
}

#[test]
fn white_noise_is_flat() {
    const MAPS: usize = 200;
    let (pupil, mut random) = (keck(), random());
    let mut average = PsdAverage::new(&pupil, 1).unwrap();
    (0..MAPS).for_each(|_| average.add(noise(240, &mut random).view()).unwrap());
    let psd = average.mean().unwrap();
    let expected = pupil.grid.pitch_m().powi(2);
    let rings = psd.rings();
    assert_eq!((rings.samples.len(), rings.samples[0]), (121, 1));
    // Without the piston of each map the density at frequency 0, and within the pupil's PSF of it,
    // is 0.
    for ring in 4..=120 {
        // Exponentially distributed powers: a ring of n samples has n/2 independent ones per map
        // (±f are equal), and the window, which fills 0.6 of the grid, leaves 0.6 of these
        // independent: 5σ.
        let free = 0.6 * rings.samples[ring] as f64 / 2.0 * MAPS as f64;
        let departure = rings.density_nm2_m2[ring] / expected - 1.0;
        assert!(departure.abs() < 5.0 / free.sqrt(), "ring {ring}: {departure}");
        assert!((rings.frequency_per_m[ring] / psd.step_per_m() - ring as f64).abs() < 0.5);
    }
    // A box of a quarter of the side holds a sixteenth. 57600·0.6/16/2·200 free powers, less the
    // piston's 1/2160 of it.
    let fraction = fraction_within(&psd, psd.step_per_m() * 30.0);
    assert!((fraction * 16.0 - 1.0).abs() < 5.0 / 216_000f64.sqrt() + 1.0 / 1500.0, "{fraction}");
}

/// Draws two independent periodic screens with the spectrum of `turbulence`, `side` samples of
/// `pitch_m`, nm.
fn screens(turbulence: &VonKarman, side: usize, pitch_m: f64, random: &mut ChaCha8Rng) -> [Array2<f64>; 2] {
    let step = 1.0 / (side as f64 * pitch_m);
    let frequency = |k: usize| step * (if 2 * k <= side { k as f64 } else { k as f64 - side as f64 });
    let mut field = Array2::from_shape_fn((side, side), |(y, x)| {
        let density = turbulence.psd_nm2_m2(frequency(y).hypot(frequency(x)));
        let draw = Complex64::new(StandardNormal.sample(random), StandardNormal.sample(random));
        draw * density.sqrt() * step
    });
    let fft = f64::plan(side, FftDirection::Inverse);
    for _ in 0..2 {
        fft.process(field.as_slice_mut().unwrap());
        field = field.t().as_standard_layout().into_owned();
    }
    [field.mapv(|value| value.re), field.mapv(|value| value.im)]
}

#[test]
fn a_taper_recovers_the_spectrum_of_von_karman_turbulence() {
    let (pupil, mut random) = (keck(), random());
    let turbulence = VonKarman::new(0.16, 20.0).unwrap();
    let extent = pupil.grid.width_m();
    // The square of a Hann window over the width of the pupil.
    let taper = map(&pupil, |x, y| (PI * x.hypot(y) / extent).cos().powi(4) * f64::from(2.0 * x.hypot(y) < extent));
    let mut tapered = PsdAverage::with_weights(pupil.grid, taper.view(), 1).unwrap();
    let mut plain = PsdAverage::new(&pupil, 1).unwrap();
    let mut variance = 0.0;
    for _ in 0..6 {
        // 960 samples are 45 m, more than twice the outer scale: 16 neighbouring pupils are nearly
        // independent.
        for screen in screens(&turbulence, 960, pupil.grid.pitch_m(), &mut random) {
            for tile in screen.exact_chunks((240, 240)) {
                tapered.add(tile).unwrap();
                plain.add(tile).unwrap();
                variance += pupil.rms(pupil.remove_piston(tile).unwrap().view()).unwrap().powi(2);
            }
        }
    }
    let maps = plain.maps() as f64;
    let [tapered, plain] = [tapered, plain].map(|average| average.mean().unwrap());
    assert!((plain.variance_nm2() / (variance / maps) - 1.0).abs() < 1e-12);
    // Fraction of the grid's frequencies that the window leaves independent.
    let independent = taper.sum().powi(2) / taper.mapv(|a| a * a).sum() / taper.len() as f64;
    for rings in [8..12, 12..20, 20..40, 40..80, 80..120] {
        let (measured, count) = ratio_to_theory(&tapered, &turbulence, rings.clone());
        let (leaking, _) = ratio_to_theory(&plain, &turbulence, rings.clone());
        println!("rings {rings:?}: {measured:.4} of theory through the taper, {leaking:.2} without");
        // A Hann window broadens by 1/3 of a squared step along each axis: for f^(−11/3) the excess
        // is (1/6)·(11/3)²/ring². In addition 5σ of exponentially distributed powers, ±f being
        // equal.
        let tolerance = 2.3 / (rings.start as f64).powi(2) + 5.0 / (independent * count / 2.0 * maps).sqrt();
        assert!((measured - 1.0).abs() < tolerance, "{measured} {tolerance}");
        // The leakage falls as f^−3, slower than the spectrum.
        assert!(leaking > 2.0 && leaking > measured, "{leaking}");
    }
}

/// Mean ratio of density to theory over rings, and the number of samples of these rings.
fn ratio_to_theory(psd: &Psd, turbulence: &VonKarman, rings: std::ops::Range<usize>) -> (f64, f64) {
    let (mut sum, mut count) = (0.0, 0.0);
    for ((y, x), density) in psd.density_nm2_m2().indexed_iter() {
        let f_per_m = psd.frequency_per_m(y).hypot(psd.frequency_per_m(x));
        if rings.contains(&((f_per_m / psd.step_per_m()).round() as usize)) {
            (sum, count) = (sum + density / turbulence.psd_nm2_m2(f_per_m), count + 1.0);
        }
    }
    (sum / count, count)
}

#[test]
fn the_control_box_weights_steps_by_the_fraction_inside() {
    // The paper's grid: 240 samples over 20 actuator pitches.
    let pupil = full_square(240, 11.25);
    let half_width = control_half_width_per_m(0.5625).unwrap();
    // On the edge of the box (10 periods over the grid), on a corner, inside, outside.
    for (periods, fraction) in [([0.0, 10.0], 0.5), ([10.0, 10.0], 0.25), ([9.0, -9.0], 1.0), ([2.0, 11.0], 0.0)] {
        let psd = spectrum(&pupil, 1, &[sine(&pupil, 20.0, periods)]);
        let within = fraction_within(&psd, half_width);
        // The edge is at 10 steps up to rounding.
        assert!((within - fraction).abs() < 1e-12, "{periods:?}: {within}");
        assert!((psd.variance_nm2() - 200.0).abs() < 1e-10);
        let all = fraction_within(&psd, 120.0 * psd.step_per_m());
        assert!((all - 1.0).abs() < 1e-12, "{all}");
    }
    let alternating = map(&pupil, |x, _| ((x / pupil.grid.pitch_m()).floor() as i64).rem_euclid(2) as f64);
    // The Nyquist frequency of an even grid is its own mirror image, and lies within the largest
    // box.
    let psd = spectrum(&pupil, 1, &[alternating]);
    assert!((fraction_within(&psd, 120.0 * psd.step_per_m()) - 1.0).abs() < 1e-12);
    assert!(fraction_within(&psd, 119.4 * psd.step_per_m()) < 1e-12);
}

#[test]
fn the_ratio_of_spectra_is_the_squared_ratio_of_wavefronts() {
    let (pupil, mut random) = (keck(), random());
    let wavefront = noise(240, &mut random);
    let (before, after) = (spectrum(&pupil, 1, &[&wavefront * 3.0]), spectrum(&pupil, 1, &[wavefront + 40.0]));
    let ratio = before.ratio(&after).unwrap();
    for ((y, x), ratio) in ratio.indexed_iter() {
        if (y, x) == (120, 120) {
            assert!(ratio.is_nan());
            continue;
        }
        // The transforms have errors of about 1e-15 of the largest value; the smallest of 57600
        // exponentially distributed powers is 1e-5 of the mean, its amplitude 3e-3 of it.
        assert!((ratio - 9.0).abs() < 1e-9, "{y} {x}: {ratio}");
    }
    assert!(before.ratio(&spectrum(&pupil, 2, &[Array2::zeros((240, 240))])).is_err());
    assert!(before.ratio(&spectrum(&full_square(240, 5.0), 1, &[Array2::zeros((240, 240))])).is_err());
}

#[test]
fn invalid_maps_weights_and_bands_are_refused_with_the_reason() {
    let pupil = keck();
    let mut average = PsdAverage::new(&pupil, 1).unwrap();
    assert!(average.mean().unwrap_err().to_string().contains("0 maps"));
    let inside = pupil.amplitude.indexed_iter().find(|(_, a)| **a > 0.0).unwrap().0;
    let mut wavefront = Array2::from_elem((240, 240), f32::NAN);
    wavefront.zip_mut_with(&pupil.amplitude, |value, &a| *value = if a > 0.0 { a as f32 } else { f32::NAN });
    average.add(wavefront.view()).unwrap();
    let clean = average.mean().unwrap();
    wavefront[inside] = f32::INFINITY;
    let named = format!("inf at row {}, column {}", inside.0, inside.1);
    assert!(average.add(wavefront.view()).unwrap_err().to_string().contains(&named));
    assert!(average.add(wavefront.slice(s![.., 1..])).unwrap_err().to_string().contains("240x239"));
    assert_eq!(average.maps(), 1);
    assert_eq!(average.mean().unwrap().density_nm2_m2(), clean.density_nm2_m2());

    let weights = |value| Array2::from_elem((240, 240), value);
    for weights in [weights(0.0), weights(-1.0), weights(f64::NAN), weights(f64::MAX), Array2::zeros((0, 240))] {
        assert!(PsdAverage::with_weights(pupil.grid, weights.view(), 1).is_err());
    }
    for padding in [0, LARGEST_PADDING + 1, usize::MAX] {
        assert!(PsdAverage::new(&pupil, padding).err().unwrap().to_string().contains("zero-padding"));
    }
    for pitch in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(control_half_width_per_m(pitch).is_err());
    }
    for half_width in [-1.0, f64::NAN, 11.0] {
        assert!(clean.variance_within_nm2(half_width).unwrap_err().to_string().contains("cycles/m"), "{half_width}");
    }
}
