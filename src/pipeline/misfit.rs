//! Likely cause of a misfit, from the structure of an image and of its residual: saturated pixels, a second star, another plate
//! scale.

use super::modal_task::ModalTask;
use crate::modal::{self, Cube, DiversityProjection, FittedImage, ModalEstimate, Model};
use crate::modes::Group;
use crate::{Error, Result};
use ndarray::{Array2, ArrayView2, Axis};

/// Part of the largest value from which a pixel counts as being at the top.
const TOP: f64 = 0.995;
/// Fewest pixels at the top of a saturated image: noise and a peak between pixels make one or two.
const SATURATED_PIXELS: usize = 4;
/// Least separation of a second star, model pixels: closer ones look like aberrations.
const LEAST_SEPARATION: usize = 3;
/// Part of the residual's χ² that a displaced copy of the model must explain.
const EXPLAINED_BY_COPY: f64 = 0.4;
/// Products in the search for a copy; larger images are searched on every second pixel, or third.
const MAX_PRODUCTS: usize = 20_000_000;

/// Largest part of χ² beyond 1 that may be left where another plate scale is the cause. A plate scale that is 1 to 10 % wrong leaves
/// 0.2 % at most (Keck and seven hexagons, peak S/N of 50 to 1,000). Of saturation, companions of 1 and 5 %, a non-linear
/// detector (10 %), a gradient, another obscuration, spiders, a filter of 5 %, square pixels and unmodelled aberrations it leaves
/// 89 % or more, of gaps of 3 cm in place of 3 mm 52 %.
const LEFT_BY_PLATE_SCALE: f64 = 0.1;
/// Largest change of the plate scale that is tried, as a fraction: the fit reaches a few per cent beyond.
const LARGEST_CHANGE: f64 = 0.25;
/// Largest side of a frame for which another plate scale is tried, pixels: it is fitted without reducing the image, some ten times.
const MAX_TRIED_PIXELS: usize = 512;

/// An image that the model does not explain.
pub(super) struct Case<'a> {
    pub(super) task: ModalTask<'a>,
    /// Its number, from 0.
    pub(super) image: usize,
    pub(super) model: &'a Model,
    /// Projection of the diversity on the modes of the model.
    pub(super) diversity: &'a DiversityProjection,
}

