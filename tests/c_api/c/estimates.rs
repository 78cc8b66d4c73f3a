//! What C sees of a model and of its fits is what Rust sees.

use super::super::fits::{are_those_of_rust, scenes};
use super::super::sky;
use super::{doubles, dumps, here, same};
use cophase::modal::ModalFitter;
use cophase::modes::Group;
use cophase::scene::Scene;
use ndarray::{Array2, ArrayView1, s};

#[test]
fn models_have_the_maps_of_rust() {
    let scene = here().join("tiny.toml");
    let estimator = ModalFitter::new(&Scene::from_file(&scene).unwrap(), false).unwrap();
    let model = estimator.model();
    dumps("model.c", &[&scene], |dump| {
        let dump = doubles(dump);
        let (coefficients_nm, maps) = dump.split_at(model.optics.modes());
        let wavefronts = [Group::Segment, Group::Ncpa].map(|group| model.map_nm(coefficients_nm, group));
        let psf = estimator.reference_chain().psf(ArrayView1::from(coefficients_nm));
        let expected = wavefronts.iter().flatten().chain(&psf).copied();
        same("the wavefronts and the PSF", maps, &expected.collect::<Vec<_>>());
        let turned = |map: &Array2<f64>| map.t() != map && map.slice(s![..;-1, ..]) != map;
        let psf = Array2::from_shape_vec((48, 48), psf).unwrap();
        assert!(turned(&wavefronts[1]) && turned(&psf), "what is compared would not show a turn or a flip");
    });
}

#[test]
fn fits_have_the_bits_of_rust() {
    let directory = tempfile::tempdir().unwrap();
    for scene in scenes(directory.path()) {
        dumps("session.c", &[&scene], |dump| are_those_of_rust(&scene, dump));
    }
}

#[test]
fn map_estimates_have_the_bits_of_rust() {
    dumps("estimator.c", &[&sky::scene()], sky::is_that_of_rust);
}
