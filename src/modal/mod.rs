//! From images to what the segments and the NCPA are doing, in nm, with error bars.
//!
//! ```text
//! Scene ─ Recipe ─ Model ┐
//!                        ├ prepare ─ fit (lock-step over the batch) ─ Fisher ─ combine ─ ModalEstimate
//! frames ────────────────┘
//! ```
//!
//! [`ModalFitter::new`], or [`ModalFitter::from_arrays`] for a telescope of the caller's own, pays every cost that does not
//! depend on the images; [`ModalFitter::estimate`] takes a cube of them. A [`Session`] takes frames as a camera delivers
//! them, in memory that is taken once, and an [`Accumulator`] keeps what they say together.

mod accumulator;
mod arrays;
mod band;
mod calibration;
mod combine;
mod device;
mod diversity_error;
mod engine;
mod fisher;
mod fit_optics;
mod gauss_newton;
mod memory;
mod metrics;
mod minimum;
mod mode_set;
mod model;
mod outliers;
mod pistons;
mod plan;
mod prepare;
mod recipe;
mod recut;
mod residual;
mod restart;
mod runner;
mod select;
mod sequence;
mod session;
mod spread;
mod status;

pub use accumulator::{Accumulator, RunningEstimate};
pub use arrays::Arrays;
pub use calibration::{Calibration, CameraMaps};
pub use combine::{Combination, Combined, Compared, ModalEstimate};
pub use diversity_error::{Held, HeldDiversity, Holder, within_reach};
pub use engine::Watch;
use engine::{FitState, FitTask, ImageFit};
pub use fit_optics::FittedOptic;
pub use memory::{Memory, Tiles};
use metrics::Metrics;
use mode_set::OwnBasis;
pub use model::Model;
use pistons::Pistons;
pub(crate) use plan::{LEAST_HALF_WIDTH, SPOT_MARGIN};
pub use prepare::{Frame, Preparation, Prepared, Refusal};
use prepare::{Preparer, Ringing};
pub use recipe::Recipe;
pub use recut::{WithoutOutliers, without_outliers};
pub(crate) use residual::photometry;
pub use select::{BasisCache, Cube, Open, read, select};
pub use session::{FitOptions, ImageResult, Session, SessionOptions};
use status::Tilts;
pub use status::{ImageReport, Status};

use crate::imaging::{Chain, CpuChain, Precision};
use crate::optimize::CancelFlag;
use crate::scene::{Combine, Method, PupilScene, Scene};
use crate::{Error, Result};
use ndarray::{Array2, ArrayView1, ArrayView3};
use std::fmt;
use std::sync::Arc;

/// Reads images of one scene.
pub struct ModalFitter {
    scene: Scene,
    recipe: Recipe,
    model: Model,
    /// The f64 CPU chain: metric, weights, χ² and error bars come from it whatever chain fits.
    judge: CpuChain<f64>,
    metrics: Metrics,
    /// Means over the pupil, which take as long as some fits.
    pistons: Pistons,
    tilts: Tilts,
    /// Errors that all images share.
    shared: Vec<SharedError>,
    own_basis: Arc<OwnBasis>,
    fitted_optics: Vec<FittedOptic>,
}

/// An error that all images share.
#[derive(Debug, Clone)]
pub struct SharedError {
    /// Its cause, in a word or two.
    pub name: &'static str,
    /// Its covariance, `[mode, mode]`, nm².
    pub covariance_nm2: Array2<f64>,
}

impl fmt::Debug for ModalFitter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ModalFitter").field("recipe", &self.recipe).finish_non_exhaustive()
    }
}

/// What [`ModalFitter::fit_each`] found.
#[derive(Debug, Clone)]
pub struct EachImage {
    /// `[image, mode]`, nm, pistons about their mean over the pupil; NaN for images that cannot be used.
    pub coefficients_nm: Array2<f64>,
    /// One report per image, in order.
    pub reports: Vec<ImageReport>,
}

/// That `scene` has no budget left, which an estimator would ignore.
///
/// # Errors
/// [`Error::Scene`].
fn refuse_budget(scene: &Scene) -> Result<()> {
    match scene.estimate.budget_nm {
        None => Ok(()),
        Some(budget_nm) => Err(Error::Scene(format!(
            "estimate.budget_nm = {budget_nm} asks for a plan, which needs a telescope that the scene describes: an \
             estimator takes the scene that the planner makes of this one, or one without a budget"
        ))),
    }
}

