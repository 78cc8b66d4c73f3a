//! What a detector's pixels make of a PSF: each gathers light over a square, and answers it in its own way.

use super::stream;
use crate::scene::Scene;
use ndarray::{Array2, Axis};
use num_complex::Complex64;
use rustfft::FftPlanner;

/// Stream of the responses under the seed of the aberrations: beyond the noise of any image.
const RESPONSE_STREAM: u64 = 4 << 32;

/// The pixels of a scene's detector.
pub(crate) struct Pixels {
    /// Side of the square over which one gathers light, over the pitch.
    fill: f64,
    /// RMS of the responses about 1, and the seed of their draw.
    response_rms: f64,
    seed: u64,
}

impl Pixels {
    /// Those of `scene`.
    pub(crate) fn of(scene: &Scene) -> Self {
        let seed = scene.aberrations.as_ref().map_or(1, |aberrations| aberrations.seed);
        Self { fill: scene.image.pixel_fill, response_rms: scene.image.pixel_response_rms, seed }
    }

    /// The PSF `[y, x]` as points sample it, as these pixels do. Points without differences return it to the last bit.
    pub(crate) fn see(&self, psf: Array2<f64>) -> Array2<f64> {
        let mut seen = if self.fill > 0.0 { gathered(psf, self.fill) } else { psf };
        if self.response_rms > 0.0 {
            use rand_distr::{Distribution, StandardNormal};
            let mut rng = stream(self.seed, RESPONSE_STREAM);
            seen.mapv_inplace(|h| {
                let normal: f64 = StandardNormal.sample(&mut rng);
                h * (1.0 + self.response_rms * normal).max(0.0)
            });
        }
        seen
    }
}

/// Means over squares of side `fill` about each point. An image sampled at two pixels or more per λ/D holds no frequency
/// beyond half a cycle per pixel, so the transfer function of the square, `sinc·sinc`, says it exactly, but for what a
/// periodic image takes from its opposite edge: light of the faintest wings.
fn gathered(psf: Array2<f64>, fill: f64) -> Array2<f64> {
    let mut field = psf.mapv(Complex64::from);
    let mut planner = FftPlanner::new();
    for axis in [Axis(1), Axis(0)] {
        let n = field.len_of(axis);
        let (forward, inverse) = (planner.plan_fft_forward(n), planner.plan_fft_inverse(n));
        let transfer: Vec<f64> = (0..n)
            .map(|k| {
                let cycles = if k <= n / 2 { k as f64 } else { k as f64 - n as f64 } / n as f64;
                let x = std::f64::consts::PI * cycles * fill;
                if x == 0.0 { 1.0 } else { x.sin() / x }
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
    // The square's share is positive; rounding about 0 is not.
    field.mapv(|value| value.re.max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_square_gathers_the_mean_of_what_is_under_it() {
        // 1 + cos(2πfx) averaged over a width w about x: 1 + sinc(fw)·cos(2πfx); f = 3/24 cycles a pixel, w = 0.8.
        let f = 3.0 / 24.0;
        let wave = |x: usize| (std::f64::consts::TAU * f * x as f64).cos();
        let seen = gathered(Array2::from_shape_fn((16, 24), |(_, x)| 1.0 + wave(x)), 0.8);
        let share = (std::f64::consts::PI * f * 0.8).sin() / (std::f64::consts::PI * f * 0.8);
        for ((_, x), value) in seen.indexed_iter() {
            // Rounding of transforms of 24 numbers of order 1.
            assert!((value - 1.0 - share * wave(x)).abs() < 1e-13);
        }
    }

    #[test]
    fn responses_have_the_stated_spread_and_points_change_nothing() {
        let scene = Scene::preset("keck-onsky").unwrap();
        let flat = Array2::from_elem((100, 100), 2.0);
        assert_eq!(Pixels::of(&scene).see(flat.clone()), flat);
        let rough = scene.with(&[("image.pixel_response_rms", "0.02")]).unwrap();
        let seen = Pixels::of(&rough).see(flat.clone());
        // The spread of 10,000 draws is known to 0.7 %: four times that.
        let spread = seen.std(0.0) / 2.0;
        assert!((spread / 0.02 - 1.0).abs() < 0.03, "{spread}");
        assert_eq!(Pixels::of(&rough).see(flat), seen, "a detector does not change from image to image");
    }
}
