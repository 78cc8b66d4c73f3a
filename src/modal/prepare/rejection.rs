//! Rejection of pixels that the fitted model does not explain: cosmic rays, hot and dead pixels,
//! columns and rows.
//!
//! At every renewal of the weights each pixel's residual is compared with its noise and with the
//! residuals around it. Where the model is wrong, or the fit is not at its minimum yet, residuals
//! are large together, over λ/D or more; those of a bad pixel are large alone. All pixels are
//! compared anew each time, so that a pixel that was rejected by a poor model returns.

use crate::imaging::Exposure;
use crate::modal::assess::chi2::pixel_variance;
use crate::modal::prepare::rejected::RejectedPixels;
use crate::modal::prepare::{Preparation, PreparedFrame};

/// Standard deviations beyond which a pixel is rejected. Of 100,000 pixels of Gaussian noise one in
/// 5,000 images is.
const LIMIT: f64 = 6.0;
/// The same for the square root of electrons, whose noise is the same for few electrons as for
/// many: single photons on dark pixels are no outliers.
const ROOT_LIMIT: f64 = 5.5;
/// Half a side of the square of pixels with whose residuals a pixel's is compared. A spot of 3 × 3
/// pixels, as a companion or the core of a star makes, is a third of it, two bad columns beside one
/// another are not.
const REACH: usize = 2;
/// Share of the pixels around one below whose residual the scale is: three of four.
const QUANTILE: f64 = 0.75;
/// The absolute value of a normal variable below which three of four are.
const NORMAL_QUANTILE: f64 = 1.150;
/// Least number of pixels that a scale can be of.
const LEAST_AROUND: usize = 6;
/// Parts in which a column or row is compared, so that no single part of it decides.
const PARTS: usize = 8;
/// Parts of a bad column or row that must be off in the same direction.
const LEAST_PARTS: usize = 3;
/// Standard deviations from which the mean of a part is off.
const PART_LIMIT: f64 = 5.0;
/// How many times the mean of a part is that of the same part of both neighbours. Light spreads
/// over two pixels or more: its error at the neighbours is a third or more.
const CONTRAST: f64 = 4.0;
/// Mean of the absolute value of a normal variable.
const NORMAL_MEAN: f64 = 0.798;
/// Columns that are surveyed at a time: their sums fit a core's nearest cache.
const STRIP: usize = 32;
/// Independent partial sums.
const LANES: usize = 4;
/// Most columns, and most rows, that are looked at.
const MOST_LINES: usize = 16;
/// Most times that pixels are compared with the model, with flux and background of those that are
/// left.
const ROUNDS: usize = 3;

/// The outlier pixels of a prepared image, by kind: what its preparation took out, and what its fit
/// rejected.
pub(in crate::modal) fn kinds(image: &PreparedFrame, preparation: &Preparation) -> RejectedPixels {
    let (data_e, floor_e2) = (&image.exposure.data_e, &image.floor_variance_e2);
    let side = preparation.pixels;
    let is_bad = |pixel: usize| floor_e2[pixel] == f64::INFINITY;
    let mut kinds = RejectedPixels::default();
    for &pixel in image.rejected.pixels() {
        let pixel = pixel as usize;
        let [x, y] = [pixel % side, pixel / side];
        let is_column = (x..data_e.len()).step_by(side).all(is_bad);
        if is_column || (y * side..(y + 1) * side).all(is_bad) {
            kinds.in_lines += 1;
            let axis = usize::from(!is_column);
            let place = preparation.place_in_frame(axis, [x, y][axis], image.shift_pixels[axis]);
            kinds.line[axis] = kinds.line[axis].or(place);
            continue;
        }
        let around = pixel.saturating_sub(2)..(pixel + 3).min(data_e.len());
        let (sum_e, count) = around
            .filter(|&other| !is_bad(other))
            .fold((0.0, 0), |(sum_e, count), other| (sum_e + data_e[other], count + 1));
        *(if data_e[pixel] * f64::from(count) < sum_e { &mut kinds.low } else { &mut kinds.high }) += 1;
    }
    kinds.and(image.taken_out)
}

