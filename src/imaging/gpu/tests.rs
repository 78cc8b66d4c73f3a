//! Comparison of the device with explicit sums in f64.

mod reference;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use self::reference::*;
use super::*;
use crate::device::tests::test_devices;
use crate::device::{Build, Device, FftPlan, Precision};

/// Every build that a device supports.
fn builds(device: &Device) -> Vec<Build> {
    let mut builds = Vec::new();
    for precision in [Precision::F32, Precision::F64] {
        if device.info().supports(precision) {
            builds.extend([1, 4, 8, 16].map(|vector| Build { precision, vector, fft: None }));
        }
    }
    builds
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>().sqrt();
    norm(&mut a.iter().zip(b).map(|(a, b)| a - b)) / norm(&mut b.iter().copied())
}

#[test]
fn psfs_agree_with_the_direct_sum() {
    [scene(), camera_scene()].iter().for_each(psfs_of);
}

fn psfs_of(layout: &GpuLayout) {
    let mut random = ChaCha8Rng::seed_from_u64(2);
    let c = coefficients(layout, 6, &mut random);
    let wanted: Vec<f64> = c.chunks_exact(layout.modes.len()).flat_map(|c| psf(layout, c)).collect();
    let peak = wanted.iter().fold(0.0f64, |a, h| a.max(*h));
    for info in test_devices() {
        let device = Device::open(&info, false).unwrap();
        for build in builds(&device) {
            let psf = GpuChain::with_build(&device, build, layout, 3).unwrap().psf(&c).unwrap();
            let worst = psf.iter().zip(&wanted).fold(0.0f64, |a, (h, w)| a.max((h - w).abs())) / peak;
            // f32: 250 samples whose phases err by a few 1e-7 rad each (turns of up to 4 in 24
            // bits, times 2 pi) and whose signs are random: 1e-7 of the field at the peak, twice
            // that of its square; 10 of it allowed.
            let allowed = if build.precision == Precision::F32 { 2e-6 } else { 1e-12 };
            println!("{build:?}: PSF within {worst:.1e} of the peak");
            assert!(worst < allowed, "{build:?}: {worst:e} of the peak");
        }
    }
}

#[test]
fn objective_gradient_and_photometry_agree_with_the_direct_sum() {
    // Out of order, one image twice, and more than the capacity of the chain, so that there are two
    // rounds.
    let active = [4, 0, 5, 2, 2, 1, 3];
    for layout in [scene(), tilted_scene(), free_scene(), camera_scene()] {
        agreement_in(&layout, &active, builds);
    }
}

#[test]
fn the_fft_agrees_with_the_direct_sum() {
    let builds = |device: &Device| {
        let precisions = [Precision::F32, Precision::F64].into_iter().filter(|&p| device.info().supports(p));
        precisions.map(|precision| Build { precision, vector: 4, fft: FftPlan::new(64, 9) }).collect()
    };
    agreement_in(&whole_scene(), &[1, 0], builds);
}

