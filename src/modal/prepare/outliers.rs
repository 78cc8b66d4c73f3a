//! Outlier pixels of a frame that is sampled more finely than its light needs: cosmic rays, hot and
//! dead pixels, without a model of the image.
//!
//! Each pixel is predicted from the 7 × 7 around it: the linear prediction of least mean square
//! error (kriging) for light whose covariance is that of fully developed speckle behind a round
//! pupil, |2 J₁(πr)/(πr)|² at r λ/D (Goodman, Speckle Phenomena in Optics, section 4.4). At 4
//! pixels per λ/D the prediction errs by 0.4 % of the light, at 3 by 0.6 %, at 2.5 by 1 %. The
//! largest deviation of each neighbourhood is an outlier first, because neighbours of an outlier
//! are predicted wrongly; it is then replaced by its prediction from those that are left.

mod predictor;

use crate::modal::prepare::Frame;
use crate::modal::prepare::rejected::RejectedPixels;
use crate::scene::System;
use crate::statistics::{NORMAL_MEDIAN_DEVIATION, normal_cdf, upper_median_in_place};
use crate::telescope::Filter;
use ndarray::{Array2, ArrayView2, Axis, s};
use predictor::{AROUND, EDGES, Prediction, Predictor, REACH};

/// Standard deviations beyond which a pixel is an outlier, most and fewest. Only frames with
/// outliers are searched: of 100,000 pixels of noise six are beyond the most, which costs nothing.
const LIMITS: [f64; 2] = [4.0, 3.0];
/// Share of the outliers that may be noise. Where many pixels are bad, many more deviate too little
/// for the most standard deviations (hot ones in bright light), and a pixel of three is bad rather
/// than noise: the limit is the one beyond which noise is this share of what was found (the false
/// discovery rate: Benjamini & Hochberg 1995, J. R. Stat. Soc. B 57, 289). With 2 % of bad pixels
/// at a peak S/N of 500 the residual is 1.12 / 1.14 of its bound where four leave 1.14 / 1.15.
const FALSE_SHARE: f64 = 0.05;
/// Largest share of outliers. Beyond, none is rejected: the frame or its noise is not what the
/// scene says, and χ² shows it.
const MAX_SHARE: f64 = 0.1;
/// Least sampling, pixels per λ/D, at which outliers can be found, and at which their predictions
/// can take their place. At 2 a prediction errs by an eighth of the light.
const LEAST_SAMPLING: f64 = 1.9;
/// See [`LEAST_SAMPLING`].
const PREDICTABLE_SAMPLING: f64 = 2.5;
/// Least and largest variance of the noise as a share of that of the light to which a prediction is
/// made. A smaller one predicts light better and amplifies noise: 0.15 % of the light and 0.9 of
/// the variance at 1e-5 and 4 pixels per λ/D, 0.4 % and 0.6 at 1e-4.
const NOISE_SHARES: [f64; 2] = [3e-6, 1e-3];
/// Share of the pixels of a frame that are as bright as its light is taken to be.
const LIT_SHARE: f64 = 0.05;
/// That at 2 pixels per λ/D, where a smaller one amplifies the errors of outliers that are not
/// found yet.
const COARSE_NOISE_SHARE: f64 = 1e-2;
/// Smallest read noise, e⁻, so that pixels without light and noise have a variance.
const MIN_NOISE_E: f64 = 1.0;
/// Parts in which a column or row is candidates.
const LINE_PARTS: usize = 8;
/// Standard deviations of the mean deviation of a part of it beyond which it is an outlier.
const LINE_LIMIT: f64 = 6.0;
/// Most columns, and most rows, that are outliers.
const MOST_LINES: usize = 8;
/// Most rounds, each of which finds one outlier of a neighbourhood: tracks and clusters need one a
/// pixel.
const ROUNDS: usize = 60;

/// A frame without its outliers.
pub(in crate::modal) struct CleanedFrame {
    /// Electrons; of an outlier, the prediction.
    pub(in crate::modal) data_e: Array2<f64>,
    /// Pixels that were bad before, and outliers whose predictions are poor.
    pub(in crate::modal) bad: Array2<bool>,
    /// The outliers.
    pub(in crate::modal) rejected: RejectedPixels,
}

/// Finds outliers in frames of one scene.
pub(in crate::modal) struct OutlierFinder {
    /// Pixels per λ/D.
    sampling: f64,
}

