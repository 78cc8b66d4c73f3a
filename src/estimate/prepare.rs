//! From a detector frame to the exposure that the chain compares with: checked, reduced to the model's sampling with
//! its noise carried along, centred, cropped, weighted.

use super::recipe::Recipe;
use crate::imaging::{Exposure, Photometry};
use crate::scene::Weighting;
use crate::{Error, Result};
use ndarray::{Array2, ArrayView2, Zip, s};
use num_complex::Complex64;
use rustfft::FftPlanner;

/// One frame as it comes: electrons, and which pixels are bad.
#[derive(Debug, Clone, Copy)]
pub struct Frame<'a> {
    /// Electrons, `[y, x]`.
    pub data_e: ArrayView2<'a, f64>,
    /// Bad pixels, `[y, x]`; pixels that are not finite count as bad whether marked or not.
    pub bad: ArrayView2<'a, bool>,
    /// Read noise of a pixel, RMS electrons.
    pub read_noise_e: f64,
}

/// How frames become exposures of one model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Preparation {
    /// Pixels along a side of a frame.
    pub frame_pixels: usize,
    /// Pixels along a side after the reduction to the model's sampling (equal to `frame_pixels` where there is none).
    pub reduced_pixels: usize,
    /// Pixels along a side of the part that is fitted.
    pub pixels: usize,
    /// Whether the detector's columns, and its rows, run against the axes.
    pub flip: [bool; 2],
}

/// A frame made ready.
#[derive(Debug, Clone)]
pub struct Prepared {
    /// What the chain compares with.
    pub exposure: Exposure,
    /// Variance of each pixel without the star's photons (read noise and background), e²; infinite for a bad pixel.
    pub floor_variance_e2: Vec<f64>,
    /// Level of the frame's border, e⁻ per model pixel: a first guess of the background.
    pub level_e: f64,
    /// Whole model pixels by which the frame was moved, along x and y: the star stands there.
    pub shift_pixels: [i64; 2],
    /// Pixels that take no part.
    pub bad_pixels: usize,
}

impl Preparation {
    /// Makes `frame` ready.
    ///
    /// # Errors
    /// [`Error::Shape`] for a frame of another size than the scene's, [`Error::Image`] for one that holds no star.
    pub fn prepare(&self, frame: Frame, recipe: &Recipe) -> Result<Prepared> {
        let (data, bad) = self.oriented(frame)?;
        refuse_unusable(&data, &bad)?;
        let (level, scatter) = border(&data, &bad);
        let ratio = self.frame_pixels as f64 / self.reduced_pixels as f64;
        // Without a stated read noise the border's scatter stands for it; 1 e⁻ keeps weights finite on synthetic frames.
        let read_noise_e = if frame.read_noise_e > 0.0 { frame.read_noise_e } else { scatter.max(1.0) };
        let (data, bad) = if self.reduced_pixels < self.frame_pixels {
            (reduce(&data, self.reduced_pixels), Array2::from_elem([self.reduced_pixels; 2], false))
        } else {
            (data, bad)
        };
        let level = level * ratio * ratio;
        let shift = if recipe.recentre { off_axis(&data, &bad, level) } else { [0, 0] };
        let (data, bad) = crop(&data, &bad, self.pixels, shift);
        // A sum over ratio² native pixels: their read variances add, and their photons are in the data.
        let floor = (read_noise_e * ratio).powi(2);
        let floor_variance_e2: Vec<f64> = bad.iter().map(|&bad| if bad { f64::INFINITY } else { floor }).collect();
        let brightest = data.iter().zip(&bad).filter(|(_, bad)| !**bad).fold(0.0f64, |m, (&d, _)| m.max(d));
        let weight = match recipe.weighting {
            Weighting::Noise => {
                data.iter().zip(&floor_variance_e2).map(|(d, floor)| 1.0 / (d.max(0.0) + floor)).collect()
            }
            // Scaled by the brightest pixel, so that a tolerance means the same for a bright and for a faint star.
            Weighting::None => bad.iter().map(|&bad| if bad { 0.0 } else { 1.0 / (brightest * brightest) }).collect(),
        };
        let photometry = match (recipe.fit_flux, recipe.fit_background) {
            (true, true) => Photometry::FitBoth,
            (true, false) => Photometry::FitFlux { background_e: 0.0 },
            (false, _) => Photometry::Fixed { flux_e: data.sum(), background_e: 0.0 },
        };
        let bad_pixels = bad.iter().filter(|bad| **bad).count();
        let exposure = Exposure { data_e: data.into_raw_vec_and_offset().0, weight, photometry };
        Ok(Prepared { exposure, floor_variance_e2, level_e: level, shift_pixels: shift, bad_pixels })
    }