/// Weighs pixels that are far darker than their neighbours by the electrons of these, for the fit
/// with the first weights: a dead pixel in the light would have the weight of a dark one, and would
/// pull the fit a hundred times as much as the pixels around it. The electrons are the larger of
/// what both neighbours in the row have, and both in the column. Whether there are such pixels.
pub(in crate::modal) fn weigh_dead(image: &mut PreparedFrame) -> bool {
    let PreparedFrame { exposure: Exposure { data_e, weight, .. }, floor_variance_e2, .. } = image;
    let side = data_e.len().isqrt();
    if side < 3 {
        return false;
    }
    let (inner, mut has_dead) = (1..side - 1, false);
    // Comparisons are vectorised, f64::min and max, which look for NaN, are not.
    let lesser = |a: f64, b: f64| if a < b { a } else { b };
    let greater = |a: f64, b: f64| if a > b { a } else { b };
    for row in inner.clone() {
        let [above, own, below] = [row - 1, row, row + 1].map(|row| &data_e[row * side..(row + 1) * side]);
        let floor_e2 = &floor_variance_e2[row * side..(row + 1) * side];
        let around =
            |[left, right, above, below]: [f64; 4]| greater(greater(lesser(left, right), lesser(above, below)), 0.0);
        let is_dead = |own: f64, floor_e2: f64, neighbours: [f64; 4]| {
            let around = around(neighbours);
            let below_e = around - own;
            (below_e > 0.0) & (below_e * below_e > LIMIT * LIMIT * (around + floor_e2))
        };
        // A loop over slices of one length without an early exit is vectorised.
        let count = inner.len();
        let beside = [&own[..count], &own[2..], &above[1..=count], &below[1..=count]];
        let (own, floor_e2) = (&own[1..=count], &floor_e2[1..=count]);
        let mut any = false;
        for x in 0..count {
            any |= is_dead(own[x], floor_e2[x], beside.map(|line| line[x]));
        }
        if !any {
            continue;
        }
        has_dead = true;
        for x in 0..count {
            let neighbours = beside.map(|line| line[x]);
            if is_dead(own[x], floor_e2[x], neighbours) {
                let weight = &mut weight[row * side + 1 + x];
                *weight = 1.0 / (1.0 / *weight - own[x].max(0.0) + around(neighbours));
            }
        }
    }
    has_dead
}

/// Rejects the pixels that have no weight, as the fit whose weights these are did.
pub(in crate::modal) fn reject_without_weight(image: &mut PreparedFrame) {
    for pixel in 0..image.floor_variance_e2.len() {
        let floor_e2 = &mut image.floor_variance_e2[pixel];
        if image.exposure.weight[pixel] == 0.0 && floor_e2.is_finite() && image.rejected.push(pixel) {
            *floor_e2 = f64::INFINITY;
        }
    }
}

/// Rejects the outlier pixels of `image` under the model with this PSF and the photometry that
/// `photometry` finds for its present weights: their floor becomes infinite. Pixels that were
/// rejected before are compared again. Returns flux and background without them, and whether other
/// pixels are rejected than before. Nothing is allocated.
pub(in crate::modal) fn reject(
    image: &mut PreparedFrame,
    psf: &[f64],
    photometry: impl Fn(&PreparedFrame) -> (f64, f64),
) -> ((f64, f64), bool) {
    let before = image.rejected.checksum();
    let mut found = photometry(image);
    for _ in 0..ROUNDS {
        let round = image.rejected.checksum();
        image.rejected.restore(&mut image.floor_variance_e2);
        let model = FittedModel { psf, photometry: found };
        model.mark_pixels(image);
        model.mark_lines(image);
        if image.rejected.checksum() == round {
            break;
        }
        crate::modal::assess::residual::reweigh(&mut image.exposure, psf, found, &image.floor_variance_e2);
        found = photometry(image);
    }
    (found, image.rejected.checksum() != before)
}

/// Model with which pixels are compared.
struct FittedModel<'a> {
    psf: &'a [f64],
    photometry: (f64, f64),
}

