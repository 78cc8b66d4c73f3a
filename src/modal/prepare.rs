//! Preparation of a detector frame: checked, reduced to the model's sampling with its noise,
//! centred, cropped, weighted.

pub(in crate::modal) mod calibration;
pub(in crate::modal) mod cube;
pub(in crate::modal) mod dead;
mod extent;
pub(in crate::modal) mod outliers;
mod reduction;
mod refusal;
pub(in crate::modal) mod rejected;
pub(in crate::modal) mod rejection;
mod spikes;
mod statistics;

pub use refusal::Refusal;

use crate::imaging::{Exposure, Photometry};
use crate::modal::model::recipe::Recipe;
use crate::modal::prepare::rejected::{Rejected, RejectedPixels};
use crate::scene::Weighting;
use crate::{Error, Result};
use dead::DeadPixels;
use extent::{Extent, extents_of_clean_rows};
use ndarray::{Array2, ArrayView1, ArrayView2};
use reduction::Decimation;
use spikes::Spikes;
use statistics::Statistics;

/// A frame: electrons and bad pixels.
#[derive(Debug, Clone, Copy)]
pub struct Frame<'a> {
    /// Electrons, `[y, x]`.
    pub data_e: ArrayView2<'a, f64>,
    /// Bad pixels, `[y, x]`; pixels that are not finite count as bad whether marked or not.
    pub bad: ArrayView2<'a, bool>,
    /// Read noise of a pixel, RMS electrons; `None` for the scatter of the frame's border.
    pub read_noise_e: Option<f64>,
}

/// Smallest variance of a native pixel without the star's photons, e²: that of rounding to whole
/// electrons, which every count of electrons has. It keeps the weight of a pixel finite where
/// neither light nor read noise is expected, and is below a hundredth of the photon noise of ten
/// electrons.
const MIN_VARIANCE_E2: f64 = 1.0 / 12.0;

/// Preparation of frames for one model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Preparation {
    /// Pixels of a frame along x and y, both even; the axis is on pixel
    /// `[frame[0] / 2, frame[1] / 2]`.
    pub frame: [usize; 2],
    /// Pixels along x and y after the reduction to the model's sampling (equal to `frame` where
    /// there is none), even.
    pub reduced: [usize; 2],
    /// Pixels along a side of the part that is fitted; its pixels beyond the frame are bad.
    pub pixels: usize,
    /// Whether the detector's columns, and its rows, run against the axes.
    pub flip: [bool; 2],
}

/// A prepared frame.
#[derive(Debug)]
pub struct PreparedFrame {
    /// Exposure for the imaging chain.
    pub exposure: Exposure,
    /// Variance of each pixel without the star's photons (read noise and background), e²; infinite
    /// for a bad pixel.
    pub floor_variance_e2: Vec<f64>,
    /// Part of that variance which is stated: 1, but less where `MIN_VARIANCE_E2` exceeds the
    /// stated read noise, and 0 where the scatter of the border takes its place. χ² is expected to
    /// be 1 with the whole of it, and less with a part.
    pub stated_share: f64,
    /// Level of the frame's border, e⁻ per model pixel: a first guess of the background.
    pub level_e: f64,
    /// Position of the star: whole model pixels by which the frame was moved onto the axis, along x
    /// and y.
    pub shift_pixels: [i64; 2],
    /// Number of bad pixels of the fitted part.
    pub bad_pixels: usize,
    /// Outlier pixels of the frame that were taken out before.
    pub taken_out: RejectedPixels,
    /// Pixels of the fitted part that the fit rejects; their floor is infinite.
    pub(super) rejected: Rejected,
}

impl Clone for PreparedFrame {
    fn clone(&self) -> Self {
        Self {
            exposure: self.exposure.clone(),
            floor_variance_e2: self.floor_variance_e2.clone(),
            rejected: self.rejected.clone(),
            ..*self
        }
    }