impl OutlierFinder {
    /// A finder for frames of `scene` through its `filter`; `None` where they are sampled too
    /// coarsely.
    pub(in crate::modal) fn new(scene: &System, filter: &Filter) -> Option<Self> {
        let [shortest, _] = filter.range();
        let sampling = scene.image.samples_per_lambda_over_d * shortest;
        if sampling < LEAST_SAMPLING {
            return None;
        }
        Some(Self { sampling })
    }

    /// Whether predictions can take the place of outliers; otherwise these become bad pixels.
    pub(in crate::modal) fn can_predict(&self) -> bool {
        self.sampling >= PREDICTABLE_SAMPLING
    }

    /// Variance of the noise of a frame as a share of that of its light, where this is bright.
    fn noise_share(&self, data_e: &Array2<f64>, noise_e2: f64) -> f64 {
        if !self.can_predict() {
            return COARSE_NOISE_SHARE;
        }
        let mut values: Vec<f64> = data_e.iter().copied().collect();
        let at = ((1.0 - LIT_SHARE) * values.len() as f64) as usize;
        let (_, light_e, _) = values.select_nth_unstable_by(at, f64::total_cmp);
        let light_e = light_e.max(f64::MIN_POSITIVE);
        ((light_e + noise_e2) / (light_e * light_e)).clamp(NOISE_SHARES[0], NOISE_SHARES[1])
    }

    /// `frame` without its outliers; `None` where it has none, or too many.
    pub(in crate::modal) fn clean(&self, frame: Frame) -> Option<CleanedFrame> {
        let (rows, columns) = frame.data_e.dim();
        if frame.bad.dim() != (rows, columns) || rows.min(columns) <= 2 * REACH {
            return None;
        }
        let noise_e2 = frame.read_noise_e.unwrap_or(0.0).max(MIN_NOISE_E).powi(2);
        // Of bad pixels far from a good one nothing is known.
        let data_e = Array2::from_shape_fn((rows, columns), |at| {
            if frame.bad[at] || !frame.data_e[at].is_finite() { 0.0 } else { frame.data_e[at] }
        });
        let predictor = Predictor::new(self.sampling, self.noise_share(&data_e, noise_e2))?;
        let mut search = Search {
            predictor: &predictor,
            given_e: frame.data_e,
            data_e,
            bad: Array2::from_shape_fn((rows, columns), |at| frame.bad[at] || !frame.data_e[at].is_finite()),
            noise_e2,
            deviation: Array2::zeros((rows, columns)),
            residual_e: Array2::zeros((rows, columns)),
            is_lit: Array2::from_elem((rows, columns), false),
            is_in_line: Array2::from_elem((rows, columns), false),
            scale: 1.0,
            limit: LIMITS[0],
        };
        let known = search.bad.clone();
        let all =
            |bad: &Array2<bool>| bad.indexed_iter().filter(|(_, bad)| **bad).map(|(at, _)| at).collect::<Vec<_>>();
        all(&known).into_iter().for_each(|at| search.fill(at));
        let most = (MAX_SHARE * known.len() as f64) as usize;
        search.find_pixels(vec![true; rows], most)?;
        let found = search.bad.iter().zip(&known).filter(|(bad, known)| **bad && !**known).count();
        search.limit = limit(found as f64 / known.len() as f64);
        if search.limit < LIMITS[0] {
            search.find_pixels(vec![true; rows], most)?;
        }
        let mut rejected = if self.can_predict() { search.find_lines(most)? } else { RejectedPixels::default() };
        let candidates: Vec<_> =
            all(&search.bad).into_iter().filter(|&at| !known[at] && !search.is_in_line[at]).collect();
        for excess_e in search.keep_significant(candidates) {
            rejected.high += usize::from(excess_e > 0.0);
            rejected.low += usize::from(excess_e < 0.0);
        }
        if rejected.total() == 0 {
            return None;
        }
        // Pixels that were bad before keep what they had.
        let data_e =
            Array2::from_shape_fn((rows, columns), |at| if known[at] { frame.data_e[at] } else { search.data_e[at] });
        let bad = if self.can_predict() { known } else { search.bad };
        Some(CleanedFrame { data_e, bad, rejected })
    }
}

