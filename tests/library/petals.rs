//! Petals, the parts of a pupil that its spider separates: found in geometry and in maps, in the
//! truth and in estimates.

use super::full_phase::sky;
use crate::common::{assert_facts, images_of, simulated};
use cophase::Control;
use cophase::ao::{self, Shot, Simulator};
use cophase::pipeline::{Estimate, Estimator, Images};
use cophase::pupil::{Aperture, Grid, HexagonalParameters, Pupil, PupilParts};
use cophase::scene::Scene;
use cophase::source::{Truth, stream};
use cophase::telescope::Telescope;
use ndarray::{Array2, ArrayView2};
use std::path::Path;

/// Keck with six vanes, at Nyquist sampling.
fn keck(settings: &[(&str, &str)]) -> Scene {
    let nyquist = [("image.samples_per_lambda_over_d", "2"), ("image.pixels", "240")];
    Scene::preset("keck-nirc2").unwrap().with(&nyquist).unwrap().with(settings).unwrap()
}

/// Parts of a mirror like Keck's behind a spider of lines or of vanes.
fn parts(lines_deg: &[f64], vanes_deg: &[f64], rotation_deg: f64) -> PupilParts {
    let (spider_angles_deg, spider_vanes_deg) = (lines_deg.to_vec(), vanes_deg.to_vec());
    let keck = HexagonalParameters::keck();
    let parameters =
        HexagonalParameters { spider_width_m: 0.1, spider_angles_deg, spider_vanes_deg, rotation_deg, ..keck };
    Aperture::hexagonal(&parameters).unwrap().parts().clone()
}

/// The parts in the given directions.
fn parts_towards(parts: &PupilParts, directions_deg: impl Iterator<Item = f64>) -> Vec<usize> {
    let at = |degrees: f64| parts.part_at(3.0 * degrees.to_radians().cos(), 3.0 * degrees.to_radians().sin());
    directions_deg.map(at).collect()
}

#[test]
fn arms_divide_the_pupil_into_sectors_by_their_direction() {
    let every = |first_deg: f64, step_deg: f64, count: usize| (0..count).map(move |i| first_deg + step_deg * i as f64);
    let six = [0, 1, 2, 3, 4, 5];
    // The first is the one whose centre is nearest to +x on its counter-clockwise side.
    for (rotation_deg, first_deg) in [(0.0, 30.0), (20.0, 50.0), (-20.0, 10.0), (40.0, 10.0), (-30.0, 0.0)] {
        let parts = parts(&[0.0, 60.0, 120.0], &[], rotation_deg);
        assert_eq!(parts_towards(&parts, every(first_deg, 60.0, 6)), six, "{rotation_deg}");
    }
    let four = parts(&[], &[45.0, 135.0, 225.0, 315.0], 0.0);
    assert_eq!((four.count(), parts_towards(&four, every(0.0, 90.0, 4))), (4, vec![0, 1, 2, 3]));
    // A line is two vanes; one vane separates nothing.
    for (lines, vanes, count) in [(&[90.0][..], &[][..], 2), (&[90.0], &[270.0], 2), (&[], &[75.0], 1), (&[], &[], 1)] {
        assert_eq!(parts(lines, vanes, 0.0).count(), count, "{lines:?} {vanes:?}");
    }
}

/// Samples of 12 mm: gaps of 20 mm are dark strips of one or two samples, and arms of 60 mm of
/// five.
#[test]
fn maps_have_petals_of_their_spider_and_not_of_their_gaps() {
    let grid = Grid::new(960, 11.1).unwrap();
    let mirror = HexagonalParameters { gap_m: 0.02, obscuration_diameter_m: 2.6, ..HexagonalParameters::keck() };
    let whole = Aperture::hexagonal(&mirror).unwrap().pupil(&grid).unwrap();
    assert_eq!(PupilParts::of_maps(&whole).count(), 1);
    let spider = HexagonalParameters { spider_width_m: 0.06, spider_angles_deg: vec![10.0, 70.0, 130.0], ..mirror };
    let aperture = Aperture::hexagonal(&spider).unwrap();
    let pupil = aperture.pupil(&grid).unwrap();
    let (of_map, of_geometry) = (PupilParts::of_maps(&pupil), aperture.parts());
    assert_eq!((of_map.count(), of_geometry.count()), (6, 6));
    let bright = pupil.amplitude.indexed_iter().filter(|(_, a)| **a >= 0.5);
    let differ = bright.filter(|((y, x), _)| {
        let (x_m, y_m) = (grid.coordinate_m(*x), grid.coordinate_m(*y));
        of_map.part_at(x_m, y_m) != of_geometry.part_at(x_m, y_m)
    });
    assert_eq!(differ.count(), 0);
}