/// That `scene` leaves no optics to be fitted, which an estimator would ignore.
///
/// # Errors
/// [`Error::Scene`].
fn refuse_fit_optics(scene: &Scene) -> Result<()> {
    if scene.estimate.fit_optics.is_empty() {
        return Ok(());
    }
    Err(Error::Scene(
        "estimate.fit_optics fits the telescope to images, which a model and its sessions do not do: leave it out, or give \
         this scene to the full pipeline ('cophase estimate', pipeline::Estimator, cophase_estimator_create)"
            .into(),
    ))
}

/// That `scene` asks for static modes, fitted image by image.
///
/// # Errors
/// [`Error::Scene`].
fn refuse_full_phase(scene: &Scene) -> Result<()> {
    match scene.estimate.method {
        Method::Modal => Ok(()),
        Method::FullPhase => Err(Error::Scene(
            "estimate.method = \"full-phase\" retrieves wavefronts of a whole sequence, which a model and its sessions do not \
             do: leave it out, or give this scene to the full pipeline ('cophase estimate', pipeline::Estimator, \
             cophase_estimator_create)"
                .into(),
        )),
    }
}

/// Whether two scenes have the same Karhunen-Loève basis.
fn same_basis(one: &Scene, other: &Scene) -> bool {
    let telescope = |scene: &Scene| {
        let (samples, model) = (0, None);
        PupilScene { samples, model, band_pass_cycles: None, band_stop_cycles: None, ..scene.pupil.clone() }
    };
    let modes = |scene: &Scene| (scene.modes.ncpa.clone(), scene.modes.ncpa_count);
    telescope(one) == telescope(other)
        && modes(one) == modes(other)
        && one.mirror == other.mirror
        && one.turbulence == other.turbulence
        && one.directory() == other.directory()
}

/// The minima of a cube.
struct Fitted {
    /// Why an image could not be used, for each.
    refused: Vec<Option<Refusal>>,
    /// The images that could.
    indices: Vec<usize>,
    prepared: Vec<Prepared>,
    minima: Vec<minimum::Minimum>,
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
    /// Builds the model of `scene`.
    ///
    /// `native` forbids the reduction to Nyquist sampling: needed where pixels are bad, because they would ring.
    ///
    /// # Errors
    /// Those of building the telescope, its modes and its pupil; see [`Model::of`].
    pub fn new(scene: &Scene, native: bool) -> Result<Self> {
        Self::with_recipe(scene, Recipe::of(scene), native)
    }

    /// Builds the model of `scene` for a recipe of the caller's.
    ///
    /// # Errors
    /// As [`ModalFitter::new`].
    pub fn with_recipe(scene: &Scene, recipe: Recipe, native: bool) -> Result<Self> {
        Self::with_own_basis(scene, recipe, native, Arc::default())
    }

    /// An estimator of another scene, or for another recipe, that shares this one's Karhunen-Loève basis, which is most
    /// of the time that an estimator costs: where the telescope, the mirror, the turbulence and the modes are the same,
    /// and only the sampling and the fit differ. Otherwise it is made anew.
    ///
    /// # Errors
    /// As [`ModalFitter::new`].
    pub fn variant(&self, scene: &Scene, recipe: Recipe) -> Result<Self> {
        let own_basis = if same_basis(&self.scene, scene) { self.own_basis.clone() } else { Arc::default() };
        Self::with_own_basis(scene, recipe, false, own_basis)
    }

    fn with_own_basis(scene: &Scene, recipe: Recipe, native: bool, own_basis: Arc<OwnBasis>) -> Result<Self> {
        refuse_budget(scene)?;
        refuse_fit_optics(scene)?;
        refuse_full_phase(scene)?;
        let model = Model::with_own_basis(scene, &recipe, native, &own_basis)?;
        Ok(Self { own_basis, ..Self::of_model(scene, recipe, model)? })
    }