    /// Without another allocation where the frames have one size.
    fn clone_from(&mut self, source: &Self) {
        let Self { stated_share, level_e, shift_pixels, bad_pixels, taken_out, .. } = *source;
        self.exposure.clone_from(&source.exposure);
        self.floor_variance_e2.clone_from(&source.floor_variance_e2);
        self.rejected.clone_from(&source.rejected);
        (self.stated_share, self.level_e, self.shift_pixels) = (stated_share, level_e, shift_pixels);
        (self.bad_pixels, self.taken_out) = (bad_pixels, taken_out);
    }
}

/// Treatment of bad pixels where the sampling is reduced.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Ringing {
    /// They count as 0, and ring.
    Accepted,
    /// The frame is refused.
    Refused,
}

impl Preparation {
    /// Prepares `frame`.
    ///
    /// # Errors
    /// [`Error::Shape`] for a frame of another size than the scene's, [`Error::Image`] for one
    /// without a star.
    pub fn prepare(&self, frame: Frame, recipe: &Recipe) -> Result<PreparedFrame> {
        self.attempt(frame, recipe)?.map_err(|refusal| Error::Image(refusal.to_string()))
    }

    /// As [`Preparation::prepare`], with the reason why a frame cannot be used.
    pub(crate) fn attempt(&self, frame: Frame, recipe: &Recipe) -> Result<std::result::Result<PreparedFrame, Refusal>> {
        self.check(frame)?;
        let mut prepared = self.empty();
        let outcome = Preparer::new(*self).prepare(frame, recipe, Ringing::Accepted, &mut prepared);
        Ok(outcome.map(|()| prepared))
    }

    /// Native pixels to a model pixel, by area.
    pub fn native_pixels(&self) -> f64 {
        self.native_along(0) * self.native_along(1)
    }

    /// Native pixels to a model pixel along x (0) or y (1).
    pub fn native_along(&self, axis: usize) -> f64 {
        self.frame[axis] as f64 / self.reduced[axis] as f64
    }

    /// Place in the frame of a pixel of the fitted part along x (0) or y (1), of an image that was
    /// moved by `shift` model pixels: the first of several where the sampling is reduced; `None`
    /// beyond the frame.
    pub(super) fn place_in_frame(&self, axis: usize, pixel: usize, shift: i64) -> Option<usize> {
        let (frame, reduced) = (self.frame[axis], self.reduced[axis]);
        let model = (pixel + reduced / 2) as i64 - (self.pixels / 2) as i64 + shift;
        let place = usize::try_from(model).ok().filter(|&model| model < reduced)? * frame / reduced;
        Some(if self.flip[axis] { frame.checked_sub(place).filter(|&place| place < frame)? } else { place })
    }

    /// An empty prepared frame, to be written by a [`Preparer`].
    pub(super) fn empty(&self) -> PreparedFrame {
        let zeros = || vec![0.0; self.pixels * self.pixels];
        let photometry = Photometry::Fixed { flux_e: 0.0, background_e: 0.0 };
        PreparedFrame {
            exposure: Exposure { data_e: zeros(), weight: zeros(), photometry },
            floor_variance_e2: zeros(),
            stated_share: 1.0,
            level_e: 0.0,
            shift_pixels: [0, 0],
            bad_pixels: 0,
            taken_out: RejectedPixels::default(),
            rejected: Rejected::none_of(self.pixels.pow(2)),
        }
    }

    /// Refuses a frame of another size than the scene's.
    ///
    /// # Errors
    /// [`Error::Shape`].
    pub(super) fn check(&self, frame: Frame) -> Result<()> {
        let [x, y] = self.frame;
        check_frame_shape(frame.data_e.dim(), (y, x))?;
        if frame.bad.dim() == (y, x) { Ok(()) } else { check_frame_shape(frame.bad.dim(), (y, x)) }
    }
}

