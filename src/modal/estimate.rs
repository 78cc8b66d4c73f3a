//! Modal estimate of a cube of images: every image fitted, outlier pixels rejected, wrong minima restarted, images combined.

use super::combine::{self, Combination, ModalEstimate};
use super::cube::Cube;
use super::engine::{FitState, ImageFit, Watch};
use super::fitter::ModalFitter;
use super::minimum::Minimum;
use super::prepare::{Frame, Prepared, Refusal};
use super::status::{self, ImageReport, Status};
use crate::imaging::{Chain, Precision};
use crate::optimize::CancelFlag;
use crate::scene::Combine;
use crate::{Error, Result};
use ndarray::{Array2, ArrayView1, ArrayView3};

/// What [`ModalFitter::fit_each`] found.
#[derive(Debug, Clone)]
pub struct EachImage {
    /// `[image, mode]`, nm, pistons about their mean over the pupil; NaN for images that cannot be used.
    pub coefficients_nm: Array2<f64>,
    /// One report per image, in order.
    pub reports: Vec<ImageReport>,
}

/// The minima of a cube.
pub(super) struct Fitted {
    /// Why an image could not be used, for each.
    pub(super) refused: Vec<Option<Refusal>>,
    /// The images that could.
    pub(super) indices: Vec<usize>,
    pub(super) prepared: Vec<Prepared>,
    pub(super) minima: Vec<Minimum>,
}

impl Fitted {
    fn from_fits(fits: Vec<ImageFit>) -> Self {
        let mut fitted = Self { refused: Vec::new(), indices: Vec::new(), prepared: Vec::new(), minima: Vec::new() };
        for (image, fit) in fits.into_iter().enumerate() {
            let refused = match fit.state {
                FitState::Refused(refusal) => Some(refusal),
                FitState::NotBegun | FitState::Fitted => None,
            };
            fitted.refused.push(refused);
            if fit.is_fitted() {
                fitted.indices.push(image);
                fitted.prepared.push(fit.prepared);
                fitted.minima.push(fit.minimum);
            }
        }
        fitted
    }
}

impl ModalFitter {
    /// Estimates the static wavefront behind a cube of images (`[image, y, x]`, electrons) on `chain`.
    ///
    /// Images that cannot be used are reported with their reason and left out. `watch` is told how many images are done.
    ///
    /// # Errors
    /// [`Error::Image`] where no image can be used, [`Error::Shape`] where they have another size than the scene says,
    /// [`Error::Interrupted`] where `cancel` went up, [`Error::Device`] where the device failed.
    pub fn estimate(
        &self,
        chain: &mut Chain,
        images_e: ArrayView3<f64>,
        bad: ArrayView3<bool>,
        read_noise_e: Option<f64>,
        cancel: Option<&CancelFlag>,
        watch: &mut Watch,
    ) -> Result<ModalEstimate> {
        let started = std::time::Instant::now();
        let cube = Cube { images_e, bad, read_noise_e };
        let Fitted { refused, indices, prepared, minima } = self.fitted(chain, cube, cancel, watch)?;
        let mut estimate = combine::combine(self, refused, &indices, &prepared, minima)?;
        estimate.seconds = started.elapsed().as_secs_f64();
        estimate.device = chain.device_name();
        estimate.device_failure = chain.failure().map(str::to_owned);
        estimate.precision = match chain.precision() {
            Precision::F32 => "f32",
            Precision::F64 => "f64",
        };
        Ok(estimate)
    }

    /// What each image of a cube (`[image, y, x]`, electrons) says by itself, on `chain`: no combination, no error bars
    /// and no maps, which take longer than the fits.
    ///
    /// # Errors
    /// As [`ModalFitter::estimate`].
    pub fn fit_each(
        &self,
        chain: &mut Chain,
        cube: Cube,
        cancel: Option<&CancelFlag>,
        watch: &mut Watch,
    ) -> Result<EachImage> {
        let Fitted { refused, indices, prepared, minima } = self.fitted(chain, cube, cancel, watch)?;
        let mut coefficients_nm = Array2::from_elem((refused.len(), self.model.optics.modes()), f64::NAN);
        let mut reports: Vec<ImageReport> =
            refused.into_iter().map(|refusal| status::unfitted(refusal.map_or(Status::Ok, Status::Unusable))).collect();
        for ((&image, mut minimum), report) in
            indices.iter().zip(minima.iter().cloned()).zip(status::judged(self, &prepared, &minima))
        {
            self.pistons.centre(&mut minimum.coefficients_nm);
            coefficients_nm.row_mut(image).assign(&ArrayView1::from(&minimum.coefficients_nm));
            reports[image] = report;
        }
        Ok(EachImage { coefficients_nm, reports })
    }

    /// Prepares and fits every image: outlier pixels rejected, fits in a wrong minimum restarted, as the recipe says.
    pub(super) fn fitted(
        &self,
        chain: &mut Chain,
        cube: Cube,
        cancel: Option<&CancelFlag>,
        watch: &mut Watch,
    ) -> Result<Fitted> {
        let read_noise_e = cube.read_noise_e.unwrap_or(self.scene.image.read_noise_e);
        let preparation = self.model.preparation;
        let pairs = cube.images_e.outer_iter().zip(cube.bad.outer_iter());
        let frames: Vec<Frame> = pairs.map(|(data_e, bad)| Frame { data_e, bad, read_noise_e }).collect();
        frames.iter().try_for_each(|frame| preparation.checked(*frame))?;
        let task = self.task(cancel);
        let mut fits = vec![ImageFit::new(&preparation, self.model.optics.modes()); frames.len()];
        self.fit_frames(chain, &task, &frames, &mut fits, watch)?;
        if !fits.iter().any(ImageFit::is_fitted) {
            let refused = fits.iter().find_map(|fit| match fit.state {
                FitState::Refused(refusal) => Some(refusal.to_string()),
                FitState::NotBegun | FitState::Fitted => None,
            });
            return Err(Error::Image(refused.unwrap_or_else(|| "there is no image to estimate from".into())));
        }
        let cleaned = self.reject_outliers(chain, &task, &frames, &mut fits)?;
        self.restart(chain, &task, (&frames, &cleaned), &mut fits)?;
        Ok(Fitted::from_fits(fits))
    }

    /// Combines some images of `estimate` (which this estimator made) anew, without fitting them again: for a study of
    /// the number of images, or another way to combine them.
    ///
    /// The images are taken as if there were no others, by the rules of [`Combine`] and [`Status`]; only the error bars
    /// of fewer than eight are those of the whole estimate's scatter, over the root of their number.
    ///
    /// # Errors
    /// [`Error::Value`] for an image that is not there, [`Error::Image`] where none of them was fitted, [`Error::Shape`]
    /// for an estimate of another model.
    pub fn combine_subset(&self, estimate: &ModalEstimate, images: &[usize], how: Combine) -> Result<Combination> {
        combine::subset(self, estimate, images, how)
    }
}
