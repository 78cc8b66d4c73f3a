//! Photometry of an image, and the results of one evaluation of a batch.

/// Whether flux and background of an image are known or fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum GpuPhotometry {
    /// Both known, electrons.
    Known {
        /// Flux, electrons.
        flux_e: f64,
        /// Background, electrons per pixel.
        background_e: f64,
    },
    /// The flux that minimises the objective over a known background.
    FitFlux {
        /// Background, electrons per pixel.
        background_e: f64,
    },
    /// The flux and background that minimise the objective.
    FitBoth,
}

/// Results of one evaluation of a batch; every list is in the order of the active images.
#[derive(Debug, Clone, PartialEq)]
pub struct GpuEvaluation {
    /// J = Σ w (flux·h + background − d)².
    pub objective: Vec<f64>,
    /// dJ/d(coefficient), `[image][mode]`, per nm.
    pub gradient: Vec<f64>,
    /// Flux, electrons.
    pub flux_e: Vec<f64>,
    /// Background, electrons per pixel.
    pub background_e: Vec<f64>,
}
