//! Telescopes, modes and diversities that a caller gives as arrays.

use super::scene;
use crate::common::{assert_facts, source_images};
use cophase::Control;
use cophase::imaging::{Chain, Precision};
use cophase::io::{Column, FitsWriter, Pixel};
use cophase::modal::Cube;
use cophase::modal::{Arrays, ModalEstimate, ModalFitter, Status};
use cophase::pupil::Grid;
use cophase::scene::Scene;
use cophase::telescope::{Diversity, Telescope};
use ndarray::{Array2, Array3, ArrayView1, Axis, stack};
use std::path::Path;

const IMAGE: &str = "[image]\nwavelength_nm = 1000\npixels = 96\ncrop_pixels = 96\nread_noise_e = 10\n";

/// Modes of the caller's and no others.
const NO_OTHERS: &str = "[modes]\nexact_zernikes = 'none'\n";

fn for_arrays(text: &str) -> Scene {
    Scene::for_arrays(text, Path::new("")).unwrap()
}

fn fit(estimator: &ModalFitter, images_e: &Array3<f64>) -> ModalEstimate {
    let mut chain = Chain::cpu(estimator.model().optics.clone(), Precision::F64);
    let bad = images_e.mapv(|_| false);
    estimator
        .estimate(
            &mut chain,
            Cube { images_e: images_e.view(), bad: bad.view(), read_noise_e: None },
            &Control::default(),
        )
        .unwrap()
}

/// A telescope of one piece that no symmetry maps onto itself: a disc with a hole off its centre
/// and one vane, half-grey at the rim. Coordinates run from −1 to 1 over the grid.
fn lopsided(samples: usize) -> Array2<f64> {
    map(samples, |x, y| {
        let rim = (x * x + y * y).sqrt();
        let hole = (x - 0.2).hypot(y + 0.1) < 0.25;
        let vane = x > 0.0 && (y - 0.3 * x).abs() < 0.05;
        if hole || vane || rim > 0.95 {
            0.0
        } else if rim > 0.9 {
            0.5
        } else {
            1.0
        }
    })
}

fn map(samples: usize, value: impl Fn(f64, f64) -> f64) -> Array2<f64> {
    let grid = Grid::new(samples, 2.0).unwrap();
    Array2::from_shape_fn((samples, samples), |(y, x)| value(grid.coordinate_m(x), grid.coordinate_m(y)))
}

/// Five modes of a caller's own: neither orthogonal nor of unit RMS, NaN outside the pupil.
fn own_modes(amplitude: &Array2<f64>) -> Array3<f64> {
    let shapes: [fn(f64, f64) -> f64; 5] = [
        |x, _| 2.0 * x,
        |x, y| x * x + 2.0 * y * y,
        |x, y| 3.0 * x * y,
        |x, y| x * x * x - y,
        |x, y| (-8.0 * ((x + 0.4).powi(2) + (y - 0.5).powi(2))).exp(),
    ];
    let maps = shapes.map(|shape| {
        let mut mode = map(amplitude.nrows(), shape);
        mode.zip_mut_with(amplitude, |mode, a| *mode = if *a > 0.0 { *mode } else { f64::NAN });
        mode
    });
    stack(Axis(0), &maps.each_ref().map(|map| map.view())).unwrap()
}

fn own(samples: usize) -> Arrays {
    let amplitude = lopsided(samples);
    let modes = Some(own_modes(&amplitude));
    // A focus and an astigmatism of about half a wave RMS, so that signs can be told.
    let diversity_nm = Some(map(samples, |x, y| 1200.0 * (x * x + y * y) + 500.0 * x * y));
    Arrays { amplitude, segments: None, modes, diversity_nm }
}