/// Search in one frame.
struct Search<'a> {
    predictor: &'a Predictor,
    given_e: ArrayView2<'a, f64>,
    /// With the predictions of bad pixels.
    data_e: Array2<f64>,
    bad: Array2<bool>,
    noise_e2: f64,
    /// Deviation of each pixel from its prediction, in standard deviations, and e⁻.
    deviation: Array2<f64>,
    residual_e: Array2<f64>,
    /// Whether the noise of a pixel is that of its light.
    is_lit: Array2<bool>,
    /// Pixels of columns and rows that are outliers as a whole.
    is_in_line: Array2<bool>,
    /// How much larger deviations are than expected.
    scale: f64,
    /// Standard deviations beyond which a pixel is an outlier.
    limit: f64,
}

impl Search<'_> {
    /// Replaces a pixel by its prediction from those around it that are not bad.
    fn fill(&mut self, at: (usize, usize)) {
        if let Some((expected_e, _)) = self.predicted(at) {
            self.data_e[at] = expected_e;
        }
    }

    /// Expectation of a pixel from those around it that are not bad, e⁻, and the variance of its
    /// deviation, e².
    fn predicted(&self, (y, x): (usize, usize)) -> Option<(f64, f64)> {
        let (rows, columns) = self.bad.dim();
        let place = |at: usize, offset: isize, size: usize| at.checked_add_signed(offset).filter(|&at| at < size);
        let (mut good, mut data_e) = (Vec::with_capacity(AROUND), Vec::with_capacity(AROUND));
        for (i, &[v, u]) in self.predictor.offsets.iter().enumerate() {
            let at = place(y, v, rows).zip(place(x, u, columns)).filter(|&at| !self.bad[at]);
            if let Some(at) = at {
                good.push(i);
                data_e.push(self.data_e[at]);
            }
        }
        let prediction = self.predictor.prediction(&good)?;
        let expected_e = prediction.shares.iter().zip(&data_e).map(|(share, e)| share * e).sum::<f64>();
        Some((expected_e, self.variance_e2(&prediction, expected_e)))
    }

    /// Variance of the deviation of a pixel about which the light is `light_e`: noise of all
    /// pixels, and the error of the prediction.
    fn variance_e2(&self, prediction: &Prediction, light_e: f64) -> f64 {
        let light_e = light_e.max(0.0);
        prediction.noise * (light_e + self.noise_e2) + prediction.light * light_e * light_e
    }

    /// Computes the deviations of the rows that have `changed`, and the scale of all.
    fn compute_deviations(&mut self, changed: &[bool]) {
        let (rows, columns) = self.bad.dim();
        for y in (0..rows).filter(|&y| changed[y]) {
            let mut residual_e = self.data_e.row(y).to_owned();
            let edge = EDGES * Predictor::edge(y, rows);
            let (around, prediction) = &self.predictor.predictions[edge + REACH];
            for (&i, &share) in around.iter().zip(&prediction.shares) {
                let [v, u] = self.predictor.offsets[i];
                let row = self.data_e.row((y as isize + v) as usize);
                let from = (REACH as isize + u) as usize;
                let mut middle = residual_e.slice_mut(s![REACH..columns - REACH]);
                middle.scaled_add(-share, &row.slice(s![from..from + columns - 2 * REACH]));
            }
            for x in (0..REACH).chain(columns - REACH..columns) {
                let (around, prediction) = &self.predictor.predictions[edge + Predictor::edge(x, columns)];
                for (&i, &share) in around.iter().zip(&prediction.shares) {
                    let [v, u] = self.predictor.offsets[i];
                    residual_e[x] -= share * self.data_e[((y as isize + v) as usize, (x as isize + u) as usize)];
                }
            }
            self.residual_e.row_mut(y).assign(&residual_e);
        }
        // A row's light is of the rows beside it, too, which have changed together.
        for y in (0..rows).filter(|&y| changed[y]) {
            for x in 0..columns {
                let light_e = light_e(&self.data_e, (y, x));
                let edge = EDGES * Predictor::edge(y, rows) + Predictor::edge(x, columns);
                let variance_e2 = self.variance_e2(&self.predictor.predictions[edge].1, light_e);
                self.is_lit[(y, x)] = light_e > 2.0 * self.noise_e2;
                self.deviation[(y, x)] = self.residual_e[(y, x)] / variance_e2.sqrt();
            }
        }
        let (mut all, mut lit) = (Vec::with_capacity(rows * columns), Vec::new());
        for ((deviation, &is_lit), _) in
            self.deviation.iter().zip(&self.is_lit).zip(&self.bad).filter(|(_, bad)| !**bad)
        {
            all.push(deviation.abs());
            if is_lit {
                lit.push(deviation.abs());
            }
        }
        self.scale = 1.0;
        for values in [&mut all, &mut lit].into_iter().filter(|values| values.len() >= 100) {
            self.scale = self.scale.max(upper_median_in_place(values) / NORMAL_MEDIAN_DEVIATION);
        }
    }

    /// Pixels beyond the limit whose residual is the largest of those in their neighbourhood.
    fn most_deviating(&self) -> Vec<(usize, usize)> {
        let (rows, columns) = self.bad.dim();
        let is_candidate = |at: (usize, usize)| self.deviation[at].abs() > self.limit * self.scale && !self.bad[at];
        let mut found = Vec::new();
        for at in (0..rows).flat_map(|y| (0..columns).map(move |x| (y, x))).filter(|&at| is_candidate(at)) {
            let range = |at: usize, size: usize| at.saturating_sub(REACH)..(at + REACH + 1).min(size);
            let around = range(at.0, rows).flat_map(|y| range(at.1, columns).map(move |x| (y, x)));
            let own_e = self.residual_e[at].abs();
            if around.filter(|&other| is_candidate(other)).all(|other| self.residual_e[other].abs() <= own_e) {
                found.push(at);
            }
        }
        found
    }

    /// Takes those of the `candidates` back that do not deviate from their prediction from good
    /// pixels alone: of each neighbourhood the least deviating first, from which others are then
    /// predicted better. Returns the excess of those that are left, e⁻, which their predictions
    /// replace.
    fn keep_significant(&mut self, pixels: Vec<(usize, usize)>) -> Vec<f64> {
        let mut candidates: Vec<Candidate> = pixels.into_iter().map(Candidate::new).collect();
        loop {
            for candidate in candidates.iter_mut().filter(|candidate| candidate.deviation.is_nan()) {
                let at = candidate.at;
                let (expected_e, variance_e2) = self.predicted(at).unwrap_or((self.given_e[at], f64::INFINITY));
                self.data_e[at] = expected_e;
                candidate.excess_e = self.given_e[at] - expected_e;
                candidate.deviation = (candidate.excess_e / variance_e2.sqrt()).abs();
            }
            let is_least = |place: usize| {
                let own = &candidates[place];
                // They are in the order of their rows.
                let is_close = |other: &&Candidate| other.at.0.abs_diff(own.at.0) <= REACH;
                let before = candidates[..place].iter().rev().take_while(is_close);
                let mut near = before.chain(candidates[place + 1..].iter().take_while(is_close));
                near.all(|other| !other.is_near(own.at) || other.deviation >= own.deviation)
            };
            let free: Vec<(usize, usize)> = (0..candidates.len())
                .filter(|&place| candidates[place].deviation <= self.limit * self.scale && is_least(place))
                .map(|place| candidates[place].at)
                .collect();
            if free.is_empty() {
                return candidates.into_iter().map(|candidate| candidate.excess_e).collect();
            }
            candidates.retain(|candidate| free.binary_search(&candidate.at).is_err());
            for &at in &free {
                (self.bad[at], self.data_e[at]) = (false, self.given_e[at]);
            }
            for candidate in candidates.iter_mut().filter(|candidate| free.iter().any(|&at| candidate.is_near(at))) {
                candidate.deviation = f64::NAN;
            }
        }
    }

    /// Replaces single outliers until there are none; `None` where they are more than `most`. At
    /// first the rows that have `changed` are candidates.
    fn find_pixels(&mut self, mut changed: Vec<bool>, most: usize) -> Option<()> {
        let rows = changed.len();
        for _ in 0..ROUNDS {
            self.compute_deviations(&changed);
            let found = self.most_deviating();
            if found.is_empty() {
                break;
            }
            changed.fill(false);
            found.iter().for_each(|&at| self.bad[at] = true);
            for at in found {
                self.fill(at);
                changed[at.0.saturating_sub(REACH)..(at.0 + REACH + 1).min(rows)].fill(true);
            }
            if self.bad.iter().filter(|bad| **bad).count() > most {
                return None;
            }
        }
        Some(())
    }

    /// Replaces columns and rows whose pixels deviate together; `None` where they have more than
    /// `most` pixels.
    fn find_lines(&mut self, most: usize) -> Option<RejectedPixels> {
        let (rows, columns) = self.bad.dim();
        let mut found = RejectedPixels::default();
        for (axis, size) in [columns, rows].into_iter().enumerate() {
            let across = Axis(1 - axis);
            for _ in 0..MOST_LINES {
                let means: Vec<f64> = (0..size).map(|line| self.deviation_of_line(across, line)).collect();
                let Some(line) = (0..size).max_by(|&a, &b| means[a].abs().total_cmp(&means[b].abs())) else { break };
                if means[line].abs() <= LINE_LIMIT * self.scale {
                    break;
                }
                let at = |along: usize| if axis == 0 { (along, line) } else { (line, along) };
                let pixels: Vec<_> = (0..self.bad.len_of(Axis(axis))).map(at).filter(|&at| !self.bad[at]).collect();
                pixels.iter().for_each(|&at| (self.bad[at], self.is_in_line[at]) = (true, true));
                pixels.iter().for_each(|&at| self.fill(at));
                found.in_lines += pixels.len();
                found.line[axis] = found.line[axis].or(Some(line));
                if self.bad.iter().filter(|bad| **bad).count() > most {
                    return None;
                }
                self.compute_deviations(&vec![true; rows]);
            }
        }
        Some(found)
    }

    /// Deviation of a line in standard deviations: that of the parts of it, of which the third
    /// largest in the same direction counts, so that single pixels do not decide; 0 where parts
    /// deviate in both directions.
    fn deviation_of_line(&self, across: Axis, line: usize) -> f64 {
        let (deviation, bad) = (self.deviation.index_axis(across, line), self.bad.index_axis(across, line));
        let mut parts: Vec<f64> = (0..LINE_PARTS)
            .map(|part| {
                let places = part * deviation.len() / LINE_PARTS..(part + 1) * deviation.len() / LINE_PARTS;
                let good = places.filter(|&place| !bad[place]).map(|place| deviation[place]);
                let (sum, count) = good.fold((0.0, 0), |(sum, count), deviation| (sum + deviation, count + 1));
                if count > 0 { sum / f64::from(count).sqrt() } else { 0.0 }
            })
            .collect();
        parts.sort_unstable_by(f64::total_cmp);
        let (low, high) = (parts[2], parts[LINE_PARTS - 3]);
        match (-parts[0] > LINE_LIMIT * self.scale, parts[LINE_PARTS - 1] > LINE_LIMIT * self.scale) {
            (true, true) => 0.0,
            _ if high > -low => high.max(0.0),
            _ => low.min(0.0),
        }
    }
}

