//! Cost of a model: its error, and the work of a fit.

/// Error of a model, and the work of one image's fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Price {
    /// RMS error without noise, nm, of the phasing and of the NCPA: the largest of the draws.
    pub model_nm: [f64; 2],
    /// RMS error from noise (Cramér-Rao bound of these pixels), nm, of the phasing and of the NCPA.
    pub noise_nm: [f64; 2],
    /// Reduced χ² of the model's error alone, over what noise and a finely sampled model explain
    /// beyond 1, the largest of the draws: from about 1 on, an estimate looks for another minimum,
    /// and then calls the image a misfit.
    pub misfit: f64,
    /// Evaluations of the objective for one image, mean.
    pub evaluations: f64,
    /// Operations of one image's fit, 10⁶: what candidates are compared by, because it is the same
    /// on every run.
    pub megaflops: f64,
    /// Wall-clock time of one image's fit in a batch on this machine's CPU, µs.
    pub estimate_us: f64,
}

impl Price {
    /// The larger error of the phasing and of the NCPA, model and noise together, nm.
    pub fn error_nm(&self) -> f64 {
        self.model_nm.iter().zip(&self.noise_nm).map(|(model, noise)| model.hypot(*noise)).fold(0.0, f64::max)
    }
}

/// Largest [`Price::misfit`] of an acceptable candidate: the other half is left to the scatter of
/// the noise.
const MISFIT: f64 = 0.5;

/// What a candidate may cost.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limit {
    error_nm: f64,
    misfit: f64,
}

impl Limit {
    /// An error of `error_nm`, and a χ² that noise explains, or that of the scene's own model,
    /// `reference`.
    pub(super) fn new(error_nm: f64, reference: &Price) -> Self {
        Self { error_nm, misfit: reference.misfit.max(MISFIT) }
    }

    pub(super) fn allows(&self, price: &Price) -> bool {
        price.error_nm() <= self.error_nm && price.misfit <= self.misfit
    }
}
