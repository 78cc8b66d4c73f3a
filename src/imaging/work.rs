//! What one evaluation cannot avoid: the operations and bytes of its floor, from the shapes alone.
//!
//! Per image, with n samples and m pixels a side, L lit samples, E entries of segments in them, M smooth modes, in numbers
//! of b bytes, in a batch of B images:
//!
//! | part | operations |
//! |---|---|
//! | folded matrix products, there and back | 4 n m (n + m) |
//! | or FFTs of N points, there and back | 10 N log₂N (n + m) |
//! | smooth modes to phase, slopes to gradient | 4 L M |
//! | sine and cosine | 30 L (f32), 50 L (f64) |
//! | field, slopes | 20 L |
//! | segments | 8 E; where they tilt 16 E and two sines and cosines for each |
//! | pixels: intensity, sums, residual, source | 30 m² |
//!
//! Light of several wavelengths takes all but the pixels' as often. Bytes from memory: data and weights, 2 m² b; the basis, L M b/B, read once for the batch; coefficients up and gradient
//! down, 16 a mode. Zeros of padding are in neither, nor what a variant computes twice.

use super::chain::Precision;
use super::optics::Optics;

/// Operations and bytes of one evaluation of one image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Work {
    /// Additions and multiplications.
    pub flops: f64,
    /// Bytes that come from memory or go there.
    pub bytes: f64,
}

/// What [`Work`] depends on; the names are those of the table above.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shapes {
    /// Pupil samples a side, n.
    pub samples: usize,
    /// Image pixels a side, m.
    pub pixels: usize,
    /// Points of the FFT, N; `None` where matrices transform.
    pub fft: Option<usize>,
    /// Lit samples, L.
    pub lit: usize,
    /// Entries of segments in lit samples, E.
    pub entries: usize,
    /// Smooth modes, M.
    pub smooth: usize,
    /// Coefficients of the model.
    pub modes: usize,
    /// Whether segments tilt.
    pub tilts: bool,
    /// Wavelengths of the light.
    pub colours: usize,
}

impl Shapes {
    /// Those of `optics`, transformed by an FFT of `fft` points or by matrices.
    pub fn of(optics: &Optics, fft: Option<usize>) -> Self {
        let parts = optics.parts();
        Self {
            samples: parts.sampling.samples,
            pixels: parts.sampling.pixels,
            fft,
            lit: parts.weights.lit.len(),
            entries: parts.weights.weight.len(),
            smooth: parts.basis.nrows(),
            modes: parts.modes.len(),
            tilts: optics.tilts_segments(),
            colours: parts.colours.len(),
        }
    }

    /// Work of one image's objective and gradient in a batch of `batch`.
    pub fn work(&self, precision: Precision, batch: usize) -> Work {
        let counts = [self.samples, self.pixels, self.lit, self.entries, self.smooth, self.modes, self.colours];
        let [n, m, lit, entries, smooth, modes, colours] = counts.map(|count| count as f64);
        let transform = match self.fft {
            Some(points) => 10.0 * points as f64 * (points as f64).log2() * (n + m),
            None => 4.0 * n * m * (n + m),
        };
        let turn = if precision == Precision::F32 { 30.0 } else { 50.0 };
        let segments = if self.tilts { entries * (16.0 + 2.0 * turn) } else { 8.0 * entries };
        let number = precision.bytes() as f64;
        Work {
            flops: colours * (transform + lit * (4.0 * smooth + turn + 20.0) + segments) + 30.0 * m * m,
            bytes: number * (2.0 * m * m + colours * lit * smooth / batch.max(1) as f64) + 16.0 * modes,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_model_costs_what_its_shapes_say() {
        let matrix = Shapes {
            samples: 120,
            pixels: 240,
            fft: None,
            lit: 9000,
            entries: 9000,
            smooth: 66,
            modes: 102,
            tilts: false,
            colours: 1,
        };
        let work = matrix.work(Precision::F32, 200);
        // 41.472 M of products, 2.376 M of modes, 0.45 M of fields, 0.072 M of segments, 1.728 M of pixels.
        assert_eq!(work.flops, 46.098e6);
        // 460,800 of images, 11,880 of the basis, 1,632 of coefficients and gradient.
        assert_eq!(work.bytes, 474_312.0);
        let fft = Shapes { fft: Some(240), ..matrix }.work(Precision::F32, 200);
        // Three wavelengths: three times all but the pixels', and the basis.
        let three = Shapes { colours: 3, ..matrix }.work(Precision::F32, 200);
        assert_eq!((three.flops, three.bytes), (3.0 * (46.098e6 - 1.728e6) + 1.728e6, 474_312.0 + 2.0 * 11_880.0));
        // log2 240 = 7.9069: 6.8316 M in place of the products.
        assert!((fft.flops - (46.098e6 - 41.472e6 + 6.8316e6)).abs() < 100.0, "{}", fft.flops);
    }
}
