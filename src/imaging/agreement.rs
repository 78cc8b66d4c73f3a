//! Comparison of every fast variant of the chain with the f64 CPU chain over random scenes: random
//! grids, crops and samplings, overlapping and tilting segments, random modes and photometry,
//! batches of random size.

use super::chain::layout;
use super::gpu::{GpuChain, GpuLayout};
use super::*;
use crate::device::tests::test_devices;
use crate::device::{Build, Device, FftPlan};
use crate::fourier::{PixelResponse, Sampling};
use crate::pupil::SegmentWeights;
use ndarray::Array2;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// Random scenes: six in a usual run, which has each branch of [`sampling`] and each combination of
/// builds; sixteen in `scripts/test --all`. Most of their time is that of compiling kernels.
fn cases() -> u64 {
    if std::env::var_os("COPHASE_LONG_TESTS").is_some() { 16 } else { 6 }
}

pub(super) struct AgreementCase {
    pub optics: Arc<Optics>,
    pub exposures: Vec<Exposure>,
    pub active: Vec<usize>,
    pub coefficients_nm: Array2<f64>,
    /// The FFT, if the image is whole.
    fft: Option<FftPlan>,
}

fn uniform(count: usize, scale: f64, random: &mut impl Rng) -> Vec<f64> {
    (0..count).map(|_| scale * (2.0 * random.random::<f64>() - 1.0)).collect()
}

/// Even grids of 8 to 46 samples and 6 to 62 pixels; one case in three is a whole image of 64 to
/// 144 pixels.
fn sampling(seed: u64, random: &mut impl Rng) -> (Sampling, Option<FftPlan>) {
    if seed.is_multiple_of(3) {
        let pixels = [64, 96, 128, 144, 160, 240][(seed / 3 % 6) as usize];
        // Oversampled 2 to 3 times: the outer blocks of the FFT are zero.
        let samples = pixels / 4 * 2 - 2 * random.random_range(0..3);
        let sampling = Sampling::new(samples, pixels, pixels as f64 / samples as f64).unwrap();
        return (sampling, FftPlan::new(pixels, samples / 2));
    }
    let (samples, pixels) = (2 * random.random_range(4..24), 2 * random.random_range(3..32));
    (Sampling::new(samples, pixels, 1.0 + 2.0 * random.random::<f64>()).unwrap(), None)
}

/// Wavelengths and pixels: of six cases in turn, one has three wavelengths, one has pixels with an
/// area, and one has both.
fn camera(seed: u64) -> (Vec<Colour>, [PixelResponse; 2]) {
    let colours = [(0.9, 0.3), (1.02, 0.5), (1.15, 0.2)].map(|(ratio, share)| Colour { ratio, share });
    let pixel = [(0.8, 0.3), (1.0, 0.0)]
        .map(|(width_pixels, diffusion_pixels)| PixelResponse { width_pixels, diffusion_pixels });
    let (has_colours, has_area) = (matches!(seed % 6, 1 | 5), matches!(seed % 6, 2 | 5));
    (
        if has_colours { colours.to_vec() } else { vec![Colour::MONOCHROMATIC] },
        if has_area { pixel } else { [PixelResponse::POINT; 2] },
    )
}

