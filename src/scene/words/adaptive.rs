//! Words of the AO system.

use super::one_of;
use crate::scene::value::{FromToml, Range};
use toml_edit::Value;

words! {
    /// Order, axes or signs of measured slopes, relative to all x and then all y over the
    /// subapertures in use, row by row.
    #[derive(Copy)]
    SlopeOrder {
        /// All x, then all y, subapertures row by row.
        Expected = "x-then-y",
        /// Along y first, then along x.
        YBeforeX = "y-then-x",
        /// x and y of each subaperture in turn.
        Interleaved = "interleaved",
        /// Subapertures column by column.
        ColumnMajor = "column-major",
        /// The slopes along x have the opposite sign.
        OppositeX = "opposite-x",
        /// The slopes along y have the opposite sign.
        OppositeY = "opposite-y",
        /// Positions and signs mirrored, left to right.
        FlippedX = "flipped-x",
        /// Positions and signs mirrored, up to down.
        FlippedY = "flipped-y",
        /// Both: rotated by 180°.
        Rotated180 = "rotated-180",
        /// x and y exchanged, positions too.
        Transposed = "transposed",
        /// Rotated by 90°, one way or the other.
        Rotated90 = "rotated-90",
        /// As [`SlopeOrder::Rotated90`], the other way.
        Rotated270 = "rotated-270",
        /// x and y exchanged about the other diagonal.
        TransposedBack = "transposed-back",
    }
}

words! {
    /// Shape of an actuator's influence function.
    #[derive(Copy)]
    Influence {
        /// `coupling^(r²/pitch²)`: 1 at the actuator, `coupling` at its neighbour.
        Gaussian = "gaussian",
    }
}

words! {
    /// Kind of wavefront sensor.
    #[derive(Copy)]
    SensorKind {
        /// An array of lenslets.
        ShackHartmann = "shack-hartmann",
        /// A four-sided pyramid in the focus, with a circular modulation, and four images of the
        /// pupil behind it.
        Pyramid = "pyramid",
    }
}

words! {
    /// Measurement of the optical gains of a sensor whose response depends on the residual
    /// wavefront.
    #[derive(Copy)]
    OpticalGainMethod {
        /// None: modes have the response of the calibration.
        None = "none",
        /// Sines of a few modes on the mirror, found again in the slopes; each mode is divided by
        /// its gain.
        Dither = "dither",
    }
}

words! {
    /// Normalisation of the slopes of a pyramid sensor.
    #[derive(Copy)]
    SlopeNormalisation {
        /// Differences of a pixel's four intensities over their mean sum in all pixels in use
        /// (Vérinaud 2004, Opt. Commun. 233, 27).
        Global = "global",
        /// Differences of a pixel's four intensities over their own sum (Ragazzoni 1996, J. Mod.
        /// Opt. 43, 289).
        Pixel = "pixel",
    }
}

words! {
    /// Detector behind a lenslet, and the calculation of slopes.
    #[derive(Copy)]
    SensorDetector {
        /// Diffracted spot on four pixels; slope: difference of the two halves over their sum.
        QuadCell = "quad-cell",
        /// Diffracted spot on `pixels_per_lenslet` pixels a side; slope: centre of gravity.
        Pixels = "pixels",
        /// No diffraction and no noise; slope: mean slope of the wavefront over the lenslet.
        Geometric = "geometric",
    }
}

words! {
    /// Subapertures that are masked in the reconstruction.
    #[derive(Copy)]
    SensorMask {
        /// None.
        None = "none",
        /// Those that straddle segments: no segment has `mask_dominant_fraction` of their light.
        Segments = "segments",
    }
}

words! {
    /// Basis in which the interaction matrix is inverted.
    #[derive(Copy)]
    ControlBasis {
        /// Actuators.
        Zonal = "zonal",
        /// Karhunen-Loève modes of the mirror.
        Kl = "kl",
    }
}

words! {
    /// Calculation of commands from slopes.
    #[derive(Copy)]
    ReconstructorKind {
        /// A truncated inverse of the interaction matrix, by its singular values: one dense matrix.
        Dense = "dense",
        /// Regularised least squares, solved in every frame with a banded factorisation of the
        /// normal equations.
        Sparse = "sparse",
    }
}

words! {
    /// Control law.
    #[derive(Copy)]
    Loop {
        /// Integrator on the residual slopes.
        Closed = "closed",
        /// The mirror's own slopes are added before the reconstruction.
        PseudoOpenLoop = "pseudo-open-loop",
        /// The mirror's own slopes are added for `fill = "inpaint"` and subtracted again before the
        /// integrator.
        FullTurbulenceSlopes = "full-turbulence-slopes",
    }
}

words! {
    /// Treatment of masked slopes.
    #[derive(Copy)]
    Fill {
        /// The measured values are used.
        None = "none",
        /// Their rows are removed from the interaction matrix.
        MaskInteractionMatrix = "mask-interaction-matrix",
        /// They are replaced by values inpainted from their neighbours.
        Inpaint = "inpaint",
    }
}