#[test]
fn a_caller_s_telescope_and_modes_are_read_back() {
    let estimator = ModalFitter::from_arrays(&for_arrays(&format!("{IMAGE}{NO_OTHERS}")), &own(48)).unwrap();
    assert_eq!(estimator.model().basis.names(), ["mode-1", "mode-2", "mode-3", "mode-4", "mode-5"]);
    assert_eq!(estimator.model().segment_modes, 0);
    let truth = [30.0, -45.0, 25.0, 60.0, -80.0];
    let psf = Array2::from_shape_vec((96, 96), estimator.reference_chain().psf(ArrayView1::from(&truth))).unwrap();
    let images_e = (psf * 1e6 + 50.0).insert_axis(Axis(0));
    let found = fit(&estimator, &images_e);
    // An image without noise is no image of electrons, and is flagged.
    assert!(found.images[0].status == Status::Misfit && found.images[0].is_too_small());
    // Without noise all that is left is where the fit stops: no coefficient would move by more than
    // 1e-3 nm.
    let errors: Vec<f64> =
        found.combined.modes.coefficients_nm.iter().zip(truth).map(|(nm, truth)| nm - truth).collect();
    println!("errors {errors:?} nm in {} evaluations", found.images[0].evaluations);
    assert!(errors.iter().all(|error| error.abs() < 2e-3), "{errors:?}");
    // A map of the modes is what the caller's own matrix makes of the coefficients.
    let (x, y) = (10, 20);
    let expected: f64 = truth.iter().zip(own(48).modes.unwrap().outer_iter()).map(|(nm, mode)| nm * mode[[y, x]]).sum();
    assert!(
        (found.combined.maps.ncpa_nm[[y, x]] - expected).abs() < 1e-2,
        "{} against {expected}",
        found.combined.maps.ncpa_nm[[y, x]]
    );
}

#[test]
fn arrays_and_files_are_the_same_model() {
    let folder = tempfile::tempdir().unwrap();
    let plain = scene(&[]);
    let telescope = Telescope::new(&plain).unwrap();
    let pupil = &telescope.pupil;
    let diversity = Diversity::new(&plain, &telescope).unwrap();
    let at = |(y, x)| diversity.at(pupil.grid.coordinate_m(x), pupil.grid.coordinate_m(y));
    let diversity_nm = Array2::from_shape_fn(pupil.amplitude.dim(), at);
    let modes = ModalFitter::new(&plain.with_override("modes.segment", "none").unwrap(), false).unwrap();
    let modes = modes.model().basis.maps().to_owned();

    let mut file = FitsWriter::create(folder.path().join("pupil.fits")).unwrap();
    file.image("PUPIL", &pupil.amplitude, Pixel::F64, "").unwrap();
    file.image("SEGMENT", &pupil.owner.mapv(f64::from), Pixel::I32, "").unwrap();
    file.finish().unwrap();
    let mut file = FitsWriter::create(folder.path().join("modes.fits")).unwrap();
    file.image("BASIS", &modes, Pixel::F64, "").unwrap();
    let names: Vec<String> = (1..=modes.dim().0).map(|mode| format!("mode-{mode}")).collect();
    let groups = vec!["ncpa"; names.len()];
    file.table("MODES", &[Column::text("NAME", names), Column::text("GROUP", groups)]).unwrap();
    file.finish().unwrap();
    let mut file = FitsWriter::create(folder.path().join("diversity.fits")).unwrap();
    file.image("DIVERSITY", &diversity_nm, Pixel::F64, "nm").unwrap();
    file.finish().unwrap();

    let image = "[image]\nwavelength_nm = 2168.6\nsamples_per_lambda_over_d = 3\npixels = 132\nread_noise_e = 60\n";
    let files = format!(
        "{image}diversity_file = 'diversity.fits'\n[pupil]\nfile = 'pupil.fits'\ngrid_m = 4.8\nsamples = 64\nmodel = 'hard'\n\
         [modes]\nsegment = 'piston'\nfile = 'modes.fits'\nexact_zernikes = 'none'\n"
    );
    let of_files = ModalFitter::new(&Scene::from_text(&files, folder.path()).unwrap(), false).unwrap();
    let arrays = Arrays {
        amplitude: pupil.amplitude.clone(),
        segments: Some(pupil.owner.clone()),
        modes: Some(modes),
        diversity_nm: Some(diversity_nm),
    };
    // A planner cannot simulate what the scene does not describe: a budget is refused and not
    // ignored.
    let budget = format!("{image}[estimate]\nbudget_nm = 1\n");
    let error = ModalFitter::from_arrays(&for_arrays(&budget), &arrays).err().unwrap();
    assert!(error.to_string().contains("budget_nm"), "{error}");
    // The width is stated by the one and not by the other: nothing here has a length.
    let of_arrays = ModalFitter::from_arrays(&for_arrays(&format!("{image}{NO_OTHERS}")), &arrays).unwrap();
    assert_eq!(of_arrays.model().basis.names(), of_files.model().basis.names());
    assert_eq!(of_arrays.model().segment_modes, 7);
    assert_eq!(of_arrays.model().preparation, of_files.model().preparation);
    let coefficients_nm: Vec<f64> = (0..of_files.model().basis.len()).map(|i| 40.0 * (i as f64).sin()).collect();
    let psf = |estimator: &ModalFitter| estimator.reference_chain().psf(ArrayView1::from(&coefficients_nm));
    // Coordinates in units of other widths differ by roundings, which the diversity's interpolation
    // passes on.
    let (a, b) = (psf(&of_arrays), psf(&of_files));
    let peak = b.iter().copied().fold(0.0, f64::max);
    assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-11 * peak));
    let made = source_images(&plain);
    let (a, b) = (fit(&of_arrays, &made.images_e), fit(&of_files, &made.images_e));
    // Both stop within 1e-3 nm of one minimum.
    let (a, b) = (&a.combined.modes.coefficients_nm, &b.combined.modes.coefficients_nm);
    assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-3), "{a:?} and {b:?}");
}

