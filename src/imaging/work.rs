//! Operations and memory traffic of one evaluation, from the sizes of the model: a lower bound of
//! its cost.
//!
//! Per image, with n samples and m pixels a side, L illuminated samples, E entries of segments in
//! them, M smooth modes, in numbers of b bytes, in a batch of B images:
//!
//! | part | operations |
//! |---|---|
//! | folded matrix products, forward and adjoint | 4 n m (n + m) |
//! | or FFTs of N points, forward and adjoint | 10 N log₂N (n + m) |
//! | smooth modes to phase, slopes to gradient | 4 L M |
//! | sine and cosine | 30 L (f32), 50 L (f64) |
//! | field, slopes | 20 L |
//! | segments | 8 E; if they tilt, 16 E and two sines and cosines for each |
//! | pixels: intensity, sums, residual, source | 30 m² |
//!
//! With several wavelengths, all parts but the pixels are counted once per wavelength. Bytes from
//! memory: data and weights, 2 m² b; the basis, L M b/B, read once per batch; coefficients and
//! gradient, 16 per mode. Padding, repeated computations of a variant, and the area of pixels are
//! not counted.

use super::optics::Optics;
use crate::device::Precision;

/// Operations and bytes of one evaluation of one image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EvaluationWork {
    /// Additions and multiplications.
    pub flops: f64,
    /// Bytes read from and written to memory.
    pub bytes: f64,
}

/// The sizes that determine [`EvaluationWork`]; the symbols are those of the table above.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shapes {
    /// Pupil samples a side, n.
    pub samples: usize,
    /// Image pixels a side, m.
    pub pixels: usize,
    /// Points of the FFT, N; `None` with matrix products.
    pub fft: Option<usize>,
    /// Illuminated samples, L.
    pub illuminated: usize,
    /// Entries of segments in illuminated samples, E.
    pub entries: usize,
    /// Smooth modes, M.
    pub smooth: usize,
    /// Coefficients of the model.
    pub modes: usize,
    /// Whether segments tilt.
    pub tilts: bool,
    /// Number of wavelengths.
    pub colours: usize,
}

impl Shapes {
    /// The sizes of `optics`, with an FFT of `fft` points or matrix products.
    pub fn new(optics: &Optics, fft: Option<usize>) -> Self {
        let parts = optics.parts();
        Self {
            samples: parts.sampling.samples,
            pixels: parts.sampling.pixels,
            fft,
            illuminated: parts.weights.illuminated.len(),
            entries: parts.weights.weight.len(),
            smooth: parts.basis.nrows(),
            modes: parts.modes.len(),
            tilts: optics.tilts_segments(),
            colours: parts.colours.len(),
        }
    }

    /// Work of one image's objective and gradient in a batch of `batch`.
    pub fn work(&self, precision: Precision, batch: usize) -> EvaluationWork {
        let counts = [self.samples, self.pixels, self.illuminated, self.entries, self.smooth, self.modes, self.colours];
        let [n, m, illuminated, entries, smooth, modes, colours] = counts.map(|count| count as f64);
        let transform = match self.fft {
            Some(points) => 10.0 * points as f64 * (points as f64).log2() * (n + m),
            None => 4.0 * n * m * (n + m),
        };
        let turn = if precision == Precision::F32 { 30.0 } else { 50.0 };
        let segments = if self.tilts { entries * (16.0 + 2.0 * turn) } else { 8.0 * entries };
        let number = precision.bytes() as f64;
        EvaluationWork {
            flops: colours * (transform + illuminated * (4.0 * smooth + turn + 20.0) + segments) + 30.0 * m * m,
            bytes: number * (2.0 * m * m + colours * illuminated * smooth / batch.max(1) as f64) + 16.0 * modes,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_work_of_the_papers_model_follows_from_its_sizes() {
        let matrix = Shapes {
            samples: 120,
            pixels: 240,
            fft: None,
            illuminated: 9000,
            entries: 9000,
            smooth: 66,
            modes: 102,
            tilts: false,
            colours: 1,
        };
        let work = matrix.work(Precision::F32, 200);
        // 41.472 M of products, 2.376 M of modes, 0.45 M of fields, 0.072 M of segments, 1.728 M of
        // pixels.
        assert_eq!(work.flops, 46.098e6);
        // 460,800 of images, 11,880 of the basis, 1,632 of coefficients and gradient.
        assert_eq!(work.bytes, 474_312.0);
        let fft = Shapes { fft: Some(240), ..matrix }.work(Precision::F32, 200);
        // Three wavelengths: three times all parts but the pixels, and three times the basis.
        let three = Shapes { colours: 3, ..matrix }.work(Precision::F32, 200);
        assert_eq!((three.flops, three.bytes), (3.0 * (46.098e6 - 1.728e6) + 1.728e6, 474_312.0 + 2.0 * 11_880.0));
        // log2 240 = 7.9069: 6.8316 M in place of the products.
        assert!((fft.flops - (46.098e6 - 41.472e6 + 6.8316e6)).abs() < 100.0, "{}", fft.flops);
    }
}
