//! Strehl ratios of simulated PSFs.

use super::{keck, map};
use cophase::imaging::{Sampling, Transform};
use cophase::pupil::Pupil;
use cophase_paper::experiment::metrics::{Marechal, centre, strehl_by_energy, strehl_by_marechal, strehl_by_otf};
use ndarray::{Array2, Axis, Zip};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use std::f64::consts::PI;

/// H and K', nm.
const BANDS_NM: [f64; 2] = [1633.0, 2124.0];
const PIXELS: usize = 256;
/// Pixels per λ/(width of the grid), which is a little less than λ/D: the OTF of the scene's pupil
/// ends within the cut-off.
const SAMPLING: f64 = 4.0;

/// Pupil, and the transform of its wavefronts to PSFs of sum 1 over an unbounded detector.
struct Telescope {
    pupil: Pupil,
    transform: Transform<f64>,
}

impl Telescope {
    fn new() -> Self {
        let pupil = keck();
        let transform = Transform::choose(Sampling::new(pupil.grid.samples(), PIXELS, SAMPLING).unwrap());
        Self { pupil, transform }
    }

    fn psf(&self, wavefront_nm: &Array2<f64>, wavelength_nm: f64) -> Array2<f64> {
        let n = self.pupil.grid.samples();
        let mut field = Array2::zeros((n, 2 * n));
        for ((y, x), &a) in self.pupil.amplitude.indexed_iter().filter(|(_, a)| **a > 0.0) {
            let (sin, cos) = (2.0 * PI * wavefront_nm[[y, x]] / wavelength_nm).sin_cos();
            (field[[y, x]], field[[y, n + x]]) = (a * cos, a * sin);
        }
        let mut focus = Array2::zeros((PIXELS, 2 * PIXELS));
        let mut workspace = self.transform.workspace();
        self.transform.forward(field.as_slice().unwrap(), focus.as_slice_mut().unwrap(), &mut workspace);
        let energy = self.pupil.amplitude.mapv(|a| a * a).sum();
        let scale = 1.0 / (energy * (n as f64 * SAMPLING).powi(2));
        Array2::from_shape_fn((PIXELS, PIXELS), |(v, u)| {
            scale * (focus[[v, u]].powi(2) + focus[[v, PIXELS + u]].powi(2))
        })
    }

    fn perfect(&self) -> Array2<f64> {
        self.psf(&Array2::zeros(self.pupil.amplitude.dim()), BANDS_NM[0])
    }

    /// Smooth aberration without piston, tip and tilt, of `rms_nm`: focus, astigmatism, coma and
    /// higher orders.
    fn smooth(&self, rms_nm: f64) -> Array2<f64> {
        let shape = |x: f64, y: f64| (x * x + y * y) - 0.7 * x * y + 0.3 * x * (x * x + y * y) + 2.0 * (2.1 * y).sin();
        self.scaled(map(&self.pupil, shape), rms_nm)
    }

    /// Segment pistons of `rms_nm`.
    fn pistons(&self, rms_nm: f64) -> Array2<f64> {
        let piston = |owner: i32| f64::from((owner * 17 + owner * owner * 5) % 23);
        self.scaled(self.pupil.owner.mapv(piston), rms_nm)
    }

    fn scaled(&self, map: Array2<f64>, rms_nm: f64) -> Array2<f64> {
        let map = self.pupil.remove_piston_tip_tilt(map.view()).unwrap();
        let scale = rms_nm / self.pupil.rms(map.view()).unwrap();
        map * scale
    }

    /// Mean over the pupil (weight A) of a function of the phase.
    fn mean(&self, phase: &Array2<f64>, function: impl Fn(f64) -> f64) -> f64 {
        let illuminated = self.pupil.amplitude.iter().zip(phase).filter(|(a, _)| **a > 0.0);
        illuminated.map(|(a, &phase)| a * function(phase)).sum::<f64>() / self.pupil.weight_sum()
    }
}

