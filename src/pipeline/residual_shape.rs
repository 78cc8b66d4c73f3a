//! Shape of the residual of an image: the part of its χ² that a copy of the star, an error of the
//! camera or lines of pixels explain.
//!
//! Each is a linear model of the residual, r = Σ cₖ·vₖ, fitted by least squares under the noise of
//! the pixels. At the minimum of a fit the residual is orthogonal to the derivatives of the image
//! by the fitted modes, which have absorbed a part of the cause: so the vₖ are replaced by their
//! parts orthogonal to these derivatives. The share that a shape explains is its decrease of χ²
//! over the excess of χ² beyond the degrees of freedom.

use crate::linear_algebra::SpdInverse;
use crate::modal::{FittedImage, camera};
use ndarray::{Array1, Array2, Axis, concatenate};
use std::ops::Range;

/// Least separation of a second star, model pixels: closer ones look like aberrations.
const LEAST_SEPARATION: usize = 3;
/// Products in the search for a copy; larger images are searched on every second pixel, or third.
const MAX_PRODUCTS: usize = 20_000_000;
/// Copies that are fitted without what the modes absorb of them: those that explain most with it.
const CANDIDATES: usize = 24;
/// Regularisation of the products of derivatives, whose squares are 1: nearly degenerate modes have
/// eigenvalues of 1e-3.
const RIDGE: f64 = 1e-9;

/// What makes a shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ShapeKind {
    /// A copy of the star: its flux over the star's. Two coordinates and a flux.
    Companion,
    /// The square of the signal: its part at the brightest pixel.
    NonLinearity,
    /// Second derivatives: RMS of the blur along an axis, detector pixels.
    Blur,
    /// Light spread far: its part of the star's.
    Halo,
    /// Gains of halves and quadrants: the largest difference.
    Gain,
    /// A response of each column or row of its own: RMS of it.
    Response,
    /// A level of each column or row of its own: its RMS, electrons.
    Level,
}

/// A shape of the residual: its share of the excess of χ², and the sentence's end that names it.
pub(super) struct Shape {
    pub(super) kind: ShapeKind,
    pub(super) share: f64,
    /// Its decrease of χ².
    pub(super) decrease: f64,
    /// Parameters that were fitted.
    pub(super) parameters: usize,
    /// What was found, in the unit of its kind.
    pub(super) value: f64,
    pub(super) sentence: String,
}

/// The value of an error of the camera with these coefficients, and the end of the sentence that
/// names it; `None` where there is no such error.
fn sentence_of_camera(kind: ShapeKind, found: &[f64]) -> Option<(f64, String)> {
    match kind {
        ShapeKind::NonLinearity => {
            let percent = -100.0 * found[0];
            let text = format!(
                "follows the square of the signal, {percent:+.1} % at the brightest pixel: a non-linear detector; correct the images \
                 for it, or expose for a shorter time"
            );
            Some((percent / 100.0, text))
        }
        ShapeKind::Blur => (found[0] > 0.0).then(|| {
            let pixels = found[0].sqrt();
            let text = format!(
                "is a blur of {pixels:.2} pixels RMS that the model lacks: the area of the pixels (image.pixel_fill), diffusion of charge \
                 (image.charge_diffusion_pixels), a filter (image.bandwidth_fraction), or motion of the image"
            );
            (pixels, text)
        }),
        ShapeKind::Halo => (found[0] > 0.0).then(|| {
            let (percent, pixels) = (100.0 * found[0], camera::HALO_PIXELS);
            let text = format!(
                "is a halo, {percent:.1} % of the star's light spread over some {pixels} pixels: scattered light; \
                 tolerance.halo_fraction holds it in the error bars"
            );
            (found[0], text)
        }),
        ShapeKind::Gain => {
            let percent = found.iter().map(|gain| 100.0 * gain).collect::<Vec<_>>();
            let text = format!(
                "is a difference of gains: the half at +x has {:+.1} %, that at +y {:+.1} % and the quadrants at +x, +y and −x, −y {:+.1} % \
                 more than the others; correct the images by a flat field",
                percent[0], percent[1], percent[2]
            );
            Some((found.iter().fold(0.0, |most: f64, gain| most.max(gain.abs())), text))
        }
        ShapeKind::Companion | ShapeKind::Response | ShapeKind::Level => None,
    }
}

