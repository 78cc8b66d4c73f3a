//! Settings of a MAP retrieval, with the reason for each default.

use crate::imaging::{Choice, Precision};
use crate::{Error, Result};

/// Settings of a MAP retrieval.
#[derive(Debug, Clone, PartialEq)]
pub struct RetrievalSettings {
    /// Cycles across a segment (the root of its area) that the model resolves, where the scene
    /// leaves samples and pixels open. Edges of segments carry the information on pistons. Behind
    /// Keck's loop 75 images leave 3.6 nm of phasing with 8 cycles and 4.3 nm with 6 (one draw).
    pub cycles_across_a_segment: f64,
    /// Device of the imaging chain. On the CPU each thread retrieves an image of its own; on a
    /// device a batch goes in lock-step. Where amplitudes of segments are unknowns it is always the
    /// CPU.
    pub device: Choice,
    /// Precision of the imaging chain; the optimiser's steps are always in double precision.
    pub precision: Precision,
    /// Model error (motion in an exposure, flat field) as a fraction of a pixel's signal. Its
    /// square joins the variance of the noise, so that the brightest pixels do not dominate χ².
    pub model_error: f64,
    /// Predicted decrease of the objective at which a retrieval stops, in units of χ²: a direction
    /// or two known to a standard deviation. A hundred times as much leaves an image of peak signal
    /// over noise 50 with 19 nm of error at the mirror's frequencies in place of 6.6.
    pub decrement_tolerance: f64,
    /// Fraction of the excess of χ² over its degrees of freedom that is added to
    /// `decrement_tolerance`. A perfect retrieval also leaves what the model cannot explain
    /// (turbulence finer than its samples, motion); further steps would overfit it. A fifth of this
    /// value takes two thirds more evaluations of a bright star's images, for 2.7 nm of error at
    /// the mirror's frequencies in place of 3.0.
    pub misfit_tolerance: f64,
    /// Largest batch on a device: fewer images leave it idle, more gain nothing.
    pub max_batch: usize,
    /// Most evaluations for one image.
    pub max_evaluations: usize,
    /// Pairs of steps and changes of gradient in the quasi-Newton memory. 3 do as well as 10, to 5
    /// % of the evaluations. With 16,000 numbers each they are the cost of an evaluation apart from
    /// the optics.
    pub memory: usize,
    /// Prior RMS of each segment's piston about the [`StaticWavefront`](super::StaticWavefront),
    /// nm. 0 leaves pistons to the free phase, whose power spectrum includes them: a mean over
    /// images is then unbiased by the exchange of sharp edges for a field that is nearly an edge.
    /// The error of a single image is 23 nm either way.
    pub piston_rms_nm: f64,
    /// Prior RMS of each segment's tilts, nm, where the scene estimates them.
    pub segment_tilt_rms_nm: f64,
    /// Prior RMS of the segments' amplitudes about those of the model, as a fraction; 0 takes them
    /// as known.
    pub segment_amplitude_rms: f64,
    /// Whether the scene's turbulence is that of the images: exposures are then blurred by its
    /// motion.
    pub has_known_turbulence: bool,
}

impl Default for RetrievalSettings {
    fn default() -> Self {
        Self {
            cycles_across_a_segment: 8.0,
            device: Choice::Cpu,
            precision: Precision::F32,
            model_error: 0.003,
            decrement_tolerance: 3.0,
            misfit_tolerance: 0.015,
            max_batch: 128,
            max_evaluations: 200,
            memory: 4,
            piston_rms_nm: 0.0,
            segment_tilt_rms_nm: 0.0,
            segment_amplitude_rms: 0.0,
            has_known_turbulence: false,
        }
    }
}

impl RetrievalSettings {
    /// # Errors
    /// [`Error::Value`] for the first number out of range.
    pub(super) fn check(&self) -> Result<()> {
        let numbers = [
            ("cycles_across_a_segment", self.cycles_across_a_segment),
            ("model_error", self.model_error),
            ("decrement_tolerance", self.decrement_tolerance),
            ("misfit_tolerance", self.misfit_tolerance),
            ("piston_rms_nm", self.piston_rms_nm),
            ("segment_tilt_rms_nm", self.segment_tilt_rms_nm),
            ("segment_amplitude_rms", self.segment_amplitude_rms),
        ];
        match numbers.iter().find(|(_, value)| !(value.is_finite() && *value >= 0.0)) {
            Some((name, value)) => {
                Err(Error::Value(format!("{name} is {value}, where a finite number of 0 or more is needed")))
            }
            None => Ok(()),
        }
    }
}
