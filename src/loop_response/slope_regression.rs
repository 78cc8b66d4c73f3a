//! Regression of measured slopes on the slopes of retrieved wavefronts: whether telemetry belongs
//! to the images, and where not, why.
//!
//! The wavefronts are retrieved from the images alone, without the telemetry. Means over the
//! images, which hold the NCPA and the sensor's reference, and the mean x and y slope of each
//! exposure, which is pointing, are taken out of both. A retrieved wavefront is shrunk by its
//! prior, so the regression of measured on predicted slopes has the gain 1 at any noise.

use crate::ao::{OTHER_SLOPE_ORDERS, slope_sources};
use crate::scene::SlopeOrder;
use ndarray::{Array2, ArrayView2, Axis, s};

/// Gains that are accepted: a sensor's calibration errs by some tens of percent, other units by
/// factors.
pub const ACCEPTED_GAIN: std::ops::RangeInclusive<f64> = 0.5..=2.0;
/// Gains without a warning: spots that turbulence blurs during an exposure of 10 ms reduce a quad
/// cell's gain to 0.88.
pub const USUAL_GAIN: std::ops::RangeInclusive<f64> = 0.7..=1.4;
/// Difference of correlations beyond which one order of the slopes is better than another.
const BETTER: f64 = 0.15;
/// Advantage of a simpler cause over another that explains as much.
const SIMPLER: f64 = 0.05;
/// Slopes to one independent number: residuals of neighbouring subapertures are correlated.
const SLOPES_PER_NUMBER: f64 = 4.0;
/// Scatter of a slope over that of the others below which its subaperture is stuck: pointing alone
/// moves each by a third or more.
const STUCK_SHARE: f64 = 0.1;
/// Fewest images of which a small scatter of both slopes is no chance: of six normal numbers one is
/// below a tenth three times in 10⁵.
const IMAGES_OF_A_SCATTER: usize = 6;
/// The same of fewer images: slopes that do not change at all.
const STUCK_SHARE_OF_FEW: f64 = 1e-3;
/// Significance of a correlation, standard deviations.
const SIGNIFICANT: f64 = 3.0;
/// Fewest images whose order is identifiable: of two, each is the negative of the other about their
/// mean.
const ORDERED_IMAGES: usize = 3;

/// Likely cause of slopes that do not belong to the images.
#[derive(Debug, Clone, PartialEq)]
pub enum TelemetryFault {
    /// All slopes are 0.
    Zero,
    /// Every image has the same slopes.
    Constant,
    /// Slopes in another order or about other axes, and whether their sign is opposite too.
    Order(SlopeOrder, bool),
    /// Another unit: measured over predicted slopes.
    Unit(f64),
    /// Image i belongs to the slopes of image `count − 1 − i`.
    ReversedTime,
    /// Image i belongs to the slopes of image i + n.
    ShiftedTime(isize),
    /// The images are in another order than the slopes.
    OtherTime,
    /// No alternative explains the slopes.
    Unrelated,
}

/// Measured slopes against those of retrieved wavefronts.
#[derive(Debug, Clone, PartialEq)]
pub struct SlopeRegression {
    /// Measured over predicted slopes, least squares; 0 where all are.
    pub gain: f64,
    /// Their correlation.
    pub correlation: f64,
    /// The same for each image.
    pub image_correlations: Vec<f64>,
    /// Correlation under the likely cause.
    pub explained_correlation: f64,
    /// Why the slopes do not belong to the images; `None` where they do.
    pub fault: Option<TelemetryFault>,
    /// Whether the slopes exclude that the images are mirrored or rotated by 180°.
    pub excludes_flips: bool,
    /// Least correlation that noise does not explain.
    pub significant_correlation: f64,
    /// Subapertures (row, column) whose slopes change little from image to image, where those of
    /// the others do.
    pub stuck: Vec<(usize, usize)>,
}