#[test]
fn modes_of_the_scene_apply_without_mode_arrays() {
    let pupil = Telescope::new(&scene(&[])).unwrap().pupil;
    let arrays = Arrays { amplitude: pupil.amplitude, segments: Some(pupil.owner), modes: None, diversity_nm: None };
    let names = |text: &str, arrays: &Arrays| {
        let estimator = ModalFitter::from_arrays(&for_arrays(&format!("{IMAGE}{text}")), arrays).unwrap();
        estimator.model().basis.names().to_vec()
    };
    let zernike = "[modes]\nncpa = 'zernike'\nncpa_count = 4\nexact_zernikes = 'none'";
    assert_eq!(names(zernike, &arrays).len(), 11);
    assert_eq!(names("[modes]\nncpa = 'none'\nsegment = 'piston-tip-tilt'", &arrays).len(), 21);
    assert_eq!(names(&format!("{zernike}\nsegment = 'none'"), &arrays).len(), 4);
    assert_eq!(names("[modes]\nncpa = 'none'\nexact_zernikes = [2, 4]", &arrays).len(), 10);
    // A mirror has a pitch in metres.
    let kl = "[pupil]\ngrid_m = 4.8\n[modes]\nncpa = 'kl'\nncpa_count = 5\nexact_zernikes = 'none'";
    assert_eq!(names(kl, &arrays).len(), 12);
    // Modes of a caller's are not joined by those of segments that are not there, and by low
    // Zernikes unless the scene says otherwise.
    let own = own(48);
    assert_eq!(names("[modes]\nncpa = 'none'\nsegment = 'none'", &own).len(), 5);
    let joined = names("[modes]\nexact_zernikes = [2, 4]", &own);
    // The caller's own span tip, and focus but for what is left of it beside astigmatism.
    assert_eq!(joined[..5], ["mode-1", "mode-2", "mode-3", "mode-4", "mode-5"]);
    assert!(joined.len() > 5, "{joined:?}");
    assert!(names("", &own).len() > joined.len());
}