/// Refuses a frame of other rows and columns than `(y, x)`, those of the scene.
///
/// # Errors
/// [`Error::Shape`].
pub(crate) fn check_frame_shape((rows, columns): (usize, usize), (y, x): (usize, usize)) -> Result<()> {
    if (rows, columns) == (y, x) {
        return Ok(());
    }
    let keys = if x == y { "image.pixels" } else { "image.columns and image.rows" };
    let [even_columns, even_rows] = [columns, rows].map(|size| size - size % 2);
    let even = if (even_columns, even_rows) == (columns, rows) {
        String::new()
    } else {
        format!("; frames are even: {even_columns}x{even_rows}, without the last row or column, is accepted")
    };
    let hint = cut_out_hint((rows, columns), (y, x));
    Err(Error::Shape(format!(
        "the image has {columns}x{rows} pixels where the scene says {x}x{y} ({keys}){even}{hint}"
    )))
}

/// End of a message on frames that are larger than those of a scene: how such frames are cut out.
pub(crate) fn cut_out_hint((rows, columns): (usize, usize), (y, x): (usize, usize)) -> &'static str {
    if rows >= y && columns >= x { "; 'cophase reduce' cuts images of this size out of raw frames" } else { "" }
}

/// Prepares frames one after the other, in memory of its own. Nothing is allocated after
/// construction.
pub(super) struct Preparer {
    plan: Preparation,
    /// The frame in the model's orientation, `[y, x]`; bad pixels hold 0.
    data: Array2<f64>,
    bad: Array2<bool>,
    /// Extents of each row of the frame, and then of each row at the model's sampling.
    extents: Vec<Extent>,
    statistics: Statistics,
    /// `None` while a frame is prepared.
    dead: Option<DeadPixels>,
    spikes: Spikes,
    reduction: Option<Decimation>,
}

/// A frame at the model's sampling, before it is cropped.
struct SampledFrame<'a> {
    data: ArrayView2<'a, f64>,
    /// `None` after a reduction, which has no bad pixels.
    bad: Option<ArrayView2<'a, bool>>,
    /// Extents of each row.
    extents: &'a [Extent],
}

impl SampledFrame<'_> {
    fn is_bad(&self, at: (usize, usize)) -> bool {
        self.bad.as_ref().is_some_and(|bad| bad[at])
    }

    /// The `size` pixels of a row from `(row, column)` on, where the frame has them all and none is
    /// bad.
    fn good_stretch(&self, (row, column): (usize, usize), size: usize) -> Option<&[f64]> {
        let stretch = column..column + size;
        let bad = self.bad.as_ref().map(|bad| bad.row(row).to_slice().and_then(|bad| bad.get(stretch.clone())));
        let good = bad.is_none_or(|bad| bad.is_some_and(|bad| !bad.iter().fold(false, |any, bad| any | *bad)));
        self.data.row(row).to_slice().and_then(|data| data.get(stretch)).filter(|_| good)
    }
}

impl Preparer {
    pub(super) fn new(plan: Preparation) -> Self {
        let shape = (plan.frame[1], plan.frame[0]);
        Self {
            plan,
            data: Array2::zeros(shape),
            bad: Array2::from_elem(shape, false),
            extents: vec![Extent::EMPTY; shape.0.max(plan.reduced[1])],
            statistics: Statistics::with_capacity(shape.0 * shape.1),
            dead: Some(DeadPixels::new(shape)),
            spikes: Spikes::new(),
            reduction: (plan.reduced != plan.frame).then(|| Decimation::new(plan.frame, plan.reduced)),
        }
    }

