//! The estimator end to end on a small telescope: seven hexagons, Zernike NCPA.

mod agreement;
mod arrays;
mod diversity;
mod optics;
mod sequence;
mod session;

use crate::common::source_images;
use cophase::Control;
use cophase::imaging::{Chain, Precision};
use cophase::modal::{Cube, ModalEstimate, ModalFitter, ModelCache, Recipe, Refusal, Status, fitter_of};
use cophase::scene::{Scene, System};
use cophase::source::SourceImages;
use ndarray::{Array2, Array3, Axis, s};

/// Seven segments and 11 Zernikes, 48 samples, images of 32 λ/D at 3 pixels per λ/D (no reduction).
fn scene(settings: &[(&str, &str)]) -> Scene {
    let small = [
        ("pupil.aperture", "hexagonal"),
        ("pupil.rings", "1"),
        ("pupil.grid_m", "4.8"),
        ("pupil.samples", "64"),
        ("image.samples_per_lambda_over_d", "3"),
        ("image.pixels", "132"),
        ("image.diversity_focus_waves_rms", "0.8"),
        ("aberrations.truth_samples", "512"),
        ("aberrations.ncpa_zernikes", "[4, 11]"),
        ("modes.ncpa", "zernike"),
        ("modes.ncpa_count", "12"),
        ("modes.exact_zernikes", "none"),
    ];
    Scene::preset("keck-artificial").unwrap().with(&small).unwrap().with(settings).unwrap()
}

fn fitter_of_scene(scene: &System, cube: Cube) -> cophase::Result<ModalFitter> {
    fitter_of(scene, Recipe::with_prior(scene), &ModelCache::default(), cube, &Control::default())
}

fn estimate(scene: &System, images_e: &Array3<f64>, bad: &Array3<bool>) -> (ModalFitter, ModalEstimate) {
    let cube = Cube { images_e: images_e.view(), bad: bad.view(), read_noise_e: None };
    let fitter = fitter_of_scene(scene, cube).unwrap();
    let mut chain = Chain::cpu(fitter.model().optics.clone(), Precision::F64);
    let found = fitter.estimate(&mut chain, cube, &Control::default()).unwrap();
    (fitter, found)
}

/// Peak signal-to-noise ratio at which the error of this coarse model, half the noise at 500, is
/// explained.
const EXPLAINED_SNR: (&str, &str) = ("image.peak_snr", "200");

/// Error bars of the noise: what the modes leave out would hold the errors of the coarse model,
/// which look like errors of the camera.
const NOISE_ALONE: (&str, &str) = ("estimate.posterior", "false");

/// Residuals of phasing and NCPA, nm.
fn residuals(estimator: &ModalFitter, estimate: &ModalEstimate, made: &SourceImages) -> [f64; 2] {
    let pupil = &estimator.model().telescope.pupil;
    [
        (&estimate.combined.maps.phasing_nm, &made.truth.phasing_nm),
        (&estimate.combined.maps.ncpa_nm, &made.truth.ncpa_nm),
    ]
    .map(|(found, truth)| {
        let difference: Array2<f64> = found - truth;
        pupil.rms(pupil.remove_piston_tip_tilt(difference.view()).unwrap().view()).unwrap()
    })
}

/// What the error bars promise for both maps, nm (tip and tilt kept, so a little more than the
/// residuals).
fn promised(estimator: &ModalFitter, estimate: &ModalEstimate) -> [f64; 2] {
    let pupil = &estimator.model().telescope.pupil;
    let sigma_maps = &estimate.combined.sigma_maps;
    [&sigma_maps.phasing_nm, &sigma_maps.ncpa_nm]
        .map(|map| pupil.rms(map.mapv(|v| if v.is_nan() { 0.0 } else { v }).view()).unwrap())
}

