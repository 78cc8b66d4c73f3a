//! Retrieval of wavefronts that are drawn from the prior, with pistons, from images of the model's own making.

use super::*;
use crate::estimate::Cube;
use crate::imaging::{Choice, CpuChain, Precision};
use crate::scene::Scene;
use ndarray::{Array1, Array3, s};

/// Seven segments of 0.9 m behind a mirror of 0.5625 m pitch: a small Keck.
pub(crate) fn scene() -> Scene {
    let settings = [
        ("pupil.aperture", "hexagonal"),
        ("pupil.rings", "1"),
        ("pupil.grid_m", "5.625"),
        ("pupil.samples", "64"),
        ("image.pixels", "128"),
        ("wavefront_sensor.lenslets_across", "10"),
        ("mirror.actuators_across", "11"),
    ];
    Scene::preset("keck-onsky").unwrap().with(&settings).unwrap()
}

/// Frames of wavefronts drawn from the prior with pistons of 60 nm, and those wavefronts.
pub(crate) struct Drawn {
    pub(crate) images_e: Array3<f64>,
    wavefronts_nm: Vec<Vec<f64>>,
}

pub(crate) fn draw(retriever: &Retriever, prior: &Spectrum, count: usize, noise: bool) -> Drawn {
    let mut rng = crate::source::stream(7, 0);
    let scene = scene();
    let (rows, columns) = scene.image.frame_shape();
    let model = retriever.model();
    let chain = CpuChain::<f64>::new(model.optics.clone());
    let (mut scratch, wavelength_nm) = (chain.scratch(), scene.image.wavelength_nm);
    let pixels = model.preparation.pixels;
    let mut drawn = Drawn { images_e: Array3::zeros((count, rows, columns)), wavefronts_nm: Vec::new() };
    for image in 0..count {
        let field_nm = retriever.draw_nm(prior, image as u64);
        let mut coefficients_nm = Array1::zeros(model.optics.modes());
        for (segment, nm) in coefficients_nm.iter_mut().take(model.segment_modes).enumerate() {
            *nm = 60.0 * (2.4 * (segment + 7 * image) as f64).sin();
        }
        let turns: Vec<f64> = field_nm.iter().map(|nm| nm / wavelength_nm).collect();
        let psf = chain.psf_free_in(coefficients_nm.view(), &turns, &mut scratch);
        // A bright star: the brightest pixel has some 10⁵ electrons.
        let flux_e = 3e8;
        let (top, left) = (rows / 2 - pixels / 2, columns / 2 - pixels / 2);
        let mut frame = drawn.images_e.slice_mut(s![image, .., ..]);
        for v in 0..pixels {
            for u in 0..pixels {
                let mean = psf[v * pixels + u];
                frame[[top + v, left + u]] =
                    if noise { crate::source::expose(&scene.image, mean, flux_e, &mut rng) } else { flux_e * mean };
            }
        }
        let shown = retriever.shown_nm(coefficients_nm.as_slice().unwrap());
        drawn.wavefronts_nm.push(field_nm.iter().zip(shown).map(|(a, b)| a + b).collect());
    }
    drawn
}

/// RMS over the glass, piston removed, and RMS of what `wavefronts` differ by.
fn rms_nm(retriever: &Retriever, wavefront_nm: impl Iterator<Item = f64>) -> f64 {
    let glass = retriever.glass();
    let inside: Vec<f64> = wavefront_nm.zip(&glass).filter(|(_, glass)| **glass > 0.9).map(|(nm, _)| nm).collect();
    let mean = inside.iter().sum::<f64>() / inside.len() as f64;
    (inside.iter().map(|nm| (nm - mean).powi(2)).sum::<f64>() / inside.len() as f64).sqrt()
}

fn cube<'a>(drawn: &'a Drawn, bad: &'a Array3<bool>) -> Cube<'a> {
    Cube { images_e: drawn.images_e.view(), bad: bad.view(), read_noise_e: None }
}

pub(crate) fn prior() -> Spectrum {
    Spectrum::of_scene(&scene(), Unknown { piston_rms_nm: 0.0, ncpa_rms_nm: 40.0 }).unwrap()
}

