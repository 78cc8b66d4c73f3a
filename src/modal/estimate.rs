//! Modal estimate of a cube of images: every image fitted, outlier pixels rejected, wrong minima
//! restarted, images combined.

pub(in crate::modal) mod image_fits;
pub(in crate::modal) mod scene_fitter;

use super::combine::{ModalEstimate, combine};
use super::fitter::ModalFitter;
use super::prepare::Frame;
use crate::control::{Control, Stage};
use crate::imaging::Chain;
use crate::modal::assess::status::Status;
use crate::modal::combine::pistons;
use crate::modal::combine::sequence::SEQUENCE;
use crate::modal::estimate::image_fits::{FittedCube, ImageFits};
use crate::modal::prepare::cube::Cube;
use crate::modal::prepare::outliers::CleanedFrame;
use crate::modal::solve::engine::{FitTask, ImageFit, reason_of_none};
use crate::modal::solve::fit_series::{FIRST, FitSeries, SeriesStep};
use crate::{Error, Result};
use std::time::Instant;

/// Estimate of some images, with the fitter that made it.
pub(crate) type ModalFit = (ModalFitter, ModalEstimate);

impl ModalFitter {
    /// Estimates the static wavefront behind a cube of images (`[image, y, x]`, electrons) on
    /// `chain`.
    ///
    /// Images that cannot be used are reported with their reason and left out.
    ///
    /// # Errors
    /// [`Error::Image`] where no image can be used, [`Error::Shape`] where they have another size
    /// than the scene says, [`Error::Interrupted`] where `control` was cancelled, [`Error::Device`]
    /// where the device failed.
    pub fn estimate(&self, chain: &mut Chain, cube: Cube, control: &Control) -> Result<ModalEstimate> {
        self.estimate_from(chain, cube, None, None, control)
    }

    /// As [`ModalFitter::estimate`]; with `start_nm` each image is fitted from there, and not
    /// restarted. Fits that `series` have are taken.
    ///
    /// # Errors
    /// As [`ModalFitter::estimate`].
    pub(crate) fn estimate_from(
        &self,
        chain: &mut Chain,
        cube: Cube,
        start_nm: Option<&[f64]>,
        series: Option<&mut FitSeries>,
        control: &Control,
    ) -> Result<ModalEstimate> {
        let started = Instant::now();
        // What the modes leave out does not depend on the images, and the fit of one image has one
        // thread.
        let mut left_out = Ok(());
        let fitted = rayon::in_place_scope(|scope| {
            scope.spawn(|_| left_out = self.left_out().map(drop));
            self.fit_all(chain, cube, start_nm, series, control)
        })?;
        left_out?;
        self.combined(chain, fitted, !self.scene.has_changing_wavefront(), started)
    }

    fn combined(&self, chain: &Chain, fitted: FittedCube, is_tested: bool, started: Instant) -> Result<ModalEstimate> {
        let mut estimate = combine(self, fitted, is_tested)?;
        estimate.seconds = started.elapsed().as_secs_f64();
        estimate.device = chain.device_name();
        estimate.device_failure = chain.failure().map(str::to_owned);
        estimate.precision = chain.precision();
        Ok(estimate)
    }

    /// Fits each image of a cube (`[image, y, x]`, electrons) on `chain`, without combination,
    /// error bars and maps, which take longer than the fits.
    ///
    /// # Errors
    /// As [`ModalFitter::estimate`].
    pub fn fit_each(&self, chain: &mut Chain, cube: Cube, control: &Control) -> Result<ImageFits> {
        Ok(self.fit_all(chain, cube, None, None, control)?.assess(self))
    }