#[test]
fn one_image_gives_both_maps_within_their_error_bars() {
    let scene = scene(&[EXPLAINED_SNR, ("pupil.samples", "128"), ("aberrations.truth_samples", "1024")]);
    let made = source_images(&scene);
    let bad = made.images_e.mapv(|_| false);
    let (estimator, found) = estimate(&scene, &made.images_e, &bad);
    assert_eq!(found.images[0].status, Status::Ok, "{:?}", found.images[0]);
    for (residual, promised) in residuals(&estimator, &found, &made).into_iter().zip(promised(&estimator, &found)) {
        println!("residual {residual:.3} nm, promised {promised:.3} nm");
        // An RMS over some ten independent directions scatters by 1/√20 of itself: 22 %; three of
        // these above, and far below would mean error bars that promise nothing.
        assert!(residual < 1.7 * promised && residual > 0.2 * promised);
    }
}

#[test]
fn large_defocuses_are_fitted_on_more_samples() {
    let fitted = |waves: &str, samples: Option<&str>| {
        // In a frame of 132 pixels the reduction of what its edge cuts off would leave a χ² of 1.3.
        let own = [("image.diversity_focus_waves_rms", waves), ("image.pixels", "192")].into_iter();
        let own = own.chain(samples.map(|samples| ("estimate.samples", samples)));
        let scene = scene(&own.collect::<Vec<_>>());
        let made = source_images(&scene);
        let (fitter, found) = estimate(&scene, &made.images_e, &made.images_e.mapv(|_| false));
        let ratios = residuals(&fitter, &found, &made).into_iter().zip(promised(&fitter, &found)).map(|(a, b)| a / b);
        let samples = fitter.model().optics.sampling().samples;
        println!("{waves} waves: {samples} samples, χ² {}", found.reduced_chi2());
        (samples, found.reduced_chi2(), ratios.fold(0.0, f64::max))
    };
    // Those of the scene carry all light of the spot.
    assert_eq!(fitted("0.5", None).0, 64);
    // They do not.
    let (few, more) = (fitted("1.2", Some("64")), fitted("1.2", None));
    assert!(few.0 == 64 && few.1 > 10.0, "{few:?}");
    assert!(more.0 > 64 && more.1 < 1.1 && more.2 < 1.8, "{more:?}");
}

#[test]
fn outlier_pixels_are_rejected_in_images_with_a_misfit() {
    // Each pixel by itself, and four of nine in one, where a hole would be smeared.
    for sampling in ["native", "nyquist"] {
        let scene = scene(&[EXPLAINED_SNR, NOISE_ALONE, ("estimate.sampling", sampling)]);
        let made = source_images(&scene);
        let bad = made.images_e.mapv(|_| false);
        let (_, clean) = estimate(&scene, &made.images_e, &bad);
        assert_eq!(
            (clean.images[0].status, clean.images[0].rejected.total()),
            (Status::Ok, 0),
            "{:?}",
            clean.images[0]
        );
        let peak_e = made.images_e.iter().copied().fold(0.0, f64::max);
        let mut images_e = made.images_e.clone();
        // Hot, dead, and the track of a cosmic ray.
        images_e[[0, 70, 60]] += 10.0 * peak_e;
        let brightest = made.images_e.indexed_iter().max_by(|a, b| a.1.total_cmp(b.1)).unwrap().0;
        images_e[brightest] = 0.0;
        [(40, 90), (41, 91), (42, 92)].iter().for_each(|&(y, x)| images_e[[0, y, x]] += 0.3 * peak_e);
        let (estimator, found) = estimate(&scene, &images_e, &bad);
        let report = &found.images[0];
        assert_eq!((report.status, report.rejected.total()), (Status::Ok, 5), "{sampling}: {report:?}");
        for (residual, promised) in residuals(&estimator, &found, &made).into_iter().zip(promised(&estimator, &found)) {
            // As in the test above.
            assert!(residual < 1.7 * promised, "{sampling}: {residual} {promised}");
        }
        // The paper's way knows no noise that a pixel could stand out of.
        let paper = scene.with(&[("estimate.optimizer", "paper")]).unwrap();
        assert_eq!(estimate(&paper, &images_e, &bad).1.images[0].rejected.total(), 0);
    }
}

