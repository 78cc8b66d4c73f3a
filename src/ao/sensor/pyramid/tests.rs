//! The pyramid against its definition in double precision, and against the published theory of the
//! sensor.

use super::super::{GuideStar, Sensor};
use super::*;
use crate::grid::Grid;
use crate::pupil::Pupil;
use crate::scene::Scene;
use crate::telescope::Telescope;
use num_complex::Complex64;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::{PI, TAU};

/// Width of the grid and of the round pupil, m.
const WIDTH_M: f64 = 11.25;
const SENSOR: &str = "[wavefront_sensor]\nkind = \"pyramid\"\nwavelength_nm = 1000.0\n";

struct Bench {
    scene: SensorScene,
    pupil: Pupil,
    footprint: Footprint,
    pixels: Lenslets,
}

impl Bench {
    /// A sensor of `keys` behind a round pupil as wide as the grid.
    fn new(keys: &str) -> Self {
        let onsky = Scene::preset("keck-artificial").unwrap();
        let text = format!("{}\n{SENSOR}{keys}", onsky.text());
        let scene = Scene::from_text(&text, "".as_ref()).unwrap();
        let telescope = Telescope::new(&scene).unwrap();
        let sensing = scene.wavefront_sensor.clone().unwrap();
        let grid = Grid::new(sensing.lenslets_across * sensing.samples_per_lenslet, WIDTH_M).unwrap();
        let mut pupil = telescope.pupil_on(grid).unwrap();
        for ((y, x), amplitude) in pupil.amplitude.indexed_iter_mut() {
            *amplitude = f64::from(u8::from(grid.coordinate_m(x).hypot(grid.coordinate_m(y)) < WIDTH_M / 2.0));
        }
        let footprint = Footprint::new(&pupil);
        let pixels = Lenslets::new(&sensing, &pupil, scene.directory()).unwrap();
        Self { scene: sensing, pupil, footprint, pixels }
    }

    fn pyramid(&self) -> Pyramid {
        Pyramid::new(&self.scene, &self.pixels, &self.footprint)
    }

    /// Map of a wavefront in radians of phase, over coordinates in units of the grid's width.
    fn map(&self, mut phase: impl FnMut(f64, f64) -> f64) -> Vec<f32> {
        let (grid, mut map) = (self.pupil.grid, self.footprint.zeros().to_vec());
        for (y, row) in map.chunks_exact_mut(self.footprint.stride()).enumerate() {
            for (x, out) in row.iter_mut().take(grid.samples()).enumerate() {
                let at = [x, y].map(|i| grid.coordinate_m(i) / grid.width_m());
                *out = (phase(at[0], at[1]) * self.scene.wavelength_nm / TAU) as f32;
            }
        }
        map
    }

    /// Slopes without a unit of a phase, less those of a flat wavefront: x, then y.
    fn slopes(&self, pyramid: &mut Pyramid, phase: impl FnMut(f64, f64) -> f64) -> Vec<f64> {
        let [mut seen, mut flat] = [(); 2].map(|()| vec![0.0; 2 * self.pixels.subapertures.len()]);
        pyramid.raw_slopes(&self.map(phase), None, &mut seen);
        pyramid.raw_slopes(&self.footprint.zeros(), None, &mut flat);
        seen.iter().zip(&flat).map(|(seen, flat)| f64::from(seen - flat)).collect()
    }

