//! What does a frame of turbulence cost, on one core? `cargo bench --bench atmosphere`
//!
//! The seven layers of the `keck-onsky` scene over its pupil, on the AO simulator's grid of 240
//! samples: with the wind, which makes new turbulence at every frame, and without, where only the
//! layers are interpolated and added.

use cophase::ao::{Atmosphere, Footprint};
use cophase::scene::Scene;
use cophase::telescope::Telescope;
use criterion::{Criterion, criterion_group, criterion_main};

fn frames(c: &mut Criterion) {
    let scene = Scene::preset("keck-onsky").expect("the preset is built in");
    let fine = scene.with(&[("pupil.samples", "240")]).expect("the key exists");
    let pupil = Telescope::new(&fine).expect("the preset is buildable").pupil;
    let footprint = Footprint::new(&pupil);
    let mut group = c.benchmark_group("atmosphere");
    for (name, wind) in [("frame", 1.0), ("frame without wind", 0.0)] {
        let mut turbulence = fine.turbulence.clone();
        turbulence.wind_m_s.iter_mut().for_each(|speed| *speed *= wind);
        let mut atmosphere =
            Atmosphere::new(&turbulence, &pupil.grid, &footprint, 1.0 / 1054.0, 1).expect("the preset is valid");
        let mut opd_nm = footprint.zeros();
        group.bench_function(name, |b| b.iter(|| atmosphere.next_frame(&mut opd_nm)));
    }
    group.finish();
}

criterion_group!(benches, frames);
criterion_main!(benches);
