//! Source of the wavefronts of a sequence: a retrieval from images, or the known wavefronts of a
//! simulation.

use crate::Result;
use crate::retrieval::{IlluminatedSamples, RadialPsd, StaticWavefront};
use ndarray::{Array1, Array2};

/// Retrieved wavefronts of a sequence, with the telemetry of each exposure.
#[derive(Debug, Clone)]
pub struct RetrievedSequence {
    /// Static and dynamic wavefront, `[image, sample]`, nm; NaN for unusable images.
    pub wavefront_nm: Array2<f64>,
    /// χ² per degree of freedom of each image; 1 where wavefronts are known.
    pub reduced_chi2: Vec<f64>,
    /// Slopes that the wavefront sensor measured, mean over each exposure, `[image, slope]`, mas;
    /// `None` without telemetry.
    pub slopes_mas: Option<Array2<f64>>,
}

/// Source of the wavefronts of a sequence.
pub trait WavefrontSource {
    /// Illuminated samples of the wavefronts.
    fn samples(&self) -> &IlluminatedSamples;

    /// Prior power spectral density of the wavefronts, where they are shrunk by one: a lower bound
    /// of the true one.
    fn prior(&self) -> Option<&RadialPsd> {
        None
    }

    /// Pistons of the static wavefront about which the first wavefronts are retrieved, nm, where
    /// they are beyond those to which the loop responds linearly.
    fn start_pistons_nm(&self) -> Option<&[f64]> {
        None
    }

    /// By how much corrections have moved the reference slopes, to which those of the telemetry are
    /// relative, mas, where that is known.
    fn moved_reference_mas(&self) -> Option<&Array1<f64>> {
        None
    }

    /// Highest spatial frequency that the wavefronts resolve, 1/m.
    fn highest_frequency_per_m(&self) -> f64 {
        f64::INFINITY
    }

    /// Retrieves the wavefronts about the static wavefront `about`; `None` where they do not depend
    /// on it and are as before.
    ///
    /// # Errors
    /// Those of the source.
    fn retrieve(&mut self, about: Option<&StaticWavefront>) -> Result<Option<RetrievedSequence>>;
}
