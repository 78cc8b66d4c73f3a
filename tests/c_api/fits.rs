//! What Rust makes of the frames that a program in another language dumped with its own answer.

use cophase::modal::{FitOptions, ModalFitter, Session, SessionOptions};
use cophase::scene::Scene;
use ndarray::{ArrayView2, ArrayView3, Axis};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Number of frames in a dump.
const COUNT: usize = 3;

/// The scene of the tests, and one with another detector: neither its rows nor its columns are
/// those of the image.
pub(super) fn scenes(directory: &Path) -> [PathBuf; 2] {
    let square = super::here().join("tiny.toml");
    let text = std::fs::read_to_string(&square).unwrap();
    let other = text.replace("pixels = 48\n", "pixels = 48\nrows = 36\ncolumns = 44\n");
    assert_ne!(text, other);
    let oblong = directory.join("oblong.toml");
    std::fs::write(&oblong, other).unwrap();
    [square, oblong]
}

/// That the dump's answers are Rust's, to the last bit. It holds, as doubles in C order: COUNT
/// frames; their coefficients; the covariance of the first; the true coefficients; objectives and
/// gradients there.
pub(super) fn are_those_of_rust(scene: &Path, dump: &Path) {
    let bytes = std::fs::read(dump).unwrap();
    let (values, rest) = bytes.as_chunks::<8>();
    assert!(rest.is_empty());
    let mut values = values.iter().map(|&bytes| f64::from_ne_bytes(bytes));
    let mut next = |count| -> Vec<f64> { values.by_ref().take(count).collect() };

    let estimator = Arc::new(ModalFitter::new(&Scene::from_file(scene).unwrap(), false).unwrap());
    let (rows, columns) = estimator.scene().image.frame_shape();
    let modes = estimator.model().optics.modes();
    let options = SessionOptions { capacity: COUNT, ..SessionOptions::default() };
    let mut session = Session::new(estimator, &options).unwrap();

    let frames = next(COUNT * rows * columns);
    let frames = ArrayView3::from_shape((COUNT, rows, columns), &frames).unwrap();
    for (k, frame) in frames.axis_iter(Axis(0)).enumerate() {
        assert!(frame != frame.slice(ndarray::s![..;-1, ..]) && frame != frame.slice(ndarray::s![.., ..;-1]));
        let (mut data_e, mut bad) = session.frame_mut(k, 0).unwrap();
        data_e.assign(&frame);
        bad.fill(false);
    }
    session.fit(COUNT, &FitOptions::default()).unwrap();
    let fitted: Vec<f64> = session.results().iter().flat_map(|result| result.coefficients_nm.clone()).collect();
    same("coefficients", &next(COUNT * modes), &fitted);
    let covariance_nm2: Vec<f64> = session.refine(0).unwrap().modes.covariance_nm2.into_iter().collect();
    same("covariance", &next(modes * modes), &covariance_nm2);

    let points_nm = next(COUNT * modes);
    let points_nm = ArrayView2::from_shape((COUNT, modes), &points_nm).unwrap();
    let (mut objectives, mut gradients) = (vec![0.0; COUNT], vec![0.0; COUNT * modes]);
    session.load(0, COUNT, None).unwrap();
    session.evaluate(0, points_nm, &mut objectives, &mut gradients).unwrap();
    same("objectives", &next(COUNT), &objectives);
    same("gradients", &next(COUNT * modes), &gradients);
    assert!(next(1).is_empty());
}

/// That a dump holds these numbers, to the last bit.
///
/// valgrind plays a processor without the widest vector units: other routines of the libraries run
/// there, which round otherwise, and a fit stops anywhere within its tolerance, 0.001 nm in
/// coefficients of 25 and more.
pub(super) fn same(what: &str, dumped: &[f64], expected: &[f64]) {
    if std::env::var_os("COPHASE_C_RUNNER").is_some_and(|runner| !runner.is_empty()) {
        let largest = expected.iter().fold(0.0f64, |most, value| most.max(value.abs()));
        let close = |(a, b): (&f64, &f64)| (a - b).abs() <= 1e-3 * largest || a.is_nan() && b.is_nan();
        assert!(dumped.len() == expected.len() && dumped.iter().zip(expected).all(close), "{what}");
        return;
    }
    let bits = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
    let (dumped, expected) = (bits(dumped), bits(expected));
    assert_eq!(dumped.len(), expected.len(), "{what}");
    let first = dumped.iter().zip(&expected).position(|(a, b)| a != b);
    assert_eq!(first, None, "{what}: the first value that differs");
}
