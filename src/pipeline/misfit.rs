//! Likely cause of a misfit, from the structure of an image and of its residual: saturated pixels,
//! a second star, a non-linear detector, a blur, another plate scale.

use super::modal_task::ModalTask;
use super::residual_shape::Residual;
use crate::imaging::CpuChain;
use crate::modal::{self, Cube, DiversityProjection, FittedImage, ModalEstimate, Model};
use crate::modes::Group;
use crate::scene::{Optic, Scene, rounded};
use crate::{Error, Result};
use ndarray::{Array2, ArrayView2, Axis};

/// Part of the largest value from which a pixel has that value, but for its rounding to single
/// precision. A saturated detector gives one value; a flat top within its noise does not.
pub(super) const TOP: f64 = 1.0 - 1e-6;
/// Part of the model's peak from which a pixel of whole counts may have one value with it.
const FLAT: f64 = 0.995;
/// Fewest pixels at the top of a saturated image: noise and a peak between pixels make one or two.
const SATURATED_PIXELS: usize = 4;
/// Part of the excess of χ² that a shape of the residual must explain. The right one explains 95 %
/// or more of companions of 1 and 33 %, of a response that falls by 2 % and of square pixels, 60 %
/// of a filter of 1.5 % taken for none; of all other faults among the hard cases (tilts,
/// reflectivities, NCPA of high order, shadows, rotation, another telescope) no shape explains more
/// than 16 %; of a plate scale that is 5 % wrong a blur explains 53 %.
const EXPLAINED_BY_SHAPE: f64 = 0.5;
/// Largest variance of a pixel of little light, relative to the smallest, and fewest of them: with
/// 400 the noise is known to 4 %.
const MOST_DARK: f64 = 3.0;
const FEWEST_DARK: usize = 400;
/// Least χ² of such pixels, and part of the excess of all that it must explain: 72 % in a sum of
/// eight frames at a peak S/N of 1,400, where the model's own errors are the rest. Noise has no
/// correlation between neighbours (0.02 and 0.04 there); what the model lacks has.
const LEAST_NOISE: f64 = 1.3;
const EXPLAINED_BY_NOISE: f64 = 0.5;
const MOST_CORRELATED: f64 = 0.2;
/// Most derivatives that are held, 160 MB; shapes of the residual of a larger model are compared
/// with what the modes absorb of them.
const MAX_DERIVATIVES: usize = 20_000_000;

/// Largest part of χ² beyond 1 that may be left where an optical parameter is the cause. A plate
/// scale that is 1 to 10 % wrong leaves 0.2 % at most (Keck and seven hexagons, peak S/N of 50 to
/// 1,000). Of saturation, companions of 1 and 5 %, a non-linear detector (10 %), a gradient,
/// another obscuration, spiders, a filter of 5 %, square pixels and unmodelled aberrations it
/// leaves 89 % or more, of gaps of 3 cm in place of 3 mm 52 %.
const LEFT_BY_OPTIC: f64 = 0.1;
/// Largest change of an optical parameter that is tried, as a fraction: the fit reaches a few per
/// cent beyond.
const LARGEST_CHANGE: f64 = 0.25;
/// Largest side of a frame for which another value is tried, pixels: it is fitted without reducing
/// the image, some ten times.
const MAX_TRIED_PIXELS: usize = 512;

