//! Scenes, simulators and averages that the tests share.

use cophase::ao::{AlignedBuffer, Footprint, LoopFrame, Simulator};
use cophase::scene::Scene;

/// Settings without turbulence.
pub const NO_TURBULENCE: [(&str, &str); 4] = [
    ("turbulence.fractions", "[]"),
    ("turbulence.heights_m", "[]"),
    ("turbulence.wind_m_s", "[]"),
    ("turbulence.wind_dir_rad", "[]"),
];

/// Settings with perfect segments and a noise-free sensor.
pub const NO_ERRORS_NO_NOISE: [(&str, &str); 3] = [
    ("aberrations.segment_piston_rms_nm", "0.0"),
    ("wavefront_sensor.photon_noise", "false"),
    ("wavefront_sensor.read_noise_e", "0.0"),
];

/// Settings of one layer at `wind` m/s along +x.
pub fn one_layer(wind: &str) -> [(String, String); 4] {
    let list = |value: &str| format!("[{value}]");
    [
        ("turbulence.fractions".into(), list("1.0")),
        ("turbulence.heights_m".into(), list("0.0")),
        ("turbulence.wind_m_s".into(), list(wind)),
        ("turbulence.wind_dir_rad".into(), list("0.0")),
    ]
}

/// Preset with settings.
pub fn scene(settings: &[(&str, &str)]) -> Scene {
    Scene::preset("keck-onsky").unwrap().with(settings).unwrap()
}

pub fn simulator(settings: &[(&str, &str)]) -> Simulator {
    Simulator::new(&scene(settings)).unwrap()
}

/// Mean of a quantity over `frames` frames, after `settle` frames.
pub fn mean(
    simulator: &mut Simulator,
    settle: usize,
    frames: usize,
    mut quantity: impl FnMut(&LoopFrame) -> f64,
) -> f64 {
    for _ in 0..settle {
        simulator.step().unwrap();
    }
    (0..frames).map(|_| quantity(&simulator.step().unwrap())).sum::<f64>() / frames as f64
}

/// RMS residual over `frames` frames, after `settle` frames, nm.
pub fn residual_nm(simulator: &mut Simulator, settle: usize, frames: usize) -> f64 {
    mean(simulator, settle, frames, |frame| frame.residual_rms_nm.powi(2)).sqrt()
}

/// Map over the footprint of a function of (row, column).
pub fn map(footprint: &Footprint, function: impl Fn(usize, usize) -> f32) -> AlignedBuffer {
    let mut map = footprint.zeros();
    for (y, row) in map.chunks_exact_mut(footprint.stride()).enumerate() {
        for (x, out) in row.iter_mut().take(footprint.samples()).enumerate() {
            *out = function(y, x);
        }
    }
    map
}

/// Converts a map over the footprint to a square array.
pub fn square(footprint: &Footprint, map: &[f32]) -> ndarray::Array2<f64> {
    let n = footprint.samples();
    ndarray::Array2::from_shape_fn((n, n), |(y, x)| f64::from(map[y * footprint.stride() + x]))
}
