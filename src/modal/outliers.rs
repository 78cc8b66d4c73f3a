//! Pixels that are not light: cosmic rays, hot and dead pixels that nobody has marked.
//!
//! A telescope of diameter D passes no spatial frequency beyond D/λ, so that what a frame has there is noise, and pixels that
//! stand alone. With the frame's transform zeroed up to that frequency (kernel k, `k(0)` the share that is left), a pixel too
//! high by A is A·k about its place, and noise of variance v has the variance `Σ k²·v`. The pixel that stands out most is noted,
//! what all that were noted have too much is found together, and is taken off, until none stands out (orthogonal matching
//! pursuit, Pati et al. 1993). No model of the image is needed, and none can be led astray. Towards its border the frame is
//! faded out, or the jump from one side to the other would stand out; what stands out there all the same is left where it is.

use super::prepare::Frame;
use crate::scene::Scene;
use faer::linalg::solvers::Solve;
use ndarray::{Array2, ArrayViewMut1, Axis, Zip};
use num_complex::Complex64;
use rustfft::{Fft, FftDirection, FftPlanner};
use std::sync::Arc;

/// Standard deviations beyond which a pixel stands out: of 100,000 pixels of noise one does in 5,000 frames.
const STANDS_OUT: f64 = 6.0;
/// Outliers, and their share of a frame's pixels, beyond which they do not stand alone: the frame or its noise is not what the
/// scene says, and χ² tells.
const MOST: usize = 48;
/// See [`MOST`].
const MOST_SHARE: f64 = 3e-3;
/// Standard deviations by which what a pixel has too much may change as others are found, and stay what it was.
const SETTLED: f64 = 0.1;
/// Frequencies that light does not reach, as a share of all, below which too little is left to tell by.
const LEAST_FREE: f64 = 0.1;
/// Room for a plate scale that is not quite the scene's.
const MARGIN: f64 = 1.02;
/// Pixels along the border in which the frame is faded out.
const FADED: usize = 8;
/// Least variance of a pixel's frequencies, of the read noise's.
const LEAST_SHARE: f64 = 1e-3;
/// Least read noise, e⁻: pixels without light or noise are not infinitely sure.
const LEAST_NOISE_E: f64 = 1.0;

/// A frame without the pixels that stood out.
pub(super) struct Cleaned {
    /// Electrons; where a pixel stood out, what it has without that.
    pub(super) data_e: Array2<f64>,
    /// Bad pixels, and those that stood out.
    pub(super) bad: Array2<bool>,
    /// How many stood out.
    pub(super) cut: usize,
}

/// Finds outliers in frames of one scene.
pub(super) struct OutlierFinder {
    /// Of rows, and of columns: there and back.
    plans: [[Arc<dyn Fft<f64>>; 2]; 2],
    /// Frequencies that light does not reach.
    free: Array2<bool>,
    kernel: Array2<f64>,
    /// What is left of each pixel where the frame is faded out.
    window: Array2<f64>,
    /// Transform of the kernel's square.
    square: Array2<Complex64>,
}

impl OutlierFinder {
    /// For frames of `scene`; none where they are sampled too coarsely.
    pub(super) fn of(scene: &Scene) -> Option<Self> {
        let (rows, columns) = scene.image.frame_shape();
        let shortest = 1.0 - 0.5 * scene.image.bandwidth_fraction;
        let cutoff = MARGIN / (scene.image.samples_per_lambda_over_d * shortest);
        let cycles = |i: usize, n: usize| i.min(n - i) as f64 / n as f64;
        let free = Array2::from_shape_fn((rows, columns), |(y, x)| cycles(y, rows).hypot(cycles(x, columns)) > cutoff);
        let share = free.iter().filter(|free| **free).count() as f64 / free.len() as f64;
        if share < LEAST_FREE {
            return None;
        }
        let faded = |i: usize, n: usize| {
            let inside = (i.min(n - 1 - i) as f64 + 0.5) / FADED as f64;
            if inside < 1.0 { (0.5 * std::f64::consts::PI * inside).sin().powi(2) } else { 1.0 }
        };
        let window = Array2::from_shape_fn((rows, columns), |(y, x)| faded(y, rows) * faded(x, columns));
        let mut planner = FftPlanner::new();
        let plans = [columns, rows]
            .map(|n| [FftDirection::Forward, FftDirection::Inverse].map(|direction| planner.plan_fft(n, direction)));
        let mut finder = Self { plans, kernel: Array2::zeros((0, 0)), square: Array2::default((0, 0)), window, free };
        finder.kernel = finder.back(finder.free.mapv(|free| Complex64::from(if free { 1.0 } else { 0.0 })));
        finder.square = finder.there(&finder.kernel.mapv(|k| k * k));
        Some(finder)
    }

