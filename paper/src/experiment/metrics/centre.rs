//! Sub-pixel centring by Fourier interpolation and a Fourier shift.
//!
//! A PSF sampled at least twice per λ/D is band-limited, so its Fourier interpolant equals the PSF
//! between the pixels (except for the light beyond the edges of the box). The peak is found on the
//! interpolant, and the image is shifted by a phase on its transform, without blur, as in Poyneer
//! 2003 (Appl. Opt. 42, 5807).

use super::fft2;
use cophase::{Error, Result};
use ndarray::{Array2, ArrayView2, Zip};
use num_complex::Complex64;
use std::f64::consts::PI;

/// Image with its peak on a pixel.
#[derive(Debug, Clone)]
pub struct CentredImage {
    /// `[y, x]`; the peak is on pixel `[rows/2, columns/2]`, the pixel of the optical axis.
    pub image: Array2<f64>,
    /// Shift that was applied, `[y, x]`, pixels.
    pub shift_px: [f64; 2],
}

/// Shifts `image`, `[y, x]`, so that its peak lies on pixel `[rows/2, columns/2]`.
///
/// The peak is the maximum of the Fourier interpolant next to the brightest pixel. The shift wraps
/// around the edges of the box and conserves the sum, so crop to the star first. The image should
/// be sampled at least twice per λ/D.
///
/// # Errors
/// [`Error::Image`] for an image that is empty, constant, or has a value that is not finite, and if
/// the ascent to the peak does not converge.
pub fn centre(image: ArrayView2<f64>) -> Result<CentredImage> {
    let interpolant = Interpolant::new("image", image)?;
    let peak = interpolant.peak()?;
    let (rows, columns) = image.dim();
    let shift_px = [(rows / 2) as f64 - peak.at[0], (columns / 2) as f64 - peak.at[1]];
    Ok(CentredImage { image: interpolant.shifted(shift_px), shift_px })
}

/// Largest number of steps of the ascent. Newton's method takes about 5 on a PSF; elsewhere a step
/// is at most half a pixel.
const STEPS: usize = 50;

/// Longest step, pixels: the core of a PSF at the Nyquist limit is concave within about this
/// distance of its peak.
const LONGEST_PX: f64 = 0.5;

/// Length of a step at which the ascent ends, pixels. The error of the peak's height is of the
/// order of its square.
const SHORTEST_PX: f64 = 1e-9;

/// Maximum of an interpolant.
pub(super) struct Peak {
    /// `[y, x]`, pixels.
    pub(super) at: [f64; 2],
    /// In units of the image.
    pub(super) height: f64,
}

/// Trigonometric polynomial through the pixels of an image.
pub(super) struct Interpolant {
    /// `[kx, ky]`, not normalised, frequency 0 first.
    spectrum: Array2<Complex64>,
}

/// Height, slope and curvature of the interpolant at a point.
struct Local {
    height: f64,
    slope: [f64; 2],
    /// yy, xy, xx.
    curvature: [f64; 3],
}

impl Interpolant {
    /// Interpolant of `image`, `[y, x]`; error messages call it `name`.
    pub(super) fn new(name: &str, image: ArrayView2<f64>) -> Result<Self> {
        check(name, image)?;
        Ok(Self { spectrum: fft2::spectrum(image) })
    }

    /// Removes the frequencies beyond `cut_off`, cycles per pixel.
    pub(super) fn low_passed(mut self, cut_off: f64) -> Self {
        let (columns, rows) = self.spectrum.dim();
        // A frequency equal to the cut-off is kept; the factor allows for rounding.
        let limit = (cut_off * (1.0 + 1e-12)).powi(2);
        for ((x, y), value) in self.spectrum.indexed_iter_mut() {
            if frequency(x, columns).powi(2) + frequency(y, rows).powi(2) > limit {
                *value = Complex64::default();
            }
        }
        self
    }

    /// Sum of the image over its pixels.
    pub(super) fn sum(&self) -> f64 {
        self.spectrum[[0, 0]].re
    }

