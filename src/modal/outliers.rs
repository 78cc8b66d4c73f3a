//! Outlier pixels: cosmic rays, hot and dead pixels that are not marked as bad.
//!
//! A telescope of diameter D passes no spatial frequency beyond D/λ, so that a frame has only noise and outlier pixels there.
//! With the frame's transform set to 0 up to that frequency (kernel k, `k(0)` the share of frequencies that is left), a pixel
//! too high by A becomes A·k about its place, and noise of variance v has the variance `Σ k²·v`. The most significant pixel is
//! added to a list, the excesses of all pixels in the list are fitted together and subtracted, until no pixel is significant
//! (orthogonal matching pursuit, Pati et al. 1993). No model of the image is needed. Towards its border the frame is tapered,
//! because the jump from one side to the other would be significant; outliers within the taper are not rejected.

use super::prepare::Frame;
use crate::scene::Scene;
use crate::statistics::upper_median_in_place;
use crate::telescope::Filter;
use cophase_numerics::cholesky::Cholesky;
use cophase_numerics::fft::{Fft, FftDirection, FftReal};
use ndarray::{Array2, ArrayViewMut1, Axis, Zip};
use num_complex::Complex64;
use std::sync::Arc;

/// Standard deviations beyond which a pixel is an outlier: with 100,000 pixels of noise one in 5,000 frames.
const OUTLIER_SIGMA: f64 = 6.0;
/// Largest number of outliers of a frame, and their largest share of its pixels. Beyond it none is rejected: the frame or its
/// noise is not what the scene says, and χ² shows it.
const MAX_OUTLIERS: usize = 48;
/// See [`MAX_OUTLIERS`].
const MAX_OUTLIER_SHARE: f64 = 3e-3;
/// Changes of a pixel's excess below this number of standard deviations are ignored as others are found.
const SMALL_CHANGE: f64 = 0.1;
/// Smallest share of frequencies beyond D/λ for which outliers can be found.
const MIN_FREE_SHARE: f64 = 0.1;
/// Margin of the cut-off for a plate scale that differs from the scene's.
const MARGIN: f64 = 1.02;
/// Width of the taper along the border, pixels.
const TAPER: usize = 8;
/// Smallest variance of a filtered pixel, as a share of that of the read noise.
const MIN_VARIANCE_SHARE: f64 = 1e-3;
/// Smallest read noise, e⁻, so that pixels without light and noise have a variance.
const MIN_NOISE_E: f64 = 1.0;

/// A frame without its outliers.
pub(super) struct CleanedFrame {
    /// Electrons; of an outlier, without its excess.
    pub(super) data_e: Array2<f64>,
    /// Bad pixels and outliers.
    pub(super) bad: Array2<bool>,
    /// Number of outliers.
    pub(super) rejected: usize,
}

/// Finds outliers in frames of one scene.
pub(super) struct OutlierFinder {
    /// Plans forward and inverse, of rows and of columns.
    plans: [[Arc<dyn Fft<f64>>; 2]; 2],
    /// Frequencies beyond D/λ.
    free: Array2<bool>,
    kernel: Array2<f64>,
    /// Window that tapers the frame.
    window: Array2<f64>,
    /// Transform of the kernel's square.
    square: Array2<Complex64>,
}

impl OutlierFinder {
    /// A finder for frames of `scene` through its `filter`; `None` where they are sampled too coarsely.
    pub(super) fn new(scene: &Scene, filter: &Filter) -> Option<Self> {
        let (rows, columns) = scene.image.fitted_shape();
        let [shortest, _] = filter.range();
        let cutoff = MARGIN / (scene.image.samples_per_lambda_over_d * shortest);
        let cycles = |i: usize, n: usize| i.min(n - i) as f64 / n as f64;
        let free = Array2::from_shape_fn((rows, columns), |(y, x)| cycles(y, rows).hypot(cycles(x, columns)) > cutoff);
        let share = free.iter().filter(|free| **free).count() as f64 / free.len() as f64;
        if share < MIN_FREE_SHARE {
            return None;
        }
        let taper = |i: usize, n: usize| {
            let inside = (i.min(n - 1 - i) as f64 + 0.5) / TAPER as f64;
            if inside < 1.0 { (0.5 * std::f64::consts::PI * inside).sin().powi(2) } else { 1.0 }
        };
        let window = Array2::from_shape_fn((rows, columns), |(y, x)| taper(y, rows) * taper(x, columns));
        let plans =
            [FftDirection::Forward, FftDirection::Inverse].map(|direction| f64::plan_pair([columns, rows], direction));
        let mut finder = Self { plans, kernel: Array2::zeros((0, 0)), square: Array2::default((0, 0)), window, free };
        finder.kernel = finder.inverse(finder.free.mapv(|free| Complex64::from(if free { 1.0 } else { 0.0 })));
        finder.square = finder.forward(&finder.kernel.mapv(|k| k * k));
        Some(finder)
    }