#[test]
fn bad_pixels_cost_nothing_when_marked() {
    let scene = scene(&[]);
    let made = source_images(&scene);
    let (mut images, mut bad) = (made.images_e.clone(), made.images_e.mapv(|_| false));
    for i in (7..images.len()).step_by(97) {
        let at = (0, i / 132 % 132, i % 132);
        // Marked hot pixels, and NaN without a mark.
        (images[at], bad[at]) = if i % 2 == 0 { (1e7, true) } else { (f64::NAN, false) };
    }
    bad.zip_mut_with(&images, |bad, value| *bad |= !value.is_finite());
    let (estimator, found) = estimate(&scene, &images, &bad);
    let whole = estimate(&scene, &made.images_e, &made.images_e.mapv(|_| false));
    assert!(found.images[0].bad_pixels > 20);
    let (with, without) = (residuals(&estimator, &found, &made), residuals(&whole.0, &whole.1, &made));
    for (with, without) in with.into_iter().zip(without) {
        // One per cent of the light is gone: the error moves by a tenth of itself or so.
        assert!(with < 1.3 * without, "{with} against {without}");
    }
}

#[test]
fn a_shifted_image_gives_the_same_maps_and_reports_the_shift() {
    let scene = scene(&[]);
    let made = source_images(&scene);
    let mut shifted = Array3::from_elem(made.images_e.dim(), 0.0);
    // Nine pixels to the right, five down.
    shifted.slice_mut(s![.., ..127, 9..]).assign(&made.images_e.slice(s![.., 5.., ..123]));
    let bad = shifted.mapv(|_| false);
    let (estimator, found) = estimate(&scene, &shifted, &bad);
    let here = estimate(&scene, &made.images_e, &bad).1;
    for (with, without) in residuals(&estimator, &found, &made).into_iter().zip(residuals(&estimator, &here, &made)) {
        // The same pixels are fitted but for those at the rim of the crop.
        assert!(with < 1.5 * without + 0.02, "{with} against {without}");
    }
    // λ/D over three pixels, times the RMS of x over the pupil.
    let pupil = &estimator.model().telescope.pupil;
    let x2: f64 = pupil.amplitude.indexed_iter().map(|((_, x), a)| a * pupil.grid.coordinate_m(x).powi(2)).sum();
    let per_pixel = 2168.6 / (3.0 * 4.8) * (x2 / pupil.weight_sum()).sqrt();
    let moved = [0, 1].map(|axis| found.images[0].tip_tilt_nm[axis] - here.images[0].tip_tilt_nm[axis]);
    println!("moved by {moved:?} nm RMS, {per_pixel} nm a pixel");
    // Tip and tilt of a bright star are known to well below a nanometre.
    assert!((moved[0] - 9.0 * per_pixel).abs() < 1.0 && (moved[1] + 5.0 * per_pixel).abs() < 1.0);
}

#[test]
fn a_mirrored_detector_is_undone_by_the_flip() {
    let plain = scene(&[]);
    let made = source_images(&plain);
    // Pixel 0 mirrors onto pixel 132, which is not there.
    let mut mirrored = made.images_e.clone();
    mirrored.slice_mut(s![.., .., 1..]).assign(&made.images_e.slice(s![.., .., 1..;-1]));
    // The library undoes what a detector that reads its columns backwards does: [.., ..;-1].
    let detector = made.images_e.slice(s![.., .., ..;-1]).to_owned();
    let bad = detector.mapv(|_| false);
    let (estimator, found) = estimate(&scene(&[("image.flip_x", "true")]), &detector, &bad);
    let mean = residuals(&estimator, &found, &made);
    // As good as the unflipped image: well under a nanometre, where the wrong handedness gives
    // tens.
    assert!(mean.iter().all(|residual| *residual < 0.5), "{mean:?}");
    let (estimator, wrong) = estimate(&plain, &mirrored, &bad);
    assert!(residuals(&estimator, &wrong, &made).iter().any(|residual| *residual > 20.0));
}

