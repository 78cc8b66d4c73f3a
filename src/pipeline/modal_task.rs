//! Modal fits of the images of one channel: by its scene, by an extension of it, and from another
//! start.

use super::consistency::Electrons;
use super::model_selection::Selected;
use super::policy::Policy;
use crate::Result;
use crate::control::{Control, Stage};
use crate::imaging::Chain;
use crate::modal::{self, Cube, FitSeries, ModalFit, ModalFitter, ModelCache, Recipe, Status};
use crate::scene::Scene;
use std::time::Instant;

/// What is fitted, and how.
#[derive(Clone, Copy)]
pub(super) struct ModalTask<'a> {
    pub(super) scene: &'a Scene,
    pub(super) policy: &'a Policy,
    pub(super) control: &'a Control,
    pub(super) cache: &'a ModelCache,
    pub(super) images: &'a Electrons<'a>,
}

/// Fit of the images of one channel.
pub(super) struct Fitted {
    /// The fitter, and what it found.
    pub(super) fit: ModalFit,
    /// The scene by which they were fitted, with the values of the optical parameters that were.
    pub(super) scene: Scene,
    /// The extension of the scene's model that explains the images, where there is one.
    pub(super) selected: Option<Selected>,
    /// Likely cause of a misfit, as a sentence.
    pub(super) cause: Option<String>,
    /// Reduced χ² of the differences of the images, where they are not explained.
    pub(super) changes: Option<f64>,
    pub(super) model_seconds: f64,
}

impl Fitted {
    /// Whether the model explains every image.
    pub(super) fn is_explained(&self) -> bool {
        *self.fit.1.status() == Status::Ok
    }
}

impl ModalTask<'_> {
    /// Fits the images by the model of the scene; fits that `series` have are taken.
    ///
    /// # Errors
    /// Those of [`modal::fitter_of`] and of [`ModalFitter::estimate`].
    pub(super) fn fit(&self, series: Option<&mut FitSeries>) -> Result<Fitted> {
        let started = Instant::now();
        self.control.enter(Stage::Preparing, 0);
        let fit = self.fit_by(self.scene, series)?;
        let model_seconds = started.elapsed().as_secs_f64() - fit.1.seconds;
        let scene = self.scene.adopting(fit.0.scene())?;
        Ok(Fitted { fit, scene, selected: None, cause: None, changes: None, model_seconds })
    }

    /// Fits the images again from `start_nm`, and keeps the fit that explains them better; whether
    /// that is the new one.
    ///
    /// # Errors
    /// Those of [`ModalFitter::estimate`].
    pub(super) fn improve(&self, fitted: &mut Fitted, start_nm: &[f64]) -> Result<bool> {
        let (fitter, before) = &fitted.fit;
        let mut chain = self.open(fitter)?;
        let control = &self.control.silent();
        let again = fitter.estimate_from(&mut chain, self.images.cube(), Some(start_nm), None, control)?;
        self.check()?;
        let (is_better, seconds) = (again.is_better_than(before), before.seconds + again.seconds);
        if is_better {
            fitted.fit.1 = again;
        }
        fitted.fit.1.seconds = seconds;
        Ok(is_better)
    }

    fn check(&self) -> Result<()> {
        self.control.check("the images were fitted, nothing was written")
    }

    /// The chain that fits the images by `fitter`.
    fn open(&self, fitter: &ModalFitter) -> Result<Chain> {
        let model = fitter.model();
        let estimate = &self.scene.estimate;
        // No more images than this are fitted at once.
        let capacity = self.images.len().min(model.tiles().images);
        Chain::open_shared(model.optics.clone(), estimate.device.into(), estimate.precision().into(), capacity)
    }

    /// Fit of all images by `scene`, which is that of the task or an extension of it; fits that
    /// `series` have are taken.
    pub(super) fn fit_by(&self, scene: &Scene, series: Option<&mut FitSeries>) -> Result<ModalFit> {
        let fitter = self.fitter(scene)?;
        let mut chain = self.begin(&fitter, self.images.len())?;
        let found = fitter.estimate_from(&mut chain, self.images.cube(), None, series, self.control)?;
        self.check()?;
        Ok((fitter, found))
    }

    /// Adds the fits of the images `which` to `series`, which are of these images.
    ///
    /// # Errors
    /// Those of [`ModalFitter::fit_series`].
    pub(super) fn fit_series(&self, which: &[usize], series: &mut FitSeries) -> Result<()> {
        self.control.enter(Stage::Preparing, 0);
        let fitter = self.fitter(self.scene)?;
        let mut chain = self.begin(&fitter, which.len())?;
        fitter.fit_series(&mut chain, self.images.cube(), which, series, self.control)?;
        self.check()
    }

    /// The fitter of all images by `scene`.
    fn fitter(&self, scene: &Scene) -> Result<ModalFitter> {
        modal::fitter_of(scene, self.policy.recipe(scene), self.cache, self.images.cube(), self.control)
    }

    /// The chain for fits of `count` images, which begin now.
    fn begin(&self, fitter: &ModalFitter, count: usize) -> Result<Chain> {
        self.control.check("the model was built, no image was fitted")?;
        fitter.model().check_images(count)?;
        self.open(fitter)
    }

    /// Fit of image `image` alone by `scene`; `None` where the optical parameters that the scene
    /// fits would not lower χ² enough in a first step.
    pub(super) fn fit_one(&self, scene: &Scene, image: usize) -> Result<Option<ModalFit>> {
        let cube = self.images.cube();
        let only = ndarray::s![image..=image, .., ..];
        let cube = Cube { images_e: cube.images_e.slice(only), bad: cube.bad.slice(only), ..cube };
        // A model that explains the image does so at its first minimum; restarts of the others
        // would take most of the time.
        let (recipe, control) = (Recipe { restarts: 0, ..self.policy.recipe(scene) }, &self.control.silent());
        let fitter = if scene.estimate.fit_optics.is_empty() {
            modal::fitter_for(scene, recipe, self.cache, cube)?
        } else {
            let explaining = modal::explaining_fit(scene, &recipe, self.cache, cube, 1.0, control)?;
            let Some((fitter, _)) = explaining else { return Ok(None) };
            fitter
        };
        let (optics, estimate) = (fitter.model().optics.clone(), &scene.estimate);
        let mut chain = Chain::open_shared(optics, estimate.device.into(), estimate.precision().into(), 1)?;
        let found = fitter.estimate(&mut chain, cube, control)?;
        Ok(Some((fitter, found)))
    }
}
