//! How a fit is done: the paper's way or ours, with whatever the scene changes.

use crate::scene::{Optimizer, PupilModel, Sampling, Scene, Weighting, Zernikes};

/// Tip, tilt and focus: what every optic does.
const NARROW: Zernikes = Zernikes::Span { first: 2, last: 4 };
/// Everything to radial order 5: with 66 Karhunen-Loève modes this spans the low-order NCPA of which a mirror of small
/// coupling holds only 75 to 95 %.
const WIDE: Zernikes = Zernikes::Span { first: 2, last: 21 };

/// The choices of one fit. [`Recipe::of`] fills in what the scene leaves open.
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
    /// The pixels that are compared.
    pub sampling: Sampling,
    /// How the model samples a geometric pupil, or a fine map of one.
    pub pupil_model: PupilModel,
    /// Zernikes that are always estimated exactly.
    pub exact_zernikes: Zernikes,
    /// Most evaluations for one image.
    pub max_evaluations: usize,
    /// The fit stops where no coefficient would move by more than this.
    pub step_tolerance_nm: f64,
}

impl Recipe {
    /// The recipe that `scene` asks for.
    ///
    /// `optimizer = "bfgs"` is the paper's method as a whole: a hard-edged pupil of grey samples, the scene's own modes
    /// and no others, an unweighted objective with the flux fixed to the image's sum and no background, the whole image
    /// at Nyquist sampling, BFGS from zero. Ours weighs by the noise, fits flux and background, samples the pupil with
    /// band-limited weights, crops to the signal, and estimates low Zernikes exactly.
    pub fn of(scene: &Scene) -> Self {
        let ours = scene.estimate.optimizer == Optimizer::GaussNewton;
        let estimate = &scene.estimate;
        Self {
            optimizer: estimate.optimizer,
            weighting: estimate.weighting.unwrap_or(if ours { Weighting::Noise } else { Weighting::None }),
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
            exact_zernikes: if ours { scene.modes.exact_zernikes.unwrap_or(WIDE) } else { Zernikes::None },
            // The paper's way needs 130 to 400; ours about 15.
            max_evaluations: estimate.max_evaluations.unwrap_or(if ours { 200 } else { 2000 }),
            step_tolerance_nm: estimate.step_tolerance_nm.unwrap_or(1e-3),
        }
    }

    /// The recipes to try in turn, the smallest basis first: where the scene leaves the exact Zernikes open, tip, tilt
    /// and focus, then those to Noll 21. Otherwise the one that the scene asks for.
    pub fn ladder(scene: &Scene) -> Vec<Self> {
        let own = Self::of(scene);
        if own.optimizer != Optimizer::GaussNewton || scene.modes.exact_zernikes.is_some() {
            return vec![own];
        }
        [NARROW, WIDE].map(|exact_zernikes| Self { exact_zernikes, ..own.clone() }).to_vec()
    }
}