    /// `frame` without the pixels that stand out; none where no pixel does, or where too many do.
    pub(super) fn clean(&self, frame: Frame) -> Option<Cleaned> {
        let most = MOST.min((MOST_SHARE * self.free.len() as f64) as usize);
        let known = Zip::from(frame.bad).and(frame.data_e).map_collect(|&bad, e| bad || !e.is_finite());
        let known_count = known.iter().filter(|known| **known).count();
        if frame.data_e.dim() != self.free.dim() || known_count > most {
            return None;
        }
        let data_e = Zip::from(&known).and(frame.data_e).map_collect(|&known, &e| if known { 0.0 } else { e });
        let floor_e2 = frame.read_noise_e.max(LEAST_NOISE_E).powi(2);
        let mut high = self.there(&(&data_e * &self.window));
        Zip::from(&mut high).and(&self.free).for_each(|value, &free| *value *= if free { 1.0 } else { 0.0 });
        let high_e = self.back(high);
        let faded_e2 =
            Array2::from_shape_fn(data_e.dim(), |at| light_e(&data_e, at) + floor_e2) * &self.window * &self.window;
        // At the rim variances are nothing but rounding: 1e-16 of the light's.
        let variance_e2 = self.back(self.there(&faded_e2) * &self.square).mapv(|e2| e2.max(LEAST_SHARE * floor_e2));
        let mut left_e = high_e.clone();
        let (mut standing, mut taken_e): (Vec<(usize, usize)>, Vec<f64>) = Default::default();
        loop {
            let (at, most_squared) = Zip::indexed(&left_e).and(&variance_e2).fold(((0, 0), 0.0), |most, at, e, e2| {
                let squared = e * e / e2;
                if squared > most.1 { (at, squared) } else { most }
            });
            if most_squared <= STANDS_OUT.powi(2) {
                break;
            }
            if standing.len() == 2 * most + known_count || standing.contains(&at) {
                return None;
            }
            let between = standing.iter().flat_map(|&other| between(at, other)).collect::<Vec<_>>();
            for at in std::iter::once(at).chain(between) {
                if !standing.contains(&at) {
                    standing.push(at);
                    taken_e.push(0.0);
                }
            }
            let together_e = self.together(&standing, &high_e)?;
            for ((&at, taken_e), wanted_e) in standing.iter().zip(&mut taken_e).zip(together_e) {
                let more_e = wanted_e - *taken_e;
                if (more_e * self.kernel[[0, 0]]).powi(2) >= SETTLED.powi(2) * variance_e2[at] {
                    *taken_e = wanted_e;
                    Zip::indexed(&mut left_e).for_each(|(y, x), e| *e -= more_e * self.kernel_at((y, x), at));
                }
            }
        }
        let mut found = Cleaned { data_e, bad: known, cut: 0 };
        for (&at, &too_high_e) in standing.iter().zip(&taken_e) {
            // What was taken for an outlier before its neighbours were found is none beside them.
            let stands_out = (too_high_e * self.kernel[[0, 0]]).powi(2) > STANDS_OUT.powi(2) * variance_e2[at];
            if self.window[at] == 1.0 && stands_out {
                found.data_e[at] -= too_high_e;
                found.cut += usize::from(!found.bad[at]);
                found.bad[at] = true;
            }
        }
        (1..=most).contains(&found.cut).then_some(found)
    }

    /// By how much each of these pixels is too high, all together, e⁻: least squares in the frequencies without light.
    fn together(&self, standing: &[(usize, usize)], high_e: &Array2<f64>) -> Option<Vec<f64>> {
        let count = standing.len();
        let gram = faer::Mat::from_fn(count, count, |i, j| self.kernel_at(standing[i], standing[j]));
        let solved = gram.llt(faer::Side::Lower).ok()?.solve(faer::Mat::from_fn(count, 1, |i, _| high_e[standing[i]]));
        Some((0..count).map(|i| solved[(i, 0)]).collect())
    }

    /// The kernel of a pixel at `from`, at `at`.
    fn kernel_at(&self, at: (usize, usize), from: (usize, usize)) -> f64 {
        let (rows, columns) = self.free.dim();
        self.kernel[[(at.0 + rows - from.0) % rows, (at.1 + columns - from.1) % columns]]
    }

    fn there(&self, map: &Array2<f64>) -> Array2<Complex64> {
        let mut map = map.mapv(Complex64::from);
        self.transform(&mut map, 0);
        map
    }

    fn back(&self, mut map: Array2<Complex64>) -> Array2<f64> {
        self.transform(&mut map, 1);
        let scale = 1.0 / map.len() as f64;
        map.mapv(|value| value.re * scale)
    }