impl Case<'_> {
    /// The cause that the image shows, as a sentence; `None` where it shows none.
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    pub(super) fn likely_cause(&self, found: &ModalEstimate) -> Result<Option<String>> {
        let frame_e = self.task.images.images_e.index_axis(Axis(0), self.image);
        let bad = self.task.images.bad.index_axis(Axis(0), self.image);
        // Detector pixels along a side of a model pixel.
        let native = self.model.preparation.native_along(0);
        let cause = match shown_by_residual(&found.compared, frame_e, bad, native) {
            Some(cause) => Some(cause),
            None => self.plate_scale(found)?,
        };
        Ok(cause.map(|cause| format!("likely cause of the residual of image {}: {cause}", self.image + 1)))
    }

    /// Another plate scale with which the model explains the image.
    fn plate_scale(&self, found: &ModalEstimate) -> Result<Option<String>> {
        let only = self.image..self.image + 1;
        let images_e = self.task.images.images_e.slice(ndarray::s![only.clone(), .., ..]);
        let bad = self.task.images.bad.slice(ndarray::s![only, .., ..]);
        let (_, rows, columns) = images_e.dim();
        let is_tried = self.task.policy.fit_optics
            && self.task.scene.estimate.fit_optics.is_empty()
            && found.images[self.image].reduced_chi2 > 1.0;
        if !is_tried || rows.max(columns) > MAX_TRIED_PIXELS {
            return Ok(None);
        }
        // A scene that fits no optics, as one with the paper's optimiser, is not tried.
        let Ok(scene) = self.task.scene.with(&[("estimate.fit_optics", "[\"plate-scale\"]")]) else { return Ok(None) };
        let cube = Cube { images_e, bad, read_noise_e: self.task.images.read_noise_e };
        let (recipe, flag) = (self.task.policy.recipe(&scene), Some(self.task.control.flag()));
        let factor = 1.0 + self.fitted_diversity(found).clamp(-LARGEST_CHANGE, LARGEST_CHANGE);
        let fitted = modal::explaining_fit(&scene, &recipe, self.task.cache, cube, factor, flag);
        let (fitter, [own_chi2, fitted_chi2]) = match fitted {
            Ok(Some(found)) => found,
            Err(error @ Error::Interrupted(_)) => return Err(error),
            // A trial that fails names no cause.
            Ok(None) | Err(_) => return Ok(None),
        };
        let [optic] = fitter.fitted_optics() else { return Ok(None) };
        let left = (fitted_chi2 - 1.0).max(0.0) / (own_chi2 - 1.0);
        Ok((optic.is_identifiable() && left < LEFT_BY_PLATE_SCALE).then(|| {
            format!(
                "the plate scale: with {} = {:.4} in place of {} its reduced χ² is {fitted_chi2:.2} in place of {own_chi2:.2}; \
                 estimate.fit_optics = [\"plate-scale\"] fits it (another wavelength or size of the pupil has the same effect)",
                optic.key(),
                optic.value,
                optic.scene
            )
        }))
    }

    /// The diversity that was fitted as NCPA, as a fraction of the scene's diversity: Σ A·w·d / Σ A·d², with w the NCPA, d the
    /// diversity and A the amplitude.
    ///
    /// The spot of a diversity d has the shape of d's gradient, so a spot that is larger by a fraction than the scene's plate
    /// scale says is fitted as that fraction of d. Of Keck's defocus of 1.5 waves a plate scale that is 5, 10 and 20 % wrong
    /// leaves 4.0, 8 and 16 %: what remains is within the reach of the fit.
    fn fitted_diversity(&self, found: &ModalEstimate) -> f64 {
        let Self { model, diversity, .. } = self;
        if !diversity.is_spanned() {
            return 0.0;
        }
        let map_nm = model.map_nm(diversity.coefficients_nm.as_slice().unwrap_or_default(), Group::Ncpa);
        let (mut product, mut square) = (0.0, 0.0);
        for ((ncpa_nm, diversity_nm), amplitude) in
            found.ncpa_nm.iter().zip(&map_nm).zip(&model.telescope.pupil.amplitude)
        {
            // NaN outside the pupil.
            if diversity_nm.is_finite() {
                product += amplitude * ncpa_nm * diversity_nm;
                square += amplitude * diversity_nm * diversity_nm;
            }
        }
        if square > 0.0 { product / square } else { 0.0 }
    }
}

/// A cause that an image and its residual show, as a sentence's end. `frame_e` is the detector frame, `native` the number of its
/// pixels along a side of a model pixel.
fn shown_by_residual(
    fitted: &FittedImage,
    frame_e: ArrayView2<f64>,
    bad: ArrayView2<bool>,
    native: f64,
) -> Option<String> {
    saturation(fitted, frame_e, bad).or_else(|| second_star(fitted, native))
}

/// Several pixels at one largest value, where the model has a peak.
fn saturation(fitted: &FittedImage, frame_e: ArrayView2<f64>, bad: ArrayView2<bool>) -> Option<String> {
    let good = || frame_e.iter().zip(&bad).filter(|(electrons, bad)| !**bad && electrons.is_finite());
    let largest = good().map(|(electrons, _)| *electrons).fold(f64::MIN, f64::max);
    let top = good().filter(|(electrons, _)| **electrons >= TOP * largest).count();
    let peak = fitted.model_e.iter().copied().fold(f64::MIN, f64::max);
    let expected = fitted.model_e.iter().filter(|electrons| **electrons >= TOP * peak).count();
    (largest > 0.0 && top >= SATURATED_PIXELS + 3 * expected.saturating_sub(1)).then(|| {
        format!(
            "{top} pixels are at the largest value, {largest:.0} e⁻, where one peak is expected: the detector is saturated; mark \
             such pixels as bad (BADPIX or --mask), or expose for a shorter time"
        )
    })
}

