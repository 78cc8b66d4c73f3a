//! What does one objective with its gradient cost, per image? `cargo bench --bench evaluation`
//!
//! The paper's case (36 segment pistons and 66 Karhunen-Loève modes, 120×120 pupil samples with
//! grey edges, 240×240 pixels) and our default model of the same scene (band-limited pupil, tip,
//! tilt and focus more, cropped image), on every chain that is here, one image at a time and 200
//! together; the default model with three wavelengths and with pixels that have an area, too.
//! Throughput counts images. Coefficients differ from image to image, so that nothing can be
//! reused.

use cophase::device::{self, Choice, Precision};
use cophase::imaging::{Chain, Exposure};
use cophase::modal::{Frame, ModalFitter};
use cophase::scene::Scene;
use cophase::source;
use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use ndarray::Array2;

const BATCHES: [usize; 2] = [1, 200];

fn scenes() -> [(&'static str, Scene); 4] {
    let preset = Scene::preset("keck-artificial").expect("the preset is built in");
    let plain = [
        ("pupil.model", "hard"),
        ("modes.exact_zernikes", "none"),
        ("image.samples_per_lambda_over_d", "2"),
        ("image.pixels", "240"),
        ("image.crop_pixels", "240"),
    ];
    let paper = preset.with(&plain).expect("the keys exist");
    let ours = preset.with(&[("modes.exact_zernikes", "[2, 4]")]).expect("the key exists");
    let with = |keys: &[(&str, &str)]| ours.with(keys).expect("the keys exist");
    let colours = with(&[("image.bandwidth_fraction", "0.015"), ("estimate.wavelengths", "3")]);
    let area = with(&[("image.pixel_fill", "1")]);
    [
        ("paper 102 modes 120/240", paper),
        ("default 105 modes", ours),
        ("default, three wavelengths", colours),
        ("default, pixels with an area", area),
    ]
}

/// The chains that are here, CPU first.
fn chains(estimator: &ModalFitter, capacity: usize) -> Vec<(String, Chain)> {
    let optics = || estimator.model().optics.clone();
    let precisions = [Precision::F32, Precision::F64];
    let mut chains: Vec<_> = precisions.map(|p| (format!("cpu {p}"), Chain::cpu(optics(), p))).into();
    for info in device::devices().unwrap_or_default() {
        for precision in precisions.into_iter().filter(|&precision| info.supports(precision)) {
            let choice = Choice::OpenClAt(info.platform, info.device);
            match Chain::open(optics(), choice, precision, capacity) {
                Ok(chain) => chains.push((format!("{} {precision}", info.address()), chain)),
                Err(error) => eprintln!("left out: {error}"),
            }
        }
    }
    chains
}

fn exposure(scene: &Scene, estimator: &ModalFitter) -> Exposure {
    let made = source::simulate(scene).expect("the scene can be imaged").remove(0);
    let bad = made.images_e.mapv(|_| false);
    let frame = Frame {
        data_e: made.images_e.index_axis(ndarray::Axis(0), 0),
        bad: bad.index_axis(ndarray::Axis(0), 0),
        read_noise_e: scene.image.read_noise_e,
    };
    estimator.model().preparation.prepare(frame, estimator.recipe()).expect("the image holds a star").exposure
}

fn evaluation(criterion: &mut Criterion) {
    for (name, scene) in scenes() {
        let estimator = ModalFitter::new(&scene, false).expect("the scene has a model");
        let exposure = exposure(&scene, &estimator);
        let mut group = criterion.benchmark_group(name);
        group.sample_size(20);
        for batch in BATCHES {
            group.throughput(Throughput::Elements(batch as u64));
            let modes = estimator.model().optics.modes();
            let coefficients =
                Array2::from_shape_fn((batch, modes), |(image, mode)| 40.0 * ((7 * image + 3 * mode) as f64).sin());
            let images: Vec<usize> = (0..batch).collect();
            for (device, mut chain) in chains(&estimator, batch) {
                chain.load(&vec![exposure.clone(); batch]).expect("the images fit");
                group.bench_with_input(BenchmarkId::new(device, batch), &batch, |bencher, _| {
                    bencher.iter(|| chain.evaluate(&images, coefficients.view()).expect("the evaluation runs"))
                });
            }
        }
        group.finish();
    }
}

criterion_group!(benches, evaluation);
criterion_main!(benches);