fn agreement_in(layout: &GpuLayout, active: &[usize], builds: impl Fn(&Device) -> Vec<Build>) {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let count = active.iter().max().unwrap() + 1;
    let images = images(layout, count, &mut random);
    let size = layout.pixels * layout.pixels;
    let c = coefficients(layout, active.len(), &mut random);
    let free = free_phases(layout, active.len(), &mut random);
    let illuminated = free.len() / active.len();
    let wanted: Vec<ReferenceResult> = (active.iter().zip(c.chunks_exact(layout.modes.len())).enumerate())
        .map(|(k, (&i, c))| {
            let (range, layout) =
                (i * size..(i + 1) * size, with_free(layout, &free[k * illuminated..(k + 1) * illuminated]));
            reference(&layout, c, &images.data[range.clone()], &images.weights[range], images.photometry[i])
        })
        .collect();
    for info in test_devices() {
        let device = Device::open(&info, false).unwrap();
        for build in builds(&device) {
            let mut chain = GpuChain::with_build(&device, build, layout, count).unwrap();
            // The first evaluation leaves data in every scratch array.
            chain.load(&images.data, &images.weights, &images.photometry).unwrap();
            let all: Vec<usize> = (0..count).collect();
            chain.evaluate(&all, &coefficients(layout, count, &mut random)).unwrap();
            let mut slopes = vec![f64::NAN; free.len()];
            let found = chain.evaluate_free(active, &c, &free, &mut slopes).unwrap();
            // Sums of 500 pixels and 250 samples of terms that err by 1e-7 (f32) or 1e-16 each:
            // some 1e-6 or 1e-15 where signs are random. Residuals here are of the order of the
            // image, so nothing cancels.
            let [close, closer] = if build.precision == Precision::F32 { [1e-5, 1e-5] } else { [1e-12, 1e-11] };
            for (i, wanted) in wanted.iter().enumerate() {
                let gradient = &found.gradient[i * layout.modes.len()..(i + 1) * layout.modes.len()];
                let slopes = &slopes[i * illuminated..(i + 1) * illuminated];
                let errors = [
                    (found.objective[i] / wanted.objective - 1.0).abs(),
                    (found.flux_e[i] / wanted.flux - 1.0).abs(),
                    (found.background_e[i] - wanted.background).abs() / wanted.flux.abs() * 22.0,
                    distance(gradient, &wanted.gradient),
                    if layout.free_phase { distance(slopes, &wanted.slopes) } else { 0.0 },
                ];
                if i == 0 {
                    println!("{build:?}: objective, flux, background, gradient, slopes within {errors:?}");
                }
                assert!(errors[..3].iter().all(|e| *e < close), "{build:?} image {i}: {errors:?}");
                assert!(errors[3..].iter().all(|e| *e < closer), "{build:?} image {i}: {errors:?}");
            }
        }
    }
}

#[test]
fn a_faint_star_on_a_bright_background_does_not_lose_accuracy() {
    let layout = scene();
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let size = layout.pixels * layout.pixels;
    let c = coefficients(&layout, 3, &mut random);
    let images = images(&layout, 3, &mut random);
    // 300 electrons of star on 50,000 per pixel: in f32 the data themselves would be rounded by
    // 0.004.
    let data: Vec<f64> = images.data.iter().map(|d| 5e4 + d / 130.0).collect();
    let photometry = [
        GpuPhotometry::FitBoth,
        GpuPhotometry::FitFlux { background_e: 5e4 + 0.1 },
        GpuPhotometry::Known { flux_e: 290.0, background_e: 5e4 },
    ];
    for info in test_devices() {
        let device = Device::open(&info, false).unwrap();
        let mut chain = GpuChain::new(&device, Precision::F32, &layout, 3).unwrap();
        chain.load(&data, &images.weights, &photometry).unwrap();
        let found = chain.evaluate(&[0, 1, 2], &c).unwrap();
        for (i, c) in c.chunks_exact(layout.modes.len()).enumerate() {
            let range = i * size..(i + 1) * size;
            let wanted = reference(&layout, c, &data[range.clone()], &images.weights[range], photometry[i]);
            let gradient = &found.gradient[i * layout.modes.len()..(i + 1) * layout.modes.len()];
            let errors = [
                (found.objective[i] / wanted.objective - 1.0).abs(),
                (found.flux_e[i] / wanted.flux - 1.0).abs(),
                distance(gradient, &wanted.gradient),
            ];
            println!("{info}: image {i} within {errors:?}");
            // As for a bright star; without the offset the flux alone would be wrong by some 1e-3.
            assert!(errors.iter().all(|e| *e < 1e-5), "image {i}: {errors:?}");
        }
    }
}

#[test]
fn results_do_not_depend_on_the_batch() {
    [scene(), tilted_scene(), free_scene(), camera_scene()].iter().for_each(compare_with_single_images);
}