impl FittedModel<'_> {
    fn expected_e(&self, pixel: usize) -> f64 {
        self.photometry.0 * self.psf[pixel] + self.photometry.1
    }

    /// Residual of a pixel in standard deviations; 0 of a bad one.
    fn deviation(&self, image: &PreparedFrame, pixel: usize) -> f64 {
        let expected_e = self.expected_e(pixel);
        let variance_e2 = pixel_variance(expected_e, image.floor_variance_e2[pixel]);
        (image.exposure.data_e[pixel] - expected_e) / variance_e2.sqrt()
    }

    /// Marks single pixels; none where there are too many.
    fn mark_pixels(&self, image: &mut PreparedFrame) {
        let side = image.exposure.data_e.len().isqrt();
        for row in 0..side {
            if !self.has_candidate(image, row * side..(row + 1) * side) {
                continue;
            }
            for pixel in row * side..(row + 1) * side {
                let deviation = self.deviation(image, pixel);
                if deviation.abs() <= LIMIT || !self.is_outlier(image, pixel, deviation, side) {
                    continue;
                }
                if !image.rejected.push(pixel) {
                    image.rejected.clear();
                    return;
                }
            }
        }
        // Not before all were compared: each is compared with the others.
        let PreparedFrame { rejected, floor_variance_e2, .. } = image;
        rejected.pixels().iter().for_each(|&pixel| floor_variance_e2[pixel as usize] = f64::INFINITY);
    }

    /// Whether a pixel of `pixels` is beyond the limit. Without an early exit, so that it is
    /// vectorised.
    fn has_candidate(&self, image: &PreparedFrame, pixels: std::ops::Range<usize>) -> bool {
        let (flux_e, background_e) = self.photometry;
        let data = image.exposure.data_e[pixels.clone()].iter().zip(&self.psf[pixels.clone()]);
        data.zip(&image.floor_variance_e2[pixels]).fold(false, |any, ((d, h), &floor)| {
            let expected_e = flux_e * h + background_e;
            any | ((d - expected_e).powi(2) > LIMIT * LIMIT * pixel_variance(expected_e, floor))
        })
    }

    /// Whether a pixel beyond the limit is so alone.
    fn is_outlier(&self, image: &PreparedFrame, pixel: usize, deviation: f64, side: usize) -> bool {
        let (expected_e, floor_e2) = (self.expected_e(pixel).max(0.0), image.floor_variance_e2[pixel]);
        let root = |electrons: f64| 2.0 * (electrons.max(0.0) + floor_e2 + 0.375).sqrt();
        if deviation > 0.0 && root(image.exposure.data_e[pixel]) - root(expected_e) <= ROOT_LIMIT {
            return false;
        }
        let mut around = [0.0; (2 * REACH + 1).pow(2)];
        let mut count = 0;
        let range = |at: usize| at.saturating_sub(REACH)..(at + REACH + 1).min(side);
        for y in range(pixel / side) {
            for x in range(pixel % side) {
                let other = y * side + x;
                if other != pixel && image.floor_variance_e2[other].is_finite() {
                    around[count] = self.deviation(image, other).abs();
                    count += 1;
                }
            }
        }
        if count < LEAST_AROUND {
            return false;
        }
        let at = (QUANTILE * (count - 1) as f64).round() as usize;
        let (_, scale, _) = around[..count].select_nth_unstable_by(at, f64::total_cmp);
        deviation.abs() > LIMIT * (*scale / NORMAL_QUANTILE).max(1.0)
    }

    /// Marks columns and rows whose pixels are off together by less than a single pixel shows,
    /// where not all lines are.
    fn mark_lines(&self, image: &mut PreparedFrame) {
        let side = image.exposure.data_e.len().isqrt();
        for (axis, (step, stride)) in [(1, side), (side, 1)].into_iter().enumerate() {
            let mut survey = Survey::default();
            match axis {
                0 => self.survey_columns(image, side, &mut survey),
                _ => (0..side).for_each(|row| survey.add(row, &self.line(image, row * step, stride, side))),
            }
            let scale = (survey.deviations / (side * PARTS) as f64 / NORMAL_MEAN).max(1.0);
            for &number in &survey.candidates[..survey.count] {
                let line = |number: usize| self.line(image, number * step, stride, side);
                let beside = [number.checked_sub(1), Some(number + 1).filter(|&next| next < side)];
                let beside = beside.map(|number| number.map_or(Line::default(), line));
                if line(number).stands_out(&beside, scale) {
                    self.reject_line(image, number * step, stride, side);
                }
            }
        }
    }

    /// Adds all columns to `survey`: some at a time, so that pixels are read in the order of
    /// memory.
    fn survey_columns(&self, image: &PreparedFrame, side: usize, survey: &mut Survey) {
        let (flux_e, background_e) = self.photometry;
        for first in (0..side).step_by(STRIP) {
            let width = STRIP.min(side - first);
            let mut sums = [[[0.0; STRIP]; 2]; PARTS];
            for (part, [sum, weights]) in sums.iter_mut().enumerate() {
                for row in part * side / PARTS..(part + 1) * side / PARTS {
                    let pixels = row * side + first..row * side + first + width;
                    let data = image.exposure.data_e[pixels.clone()].iter().zip(&self.psf[pixels.clone()]);
                    let data = data.zip(&image.floor_variance_e2[pixels]);
                    for (((d, h), &floor), (sum, weights)) in data.zip(sum.iter_mut().zip(weights.iter_mut())) {
                        let expected_e = flux_e * h + background_e;
                        let weight = 1.0 / pixel_variance(expected_e, floor);
                        *sum += weight * (d - expected_e);
                        *weights += weight;
                    }
                }
            }
            for column in 0..width {
                let parts = sums.each_ref().map(|[sum, weights]| mean(sum[column], weights[column]));
                survey.add(first + column, &Line { parts });
            }
        }
    }

    /// Weighted means of the residuals of the parts of a line that begins at `first`.
    fn line(&self, image: &PreparedFrame, first: usize, stride: usize, side: usize) -> Line {
        let (flux_e, background_e) = self.photometry;
        let parts = std::array::from_fn(|part| {
            let (mut sum, mut weights) = ([0.0; LANES], [0.0; LANES]);
            for (place, at) in (part * side / PARTS..(part + 1) * side / PARTS).enumerate() {
                let pixel = first + at * stride;
                let expected_e = flux_e * self.psf[pixel] + background_e;
                let weight = 1.0 / pixel_variance(expected_e, image.floor_variance_e2[pixel]);
                sum[place % LANES] += weight * (image.exposure.data_e[pixel] - expected_e);
                weights[place % LANES] += weight;
            }
            mean(sum.iter().sum(), weights.iter().sum())
        });
        Line { parts }
    }

    fn reject_line(&self, image: &mut PreparedFrame, first: usize, stride: usize, side: usize) {
        let pixels = (0..side).map(|at| first + at * stride);
        for pixel in pixels {
            if image.floor_variance_e2[pixel].is_finite() && image.rejected.push(pixel) {
                image.floor_variance_e2[pixel] = f64::INFINITY;
            }
        }
    }
}