/// Standard deviations beyond which noise is [`FALSE_SHARE`] of the `share` of the pixels that are
/// outliers, within [`LIMITS`].
fn limit(share: f64) -> f64 {
    let [most, fewest] = LIMITS;
    let is_noise = |limit: f64| 2.0 * normal_cdf(-limit) > FALSE_SHARE * share;
    // Hundredths decide nothing.
    let mut steps = (0..).map(|step| fewest + 0.01 * f64::from(step)).take_while(|limit| *limit < most);
    steps.find(|&limit| !is_noise(limit)).unwrap_or(most)
}

/// A pixel that may be an outlier.
struct Candidate {
    at: (usize, usize),
    /// Above its prediction, e⁻.
    excess_e: f64,
    /// In standard deviations; NaN where that is to be computed.
    deviation: f64,
}

impl Candidate {
    fn new(at: (usize, usize)) -> Self {
        Self { at, excess_e: f64::NAN, deviation: f64::NAN }
    }

    /// Whether one of both is predicted from the other.
    fn is_near(&self, at: (usize, usize)) -> bool {
        self.at.0.abs_diff(at.0).max(self.at.1.abs_diff(at.1)) <= REACH
    }
}

/// Electrons of the light in a pixel, at most: twice the median of the pixels around it, which a
/// spot of two pixels' width has in its middle. The median ignores single outliers, so that the
/// noise of their neighbours is that of the light alone.
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

#[cfg(test)]
mod tests;