fn compare_with_single_images(layout: &GpuLayout) {
    let mut random = ChaCha8Rng::seed_from_u64(4);
    let images = images(layout, 3, &mut random);
    let c = coefficients(layout, 3, &mut random);
    let modes = layout.modes.len();
    for info in test_devices() {
        let device = Device::open(&info, false).unwrap();
        for build in builds(&device) {
            // So many that every CPU device uses focus.cl; one image is processed stage by stage.
            let batch: Vec<usize> = (0..3).cycle().take(2 * info.compute_units as usize + 37).collect();
            let mut chain = GpuChain::with_build(&device, build, layout, batch.len()).unwrap();
            chain.load(&images.data, &images.weights, &images.photometry).unwrap();
            let all: Vec<f64> = batch.iter().flat_map(|&i| c[i * modes..(i + 1) * modes].to_vec()).collect();
            let free = free_phases(layout, 3, &mut random);
            let illuminated = free.len() / 3;
            let all_free: Vec<f64> =
                batch.iter().flat_map(|&i| free[i * illuminated..(i + 1) * illuminated].to_vec()).collect();
            let mut slopes = vec![f64::NAN; all_free.len()];
            let together = chain.evaluate_free(&batch, &all, &all_free, &mut slopes).unwrap();
            // The same sums in the same order; only fused multiply-adds may differ: a few
            // roundings, far below the errors of the test above.
            let close = if build.precision == Precision::F32 { 1e-6 } else { 1e-14 };
            for (i, &image) in batch.iter().enumerate() {
                let mut slopes_alone = vec![f64::NAN; illuminated];
                let (own, own_free) =
                    (&c[image * modes..(image + 1) * modes], &free[image * illuminated..(image + 1) * illuminated]);
                let alone = chain.evaluate_free(&[image], own, own_free, &mut slopes_alone).unwrap();
                let objective = (together.objective[i] / alone.objective[0] - 1.0).abs();
                let gradient = distance(&together.gradient[i * modes..(i + 1) * modes], &alone.gradient);
                let slopes = if illuminated > 0 {
                    distance(&slopes[i * illuminated..(i + 1) * illuminated], &slopes_alone)
                } else {
                    0.0
                };
                let difference = objective.max(gradient).max(slopes);
                assert!(difference < close, "{build:?} image {i}: {objective:e} {gradient:e} {slopes:e}");
            }
        }
    }
}

#[test]
fn allocated_memory_agrees_with_its_formula_and_limits_tiles() {
    let whole = whole_scene();
    for info in test_devices() {
        let device = Device::open(&info, false).unwrap();
        let mut random = ChaCha8Rng::seed_from_u64(6);
        let plain = [scene(), tilted_scene(), free_scene(), camera_scene()];
        let plain = plain.iter().map(|layout| (layout, None));
        for (layout, fft) in plain.chain([(&whole, FftPlan::new(64, 9)), (&whole, None)]) {
            let own = |build: &Build| *build == Build::for_device(&info, build.precision);
            // There is no FFT for one number per work-item.
            let possible = |build: &Build| build.vector > 1 || fft.is_none();
            for build in builds(&device).into_iter().filter(|b| possible(b) && (own(b) || b.vector == 1)) {
                let build = Build { fft, ..build };
                let capacity = 41;
                let mut chain = GpuChain::with_build(&device, build, layout, capacity).unwrap();
                // Exactly: the allocated bytes are counted where the buffers are made.
                assert_eq!(chain.bytes(), device.allocated_bytes(), "{build:?}");

                // Less memory: smaller tiles, the same numbers.
                let images = images(layout, 3, &mut random);
                let data: Vec<usize> = (0..capacity).map(|i| i % 3).collect();
                let c = coefficients(layout, capacity, &mut random);
                chain.load(&images.data, &images.weights, &images.photometry).unwrap();
                let wanted = chain.evaluate(&data, &c).unwrap();
                let bytes = chain.bytes();
                drop(chain);
                assert_eq!(device.allocated_bytes(), 0);
                let mut least = bytes;
                while let Ok(chain) = GpuChain::with_memory(&device, build, layout, capacity, least - 1) {
                    assert!(chain.bytes() < least && chain.bytes() == device.allocated_bytes(), "{build:?}");
                    least = chain.bytes();
                }
                let mut small = GpuChain::with_memory(&device, build, layout, capacity, least).unwrap();
                assert!(small.bytes() < bytes);
                small.load(&images.data, &images.weights, &images.photometry).unwrap();
                let found = small.evaluate(&data, &c).unwrap();
                // As in the comparison with single images.
                let close = if build.precision == Precision::F32 { 1e-6 } else { 1e-14 };
                assert!(distance(&found.gradient, &wanted.gradient) < close, "{build:?}");
                let refusal = GpuChain::with_memory(&device, build, layout, capacity, 1000).unwrap_err().to_string();
                assert!(refusal.contains("1000") && refusal.contains("41 images"), "{refusal}");
            }
        }
    }
}