pub(super) fn case(seed: u64) -> AgreementCase {
    let random = &mut ChaCha8Rng::seed_from_u64(seed);
    let (sampling, fft) = sampling(seed, random);
    let n = sampling.samples;
    // An asymmetric ellipse with a hole and some dark samples.
    let illuminated: Vec<u32> = (0..(n * n) as u32)
        .filter(|&p| {
            let [y, x] = [p as usize / n, p as usize % n].map(|i| (2 * i + 1) as f64 / n as f64 - 1.0);
            let r = (x - 0.1).powi(2) + (1.2 * y).powi(2);
            (0.05..1.0).contains(&r) && random.random::<f64>() < 0.95
        })
        .collect();
    let segments = random.random_range(1..8);
    let (mut offsets, mut segment, mut weight) = (vec![0], Vec::new(), Vec::new());
    for &p in &illuminated {
        for s in 0..segments.min(1 + random.random_range(0..3)) {
            segment.push((p / 3 + s) % segments);
            weight.push(if s == 0 { 1.0 } else { 0.3 * random.random::<f64>() - 0.15 });
        }
        offsets.push(weight.len() as u32);
    }
    let (count, entries, smooth) = (illuminated.len(), weight.len(), random.random_range(0..9));
    let tilts = random.random::<bool>();
    let mut modes: Vec<Mode> = (0..segments as usize).map(Mode::Piston).collect();
    if tilts {
        modes.extend((0..segments as usize).flat_map(|s| [Mode::Tip(s), Mode::Tilt(s)]));
    }
    modes.extend((0..smooth).rev().map(Mode::Smooth));
    let energy = weight.iter().map(|w| w * w).sum();
    let (colours, pixel) = camera(seed);
    let parts = OpticsParts {
        products: None,
        sampling,
        wavelength_nm: 1650.0,
        colours,
        pixel,
        weights: SegmentWeights { segments: segments as usize, illuminated, offsets, segment, weight, energy },
        slopes: tilts.then(|| (uniform(entries, 1.7, random), uniform(entries, 1.7, random))),
        diversity_nm: uniform(count, 1500.0, random),
        basis: Array2::from_shape_vec((smooth, count), uniform(smooth * count, 1.5, random)).unwrap(),
        modes,
    };
    let optics = Arc::new(Optics::new(parts).unwrap());
    let images = random.random_range(1..4);
    let exposures: Vec<_> = (0..images).map(|i| exposure(&optics, i, random)).collect();
    let active: Vec<usize> = (0..random.random_range(1..12)).map(|i| (i * 7 + 1) % images).collect();
    let coefficients = uniform(active.len() * optics.modes(), 120.0, random);
    let coefficients_nm = Array2::from_shape_vec((active.len(), optics.modes()), coefficients).unwrap();
    AgreementCase { optics, exposures, active, coefficients_nm, fft }
}

/// A simulated image of the scene, with uneven weights and bad pixels.
fn exposure(optics: &Arc<Optics>, kind: usize, random: &mut impl Rng) -> Exposure {
    let truth = uniform(optics.modes(), 120.0, random);
    let psf = CpuChain::<f64>::new(optics.clone()).psf(ndarray::ArrayView1::from(&truth));
    let peak = psf.iter().fold(0.0f64, |peak, &h| peak.max(h));
    let flux_e = 1e4 / peak;
    Exposure {
        data_e: psf.iter().map(|h| flux_e * h + 12.0 + 20.0 * random.random::<f64>()).collect(),
        weight: psf
            .iter()
            .map(|_| if random.random::<f64>() < 0.03 { 0.0 } else { 0.2 + random.random::<f64>() })
            .collect(),
        photometry: [
            Photometry::FitBoth,
            Photometry::FitFlux { background_e: 18.0 },
            Photometry::Fixed { flux_e: 0.9 * flux_e, background_e: 20.0 },
        ][kind],
    }
}

/// Largest relative difference of objective, flux and gradient (in the 2-norm) over the images.
pub(super) fn largest_difference(found: &[Evaluation], wanted: &[Evaluation]) -> f64 {
    let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>().sqrt();
    let one = |(f, w): (&Evaluation, &Evaluation)| {
        let difference = norm(&mut f.gradient.iter().zip(&w.gradient).map(|(f, w)| f - w));
        (difference / norm(&mut w.gradient.iter().copied()))
            .max((f.objective / w.objective - 1.0).abs())
            .max((f.flux_e / w.flux_e - 1.0).abs())
    };
    found.iter().zip(wanted).map(one).fold(0.0, f64::max)
}

/// A random free phase of up to ±0.3 turns for each active image.
pub(super) fn free_phase(case: &AgreementCase) -> Vec<f64> {
    let illuminated = case.optics.parts().weights.illuminated.len();
    uniform(case.active.len() * illuminated, 0.3, &mut ChaCha8Rng::seed_from_u64(illuminated as u64))
}

