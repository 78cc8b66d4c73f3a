//! MAP estimate by Rust of the exposures that a program in another language dumped with its own
//! estimate.

use super::fits;
use cophase::pipeline::{Estimator, Images};
use cophase::scene::Scene;
use ndarray::{Array2, Array3, s};
use std::path::{Path, PathBuf};

/// Number of exposures in a dump.
const COUNT: usize = 4;

pub(super) fn scene() -> PathBuf {
    super::here().join("sky.toml")
}

/// That a dump holds these numbers, to the last bit; under valgrind, whose processor rounds
/// otherwise, as many.
fn same(what: &str, dumped: &[f64], expected: &[f64]) {
    if is_emulated() {
        assert_eq!(dumped.len(), expected.len(), "{what}");
    } else {
        fits::same(what, dumped, expected);
    }
}

fn is_emulated() -> bool {
    std::env::var_os("COPHASE_C_RUNNER").is_some_and(|runner| !runner.is_empty())
}

/// That the dump's answers are Rust's, to the last bit. It holds, as doubles in C order: COUNT
/// frames; the slopes of each; coefficients, their error bars and covariance; maps of phasing, NCPA
/// and the error bars of both; the error budget; corrections of segments and actuators, where these
/// are, and those of the slopes.
pub(super) fn is_that_of_rust(dump: &Path) {
    let bytes = std::fs::read(dump).unwrap();
    let (values, rest) = bytes.as_chunks::<8>();
    assert!(rest.is_empty());
    let mut values = values.iter().map(|&bytes| f64::from_ne_bytes(bytes));
    let mut next = |count| -> Vec<f64> { values.by_ref().take(count).collect() };

    let scene = Scene::from_file(scene()).unwrap().with(&[("estimate.method", "full-phase")]).unwrap();
    let (rows, columns) = scene.image.frame_shape();
    let images_e = Array3::from_shape_vec((COUNT, rows, columns), next(COUNT * rows * columns)).unwrap();
    assert!(images_e != images_e.slice(s![.., ..;-1, ..]) && images_e != images_e.slice(s![.., .., ..;-1]));
    let slopes = cophase::ao::Simulator::new(&scene).unwrap().interaction().nrows();
    let slopes_mas = Array2::from_shape_vec((COUNT, slopes), next(COUNT * slopes)).unwrap();
    let images = Images { slopes_mas: Some(slopes_mas), ..Images::new(images_e) };
    let found = Estimator::new(&scene).unwrap().estimate(&images).unwrap();

    let modes = found.basis.names.len();
    let coefficients_nm = next(modes);
    same("coefficients", &coefficients_nm, &found.modes.coefficients_nm);
    // Rounded otherwise a retrieval stops somewhere else, within a fraction of what its noise
    // leaves.
    let pairs = coefficients_nm.iter().zip(&found.modes.coefficients_nm).zip(found.modes.sigma_nm());
    assert!(pairs.into_iter().all(|((dumped, here), sigma)| (dumped - here).abs() < sigma));
    same("error bars", &next(modes), &found.modes.sigma_nm());
    same("covariance", &next(modes * modes), &found.modes.covariance_nm2.iter().copied().collect::<Vec<_>>());
    for (what, map) in [
        ("phasing", &found.maps.phasing_nm),
        ("NCPA", &found.maps.ncpa_nm),
        ("error bars of phasing", &found.sigma_maps.phasing_nm),
        ("error bars of NCPA", &found.sigma_maps.ncpa_nm),
    ] {
        same(what, &next(map.len()), &map.iter().copied().collect::<Vec<_>>());
    }
    let budget: Vec<f64> = found.error_budget.iter().flat_map(|term| [term.phasing_nm, term.ncpa_nm]).collect();
    same("error budget", &next(budget.len()), &budget);
    let commands = found.corrections(None).unwrap();
    let (places, moves): (Vec<[f64; 2]>, Vec<f64>) = commands.actuators_nm.iter().copied().unzip();
    same("pistons to add", &next(commands.pistons_nm.len()), &commands.pistons_nm);
    same("commands to add", &next(moves.len()), &moves);
    same("actuators", &next(2 * places.len()), places.as_flattened());
    same("slopes to add", &next(slopes), &commands.slopes_mas);
    assert!(next(1).is_empty());
}