#[test]
fn a_sequence_averages_and_leaves_out_what_it_cannot_use() {
    // Bright images show the sampling of the pupil, which does not average out.
    let scene = scene(&[("image.count", "6"), ("image.peak_snr", "100")]);
    let mut made = source_images(&scene);
    let bad = made.images_e.mapv(|_| false);
    let (_, all) = estimate(&scene, &made.images_e, &bad);
    let one =
        estimate(&scene, &made.images_e.slice(s![..1, .., ..]).to_owned(), &bad.slice(s![..1, .., ..]).to_owned()).1;
    let ratio = all.combined.modes.sigma_nm()[0] / one.combined.modes.sigma_nm()[0];
    // √6 fewer, but for the scatter of six draws (a quarter or so) where that is larger.
    assert!(ratio > 0.9 / 6f64.sqrt() && ratio < 1.6 / 6f64.sqrt(), "{ratio}");
    made.images_e.index_axis_mut(Axis(0), 2).fill(4.0);
    let (estimator, found) = estimate(&scene, &made.images_e, &bad);
    assert_eq!(found.used(), 5);
    assert!(matches!(&found.images[2].status, Status::Unusable(Refusal::Constant { value }) if *value == 4.0));
    assert!(found.image_coefficients_nm.row(2).iter().all(|nm| nm.is_nan()));
    assert!(residuals(&estimator, &found, &made).iter().all(|residual| *residual < 1.5));
}

#[test]
fn segment_tip_and_tilt_are_found() {
    let scene = scene(&[
        ("modes.segment", "piston-tip-tilt"),
        ("aberrations.segment_tip_tilt_rms_nm", "20"),
        ("modes.ncpa_count", "6"),
        ("aberrations.ncpa_zernikes", "[4, 6]"),
        EXPLAINED_SNR,
    ]);
    let made = source_images(&scene);
    let bad = made.images_e.mapv(|_| false);
    let (estimator, found) = estimate(&scene, &made.images_e, &bad);
    assert_eq!(found.images[0].status, Status::Ok, "{:?}", found.images[0]);
    // Segments that tip and tilt can imitate focus and astigmatism closely: the sum is what the
    // image fixes.
    let pupil = &estimator.model().telescope.pupil;
    let total: Array2<f64> =
        &found.combined.maps.phasing_nm + &found.combined.maps.ncpa_nm - &made.truth.phasing_nm - &made.truth.ncpa_nm;
    let residual = pupil.rms(pupil.remove_piston_tip_tilt(total.view()).unwrap().view()).unwrap();
    println!("sum of both maps: {residual:.3} nm");
    // 27 modes at the bound of this image (about 0.1 nm), and the difference of a map sampled at
    // edges.
    assert!(residual < 1.0, "{residual}");
    // The tip and tilt of all segments together are those of the NCPA, which span them: the phasing
    // has none, and no warning is needed. What is left of a plane that the pistons were off by is
    // rounding; that of figures of a nanometre, which have none, is from the samples of their maps.
    let flat = pupil.remove_piston_tip_tilt(found.combined.maps.phasing_nm.view()).unwrap();
    let plane = pupil
        .rms((&found.combined.maps.phasing_nm - &flat).mapv(|nm| if nm.is_nan() { 0.0 } else { nm }).view())
        .unwrap();
    assert!(plane < 1e-3, "{plane} nm");
    let null = &found.degeneracy.null;
    assert!(null.len() == 3 && null.iter().all(|direction| estimator.is_global_motion(direction)), "{null:?}");
}

#[test]
fn the_same_input_gives_the_same_bits() {
    let scene = scene(&[("image.count", "2")]);
    let (a, b) = (source_images(&scene), source_images(&scene));
    assert_eq!(a.images_e, b.images_e);
    let bad = a.images_e.mapv(|_| false);
    let (x, y) = (estimate(&scene, &a.images_e, &bad).1, estimate(&scene, &b.images_e, &bad).1);
    assert_eq!(x.combined.modes.coefficients_nm, y.combined.modes.coefficients_nm);
    // And an image alone gives what it gave in company.
    let alone =
        estimate(&scene, &a.images_e.slice(s![1.., .., ..]).to_owned(), &bad.slice(s![1.., .., ..]).to_owned()).1;
    assert_eq!(alone.image_coefficients_nm.row(0), x.image_coefficients_nm.row(1));
}

