//! Errors of the camera that a scene takes to have none: changes of the PSF by each.
//!
//! All are linear in the PSF h at the pixels (u, v) about the optical axis. With h_u and h_v its
//! derivatives along x and y, which follow from its Fourier transform:
//!
//! | Error | Change of h |
//! |---|---|
//! | scale along x, along y; shear; rotation | u h_u; v h_v; u h_v + v h_u; u h_v − v h_u |
//! | gain of a half; of two quadrants | ½ h within it, −½ h in the other: with the flux, all gains of quadrants |
//! | response at the peak | −h²/max h |
//! | halo | h spread by an exponential, less h |
//! | blur: all round; along x, less along y; along the diagonals | ½ (h_uu + h_vv); ½ (h_uu − h_vv); h_uv |
//!
//! A Gaussian blur with variances s ± d along x and y and the covariance c, pixels², adds s, d and
//! c times the last three to first order.
//!
//! Halves and quadrants are about the star: an amplifier whose border is elsewhere has a share of
//! each.

use crate::fourier::transform_square;
use crate::scene::ToleranceScene;
use cophase_numerics::fft::plan_both;
use ndarray::Array1;
use num_complex::Complex64;
use std::f64::consts::TAU;
use std::ops::Range;

/// Number of errors.
pub(crate) const ERRORS: usize = 12;
/// Gains of halves and quadrants, the response at the peak, a halo, a blur: places among them.
pub(crate) const GAINS: Range<usize> = 4..7;
pub(crate) const RESPONSE: Range<usize> = 7..8;
pub(crate) const HALO: Range<usize> = 8..9;
pub(crate) const BLUR: Range<usize> = 9..12;