#[test]
fn wavefronts_drawn_are_retrieved_from_their_images() {
    let (scene, prior) = (scene(), prior());
    let recipe = RetrievalRecipe { piston_rms_nm: 60.0, ..RetrievalRecipe::default() };
    let retriever = Retriever::new(&scene, &prior, recipe).unwrap();
    let mut retrieved = 0;
    for noise in [false, true] {
        let drawn = draw(&retriever, &prior, 3, noise);
        let bad = drawn.images_e.mapv(|_| false);
        let found = retriever.retrieve(cube(&drawn, &bad), None, None, &|_| {}).unwrap();
        for (image, truth_nm) in drawn.wavefronts_nm.iter().enumerate() {
            let report = &found.reports[image];
            let error_nm: Vec<f64> = found.phase_nm.row(image).iter().zip(truth_nm).map(|(a, b)| a - b).collect();
            let size = rms_nm(&retriever, truth_nm.iter().copied());
            let (all, coarse) = (rms_nm(&retriever, error_nm.iter().copied()), coarse_rms_nm(&retriever, &error_nm));
            println!("noise {noise} image {image}: {all:.1} and {coarse:.1} of {size:.1} nm, {report:?}");
            assert!(report.reason.converged(), "{report:?}");
            // Now and then a wrong minimum is met, the more so the smaller the pupil: χ² tells it, at five and more times
            // what finer turbulence leaves.
            if report.reduced_chi2 > 10.0 {
                continue;
            }
            retrieved += 1;
            // Beyond 30 λ/D, 2.7 cycles/m, the image is not looked at, and the spot around each frequency's light is 21
            // wide: between 1 and 4.5 cycles/m ever less is seen. The turbulence has 0.0863·(f·r0)^(−5/3) rad² at 500 nm
            // beyond f: 47 nm from 2.7 on, 31 from 4.5 on.
            assert!(all < 40.0, "image {image}: {all} of {size} nm");
            // Where the mirror acts all is seen; what stands against it is that the fit stops at a hundredth of χ².
            assert!(coarse < 0.07 * size, "image {image}: {coarse} of {size} nm");
        }
    }
    // The same wavefronts without and with noise, of which one meets a wrong minimum either way.
    assert!(retrieved >= 4, "{retrieved} of 6");
}

/// RMS of the means over squares of a lenslet's size, full ones alone.
fn coarse_rms_nm(retriever: &Retriever, wavefront_nm: &[f64]) -> f64 {
    const SIDE_M: f64 = 0.5625;
    let mut squares = std::collections::BTreeMap::<(i64, i64), Vec<f64>>::new();
    for ((&nm, &(x_m, y_m)), glass) in wavefront_nm.iter().zip(retriever.points_m()).zip(retriever.glass()) {
        if glass > 0.9 {
            squares.entry(((x_m / SIDE_M).floor() as i64, (y_m / SIDE_M).floor() as i64)).or_default().push(nm);
        }
    }
    let most = squares.values().map(Vec::len).max().unwrap_or(0);
    let full = squares.values().filter(|square| 2 * square.len() > most);
    let means: Vec<f64> = full.map(|square| square.iter().sum::<f64>() / square.len() as f64).collect();
    let mean = means.iter().sum::<f64>() / means.len() as f64;
    (means.iter().map(|nm| (nm - mean).powi(2)).sum::<f64>() / means.len() as f64).sqrt()
}

/// The whole batch on one thread and on three, and each image alone: the same bits.
#[test]
fn threads_and_batches_do_not_matter() {
    let (scene, prior) = (scene(), prior());
    let recipe = RetrievalRecipe { max_evaluations: 12, ..RetrievalRecipe::default() };
    let retriever = Retriever::new(&scene, &prior, recipe).unwrap();
    let drawn = draw(&retriever, &prior, 3, true);
    let bad = drawn.images_e.mapv(|_| false);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| retriever.retrieve(cube(&drawn, &bad), None, None, &|_| {}).unwrap())
    };
    let (one, three) = (on(1), on(3));
    assert_eq!(one.phase_nm, three.phase_nm);
    assert_eq!(one.reports, three.reports);
    let last =
        Cube { images_e: drawn.images_e.slice(s![2.., .., ..]), bad: bad.slice(s![2.., .., ..]), read_noise_e: None };
    let alone = retriever.retrieve(last, None, None, &|_| {}).unwrap();
    assert_eq!(alone.phase_nm.row(0), one.phase_nm.row(2));
}

