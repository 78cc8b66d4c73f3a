//! No input panics, hangs, or takes more memory than it says: the probes of the fuzz targets
//! (`fuzz/`), on its seeds and on what a seeded generator makes of them. `scripts/fuzz` goes on
//! where this ends, with a nightly toolchain.

#[path = "../../../fuzz/src/frames.rs"]
mod frames;
#[path = "../../../fuzz/src/probes.rs"]
mod probes;

mod fits;
mod scenes;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::Path;

/// The seeds of a target, by name.
fn seeds(target: &str) -> Vec<(String, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/seeds").join(target);
    let entries = std::fs::read_dir(&folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let read = |entry: std::io::Result<std::fs::DirEntry>| {
        let path = entry.unwrap().path();
        (path.file_name().unwrap().to_string_lossy().into_owned(), std::fs::read(&path).unwrap())
    };
    let mut seeds: Vec<_> = entries.map(read).collect();
    // The order of a folder is the file system's.
    seeds.sort();
    assert!(seeds.len() > 2, "{target} has {} seeds", seeds.len());
    seeds
}

/// The same inputs on every run.
fn generator(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

fn pick<'a, T>(rng: &mut ChaCha8Rng, from: &'a [T]) -> &'a T {
    &from[rng.random_range(0..from.len())]
}

fn word(rng: &mut ChaCha8Rng, from: &[&'static str]) -> &'static str {
    from[rng.random_range(0..from.len())]
}

#[test]
fn described_arrays_are_fitted_or_refused() {
    let session = frames::Session::new();
    let mut fitted = 0;
    let seeds = seeds("frames");
    for (name, bytes) in &seeds {
        let outcome = session.probe(bytes);
        let refused = ["misaligned", "bad-element", "huge", "far"].contains(&name.as_str());
        assert!(!(outcome && refused), "{name} was fitted");
        fitted += usize::from(outcome);
    }
    // Pixels that hold no star are fitted too, in so far as each has its report.
    assert!(fitted >= 10, "{fitted} of {} seeds were fitted", seeds.len());
    let mut rng = generator(41);
    for _ in 0..400 {
        let mut bytes = pick(&mut rng, &seeds).1.clone();
        bytes.resize(bytes.len().max(64), 0);
        for _ in 0..rng.random_range(1..8) {
            // The description more often than the pixels behind it.
            let end = if rng.random_bool(0.7) { 40 } else { bytes.len() };
            let at = rng.random_range(0..end);
            bytes[at] = rng.random();
        }
        session.probe(&bytes);
    }
}
