//! What C sees of a model and of its fits is what Rust sees.

use super::{dumps, here, oblong, same};
use cophase::estimate::{Estimator, FitOptions, Session, SessionOptions};
use cophase::modes::Group;
use cophase::scene::Scene;
use ndarray::{Array2, ArrayView1, ArrayView2, ArrayView3, Axis};
use std::path::Path;
use std::sync::Arc;

fn estimator(scene: &Path) -> Estimator {
    Estimator::new(&Scene::from_file(scene).unwrap(), false).unwrap()
}

/// The `count` numbers that come next in a dump.
fn next<'a>(dump: &mut &'a [f64], count: usize) -> &'a [f64] {
    let (these, rest) = dump.split_at(count);
    *dump = rest;
    these
}

#[test]
fn models_have_the_maps_of_rust() {
    let scene = here().join("tiny.toml");
    let estimator = estimator(&scene);
    let model = estimator.model();
    for dump in dumps("model.c", &[&scene]) {
        let (coefficients_nm, maps) = dump.split_at(model.optics.modes());
        let wavefronts = [Group::Segment, Group::Ncpa].map(|group| model.map_nm(coefficients_nm, group));
        let psf = estimator.judge().psf(ArrayView1::from(coefficients_nm));
        let narrow = wavefronts.iter().flatten().chain(&psf).map(|&value| f64::from(value as f32));
        same("the wavefronts and the PSF", maps, narrow);
        let turned = |map: &Array2<f64>| map.t() != map && map.slice(ndarray::s![..;-1, ..]) != map;
        let psf = Array2::from_shape_vec((48, 48), psf).unwrap();
        assert!(turned(&wavefronts[1]) && turned(&psf), "what is compared would not show a turn or a flip");
    }
}

/// Number of frames in a dump of session.c.
const COUNT: usize = 3;

#[test]
fn fits_have_the_bits_of_rust() {
    let directory = tempfile::tempdir().unwrap();
    for scene in [here().join("tiny.toml"), oblong(directory.path())] {
        let estimator = Arc::new(estimator(&scene));
        let (rows, columns) = estimator.scene().image.frame_shape();
        let modes = estimator.model().optics.modes();
        let options = SessionOptions { capacity: COUNT, ..SessionOptions::default() };
        let mut session = Session::new(estimator, &options).unwrap();
        for dump in dumps("session.c", &[&scene]) {
            let mut dump = dump.as_slice();
            let frames = next(&mut dump, COUNT * rows * columns);
            let frames = ArrayView3::from_shape((COUNT, rows, columns), frames).unwrap();
            for (k, frame) in frames.axis_iter(Axis(0)).enumerate() {
                let (mut data_e, mut bad) = session.frame_mut(k).unwrap();
                data_e.assign(&frame);
                bad.fill(false);
            }
            session.fit(COUNT, &FitOptions::default()).unwrap();
            let fitted = session.results().iter().flat_map(|result| result.coefficients_nm.clone());
            same("the coefficients", next(&mut dump, COUNT * modes), fitted);
            same("the covariance", next(&mut dump, modes * modes), session.covariance_nm2(0).unwrap());
            session.load(COUNT, None).unwrap();
            let points_nm = ArrayView2::from_shape((COUNT, modes), next(&mut dump, COUNT * modes)).unwrap();
            let (mut objectives, mut gradients) = (vec![0.0; COUNT], vec![0.0; COUNT * modes]);
            session.evaluate(points_nm, &mut objectives, &mut gradients).unwrap();
            same("the objectives", next(&mut dump, COUNT), objectives);
            same("the gradients", next(&mut dump, COUNT * modes), gradients);
            assert!(dump.is_empty());
        }
    }
}