    /// Part of the pixels' light that the last frame of `pyramid` has in the four images; the rest
    /// is diffracted beside them. Theory divides differences by all light.
    fn light(&self, pyramid: &Pyramid) -> f64 {
        let seen: f64 = pyramid.signals.iter().map(|[sum, ..]| sum).sum();
        seen / self.pixels.light.iter().sum::<f64>()
    }
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// Field of the frequencies of one side of an edge at −m: `[x][x']`, by the midpoint rule over the
/// focal plane.
fn side(m: f64, is_above: bool, n: usize) -> Vec<Vec<Complex64>> {
    let (from, to) = if is_above { (-m, n as f64 / 2.0) } else { (-(n as f64) / 2.0, -m) };
    let cells = 200 * n;
    let width = (to - from) / cells as f64;
    let of_distance = |d: i64| -> Complex64 {
        let wave =
            |cell| Complex64::from_polar(width, TAU * (from + (cell as f64 + 0.5) * width) * d as f64 / n as f64);
        (0..cells).map(wave).sum::<Complex64>() / n as f64
    };
    let table: Vec<Complex64> = (1 - n as i64..n as i64).map(of_distance).collect();
    (0..n).map(|x| (0..n).map(|s| table[x + n - 1 - s]).collect()).collect()
}

/// Intensities of the four faces over the pupil, in the order of [`FACES`], summed over the
/// modulation, from the definition.
fn definition(field: &[Vec<Complex64>], points: &[[f64; 2]]) -> [Vec<Vec<f64>>; 4] {
    let n = field.len();
    let mut sums = [(); 4].map(|()| vec![vec![0.0; n]; n]);
    for [mx, my] in points {
        for ([sx, sy], sum) in FACES.iter().zip(&mut sums) {
            let (across, along) = (side(*mx, *sx > 0.0, n), side(*my, *sy > 0.0, n));
            let half: Vec<Vec<Complex64>> = field
                .iter()
                .map(|row| across.iter().map(|kernel| kernel.iter().zip(row).map(|(k, e)| k * e).sum()).collect())
                .collect();
            for (y, x) in (0..n * n).map(|i| (i / n, i % n)) {
                sum[y][x] += (0..n).map(|s| along[y][s] * half[s][x]).sum::<Complex64>().norm_sqr();
            }
        }
    }
    sums
}

#[test]
fn the_light_is_that_of_the_definition_in_double_precision() {
    for (radius, points) in [(0.0, 1), (1.5, 8), (3.0, 20)] {
        let bench = Bench::new(&format!(
            "pixels_across = 6\nsamples_per_pixel = 4\nmodulation_lambda_over_d = {radius}\nmodulation_points = {}\n",
            points.max(4)
        ));
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let map = bench.map(|_, _| normal(&mut rng));
        let n = bench.footprint.samples();
        let field: Vec<Vec<Complex64>> = (0..n)
            .map(|y| {
                let value = |x| {
                    let place = y * bench.footprint.stride() + x;
                    let phase = f64::from(map[place]) * TAU / bench.scene.wavelength_nm;
                    Complex64::from_polar(f64::from(bench.footprint.amplitude()[place]), phase)
                };
                (0..n).map(value).collect()
            })
            .collect();
        let circle: Vec<[f64; 2]> = (0..points)
            .map(|j| TAU * (j as f64 + 0.5) / points as f64)
            .map(|angle| [radius * angle.cos(), radius * angle.sin()])
            .collect();
        let expected = definition(&field, &circle);
        let mut pyramid = bench.pyramid();
        pyramid.optics.propagate(&map);
        let mut worst = 0f64;
        for place in &bench.pixels.subapertures {
            let (top, left) = (place / 6 * 4, place % 6 * 4);
            for (y, x) in (0..16).map(|i| (top + i / 4, left + i % 4)) {
                let [t, sx, sy, z] = pyramid.optics.sums_at(y, x).map(f64::from);
                for ([along_x, along_y], sum) in FACES.iter().zip(&expected) {
                    let found = (t + 2.0 * (along_x * sx + along_y * sy + along_x * along_y * z)) / 16.0;
                    worst = worst.max((found - sum[y][x]).abs() / points as f64);
                }
            }
        }
        println!("radius {radius}: {worst:.1e} of the light of a sample");
        // The quadrature of a strip has an error of 1e-4 of 2·0.5 λ/D between opposite edges, for
        // few pairs of samples; single precision some hundred roundings of 1e-7.
        assert!(worst < 1e-4, "{radius}: {worst}");
    }
}

#[test]
fn twice_the_points_have_the_same_slopes() {
    let [default, twice] = [28, 56].map(|points| {
        let bench = Bench::new(&format!("pixels_across = 10\nsamples_per_pixel = 4\nmodulation_points = {points}\n"));
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        bench.slopes(&mut bench.pyramid(), |_, _| 0.5 * normal(&mut rng))
    });
    let rms = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>().sqrt();
    let ratio = rms(&mut default.iter().zip(&twice).map(|(a, b)| a - b)) / rms(&mut twice.iter().copied());
    println!("{ratio:.1e}");
    // J_28(6π) is 1e-3, and only pairs at opposite edges of the pupil have it.
    assert!(ratio < 1e-3, "{ratio}");
}

#[test]
fn tilt_signal_is_an_arcsine_that_saturates_at_the_modulation() {
    // Ragazzoni 1996; Vérinaud 2004, section 3: the spot is on one side of the edge for a part of
    // its circle, s = (2/π) asin(α/r).
    for radius in [3.0, 5.0] {
        let bench =
            Bench::new(&format!("pixels_across = 10\nsamples_per_pixel = 6\nmodulation_lambda_over_d = {radius}\n"));
        let (mut pyramid, count) = (bench.pyramid(), bench.pixels.subapertures.len());
        let mean = |slopes: &[f64]| slopes[..count].iter().sum::<f64>() / count as f64;
        for share in [0.1, 0.3, 0.5, 0.7] {
            let found = mean(&bench.slopes(&mut pyramid, |x, _| TAU * share * radius * x)) * bench.light(&pyramid);
            let expected = 2.0 / PI * f64::asin(share);
            println!("{radius} {share}: {found:.4} {expected:.4}");
            // The spot's wings, 1/(π²·distance in λ/D) of the light on one side of an edge, weaken
            // it by some percent.
            assert!((found / expected - 1.0).abs() < 0.1, "{radius} {share}: {found} {expected}");
        }
        let saturated = mean(&bench.slopes(&mut pyramid, |x, _| TAU * 2.0 * radius * x));
        assert!((0.9..1.01).contains(&saturated), "{radius}: {saturated}");
    }
}

#[test]
fn sensitivity_grows_with_frequency_up_to_the_modulation() {
    // Vérinaud 2004, eq. 28 and figure 4: an edge between the spot and the speckle of a wave of f
    // cycles is there for the part of the circle on which |mx| < f: (2/π) asin(f/r) below the
    // modulation, 1 above.
    let radius = 4.0;
    let bench =
        Bench::new(&format!("pixels_across = 32\nsamples_per_pixel = 4\nmodulation_lambda_over_d = {radius}\n"));
    let mut pyramid = bench.pyramid();
    let count = bench.pixels.subapertures.len();
    let centres: Vec<f64> = bench.pixels.subapertures.iter().map(|place| ((place % 32) as f64 - 15.5) / 32.0).collect();
    let mut sensitivity = |cycles: f64| {
        let slopes = bench.slopes(&mut pyramid, |x, _| 0.02 * (TAU * cycles * x).cos());
        let part = |wave: fn(f64) -> f64| {
            slopes[..count].iter().zip(&centres).map(|(s, x)| s * wave(TAU * cycles * x)).sum::<f64>()
        };
        // A pixel averages over its width.
        let blur = (PI * cycles / 32.0).sin() / (PI * cycles / 32.0);
        2.0 * part(f64::cos).hypot(part(f64::sin)) / count as f64 / 0.02 / blur * bench.light(&pyramid)
    };
    for cycles in [1.0, 2.0, 3.0, 6.0, 8.0, 10.0] {
        let found = sensitivity(cycles);
        let expected = if cycles < radius { 2.0 / PI * f64::asin(cycles / radius) } else { 1.0 };
        println!("{cycles}: {found:.3} {expected:.3}");
        // Speckles have wings as the spot of a tilt has: some percent.
        assert!((found / expected - 1.0).abs() < 0.12, "{cycles}: {found} {expected}");
    }
}

#[test]
fn a_piston_between_halves_has_the_sine_of_its_phase() {
    // Esposito et al. 2005, Opt. Lett. 30, 2572: the signal at the edge of a segment is
    // proportional to sin φ.
    for radius in [0.0, 3.0] {
        let bench =
            Bench::new(&format!("pixels_across = 10\nsamples_per_pixel = 4\nmodulation_lambda_over_d = {radius}\n"));
        let mut pyramid = bench.pyramid();
        // Differences before they are divided by the light in the images, which depends on φ
        // without a modulation.
        let mut at = |phase: f64| {
            let seen = bench.map(|x, _| if x > 0.0 { phase } else { 0.0 });
            let mut slopes = vec![0.0; 2 * bench.pixels.subapertures.len()];
            pyramid.raw_slopes(&seen, None, &mut slopes);
            pyramid.signals.iter().map(|[_, x, _]| *x).collect::<Vec<f64>>()
        };
        let quarter = at(PI / 2.0);
        let largest = quarter.iter().fold(0f64, |largest, s| largest.max(s.abs()));
        assert!(largest > 0.1, "{largest}");
        for phase in [0.2, 1.0, 2.5, 3.1, 4.5, 6.0] {
            for (found, quarter) in at(phase).iter().zip(&quarter) {
                // Exact but for the quadrature's 1e-4: an intensity is of second order in the
                // field, so that only 1, cos φ and sin φ occur, and a conjugated field has the
                // opposite signal.
                assert!((found - phase.sin() * quarter).abs() < 1e-3 * largest, "{radius} {phase}: {found} {quarter}");
            }
        }
    }
}

#[test]
fn photon_noise_of_a_slope_is_one_over_root_electrons() {
    // Vérinaud 2004, eq. 33: var s = 1/N with N the photons in the four pixels; read noise adds 4
    // e²/N².
    for normalisation in ["global", "pixel"] {
        for (read_e, magnitude) in [(0.0, 5.0), (20.0, 9.0)] {
            let bench = Bench::new(&format!(
                "pixels_across = 10\nsamples_per_pixel = 4\nslope_normalisation = \"{normalisation}\"\nread_noise_e = {read_e}\nstar_magnitude_r = {magnitude}\n"
            ));
            let (mut pyramid, count) = (bench.pyramid(), bench.pixels.subapertures.len());
            let mut light = GuideStar::new(&bench.scene, 0.8, 1e-3, ChaCha8Rng::seed_from_u64(1));
            let [mut slopes, mut flat] = [(); 2].map(|()| vec![0.0; 2 * count]);
            let map = bench.footprint.zeros();
            pyramid.raw_slopes(&map, None, &mut flat);
            let signals = pyramid.signals.clone();
            let mean_e = light.electrons * signals.iter().map(|[sum, ..]| sum).sum::<f64>() / count as f64;
            let (mut square, mut expected) = (0.0, 0.0);
            for _ in 0..60 {
                pyramid.raw_slopes(&map, Some(&mut light), &mut slopes);
                for (i, (found, flat)) in slopes.iter().zip(&flat).enumerate() {
                    let e = light.electrons * signals[i % count][0];
                    let over = if normalisation == "global" { mean_e } else { e };
                    square += f64::from(found - flat).powi(2);
                    expected += (e + 4.0 * read_e * read_e) / (over * over);
                }
            }
            let ratio = (square / expected).sqrt();
            println!("{normalisation} {read_e}: {ratio:.3}");
            // 60 frames of 150 slopes: 0.7 %; "pixel" also divides by a noisy sum, which is of
            // second order.
            assert!((ratio - 1.0).abs() < 0.03, "{normalisation} {read_e}: {ratio}");
        }
    }
}

#[test]
fn optical_gain_of_uncorrelated_phases_is_their_strehl_ratio() {
    // An intensity is a sum of products of the field at two points, and the mean of such a product
    // falls by exp(−D/2), D the structure function (Fauvarque et al. 2019, arXiv:1902.05440;
    // Chambouleyron et al. 2020, A&A 644, A6). Phases without correlation have D = 2σ² between all
    // pairs, so that every mode has the gain exp(−σ²).
    let bench = Bench::new("pixels_across = 10\nsamples_per_pixel = 6\n");
    let mut pyramid = bench.pyramid();
    let mode = |x: f64, y: f64| 0.1 * (TAU * (2.0 * x + y)).sin();
    let calibrated = bench.slopes(&mut pyramid, mode);
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    for sigma in [0.3, 0.6, 1.0] {
        let mut gain = 0.0;
        let draws = 40;
        for _ in 0..draws {
            let residual: Vec<f64> = (0..60 * 60).map(|_| sigma * normal(&mut rng)).collect();
            let at = |x: f64, y: f64| residual[((y + 0.5) * 60.0) as usize * 60 + ((x + 0.5) * 60.0) as usize];
            // Push and pull: the slopes of the residual itself cancel.
            let [push, pull] = [1.0, -1.0].map(|sign| bench.slopes(&mut pyramid, |x, y| sign * mode(x, y) + at(x, y)));
            let along = |slopes: &[f64]| slopes.iter().zip(&calibrated).map(|(s, c)| s * c).sum::<f64>();
            gain += (along(&push) - along(&pull)) / 2.0 / along(&calibrated) / f64::from(draws);
        }
        let expected = (-sigma * sigma).exp();
        println!("{sigma}: {gain:.4} {expected:.4}");
        // The mean over 2,800 samples and 40 draws is known to some percent of the gain's
        // complement; light that is scattered out of the four images lowers it by some percent.
        assert!((gain / expected - 1.0).abs() < 0.12, "{sigma}: {gain} {expected}");
    }
}

#[test]
fn keys_of_the_other_kind_are_refused_by_name() {
    let refused = |keys: &str, facts: &str| {
        let text = format!("{}\n[wavefront_sensor]\n{keys}", Scene::preset("keck-artificial").unwrap().text());
        let reason = Scene::from_text(&text, "".as_ref()).unwrap_err().to_string();
        assert!(facts.split(" | ").all(|fact| reason.contains(fact)), "{reason}");
    };
    refused("kind = \"pyramid\"\nlenslets_across = 20", "wavefront_sensor.lenslets_across");
    refused("kind = \"pyramid\"\nthreshold_e = 2.0", "wavefront_sensor.threshold_e");
    refused("pixels_across = 20", "wavefront_sensor.pixels_across");
    refused("kind = \"pyramid\"\nmodulation_points = 18", "modulation_points = 18 | multiple of 4");
    refused("kind = \"pyramid\"\npixels_across = 2\nsamples_per_pixel = 2", "less than 2, half the");
    refused("kind = \"pyramid\"\n[control]\nreconstructor = \"sparse\"", "\"dense\" is needed");
}

#[test]
fn slopes_are_angles_with_the_sign_of_the_convention() {
    let bench = Bench::new("pixels_across = 10\nsamples_per_pixel = 6\nmodulation_lambda_over_d = 3.0\n");
    let mut sensor = Sensor::new(&bench.scene, bench.pixels.clone(), &bench.pupil, &bench.footprint).unwrap();
    // A tilt of 0.05 λ/D along x and −0.1 λ/D along y, far within the modulation.
    let map = bench.map(|x, y| TAU * (0.05 * x - 0.1 * y));
    let count = bench.pixels.subapertures.len();
    let mut slopes = vec![0.0; 2 * count];
    sensor.measure(&map, None, &mut slopes).unwrap();
    // The unit is that of the mean over the pixels by their light.
    let light = &bench.pixels.light;
    let mean = |slopes: &[f32]| {
        let sum: f64 = slopes.iter().zip(light).map(|(slope, light)| f64::from(*slope) * light).sum();
        sum / light.iter().sum::<f64>()
    };
    let unit_mas = bench.scene.wavelength_nm / WIDTH_M * super::super::MAS_PER_NM_M;
    for (found, expected) in [(mean(&slopes[..count]), 0.05), (mean(&slopes[count..]), -0.1)] {
        // Cubic terms are below (0.1/3)²/6; single precision.
        assert!((found / (expected * unit_mas) - 1.0).abs() < 0.01, "{found} {expected} {unit_mas}");
    }
}