/// A scene that reads its pupil from `file` in `folder`.
fn scene_of_file(folder: &std::path::Path, file: &str, grid_m: f64, segment: &str) -> Scene {
    let text = format!(
        "[pupil]\nfile = {file:?}\ngrid_m = {grid_m}\nsamples = 64\n\
         [image]\nwavelength_nm = 2168.6\npixels = 128\ndiversity_focus_waves_rms = 0.8\nread_noise_e = 60\n\
         [aberrations]\nsegment_piston_rms_nm = 40\nncpa_rms_nm = 60\nncpa_zernikes = [4, 11]\n\
         [modes]\nsegment = {segment:?}\nncpa = \"zernike\"\nncpa_count = 12\n"
    );
    Scene::from_text(&text, folder).unwrap()
}

#[test]
fn a_telescope_from_fine_maps_is_read_back() {
    use cophase::io::{FitsWriter, Pixel};
    use cophase::pupil::Grid;
    use cophase::pupil::{Aperture, HexagonalParameters};
    let folder = tempfile::tempdir().unwrap();
    let hexagons = HexagonalParameters {
        rings: 1,
        central_segment: true,
        obscuration_diameter_m: 0.6,
        ..HexagonalParameters::keck()
    };
    let pupil = Aperture::hexagonal(&hexagons).unwrap().pupil(&Grid::new(320, 4.8).unwrap()).unwrap();
    let mut file = FitsWriter::create(folder.path().join("pupil.fits")).unwrap();
    file.image("PUPIL", &pupil.amplitude, Pixel::F64, "").unwrap();
    file.image("SEGMENT", &pupil.owner.mapv(f64::from), Pixel::I32, "").unwrap();
    file.finish().unwrap();
    let scene = scene_of_file(folder.path(), "pupil.fits", 4.8, "piston");
    let made = source_images(&scene);
    let (estimator, found) = estimate(&scene, &made.images_e, &made.images_e.mapv(|_| false));
    let residuals = residuals(&estimator, &found, &made);
    println!("residuals {residuals:?}, chi2 {}", found.reduced_chi2());
    // Truth and model both take the map for the truth, at 320 samples and band-limited at 64: what
    // is left is noise (0.1 nm) and the band limit, which at this coarse sampling may be a few
    // times that.
    assert!(residuals.iter().all(|residual| *residual < 0.5), "{residuals:?}");
}

#[test]
fn the_real_keck_pupil_is_read_back() {
    let places = ["../shared/data", "../../shared/data"].map(std::path::Path::new);
    let Some(folder) = places.into_iter().find(|place| place.join("keck_pupil_open_240px.fits").exists()) else {
        println!("skipped: the real Keck pupil is not beside the project (../shared/data)");
        return;
    };
    // Secondary and spiders, no labels: one segment, whose piston nothing sees. 0.33 nm where edges
    // are not band-limited.
    let scene = scene_of_file(folder, "keck_pupil_open_240px.fits", 11.25, "none")
        .with(&[
            ("pupil.samples", "120"),
            ("image.pixels", "240"),
            ("image.diversity_focus_waves_rms", "1.5"),
            ("aberrations.segment_piston_rms_nm", "0"),
            NOISE_ALONE,
        ])
        .unwrap();
    let made = source_images(&scene);
    let (estimator, found) = estimate(&scene, &made.images_e, &made.images_e.mapv(|_| false));
    let [_, ncpa] = residuals(&estimator, &found, &made);
    println!("NCPA residual {ncpa:.3} nm, chi2 {}", found.reduced_chi2());
    assert!(ncpa < 0.25, "{ncpa}");
}
