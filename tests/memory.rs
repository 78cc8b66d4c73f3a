//! Memory follows its formula, and what is cut into tiles comes out as it would whole.

mod common;

use common::source_images;
use cophase::imaging::{Chain, Precision};
use cophase::modal::{Cube, ModalFitter};
use cophase::pipeline::{Control, Stage};
use cophase::scene::Scene;
use ndarray::{Array1, Array3, Axis, s};
use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::sync::{Arc, Mutex};

/// The system's allocator, with a count of the bytes that stand.
struct Counting;

static STANDING: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

fn grown(bytes: usize) {
    let standing = STANDING.fetch_add(bytes, Relaxed) + bytes;
    PEAK.fetch_max(standing, Relaxed);
}

// SAFETY: every call is passed on to the system's allocator as it came.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        grown(layout.size());
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        STANDING.fetch_sub(layout.size(), Relaxed);
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        grown(layout.size());
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        grown(size);
        STANDING.fetch_sub(layout.size(), Relaxed);
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// One test at a time, lest one count another's bytes.
static ALONE: Mutex<()> = Mutex::new(());

fn alone() -> std::sync::MutexGuard<'static, ()> {
    ALONE.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
}

/// What `work` returns, and the most bytes that stood during it beyond those before.
fn peak<R>(work: impl FnOnce() -> R) -> (R, usize) {
    let before = STANDING.load(Relaxed);
    PEAK.store(before, Relaxed);
    let result = work();
    (result, PEAK.load(Relaxed).saturating_sub(before))
}

fn scene(settings: &[(&str, &str)]) -> Scene {
    let small = [
        ("pupil.aperture", "hexagonal"),
        ("pupil.rings", "1"),
        ("pupil.grid_m", "4.8"),
        ("pupil.samples", "64"),
        ("image.samples_per_lambda_over_d", "3"),
        ("image.pixels", "132"),
        ("image.diversity_focus_waves_rms", "0.8"),
        ("image.count", "7"),
        ("aberrations.truth_samples", "512"),
        ("aberrations.ncpa_zernikes", "[4, 8]"),
        ("modes.ncpa", "zernike"),
        ("modes.ncpa_count", "7"),
        ("modes.exact_zernikes", "none"),
    ];
    Scene::preset("keck-artificial").unwrap().with(&small).unwrap().with(settings).unwrap()
}

fn estimate_of(estimator: &ModalFitter, chain: &mut Chain, images_e: &Array3<f64>) -> cophase::modal::ModalEstimate {
    let bad = images_e.mapv(|_| false);
    let cube = Cube { images_e: images_e.view(), bad: bad.view(), read_noise_e: None };
    estimator.estimate(chain, cube, &Control::default()).unwrap()
}

/// `scene` with memory for `images` at once, and its limit in bytes.
fn limited(scene: &Scene, images: usize) -> (Scene, usize) {
    let memory = ModalFitter::new(scene, false).unwrap().model().memory(rayon::current_num_threads());
    let limit = memory.least_bytes() + 2 * (images - 1) * memory.fitted_image + memory.fitted_image;
    (scene.with_override("estimate.memory_gb", &format!("{}", limit as f64 / 1e9)).unwrap(), limit)
}

#[test]
fn a_cube_in_tiles_is_fitted_to_the_same_bits() {
    let _alone = alone();
    let (scene, _) = limited(&scene(&[]), 3);
    let images_e = source_images(&scene).images_e;
    let estimator = ModalFitter::new(&scene, false).unwrap();
    assert_eq!(estimator.model().tiles().images, 3);
    // Chains with room for a tile, not for the cube.
    for (name, mut chain) in common::chains(&estimator, 3) {
        let seen = Arc::new(Mutex::new(Vec::new()));
        let control = {
            let seen = seen.clone();
            Control::with_observer(move |progress| seen.lock().unwrap().push((progress.stage, progress.done)))
        };
        let bad = images_e.mapv(|_| false);
        let cube = Cube { images_e: images_e.view(), bad: bad.view(), read_noise_e: None };
        let together = estimator.estimate(&mut chain, cube, &control).unwrap();
        // Each image is a step, of which a device may end several at once; what follows the fits is
        // none.
        let seen = seen.lock().unwrap();
        let fits: Vec<u64> =
            seen.iter().filter(|(stage, _)| *stage != Stage::Combining).map(|(_, done)| *done).collect();
        assert!(fits.is_sorted() && fits.last() == Some(&7), "{name}: {fits:?}");
        assert_eq!(seen.last(), Some(&(Stage::Combining, 0)), "{name}");
        for image in 0..7 {
            let alone = estimate_of(&estimator, &mut chain, &images_e.slice(s![image..=image, .., ..]).to_owned());
            let (found, wanted) = (&together.image_coefficients_nm, &alone.image_coefficients_nm);
            assert_eq!(found.row(image), wanted.row(0), "{name}, image {image}");
            assert_eq!(together.images[image].evaluations, alone.images[0].evaluations, "{name}, image {image}");
        }
    }
}