#[test]
fn a_perfect_image_has_a_strehl_of_1() {
    let perfect = Telescope::new().perfect();
    let by_energy = strehl_by_energy(perfect.view(), 0.0, perfect.view()).unwrap();
    let by_otf = strehl_by_otf(perfect.view(), 0.0, perfect.view(), SAMPLING).unwrap();
    assert_eq!((by_energy, by_otf, strehl_by_marechal(0.0, BANDS_NM[0])), (1.0, 1.0, 1.0));
}

#[test]
fn three_methods_agree_to_fourth_order_for_small_aberrations() {
    let telescope = Telescope::new();
    let perfect = telescope.perfect();
    for (wavelength_nm, rms_nm) in BANDS_NM.into_iter().flat_map(|band| [40.0, 80.0, 120.0].map(|rms| (band, rms))) {
        for wavefront in [telescope.smooth(rms_nm), telescope.pistons(rms_nm)] {
            let image = telescope.psf(&wavefront, wavelength_nm);
            let by_energy = strehl_by_energy(image.view(), 0.0, perfect.view()).unwrap();
            let by_otf = strehl_by_otf(image.view(), 0.0, perfect.view(), SAMPLING).unwrap();
            let by_marechal = strehl_by_marechal(rms_nm, wavelength_nm);
            let phase = wavefront.mapv(|w| 2.0 * PI * w / wavelength_nm);
            let [sigma2, fourth] = [2, 4].map(|power| telescope.mean(&phase, |p| p.powi(power)));
            let on_axis = telescope.mean(&phase, f64::cos).powi(2) + telescope.mean(&phase, f64::sin).powi(2);
            println!(
                "{wavelength_nm} nm, {rms_nm} nm: {by_energy:.5} {by_otf:.5} {by_marechal:.5} on axis {on_axis:.5}"
            );
            // Without noise the two methods differ only by the discontinuity at the edges of the
            // box: 1e-6 of the peak per pixel, 128 pixels away.
            assert!((by_otf - by_energy).abs() < 1e-7, "{by_otf} {by_energy}");
            // The light outside the box is known here, and so is the ratio of the peaks. An
            // aberration without tilt shifts the peak by the order of σ³, so the peak exceeds the
            // intensity on the axis by the order of σ⁶.
            let peak = by_energy * image.sum() / perfect.sum();
            assert!((-1e-6..0.1 * sigma2.powi(3) + 1e-6).contains(&(peak - on_axis)), "{peak} {on_axis}");
            // ln |<exp iφ>|² = −κ2 + κ4/12 − κ6/360 …, and |κ6| < 30 σ⁶ for bounded phases such as
            // these.
            let lacking = (fourth - 3.0 * sigma2 * sigma2) / 12.0;
            assert!((on_axis.ln() - by_marechal.ln() - lacking).abs() < sigma2.powi(3) / 12.0);
            // The image and Maréchal differ by the fourth order and by the light outside the box.
            let lost = (perfect.sum() / image.sum()).ln();
            assert!((by_energy.ln() - by_marechal.ln()).abs() < sigma2 * sigma2 / 4.0 + lost);
        }
    }
}

