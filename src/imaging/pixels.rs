//! Pixel stage: the mean of the intensity over the area of each pixel, and its adjoint.
//!
//! The image has no frequency beyond 1/q cycles a pixel at q pixels per λ/D, so for q ≥ 2 the
//! response of a pixel is a convolution of the samples: the first `REACH` terms on either side
//! along each axis. Beyond the border of the image its mirror image continues it, with which the
//! convolution is a symmetric matrix: it is its own adjoint, and keeps the sum.

use super::optics::Optics;
use super::phasor::Polynomial;
use crate::fourier::PixelResponse;
use cophase_numerics::systems::solve;
use ndarray::Array2;
use std::ops::Range;

/// Terms of the convolution on either side. Of Keck's spot of 1.5 waves at q = 2, on pixels without
/// gaps, 8 terms are 4e-5 off, 12 are 2e-5 (RMS of the difference over that of the image), which is
/// a twentieth of the error of the pupil's sampling.
const REACH: usize = 12;

/// Least weight of a frequency in the fit of the convolution, relative to that of frequency 0.
const LEAST_CONTRAST: f64 = 1e-3;

/// Frequencies in the fit of the convolution.
const FREQUENCIES: usize = 512;

/// Terms of a symmetric convolution: of the pixel itself, and of those at a distance of 1, 2, … on
/// both sides.
type Terms<T> = [T; REACH + 1];

/// Convolution of an image with the response of its pixels.
pub(super) struct Pixels<T> {
    along_x: Terms<T>,
    along_y: Terms<T>,
    /// Pixels along a side.
    pixels: usize,
}

impl<T: Polynomial> Pixels<T> {
    /// The stage of `optics`; `None` where its pixels are points.
    pub(super) fn of(optics: &Optics) -> Option<Self> {
        let [along_x, along_y] = convolution(optics)?.map(|terms| terms.map(T::narrow));
        Some(Self { along_x, along_y, pixels: optics.sampling().pixels })
    }

    /// Replaces an image (`[y][x]`) by its convolution; `work` is as large.
    #[inline(always)]
    pub(super) fn apply(&self, image: &mut [T], work: &mut [T]) {
        let m = self.pixels;
        for (line, out) in image.chunks_exact(m).zip(work.chunks_exact_mut(m)) {
            self.convolve_row(line, out);
        }
        for (y, out) in image.chunks_exact_mut(m).enumerate() {
            self.convolve_columns(work, 0, y, out);
        }
    }

    /// Rows of an image that the convolution of `rows` needs.
    pub(super) fn needed(&self, rows: &Range<usize>) -> Range<usize> {
        rows.start.saturating_sub(REACH)..self.pixels.min(rows.end + REACH)
    }

    /// Gives `out` each row of the convolution in turn, from the image's rows [`Pixels::needed`],
    /// which it overwrites.
    pub(super) fn apply_to_rows(
        &self,
        needed: &mut [T],
        rows: &Range<usize>,
        work: &mut Vec<T>,
        mut out: impl FnMut(&[T]),
    ) {
        let m = self.pixels;
        let first = self.needed(rows).start;
        work.resize(m, T::zero());
        for line in needed.chunks_exact_mut(m) {
            work.copy_from_slice(line);
            self.convolve_row(work, line);
        }
        for y in rows.clone() {
            self.convolve_columns(needed, first, y, work);
            out(work);
        }
    }

    #[inline(always)]
    fn convolve_row(&self, line: &[T], out: &mut [T]) {
        let m = self.pixels;
        let inside = REACH.min(m)..m.saturating_sub(REACH).max(REACH.min(m));
        for x in (0..inside.start).chain(inside.end..m) {
            out[x] = self.along_x[0] * line[x];
            for (k, &term) in self.along_x.iter().enumerate().skip(1) {
                let (below, above) = (x as isize - k as isize, (x + k) as isize);
                out[x] += term * (line[mirrored(below, m)] + line[mirrored(above, m)]);
            }
        }
        if inside.is_empty() {
            return;
        }
        // Without a mirror the loop over the pixels is vectorised. Products are not fused with
        // sums: where this is not compiled for vectors, that is a function call.
        for (x, out) in inside.clone().zip(&mut out[inside.clone()]) {
            *out = self.along_x[0] * line[x];
        }
        for (k, &term) in self.along_x.iter().enumerate().skip(1) {
            let below = &line[inside.start - k..inside.end - k];
            let above = &line[inside.start + k..inside.end + k];
            for ((out, &below), &above) in out[inside.clone()].iter_mut().zip(below).zip(above) {
                *out += term * (below + above);
            }
        }
    }