impl SlopeRegression {
    /// Compares slopes, both `[image, slope]`, of the subapertures in use (`row·across + column`).
    pub fn new(
        predicted_mas: ArrayView2<f64>,
        measured_mas: ArrayView2<f64>,
        across: usize,
        subapertures: &[usize],
    ) -> Self {
        let predicted = dynamic(predicted_mas);
        let measured = dynamic(measured_mas);
        let (images, slopes) = predicted.dim();
        let numbers = (images.max(2) - 1) as f64 * slopes as f64 / SLOPES_PER_NUMBER;
        let significant = (SIGNIFICANT / numbers.sqrt()).min(0.9);
        let [gain, correlation] = regress(&predicted, &measured);
        let whole: f64 = measured_mas.iter().map(|mas| mas * mas).sum();
        let moving: f64 = measured.iter().map(|mas| mas * mas).sum();
        let matches = image_matches(&predicted, &measured);
        let mut found = Self {
            gain,
            correlation,
            image_correlations: matches.diag().to_vec(),
            explained_correlation: correlation,
            fault: None,
            excludes_flips: false,
            significant_correlation: significant,
            stuck: Vec::new(),
        };
        if moving <= 1e-12 * whole || whole == 0.0 {
            found.fault = Some(if whole == 0.0 { TelemetryFault::Zero } else { TelemetryFault::Constant });
            return found;
        }
        found.stuck = stuck(measured_mas, subapertures).map(|at| (at / across, at % across)).collect();
        let orders: Vec<(SlopeOrder, f64)> = OTHER_SLOPE_ORDERS
            .into_iter()
            .filter_map(|order| {
                let sources = slope_sources(order, across, subapertures)?;
                // Centred again: pointing is the mean of other slopes in another order.
                let reordered = Array2::from_shape_fn(measured_mas.dim(), |(image, slope)| {
                    let (source, sign) = sources[slope];
                    sign * measured_mas[[image, source]]
                });
                Some((order, regress(&predicted, &dynamic(reordered.view()))[1]))
            })
            .chain([(SlopeOrder::Expected, -correlation)])
            .collect();
        let mut best = (None, correlation);
        for &(order, value) in &orders {
            // One axis negated is the other one negated and all signs opposite: the simpler name
            // goes first.
            let (size, opposite) = match order {
                SlopeOrder::Expected => (value, true),
                _ if value < 0.0 => (-value - SIMPLER, true),
                _ => (value, false),
            };
            if size > best.1.max(correlation + BETTER) {
                best = (Some(TelemetryFault::Order(order, opposite)), size);
            }
        }
        for (fault, value) in other_times(&matches, &predicted, &measured) {
            if value > best.1.max(correlation + BETTER) {
                best = (Some(fault), value);
            }
        }
        found.fault = match best {
            (Some(fault), value) if value >= significant => {
                found.explained_correlation = value;
                Some(fault)
            }
            _ if correlation < significant => Some(TelemetryFault::Unrelated),
            _ if !ACCEPTED_GAIN.contains(&gain) => Some(TelemetryFault::Unit(gain)),
            _ => None,
        };
        let flips = [SlopeOrder::FlippedX, SlopeOrder::FlippedY, SlopeOrder::Rotated180];
        let is_worse = |flip| orders.iter().any(|&(order, value)| order == flip && value < correlation - BETTER);
        found.excludes_flips = found.fault.is_none() && flips.into_iter().all(is_worse);
        found
    }

    /// Images whose slopes do not belong to them, although those of the others do.
    pub fn odd_images(&self, slopes: usize) -> Vec<usize> {
        let mut sorted = self.image_correlations.clone();
        sorted.sort_by(f64::total_cmp);
        let typical = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
        // Standard deviation of a correlation (Fisher).
        let sigma = (1.0 - typical * typical) * (SLOPES_PER_NUMBER / slopes as f64).sqrt();
        let least = (0.5 * typical).min(typical - SIGNIFICANT * sigma);
        (0..self.image_correlations.len()).filter(|&image| self.image_correlations[image] < least).collect()
    }

    /// Whether the gain is known, so that slopes can be divided by it.
    pub fn has_significant_gain(&self) -> bool {
        self.correlation.abs() >= self.significant_correlation && self.gain != 0.0
    }
}

/// Measured over predicted slopes, both `[image, slope]`, least squares as in [`SlopeRegression`],
/// within [`ACCEPTED_GAIN`]; 1 where nothing is predicted.
pub(super) fn slope_gain(predicted_mas: ArrayView2<f64>, measured_mas: ArrayView2<f64>) -> f64 {
    let [gain, _] = regress(&dynamic(predicted_mas), &dynamic(measured_mas));
    if gain == 0.0 { 1.0 } else { gain.clamp(*ACCEPTED_GAIN.start(), *ACCEPTED_GAIN.end()) }
}