fn truth(scene: &Scene) -> (Pupil, Truth) {
    let telescope = Telescope::new(scene).unwrap();
    let truth = Truth::draw(scene, &telescope, &mut stream(1, 0)).unwrap();
    (telescope.pupil, truth)
}

/// Mean of a map over the six sectors of Keck, by the direction of each sample.
fn sector_means(pupil: &Pupil, map: ArrayView2<f64>) -> Vec<f64> {
    let mut sums = [[0.0; 2]; 6];
    for ((y, x), &a) in pupil.amplitude.indexed_iter().filter(|(_, a)| **a > 0.0) {
        let angle_rad = pupil.grid.coordinate_m(y).atan2(pupil.grid.coordinate_m(x)).rem_euclid(std::f64::consts::TAU);
        let [sum, weight] = &mut sums[(angle_rad / 60f64.to_radians()) as usize];
        (*sum, *weight) = (*sum + a * map[[y, x]], *weight + a);
    }
    sums.iter().map(|[sum, weight]| sum / weight).collect()
}

const PISTONS: (&str, &str) = ("aberrations.petal_coefficients_nm", "[300, -300, 300, -300, 300, -300]");
const PISTONS_NM: [f64; 6] = [300.0, -300.0, 300.0, -300.0, 300.0, -300.0];

#[test]
fn petals_are_added_to_the_ncpa_without_changing_other_draws() {
    let (pupil, before) = truth(&keck(&[]));
    let (_, given) = truth(&keck(&[PISTONS]));
    assert_eq!(before.piston_nm, given.piston_nm);
    let added: Array2<f64> = &given.ncpa_nm - &before.ncpa_nm;
    for (mean_nm, wanted_nm) in sector_means(&pupil, added.view()).iter().zip(PISTONS_NM) {
        // Sums of 2,000 samples.
        assert!((mean_nm - wanted_nm).abs() < 1e-9, "{mean_nm} {wanted_nm}");
    }
    let (_, drawn) = truth(&keck(&[("aberrations.petal_piston_rms_nm", "80")]));
    assert_eq!(before.piston_nm, drawn.piston_nm);
    let added_nm: Array2<f64> = &drawn.ncpa_nm - &before.ncpa_nm;
    // Exact but for the rounding of the sums over 8,000 samples.
    assert!((pupil.rms(added_nm.view()).unwrap() - 80.0).abs() < 1e-9);
    let centred_nm = pupil.remove_piston(added_nm.view()).unwrap();
    assert!(centred_nm.iter().zip(&added_nm).all(|(a, b)| a.is_nan() || (a - b).abs() < 1e-9));
}

fn estimate(scene: &Scene) -> Estimate {
    Estimator::new(scene).unwrap().estimate(&simulated(scene)).unwrap()
}

#[test]
#[ignore = "merge: 10 s"]
fn petals_of_300_nm_are_found_in_one_defocused_image() {
    let found = estimate(&keck(&[PISTONS, ("modes.petals", "piston"), ("estimate.model", "scene")]));
    let (_, residual) = found.truth.as_ref().unwrap();
    let left_nm = sector_means(&found.pupil, residual.maps.ncpa_nm.view());
    println!("errors of the petals, nm: {left_nm:.2?}; NCPA {:?} {:?}", residual.rms_nm, found.figures.ncpa);
    // Steps of 600 nm are at the nearest of samples that are four vanes wide: a misfit of 2.7 times
    // the noise, by which the error bar is widened. The error of the map is normal with that error
    // bar, of many modes, so twice of it is beyond chance.
    assert!(residual.rms_nm[1] < 2.0 * found.figures.ncpa.sigma_nm, "{:?} {:?}", residual.rms_nm, found.figures.ncpa);
    assert!(left_nm.iter().all(|nm| nm.abs() < 5.0), "{left_nm:?}");
}

