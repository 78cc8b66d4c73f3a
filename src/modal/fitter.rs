//! Modal fitter: the model of a scene, and the data that all fits with it share.

use super::model::Model;
use super::pointing::Pointing;
use crate::control::Control;
use crate::imaging::CpuChain;
use crate::modal::assess::fisher;
use crate::modal::assess::tilts::Tilts;
use crate::modal::combine::diversity_error::{self, DiversityProjection, SharedError};
use crate::modal::combine::global_motions::GlobalMotions;
use crate::modal::left_out::{LeftOut, last_zernike};
use crate::modal::model::mode_set::SceneBasis;
use crate::modal::model::recipe::Recipe;
use crate::modal::solve::engine::FitTask;
use crate::modal::solve::metrics::Metrics;
use crate::modes::Direction;
use crate::scene::{Grouping, Method, OpticalParameter, PupilScene, System};
use crate::{Error, Result};
use ndarray::{Array2, ArrayView1};
use std::fmt;
use std::sync::{Arc, OnceLock};

/// Fits static modes to images of one scene, and combines the images. A clone shares the model.
#[derive(Clone)]
pub struct ModalFitter {
    pub(super) scene: System,
    pub(super) recipe: Recipe,
    pub(super) model: Arc<Model>,
    /// Reference chain (f64, CPU): metric, weights, χ² and error bars come from it for every chain
    /// that fits.
    pub(super) reference: Arc<CpuChain<f64>>,
    pub(super) metrics: Arc<Metrics>,
    /// Motions of the whole mirror, computed once because that takes as long as some fits.
    pub(super) motions: Arc<GlobalMotions>,
    pub(super) tilts: Arc<Tilts>,
    /// Errors that all images share.
    pub(super) shared: Vec<SharedError>,
    pub(super) scene_basis: Arc<SceneBasis>,
    pub(super) fitted_optics: Vec<OpticalParameter>,
    /// What the modes leave out, once an estimate has marginalised it: sessions and the search of
    /// the optics do without.
    pub(super) left_out: Arc<OnceLock<LeftOut>>,
}

impl fmt::Debug for ModalFitter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ModalFitter").field("recipe", &self.recipe).finish_non_exhaustive()
    }
}

/// Refuses a scene with an error budget, which a fitter would ignore.
///
/// # Errors
/// [`Error::Scene`].
pub(super) fn refuse_budget(scene: &System) -> Result<()> {
    match scene.estimate.budget_nm {
        None => Ok(()),
        Some(budget_nm) => Err(Error::Scene(format!(
            "estimate.budget_nm = {budget_nm} needs a plan, which a model and its sessions do not make: use the scene that \
             'cophase plan' or planner::plan writes, or leave the budget out"
        ))),
    }
}

/// Refuses a scene with optical parameters to be fitted, which a fitter would ignore.
///
/// # Errors
/// [`Error::Scene`].
pub(super) fn refuse_fit_optics(scene: &System) -> Result<()> {
    if scene.estimate.fit_optics.is_empty() {
        return Ok(());
    }
    Err(Error::Scene(
        "estimate.fit_optics fits the telescope to images, which a model and its sessions do not do: leave it out, or give \
         this scene to the full pipeline ('cophase estimate', pipeline::Estimator, cophase_estimator_create)"
            .into(),
    ))
}

/// Refuses a scene whose method is not modal.
///
/// # Errors
/// [`Error::Scene`].
pub(super) fn refuse_full_phase(scene: &System) -> Result<()> {
    match scene.estimate.method {
        Method::Modal => Ok(()),
        Method::FullPhase | Method::Auto => Err(Error::Scene(
            "estimate.method = \"full-phase\" (or \"auto\") retrieves wavefronts of a whole sequence, which a model and its sessions do not \
             do: leave it out, or give this scene to the full pipeline ('cophase estimate', pipeline::Estimator, \
             cophase_estimator_create)"
                .into(),
        )),
    }
}

/// Refuses a scene whose images are fitted together, which a fitter of single images would ignore.
///
/// # Errors
/// [`Error::Scene`].
pub(super) fn refuse_group(scene: &System) -> Result<()> {
    match scene.estimate.group {
        // A session takes one image of each channel.
        Grouping::Auto | Grouping::Each | Grouping::Successive(1) => Ok(()),
        together => Err(Error::Scene(format!(
            "estimate.group = {} fits several images of a channel together, where a model and its sessions take one of each: leave it \
             out, or give this scene to the full pipeline ('cophase estimate', 'cophase watch --policy full', pipeline::Estimator, \
             cophase_estimator_create)",
            together.shown()
        ))),
    }
}