/// Slopes without the mean x and y slope of each image, and without the mean over images.
fn dynamic(slopes_mas: ArrayView2<f64>) -> Array2<f64> {
    let mut slopes = slopes_mas.to_owned();
    let half = slopes.ncols() / 2;
    for mut row in slopes.outer_iter_mut() {
        for range in [s![..half], s![half..]] {
            let mut part = row.slice_mut(range);
            let mean = part.mean().unwrap_or(0.0);
            part -= mean;
        }
    }
    if let Some(mean) = slopes.mean_axis(Axis(0)) {
        slopes -= &mean;
    }
    slopes
}

/// Those of the `subapertures` both of whose slopes scatter over the images by less than
/// [`STUCK_SHARE`] of the median scatter.
fn stuck(slopes_mas: ArrayView2<f64>, subapertures: &[usize]) -> impl Iterator<Item = usize> {
    let scatter: Vec<f64> = slopes_mas.columns().into_iter().map(|column| column.std(0.0)).collect();
    let mut sorted = scatter.clone();
    sorted.sort_by(f64::total_cmp);
    let share = if slopes_mas.nrows() < IMAGES_OF_A_SCATTER { STUCK_SHARE_OF_FEW } else { STUCK_SHARE };
    let least = share * sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
    let half = scatter.len() / 2;
    let is_stuck = move |&(number, _): &(usize, &usize)| scatter[number].max(scatter[half + number]) < least;
    subapertures.iter().enumerate().filter(is_stuck).map(|(_, &subaperture)| subaperture)
}

/// Gain and correlation of `measured` on `predicted`.
fn regress(predicted: &Array2<f64>, measured: &Array2<f64>) -> [f64; 2] {
    let (mut pp, mut pm, mut mm) = (0.0, 0.0, 0.0);
    for (p, m) in predicted.iter().zip(measured) {
        (pp, pm, mm) = (pp + p * p, pm + p * m, mm + m * m);
    }
    let ratio = |a: f64, b: f64| if b > 0.0 { a / b } else { 0.0 };
    [ratio(pm, pp), ratio(pm, (pp * mm).sqrt())]
}

/// Correlation of the prediction of each image with the measurement of each,
/// `[predicted, measured]`.
fn image_matches(predicted: &Array2<f64>, measured: &Array2<f64>) -> Array2<f64> {
    let mut matches = predicted.dot(&measured.t());
    let norms = |slopes: &Array2<f64>| -> Vec<f64> { slopes.outer_iter().map(|row| row.dot(&row).sqrt()).collect() };
    let (p, m) = (norms(predicted), norms(measured));
    for ((i, j), value) in matches.indexed_iter_mut() {
        let norm = p[i] * m[j];
        *value = if norm > 0.0 { *value / norm } else { 0.0 };
    }
    matches
}