    /// `frame` without its outliers; `None` where it has none, or too many.
    pub(super) fn clean(&self, frame: Frame) -> Option<CleanedFrame> {
        let most = MAX_OUTLIERS.min((MAX_OUTLIER_SHARE * self.free.len() as f64) as usize);
        let known = Zip::from(frame.bad).and(frame.data_e).map_collect(|&bad, e| bad || !e.is_finite());
        let known_count = known.iter().filter(|known| **known).count();
        if frame.data_e.dim() != self.free.dim() || known_count > most {
            return None;
        }
        let data_e = Zip::from(&known).and(frame.data_e).map_collect(|&known, &e| if known { 0.0 } else { e });
        let floor_e2 = frame.read_noise_e.unwrap_or(0.0).max(MIN_NOISE_E).powi(2);
        let mut high = self.forward(&(&data_e * &self.window));
        Zip::from(&mut high).and(&self.free).for_each(|value, &free| *value *= if free { 1.0 } else { 0.0 });
        let high_e = self.inverse(high);
        let faded_e2 =
            Array2::from_shape_fn(data_e.dim(), |at| light_e(&data_e, at) + floor_e2) * &self.window * &self.window;
        // At the rim the variances are rounding: 1e-16 of those of the light.
        let variance_e2 =
            self.inverse(self.forward(&faded_e2) * &self.square).mapv(|e2| e2.max(MIN_VARIANCE_SHARE * floor_e2));
        let mut left_e = high_e.clone();
        let mut is_noise_compared = false;
        let (mut outliers, mut excess_e): (Vec<(usize, usize)>, Vec<f64>) = Default::default();
        loop {
            let (at, most_squared) = Zip::indexed(&left_e).and(&variance_e2).fold(((0, 0), 0.0), |most, at, e, e2| {
                let squared = e * e / e2;
                if squared > most.1 { (at, squared) } else { most }
            });
            if most_squared <= OUTLIER_SIGMA.powi(2) {
                break;
            }
            if outliers.len() == 2 * most + known_count || outliers.contains(&at) {
                return None;
            }
            // Not before the brightest are gone: their ripples are all over the frame.
            if !is_noise_compared && 2 * outliers.len() >= most {
                is_noise_compared = true;
                if self.is_noisier(&left_e, &variance_e2, most) {
                    return None;
                }
            }
            let between = outliers.iter().flat_map(|&other| between(at, other)).collect::<Vec<_>>();
            for at in std::iter::once(at).chain(between) {
                if !outliers.contains(&at) {
                    outliers.push(at);
                    excess_e.push(0.0);
                }
            }
            let fitted_e = self.fit_excess(&outliers, &high_e)?;
            for ((&at, excess_e), wanted_e) in outliers.iter().zip(&mut excess_e).zip(fitted_e) {
                let more_e = wanted_e - *excess_e;
                if (more_e * self.kernel[[0, 0]]).powi(2) >= SMALL_CHANGE.powi(2) * variance_e2[at] {
                    *excess_e = wanted_e;
                    Zip::indexed(&mut left_e).for_each(|(y, x), e| *e -= more_e * self.kernel_at((y, x), at));
                }
            }
        }
        let mut found = CleanedFrame { data_e, bad: known, rejected: 0 };
        for (&at, &own_excess_e) in outliers.iter().zip(&excess_e) {
            // A pixel that was significant before its neighbours were found may not be after.
            let is_outlier = (own_excess_e * self.kernel[[0, 0]]).powi(2) > OUTLIER_SIGMA.powi(2) * variance_e2[at];
            if self.window[at] == 1.0 && is_outlier {
                found.data_e[at] -= own_excess_e;
                found.rejected += usize::from(!found.bad[at]);
                found.bad[at] = true;
            }
        }
        (1..=most).contains(&found.rejected).then_some(found)
    }