/// A pupil of more samples than the model's, without a section [modes]: the same modes on the same
/// grid, to the last bit.
#[test]
fn fine_arrays_and_files_are_the_same_model_by_default() {
    let folder = tempfile::tempdir().unwrap();
    let telescope = Telescope::new(&scene(&[])).unwrap();
    let fine = telescope.pupil_on(Grid::new(512, telescope.pupil.grid.width_m()).unwrap()).unwrap();
    let diversity_nm = map(512, |x, y| 2000.0 * (x * x + y * y) + 300.0 * x * y);
    let mut file = FitsWriter::create(folder.path().join("pupil.fits")).unwrap();
    file.image("PUPIL", &fine.amplitude, Pixel::F64, "").unwrap();
    file.image("SEGMENT", &fine.owner.mapv(f64::from), Pixel::I32, "").unwrap();
    file.finish().unwrap();
    let mut file = FitsWriter::create(folder.path().join("diversity.fits")).unwrap();
    file.image("DIVERSITY", &diversity_nm, Pixel::F64, "nm").unwrap();
    file.finish().unwrap();
    // As wide as the default mirror, which has the 66 modes.
    let common = format!("{IMAGE}[pupil]\ngrid_m = 10.95\nsamples = 64\n");
    let files =
        format!("{common}file = 'pupil.fits'\n").replace("[image]", "[image]\ndiversity_file = 'diversity.fits'");
    let of_files = ModalFitter::new(&Scene::from_text(&files, folder.path()).unwrap(), false).unwrap();
    let arrays =
        Arrays { amplitude: fine.amplitude, segments: Some(fine.owner), modes: None, diversity_nm: Some(diversity_nm) };
    let of_arrays = ModalFitter::from_arrays(&for_arrays(&common), &arrays).unwrap();
    let (a, b) = (of_arrays.model(), of_files.model());
    assert_eq!((a.basis.names(), a.segment_modes, a.telescope.pupil.grid.samples()), (b.basis.names(), 7, 64));
    assert!(a.basis.len() > 7 + 66, "{}", a.basis.len());
    let coefficients_nm: Vec<f64> = (0..a.basis.len()).map(|i| 20.0 * (i as f64).sin()).collect();
    let psf = |fitter: &ModalFitter| fitter.reference_chain().psf(ArrayView1::from(&coefficients_nm));
    assert_eq!(psf(&of_arrays), psf(&of_files));
    // Without the width of the array there is no mirror.
    let error = ModalFitter::from_arrays(&for_arrays(IMAGE), &arrays).err().unwrap().to_string();
    assert!(error.contains("'pupil.grid_m' is missing"), "{error}");
}

#[test]
fn zero_and_duplicate_modes_are_in_the_degeneracy_report() {
    let mut arrays = own(48);
    let modes = arrays.modes.take().unwrap();
    let zero = Array2::zeros((48, 48));
    let views = [modes.index_axis(Axis(0), 1), zero.view(), modes.index_axis(Axis(0), 4), modes.index_axis(Axis(0), 4)];
    arrays.modes = Some(stack(Axis(0), &views).unwrap());
    let estimator = ModalFitter::from_arrays(&for_arrays(&format!("{IMAGE}{NO_OTHERS}")), &arrays).unwrap();
    let psf =
        Array2::from_shape_vec((96, 96), estimator.reference_chain().psf(ArrayView1::from(&[50.0, 0.0, -30.0, 0.0])));
    let found = fit(&estimator, &(psf.unwrap() * 1e6).insert_axis(Axis(0)));
    let nm = &found.combined.modes.coefficients_nm;
    // What the images see is found: the first mode, and the sum of the two that are one.
    assert!((nm[0] - 50.0).abs() < 2e-3 && (nm[2] + nm[3] + 30.0).abs() < 4e-3, "{nm:?}");
    let report = found.degeneracy.to_string();
    println!("{report}");
    assert!(report.contains("mode-2") && report.contains("mode-3") && report.contains("mode-4"), "{report}");
}