/// The errors, as the subjects of a sentence, each with its standard deviation before the images
/// say more, in the order of [`columns`].
pub(super) fn errors(tolerance: &ToleranceScene) -> [(&'static str, f64); ERRORS] {
    let ToleranceScene { pixel_scale_fraction: scale, gain_fraction: gain, .. } = *tolerance;
    [
        ("the scale of the image along x", scale),
        ("the scale of the image along y", scale),
        ("the shear of the image", scale),
        ("the rotation of the image (rad)", tolerance.rotation_deg.to_radians()),
        ("the gain of the half at +x, over that at −x,", gain),
        ("the gain of the half at +y, over that at −y,", gain),
        ("the gain of the quadrants at +x, +y and at −x, −y, over that of the others,", gain),
        ("the loss of response at the peak", tolerance.response_fraction),
        ("the share of the light in a halo", tolerance.halo_fraction),
        ("the variance of a blur (pixels²)", tolerance.blur_pixels.powi(2)),
        ("half the variance of a blur along x, less that along y, (pixels²)", tolerance.blur_pixels.powi(2)),
        ("the covariance of a blur along x and y (pixels²)", tolerance.blur_pixels.powi(2)),
    ]
}

/// Scale length of the halo, pixels of the detector.
pub(crate) const HALO_PIXELS: f64 = 10.0;

/// Change of the PSF, or of an image of a star without its background, by each of the [`errors`]:
/// `[error][pixel]`. It has `size` pixels along a side, of `native` pixels of the detector.
pub(crate) fn columns(psf: &[f64], size: usize, native: f64) -> [Array1<f64>; ERRORS] {
    let spectrum = Spectrum::new(psf, size);
    let [h_u, h_v] = [0, 1].map(|axis| spectrum.derivative(axis));
    let from_axis = |at: usize| at as f64 - (size / 2) as f64;
    let moved = |[[xx, xy], [yx, yy]]: [[f64; 2]; 2]| -> Vec<f64> {
        let pixel = |at: usize| {
            let (u, v) = (from_axis(at % size), from_axis(at / size));
            (xx * u + xy * v) * h_u[at] + (yx * u + yy * v) * h_v[at]
        };
        (0..psf.len()).map(pixel).collect()
    };
    let halves = |is_first: &dyn Fn(bool, bool) -> bool| -> Vec<f64> {
        let is_first = |at: usize| is_first(at % size >= size / 2, at / size >= size / 2);
        psf.iter().enumerate().map(|(at, &h)| if is_first(at) { 0.5 * h } else { -0.5 * h }).collect()
    };
    let peak = psf.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    let halo = spectrum.spread(HALO_PIXELS / native);
    let blur = |form: &dyn Fn(f64, f64) -> f64| {
        spectrum.times(|x, y| (-0.5 * form(TAU * x / native, TAU * y / native)).into())
    };
    let all = [
        moved([[1.0, 0.0], [0.0, 0.0]]),
        moved([[0.0, 0.0], [0.0, 1.0]]),
        moved([[0.0, 1.0], [1.0, 0.0]]),
        moved([[0.0, -1.0], [1.0, 0.0]]),
        halves(&|right, _| right),
        halves(&|_, up| up),
        halves(&|right, up| right == up),
        psf.iter().map(|h| -h * h / peak).collect(),
        halo.iter().zip(psf).map(|(spread, h)| spread - h).collect(),
        blur(&|x, y| x * x + y * y),
        blur(&|x, y| x * x - y * y),
        blur(&|x, y| 2.0 * x * y),
    ];
    all.map(Array1::from)
}

/// Fourier transform of a square image.
struct Spectrum {
    size: usize,
    values: Vec<Complex64>,
}

impl Spectrum {
    fn new(image: &[f64], size: usize) -> Self {
        let mut values: Vec<Complex64> = image.iter().map(|&value| value.into()).collect();
        transform_square(&mut values, size, &*plan_both(size).0);
        Self { size, values }
    }

    /// The image whose transform is this times `factor` of the frequencies along x and y, cycles
    /// per pixel.
    fn times(&self, factor: impl Fn(f64, f64) -> Complex64) -> Vec<f64> {
        let size = self.size;
        let frequency = |at: usize| {
            let signed = if 2 * at < size { at as f64 } else { at as f64 - size as f64 };
            signed / size as f64
        };
        let each = self.values.iter().enumerate();
        let mut values: Vec<Complex64> =
            each.map(|(at, value)| value * factor(frequency(at % size), frequency(at / size))).collect();
        transform_square(&mut values, size, &*plan_both(size).1);
        values.iter().map(|value| value.re / (size * size) as f64).collect()
    }

    /// The derivative along x (0) or y (1), per pixel. The highest frequency has none.
    fn derivative(&self, axis: usize) -> Vec<f64> {
        self.times(|x, y| {
            let along = [x, y][axis];
            if along <= -0.5 { 0.0.into() } else { Complex64::new(0.0, TAU * along) }
        })
    }

    /// The image spread by exp(−r/length) of the sum 1, with a length in pixels.
    fn spread(&self, length: f64) -> Vec<f64> {
        self.times(|x, y| (1.0 + (TAU * length).powi(2) * (x * x + y * y)).powf(-1.5).into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_differences_of_changed_images() {
        let (size, width) = (64, 4.0);
        // An elliptic Gaussian off the axis, magnified, sheared and rotated about it.
        type Map = fn(f64, f64, f64) -> (f64, f64);
        let image = |map: Map, step: f64| -> Vec<f64> {
            let pixel = |at: usize| {
                let (u, v) = map((at % size) as f64 - 32.0, (at / size) as f64 - 32.0, step);
                (-((u - 3.0) / width).powi(2) - ((v + 2.0) / (1.5 * width)).powi(2)).exp()
            };
            (0..size * size).map(pixel).collect()
        };
        let psf = image(|u, v, _| (u, v), 0.0);
        let found = columns(&psf, size, 1.0);
        let step = 1e-4;
        let maps: [Map; 4] = [
            |u, v, step| (u * (1.0 + step), v),
            |u, v, step| (u, v * (1.0 + step)),
            |u, v, step| (u + step * v, v + step * u),
            |u, v, step| (u - step * v, v + step * u),
        ];
        for (number, (map, column)) in maps.iter().zip(&found).enumerate() {
            let [before, after] = [-step, step].map(|step| image(*map, step));
            let largest = column.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
            for ((after, before), column) in after.iter().zip(&before).zip(column) {
                // A third derivative of up to 10³ times the square of the step.
                let difference = (after - before) / (2.0 * step);
                assert!((difference - column).abs() < 1e-5 * largest, "{number}: {difference} {column}");
            }
        }
        // A Gaussian that is blurred has the variances of both; its peak falls by their ratio.
        let variances = [0.5 * width * width, 0.5 * (1.5f64 * width).powi(2)];
        let blurred = |[x, y]: [f64; 2]| {
            let [own_x, own_y] = [variances[0] + x, variances[1] + y];
            let scale = (variances[0] * variances[1] / (own_x * own_y)).sqrt();
            move |at: usize| {
                let (u, v) = ((at % size) as f64 - 35.0, (at / size) as f64 - 30.0);
                scale * (-0.5 * (u * u / own_x + v * v / own_y)).exp()
            }
        };
        for (column, along) in [(9, [1.0, 1.0]), (10, [1.0, -1.0])] {
            let [before, after] = [-step, step].map(|step| blurred(along.map(|sign| sign * step)));
            for (at, value) in found[column].iter().enumerate() {
                let difference = (after(at) - before(at)) / (2.0 * step);
                assert!((difference - value).abs() < 1e-7, "{column}: {difference} {value}");
            }
        }
        // h_uv of a product is the product of the derivatives.
        let off_axis = 27 * size + 40;
        let product = 5.0 / variances[0] * -3.0 / variances[1] * psf[off_axis];
        assert!((found[11][off_axis] - product).abs() < 1e-7, "{} {product}", found[11][off_axis]);
        // The three gains and the flux are the gain of one quadrant; a halo moves light and loses
        // none.
        for (at, h) in psf.iter().enumerate() {
            let sum = found[4][at] + found[5][at] + found[6][at] + 0.5 * h;
            let wanted = if at % size >= size / 2 && at / size >= size / 2 { 2.0 * h } else { 0.0 };
            assert!((sum - wanted).abs() < 1e-12, "{at}: {sum} {wanted}");
        }
        assert!(found[8].sum().abs() < 1e-9 * psf.iter().sum::<f64>());
    }
}
