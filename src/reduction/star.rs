//! The star in a frame: the brightest compact source, in focus or defocused.

use super::noise::scatter;
use crate::statistics::median;
use ndarray::{Array2, s};

/// Iterations of the centroid at most; it settles in two or three.
const ITERATIONS: usize = 12;
/// Threshold of the centroid, relative to the peak of the smoothed image: above the speckle halo,
/// below the rim of a defocused spot.
const THRESHOLD: f64 = 0.15;
/// Threshold of the centroid in standard deviations of the smoothed image.
const THRESHOLD_SIGMAS: f64 = 4.0;
/// Value of a pixel over the second largest of its neighbours from which it is a spike. A star in
/// focus that is sampled with two pixels per λ/D has about 2.
const SPIKE: f64 = 5.0;

/// Spot of a star.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Spot {
    /// Centroid, pixels from 0.
    pub(super) x: f64,
    pub(super) y: f64,
    /// Signal of the box it was found in, above the ring about it, electrons.
    pub(super) light_e: f64,
    /// That over the noise of the box.
    pub(super) snr: f64,
    /// Ratio of its larger to its smaller width (square roots of the second moments).
    pub(super) elongation: f64,
}

/// Sums over rectangles in constant time, of the pixels that are good.
struct Sums {
    value: Array2<f64>,
    count: Array2<f64>,
}

impl Sums {
    fn new(image: &Array2<f64>) -> Self {
        let (rows, columns) = image.dim();
        let mut sums =
            Self { value: Array2::zeros((rows + 1, columns + 1)), count: Array2::zeros((rows + 1, columns + 1)) };
        for ((y, x), &value) in image.indexed_iter() {
            let (value, count) = if value.is_finite() { (value, 1.0) } else { (0.0, 0.0) };
            for (sum, new) in [(&mut sums.value, value), (&mut sums.count, count)] {
                sum[[y + 1, x + 1]] = new + sum[[y, x + 1]] + sum[[y + 1, x]] - sum[[y, x]];
            }
        }
        sums
    }

    /// Sum and number of good pixels of the square of side `side` about a pixel.
    fn square(&self, (y, x): (usize, usize), side: usize) -> (f64, f64) {
        let (rows, columns) = (self.value.nrows() - 1, self.value.ncols() - 1);
        let (top, left) = (y.saturating_sub(side / 2), x.saturating_sub(side / 2));
        let (bottom, right) = ((y + side.div_ceil(2)).min(rows), (x + side.div_ceil(2)).min(columns));
        let of = |sum: &Array2<f64>| sum[[bottom, right]] - sum[[top, right]] - sum[[bottom, left]] + sum[[top, left]];
        (of(&self.value), of(&self.count))
    }

    /// Mean of the good pixels of a square.
    fn mean(&self, at: (usize, usize), side: usize) -> f64 {
        let (sum, count) = self.square(at, side);
        if count > 0.0 { sum / count } else { f64::NAN }
    }
}

/// The brightest compact source in `image` (NaN where it is bad), of the size of a cut-out of side
/// `window` or smaller; `None` for an image without good pixels.
///
/// It is found as the square of a quarter of the window with the most light above the ring about
/// it, so that neither a hot pixel nor a slope of the sky counts, and centred on the centroid of
/// what rises above [`THRESHOLD`] in the smoothed image.
pub(super) fn find(image: &Array2<f64>, window: usize) -> Option<Spot> {
    let clean = without_spikes(image);
    let noise = scatter(clean.iter().copied());
    let sums = Sums::new(&clean);
    let (box_side, ring_side) = ((window / 4).max(3), (3 * window / 4).max(9));
    let mut best: Option<((usize, usize), f64, f64)> = None;
    // A ring that the edge of the frame cuts is not symmetric: on a slope it differs from its
    // centre. The cut-out of a star nearer to the edge does not fit the frame anyway.
    let [ys, xs] = [clean.nrows(), clean.ncols()].map(|size| {
        let margin = if size > ring_side { ring_side.div_ceil(2) } else { 0 };
        margin..size - margin
    });
    for y in ys {
        for x in xs.clone() {
            let (inner, good) = sums.square((y, x), box_side);
            let (outer, around) = sums.square((y, x), ring_side);
            if good < 4.0 || around - good < 4.0 {
                continue;
            }
            let light = inner - (outer - inner) / (around - good) * good;
            if best.is_none_or(|(_, most, _)| light > most) {
                best = Some(((y, x), light, good));
            }
        }
    }
    let (mut at, light_e, good) = best?;
    let snr = light_e / (noise.max(f64::MIN_POSITIVE) * good.sqrt());
    let background = median(&clean.iter().copied().filter(|value| value.is_finite()).collect::<Vec<_>>());
    let mut spot = Spot { x: at.1 as f64, y: at.0 as f64, light_e, snr, elongation: 1.0 };
    for _ in 0..ITERATIONS {
        let Some(next) = centroid(&sums, at, window, background, noise) else { break };
        let has_settled = (next.x - spot.x).hypot(next.y - spot.y) < 0.05;
        spot = Spot { light_e, snr, ..next };
        at = (spot.y.round() as usize, spot.x.round() as usize);
        if has_settled {
            break;
        }
    }
    Some(spot)
}