/// A copy of the model in the residual.
fn second_star(fitted: &FittedImage, native: f64) -> Option<String> {
    let size = fitted.model_e.nrows();
    let floor = fitted.model_e.iter().copied().fold(f64::MAX, f64::min);
    let star = fitted.model_e.mapv(|electrons| electrons - floor);
    let residual = &fitted.data_e - &fitted.model_e;
    // Inverse variances; 0 for bad pixels and where the residual is 0, which explains nothing.
    let weight = Array2::from_shape_fn(residual.dim(), |at| {
        let ratio = fitted.residual_sigma[at] / residual[at];
        if ratio.is_finite() { ratio * ratio } else { 0.0 }
    });
    let reach = (size / 3) as isize;
    let shifts = (2 * reach + 1).pow(2) as usize;
    let stride = (1..).find(|stride| (size / stride).pow(2) * shifts <= MAX_PRODUCTS).unwrap_or(1);
    // Amplitude of a copy at a shift, and the χ² that it explains.
    let copy = |dy: isize, dx: isize, stride: usize| {
        let (mut product, mut norm) = (0.0, 0.0);
        let inside = |at: usize, shift: isize| usize::try_from(at as isize - shift).ok().filter(|at| *at < size);
        for y in (0..size).step_by(stride) {
            let Some(v) = inside(y, dy) else { continue };
            for x in (0..size).step_by(stride) {
                let Some(u) = inside(x, dx) else { continue };
                let weighted = weight[[y, x]] * star[[v, u]];
                if weighted > 0.0 {
                    product += weighted * residual[[y, x]];
                    norm += weighted * star[[v, u]];
                }
            }
        }
        if norm > 0.0 && product > 0.0 { (product / norm, product * product / norm) } else { (0.0, 0.0) }
    };
    let is_apart = |dy: isize, dx: isize| dy * dy + dx * dx >= (LEAST_SEPARATION * LEAST_SEPARATION) as isize;
    let best = |ys: std::ops::RangeInclusive<isize>, xs: std::ops::RangeInclusive<isize>, stride: usize| {
        let pairs = ys.flat_map(|dy| xs.clone().map(move |dx| (dy, dx))).filter(|&(dy, dx)| is_apart(dy, dx));
        let found = pairs.map(|(dy, dx)| (copy(dy, dx, stride), dy, dx));
        found.max_by(|a, b| a.0.1.total_cmp(&b.0.1))
    };
    let (_, dy, dx) = best(-reach..=reach, -reach..=reach, stride)?;
    let ((contrast, explained), dy, dx) = best(dy - 1..=dy + 1, dx - 1..=dx + 1, 1)?;
    let whole: f64 = fitted.residual_sigma.iter().filter(|sigma| sigma.is_finite()).map(|sigma| sigma * sigma).sum();
    (explained > EXPLAINED_BY_COPY * whole).then(|| {
        let (x, y) = (dx as f64 * native, dy as f64 * native);
        format!(
            "{:.0} % of it is a copy of the star's image with {contrast:.2} of its flux or more, {:.0} pixels away ({x:.0} along x, {y:.0} \
             along y): a second star; mark its pixels as bad (BADPIX or --mask), or take another star",
            100.0 * explained / whole,
            x.hypot(y)
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spot(y: usize, x: usize, centre: (f64, f64)) -> f64 {
        let (v, u) = (y as f64 - centre.0, x as f64 - centre.1);
        1e4 * (-(u * u + v * v) / 8.0).exp() * (1.0 + 0.5 * (0.9 * u + 0.4 * v).sin())
    }

    fn cause(image: impl Fn(usize, usize) -> f64) -> Option<String> {
        let data_e = Array2::from_shape_fn((32, 32), |(y, x)| image(y, x) + 3.0 * ((7 * x + 13 * y) as f64).sin());
        let model_e = Array2::from_shape_fn((32, 32), |(y, x)| spot(y, x, (16.0, 16.0)));
        let residual_sigma =
            Array2::from_shape_fn((32, 32), |at| (data_e[at] - model_e[at]) / (model_e[at] + 100.0).sqrt());
        let fitted = FittedImage { data_e: data_e.clone(), model_e, residual_sigma };
        shown_by_residual(&fitted, data_e.view(), Array2::from_elem((32, 32), false).view(), 2.0)
    }

    #[test]
    fn saturation_and_a_second_star_are_named_and_nothing_else() {
        let one = |y, x| spot(y, x, (16.0, 16.0));
        assert_eq!(cause(one), None);
        assert_eq!(cause(|y, x| 1.1 * one(y, x)), None);
        let clipped = cause(|y, x| if one(y, x) > 6000.0 { 6000.0 } else { one(y, x) }).unwrap();
        assert!(clipped.contains("saturated"), "{clipped}");
        let double = cause(|y, x| one(y, x) + 0.2 * spot(y, x, (20.0, 9.0))).unwrap();
        assert!(double.contains("0.20 of its flux or more") && double.contains("(-14 along x, 8 along y)"), "{double}");
    }
}