#[test]
fn marechal_over_telemetry_is_the_strehl_of_the_long_exposure() {
    let telescope = Telescope::new();
    let (perfect, wavelength_nm) = (telescope.perfect(), BANDS_NM[0]);
    let tilt = map(&telescope.pupil, |x, y| 14.0 * x - 9.0 * y);
    let mut marechal = Marechal::new(wavelength_nm).unwrap();
    let mut exposure = Array2::zeros(perfect.dim());
    let mut fourth = 0.0;
    for frame in 0..12 {
        // Pairs of opposite sign make the long exposure symmetric, with its peak on the axis.
        let sign = if frame % 2 == 0 { 1.0 } else { -1.0 };
        let strength = f64::from(frame / 2);
        let wavefront = (telescope.smooth(30.0 + 8.0 * strength) + telescope.pistons(50.0) + &tilt * strength) * sign;
        let wavefront = telescope.pupil.remove_piston(wavefront.view()).unwrap();
        let rms_nm = telescope.pupil.rms(wavefront.view()).unwrap();
        marechal.add(rms_nm).unwrap();
        fourth += (2.0 * PI * rms_nm / wavelength_nm).powi(4) / 12.0;
        exposure += &(telescope.psf(&wavefront, wavelength_nm) / 12.0);
    }
    let (measured, expected) =
        (strehl_by_energy(exposure.view(), 0.0, perfect.view()).unwrap(), marechal.strehl().unwrap());
    let lost = (perfect.sum() / exposure.sum()).ln();
    println!("long exposure {measured:.4}, Maréchal {expected:.4}");
    // The tolerance of a single frame.
    assert!((measured / expected).ln().abs() < fourth / 4.0 + lost, "{measured} {expected}");
    // The mean wavefront is flat; its Strehl ratio would be 1.
    assert!(measured < 0.9);
}

#[test]
fn a_subpixel_shift_does_not_change_the_strehl_ratio() {
    let telescope = Telescope::new();
    let (perfect, wavelength_nm) = (telescope.perfect(), BANDS_NM[1]);
    let aberration = telescope.smooth(60.0) + telescope.pistons(60.0);
    let wavefront = |[y_px, x_px]: [f64; 2]| {
        let nm_per_m = wavelength_nm / (telescope.pupil.grid.width_m() * SAMPLING);
        &aberration + &map(&telescope.pupil, |x, y| nm_per_m * (x_px * x + y_px * y))
    };
    let still = telescope.psf(&wavefront([0.0; 2]), wavelength_nm);
    let centred = centre(still.view()).unwrap();
    let [by_energy, by_otf] = [
        strehl_by_energy(still.view(), 0.0, perfect.view()).unwrap(),
        strehl_by_otf(still.view(), 0.0, perfect.view(), SAMPLING).unwrap(),
    ];
    let brightest = |image: &Array2<f64>| image.iter().copied().fold(f64::MIN, f64::max);
    for shift in [[0.5, 0.5], [0.37, -0.21], [-0.8, 0.05], [2.3, -1.6]] {
        let moved = telescope.psf(&wavefront(shift), wavelength_nm);
        let (energy, otf) = (
            strehl_by_energy(moved.view(), 0.0, perfect.view()).unwrap(),
            strehl_by_otf(moved.view(), 0.0, perfect.view(), SAMPLING).unwrap(),
        );
        // The light that a shift moves across the box's edges is at most that of the rows at the
        // edges, per pixel of shift.
        let edges = [[0, 0], [1, 0], [0, 1], [1, 1]]
            .map(|[axis, last]| still.index_axis(Axis(axis), last * (PIXELS - 1)).sum() / still.sum());
        let tolerance = shift[0].abs() * edges[0].max(edges[2]) + shift[1].abs() * edges[1].max(edges[3]);
        println!("{shift:?}: {:.1e} {:.1e} of {tolerance:.1e}", energy / by_energy - 1.0, otf / by_otf - 1.0);
        assert!((energy / by_energy - 1.0).abs() < tolerance && (otf / by_otf - 1.0).abs() < tolerance);
        let back = centre(moved.view()).unwrap();
        for axis in 0..2 {
            let found = centred.shift_px[axis] - back.shift_px[axis];
            assert!((found - shift[axis]).abs() < 1e-4, "{found} {shift:?}");
        }
        // The shift wraps around; the images differ by the light at the edges.
        let worst = Zip::from(&back.image).and(&centred.image).fold(0.0f64, |w, a, b| w.max((a - b).abs()));
        println!("   {:.1e} of the peak", worst / brightest(&still));
        assert!(worst < 1e-3 * brightest(&still), "{worst:.1e}");
    }
    // Without interpolation the brightest of the four pixels around a peak is well below it.
    let moved = telescope.psf(&wavefront([0.5, 0.5]), wavelength_nm);
    assert!(brightest(&moved) < 0.95 * brightest(&still));
}

