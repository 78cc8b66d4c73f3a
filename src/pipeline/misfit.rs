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
        let cause = match saturation(&found.compared, frame_e, bad) {
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
            key: one.key(),
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
            .or_else(|| shape(&fitted, 2.0, Array2::zeros((0, 1024))))
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