    /// Whether the frame is so much noisier than stated that noise alone exceeds the limit in more than `most` pixels: the search would add one after
    /// the other, each at the cost of all before it, and find none in the end. Of noise that is s times as large at most N·exp(−(6/s)²/2) pixels do; the median of squares, 0.455 s² of
    /// Gaussian noise, is that of the pixels without outliers.
    fn is_noisier(&self, high_e: &Array2<f64>, variance_e2: &Array2<f64>, most: usize) -> bool {
        const MEDIAN_OF_SQUARES: f64 = 0.455;
        let mut squares: Vec<f64> = high_e.iter().zip(variance_e2).map(|(e, e2)| e * e / e2).collect();
        let scale_squared = (upper_median_in_place(&mut squares) / MEDIAN_OF_SQUARES).max(f64::MIN_POSITIVE);
        high_e.len() as f64 * (-0.5 * OUTLIER_SIGMA.powi(2) / scale_squared).exp() > most as f64
    }

    /// Excess of each of these pixels, fitted together, e⁻: least squares in the frequencies without light.
    fn fit_excess(&self, outliers: &[(usize, usize)], high_e: &Array2<f64>) -> Option<Vec<f64>> {
        let count = outliers.len();
        let gram = Array2::from_shape_fn((count, count), |(i, j)| self.kernel_at(outliers[i], outliers[j]));
        let right_e = Array2::from_shape_fn((count, 1), |(i, _)| high_e[outliers[i]]);
        Some(Cholesky::new(gram.view()).ok()?.solve(right_e.view()).into_iter().collect())
    }

    /// The kernel of a pixel at `from`, at `at`.
    fn kernel_at(&self, at: (usize, usize), from: (usize, usize)) -> f64 {
        let (rows, columns) = self.free.dim();
        self.kernel[[(at.0 + rows - from.0) % rows, (at.1 + columns - from.1) % columns]]
    }

    fn forward(&self, map: &Array2<f64>) -> Array2<Complex64> {
        let mut map = map.mapv(Complex64::from);
        self.transform(&mut map, 0);
        map
    }

    fn inverse(&self, mut map: Array2<Complex64>) -> Array2<f64> {
        self.transform(&mut map, 1);
        let scale = 1.0 / map.len() as f64;
        map.mapv(|value| value.re * scale)
    }

    fn transform(&self, map: &mut Array2<Complex64>, way: usize) {
        for (axis, plan) in [Axis(1), Axis(0)].into_iter().zip(&self.plans[way]) {
            let mut line = vec![Complex64::default(); plan.len()];
            for mut lane in map.lanes_mut(axis) {
                through(&**plan, &mut line, &mut lane);
            }
        }
    }
}

/// The pixels between two that are two pixels apart, as a track would cross them: the brightest pixels of a track are found
/// first, and absorb a part of the excess of those between them.
fn between(a: (usize, usize), b: (usize, usize)) -> Vec<(usize, usize)> {
    if a.0.abs_diff(b.0).max(a.1.abs_diff(b.1)) != 2 {
        return Vec::new();
    }
    let middles = |a: usize, b: usize| (a + b) / 2..=(a + b).div_ceil(2);
    middles(a.0, b.0).flat_map(|y| middles(a.1, b.1).map(move |x| (y, x))).collect()
}

/// Electrons of the light in a pixel, at most: twice the median of the pixels around it, which a spot of two pixels' width has
/// in its middle. The median ignores a single outlier, so that the noise of its neighbours is that of the light alone.
fn light_e(data_e: &Array2<f64>, (y, x): (usize, usize)) -> f64 {
    let around = |at: usize, size: usize| at.saturating_sub(1)..(at + 2).min(size);
    let (rows, columns) = data_e.dim();
    let (mut values, mut count) = ([0.0; 9], 0);
    for (y, x) in around(y, rows).flat_map(|y| around(x, columns).map(move |x| (y, x))) {
        (values[count], count) = (data_e[[y, x]], count + 1);
    }
    values[..count].sort_unstable_by(f64::total_cmp);
    2.0 * values[count / 2].max(0.0)
}