#[test]
fn flux_and_background_do_not_change_the_strehl_ratio() {
    let telescope = Telescope::new();
    let perfect = telescope.perfect();
    let image = telescope.psf(&telescope.smooth(90.0), BANDS_NM[0]);
    let plain = strehl_by_energy(image.view(), 0.0, perfect.view()).unwrap();
    let scaled = &image * 3.7e5 + 212.0;
    let energy = strehl_by_energy(scaled.view(), 212.0, (&perfect * 1e-3).view()).unwrap();
    let otf = strehl_by_otf(scaled.view(), 212.0, (&perfect * 1e-3).view(), SAMPLING).unwrap();
    // 212 in each of 65536 pixels is 40 times the light, with rounding of 1e-16 of itself.
    assert!((energy / plain - 1.0).abs() < 1e-12 && (otf / plain - 1.0).abs() < 1e-7, "{energy} {otf} {plain}");
    // A background too small by 1 e⁻: the peak gains 1, the sum 65536 of 3.7e5.
    let biased = strehl_by_energy(scaled.view(), 211.0, perfect.view()).unwrap();
    let expected = (1.0 + 1.0 / (scaled[[128, 128]] - 212.0)) / (1.0 + 65536.0 / (scaled.sum() - 212.0 * 65536.0));
    assert!((biased / plain / expected - 1.0).abs() < 1e-4, "{biased} {plain} {expected}");
}

#[test]
fn the_strehl_ratio_has_the_noise_of_its_peak_and_sum() {
    const DRAWS: usize = 60;
    let telescope = Telescope::new();
    let perfect = telescope.perfect();
    let image = telescope.psf(&telescope.smooth(60.0), BANDS_NM[0]);
    let peak = image.iter().copied().fold(0.0, f64::max);
    let noise = Normal::new(0.0, 0.003 * peak).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let clean = strehl_by_energy(image.view(), 0.0, perfect.view()).unwrap();
    let mut sums = [[0.0; 2]; 3];
    for _ in 0..DRAWS {
        let noisy = image.mapv(|value| value + noise.sample(&mut random));
        let flux = noisy.sum() / image.sum();
        let energy = strehl_by_energy(noisy.view(), 0.0, perfect.view()).unwrap() / clean;
        let otf = strehl_by_otf(noisy.view(), 0.0, perfect.view(), SAMPLING).unwrap() / clean;
        // The ratio, and the peaks alone.
        for (sums, value) in sums.iter_mut().zip([energy, energy * flux, otf * flux]) {
            sums[0] += (value - 1.0) / DRAWS as f64;
            sums[1] += (value - 1.0).powi(2) / DRAWS as f64;
        }
    }
    let scatter = sums.map(|[mean, square]| (square - mean * mean).sqrt());
    println!("scatter {scatter:?}, bias {:?}", sums.map(|s| s[0]));
    let (at_peak, in_sum) = (0.003f64, 0.003 * peak * PIXELS as f64 / image.sum());
    // π/16 of the frequencies pass.
    let expected = [at_peak.hypot(in_sum), at_peak, at_peak * (PI / SAMPLING.powi(2)).sqrt()];
    for (scatter, expected) in scatter.into_iter().zip(expected) {
        // 60 draws determine a standard deviation to 1/√120 = 9 %: 4σ.
        assert!((scatter / expected - 1.0).abs() < 0.37, "{scatter} {expected}");
    }
    for (sum, scatter) in sums.into_iter().zip(scatter) {
        // Noise shifts the maximum, which raises it by slope² over twice the curvature, of the
        // order of the noise squared, (π·0.003)². The mean of 60 draws is known to 0.13 of their
        // scatter: 4σ.
        assert!(sum[0].abs() < 0.52 * scatter + 1e-4, "{} {scatter}", sum[0]);
    }
}