    /// Prepares and fits every image as the recipe says: from `start_nm`, or else from the flat
    /// wavefront with restarts of fits in a wrong minimum; outlier pixels rejected. Fits that
    /// `series` have are taken, others added to them.
    pub(super) fn fit_all(
        &self,
        chain: &mut Chain,
        cube: Cube,
        start_nm: Option<&[f64]>,
        mut series: Option<&mut FitSeries>,
        control: &Control,
    ) -> Result<FittedCube> {
        let (frames, task) = (self.frames(&cube)?, self.task(control));
        let flat_nm = vec![0.0; self.model.optics.modes()];
        let start_of_all_nm = start_nm.unwrap_or(&flat_nm);
        let (mut fits, cleaned) = self.fit_cleaned(chain, &task, (&frames, start_of_all_nm), series.as_deref_mut())?;
        if !fits.iter().any(ImageFit::is_fitted) {
            return Err(Error::Image(reason_of_none(&fits)));
        }
        if start_nm.is_none() {
            self.restart(chain, &task, (&frames, &cleaned), &mut fits, series)?;
        }
        for fit in &mut fits {
            pistons::wrap_if_monochromatic(&mut fit.minimum.coefficients_nm, &flat_nm, &self.model);
        }
        Ok(FittedCube::from_fits(fits))
    }

    /// Adds the fits of the images `which` of a cube to `series`, which are of these images: as far
    /// as they depend on no other image. A fit of a sequence may be restarted, which is decided by
    /// all images: here it is where less than half of `which` misfit.
    ///
    /// # Errors
    /// As [`ModalFitter::estimate`], except that all images may be unusable.
    pub(crate) fn fit_series(
        &self,
        chain: &mut Chain,
        cube: Cube,
        which: &[usize],
        series: &mut FitSeries,
        control: &Control,
    ) -> Result<()> {
        let (all, task) = (self.frames(&cube)?, self.task(control));
        let frames: Vec<Frame> = which.iter().map(|image| all[*image]).collect();
        let flat_nm = vec![0.0; self.model.optics.modes()];
        let (mut fits, cleaned) = self.fit_cleaned(chain, &task, (&frames, &flat_nm), Some(&mut *series))?;
        let misfits = self.reports(&fits).iter().filter(|report| report.status != Status::Ok).count();
        if all.len() < SEQUENCE || 2 * misfits < fits.len() {
            self.restart(chain, &task, (&frames, &cleaned), &mut fits, Some(series))?;
        }
        Ok(())
    }

    /// Prepares and fits `frames` from `start_nm`, and rejects outlier pixels. Returns the cleaned
    /// frames of the fits that were replaced.
    fn fit_cleaned(
        &self,
        chain: &mut Chain,
        task: &FitTask,
        (frames, start_nm): (&[Frame], &[f64]),
        mut series: Option<&mut FitSeries>,
    ) -> Result<(Vec<ImageFit>, Vec<Option<CleanedFrame>>)> {
        let mut fit = ImageFit::new(&self.model.preparation, self.model.optics.modes());
        fit.start_nm.copy_from_slice(start_nm);
        let (mut fits, images) = (vec![fit; frames.len()], (0..frames.len()).collect::<Vec<_>>());
        let step = series.as_deref_mut().map(|series| SeriesStep { series, images: &images, step: FIRST });
        task.control.enter(Stage::Fitting, frames.len());
        self.fit_frames(chain, task, frames, &mut fits, step)?;
        task.control.enter(Stage::Combining, 0);
        let cleaned = self.reject_outliers(chain, task, frames, &mut fits, series)?;
        Ok((fits, cleaned))
    }

    /// The frames of `cube`.
    ///
    /// # Errors
    /// [`Error::Shape`] where they have another size than the scene says.
    pub(super) fn frames<'a>(&self, cube: &'a Cube) -> Result<Vec<Frame<'a>>> {
        let read_noise_e = cube.read_noise_e.or(self.scene.image.read_noise_e);
        let pairs = cube.images_e.outer_iter().zip(cube.bad.outer_iter());
        let frames: Vec<Frame> = pairs.map(|(data_e, bad)| Frame { data_e, bad, read_noise_e }).collect();
        frames.iter().try_for_each(|frame| self.model.preparation.check(*frame))?;
        Ok(frames)
    }
}