/// An image that the model does not explain.
pub(super) struct Case<'a> {
    pub(super) task: ModalTask<'a>,
    /// Its number, from 0.
    pub(super) image: usize,
    pub(super) model: &'a Model,
    /// Reference chain of the model.
    pub(super) chain: &'a CpuChain<f64>,
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
        // Another plate scale is a cause only where it explains nearly all. It comes before the
        // shapes of the residual, one of which may explain half of the residual of a wrong plate
        // scale.
        let area = self.model.preparation.native_pixels();
        let stated_e = self.task.images.read_noise_e.or(self.task.scene.image.read_noise_e);
        let noise = || stated_e.and_then(|stated_e| understated_noise(&found.compared, stated_e, area));
        let cause = match saturation(&found.compared, frame_e, bad).or_else(noise) {
            Some(cause) => Some(cause),
            None => match self.other_optic(found)? {
                Some(other) => Some(other.sentence(self.task.scene)),
                None => shape(&found.compared, native, self.derivatives(found)),
            },
        };
        Ok(cause.map(|cause| format!("likely cause of the residual of image {}: {cause}", self.image + 1)))
    }

    /// Residual of the image under the model.
    pub(super) fn residual(&self, found: &ModalEstimate) -> Option<Residual> {
        Residual::new(&found.compared, self.model.preparation.native_along(0), self.derivatives(found))
    }

    /// Derivatives of the image by the fitted modes, `[mode, pixel]`; none of a model that is too
    /// large.
    fn derivatives(&self, found: &ModalEstimate) -> Array2<f64> {
        let linear = self.chain.linearise(found.image_coefficients_nm.row(self.image));
        let (modes, pixels) = (linear.unknowns(), linear.pixels());
        if modes * pixels * pixels > MAX_DERIVATIVES {
            return Array2::zeros((0, pixels * pixels));
        }
        let mut derivatives = Array2::zeros((modes, pixels * pixels));
        linear.derivatives(0..pixels, derivatives.view_mut());
        derivatives
    }

    /// An optical parameter with another value of which the model explains the image.
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    pub(super) fn other_optic(&self, found: &ModalEstimate) -> Result<Option<OtherOptic>> {
        for (optic, same_effect) in Optic::all().filter_map(|optic| Some((optic, optic.as_cause()?))) {
            if let Some(other) = self.with_other(optic, same_effect, found)? {
                return Ok(Some(other));
            }
        }
        Ok(None)
    }

    fn with_other(&self, optic: Optic, same_effect: &'static str, found: &ModalEstimate) -> Result<Option<OtherOptic>> {
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
        let fitting = self.task.scene.system().with(|sections| sections.estimate.fit_optics = vec![optic]);
        let Ok(scene) = fitting else { return Ok(None) };
        let cube = Cube { images_e, bad, read_noise_e: self.task.images.read_noise_e };
        let (recipe, control) = (self.task.policy.recipe(&scene), self.task.control);
        let factor = 1.0 + self.fitted_diversity(found).clamp(-LARGEST_CHANGE, LARGEST_CHANGE);
        let fitted = modal::explaining_fit(&scene, &recipe, self.task.cache, cube, factor, control);
        let (fitter, [own_chi2, fitted_chi2]) = match fitted {
            Ok(Some(found)) => found,
            Err(error @ Error::Interrupted(_)) => return Err(error),
            // A trial that fails names no cause.
            Ok(None) | Err(_) => return Ok(None),
        };
        let [one] = fitter.fitted_optics() else { return Ok(None) };
        let left = (fitted_chi2 - 1.0).max(0.0) / (own_chi2 - 1.0);
        let explains = one.is_identifiable() && left < LEFT_BY_OPTIC;
        Ok(explains.then(|| OtherOptic {
            optic,
            same_effect,
            key: one.key.clone(),
            fitted: one.value,
            of_scene: one.scene,
            reduced_chi2: [own_chi2, fitted_chi2],
        }))
    }

    /// The diversity that was fitted as NCPA, as a fraction of the scene's diversity: Σ A·w·d / Σ
    /// A·d², with w the NCPA, d the diversity and A the amplitude.
    ///
    /// The spot of a diversity d has the shape of d's gradient, so a spot that is larger by a
    /// fraction than the scene's plate scale says is fitted as that fraction of d. Of Keck's
    /// defocus of 1.5 waves a plate scale that is 5, 10 and 20 % wrong leaves 4.0, 8 and 16 %: what
    /// remains is within the reach of the fit.
    fn fitted_diversity(&self, found: &ModalEstimate) -> f64 {
        let Self { model, diversity, .. } = self;
        if !diversity.is_spanned() {
            return 0.0;
        }
        let map_nm = model.map_nm(diversity.coefficients_nm.as_slice().unwrap_or_default(), Group::Ncpa);
        let (mut product, mut square) = (0.0, 0.0);
        for ((ncpa_nm, diversity_nm), amplitude) in
            found.combined.maps.ncpa_nm.iter().zip(&map_nm).zip(&model.telescope.pupil.amplitude)
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

/// An optical parameter with another value, which explains an image.
pub(super) struct OtherOptic {
    pub(super) optic: Optic,
    /// What else does.
    same_effect: &'static str,
    key: String,
    /// In the unit of the key.
    pub(super) fitted: f64,
    of_scene: f64,
    /// Reduced χ² of the image with the scene's and with the fitted one.
    reduced_chi2: [f64; 2],
}

impl OtherOptic {
    /// The end of a sentence, in the terms of `scene`.
    fn sentence(&self, scene: &Scene) -> String {
        let (key, fitted) = scene.own_form(&self.key, self.fitted);
        let (_, of_scene) = scene.own_form(&self.key, self.of_scene);
        let [own_chi2, fitted_chi2] = self.reduced_chi2;
        let (name, word, same_effect) = (self.optic.name(), self.optic.word(), self.same_effect);
        format!(
            "the {name}: with {key} = {fitted:.4} in place of {} its reduced χ² is {fitted_chi2:.2} in place of {own_chi2:.2}; \
             estimate.fit_optics = [\"{word}\"] fits it ({same_effect})",
            rounded(of_scene)
        )
    }
}

/// A shape that explains the residual, as a sentence's end. `native` is the number of detector
/// pixels along a side of a model pixel, `derivatives` those of the image by the fitted modes.
fn shape(fitted: &FittedImage, native: f64, derivatives: Array2<f64>) -> Option<String> {
    let shape = Residual::new(fitted, native, derivatives)?.shape();
    shape.filter(|shape| shape.share > EXPLAINED_BY_SHAPE).map(|shape| shape.sentence)
}

/// A read noise that is larger than `stated_e`, where that explains the residual: of pixels of
/// little light, as noise without correlation, and of all. A model pixel is `area` of the detector.
fn understated_noise(fitted: &FittedImage, stated_e: f64, area: f64) -> Option<String> {
    let residual = &fitted.residual_sigma;
    let variance_e2 = |at: (usize, usize)| ((fitted.data_e[at] - fitted.model_e[at]) / residual[at]).powi(2);
    let known = residual.indexed_iter().filter(|(_, sigma)| sigma.is_finite() && **sigma != 0.0).map(|(at, _)| at);
    let known: Vec<((usize, usize), f64)> = known.map(|at| (at, variance_e2(at))).collect();
    let floor_e2 = known.iter().map(|(_, variance_e2)| *variance_e2).fold(f64::INFINITY, f64::min);
    let dark: Vec<_> = known.iter().filter(|(_, variance_e2)| *variance_e2 < MOST_DARK * floor_e2).collect();
    if dark.len() < FEWEST_DARK {
        return None;
    }
    // With `times` the floor a pixel has χ² = 1 + (times − 1) floor/variance: by least squares.
    let share = |variance_e2: f64| floor_e2 / variance_e2;
    let excess = |at: (usize, usize)| residual[at].powi(2) - 1.0;
    let (along, square) = dark.iter().fold((0.0, 0.0), |(along, square), (at, variance_e2)| {
        (along + share(*variance_e2) * excess(*at), square + share(*variance_e2).powi(2))
    });
    let times = 1.0 + along / square;
    let correlation = |[down, right]: [usize; 2]| {
        let beside =
            dark.iter().filter_map(|&&((y, x), _)| Some((residual[(y, x)], *residual.get((y + down, x + right))?)));
        let (products, squares) = beside
            .filter(|(_, other)| other.is_finite())
            .fold((0.0, 0.0), |sums, (one, other)| (sums.0 + one * other, sums.1 + one * one));
        products / squares
    };
    let is_white = [[0, 1], [1, 0]].into_iter().all(|other| correlation(other).abs() < MOST_CORRELATED);
    let all = known.iter().map(|(at, _)| excess(*at)).sum::<f64>();
    let explained = known.iter().map(|(_, variance_e2)| (times - 1.0) * share(*variance_e2)).sum::<f64>();
    let is_it = times > LEAST_NOISE && is_white && explained > EXPLAINED_BY_NOISE * all;
    is_it.then(|| {
        let found_e = stated_e.hypot(((times - 1.0) * floor_e2 / area).sqrt());
        format!(
            "pixels of little light scatter by {:.2} times their noise: the read noise is {found_e:.2} e⁻ where {stated_e} are stated \
             (image.read_noise_e, or RON_E of the file)",
            times.sqrt()
        )
    })
}

/// Several pixels at one largest value, where the model has a peak.
pub(super) fn saturation(fitted: &FittedImage, frame_e: ArrayView2<f64>, bad: ArrayView2<bool>) -> Option<String> {
    let good = || frame_e.iter().zip(&bad).filter(|(electrons, bad)| !**bad && electrons.is_finite());
    let largest = good().map(|(electrons, _)| *electrons).fold(f64::MIN, f64::max);
    let top = good().filter(|(electrons, _)| **electrons >= TOP * largest).count();
    let peak = fitted.model_e.iter().copied().fold(f64::MIN, f64::max);
    let expected = fitted.model_e.iter().filter(|electrons| **electrons >= FLAT * peak).count();
    (largest > 0.0 && top >= SATURATED_PIXELS + 3 * expected.saturating_sub(1)).then(|| {
        format!(
            "{top} pixels are at the largest value, {largest:.0} e⁻, where one peak is expected: the detector is saturated; mark \
             such pixels as bad (BADPIX or --mask), or expose for a shorter time"
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
        cause_below(f64::INFINITY, image)
    }

    /// That of an image with noise by a detector that gives no more than `most_e`.
    fn cause_below(most_e: f64, image: impl Fn(usize, usize) -> f64) -> Option<String> {
        let noisy_e = |(y, x)| image(y, x) + 3.0 * ((7 * x + 13 * y) as f64).sin();
        let data_e = Array2::from_shape_fn((32, 32), |at| noisy_e(at).min(most_e));
        let spot = Array2::from_shape_fn((32, 32), |(y, x)| spot(y, x, (16.0, 16.0)));
        // With the flux of a fit, and noise a little below that stated.
        let model_e = &spot * ((&data_e * &spot).sum() / (&spot * &spot).sum());
        let residual_sigma = (&data_e - &model_e) / 2.5;
        let fitted = FittedImage { data_e: data_e.clone(), model_e, residual_sigma };
        saturation(&fitted, data_e.view(), Array2::from_elem((32, 32), false).view())
            .or_else(|| understated_noise(&fitted, 2.5, 1.0))
            .or_else(|| shape(&fitted, 2.0, Array2::zeros((0, 1024))))
    }

    #[test]
    fn a_read_noise_that_is_understated_is_named() {
        // A star's light, and pixels without any, of whose noise 1 to 3 times the deviation is
        // stated.
        let noise = |y: usize, x: usize| 2.0_f64.sqrt() * ((31 * y * y + 17 * x * y + 7 * x * x) as f64).sin();
        let cause = |times: f64, extra: &dyn Fn(usize, usize) -> f64| {
            let model_e = Array2::from_shape_fn((64, 64), |(y, x)| spot(y, x, (32.0, 32.0)));
            let sigma_e = model_e.mapv(|e| (100.0 + e).sqrt());
            let scatter_e = model_e.mapv(|e| (100.0 * times * times + e).sqrt());
            let at = |(y, x): (usize, usize)| scatter_e[(y, x)] * noise(y, x) + extra(y, x);
            let residual_e = Array2::from_shape_fn((64, 64), at);
            let residual_sigma = &residual_e / &sigma_e;
            understated_noise(&FittedImage { data_e: &model_e + &residual_e, model_e, residual_sigma }, 10.0, 1.0)
        };
        assert_eq!(cause(1.0, &|_, _| 0.0), None);
        let named = cause(3.0, &|_, _| 0.0).unwrap();
        assert!(named.contains("image.read_noise_e") && named.contains("where 10 are stated"), "{named}");
        let found_e = named.split("the read noise is ").nth(1).unwrap().split(' ').next().unwrap();
        assert!((found_e.parse::<f64>().unwrap() - 30.0).abs() < 1.0, "{named}");
        // Light that the model lacks is no noise.
        assert_eq!(cause(1.0, &|y, x| 30.0 * (0.3 * (y + x) as f64).sin()), None);
        assert_eq!(cause(1.0, &|y, x| 0.5 * spot(y, x, (30.0, 36.0))), None);
    }

    #[test]
    fn misfit_causes_are_named_without_false_alarms() {
        let one = |y, x| spot(y, x, (16.0, 16.0));
        assert_eq!(cause(one), None);
        assert_eq!(cause(|y, x| 1.1 * one(y, x)), None);
        let clipped = cause_below(6000.0, one).unwrap();
        assert!(clipped.contains("saturated"), "{clipped}");
        // A flat top within its noise is none.
        let flat = cause(|y, x| one(y, x).min(6000.0)).unwrap();
        assert!(!flat.contains("saturated"), "{flat}");
        let double = cause(|y, x| one(y, x) + 0.2 * spot(y, x, (20.0, 9.0))).unwrap();
        // Of the flux of the fit, which includes a part of the second star's.
        assert!(double.contains("0.199 of its flux") && double.contains("(-14 along x, 8 along y)"), "{double}");
        let peak = (0..1024).map(|at| one(at / 32, at % 32)).fold(0.0, f64::max);
        let curved = cause(|y, x| one(y, x) * (1.0 - 0.1 * one(y, x) / peak)).unwrap();
        // Of the flux of the fit, which is a few per cent less.
        let percent = curved.split("signal, ").nth(1).unwrap().split(' ').next().unwrap().parse::<f64>().unwrap();
        assert!(curved.contains("a non-linear detector") && (-12.0..-10.0).contains(&percent), "{curved}");
        // A weak column, gains of two halves, and levels of every other column.
        let weak = cause(|y, x| one(y, x) * if x == 13 { 0.6 } else { 1.0 }).unwrap();
        assert!(weak.contains("in some columns") && weak.contains("in that at -3 model pixels"), "{weak}");
        let halves = cause(|y, x| one(y, x) * if y >= 16 { 1.05 } else { 1.0 }).unwrap();
        assert!(halves.contains("in some rows"), "{halves}");
        let quadrant = cause(|y, x| one(y, x) * if y >= 16 && x >= 16 { 1.05 } else { 1.0 }).unwrap();
        assert!(quadrant.contains("a difference of gains"), "{quadrant}");
        let levels = cause(|y, x| one(y, x) + if x % 2 == 0 { 40.0 } else { 0.0 }).unwrap();
        assert!(levels.contains("a level of each column") && levels.contains("biases"), "{levels}");
        // The mean over nine neighbours.
        let neighbours = |y: usize, x: usize| {
            [(y, x - 1), (y, x), (y, x + 1)].map(|(y, x)| [one(y - 1, x), one(y, x), one(y + 1, x)])
        };
        let blurred =
            cause(|y, x| if y > 0 && x > 0 { neighbours(y, x).iter().flatten().sum::<f64>() / 9.0 } else { 0.0 })
                .unwrap();
        assert!(blurred.contains("a blur of "), "{blurred}");
    }
}
