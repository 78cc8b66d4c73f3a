//! Cost of a model: its error, and the work of a fit.

/// Error of a model, and the work of one image's fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Price {
    /// RMS error without noise, nm, of the phasing and of the NCPA: the largest of the draws.
    pub model_nm: [f64; 2],
    /// RMS error from noise (Cramér-Rao bound of these pixels), nm, of the phasing and of the NCPA.
    pub noise_nm: [f64; 2],
    /// Evaluations of the objective for one image, mean.
    pub evaluations: f64,
    /// Operations of one image's fit, 10⁶: what candidates are compared by, because it is the same on every run.
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