    /// Prepares `frame`, whose shape the caller has checked, in the memory of `prepared`.
    ///
    /// # Errors
    /// Why the frame cannot be used; the content of `prepared` is then undefined.
    ///
    /// # Panics
    /// Where the frame has another shape than the plan.
    pub(super) fn prepare(
        &mut self,
        frame: Frame,
        recipe: &Recipe,
        ringing: Ringing,
        prepared: &mut PreparedFrame,
    ) -> std::result::Result<(), Refusal> {
        let mut dead = self.dead.take();
        let Frame { data_e, bad, read_noise_e } = frame;
        // Where bad pixels have a frame refused, dead ones, which may be far from the star, are
        // left to the fit.
        let is_searched = recipe.reject_outliers && (self.reduction.is_none() || ringing == Ringing::Accepted);
        let has_dead = is_searched && dead.as_mut().is_some_and(|dead| dead.find(data_e, bad));
        let bad = dead.as_ref().filter(|_| has_dead).map_or(bad.view(), DeadPixels::bad);
        let good = Frame { data_e: data_e.view(), bad, read_noise_e };
        let outcome = self.prepare_good(good, recipe, ringing, prepared);
        self.dead = dead;
        outcome
    }

    /// As [`Preparer::prepare`], of a frame whose dead lines and blocks are marked.
    fn prepare_good(
        &mut self,
        frame: Frame,
        recipe: &Recipe,
        ringing: Ringing,
        prepared: &mut PreparedFrame,
    ) -> std::result::Result<(), Refusal> {
        // Most frames have no bad pixel and are not flipped: they are read without a copy.
        let flipped = self.plan.flip != [false; 2];
        let clean = if flipped { None } else { extents_of_clean_rows(frame.data_e, frame.bad, &mut self.extents) };
        let lost = if clean.is_some() { 0 } else { self.orient(frame) };
        if self.reduction.is_some() && ringing == Ringing::Refused && lost > 0 {
            return Err(Refusal::BadPixelsWouldRing { bad: lost });
        }
        let mut is_clean = clean.is_some();
        let (data, bad) = if is_clean { (frame.data_e, frame.bad) } else { (self.data.view(), self.bad.view()) };
        let level = self.statistics.level_of_border(data, bad);
        let (variance_e2, stated_share) = match frame.read_noise_e {
            Some(stated) => {
                let variance_e2 = stated.powi(2).max(MIN_VARIANCE_E2);
                (variance_e2, stated.powi(2) / variance_e2)
            }
            // The scatter of the border includes the star's light there, so it is an upper limit; 1
            // e⁻ keeps weights finite on synthetic frames.
            None => (self.statistics.scatter_about(level).max(1.0).powi(2), 0.0),
        };
        self.spikes.clear();
        if recipe.reject_outliers {
            let Self { data, bad, extents, spikes, reduction, .. } = self;
            let original = is_clean.then_some((frame.data_e, frame.bad));
            if spikes.take_out(original, (data, bad), (level, variance_e2), &mut extents[..self.plan.frame[1]]) {
                is_clean = false;
                if reduction.is_some() {
                    spikes.fill(data, bad, level);
                }
            }
        }
        prepared.taken_out = RejectedPixels { high: self.spikes.found().len(), ..RejectedPixels::default() };
        refusal::refuse_unusable(&self.extents[..self.plan.frame[1]], level, (variance_e2 + level.max(0.0)).sqrt())?;
        let (data, bad) = if is_clean { (frame.data_e, frame.bad) } else { (self.data.view(), self.bad.view()) };
        let sampled = match &mut self.reduction {
            Some(reduction) => {
                let data = reduction.run(data);
                for (extent, row) in self.extents.iter_mut().zip(data.outer_iter()) {
                    *extent = row.as_slice().map_or(Extent::EMPTY, Extent::from_row);
                }
                SampledFrame { data: data.view(), bad: None, extents: &self.extents }
            }
            None => SampledFrame { data, bad: (!is_clean).then_some(bad), extents: &self.extents },
        };
        let area = self.plan.native_pixels();
        prepared.level_e = level * area;
        prepared.shift_pixels = if recipe.recentre { off_axis(&sampled, prepared.level_e) } else { [0, 0] };
        // A sum over some native pixels: their read variances add, and their photons are in the
        // data.
        let floor = variance_e2 * area;
        prepared.stated_share = stated_share;
        prepared.rejected.begin(floor);
        prepared.bad_pixels = crop(&sampled, self.plan.pixels, floor, prepared);
        if self.reduction.is_none() {
            // Spikes of the fitted part are bad pixels that were not marked.
            let Preparation { frame, pixels, .. } = self.plan;
            let shift = prepared.shift_pixels;
            let is_fitted = |axis: usize, at: usize| {
                let first = (frame[axis] / 2) as i64 - (pixels / 2) as i64 + shift[axis];
                (first..first + pixels as i64).contains(&(at as i64))
            };
            let fitted = self.spikes.found().iter().filter(|(y, x)| is_fitted(1, *y) && is_fitted(0, *x)).count();
            prepared.bad_pixels -= fitted;
        }
        if prepared.bad_pixels == prepared.floor_variance_e2.len() {
            return Err(Refusal::NoGoodPixel);
        }
        weigh(prepared, recipe, area);
        Ok(())
    }

