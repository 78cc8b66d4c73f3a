//! Does a session stay as it is over a night? `cargo bench --bench soak -- [ESTIMATES]` (100,000)
//!
//! One session fits sixteen frames, which their noise tells apart, in turn. Memory that it holds
//! (resident, Linux; elsewhere nothing is said of it) may not grow after the first tenth, in which
//! allocators and thread stacks settle, and the same frame must give the same bits each time.

use cophase::modal::{FitOptions, ModalFitter, Session, SessionOptions};
use cophase::scene::Scene;
use cophase::source;
use ndarray::Axis;
use std::process::exit;
use std::sync::Arc;
use std::time::Instant;

/// Frames that differ: enough that a result kept from the last call would be another's.
const FRAMES: usize = 16;

/// Most that resident memory may grow after the first tenth, bytes: what an allocator returns to
/// the system and takes back is a few pages. A leak of 12 bytes an estimate would show over
/// 100,000.
const GROWTH_BYTES: usize = 1 << 20;

const SCENE: &str = "
[pupil]
aperture = \"hexagonal\"
rings = 1
samples = 32
[image]
wavelength_nm = 2168.6
samples_per_lambda_over_d = 2
pixels = 48
diversity_focus_waves_rms = 0.5
peak_snr = 300
read_noise_e = 5
count = 16
[aberrations]
segment_piston_rms_nm = 60
ncpa_rms_nm = 30
truth_samples = 256
[modes]
ncpa = \"zernike\"
ncpa_count = 8
exact_zernikes = \"none\"
";

fn main() {
    let number = std::env::args().skip(1).find(|argument| !argument.starts_with('-'));
    let estimates = number.map_or(Ok(100_000), |number| number.parse::<usize>());
    let Ok(estimates) = estimates else {
        eprintln!("soak takes a number of estimates");
        exit(2);
    };
    let scene = Scene::from_text(SCENE, std::path::Path::new("")).expect("the scene is valid");
    let frames = source::simulate(&scene).expect("the scene can be imaged").remove(0).images_e;
    let estimator = Arc::new(ModalFitter::new(&scene, false).expect("the scene has a model"));
    let mut session = Session::new(estimator, &SessionOptions::default()).expect("a session has room");

    let started = Instant::now();
    let mut first: Vec<Vec<u64>> = Vec::new();
    let (mut settled, mut most, mut lowest, mut differ, mut evaluations) = (0, 0, usize::MAX, 0, 0);
    for k in 0..estimates {
        session.frame_mut(0, 0).expect("room for one").0.assign(&frames.index_axis(Axis(0), k % FRAMES));
        session.fit(1, &FitOptions::default()).expect("the frame holds a star");
        let result = &session.channels()[0].results()[0];
        evaluations += result.report.evaluations;
        let bits = result.coefficients_nm.iter().map(|nm| nm.to_bits());
        match first.get(k % FRAMES) {
            None => first.push(bits.collect()),
            Some(known) => differ += usize::from(!bits.eq(known.iter().copied())),
        }
        if k % 1000 == 999 || k + 1 == estimates {
            let resident = resident();
            if settled == 0 || k < estimates / 10 {
                settled = resident
            } else {
                (most, lowest) = (most.max(resident), lowest.min(resident))
            }
        }
    }
    let (seconds, growth) = (started.elapsed().as_secs_f64(), most.saturating_sub(settled));
    println!(
        "{estimates} estimates in {seconds:.0} s ({evaluations} evaluations), {differ} with other bits than the first of \
         their frame; resident memory {:.1} MB after a tenth, {:.1} to {:.1} MB afterwards: {growth} bytes of growth, \
         where {GROWTH_BYTES} are allowed",
        settled as f64 / 1e6,
        lowest as f64 / 1e6,
        most as f64 / 1e6
    );
    // Sixteen times the same answer would hide an answer that is kept.
    let distinct = first.iter().collect::<std::collections::HashSet<_>>().len();
    if differ > 0 || growth > GROWTH_BYTES || distinct < FRAMES.min(estimates) {
        eprintln!("the session did not stay as it was ({distinct} different answers for {FRAMES} frames)");
        exit(1);
    }
}

/// Resident memory, bytes; 0 where there is no /proc.
fn resident() -> usize {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap_or_default();
    line.split_whitespace().next().and_then(|kib| kib.parse::<usize>().ok()).unwrap_or(0) * 1024
}
