//! Response of a simulated detector's pixels: integration over the pixel's area, and a gain of its
//! own.

use super::random::stream;
use crate::fourier::PixelResponse;
use crate::scene::System;
use crate::telescope::pixel_response;
use cophase_numerics::fft::{FftDirection, FftReal};
use ndarray::{Array2, Axis};
use num_complex::Complex64;

/// Random number stream of the pixel responses under the seed of the aberrations; above the streams
/// of the images' noise.
const RESPONSE_STREAM: u64 = 4 << 32;

/// Pixels of a scene's detector.
pub(crate) struct DetectorPixels {
    area: PixelResponse,
    /// RMS of the pixel responses about 1, and the seed of their draw.
    response_rms: f64,
    seed: u64,
}

impl DetectorPixels {
    /// Pixels of `scene`.
    pub(crate) fn new(scene: &System) -> Self {
        let seed = scene.seed();
        Self { area: pixel_response(scene), response_rms: scene.faults.pixel_response_rms, seed }
    }

    /// Applies the pixels' area and response to a point-sampled PSF `[y, x]`. With pixels that are
    /// points and equal responses the result is bit-identical to the input.
    pub(crate) fn apply(&self, psf: Array2<f64>) -> Array2<f64> {
        let mut sampled = if self.area.is_point() { psf } else { integrate_over_pixels(psf, self.area) };
        if self.response_rms > 0.0 {
            use rand_distr::{Distribution, StandardNormal};
            let mut rng = stream(self.seed, RESPONSE_STREAM);
            sampled.mapv_inplace(|h| {
                let normal: f64 = StandardNormal.sample(&mut rng);
                h * (1.0 + self.response_rms * normal).max(0.0)
            });
        }
        sampled
    }
}

/// Means over the area of a pixel about each point. An image sampled with at least two pixels per
/// λ/D has no frequency beyond half a cycle per pixel, so multiplication of its spectrum by the
/// transfer function of the pixel is exact except for the faint light that wraps around at the
/// edges.
fn integrate_over_pixels(psf: Array2<f64>, area: PixelResponse) -> Array2<f64> {
    let mut field = psf.mapv(Complex64::from);
    let (rows, columns) = field.dim();
    let [forward, inverse] =
        [FftDirection::Forward, FftDirection::Inverse].map(|direction| f64::plan_pair([columns, rows], direction));
    for (axis, (forward, inverse)) in [Axis(1), Axis(0)].into_iter().zip(forward.into_iter().zip(inverse)) {
        let n = field.len_of(axis);
        let transfer: Vec<f64> = (0..n)
            .map(|k| {
                let cycles = if k <= n / 2 { k as f64 } else { k as f64 - n as f64 } / n as f64;
                area.transfer(cycles)
            })
            .collect();
        for mut lane in field.lanes_mut(axis) {
            let mut line = lane.to_vec();
            forward.process(&mut line);
            line.iter_mut().zip(&transfer).for_each(|(value, transfer)| *value *= transfer / n as f64);
            inverse.process(&mut line);
            lane.iter_mut().zip(line).for_each(|(out, value)| *out = value);
        }
    }
    // The mean of a PSF is not negative; rounding may make it so.
    field.mapv(|value| value.re.max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;

    #[test]
    fn a_pixel_integrates_over_its_area() {
        // 1 + cos(2πfx) averaged over a width w about x: 1 + sinc(fw)·cos(2πfx); f = 3/24 cycles a
        // pixel, w = 0.8.
        let f = 3.0 / 24.0;
        let wave = |x: usize| (std::f64::consts::TAU * f * x as f64).cos();
        let area = PixelResponse { width_pixels: 0.8, diffusion_pixels: 0.0 };
        let sampled = integrate_over_pixels(Array2::from_shape_fn((16, 24), |(_, x)| 1.0 + wave(x)), area);
        let share = (std::f64::consts::PI * f * 0.8).sin() / (std::f64::consts::PI * f * 0.8);
        for ((_, x), value) in sampled.indexed_iter() {
            // Rounding of transforms of 24 numbers of order 1.
            assert!((value - 1.0 - share * wave(x)).abs() < 1e-13);
        }
    }

    #[test]
    fn responses_have_the_stated_spread_and_points_the_identity() {
        let scene = Scene::preset("keck-onsky").unwrap();
        let flat = Array2::from_elem((100, 100), 2.0);
        assert_eq!(DetectorPixels::new(&scene).apply(flat.clone()), flat);
        let rough = scene.with(&[("faults.pixel_response_rms", "0.02")]).unwrap();
        let sampled = DetectorPixels::new(&rough).apply(flat.clone());
        // The spread of 10,000 draws is known to 0.7 %: four times that.
        let spread = sampled.std(0.0) / 2.0;
        assert!((spread / 0.02 - 1.0).abs() < 0.03, "{spread}");
        assert_eq!(DetectorPixels::new(&rough).apply(flat), sampled, "a detector's responses do not change");
    }
}