    /// Copies the frame in the model's orientation, bad pixels as 0. Returns the number of bad
    /// pixels of the frame itself.
    ///
    /// Flipping an even number of pixels moves the axis from pixel M/2 to M/2 − 1: it is moved
    /// back, and the line that wraps around is bad.
    fn orient(&mut self, frame: Frame) -> usize {
        let (rows, columns) = self.data.dim();
        let [flip_x, flip_y] = self.plan.flip;
        let from = |i: usize, size: usize, flip: bool| if flip { (i > 0).then(|| size - i) } else { Some(i) };
        let mut lost = 0;
        let lines = self.data.outer_iter_mut().zip(self.bad.outer_iter_mut()).zip(&mut self.extents);
        for (v, ((mut data, mut bad), extent)) in lines.enumerate() {
            let Some(at) = from(v, rows, flip_y) else {
                data.fill(0.0);
                bad.fill(true);
                *extent = Extent::EMPTY;
                continue;
            };
            let (values, marks) = (frame.data_e.row(at), frame.bad.row(at));
            // Most rows have no bad pixel. A loop without an early exit is vectorised.
            let marked = marks.iter().fold(false, |any, marked| any | *marked);
            let whole = values.as_slice().filter(|_| !marked && !flip_x).and_then(Extent::from_finite_row);
            if let Some(whole) = whole {
                data.assign(&values);
                bad.fill(false);
                *extent = whole;
                continue;
            }
            lost += values.iter().zip(marks).filter(|(value, marked)| **marked || !value.is_finite()).count();
            for (u, (data, bad)) in data.iter_mut().zip(&mut bad).enumerate() {
                let good = from(u, columns, flip_x).filter(|&u| !marks[u] && values[u].is_finite());
                *data = good.map_or(0.0, |u| values[u]);
                *bad = good.is_none();
            }
            let good = data.iter().zip(&bad).filter(|(_, bad)| !**bad);
            *extent = good.fold(Extent::EMPTY, |extent, (&value, _)| extent.with(value));
        }
        // The row that a flip wraps around is not read, but its bad pixels count.
        if flip_y {
            let (values, marks) = (frame.data_e.row(0), frame.bad.row(0));
            lost += values.iter().zip(marks).filter(|(value, marked)| **marked || !value.is_finite()).count();
        }
        lost
    }
}

