//! Words of an estimate.

use super::one_of;
use crate::scene::value::{FromToml, Range};
use toml_edit::Value;

words! {
    /// Optimiser and recipe of a fit.
    #[derive(Copy)]
    Optimizer {
        /// Noise-weighted maximum likelihood: limited-memory BFGS in the metric of the Gauss-Newton
        /// matrix.
        GaussNewton = "gauss-newton",
        /// The paper's method: hard-edged pupil, only the scene's modes, no weights, BFGS from
        /// zero.
        Bfgs = "bfgs",
        /// The paper's objective, minimised by the optimiser of [`Optimizer::GaussNewton`]: the
        /// same minimum with a tenth of the evaluations.
        Paper = "paper",
    }
}

words! {
    /// Combination of the images of a sequence, mode by mode.
    #[derive(Copy)]
    Combine {
        /// Mean of all images whose fit converged.
        Mean = "mean",
        /// Median of these images.
        Median = "median",
        /// Mean without outliers.
        ClippedMean = "clipped-mean",
    }
}

words! {
    /// Weight of each pixel in a fit.
    #[derive(Copy)]
    Weighting {
        /// Inverse of the pixel's variance from photon and read noise.
        Noise = "noise",
        /// Equal weights.
        None = "none",
    }
}

words! {
    /// Pixels on which image and model are compared.
    #[derive(Copy)]
    Sampling {
        /// The faster one without loss: two pixels per λ/D where these are fewer, no pixel is bad,
        /// and the frame cuts off no light.
        Auto = "auto",
        /// The detector's pixels.
        Native = "native",
        /// Two pixels per λ/D.
        Nyquist = "nyquist",
    }
}

words! {
    /// Precision of the imaging chain.
    #[derive(Copy)]
    Precision {
        /// Double precision.
        F64 = "f64",
        /// Single precision.
        F32 = "f32",
    }
}

words! {
    /// Model of an estimate.
    #[derive(Copy)]
    ModelChoice {
        /// That of the scene, extended where it does not explain the images.
        Auto = "auto",
        /// That of the scene.
        Scene = "scene",
    }
}

words! {
    /// Estimator.
    #[derive(Copy)]
    Method {
        /// Fit of static modes to each image.
        Modal = "modal",
        /// Maximum a posteriori retrieval of the wavefront of each image, and of the static errors
        /// from all images.
        FullPhase = "full-phase",
        /// `FullPhase` where the scene has an AO loop or turbulence and the images change from one
        /// to the next by more than their noise; else `Modal`.
        Auto = "auto",
    }
}

words! {
    /// Knowledge of the AO system that a full-phase estimate uses; each level includes those before
    /// it.
    #[derive(Copy, PartialOrd, Ord)]
    AoKnowledge {
        /// Only the mirror's pitch; the residual wavefront has a typical spectrum.
        Nothing = "nothing",
        /// Spectrum of the residual wavefront, from the scene's turbulence and control.
        Spectrum = "spectrum",
        /// Response of the closed loop to the segments, from a noise-free, turbulence-free
        /// simulation.
        Loop = "loop",
        /// Slopes that the sensor measured during each exposure.
        Telemetry = "telemetry",
    }
}

words! {
    /// Use of telemetry that comes with the images of a full-phase estimate.
    #[derive(Copy)]
    Telemetry {
        /// It is compared with the retrieved wavefronts, and refused where it does not belong to
        /// them.
        Check = "check",
        /// It is compared, and used all the same, divided by the gain that was found.
        Use = "use",
        /// It is not used.
        Ignore = "ignore",
    }
}

words! {
    /// What is minimised by moving segments.
    #[derive(Copy)]
    SegmentConvention {
        /// The sum of the squares of all segment modes. A segment in the deadband stays,
        /// independently of its neighbours.
        LeastSquares = "least-squares",
        /// The sum of the squares of the steps at the edges that neighbouring segments share; of
        /// pistons alone. Where all segments move this is the same correction; beside a segment
        /// that stays, its neighbours meet it.
        EdgeMinimising = "edge-minimising",
    }
}
