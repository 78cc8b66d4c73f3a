//! Recipe: the choices of a fit, those of the paper or ours, with the changes that the scene makes.

use crate::scene::{Combine, NollRange, Optimizer, PupilModel, Sampling, System, Weighting};

/// Restarts of a fit that ended in a wrong minimum. Of 8 draws with pistons of 500 nm RMS at a peak
/// S/N of 30 one needs more than three.
const RESTARTS: usize = 6;
/// All Zernikes to radial order 5: with 66 Karhunen-Loève modes they span the low-order NCPA, of
/// which a mirror of small coupling spans only 75 to 95 %.
const EXACT: NollRange = NollRange::Span { first: 2, last: 21 };
/// Radial orders 6 to 8, which NCPA of polished optics reach with a few per cent of their variance.
/// Of higher orders 66 Karhunen-Loève modes span as much as the images of a monolithic mirror show.
const WITH_PRIOR: NollRange = NollRange::Span { first: 22, last: 45 };

/// The choices of one fit. [`Recipe::from_scene`] fills in what the scene leaves open.
#[derive(Debug, Clone, PartialEq)]
pub struct Recipe {
    /// The optimiser.
    pub optimizer: Optimizer,
    /// Weight of each pixel.
    pub weighting: Weighting,
    /// Whether the flux is fitted; otherwise it is the sum of the image.
    pub fit_flux: bool,
    /// Whether a constant background is fitted.
    pub fit_background: bool,
    /// Whether an image that is off the axis is first moved onto it, by whole pixels.
    pub recentre: bool,
    /// Whether only the pixels that carry signal are fitted.
    pub crop: bool,
    /// Sampling of the pixels that are fitted.
    pub sampling: Sampling,
    /// How the model samples a geometric pupil, or a fine map of one.
    pub pupil_model: PupilModel,
    /// Least pass band of a band-limited pupil, cycles, as far as its samples carry it: the same
    /// for models that are to have the same weights; 0 for what the image needs.
    pub least_pass_cycles: f64,
    /// Zernikes that are always estimated exactly.
    pub exact_zernikes: NollRange,
    /// Zernikes that are fitted too and carry a prior in the combination of the images.
    pub prior_zernikes: NollRange,
    /// Whether what the modes leave out is marginalised after the fit.
    pub marginalise: bool,
    /// Most evaluations for one image.
    pub max_evaluations: usize,
    /// The fit stops where neither a coefficient nor the RMS of the wavefront would move by more
    /// than this.
    pub step_tolerance_nm: f64,
    /// How often a fit that ended in a wrong minimum is restarted from a perturbed start.
    pub restarts: usize,
    /// Whether pixels that the model does not explain are rejected as the weights are renewed.
    pub reject_outliers: bool,
    /// Whether images that the model does not explain are searched for outlier pixels and fitted
    /// again without them.
    pub search_outliers: bool,
    /// How the images are combined.
    pub combine: Combine,
}

impl Recipe {
    /// The recipe of `scene`.
    ///
    /// `optimizer = "bfgs"` is the paper's method as a whole: a hard-edged pupil of grey samples,
    /// the scene's own modes and no others, an unweighted objective with the flux fixed to the
    /// image's sum and no background, the whole image at Nyquist sampling, BFGS from zero. Ours
    /// weighs by the noise, fits flux and background, samples the pupil with band-limited weights,
    /// crops to the signal, and estimates low Zernikes exactly. `"paper"` is the paper's recipe
    /// with our optimiser.
    pub fn from_scene(scene: &System) -> Self {
        Self::with_optimizer(scene, scene.estimate.optimizer)
    }

    /// The paper's objective with our optimiser, in place of the one that `scene` names; the
    /// scene's other keys of the fit are used.
    pub fn paper_objective(scene: &System) -> Self {
        Self::with_optimizer(scene, Optimizer::Paper)
    }

    fn with_optimizer(scene: &System, optimizer: Optimizer) -> Self {
        let ours = optimizer == Optimizer::GaussNewton;
        let estimate = &scene.estimate;
        let weighting = estimate.weighting_with(optimizer);
        let has_noise = weighting == Weighting::Noise;
        Self {
            optimizer,
            weighting,
            fit_flux: estimate.fit_flux.unwrap_or(ours),
            fit_background: estimate.fit_background.unwrap_or(ours),
            recentre: estimate.recentre.unwrap_or(ours),
            crop: ours,
            sampling: estimate.sampling,
            pupil_model: match scene.pupil.model {
                Some(model) if ours => model,
                None if ours => PupilModel::BandLimited,
                _ => PupilModel::Hard,
            },
            least_pass_cycles: 0.0,
            exact_zernikes: if ours { scene.modes.exact_zernikes.unwrap_or(EXACT) } else { NollRange::None },
            prior_zernikes: NollRange::None,
            marginalise: false,
            // BFGS needs 130 to 400; ours about 15.
            max_evaluations: estimate.max_evaluations.unwrap_or(if optimizer == Optimizer::Bfgs { 2000 } else { 200 }),
            // The paper's objective is used where the modes do not span the wavefront: this
            // tolerance ends within 0.03 nm of the minimum in three quarters of the evaluations,
            // where images of turbulence scatter by 20 nm.
            step_tolerance_nm: estimate.step_tolerance_nm.unwrap_or(if optimizer == Optimizer::Paper {
                1e-2
            } else {
                1e-3
            }),
            restarts: estimate.restarts.unwrap_or(if ours { RESTARTS } else { 0 }),
            // Without weights there is no noise model by which a pixel could be an outlier.
            reject_outliers: has_noise,
            search_outliers: has_noise,
            combine: estimate.combine.unwrap_or(if ours { Combine::ClippedMean } else { Combine::Mean }),
        }
    }

    /// [`Recipe::from_scene`] with a prior on further Zernikes, those of radial orders 6 to 8,
    /// where the scene leaves the exact Zernikes open: a χ² does not show modes that are small in
    /// one image and large in the mean of forty, and error bars without them would be too small.
    /// What these modes leave out is marginalised as `scene` says, where the weights are the
    /// noise's.
    pub fn with_prior(scene: &System) -> Self {
        let own = Self::from_scene(scene);
        let is_open = scene.estimate.optimizer == Optimizer::GaussNewton && scene.modes.exact_zernikes.is_none();
        let prior_zernikes = if is_open { WITH_PRIOR } else { NollRange::None };
        let marginalise = scene.estimate.has_posterior();
        Self { prior_zernikes, marginalise, ..own }
    }
}