/// Whole pixels from the axis to the star's centroid; 0 within 3 pixels, where exact tip and tilt
/// do better.
fn off_axis(frame: &SampledFrame, level: f64) -> [i64; 2] {
    let (rows, columns) = frame.data.dim();
    // Only pixels above 5 % of the brightest one, so that noise far from the star does not shift
    // the centroid.
    let brightest = frame.extents[..rows].iter().fold(f64::MIN, |most, row| most.max(row.most)) - level;
    let threshold = level + 0.05 * brightest;
    let (mut sum, mut x, mut y) = (0.0, 0.0, 0.0);
    // Most rows have no pixel above the threshold.
    for (v, row) in frame.data.outer_iter().enumerate().filter(|(v, _)| frame.extents[*v].most > threshold) {
        for (u, &value) in row.iter().enumerate() {
            if value > threshold && !frame.is_bad((v, u)) {
                let value = value - level;
                (sum, x, y) = (sum + value, x + value * u as f64, y + value * v as f64);
            }
        }
    }
    [(x, columns), (y, rows)].map(|(moment, size)| {
        let offset = moment / sum - (size / 2) as f64;
        // A centroid beyond the frame means that the sums have overflowed.
        if (3.0..size as f64).contains(&offset.abs()) { offset.round() as i64 } else { 0 }
    })
}

/// Copies the `size` pixels a side about the axis, moved by the shift in `prepared`, into its data,
/// and their variance `floor` into its floor (infinite for bad pixels; pixels outside the frame are
/// bad). Returns the number of bad pixels.
fn crop(frame: &SampledFrame, size: usize, floor: f64, prepared: &mut PreparedFrame) -> usize {
    let (rows, columns) = frame.data.dim();
    let [shift_x, shift_y] = prepared.shift_pixels;
    let from = |i: usize, full: usize, shift: i64| {
        let there = i as i64 + full as i64 / 2 - size as i64 / 2 + shift;
        (0..full as i64).contains(&there).then_some(there as usize)
    };
    let mut bad_pixels = 0;
    let lines = prepared.exposure.data_e.chunks_exact_mut(size).zip(prepared.floor_variance_e2.chunks_exact_mut(size));
    for (v, (data, floor_variance)) in lines.enumerate() {
        let row = from(v, rows, shift_y);
        if let Some(whole) = row.zip(from(0, columns, shift_x)).and_then(|at| frame.good_stretch(at, size)) {
            data.copy_from_slice(whole);
            floor_variance.fill(floor);
            continue;
        }
        for (u, (data, floor_variance)) in data.iter_mut().zip(floor_variance).enumerate() {
            let there = row.zip(from(u, columns, shift_x));
            *data = there.map_or(0.0, |at| frame.data[at]);
            let bad = there.is_none_or(|at| frame.is_bad(at));
            *floor_variance = if bad { f64::INFINITY } else { floor };
            bad_pixels += usize::from(bad);
        }
    }
    bad_pixels
}

/// Sets the first weights of cropped data, and the treatment of flux and background. A pixel has
/// `area` native pixels.
fn weigh(prepared: &mut PreparedFrame, recipe: &Recipe, area: f64) {
    let PreparedFrame { exposure: Exposure { data_e, weight, photometry }, floor_variance_e2: floor, .. } = prepared;
    match recipe.weighting {
        Weighting::Noise => {
            for ((weight, d), floor) in weight.iter_mut().zip(data_e.iter()).zip(floor.iter()) {
                // The datum is a poor estimate of its variance where few photons are expected: at
                // least that of one electron.
                *weight = 1.0 / (d.max(0.0) + floor.max(area));
            }
        }
        Weighting::None => {
            let good = data_e.iter().zip(floor.iter()).filter(|(_, floor)| floor.is_finite());
            let brightest = good.fold(0.0f64, |m, (&d, _)| m.max(d));
            // Scaled by the brightest pixel, so that a tolerance means the same for a bright and
            // for a faint star.
            let scale = 1.0 / (brightest * brightest);
            weight.iter_mut().zip(floor.iter()).for_each(|(weight, floor)| {
                *weight = if floor.is_finite() { scale } else { 0.0 };
            });
        }
    }
    *photometry = match (recipe.fit_flux, recipe.fit_background) {
        (true, true) => Photometry::FitBoth,
        (true, false) => Photometry::FitFlux { background_e: 0.0 },
        (false, _) => Photometry::Fixed { flux_e: ArrayView1::from(&*data_e).sum(), background_e: 0.0 },
    };
}

#[cfg(test)]
mod tests;