/// A mirror of one piece behind four vanes, which has no segment modes.
#[test]
#[ignore = "merge: 26 s"]
fn pistons_tips_and_tilts_of_a_mirror_of_one_piece_are_found() {
    let settings = [
        ("pupil.aperture", "round"),
        ("pupil.rings", "0"),
        ("pupil.segment_side_m", "4"),
        ("pupil.central_obscuration_m", "1.1"),
        ("pupil.spider_width_m", "0.1"),
        ("pupil.spider_angles_deg", "[45, 135]"),
        ("pupil.grid_m", "8.4"),
        ("pupil.samples", "96"),
        ("aberrations.truth_samples", "768"),
        ("aberrations.segment_piston_rms_nm", "0"),
        ("aberrations.petal_piston_rms_nm", "150"),
        ("aberrations.petal_tip_tilt_rms_nm", "60"),
        ("estimate.model", "scene"),
    ];
    let found = ["none", "piston-tip-tilt"]
        .map(|petals| estimate(&keck(&settings).with_override("modes.petals", petals).unwrap()));
    let left_nm = found.each_ref().map(|found| found.truth.as_ref().unwrap().1.rms_nm[1]);
    println!("NCPA residuals without and with petals, nm: {left_nm:?}, error bar {:?}", found[1].figures.ncpa);
    assert!(found[1].basis.names.iter().any(|name| name == "petal-tilt-0"), "{:?}", found[1].basis.names);
    assert!(left_nm[0] > 10.0 * left_nm[1], "{left_nm:?}");
}

/// Petals behind a loop, in the mean of a sequence of retrieved wavefronts.
#[test]
#[ignore = "merge: 7 s"]
fn petals_are_static_modes_of_a_full_phase_estimate() {
    let settings = [
        ("estimate.method", "full-phase"),
        ("pupil.spider_width_m", "0.1"),
        ("pupil.spider_angles_deg", "[20, 80, 140]"),
        ("aberrations.petal_piston_rms_nm", "100"),
        ("image.count", "8"),
    ];
    let scene = Scene::from_file(sky()).unwrap().with(&settings).unwrap();
    let mut simulator = Simulator::new(&scene).unwrap();
    let mut shots: Vec<Shot> = Vec::new();
    let summary = simulator.run(&mut shots, &Control::default()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sky.fits");
    ao::write(&path, scene.text(), &simulator, &shots, &summary).unwrap();
    let images = images_of(&path, None);
    let [without, with] = ["none", "piston"].map(|petals| {
        let scene = scene.with_override("modes.petals", petals).unwrap();
        let found = Estimator::new(&scene).unwrap().estimate(&images).unwrap();
        (found.truth.as_ref().unwrap().1.rms_nm[1], found.figures.ncpa.sigma_nm)
    });
    println!("NCPA residual and error bar without and with petals, nm: {without:?} {with:?}");
    // 6 nm in place of 80: steps of 100 nm are far above what the turbulence of eight images
    // leaves.
    assert!(with.0 < 0.2 * without.0 && with.0 < 2.0 * with.1, "{without:?} {with:?}");
}

#[test]
fn petals_that_there_are_not_are_refused() {
    let refused = |scene: &Scene| match Estimator::new(scene)
        .and_then(|estimator| estimator.estimate(&Images::simulated(scene)?))
    {
        Ok(_) => panic!("not refused"),
        Err(error) => error.to_string(),
    };
    let whole = Scene::preset("keck-artificial").unwrap();
    let sentence = refused(&whole.with_override("modes.petals", "piston").unwrap());
    assert_facts(&sentence, "one part | petals | two or more");
    let sentence = refused(&keck(&[("aberrations.petal_coefficients_nm", "[1, 2]")]));
    assert_facts(&sentence, "2 numbers | 6, a piston | or 18");
    let both = [("aberrations.petal_piston_rms_nm", "10"), PISTONS];
    let sentence = Scene::preset("keck-nirc2").unwrap().with(&both).unwrap_err().to_string();
    assert_facts(&sentence, "'aberrations.petal_piston_rms_nm' | 'aberrations.petal_coefficients_nm' | both");
    let text = Scene::preset_text("keck-nirc2").unwrap();
    let text = text.replace("[modes] ", "[modes]\npetals = \"piston\"\nfile = \"modes.fits\" #");
    let text = text.replace("ncpa    = \"kl\"", "#").replace("ncpa_count", "#");
    let sentence = Scene::from_text(&text, Path::new("")).unwrap_err().to_string();
    assert_facts(&sentence, "'modes.petals' | no meaning | from a file");
}