/// Whether two scenes have the same Karhunen-Loève basis.
pub(super) fn same_basis(one: &System, other: &System) -> bool {
    let telescope = |scene: &System| {
        let (samples, model) = (0, None);
        // The basis does not depend on the illumination.
        let (illumination_x, illumination_y, illumination_edge) = (0.0, 0.0, 0.0);
        let even = PupilScene { illumination_x, illumination_y, illumination_edge, ..scene.pupil.clone() };
        PupilScene { samples, model, band_pass_cycles: None, band_stop_cycles: None, ..even }
    };
    let modes = |scene: &System| (scene.modes.ncpa.clone(), scene.modes.ncpa_count);
    telescope(one) == telescope(other)
        && modes(one) == modes(other)
        && one.mirror == other.mirror
        && one.turbulence == other.turbulence
        && one.directory() == other.directory()
}

impl ModalFitter {
    /// Builds the model of `scene`.
    ///
    /// `native` forbids the reduction to Nyquist sampling: needed where pixels are bad, because the
    /// reduction would ring around them.
    ///
    /// # Errors
    /// Those of building the telescope, its modes and its pupil; see [`Model::new`].
    pub fn new(scene: &System, native: bool) -> Result<Self> {
        Self::with_recipe(scene, Recipe::from_scene(scene), native)
    }

    /// Builds the model of `scene` for another recipe.
    ///
    /// # Errors
    /// As [`ModalFitter::new`].
    pub fn with_recipe(scene: &System, recipe: Recipe, native: bool) -> Result<Self> {
        Self::with_scene_basis(scene, recipe, native, Arc::default())
    }

    /// A fitter for another scene or recipe that shares this one's Karhunen-Loève basis, which
    /// takes most of the time of building a fitter, where telescope, mirror, turbulence and modes
    /// are the same and only the sampling and the fit differ. Otherwise the basis is computed
    /// again.
    ///
    /// # Errors
    /// As [`ModalFitter::new`].
    pub fn variant(&self, scene: &System, recipe: Recipe) -> Result<Self> {
        let scene_basis = if same_basis(&self.scene, scene) { self.scene_basis.clone() } else { Arc::default() };
        Self::with_scene_basis(scene, recipe, false, scene_basis)
    }

    pub(super) fn with_scene_basis(
        scene: &System,
        recipe: Recipe,
        native: bool,
        scene_basis: Arc<SceneBasis>,
    ) -> Result<Self> {
        refuse_budget(scene)?;
        refuse_fit_optics(scene)?;
        refuse_full_phase(scene)?;
        refuse_group(scene)?;
        let model = Model::with_scene_basis(scene, &recipe, native, &scene_basis)?;
        Ok(Self { scene_basis, ..Self::from_model(scene, recipe, model)? })
    }

    pub(super) fn from_model(scene: &System, recipe: Recipe, model: Model) -> Result<Self> {
        Ok(Self {
            scene: scene.clone(),
            reference: Arc::new(CpuChain::new(model.optics.clone())),
            metrics: Arc::new(Metrics::new(&recipe, model.tiles().derivative_bytes)),
            motions: Arc::new(GlobalMotions::new(&model)?),
            tilts: Arc::new(Tilts::new(&model)?),
            shared: diversity_error::shared_error(&model, scene)?.into_iter().collect(),
            scene_basis: Arc::default(),
            fitted_optics: Vec::new(),
            left_out: Arc::default(),
            recipe,
            model: Arc::new(model),
        })
    }

    /// Whether this fitter was made for `scene` and `recipe`.
    pub(super) fn is_of(&self, scene: &System, recipe: &Recipe) -> bool {
        self.recipe == *recipe && *self.scene == **scene && self.scene.directory() == scene.directory()
    }

    /// What the modes leave out, where the recipe marginalises it.
    ///
    /// # Errors
    /// Those of [`LeftOut::new`].
    pub(super) fn left_out(&self) -> Result<Option<&LeftOut>> {
        if !self.recipe.marginalise {
            return Ok(None);
        }
        if let Some(built) = self.left_out.get() {
            return Ok(Some(built));
        }
        let last = last_zernike([self.recipe.exact_zernikes, self.recipe.prior_zernikes]);
        let built = LeftOut::new(&self.model, last, &self.scene.tolerance, None)?;
        Ok(Some(self.left_out.get_or_init(|| built)))
    }

    /// The model of the images.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Optical parameters that were fitted, in the order of `estimate.fit_optics`;
    /// [`ModalFitter::scene`] has their values.
    pub fn fitted_optics(&self) -> &[OpticalParameter] {
        &self.fitted_optics
    }