/// About the true static wavefront less is left to find: the same wavefront, sooner or better.
#[test]
fn statics_are_where_the_search_begins() {
    let (scene, prior) = (scene(), prior());
    let retriever = Retriever::new(&scene, &prior, RetrievalRecipe::default()).unwrap();
    let drawn = draw(&retriever, &prior, 1, true);
    let bad = drawn.images_e.mapv(|_| false);
    let truth_nm = &drawn.wavefronts_nm[0];
    let segments = retriever.model().segment_modes;
    let zero = Statics { segments_nm: vec![0.0; segments], map_nm: vec![0.0; truth_nm.len()] };
    let plain = retriever.retrieve(cube(&drawn, &bad), None, None, &|_| {}).unwrap();
    let at_zero = retriever.retrieve(cube(&drawn, &bad), Some(&zero), None, &|_| {}).unwrap();
    assert_eq!(plain.phase_nm, at_zero.phase_nm);
    // All of it known: the first gradient is the noise's.
    let pistons: Vec<f64> = (0..segments).map(|segment| 60.0 * (2.4 * segment as f64).sin()).collect();
    let shown = retriever.shown_nm(&pistons);
    let map_nm = truth_nm.iter().zip(&shown).map(|(truth, shown)| truth - shown).collect();
    let known = Statics { segments_nm: pistons, map_nm };
    let found = retriever.retrieve(cube(&drawn, &bad), Some(&known), None, &|_| {}).unwrap();
    let error = rms_nm(&retriever, found.phase_nm.row(0).iter().zip(truth_nm).map(|(a, b)| a - b));
    println!("{error} nm from the truth, {:?}", found.reports[0]);
    assert!(found.reports[0].evaluations < plain.reports[0].evaluations);
    assert!((found.reports[0].reduced_chi2 - 1.0).abs() < 0.2, "{:?}", found.reports[0]);
    assert!(
        retriever.retrieve(cube(&drawn, &bad), Some(&Statics { segments_nm: vec![], ..zero }), None, &|_| {}).is_err()
    );
}

#[test]
fn images_without_a_star_are_refused_and_the_others_retrieved() {
    let (scene, prior) = (scene(), prior());
    let recipe = RetrievalRecipe { max_evaluations: 3, precision: Precision::F64, ..RetrievalRecipe::default() };
    let retriever = Retriever::new(&scene, &prior, recipe).unwrap();
    let mut drawn = draw(&retriever, &prior, 2, true);
    drawn.images_e.slice_mut(s![0, .., ..]).fill(5.0);
    let bad = drawn.images_e.mapv(|_| false);
    let found = retriever.retrieve(cube(&drawn, &bad), None, None, &|_| {}).unwrap();
    assert!(found.reports[0].refusal.is_some() && found.phase_nm.row(0).iter().all(|nm| nm.is_nan()));
    assert!(found.reports[1].refusal.is_none() && found.phase_nm.row(1).iter().all(|nm| nm.is_finite()));
    let raised = std::sync::Arc::new(std::sync::atomic::AtomicBool::new(true));
    let stopped = retriever.retrieve(cube(&drawn, &bad), None, Some(&raised), &|_| {});
    assert!(matches!(stopped, Err(crate::Error::Interrupted(_))));
}

/// Fields drawn from a spectrum, looked at through the pupil, give it back.
#[test]
fn a_spectrum_measured_from_phases_is_the_one_they_were_drawn_from() {
    let (scene, prior) = (scene(), prior());
    let retriever = Retriever::new(&scene, &prior, RetrievalRecipe::default()).unwrap();
    let model = retriever.model();
    let samples = model.optics.sampling().samples;
    let grid = crate::grid::Grid::new(samples, model.width_ratio() * model.telescope.pupil.grid.width_m()).unwrap();
    let lit: Vec<usize> = model.optics.parts().weights.lit.iter().map(|&place| place as usize).collect();
    let map = |values: &[f64]| {
        let mut map = ndarray::Array2::zeros((samples, samples));
        lit.iter().zip(values).for_each(|(place, &value)| map[[place / samples, place % samples]] = value);
        map
    };
    let glass: Vec<f64> = retriever.glass().iter().map(|glass| glass.clamp(0.0, 1.0)).collect();
    let mut average = crate::metrics::PsdAverage::windowed(grid, map(&glass).view(), 1).unwrap();
    (0..100).for_each(|seed| average.add(map(&retriever.draw_nm(&prior, seed)).view()).unwrap());
    let floor = prior.scaled(1e-6).unwrap();
    let measured = Spectrum::measured(&average.mean().unwrap(), &floor).unwrap();
    for f_per_m in [0.6, 0.9, 1.2, 1.8, 2.4] {
        let (found, drawn) = (measured.at(f_per_m), prior.at(f_per_m));
        // A hundred fields on rings of ten frequencies and more: 3 %. The pupil's edge smears the spectrum over a cycle of
        // its width, 0.2 cycles/m, over which it changes by up to a third.
        assert!((found / drawn - 1.0).abs() < 0.25, "{f_per_m}: {found} {drawn}");
    }
    let [found, drawn] = [&measured, &prior].map(|spectrum| spectrum.variance_nm2(0.3, 4.0));
    assert!((found / drawn - 1.0).abs() < 0.15, "{found} {drawn}");
}