    /// Row `y` of the convolution along y of `lines`, the first of which is row `first` of the
    /// image.
    #[inline(always)]
    fn convolve_columns(&self, lines: &[T], first: usize, y: usize, out: &mut [T]) {
        let m = self.pixels;
        let line = |at: isize| {
            let row = mirrored(at, m) - first;
            &lines[row * m..(row + 1) * m]
        };
        for (out, &value) in out.iter_mut().zip(line(y as isize)) {
            *out = self.along_y[0] * value;
        }
        for (k, &term) in self.along_y.iter().enumerate().skip(1) {
            let (below, above) = (line(y as isize - k as isize), line((y + k) as isize));
            for ((out, &below), &above) in out.iter_mut().zip(below).zip(above) {
                *out += term * (below + above);
            }
        }
    }
}

/// Index of a pixel of a row of `m`, continued by its mirror image on both sides.
#[inline(always)]
fn mirrored(at: isize, m: usize) -> usize {
    let at = at.rem_euclid(2 * m as isize) as usize;
    if at < m { at } else { 2 * m - 1 - at }
}

/// Terms of the convolution along x and along y; `None` where pixels are points.
fn convolution(optics: &Optics) -> Option<[Terms<f64>; 2]> {
    let parts = optics.parts();
    if parts.pixel.iter().all(PixelResponse::is_point) {
        return None;
    }
    // The frequencies of the shortest wavelength reach farthest.
    let shortest = parts.colours.iter().map(|colour| colour.ratio).fold(f64::INFINITY, f64::min);
    let cut_off = 1.0 / (parts.sampling.pixels_per_lambda_over_d * shortest);
    Some(parts.pixel.map(|response| terms(response, cut_off)))
}

/// The same as lists, for a device.
pub(super) fn pixel_terms(optics: &Optics) -> Option<[Vec<f64>; 2]> {
    convolution(optics).map(|axes| axes.map(|terms| terms.to_vec()))
}

/// Terms of the convolution whose transfer function a₀ + 2 Σ aₖ cos(2πkf) is that of `response`:
/// least squares over the frequencies f, with the contrast of a circular aperture of this cut-off
/// as their weights, and a sum of 1.
fn terms(response: PixelResponse, cut_off: f64) -> Terms<f64> {
    // With a₀ = 1 − 2 Σ aₖ the unknowns are those of 2 (cos(2πkf) − 1).
    let term = |k: usize, f: f64| 2.0 * ((std::f64::consts::TAU * (k + 1) as f64 * f).cos() - 1.0);
    let (mut normal, mut right) = (Array2::<f64>::zeros((REACH, REACH)), Array2::<f64>::zeros((REACH, 1)));
    for f in (0..FREQUENCIES).map(|i| 0.5 * (i as f64 + 0.5) / FREQUENCIES as f64) {
        let weight = contrast(f / cut_off).powi(2) + LEAST_CONTRAST.powi(2);
        for i in 0..REACH {
            right[(i, 0)] += weight * term(i, f) * (response.transfer(f) - 1.0);
            for j in 0..REACH {
                normal[(i, j)] += weight * term(i, f) * term(j, f);
            }
        }
    }
    let found = solve(normal.view(), right.view());
    std::array::from_fn(|k| match k {
        0 => 1.0 - 2.0 * (0..REACH).map(|i| found[(i, 0)]).sum::<f64>(),
        k => found[(k - 1, 0)],
    })
}