    /// The frame in the model's orientation; bad pixels hold 0.
    fn oriented(&self, frame: Frame) -> Result<(Array2<f64>, Array2<bool>)> {
        let wanted = (self.frame_pixels, self.frame_pixels);
        if frame.data_e.dim() != wanted || frame.bad.dim() != wanted {
            let (rows, columns) = frame.data_e.dim();
            return Err(Error::Shape(format!(
                "the image has {columns}x{rows} pixels where the scene says {0}x{0} (image.pixels)",
                self.frame_pixels
            )));
        }
        let step = |flip: bool| if flip { -1 } else { 1 };
        let [x, y] = self.flip.map(step);
        let mut bad = frame.bad.slice(s![..;y, ..;x]).to_owned();
        let mut data = frame.data_e.slice(s![..;y, ..;x]).to_owned();
        Zip::from(&mut data).and(&mut bad).for_each(|data, bad| {
            *bad |= !data.is_finite();
            if *bad {
                *data = 0.0;
            }
        });
        // Flipping an even number of pixels moves the axis from pixel M/2 to M/2 − 1: move it back, and drop the line
        // that wraps around.
        for (axis, &flip) in [1, 0].iter().zip(&self.flip) {
            if flip {
                roll_by_one(&mut data, &mut bad, *axis);
            }
        }
        Ok((data, bad))
    }
}

fn roll_by_one(data: &mut Array2<f64>, bad: &mut Array2<bool>, axis: usize) {
    for (mut data, mut bad) in data.lanes_mut(ndarray::Axis(axis)).into_iter().zip(bad.lanes_mut(ndarray::Axis(axis))) {
        for i in (1..data.len()).rev() {
            (data[i], bad[i]) = (data[i - 1], bad[i - 1]);
        }
        (data[0], bad[0]) = (0.0, true);
    }
}

/// Refuses frames without a star in them, each with the reason.
fn refuse_unusable(data: &Array2<f64>, bad: &Array2<bool>) -> Result<()> {
    let good: Vec<f64> = data.iter().zip(bad).filter(|(_, bad)| !**bad).map(|(&d, _)| d).collect();
    let refuse = |reason: &str| Err(Error::Image(format!("the image {reason}")));
    if good.is_empty() {
        return refuse("has no good pixel: all are bad or not finite");
    }
    // Fewer pixels than this cannot fix even a handful of modes.
    if good.len() < 64 {
        return refuse(&format!("has only {} good pixels: at least 64 are needed", good.len()));
    }
    let (least, most) = good.iter().fold((f64::MAX, f64::MIN), |(a, b), &d| (a.min(d), b.max(d)));
    if least == most {
        return refuse(&format!("is constant: every good pixel holds {least}"));
    }
    if most <= 0.0 {
        return refuse(&format!("has no positive pixel: the largest value is {most}, and electrons are needed"));
    }
    let (level, _) = border(data, bad);
    let flux: f64 = good.iter().map(|d| d - level).sum();
    if flux <= 0.0 {
        return refuse(&format!(
            "holds no star: its flux above the border's level is {flux:.3e}, and must be positive"
        ));
    }
    Ok(())
}