/// Weighted mean, e⁻, and its ratio to its standard deviation, of residuals with this weighted sum
/// and these weights.
fn mean(sum: f64, weights: f64) -> (f64, f64) {
    if weights > 0.0 { (sum / weights, sum / weights.sqrt()) } else { (0.0, 0.0) }
}

/// Deviations of all lines of an image.
#[derive(Default)]
struct Survey {
    /// Sum of the absolute deviations of all parts.
    deviations: f64,
    /// Lines that may stand out, of which there are `count`.
    candidates: [usize; MOST_LINES],
    count: usize,
}

impl Survey {
    fn add(&mut self, number: usize, line: &Line) {
        self.deviations += line.parts.iter().map(|(_, deviation)| deviation.abs()).sum::<f64>();
        if self.count < MOST_LINES && line.stands_out(&[Line::default(); 2], 1.0) {
            self.candidates[self.count] = number;
            self.count += 1;
        }
    }
}

/// Residual of a column or row, in parts: weighted mean, e⁻, and its ratio to its standard
/// deviation.
#[derive(Debug, Clone, Copy, Default)]
struct Line {
    parts: [(f64, f64); PARTS],
}

impl Line {
    /// Whether so many parts are off, as those of the lines `beside` it are not.
    fn stands_out(&self, beside: &[Self; 2], scale: f64) -> bool {
        let (mut high, mut low) = (0, 0);
        for (part, &(mean_e, deviation)) in self.parts.iter().enumerate() {
            let beside_e = beside.each_ref().map(|line| line.parts[part].0.abs());
            if deviation.abs() > PART_LIMIT * scale && mean_e.abs() > CONTRAST * beside_e[0].max(beside_e[1]) {
                *(if deviation > 0.0 { &mut high } else { &mut low }) += 1;
            }
        }
        high.max(low) >= LEAST_PARTS && high.min(low) == 0
    }
}

#[cfg(test)]
mod tests;
