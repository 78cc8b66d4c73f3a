//! How long is a frame of the controller at Keck's size (296 actuators, 248 subapertures)?
//! `cargo bench --bench control`
//!
//! The matrices are random: only their sizes matter. A real loop does other work between two steps,
//! which may push the matrix out of the nearest cache: the second row of each law reads as much
//! memory in between as a pupil's screens.

use cophase::ao::{ControlLaw, Plant};
use cophase::scene::Scene;
use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use ndarray::Array2;
use std::hint::black_box;
use std::path::Path;

const ACROSS: usize = 20;
const SUBAPERTURES: usize = 248;
const ACTUATORS: usize = 296;

/// What the rest of a frame touches: seven layers of 240×240 in single precision.
const ELSEWHERE: usize = 7 * 240 * 240;

fn control(criterion: &mut Criterion) {
    let preset = Scene::preset_text("keck-onsky").expect("the preset is there");
    let (before, _) = preset.split_once("[control]").expect("it has a control section");
    let interaction =
        Array2::from_shape_fn((2 * SUBAPERTURES, ACTUATORS), |(i, j)| ((i * 7919 + j * 104_729) as f64).sin());
    let subapertures: Vec<usize> = (76..76 + SUBAPERTURES).collect();
    let mask: Vec<bool> = (0..SUBAPERTURES).map(|i| i % 7 == 3).collect();
    let plant = Plant {
        interaction: &interaction,
        lenslets_across: ACROSS,
        subapertures: &subapertures,
        mask: &mask,
        kl: None,
        command_matrix: None,
        actuator_grid: None,
        stroke_limit_nm: None,
    };
    let mut elsewhere = vec![1.0f32; ELSEWHERE];
    let mut group = criterion.benchmark_group("control step");
    for r#loop in ["closed", "pseudo-open-loop"] {
        let text = format!("{before}[control]\nfill = \"inpaint\"\nloop = {:?}\n", r#loop);
        let scene = Scene::from_text(&text, Path::new(".")).expect("a scene");
        let law = ControlLaw::new(scene.control.as_ref().expect("a control section"), &plant).expect("a law");
        let mut controller = law.start();
        let slopes: Vec<f32> = (0..2 * SUBAPERTURES).map(|i| 1e-3 * (i as f32).sin()).collect();
        group.bench_function(format!("{}, alone", r#loop), |bencher| {
            bencher.iter(|| controller.step(black_box(&slopes)));
        });
        group.bench_function(format!("{}, between other work", r#loop), |bencher| {
            bencher.iter_batched(
                || elsewhere.iter_mut().for_each(|value| *value = black_box(*value)),
                |()| controller.step(black_box(&slopes)),
                BatchSize::PerIteration,
            );
        });
    }
    group.finish();
}

criterion_group!(benches, control);
criterion_main!(benches);