    fn transform(&self, map: &mut Array2<Complex64>, way: usize) {
        for (axis, plans) in [Axis(1), Axis(0)].into_iter().zip(&self.plans) {
            let mut line = vec![Complex64::default(); plans[way].len()];
            for mut lane in map.lanes_mut(axis) {
                through(&*plans[way], &mut line, &mut lane);
            }
        }
    }
}

/// The pixels between two that have room for one, as a track would cross them: what stands out most is found first, and what
/// it took of its neighbours' shows beyond them.
fn between(a: (usize, usize), b: (usize, usize)) -> Vec<(usize, usize)> {
    if a.0.abs_diff(b.0).max(a.1.abs_diff(b.1)) != 2 {
        return Vec::new();
    }
    let middles = |a: usize, b: usize| (a + b) / 2..=(a + b).div_ceil(2);
    middles(a.0, b.0).flat_map(|y| middles(a.1, b.1).map(move |x| (y, x))).collect()
}

/// Electrons of the light in a pixel, at most: twice the median of the pixels around it, which a spot of two pixels' width has
/// in its middle. A pixel that is wrong has no part in it, so that its neighbours are judged by the noise of the light alone.
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

    fn cleaned(scene: &Scene, data_e: &Array2<f64>, bad: &Array2<bool>) -> Option<Cleaned> {
        let frame = Frame { data_e: data_e.view(), bad: bad.view(), read_noise_e: NOISE_E };
        OutlierFinder::of(scene).unwrap().clean(frame)
    }

    #[test]
    fn what_stands_alone_is_cut_and_what_was_there_comes_back() {
        for settings in [&[][..], &[("image.samples_per_lambda_over_d", "2")]] {
            let scene = scene(settings);
            let image_e = images(&scene).index_axis_move(Axis(0), 0);
            let bad = image_e.mapv(|_| false);
            assert!(cleaned(&scene, &image_e, &bad).is_none(), "light and noise stand out");
            let peak_e = image_e.iter().copied().fold(0.0, f64::max);
            let (rows, columns) = image_e.dim();
            // A hot pixel, a dead one in the light, a track of three, and a pixel that is known.
            let middle = (rows / 2, columns / 2);
            let track = [0, 1, 2].map(|i| (rows / 4 + i, columns / 3 + i));
            let lit = image_e.indexed_iter().max_by(|a, b| a.1.total_cmp(b.1)).unwrap().0;
            let mut spoilt = image_e.clone();
            spoilt[middle] += 10.0 * peak_e;
            spoilt[lit] = 0.0;
            track.iter().for_each(|&at| spoilt[at] += 0.3 * peak_e);
            let (mut known, place) = (bad.clone(), (rows / 3, columns / 2));
            (known[place], spoilt[place]) = (true, f64::NAN);
            let found = cleaned(&scene, &spoilt, &known).unwrap();
            let expected: Vec<_> = [middle, lit, place].into_iter().chain(track).collect();
            let marked: Vec<_> = found.bad.indexed_iter().filter(|(_, bad)| **bad).map(|(at, _)| at).collect();
            assert!(expected.iter().all(|at| marked.contains(at)) && marked.len() == 6 && found.cut == 5, "{marked:?}");
            // With the noise of what is beyond the light's frequencies: at two pixels per λ/D a fifth of them, 1/√0.2 times
            // a pixel's, four of these, and where neighbours were cut twice that.
            for at in expected {
                let off_e = found.data_e[at] - image_e[at];
                assert!(off_e.abs() < 20.0 * (image_e[at].max(0.0) + NOISE_E * NOISE_E).sqrt(), "{at:?}: {off_e}");
            }
        }
    }

    #[test]
    fn what_does_not_stand_alone_is_left() {
        let scene = scene(&[]);
        let image_e = images(&scene).index_axis_move(Axis(0), 1);
        let bad = image_e.mapv(|_| false);
        // Responses of pixels that scatter by 10 % are not single pixels.
        let mut uneven = image_e.clone();
        uneven.indexed_iter_mut().for_each(|((y, x), e)| *e *= 1.0 + 0.1 * ((7 * y + 13 * x * x) as f64).sin());
        assert!(cleaned(&scene, &uneven, &bad).is_none());
        // Frames with as many bad pixels as that are left alone, too, and of another size.
        let mut many = bad.clone();
        many.iter_mut().take(bad.len() / 100).for_each(|bad| *bad = true);
        let mut hot = image_e.clone();
        hot[[10, 10]] = 1e6;
        assert!(cleaned(&scene, &hot, &bad).is_some() && cleaned(&scene, &hot, &many).is_none());
        assert!(cleaned(&scene, &Array2::zeros((8, 8)), &Array2::from_elem((8, 8), false)).is_none());
        // Light of coarser pixels reaches all frequencies.
        let coarse = scene.with(&[("image.samples_per_lambda_over_d", "1.5")]).unwrap();
        assert!(OutlierFinder::of(&coarse).is_none());
    }
}