/// Centroid and widths of what is above the threshold in the window about a pixel; `None` where
/// nothing is.
fn centroid(sums: &Sums, (y, x): (usize, usize), window: usize, background: f64, noise: f64) -> Option<Spot> {
    let (rows, columns) = (sums.value.nrows() - 1, sums.value.ncols() - 1);
    let width = (window / 16).max(3) | 1;
    let (top, left) = (y.saturating_sub(window / 2), x.saturating_sub(window / 2));
    let (bottom, right) = ((y + window.div_ceil(2)).min(rows), (x + window.div_ceil(2)).min(columns));
    let smooth = Array2::from_shape_fn((bottom - top, right - left), |(j, i)| {
        sums.mean((top + j, left + i), width) - background
    });
    let peak = smooth.iter().copied().fold(0.0, f64::max);
    let threshold = (THRESHOLD * peak).max(THRESHOLD_SIGMAS * noise / width as f64);
    let mut moments = [0.0; 6];
    for ((j, i), value) in smooth.indexed_iter() {
        let weight = value - threshold;
        if weight > 0.0 {
            let (v, u) = ((top + j) as f64 - y as f64, (left + i) as f64 - x as f64);
            let terms = [1.0, u, v, u * u, u * v, v * v];
            moments.iter_mut().zip(terms).for_each(|(moment, term)| *moment += weight * term);
        }
    }
    let [sum, u, v, uu, uv, vv] = moments;
    if sum <= 0.0 {
        return None;
    }
    let (u, v) = (u / sum, v / sum);
    let (uu, uv, vv) = (uu / sum - u * u, uv / sum - u * v, vv / sum - v * v);
    let (mean, half) = ((uu + vv) / 2.0, ((uu - vv) / 2.0).hypot(uv));
    let elongation = ((mean + half) / (mean - half).max(1e-6 * mean).max(f64::MIN_POSITIVE)).sqrt();
    Some(Spot { x: x as f64 + u, y: y as f64 + v, light_e: 0.0, snr: 0.0, elongation })
}

/// `image` with NaN in pixels that stand far above all but one of their neighbours: hot pixels and
/// cosmic rays.
fn without_spikes(image: &Array2<f64>) -> Array2<f64> {
    let noise = scatter(image.iter().copied());
    let background = median(&image.iter().copied().filter(|value| value.is_finite()).collect::<Vec<_>>());
    let (rows, columns) = image.dim();
    let mut clean = image.clone();
    for ((y, x), &value) in image.indexed_iter() {
        if value.is_nan() || value - background <= 10.0 * noise {
            continue;
        }
        let near = image.slice(s![y.saturating_sub(1)..(y + 2).min(rows), x.saturating_sub(1)..(x + 2).min(columns)]);
        let mut near: Vec<f64> = near.iter().copied().filter(|value| value.is_finite()).collect();
        near.sort_by(|a, b| b.total_cmp(a));
        // The pixel itself or one brighter is first; two hot pixels side by side are spikes, too.
        let third = near.get(2).copied().unwrap_or(background) - background;
        if value - background > SPIKE * third.max(noise) {
            clean[[y, x]] = f64::NAN;
        }
    }
    clean
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ring of light on a slope with a hot pixel.
    fn frame(x0: f64, y0: f64) -> Array2<f64> {
        let mut frame = Array2::from_shape_fn((200, 260), |(y, x)| {
            let radius = (x as f64 - x0).hypot(y as f64 - y0);
            let noise = ((x * 7919 + y * 104_729) % 101) as f64 - 50.0;
            let donut = if (5.0..12.0).contains(&radius) { 2000.0 } else { 0.0 };
            donut + noise + 3.0 * x as f64
        });
        frame[[20, 30]] = 1e6;
        frame
    }

    #[test]
    fn ring_centre_is_found_with_hot_pixels_and_a_gradient() {
        for (x, y) in [(60.0, 100.0), (150.3, 60.7), (200.0, 140.0)] {
            let spot = find(&frame(x, y), 64).unwrap();
            // The slope is 3 in 2000 a pixel; a centroid within a pixel is what a cut-out needs.
            assert!((spot.x - x).abs() < 1.0 && (spot.y - y).abs() < 1.0, "{spot:?} for {x}, {y}");
            assert!(spot.snr > 50.0 && spot.elongation < 1.1, "{spot:?}");
        }
        assert!(find(&frame(-500.0, 0.0), 64).unwrap().snr < 10.0);
    }
}