/// Transforms a lane in the contiguous memory of `line`.
fn through(plan: &dyn Fft<f64>, line: &mut [Complex64], lane: &mut ArrayViewMut1<Complex64>) {
    line.iter_mut().zip(&*lane).for_each(|(to, from)| *to = *from);
    plan.process(line);
    lane.iter_mut().zip(line).for_each(|(to, from)| *to = *from);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source;
    use ndarray::Array3;

    const NOISE_E: f64 = 10.0;

    fn scene(settings: &[(&str, &str)]) -> Scene {
        let base = [("image.count", "2"), ("image.read_noise_e", "10"), ("pupil.samples", "64")];
        Scene::preset("keck-artificial").unwrap().with(&[&base[..], settings].concat()).unwrap()
    }

    fn images(scene: &Scene) -> Array3<f64> {
        source::simulate(scene).unwrap().images_e
    }

    fn clean(scene: &Scene, data_e: &Array2<f64>, bad: &Array2<bool>) -> Option<CleanedFrame> {
        let frame = Frame { data_e: data_e.view(), bad: bad.view(), read_noise_e: Some(NOISE_E) };
        OutlierFinder::new(scene, &Filter::new(scene).unwrap()).unwrap().clean(frame)
    }

    #[test]
    fn outliers_are_rejected_and_the_image_is_recovered() {
        for settings in [&[][..], &[("image.samples_per_lambda_over_d", "2")]] {
            let scene = scene(settings);
            let image_e = images(&scene).index_axis_move(Axis(0), 0);
            let bad = image_e.mapv(|_| false);
            assert!(clean(&scene, &image_e, &bad).is_none(), "light and noise have no outlier");
            let peak_e = image_e.iter().copied().fold(0.0, f64::max);
            let (rows, columns) = image_e.dim();
            // A hot pixel, a dead one in the light, a track of three, and a pixel that is known.
            let middle = (rows / 2, columns / 2);
            let track = [0, 1, 2].map(|i| (rows / 4 + i, columns / 3 + i));
            let brightest = image_e.indexed_iter().max_by(|a, b| a.1.total_cmp(b.1)).unwrap().0;
            let mut spoilt = image_e.clone();
            spoilt[middle] += 10.0 * peak_e;
            spoilt[brightest] = 0.0;
            track.iter().for_each(|&at| spoilt[at] += 0.3 * peak_e);
            let (mut known, place) = (bad.clone(), (rows / 3, columns / 2));
            (known[place], spoilt[place]) = (true, f64::NAN);
            let found = clean(&scene, &spoilt, &known).unwrap();
            let expected: Vec<_> = [middle, brightest, place].into_iter().chain(track).collect();
            let marked: Vec<_> = found.bad.indexed_iter().filter(|(_, bad)| **bad).map(|(at, _)| at).collect();
            assert!(
                expected.iter().all(|at| marked.contains(at)) && marked.len() == 6 && found.rejected == 5,
                "{marked:?}"
            );
            // With the noise of what is beyond the light's frequencies: at two pixels per λ/D a fifth of them, 1/√0.2 times
            // a pixel's, four of these, and where neighbours were rejected twice that.
            for at in expected {
                let off_e = found.data_e[at] - image_e[at];
                assert!(off_e.abs() < 20.0 * (image_e[at].max(0.0) + NOISE_E * NOISE_E).sqrt(), "{at:?}: {off_e}");
            }
        }
    }

    /// Noise that is understated is no outlier, and is seen before any is searched for.
    #[test]
    fn understated_noise_is_seen_before_the_search() {
        let scene = scene(&[("image.pixels", "132")]);
        let image_e = images(&scene).index_axis_move(Axis(0), 0);
        let finder = OutlierFinder::new(&scene, &Filter::new(&scene).unwrap()).unwrap();
        let is_noisier = |scale: f64| {
            let high_e = image_e.mapv(|e| scale * NOISE_E * (0.7 * e).sin());
            finder.is_noisier(&high_e, &Array2::from_elem(image_e.dim(), NOISE_E * NOISE_E), 48)
        };
        // A sine has a median square of a half.
        assert_eq!([1.0, 1.3, 3.0].map(is_noisier), [false, false, true]);
    }

    #[test]
    #[ignore = "merge: 7 s"]
    fn errors_that_are_not_single_pixels_are_left() {
        let scene = scene(&[]);
        let image_e = images(&scene).index_axis_move(Axis(0), 1);
        let bad = image_e.mapv(|_| false);
        // Responses of pixels that scatter by 10 % are not single pixels.
        let mut uneven = image_e.clone();
        uneven.indexed_iter_mut().for_each(|((y, x), e)| *e *= 1.0 + 0.1 * ((7 * y + 13 * x * x) as f64).sin());
        assert!(clean(&scene, &uneven, &bad).is_none());
        // Frames with as many bad pixels as that are left alone, too, and of another size.
        let mut many = bad.clone();
        many.iter_mut().take(bad.len() / 100).for_each(|bad| *bad = true);
        let mut hot = image_e.clone();
        hot[[10, 10]] = 1e6;
        assert!(clean(&scene, &hot, &bad).is_some() && clean(&scene, &hot, &many).is_none());
        assert!(clean(&scene, &Array2::zeros((8, 8)), &Array2::from_elem((8, 8), false)).is_none());
        // Light of coarser pixels reaches all frequencies.
        let coarse = scene.with(&[("image.samples_per_lambda_over_d", "1.5")]).unwrap();
        assert!(OutlierFinder::new(&coarse, &Filter::new(&coarse).unwrap()).is_none());
    }
}