/// On a device, three at a time, what the CPU finds image by image; a frame without a star among them.
#[cfg(feature = "opencl")]
#[test]
fn a_device_finds_in_lock_step_what_the_cpu_finds() {
    let (scene, prior) = (scene(), prior());
    let recipe = |device, precision| RetrievalRecipe {
        device,
        precision,
        most_together: 3,
        max_evaluations: 60,
        ..RetrievalRecipe::default()
    };
    let on = |device, precision| Retriever::new(&scene, &prior, recipe(device, precision)).unwrap();
    let judge = on(Choice::Cpu, Precision::F64);
    let mut drawn = draw(&judge, &prior, 7, true);
    drawn.images_e.slice_mut(s![1, .., ..]).fill(5.0);
    let bad = drawn.images_e.mapv(|_| false);
    let wanted = judge.retrieve(cube(&drawn, &bad), None, None, &|_| {}).unwrap();
    for info in crate::device::tests::test_devices() {
        for precision in [Precision::F64, Precision::F32].into_iter().filter(|&precision| info.supports(precision)) {
            let retriever = on(info.address().parse().unwrap(), precision);
            let most = std::sync::atomic::AtomicUsize::new(0);
            let watch = |done: usize| {
                most.fetch_max(done, std::sync::atomic::Ordering::Relaxed);
            };
            let found = retriever.retrieve(cube(&drawn, &bad), None, None, &watch).unwrap();
            assert_eq!(most.into_inner(), 7);
            let (name, failure) = retriever.device();
            assert!(name.starts_with(&info.address()) && failure.is_none(), "{name} {failure:?}");
            assert!(found.reports[1].refusal.is_some() && found.phase_nm.row(1).iter().all(|nm| nm.is_nan()));
            let statics = Statics { segments_nm: vec![0.0; 7], map_nm: vec![0.0; retriever.points_m().len()] };
            let again = retriever.retrieve(cube(&drawn, &bad), Some(&statics), None, &|_| {}).unwrap();
            assert_eq!(again.phase_nm.row(0), found.phase_nm.row(0), "the same bits from the same input");
            for image in [0, 2, 3, 4, 5, 6] {
                let (one, other) = (&found.reports[image], &wanted.reports[image]);
                let pairs = found.phase_nm.row(image).into_iter().zip(wanted.phase_nm.row(image));
                let apart = rms_nm(&retriever, pairs.map(|(a, b)| a - b));
                println!("{precision} image {image}: {apart:.1e} nm apart, {one:?}");
                // In f64 the same steps, whose roundings grow a little with each: 4e-11 nm are seen. In f32 they grow to other
                // steps towards the same minimum, which end within a deviation or so of it: 0.6 nm are seen, and 14 nm is
                // what a retrieval's own error is.
                let allowed = if precision == Precision::F64 { 1e-6 } else { 2.0 };
                assert!(apart < allowed, "{precision} image {image}: {apart} nm");
                if precision == Precision::F64 {
                    assert_eq!((one.evaluations, one.reason), (other.evaluations, other.reason));
                }
            }
            let raised = std::sync::Arc::new(std::sync::atomic::AtomicBool::new(true));
            let stopped = retriever.retrieve(cube(&drawn, &bad), None, Some(&raised), &|_| {});
            assert!(matches!(stopped, Err(crate::Error::Interrupted(_))));
        }
    }
    let nowhere = recipe(Choice::OpenClAt(99, 0), Precision::F32);
    assert!(matches!(Retriever::new(&scene, &prior, nowhere).err(), Some(crate::Error::Device(_))));
}