/// Lines of pixels that hold this part of what all explain are named.
const NAMED_PART: f64 = 0.8;
/// Most lines that are named.
const NAMED_LINES: usize = 6;

/// What a residual has of a column of numbers in each line of pixels.
struct ByLine {
    share: f64,
    /// Lines that have some of it.
    lines: usize,
    /// The decrease of χ² of all.
    total: f64,
    /// RMS of the values, weighted as they count.
    rms: f64,
    values: Vec<f64>,
    /// Decrease of χ² of each.
    gains: Vec<f64>,
}

impl ByLine {
    /// The few lines that explain most, with the value of the first, as a sentence's part.
    fn what(&self, axis: usize, value: impl Fn(f64) -> String) -> Option<String> {
        let mut order: Vec<usize> = (0..self.gains.len()).collect();
        order.sort_by(|&a, &b| self.gains[b].total_cmp(&self.gains[a]));
        let mut most = order[..NAMED_LINES.min(order.len())].to_vec();
        let held: f64 = most.iter().map(|&line| self.gains[line]).sum();
        if held < NAMED_PART * self.total {
            return None;
        }
        most.retain(|&line| self.gains[line] > 0.05 * self.total);
        let (first, middle) = (*order.first()?, self.gains.len() / 2);
        most.sort_unstable();
        let places: Vec<String> = most.iter().map(|&line| (line as i64 - middle as i64).to_string()).collect();
        Some(format!(
            "{} in that at {} model pixels from the star along {} (the clearest at {})",
            value(self.values[first]),
            places.join(", "),
            ["x", "y"][axis],
            first as i64 - middle as i64
        ))
    }

    fn shape(self, kind: ShapeKind, sentence: String) -> Shape {
        Shape { kind, share: self.share, decrease: self.total, parameters: self.lines, value: self.rms, sentence }
    }
}

/// The residual of an image, with what explains it.
pub(super) struct Residual {
    /// Model of the star, without its background.
    star_e: Array2<f64>,
    residual_e: Array2<f64>,
    /// Inverse variances; 0 for bad pixels and where the residual is 0, which explains nothing.
    weight: Array2<f64>,
    /// Derivatives of the image by the fitted parameters, of unit length under the weights,
    /// `[parameter, pixel]`.
    derivatives: Array2<f64>,
    /// Inverse of their weighted products.
    inverse: Array2<f64>,
    /// χ² less the degrees of freedom.
    excess: f64,
    /// Detector pixels along a side of a model pixel.
    native: f64,
}

impl Residual {
    /// The residual of `fitted`, whose model has these `derivatives` by its modes, `[mode, pixel]`,
    /// in any unit; the flux and the background are added to them. `None` where they are linearly
    /// dependent.
    pub(super) fn new(fitted: &FittedImage, native: f64, derivatives: Array2<f64>) -> Option<Self> {
        let excess = fitted.residual_sigma.iter().filter(|sigma| sigma.is_finite()).map(|sigma| sigma * sigma - 1.0);
        let excess = excess.sum::<f64>() + derivatives.nrows() as f64;
        let floor = fitted.model_e.iter().copied().fold(f64::MAX, f64::min);
        let star_e = fitted.model_e.mapv(|electrons| electrons - floor);
        let residual_e = (&fitted.data_e - &fitted.model_e).mapv(|e| if e.is_finite() { e } else { 0.0 });
        let weight = Array2::from_shape_fn(residual_e.dim(), |at| {
            let ratio = fitted.residual_sigma[at] / residual_e[at];
            if ratio.is_finite() { ratio * ratio } else { 0.0 }
        });
        let (ones, flat) =
            (Array2::ones((1, star_e.len())), |map: &Array2<f64>| Array1::from_iter(map.iter().copied()));
        let star = flat(&star_e).insert_axis(Axis(0));
        let mut derivatives = concatenate(Axis(0), &[derivatives.view(), star.view(), ones.view()]).ok()?;
        let roots = flat(&weight).mapv(f64::sqrt);
        derivatives.outer_iter_mut().for_each(|mut row| {
            let length = row.iter().zip(&roots).map(|(value, root)| (value * root).powi(2)).sum::<f64>().sqrt();
            row.mapv_inplace(|value| if length > 0.0 { value / length } else { 0.0 });
        });
        let weighted = &derivatives * &roots;
        let mut products = weighted.dot(&weighted.t());
        products.diag_mut().mapv_inplace(|square| square + RIDGE);
        let inverse = SpdInverse::new(&products).ok()?.inverse;
        Some(Self { star_e, residual_e, weight, derivatives, inverse, excess, native })
    }