#[test]
fn arrays_that_cannot_be_used_are_refused_with_the_reason() {
    type Change = fn(&mut Arrays);
    let cases: [(&str, Change, &str); 14] = [
        ("", |a| a.amplitude = Array2::ones((48, 50)), "50x48 samples | square | even side"),
        ("", |a| a.amplitude = Array2::ones((47, 47)), "47x47 samples | square | even side"),
        ("", |a| a.amplitude = Array2::zeros((0, 0)), "0 samples is impossible"),
        ("", |a| a.amplitude.fill(0.0), "amplitude is 0 everywhere"),
        ("", |a| a.amplitude[[3, 4]] = f64::NAN, "row 3, column 4 | NaN | [0, 1]"),
        ("", |a| a.amplitude[[3, 4]] = 1.5, "row 3, column 4 is 1.5"),
        ("", |a| a.segments = Some(Array2::zeros((48, 46))), "segment labels | 48 × 46 | 48 × 48"),
        ("", |a| a.segments = Some(Array2::from_elem((48, 48), -1)), "no segment label | 2 samples"),
        ("", |a| a.modes = Some(Array3::zeros((0, 48, 48))), "0 modes | at least one"),
        ("", |a| a.modes = Some(Array3::zeros((2, 48, 47))), "modes | 47x48 | pupil | 48x48"),
        ("", |a| a.modes.as_mut().unwrap()[[2, 24, 8]] = f64::INFINITY, "mode-3 | inf | row 24, column 8"),
        ("", |a| a.diversity_nm = Some(Array2::zeros((24, 24))), "diversity | 24x24 samples"),
        ("", |a| a.diversity_nm.as_mut().unwrap()[[24, 8]] = f64::NAN, "diversity | NaN | row 24, column 8"),
        ("[modes]\nsegment = 'piston-tip-tilt'", |_| (), "labels of the segments"),
    ];
    let without: [(&str, Change, &str); 2] = [
        ("[modes]\nncpa = 'none'", |a| a.modes = None, "no mode"),
        ("", |a| a.modes = None, "'pupil.grid_m' is missing"),
    ];
    for (text, change, wanted) in cases.into_iter().chain(without) {
        let mut arrays = own(48);
        change(&mut arrays);
        let error = ModalFitter::from_arrays(&for_arrays(&format!("{IMAGE}{text}")), &arrays).err();
        let sentence = error.unwrap_or_else(|| panic!("accepted: {wanted}")).to_string();
        assert_facts(&sentence, wanted);
    }
}

#[test]
fn a_scene_for_arrays_may_leave_out_what_the_arrays_say() {
    // A telescope of eight metres is no Keck, and modes of nobody's would be nothing to estimate:
    // not here.
    let text =
        "[pupil]\ngrid_m = 8\n[image]\nwavelength_nm = 1000\npixels = 96\n[modes]\nsegment = 'none'\nncpa = 'none'";
    let whole = Scene::from_text(text, Path::new("")).unwrap_err().to_string();
    assert_facts(&whole, "pupil.grid_m = 8");
    let scene = for_arrays(text).with_override("image.pixels", "64").unwrap();
    let estimator = ModalFitter::from_arrays(&scene, &own(48)).unwrap();
    assert_eq!(estimator.model().telescope.pupil.grid.width_m(), 8.0);
    // It is no telescope by itself.
    let alone = Telescope::new(&scene).err().unwrap().to_string();
    assert_facts(&alone, "pupil | array");
    // What no array says is still asked for.
    for (text, key) in [("", "image.wavelength_nm"), ("[image]\nwavelength_nm = 1000", "image.pixels")] {
        let missing = Scene::for_arrays(text, Path::new("")).unwrap_err().to_string();
        assert!(missing.contains(&format!("'{key}' is missing")), "{missing}");
    }
}