/// Median and scatter (1.4826 times the median deviation) of the frame's border, an eighth of it wide.
fn border(data: &Array2<f64>, bad: &Array2<bool>) -> (f64, f64) {
    let size = data.nrows();
    let inner = size / 8..size - size / 8;
    let outside =
        data.indexed_iter().zip(bad).filter(|((at, _), bad)| !**bad && [at.0, at.1].iter().any(|c| !inner.contains(c)));
    let mut values: Vec<f64> = outside.map(|((_, &d), _)| d).collect();
    let level = median(&mut values);
    let mut deviations: Vec<f64> = values.iter().map(|d| (d - level).abs()).collect();
    (level, 1.4826 * median(&mut deviations))
}

fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Low-passes and decimates a frame to `size` pixels a side by cropping its Fourier transform. The sum of the image is
/// kept; a PSF whose spectrum ends below the new Nyquist frequency keeps its values at the new pixels, and white noise
/// stays white.
fn reduce(data: &Array2<f64>, size: usize) -> Array2<f64> {
    let full = data.nrows();
    let mut planner = FftPlanner::new();
    let (forward, inverse) = (planner.plan_fft_forward(full), planner.plan_fft_inverse(size));
    let lines = |array: Array2<Complex64>| {
        let half = size / 2;
        // Each row: transform, keep the low frequencies, transform back; then the caller turns the array over.
        let mut out = Array2::zeros((array.nrows(), size));
        for (row, mut out) in array.rows().into_iter().zip(out.rows_mut()) {
            let mut line = row.to_vec();
            forward.process(&mut line);
            let mut kept: Vec<Complex64> = line[..half].iter().chain(&line[full - half..]).copied().collect();
            // The Nyquist frequency of the new grid stands for both of its signs.
            kept[half] = (kept[half] + line[half]) * 0.5;
            inverse.process(&mut kept);
            out.assign(&ndarray::Array1::from(kept));
        }
        out
    };
    let along_x = lines(data.mapv(Complex64::from));
    let along_y = lines(along_x.reversed_axes().as_standard_layout().to_owned());
    let scale = 1.0 / (size * size) as f64;
    along_y.reversed_axes().mapv(|value| value.re * scale).as_standard_layout().to_owned()
}

/// Whole pixels from the axis to the star's centroid; 0 within 3 pixels, where exact tip and tilt do better.
fn off_axis(data: &Array2<f64>, bad: &Array2<bool>, level: f64) -> [i64; 2] {
    let axis = (data.nrows() / 2) as f64;
    // Only what stands out: 5 % of the brightest pixel, so that noise far away does not pull.
    let brightest = data.iter().fold(f64::MIN, |m, &d| m.max(d - level));
    let (mut sum, mut x, mut y) = (0.0, 0.0, 0.0);
    for (((v, u), &value), &bad) in data.indexed_iter().zip(bad) {
        let value = value - level;
        if !bad && value > 0.05 * brightest {
            (sum, x, y) = (sum + value, x + value * u as f64, y + value * v as f64);
        }
    }
    [x, y].map(|moment| {
        let offset = moment / sum - axis;
        if offset.abs() > 3.0 { offset.round() as i64 } else { 0 }
    })
}

/// The central `size` pixels about the axis moved by `shift`; what lies outside the frame is bad.
fn crop(data: &Array2<f64>, bad: &Array2<bool>, size: usize, shift: [i64; 2]) -> (Array2<f64>, Array2<bool>) {
    let full = data.nrows() as i64;
    let first = full / 2 - size as i64 / 2;
    let at = |(v, u): (usize, usize)| {
        let (y, x) = (v as i64 + first + shift[1], u as i64 + first + shift[0]);
        ((0..full).contains(&y) && (0..full).contains(&x)).then_some((y as usize, x as usize))
    };
    let cropped_bad = Array2::from_shape_fn((size, size), |here| at(here).is_none_or(|there| bad[there]));
    let cropped = Array2::from_shape_fn((size, size), |here| at(here).map_or(0.0, |there| data[there]));
    (cropped, cropped_bad)
}

#[cfg(test)]
mod tests;