#[test]
fn a_chain_can_be_moved_to_another_thread() {
    fn is_send<T: Send>() {}
    is_send::<GpuChain>();
}

#[test]
fn invalid_input_is_named() {
    let Some(info) = test_devices().into_iter().next() else { return };
    let device = Device::open(&info, false).unwrap();
    let layout = scene();
    let new = |layout: &GpuLayout| GpuChain::new(&device, Precision::F32, layout, 2).map(|_| ());
    assert!(new(&layout).is_ok());
    type Change = fn(&mut GpuLayout);
    let broken: [(&str, Change); 11] = [
        ("17", |l| l.samples = 17),
        ("0 image pixels", |l| l.pixels = 0),
        ("wavelength_nm", |l| l.colours[0].wavelength_nm = f64::NAN),
        ("diversity_turns", |l| l.colours[0].diversity_turns.truncate(3)),
        ("0 wavelengths", |l| l.colours.clear()),
        ("pixel_terms", |l| l.pixel_terms = Some([vec![1.0, 0.0], vec![1.0]])),
        ("twice", |l| l.illuminated[1] = l.illuminated[0]),
        ("outside a pupil", |l| l.illuminated[0] = 18 * 18),
        ("segment 9", |l| l.segment_index[3] = 9),
        ("segment weight", |l| l.segment_weight[0] = f64::INFINITY),
        ("smooth mode 7", |l| l.modes[0] = GpuMode::Smooth(7)),
    ];
    for (word, change) in broken {
        let mut layout = layout.clone();
        change(&mut layout);
        let message = new(&layout).unwrap_err().to_string();
        assert!(message.contains(word), "`{message}` names {word}");
    }

    let mut chain = GpuChain::new(&device, Precision::F32, &layout, 2).unwrap();
    let size = layout.pixels * layout.pixels;
    let fit = GpuPhotometry::FitBoth;
    assert!(chain.load(&vec![1.0f32; size], &vec![1.0f32; size - 1], &[fit]).is_err());
    assert!(chain.load(&vec![1.0; 3 * size], &vec![1.0; 3 * size], &[fit; 3]).is_err());
    assert!(chain.load(&vec![f64::NAN; size], &vec![1.0; size], &[fit]).is_err());
    assert!(chain.load(&vec![1.0; size], &vec![-1.0; size], &[fit]).is_err());
    chain.load(&vec![1.0; size], &vec![1.0; size], &[fit]).unwrap();
    let zeros = vec![0.0; layout.modes.len()];
    assert!(chain.evaluate(&[0], &zeros).is_ok());
    assert!(chain.evaluate(&[1], &zeros).is_err());
    assert!(chain.evaluate(&[0], &zeros[1..]).is_err());
    assert!(chain.evaluate(&[0], &vec![f64::INFINITY; layout.modes.len()]).is_err());
    assert!(chain.evaluate(&[], &[]).unwrap().objective.is_empty());
}