/// Modulation transfer function of a circular aperture at a frequency relative to its cut-off.
fn contrast(x: f64) -> f64 {
    if x < 1.0 { std::f64::consts::FRAC_2_PI * (x.acos() - x * (1.0 - x * x).sqrt()) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pixels(responses: [PixelResponse; 2], cut_off: f64, side: usize) -> Pixels<f64> {
        let [along_x, along_y] = responses.map(|response| terms(response, cut_off));
        Pixels { along_x, along_y, pixels: side }
    }

    fn square(width_pixels: f64) -> PixelResponse {
        PixelResponse { width_pixels, diffusion_pixels: 0.0 }
    }

    /// The transfer function of the convolution is that of the pixel where the aperture has
    /// contrast.
    #[test]
    fn the_terms_have_the_transfer_function_of_the_pixel() {
        let diffused = PixelResponse { width_pixels: 1.0, diffusion_pixels: 0.6 };
        // The derivative of a square's transfer function is not 0 at half a cycle, where that of a
        // convolution is: the sampling decides how much contrast there is. Charge that diffuses
        // leaves nothing there.
        for (response, q, bound) in
            [(square(1.0), 2.0, 1e-4), (square(0.5), 2.0, 5e-5), (square(1.0), 2.5, 2e-5), (diffused, 2.0, 1e-4)]
        {
            let terms = terms(response, 1.0 / q);
            assert!((terms[0] + 2.0 * terms[1..].iter().sum::<f64>() - 1.0).abs() < 1e-14);
            let (mut error, mut all) = (0.0, 0.0);
            for f in (0..1000).map(|i| 0.5 * (f64::from(i) + 0.5) / 1000.0) {
                let waves = (1..=REACH).map(|k| 2.0 * terms[k] * (std::f64::consts::TAU * k as f64 * f).cos());
                let found = terms[0] + waves.sum::<f64>();
                error += ((found - response.transfer(f)) * contrast(f * q)).powi(2);
                all += contrast(f * q).powi(2);
            }
            let relative = (error / all).sqrt();
            println!("{response:?} at {q} pixels per λ/D: {relative:.1e}");
            assert!(relative < bound, "{response:?} {q}: {relative:e}");
        }
    }

    #[test]
    fn the_convolution_is_its_own_adjoint_and_keeps_the_sum() {
        for side in [8, 14, 40] {
            let stage = pixels([square(1.0), square(0.4)], 0.5, side);
            let image = |seed: f64| (0..side * side).map(|i| (seed * i as f64).sin()).collect::<Vec<f64>>();
            let applied = |mut image: Vec<f64>| {
                stage.apply(&mut image, &mut vec![0.0; side * side]);
                image
            };
            let (a, b) = (image(1.3), image(0.7));
            let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            // Sums of some hundred products of order 1.
            let difference = product(&applied(a.clone()), &b) - product(&a, &applied(b.clone()));
            assert!(difference.abs() < 1e-12, "{side}: {difference:e}");
            let change = applied(a.clone()).iter().sum::<f64>() - a.iter().sum::<f64>();
            assert!(change.abs() < 1e-12, "{side}: {change:e}");
        }
    }

    #[test]
    fn rows_are_those_of_the_whole_image() {
        let side = 32;
        let stage = pixels([square(0.9), square(1.0)], 0.5, side);
        let image: Vec<f64> = (0..side * side).map(|i| (0.37 * i as f64).cos()).collect();
        let mut whole = image.clone();
        stage.apply(&mut whole, &mut vec![0.0; side * side]);
        for rows in [0..side, 0..1, 3..9, 30..32] {
            let needed = stage.needed(&rows);
            let mut part = image[needed.start * side..needed.end * side].to_vec();
            let mut found = Vec::new();
            stage.apply_to_rows(&mut part, &rows, &mut Vec::new(), |line| found.extend_from_slice(line));
            // The same operations in the same order.
            assert_eq!(found, whole[rows.start * side..rows.end * side], "{rows:?}");
        }
    }
}