    /// Finds the maximum by ascent from the brightest pixel, so the peak is not lower than that
    /// pixel.
    pub(super) fn peak(&self) -> Result<Peak> {
        let pixels = fft2::image(self.spectrum.view());
        let brightest = pixels.indexed_iter().max_by(|a, b| a.1.total_cmp(b.1)).map_or((0, 0), |(at, _)| at);
        let mut at = [brightest.0 as f64, brightest.1 as f64];
        let mut here = self.local(at);
        for _ in 0..STEPS {
            let mut step = here.ascent();
            loop {
                if step[0].hypot(step[1]) < SHORTEST_PX {
                    return Ok(Peak { at, height: here.height });
                }
                let next_at = [at[0] + step[0], at[1] + step[1]];
                let next = self.local(next_at);
                if next.height >= here.height {
                    (at, here) = (next_at, next);
                    break;
                }
                step = step.map(|s| s / 2.0);
            }
        }
        Err(Error::Image(format!(
            "the image has no peak to centre on: the search from its brightest pixel, row {}, column {}, has not converged \
             after {STEPS} steps of at most {LONGEST_PX} pixels; crop the image to the star",
            brightest.0, brightest.1
        )))
    }

    /// Image shifted by `by_px`, `[y, x]`.
    fn shifted(&self, by_px: [f64; 2]) -> Array2<f64> {
        let (columns, rows) = self.spectrum.dim();
        let [along_y, _, _] = phasors(rows, -by_px[0]);
        let [along_x, _, _] = phasors(columns, -by_px[1]);
        let mut spectrum = self.spectrum.clone();
        Zip::indexed(&mut spectrum).for_each(|(x, y), value| *value *= along_x[x] * along_y[y]);
        fft2::image(spectrum.view())
    }