    /// Part of `column` that is orthogonal to the derivatives.
    fn without_modes(&self, column: &Array2<f64>) -> Array2<f64> {
        let weighted = Array1::from_iter(column.iter().zip(&self.weight).map(|(value, weight)| value * weight));
        let projection = self.inverse.dot(&self.derivatives.dot(&weighted)).dot(&self.derivatives);
        let mut rest = column.clone();
        rest.iter_mut().zip(&projection).for_each(|(value, along)| *value -= along);
        rest
    }

    /// The shape that explains most of the excess.
    pub(super) fn shape(&self) -> Option<Shape> {
        self.shapes().into_iter().max_by(|a, b| a.share.total_cmp(&b.share))
    }

    /// All shapes, each fitted alone.
    pub(super) fn shapes(&self) -> Vec<Shape> {
        let clearer = |of: [Option<Shape>; 2]| of.into_iter().flatten().max_by(|a, b| a.share.total_cmp(&b.share));
        let of_lines = [[0, 1].map(|axis| self.responses_along(axis)), [0, 1].map(|axis| self.levels_along(axis))];
        let of_lines = of_lines.into_iter().filter_map(clearer);
        self.copy_of_star().into_iter().chain(self.of_camera()).chain(of_lines).collect()
    }

    /// A response of its own of each column (0) or row (1): a column that is weak or dead, or gains
    /// of amplifiers.
    fn responses_along(&self, axis: usize) -> Option<Shape> {
        let own = self.by_line(axis, &self.star_e)?;
        let percent = 100.0 * own.rms;
        let what = own.what(axis, |value| format!("{:+.0} %", 100.0 * value)).unwrap_or_else(|| {
            format!("{percent:.1} % RMS: gains of amplifiers or of single lines, or a flat field that is not theirs")
        });
        let lines = ["column", "row"][axis];
        let sentence = format!(
            "{:.0} % of it is the star's light in some {lines}s more or less than in others, {what}; correct the images for it, or mark \
             the {lines}s as bad (BADPIX or --mask)",
            100.0 * own.share
        );
        Some(own.shape(ShapeKind::Response, sentence))
    }

    /// A level of its own of each column (0) or row (1): a warm column, or biases of amplifiers.
    fn levels_along(&self, axis: usize) -> Option<Shape> {
        let own = self.by_line(axis, &Array2::ones(self.star_e.dim()))?;
        let native = self.native * self.native;
        let what = own.what(axis, |value| format!("{:+.0} e⁻ a pixel", value / native)).unwrap_or_else(|| {
            format!(
                "{:.1} e⁻ RMS: biases of amplifiers or of single lines, or a background with a slope",
                own.rms / native
            )
        });
        let lines = ["column", "row"][axis];
        let sentence = format!(
            "{:.0} % of it is a level of each {lines} of its own, {what}; subtract it, or mark the {lines}s as bad (BADPIX or --mask)",
            100.0 * own.share
        );
        Some(own.shape(ShapeKind::Level, sentence))
    }

