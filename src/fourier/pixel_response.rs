//! Response of a detector's pixels to the intensity of an image: the mean over a square, blurred by
//! the diffusion of charge.

use std::f64::consts::{PI, TAU};

/// Pixels that gather light over an area, along one axis; the response along x and y is the product
/// of two of them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PixelResponse {
    /// Side of the sensitive square, pixels.
    pub width_pixels: f64,
    /// Standard deviation of the charge's diffusion, pixels.
    pub diffusion_pixels: f64,
}

impl PixelResponse {
    /// Pixels that are points.
    pub const POINT: Self = Self { width_pixels: 0.0, diffusion_pixels: 0.0 };

    /// Whether the pixels are points.
    pub fn is_point(&self) -> bool {
        *self == Self::POINT
    }

    /// The same response in units of a pixel that is `times` as large.
    pub fn in_pixels_of(&self, times: f64) -> Self {
        Self { width_pixels: self.width_pixels / times, diffusion_pixels: self.diffusion_pixels / times }
    }

    /// Factor by which the response changes a spatial frequency of the image: that of a square
    /// times that of a Gaussian, `sin(πwf)/(πwf) · exp(−(2πσf)²/2)`.
    pub fn transfer(&self, cycles_per_pixel: f64) -> f64 {
        let x = PI * self.width_pixels * cycles_per_pixel;
        let square = if x == 0.0 { 1.0 } else { x.sin() / x };
        square * (-0.5 * (TAU * self.diffusion_pixels * cycles_per_pixel).powi(2)).exp()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transfer_function_is_the_mean_of_a_wave_over_the_response() {
        let response = PixelResponse { width_pixels: 0.8, diffusion_pixels: 0.3 };
        let f = 0.21;
        // ∫ cos(2πfx) over the square and the Gaussian, by the midpoint rule on 2,000 × 2,000
        // points of ±6 standard deviations, whose error is far below 1e-6.
        let points = 2000;
        let at = |i: usize| (i as f64 + 0.5) / points as f64 - 0.5;
        let square = (0..points).map(|i| (TAU * f * 0.8 * at(i)).cos()).sum::<f64>() / points as f64;
        let (mut sum, mut weight) = (0.0, 0.0);
        for i in 0..points {
            let z = 12.0 * at(i);
            let density = (-0.5 * z * z).exp();
            sum += density * (TAU * f * 0.3 * z).cos();
            weight += density;
        }
        assert!((response.transfer(f) - square * sum / weight).abs() < 1e-6);
        assert_eq!((response.transfer(0.0), PixelResponse::POINT.transfer(0.5)), (1.0, 1.0));
        // Of pixels twice as large, twice the frequency.
        let large = response.in_pixels_of(2.0);
        assert!((large.transfer(2.0 * f) - response.transfer(f)).abs() < 1e-15);
    }
}
