//! What does a frame of the AO loop cost? `cargo bench --bench ao_loop`
//!
//! The `keck-onsky` scene: 240 samples, seven layers, 248 subapertures, 296 actuators, noise on.
//! `step` is one frame on one core, for each detector; `run` a whole run on all cores, settling and
//! one image included (divide by its 4,000 frames). `stage` is each stage of a frame of
//! `keck-onsky`, `tmt-onsky` and `elt-onsky` on one core, with its least work
//! (`cargo bench --bench ao_loop -- "stage/tmt-onsky"` builds that one only). `machine` is what the
//! stages are held against: multiply-adds in single precision from registers, and reading a
//! megabyte, on one core.

use cophase::Control;
use cophase::ao::{LANES, LoopStage, Shot, Simulator};
use cophase::scene::Scene;
use criterion::{Bencher, Criterion, criterion_group, criterion_main};
use std::hint::black_box;
use std::time::{Duration, Instant};

fn simulator(settings: &[(&str, &str)]) -> Simulator {
    let scene = Scene::preset("keck-onsky").expect("the preset is built in").with(settings).expect("the keys exist");
    Simulator::new(&scene).expect("the preset is buildable")
}

fn steps(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("step");
    for detector in ["quad-cell", "pixels", "geometric"] {
        let mut simulator = simulator(&[("wavefront_sensor.detector", detector)]);
        // Settled: a loop that closes works on other wavefronts.
        (0..500).for_each(|_| drop(simulator.step()));
        group.bench_function(detector, |b| b.iter(|| simulator.step().map(|frame| frame.residual_rms_nm)));
    }
    group.finish();
}

fn runs(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("run of 4000 frames");
    group.sample_size(10);
    for detector in ["quad-cell", "pixels"] {
        let settings = [
            ("wavefront_sensor.detector", detector),
            ("control.settle_s", "3.794"),
            ("image.count", "1"),
            ("image.exposure_s", "0.0"),
        ];
        let mut simulator = simulator(&settings);
        group.bench_function(detector, |b| {
            b.iter(|| {
                let mut shots: Vec<Shot> = Vec::new();
                simulator.run(&mut shots, &Control::default()).map(|summary| assert_eq!(summary.frames, 4000))
            });
        });
    }
    group.finish();
}

/// Time of each stage in a frame of a whole telescope, on one core, and the rate of its least
/// operations. The systems are built when the first of their stages is timed, so that a filter does
/// not wait for the others.
fn stages(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("stage");
    group.sample_size(10);
    for preset in ["keck-onsky", "tmt-onsky", "elt-onsky"] {
        let mut simulator: Option<Simulator> = None;
        for stage in LoopStage::ALL {
            let mut time = |bencher: &mut Bencher| {
                let simulator = simulator.get_or_insert_with(|| settled(preset));
                bencher.iter_custom(|frames| {
                    let before = simulator.profile().seconds(stage);
                    (0..frames).for_each(|_| drop(simulator.step()));
                    Duration::from_secs_f64(simulator.profile().seconds(stage) - before)
                });
            };
            group.bench_function(format!("{preset} {}", stage.name()), &mut time);
        }
        if let Some(simulator) = &simulator {
            for stage in LoopStage::ALL {
                let work = simulator.work(stage);
                println!(
                    "{preset} {}: at least {:.2} Mflop, {:.0} kB",
                    stage.name(),
                    work.flops / 1e6,
                    work.bytes / 1e3
                );
            }
        }
    }
    group.finish();
}

/// The loop of a preset after its first hundred frames.
fn settled(preset: &str) -> Simulator {
    let started = Instant::now();
    let scene = Scene::preset(preset).expect("the preset is built in");
    let mut simulator = Simulator::new(&scene).expect("the preset is buildable");
    println!("{preset}: set-up {:.1} s", started.elapsed().as_secs_f64());
    (0..100).for_each(|_| drop(simulator.step()));
    simulator
}

/// 8,000 vectors of multiply-adds: eight sums side by side hide the latency.
struct MultiplyAdds;

impl pulp::WithSimd for MultiplyAdds {
    type Output = f32;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) -> f32 {
        let (a, b) = (simd.splat_f32s(black_box(1.000_000_1)), simd.splat_f32s(black_box(1e-9)));
        let mut sums = [simd.splat_f32s(black_box(1.0)); 8];
        // As many numbers whatever the length of the vectors.
        for _ in 0..1000 * LANES / S::F32_LANES {
            for sum in &mut sums {
                *sum = simd.mul_add_f32s(*sum, a, b);
            }
        }
        sums.into_iter().map(|sum| simd.reduce_sum_f32s(sum)).sum()
    }
}

/// A sum over memory: as fast as it can be read.
struct Read<'a>(&'a [f32]);

impl pulp::WithSimd for Read<'_> {
    type Output = f32;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) -> f32 {
        let mut sums = [simd.splat_f32s(0.0); 8];
        for block in S::as_simd_f32s(self.0).0.as_chunks::<8>().0 {
            for (sum, values) in sums.iter_mut().zip(block) {
                *sum = simd.add_f32s(*sum, *values);
            }
        }
        sums.into_iter().map(|sum| simd.reduce_sum_f32s(sum)).sum()
    }
}

fn machine(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("machine");
    let arch = pulp::Arch::new();
    let flops = 1000 * 8 * LANES as u64 * 2;
    group.throughput(criterion::Throughput::Elements(flops));
    group.bench_function("flops from registers", |b| b.iter(|| arch.dispatch(MultiplyAdds)));
    let megabyte = vec![1.0f32; 1 << 18];
    group.throughput(criterion::Throughput::Bytes(1 << 20));
    group.bench_function("reading a megabyte", |b| b.iter(|| arch.dispatch(Read(black_box(&megabyte)))));
    group.finish();
}

criterion_group!(benches, machine, steps, runs, stages);
criterion_main!(benches);