#[test]
fn error_bars_from_tiles_are_those_of_the_whole() {
    let _alone = alone();
    let whole = scene(&[("modes.segment", "piston-tip-tilt")]);
    let (tiled, _) = limited(&whole, 1);
    let [whole, tiled] = [whole, tiled].map(|scene| ModalFitter::new(&scene, false).unwrap());
    let memory = whole.model().memory(1);
    assert!(tiled.model().tiles().derivative_bytes < memory.rows * memory.derivative_row / 2);
    let at = Array1::zeros(whole.model().optics.modes());
    let [whole, tiled] = [whole, tiled].map(|estimator| estimator.bound(at.view(), 1e6, 1.0).unwrap());
    let off = |(i, j)| (tiled[(i, j)] - whole[(i, j)]).abs() / (whole[(i, i)] * whole[(j, j)]).sqrt();
    let worst = whole.indexed_iter().map(|(at, _)| off(at)).fold(0.0, f64::max);
    // The matrices differ by 1e-12 of their diagonal at most, and inversion multiplies that by
    // their condition: no direction but piston is seen less than 1e-5 as well as another here.
    assert!(worst < 1e-7, "{worst:e}");
}

/// 91 segments that tilt, and seven Zernikes.
const LARGE: [(&str, &str); 5] = [
    ("pupil.rings", "5"),
    ("pupil.grid_m", "18"),
    ("pupil.samples", "128"),
    ("modes.segment", "piston-tip-tilt"),
    ("image.peak_snr", "200"),
];

#[test]
fn memory_stays_below_its_formula() {
    let _alone = alone();
    let whole = scene(&LARGE);
    let (tiled, limit) = limited(&whole, 1);
    let images_e = source_images(&whole).images_e;
    for (scene, limit) in [(&whole, 8_000_000_000), (&tiled, limit)] {
        let (memory, peak) = peak(|| {
            let estimator = ModalFitter::new(scene, false).unwrap();
            let mut chain = Chain::cpu(estimator.model().optics.clone(), Precision::F64);
            estimate_of(&estimator, &mut chain, &images_e);
            estimator.model().memory(rayon::current_num_threads())
        });
        let most = memory.most_bytes(images_e.len_of(Axis(0)), limit);
        println!("{peak} bytes, by the formula at most {most}");
        // `estimate_of` marks the bad pixels of the cube, which is not the estimator's.
        assert!(peak <= most + images_e.len(), "{peak} bytes where the formula has {most}");
        // An upper bound, but one that says something: not more than six times what a run takes,
        // beside the 64 MiB that it takes for granted.
        assert!(most - (64 << 20) < 6 * peak, "the formula has {most} bytes where {peak} were taken");
    }
}

#[test]
fn a_scene_that_memory_cannot_hold_is_refused() {
    let _alone = alone();
    let scene = scene(&LARGE);
    let least = ModalFitter::new(&scene, false).unwrap().model().memory(rayon::current_num_threads()).least_bytes();
    let refused =
        |gb: f64| ModalFitter::new(&scene.with_override("estimate.memory_gb", &format!("{gb}")).unwrap(), false);
    let sentence = refused(least as f64 / 1.1e9).err().unwrap().to_string();
    let allowed = (least as f64 / 1.1e9 * 1e9) as usize;
    assert!(sentence.contains(&format!("{least} bytes")) && sentence.contains(&format!("{allowed}")), "{sentence}");
    assert!(refused(least as f64 / 0.9e9).is_ok());
}