    fn of_model(scene: &Scene, recipe: Recipe, model: Model) -> Result<Self> {
        let judge = CpuChain::new(model.optics.clone());
        let metrics = Metrics::new(&recipe, model.tiles().derivative_bytes);
        let (pistons, tilts) = (Pistons::of(&model)?, Tilts::new(&model)?);
        let shared = diversity_error::common(&model, scene)?.into_iter().collect();
        let (scene, own_basis) = (scene.clone(), Arc::default());
        let fitted_optics = Vec::new();
        Ok(Self { scene, recipe, model, judge, metrics, pistons, tilts, shared, own_basis, fitted_optics })
    }

    /// The model that is compared with the images.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// What `estimate.fit_optics` found, in its order; its numbers are those of [`ModalFitter::scene`].
    pub fn fitted_optics(&self) -> &[FittedOptic] {
        &self.fitted_optics
    }

    /// How it is fitted.
    pub fn recipe(&self) -> &Recipe {
        &self.recipe
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The f64 CPU chain of this model.
    pub fn judge(&self) -> &CpuChain<f64> {
        &self.judge
    }

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
    fn fitted(&self, chain: &mut Chain, cube: Cube, cancel: Option<&CancelFlag>, watch: &mut Watch) -> Result<Fitted> {
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

    /// Prepares `frames` and fits them, each from the start of its fit.
    fn fit_frames(
        &self,
        chain: &mut Chain,
        task: &FitTask,
        frames: &[Frame],
        fits: &mut [ImageFit],
        watch: &mut Watch,
    ) -> Result<()> {
        let prepare = |index: usize, preparer: &mut Preparer, prepared: &mut Prepared| {
            preparer.prepare(frames[index], task.recipe, Ringing::Accepted, prepared)
        };
        engine::fit(chain, task, &prepare, fits, watch)
    }

    /// The errors that all images share, so that no number of images averages them out.
    pub fn shared_errors(&self) -> &[SharedError] {
        &self.shared
    }

    /// Covariance of all errors that the images share, nm²; `None` where there are none.
    fn shared_covariance_nm2(&self) -> Option<Array2<f64>> {
        let mut each = self.shared.iter().map(|shared| &shared.covariance_nm2);
        let first = each.next()?.clone();
        Some(each.fold(first, |sum, covariance_nm2| sum + covariance_nm2))
    }

    /// `covariance_nm2` of noise and scatter with that of the shared errors, nm².
    fn with_shared(&self, covariance_nm2: Array2<f64>) -> Array2<f64> {
        match self.shared_covariance_nm2() {
            Some(shared_nm2) => covariance_nm2 + shared_nm2,
            None => covariance_nm2,
        }
    }

    fn task<'a>(&'a self, cancel: Option<&'a CancelFlag>) -> FitTask<'a> {
        let Self { model, judge, metrics, recipe, .. } = self;
        FitTask { model, reference: judge, metrics, recipe, cancel, deadline: None }
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

    /// The variance that each mode would have at best, nm² (Cramér-Rao), for one image of a star of `flux_e` with the
    /// scene's read noise at the given wavefront; null directions carry none. Pistons are about their mean.
    ///
    /// # Errors
    /// [`Error::Value`] where no mode is seen at all.
    pub fn bound(&self, coefficients_nm: ArrayView1<f64>, flux_e: f64, background_e: f64) -> Result<Array2<f64>> {
        let native_pixels = self.model.preparation.native_pixels();
        let floor = (self.scene.image.read_noise_e.powi(2) + background_e) * native_pixels;
        let psf = self.judge.psf(coefficients_nm);
        let weight: Vec<f64> = psf.iter().map(|h| 1.0 / (flux_e * h + floor)).collect();
        let photometry = match (self.recipe.fit_flux, self.recipe.fit_background) {
            (true, true) => crate::imaging::Photometry::FitBoth,
            (true, false) => crate::imaging::Photometry::FitFlux { background_e },
            (false, _) => crate::imaging::Photometry::Fixed { flux_e, background_e },
        };
        let noise = (weight.as_slice(), None);
        let sensitivity = fisher::Sensitivity::at(
            &self.judge,
            coefficients_nm,
            flux_e,
            noise,
            photometry,
            self.model.tiles().derivative_bytes,
        );
        Ok(self.pistons.centred(&sensitivity.covariance()?))
    }
}