    /// The recipe of the fits.
    pub fn recipe(&self) -> &Recipe {
        &self.recipe
    }

    /// The scene.
    pub fn scene(&self) -> &System {
        &self.scene
    }

    /// The f64 CPU chain of this model.
    pub fn reference_chain(&self) -> &CpuChain<f64> {
        &self.reference
    }

    /// Where the star is in an image, in terms of the modes.
    ///
    /// # Errors
    /// [`Error::Shape`] for modes on another grid than the pupil's.
    pub fn pointing(&self) -> Result<Pointing> {
        Pointing::new(&self.model, &self.motions, &self.tilts)
    }

    /// Whether `direction` is a motion of the whole mirror, which is 0 by convention: its piston,
    /// and where segments have tips and tilts and the NCPA span them, its tip and tilt, which are
    /// then among the NCPA.
    pub fn is_global_motion(&self, direction: &Direction) -> bool {
        self.motions.contain(direction)
    }

    /// Whether `direction` moves but segments that the scene has without light.
    pub(crate) fn is_of_dark_segments(&self, direction: &Direction) -> bool {
        /// Part of its square that is of them; the mean over the mirror, which is 0, takes the
        /// rest.
        const LEAST_SHARE: f64 = 0.9;
        let (dark, pistons) = (&self.scene.pupil.dark_segments, self.model.pistons());
        let is_dark = |mode: usize| pistons > 0 && dark.contains(&((mode % pistons) as i64));
        let moves = direction.coefficients.iter().take(self.model.segment_modes).enumerate();
        moves.filter(|(mode, _)| is_dark(*mode)).map(|(_, share)| share * share).sum::<f64>() > LEAST_SHARE
    }

    /// Errors that all images share, so that no number of images averages them out.
    pub fn shared_errors(&self) -> &[SharedError] {
        &self.shared
    }

    /// Covariance of all errors that the images share, nm²; `None` where there are none.
    pub(super) fn shared_covariance_nm2(&self) -> Option<Array2<f64>> {
        let mut each = self.shared.iter().map(|shared| &shared.covariance_nm2);
        let first = each.next()?.clone();
        Some(each.fold(first, |sum, covariance_nm2| sum + covariance_nm2))
    }

    /// `covariance_nm2` of noise and scatter plus that of the shared errors, nm².
    pub(super) fn with_shared(&self, covariance_nm2: Array2<f64>) -> Array2<f64> {
        match self.shared_covariance_nm2() {
            Some(shared_nm2) => covariance_nm2 + shared_nm2,
            None => covariance_nm2,
        }
    }

    pub(super) fn task<'a>(&'a self, control: &'a Control) -> FitTask<'a> {
        let Self { model, reference, metrics, recipe, .. } = self;
        FitTask { model, reference, metrics, recipe, control }
    }

    /// Projection of the diversity on the modes of the NCPA.
    ///
    /// # Errors
    /// [`Error::File`] for a map of it that cannot be read.
    pub fn diversity_projection(&self) -> Result<DiversityProjection> {
        diversity_error::project_diversity(&self.model, &self.scene)
    }

    /// Cramér-Rao bound: covariance of the modes, nm², for one image of a star of `flux_e` with the
    /// scene's read noise at the given wavefront; null directions have none. Pistons are about
    /// their mean.
    ///
    /// # Errors
    /// [`Error::Value`] where no mode changes the image.
    pub fn bound(&self, coefficients_nm: ArrayView1<f64>, flux_e: f64, background_e: f64) -> Result<Array2<f64>> {
        let native_pixels = self.model.preparation.native_pixels();
        let floor = (self.scene.image.read_noise_e.unwrap_or(0.0).powi(2) + background_e) * native_pixels;
        let psf = self.reference.psf(coefficients_nm);
        let weight: Vec<f64> = psf.iter().map(|h| 1.0 / (flux_e * h + floor)).collect();
        let photometry = match (self.recipe.fit_flux, self.recipe.fit_background) {
            (true, true) => crate::imaging::Photometry::FitBoth,
            (true, false) => crate::imaging::Photometry::FitFlux { background_e },
            (false, _) => crate::imaging::Photometry::Fixed { flux_e, background_e },
        };
        let noise = (weight.as_slice(), None);
        let sensitivity = fisher::Sensitivity::at(
            &self.reference,
            coefficients_nm,
            flux_e,
            noise,
            photometry,
            self.model.tiles().derivative_bytes,
        );
        Ok(self.motions.removed_from(&sensitivity.covariance()?))
    }
}