    fn local(&self, at: [f64; 2]) -> Local {
        let (columns, rows) = self.spectrum.dim();
        let (along_y, along_x) = (phasors(rows, at[0]), phasors(columns, at[1]));
        // h, h_y, h_x, h_yy, h_xy, h_xx.
        let mut sums = [0.0; 6];
        for (x, line) in self.spectrum.outer_iter().enumerate() {
            let mut inner = [Complex64::default(); 3];
            for (y, &value) in line.iter().enumerate() {
                for (sum, phasor) in inner.iter_mut().zip(&along_y) {
                    *sum += value * phasor[y];
                }
            }
            for (sum, (dy, dx)) in sums.iter_mut().zip([(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]) {
                *sum += (inner[dy] * along_x[dx][x]).re;
            }
        }
        let [height, y, x, yy, xy, xx] = sums.map(|sum| sum / (rows * columns) as f64);
        Local { height, slope: [y, x], curvature: [yy, xy, xx] }
    }
}

impl Local {
    /// Ascent step: Newton's if the Hessian is negative definite, along the gradient otherwise; at
    /// most [`LONGEST_PX`] long.
    fn ascent(&self) -> [f64; 2] {
        let ([y, x], [yy, xy, xx]) = (self.slope, self.curvature);
        let determinant = yy * xx - xy * xy;
        let step = if yy < 0.0 && determinant > 0.0 {
            [(xy * x - xx * y) / determinant, (xy * y - yy * x) / determinant]
        } else if y != 0.0 || x != 0.0 {
            [y, x].map(|s| s / y.hypot(x) * LONGEST_PX)
        } else {
            [0.0; 2]
        };
        let length = step[0].hypot(step[1]);
        if length > LONGEST_PX { step.map(|s| s / length * LONGEST_PX) } else { step }
    }
}

/// Frequency of index `k` of a transform of length `n`, cycles per sample.
fn frequency(k: usize, n: usize) -> f64 {
    (if 2 * k <= n { k as f64 } else { k as f64 - n as f64 }) / n as f64
}

/// `exp(2πi·f_k·at)` for each frequency, and its first and second derivatives with respect to `at`.
/// The Nyquist frequency of an even length represents both signs, a cosine, so the interpolant of a
/// real image is real.
fn phasors(n: usize, at: f64) -> [Vec<Complex64>; 3] {
    let mut phasors = [0; 3].map(|_| Vec::with_capacity(n));
    for k in 0..n {
        let rate = 2.0 * PI * frequency(k, n);
        let (sin, cos) = (rate * at).sin_cos();
        let wave = if 2 * k == n {
            [Complex64::from(cos), Complex64::from(-rate * sin), Complex64::from(-rate * rate * cos)]
        } else {
            let phasor = Complex64::new(cos, sin);
            [phasor, phasor * Complex64::new(0.0, rate), -phasor * rate * rate]
        };
        phasors.iter_mut().zip(wave).for_each(|(list, value)| list.push(value));
    }
    phasors
}

fn check(name: &str, image: ArrayView2<f64>) -> Result<()> {
    let (rows, columns) = image.dim();
    let Some(&first) = image.first() else {
        return Err(Error::Image(format!(
            "the {name} of {rows}x{columns} pixels is empty; an image with a peak is needed"
        )));
    };
    if let Some(((y, x), value)) = image.indexed_iter().find(|(_, value)| !value.is_finite()) {
        return Err(Error::Image(format!("the {name} is {value} at row {y}, column {x}; finite values are needed")));
    }
    if image.iter().all(|&value| value == first) {
        return Err(Error::Image(format!("the {name} is {first} everywhere; an image with a peak is needed")));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A Gaussian of 1.4 pixels RMS: at the Nyquist frequency its spectrum is exp(−2(π·1.4/2)²) =
    /// 6e-5, at the edges of the box (20 pixels off, at least 8 RMS) it is below 1e-14.
    const RMS_PX: f64 = 1.4;
    const ALIASED: f64 = 6e-5;

    fn spot(rows: usize, columns: usize, [y0, x0]: [f64; 2]) -> Array2<f64> {
        let square = |y: usize, x: usize| (y as f64 - y0).powi(2) + (x as f64 - x0).powi(2);
        Array2::from_shape_fn((rows, columns), |(y, x)| (-square(y, x) / (2.0 * RMS_PX * RMS_PX)).exp())
    }

    #[test]
    fn a_spot_between_pixels_is_shifted_onto_one() {
        for (rows, columns, at) in
            [(40, 48, [19.3, 23.6]), (41, 45, [20.5, 22.49]), (40, 45, [17.0, 25.5]), (48, 48, [24.0, 24.0])]
        {
            let image = spot(rows, columns, at);
            let centred = centre(image.view()).unwrap();
            let wanted = [(rows / 2) as f64, (columns / 2) as f64];
            let expected = spot(rows, columns, wanted);
            let worst = (&centred.image - &expected).iter().fold(0.0f64, |worst, d| worst.max(d.abs()));
            // The spectrum beyond Nyquist is aliased and shifted by a wrong phase: an error of at
            // most twice that, in a few rows.
            assert!(worst < 4.0 * ALIASED, "{worst:.1e}");
            for ((shift, wanted), at) in centred.shift_px.iter().zip(wanted).zip(at) {
                // Slope of the aliased part, at most π·6e-5, over the curvature of the top, 1/1.4².
                assert!((shift - (wanted - at)).abs() < PI * ALIASED * RMS_PX * RMS_PX, "{shift} {wanted} {at}");
            }
            // The sum is frequency 0, which a shift does not change: rounding of 2000 sums.
            assert!((centred.image.sum() / image.sum() - 1.0).abs() < 1e-13);
            let brightest = centred.image.iter().copied().fold(f64::MIN, f64::max);
            assert_eq!(centred.image[[rows / 2, columns / 2]], brightest);
        }
    }

    #[test]
    fn interpolant_equals_pixels_and_its_finite_differences() {
        let values = Array2::from_shape_fn((6, 9), |(y, x)| ((7 * y + 3 * x * x) % 11) as f64);
        let interpolant = Interpolant::new("image", values.view()).unwrap();
        for ((y, x), value) in values.indexed_iter() {
            // 54 terms of at most about 270/54 each.
            assert!((interpolant.local([y as f64, x as f64]).height - value).abs() < 1e-12);
        }
        let (at, step) = ([2.3, 4.4], 1e-4);
        let here = interpolant.local(at);
        let [up, down] = [step, -step].map(|s| interpolant.local([at[0] + s, at[1]]));
        let [right, left] = [step, -step].map(|s| interpolant.local([at[0], at[1] + s]));
        // Central differences of waves of at most π per pixel: π³/6·step² = 5e-8 of heights of the
        // order 10, times π for each further derivative.
        let pairs = [
            (here.slope[0], up.height - down.height),
            (here.slope[1], right.height - left.height),
            (here.curvature[0], up.slope[0] - down.slope[0]),
            (here.curvature[1], right.slope[0] - left.slope[0]),
            (here.curvature[2], right.slope[1] - left.slope[1]),
        ];
        for (derivative, difference) in pairs {
            assert!((derivative - difference / (2.0 * step)).abs() < 2e-6, "{derivative} {difference}");
        }
    }

    #[test]
    fn images_without_a_peak_are_refused_with_the_reason() {
        let mut holed = spot(20, 20, [10.0, 10.0]);
        holed[[3, 4]] = f64::NAN;
        for (image, named) in [
            (Array2::zeros((0, 5)), "0x5"),
            (Array2::from_elem((5, 5), 7.5), "7.5 everywhere"),
            (Array2::from_elem((1, 1), 1.0), "1 everywhere"),
            (holed, "row 3, column 4"),
        ] {
            let error = centre(image.view()).unwrap_err();
            assert!(matches!(error, Error::Image(_)) && error.to_string().contains(named), "{error}");
        }
    }
}