/// Largest relative difference of the gradients by the free phase over the images, in the 2-norm.
pub(super) fn largest_gradient_difference(found: &[f64], wanted: &[f64], images: usize) -> f64 {
    let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>().sqrt();
    let illuminated = wanted.len() / images;
    let rows = found.chunks_exact(illuminated).zip(wanted.chunks_exact(illuminated));
    // f64::max ignores NaN, which must fail.
    let one = |(f, w): (&[f64], &[f64])| {
        let distance = norm(&mut f.iter().zip(w).map(|(f, w)| f - w)) / norm(&mut w.iter().copied());
        if distance.is_nan() { f64::INFINITY } else { distance }
    };
    rows.map(one).fold(0.0, f64::max)
}

/// The builds to test on a device: its own build, the same with the FFT if the image is whole, and
/// that of a GPU.
fn builds(info: &crate::device::DeviceInfo, fft: Option<FftPlan>) -> Vec<Build> {
    let mut builds = Vec::new();
    for precision in [Precision::F32, Precision::F64].into_iter().filter(|p| info.supports(*p)) {
        let own = Build::for_device(info, precision);
        builds.extend([own, Build { vector: 1, ..own }]);
        builds.extend(fft.filter(|_| own.vector > 1).map(|_| Build { fft, ..own }));
    }
    builds
}

/// Tolerance. f32: phases of up to 10 rad in 24 bits have errors of 6e-7, the sums over pixels and
/// samples smaller ones, and the residuals, of the order of the image itself, do not cancel: 1e-5
/// is ten times the observed error. f64: 2e-9 of that.
pub(super) fn allowed(precision: Precision) -> f64 {
    if precision == Precision::F32 { 1e-5 } else { 1e-11 }
}

#[test]
fn every_fast_variant_agrees_with_the_cpu_in_double_precision() {
    let devices = test_devices();
    let mut worst = [0.0f64; 2];
    for seed in 0..cases() {
        let case = case(seed);
        let mut reference = CpuChain::<f64>::new(case.optics.clone());
        reference.load(&case.exposures).unwrap();
        let wanted = reference.evaluate(&case.active, case.coefficients_nm.view()).unwrap();
        let free = free_phase(&case);
        let mut wanted_slopes = vec![f64::NAN; free.len()];
        let wanted_free =
            reference.evaluate_free_all(&case.active, case.coefficients_nm.view(), &free, &mut wanted_slopes).unwrap();
        let mut check = |what: &str, chain: &mut Chain| {
            chain.load(&case.exposures).unwrap();
            let found = chain.evaluate(&case.active, case.coefficients_nm.view()).unwrap();
            let mut slopes = vec![f64::NAN; free.len()];
            let free_result =
                chain.evaluate_free(&case.active, case.coefficients_nm.view(), &free, &mut slopes).unwrap();
            let distance = (largest_difference(&found, &wanted).max(largest_difference(&free_result, &wanted_free)))
                .max(largest_gradient_difference(&slopes, &wanted_slopes, case.active.len()));
            let precision = chain.precision();
            worst[usize::from(precision == Precision::F64)] =
                worst[usize::from(precision == Precision::F64)].max(distance);
            assert!(
                distance < allowed(precision),
                "case {seed}, {what}: a difference of {distance:e} ({:?}, {} modes)",
                case.optics.sampling(),
                case.optics.modes()
            );
        };
        check("CPU in f32", &mut Chain::cpu(case.optics.clone(), Precision::F32));
        for info in &devices {
            let device = Device::open(info, false).unwrap();
            for build in builds(info, case.fft) {
                let layout = GpuLayout { free_phase: true, ..layout(&case.optics) };
                let mut chain = GpuChain::with_build(&device, build, &layout, case.exposures.len()).unwrap();
                let own = case.coefficients_nm.row(0);
                let (psf, wanted) = (chain.psf(&own.to_vec()).unwrap(), reference.psf(own));
                let peak = wanted.iter().copied().fold(0.0, f64::max);
                let difference = psf.iter().zip(&wanted).map(|(h, wanted)| (h - wanted).abs()).fold(0.0, f64::max);
                assert!(
                    difference < allowed(build.precision) * peak,
                    "case {seed}, PSF of {build:?}: {difference:e} of {peak:e}"
                );
                let name = info.address();
                let (optics, precision) = (case.optics.clone(), build.precision);
                check(&format!("{build:?}"), &mut Chain::Device { chain: Box::new(chain), optics, precision, name });
            }
        }
    }
    println!("largest differences: f32 {:.1e}, f64 {:.1e}", worst[0], worst[1]);
}