    /// `column` in each line of pixels by itself, as much as the residual has of it. The lines
    /// share no pixel, so that no matrix is inverted; what the modes absorb of them counts as not
    /// explained.
    fn by_line(&self, axis: usize, column: &Array2<f64>) -> Option<ByLine> {
        let across = Axis(1 - axis);
        let sums = |line: usize| {
            let of = |map: &Array2<f64>| map.index_axis(across, line).to_owned();
            let (value, weight) = (of(column), of(&self.weight));
            ((&value * &of(&self.residual_e) * &weight).sum(), (&value * &value * weight).sum())
        };
        let all: Vec<(f64, f64)> = (0..self.star_e.len_of(across)).map(sums).collect();
        let gains: Vec<f64> =
            all.iter().map(|(along, square)| if *square > 0.0 { along * along / square } else { 0.0 }).collect();
        let values = all.iter().map(|(along, square)| if *square > 0.0 { along / square } else { 0.0 });
        let (lines, total): (usize, f64) = (gains.iter().filter(|gain| **gain > 0.0).count(), gains.iter().sum());
        let squares: f64 = all.iter().map(|(_, square)| square).sum();
        let rms = (total / squares).sqrt();
        (rms.is_finite() && self.excess > 0.0).then(|| ByLine {
            share: (total - lines as f64) / self.excess,
            lines,
            total,
            rms,
            values: values.collect(),
            gains,
        })
    }

    /// χ² less the degrees of freedom.
    pub(super) fn excess(&self) -> f64 {
        self.excess
    }

    /// Decrease of χ² of a share that N columns explain.
    fn decrease(&self, share: f64, columns: usize) -> f64 {
        share * self.excess + columns as f64
    }

    /// Coefficients of `columns` by least squares, and the share that they explain; `None` where
    /// they are linearly dependent.
    fn fit(&self, columns: &[Array2<f64>]) -> Option<(Vec<f64>, f64)> {
        let columns: Vec<Array2<f64>> = columns.iter().map(|column| self.without_modes(column)).collect();
        let count = columns.len();
        let product = |a: &Array2<f64>, b: &Array2<f64>| {
            a.iter().zip(b).zip(&self.weight).map(|((a, b), weight)| weight * a * b).sum::<f64>()
        };
        // Columns of unit length, so that their units do not matter.
        let lengths: Vec<f64> = columns.iter().map(|column| product(column, column).sqrt()).collect();
        let cosine = |(i, j): (usize, usize)| product(&columns[i], &columns[j]) / (lengths[i] * lengths[j]);
        let normal = Array2::from_shape_fn((count, count), cosine);
        let right = Array1::from_shape_fn(count, |k| product(&columns[k], &self.residual_e) / lengths[k]);
        let solution = SpdInverse::new(&normal).ok()?.inverse.dot(&right);
        let share = (solution.dot(&right) - count as f64) / self.excess;
        Some((solution.iter().zip(&lengths).map(|(value, length)| value / length).collect(), share))
    }

    /// Errors of the camera that are no errors of its scale, which a fit of the plate scale finds.
    fn of_camera(&self) -> Vec<Shape> {
        let star: Vec<f64> = self.star_e.iter().copied().collect();
        let all = camera::columns(&star, self.star_e.nrows(), self.native);
        let all = all.map(|column| {
            let mut map = Array2::zeros(self.star_e.dim());
            map.iter_mut().zip(column).for_each(|(to, value)| *to = value);
            map
        });
        let of = |kind: ShapeKind, places: Range<usize>| {
            let (found, share) = self.fit(&all[places.clone()])?;
            let (value, what) = sentence_of_camera(kind, &found)?;
            let sentence = format!("{:.0} % of it {what}", 100.0 * share);
            let parameters = places.len();
            Some(Shape { kind, share, decrease: self.decrease(share, parameters), parameters, value, sentence })
        };
        let kinds = [
            (ShapeKind::NonLinearity, camera::RESPONSE),
            (ShapeKind::Blur, camera::BLUR),
            (ShapeKind::Halo, camera::HALO),
            (ShapeKind::Gain, camera::GAINS),
        ];
        kinds.into_iter().filter_map(|(kind, places)| of(kind, places)).collect()
    }