/// Correlations of the images with slopes of other images.
fn other_times(matches: &Array2<f64>, predicted: &Array2<f64>, measured: &Array2<f64>) -> Vec<(TelemetryFault, f64)> {
    let images = matches.nrows();
    if images < ORDERED_IMAGES {
        return Vec::new();
    }
    let correlation = |pairs: &[(usize, usize)]| {
        let select = |slopes: &Array2<f64>, which: Vec<usize>| slopes.select(Axis(0), &which);
        let (p, m) = pairs.iter().copied().unzip();
        regress(&select(predicted, p), &select(measured, m))[1]
    };
    let reversed: Vec<_> = (0..images).map(|image| (image, images - 1 - image)).collect();
    let mut found = vec![(TelemetryFault::ReversedTime, correlation(&reversed))];
    let farthest = images.saturating_sub(ORDERED_IMAGES).min(images / 2) as isize;
    for shift in (-farthest..=farthest).filter(|shift| *shift != 0) {
        let inside = |image: usize| {
            let other = image as isize + shift;
            (0..images as isize).contains(&other).then_some((image, other as usize))
        };
        let pairs: Vec<_> = (0..images).filter_map(inside).collect();
        found.push((TelemetryFault::ShiftedTime(shift), correlation(&pairs)));
    }
    let best = |image: usize| {
        (0..images).max_by(|&a, &b| matches[[image, a]].total_cmp(&matches[[image, b]])).unwrap_or(image)
    };
    let pairs: Vec<_> = (0..images).map(|image| (image, best(image))).collect();
    let mut taken: Vec<usize> = pairs.iter().map(|pair| pair.1).collect();
    taken.sort_unstable();
    taken.dedup();
    if taken.len() == images {
        // A named order of time may explain as much.
        found.push((TelemetryFault::OtherTime, correlation(&pairs) - SIMPLER));
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_distr::{Distribution, StandardNormal};

    const ACROSS: usize = 8;

    fn subapertures() -> Vec<usize> {
        (0..ACROSS * ACROSS).filter(|i| ![0, 7, 56, 63].contains(i)).collect()
    }

    fn normal(rows: usize, seed: u64) -> Array2<f64> {
        let mut rng = crate::source::stream(4, seed);
        Array2::from_shape_simple_fn((rows, 2 * subapertures().len()), || StandardNormal.sample(&mut rng))
    }

    fn compare(measured: &Array2<f64>, predicted: &Array2<f64>) -> SlopeRegression {
        SlopeRegression::new(predicted.view(), measured.view(), ACROSS, &subapertures())
    }

    #[test]
    fn slopes_that_belong_to_the_images_have_their_gain() {
        let predicted = normal(4, 1);
        let reference = normal(1, 2) * 5.0;
        let found = compare(&(&predicted * 1.1 + &reference + normal(4, 3) * 0.5), &predicted);
        // 4·120 numbers: 0.5/√360 = 0.03.
        assert!((found.gain - 1.1).abs() < 0.1 && found.correlation > 0.85, "{found:?}");
        assert!(found.fault.is_none() && found.excludes_flips && found.odd_images(120).is_empty());
    }

    #[test]
    fn each_fault_is_named() {
        let predicted = normal(5, 1);
        let right = &predicted + &(normal(5, 3) * 0.4);
        let fault = |measured: &Array2<f64>| compare(measured, &predicted).fault;
        assert_eq!(fault(&(&right * 0.0)), Some(TelemetryFault::Zero));
        assert_eq!(fault(&(&right * 0.0 + 2.0)), Some(TelemetryFault::Constant));
        assert_eq!(fault(&-&right), Some(TelemetryFault::Order(SlopeOrder::Expected, true)));
        assert!(matches!(fault(&(&right * 30.0)), Some(TelemetryFault::Unit(gain)) if (gain / 30.0 - 1.0).abs() < 0.1));
        assert_eq!(fault(&normal(5, 9)), Some(TelemetryFault::Unrelated));
        for order in OTHER_SLOPE_ORDERS {
            let sources = slope_sources(order, ACROSS, &subapertures()).unwrap();
            let mut given = Array2::zeros(right.dim());
            for ((image, slope), mas) in right.indexed_iter() {
                let (source, sign) = sources[slope];
                given[[image, source]] = sign * mas;
            }
            let found = fault(&given);
            assert_eq!(found, Some(TelemetryFault::Order(order, false)), "{order:?}");
        }
        assert_eq!(fault(&right.select(Axis(0), &[4, 3, 2, 1, 0])), Some(TelemetryFault::ReversedTime));
        assert_eq!(fault(&right.select(Axis(0), &[4, 0, 1, 2, 3])), Some(TelemetryFault::ShiftedTime(1)));
        assert_eq!(fault(&right.select(Axis(0), &[2, 0, 4, 1, 3])), Some(TelemetryFault::OtherTime));
        let mut one = right.clone();
        one.row_mut(2).assign(&normal(1, 8).row(0));
        let found = compare(&one, &predicted);
        assert_eq!((found.fault.clone(), found.odd_images(120)), (None, vec![2]), "{found:?}");
    }

    #[test]
    fn stuck_subapertures_are_named() {
        let predicted = normal(5, 1);
        let mut measured = &predicted + &(normal(5, 3) * 0.4);
        assert!(compare(&measured, &predicted).stuck.is_empty());
        let place = subapertures().iter().position(|&at| at == 3 * ACROSS + 5).unwrap();
        measured.column_mut(place).fill(900.0);
        // An axis by itself can stand still where a spot drifts along the other.
        assert!(compare(&measured, &predicted).stuck.is_empty());
        measured.column_mut(60 + place).fill(-900.0);
        let found = compare(&measured, &predicted);
        assert_eq!((found.stuck.as_slice(), &found.fault), (&[(3, 5)][..], &None), "{found:?}");
        // With the noise of a detector, where there are enough images to tell.
        let predicted = normal(8, 1);
        let mut measured = &predicted + &(normal(8, 3) * 0.4);
        assert!(compare(&measured, &predicted).stuck.is_empty());
        for (slope, mas) in [(place, 900.0), (60 + place, -900.0)] {
            let noise = normal(8, 5).column(slope).mapv(|noise| mas + 0.03 * noise);
            measured.column_mut(slope).assign(&noise);
        }
        assert_eq!(compare(&measured, &predicted).stuck, [(3, 5)]);
    }
}