/// On a CPU device `focus_stored` takes a batch, image by image, and the stages take one image
/// alone. A build of single numbers has the stages for both.
#[test]
#[ignore = "merge: 20 s"]
fn wavelengths_and_pixel_areas_agree_with_cpu_in_any_batch() {
    let mut apart = [0.0f64; 2];
    for (info, seed) in test_devices().iter().flat_map(|info| [1, 2, 5].map(|seed| (info, seed))) {
        let AgreementCase { optics, exposures, coefficients_nm, active, .. } = &case(seed);
        assert!(optics.colours().len() > 1 || optics.parts().pixel != [PixelResponse::POINT; 2]);
        let device = Device::open(info, false).unwrap();
        let layout = GpuLayout { free_phase: true, ..layout(optics) };
        // More images than work-items of a CPU, which has three for each of its cores; the last
        // group is not full. The tolerance is that of some dozen images: of 531 random ones one is
        // 1.8e-5 off in f32 through PoCL.
        let count = 4 * (info.compute_units as usize).min(8) + 3;
        let batch: Vec<usize> = (0..count).map(|i| i % active.len()).collect();
        let images: Vec<usize> = batch.iter().map(|&i| active[i]).collect();
        let coefficients = coefficients_nm.select(ndarray::Axis(0), &batch);
        let illuminated = layout.illuminated.len();
        let free = uniform(count * illuminated, 0.3, &mut ChaCha8Rng::seed_from_u64(seed));
        let mut reference = CpuChain::<f64>::new(optics.clone());
        reference.load(exposures).unwrap();
        let mut wanted_slopes = vec![f64::NAN; free.len()];
        let wanted = reference.evaluate_free_all(&images, coefficients.view(), &free, &mut wanted_slopes).unwrap();
        let precisions = [Precision::F32, Precision::F64].into_iter().filter(|&precision| info.supports(precision));
        for build in precisions.flat_map(|precision| [1, 4, 8, 16].map(|vector| Build { precision, vector, fft: None }))
        {
            let chain = GpuChain::with_build(&device, build, &layout, count).unwrap();
            let (precision, name) = (build.precision, info.address());
            let mut chain = Chain::Device { chain: Box::new(chain), optics: optics.clone(), precision, name };
            chain.load(exposures).unwrap();
            let mut slopes = vec![f64::NAN; free.len()];
            let together = chain.evaluate_free(&images, coefficients.view(), &free, &mut slopes).unwrap();
            let distance =
                largest_difference(&together, &wanted).max(largest_gradient_difference(&slopes, &wanted_slopes, count));
            assert!(distance < allowed(precision), "case {seed}, {build:?}: {distance:e} from the CPU");
            // The same sums in the same order; only fused multiply-adds may differ: a few
            // roundings.
            let close = if precision == Precision::F32 { 1e-6 } else { 1e-14 };
            for i in 0..count {
                let own = i * illuminated..(i + 1) * illuminated;
                let mut slopes_alone = vec![f64::NAN; illuminated];
                let row = coefficients.slice(ndarray::s![i..=i, ..]);
                let alone = chain.evaluate_free(&images[i..=i], row, &free[own.clone()], &mut slopes_alone).unwrap();
                let distance = largest_difference(&together[i..=i], &alone).max(largest_gradient_difference(
                    &slopes[own],
                    &slopes_alone,
                    1,
                ));
                assert!(distance < close, "case {seed}, {build:?}, image {i}: {distance:e} from the stages");
                let largest = &mut apart[usize::from(precision == Precision::F64)];
                *largest = largest.max(distance);
            }
        }
    }
    println!("largest differences from the stages: f32 {:.1e}, f64 {:.1e}", apart[0], apart[1]);
}