    /// A copy of the star elsewhere: a second star.
    fn copy_of_star(&self) -> Option<Shape> {
        let size = self.star_e.nrows();
        let reach = (size / 3) as isize;
        let shifts = (2 * reach + 1).pow(2) as usize;
        let stride = (1..).find(|stride| (size / stride).pow(2) * shifts <= MAX_PRODUCTS).unwrap_or(1);
        let is_apart = |dy: isize, dx: isize| dy * dy + dx * dx >= (LEAST_SEPARATION * LEAST_SEPARATION) as isize;
        let pairs = (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dy, dx)));
        let mut places: Vec<_> = pairs.filter(|&(dy, dx)| is_apart(dy, dx)).collect();
        let best_first = |places: &mut Vec<(isize, isize)>, stride: usize| {
            let mut ranked: Vec<_> =
                places.iter().map(|&(dy, dx)| (self.explained_by_copy(dy, dx, stride), dy, dx)).collect();
            ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
            ranked.truncate(CANDIDATES);
            *places = ranked.into_iter().map(|(_, dy, dx)| (dy, dx)).collect();
        };
        best_first(&mut places, stride);
        if stride > 1 {
            let around = |(dy, dx): (isize, isize)| (-1..=1).flat_map(move |v| (-1..=1).map(move |u| (dy + v, dx + u)));
            places = places.into_iter().flat_map(around).filter(|&(dy, dx)| is_apart(dy, dx)).collect();
            places.sort_unstable();
            places.dedup();
            best_first(&mut places, 1);
        }
        let fitted = places.into_iter().filter_map(|(dy, dx)| {
            let (found, share) = self.fit(&[self.star_at(dy, dx)])?;
            (found[0] > 0.0).then_some((share, found[0], dy, dx))
        });
        let (share, contrast, dy, dx) = fitted.max_by(|a, b| a.0.total_cmp(&b.0))?;
        let (x, y) = (dx as f64 * self.native, dy as f64 * self.native);
        Some(Shape {
            kind: ShapeKind::Companion,
            decrease: self.decrease(share, 1),
            parameters: 3,
            value: contrast,
            share,
            sentence: format!(
                "{:.0} % of it is a copy of the star's image with {contrast:.3} of its flux, {:.0} pixels away ({x:.0} along x, \
                 {y:.0} along y): a second star; mark its pixels as bad (BADPIX or --mask), or take another star",
                100.0 * share,
                x.hypot(y)
            ),
        })
    }

    /// The star displaced by whole pixels.
    fn star_at(&self, dy: isize, dx: isize) -> Array2<f64> {
        let before = |at: usize, shift: isize| usize::try_from(at as isize - shift).ok();
        Array2::from_shape_fn(self.star_e.dim(), |(y, x)| {
            let place = before(y, dy).zip(before(x, dx));
            place.and_then(|(v, u)| self.star_e.get([v, u])).copied().unwrap_or(0.0)
        })
    }

    /// Decrease of χ² by a copy of positive flux at a shift, on every `stride`-th pixel, with what
    /// the modes absorb of it.
    fn explained_by_copy(&self, dy: isize, dx: isize, stride: usize) -> f64 {
        let size = self.star_e.nrows();
        let (mut product, mut norm) = (0.0, 0.0);
        let inside = |at: usize, shift: isize| usize::try_from(at as isize - shift).ok().filter(|at| *at < size);
        for y in (0..size).step_by(stride) {
            let Some(v) = inside(y, dy) else { continue };
            for x in (0..size).step_by(stride) {
                let Some(u) = inside(x, dx) else { continue };
                let weighted = self.weight[[y, x]] * self.star_e[[v, u]];
                product += weighted * self.residual_e[[y, x]];
                norm += weighted * self.star_e[[v, u]];
            }
        }
        if norm > 0.0 && product > 0.0 { product * product / norm } else { 0.0 }
    }
}
