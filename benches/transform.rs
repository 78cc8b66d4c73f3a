//! Which route from pupil to focus and back is cheaper, the folded matrix product or the pruned
//! FFT? `cargo bench --bench transform`
//!
//! `Transform::choose` decides by a count of operations and one ratio of speeds; this is where the
//! ratio comes from.

use cophase::imaging::{Real, Sampling, Transform};
use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};

/// Pupil samples, pixels: the paper's full image, our crop, and two sizes beyond.
const SIZES: [(usize, usize); 4] = [(120, 112), (120, 240), (240, 240), (240, 480)];

fn routes<T: Real>(criterion: &mut Criterion, precision: &str) {
    let mut group = criterion.benchmark_group(format!("forward and adjoint, {precision}"));
    for (samples, pixels) in SIZES {
        let sampling = Sampling::new(samples, pixels, 2.0).expect("the sizes are even");
        let fft = Transform::<T>::fft(sampling).expect("two pixels per λ/D make a whole grid");
        for (name, transform) in [("matrix", Transform::matrix(sampling)), ("fft", fft)] {
            let mut workspace = transform.workspace();
            let mut pupil: Vec<T> = (0..2 * samples * samples).map(|i| T::narrow((i as f64).sin())).collect();
            let mut focus = vec![T::narrow(0.0); 2 * pixels * pixels];
            group.bench_with_input(BenchmarkId::new(name, format!("{samples}/{pixels}")), &(), |bencher, ()| {
                bencher.iter(|| {
                    transform.forward(&pupil, &mut focus, &mut workspace);
                    transform.adjoint(&focus, &mut pupil, &mut workspace);
                    // Scaled back, so that repeated runs do not overflow.
                    let scale = T::narrow(1e-4);
                    pupil.iter_mut().for_each(|value| *value *= scale);
                })
            });
        }
    }
    group.finish();
}

fn transforms(criterion: &mut Criterion) {
    routes::<f32>(criterion, "f32");
    routes::<f64>(criterion, "f64");
}

criterion_group!(benches, transforms);
criterion_main!(benches);
