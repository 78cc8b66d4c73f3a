//! The transform as it is defined: four nested sums in double precision. The reference
//! implementation, too slow for anything but tests.

use super::Sampling;

/// Pupil (row-planar n×n) to focus (row-planar m×m); cost n²m².
pub fn forward(sampling: Sampling, pupil: &[f64]) -> Vec<f64> {
    transform(sampling.samples, sampling.pixels, -sampling.step(), pupil, half_sample(sampling), whole_pixel(sampling))
}

/// Focus (row-planar m×m) to pupil (row-planar n×n).
pub fn adjoint(sampling: Sampling, focus: &[f64]) -> Vec<f64> {
    transform(sampling.pixels, sampling.samples, sampling.step(), focus, whole_pixel(sampling), half_sample(sampling))
}

/// Position of the optical axis in samples: between the central two.
fn half_sample(sampling: Sampling) -> f64 {
    (sampling.samples as f64 - 1.0) / 2.0
}

/// Position of the optical axis in pixels: on pixel m/2.
fn whole_pixel(sampling: Sampling) -> f64 {
    sampling.pixels as f64 / 2.0
}

fn transform(from: usize, to: usize, step: f64, input: &[f64], axis_from: f64, axis_to: f64) -> Vec<f64> {
    let mut output = vec![0.0; 2 * to * to];
    for v in 0..to {
        for u in 0..to {
            let (mut re, mut im) = (0.0, 0.0);
            for y in 0..from {
                for x in 0..from {
                    let turns = step
                        * ((x as f64 - axis_from) * (u as f64 - axis_to)
                            + (y as f64 - axis_from) * (v as f64 - axis_to));
                    let (sin, cos) = (std::f64::consts::TAU * turns).sin_cos();
                    let (a, b) = (input[2 * from * y + x], input[2 * from * y + from + x]);
                    re += a * cos - b * sin;
                    im += a * sin + b * cos;
                }
            }
            output[2 * to * v + u] = re;
            output[2 * to * v + to + u] = im;
        }
    }
    output
}
