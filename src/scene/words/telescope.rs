//! Words of the telescope and its modes.

use super::one_of;
use crate::scene::value::{FromToml, Range};
use std::path::PathBuf;
use toml_edit::Value;

words! {
    /// Aperture of the telescope.
    Aperture {
        /// Hexagons in rings, by default without the central one.
        Keck = "keck",
        /// Hexagons in rings, by default with the central one.
        Hexagonal = "hexagonal",
        /// Round segments in rings, of the radius `segment_side_m`, by default with the central
        /// one.
        Round = "round",
        ;
        /// A FITS file: amplitude in HDU `PUPIL`, segment labels in HDU `SEGMENT` (optional). Set
        /// by `pupil.file`.
        File(PathBuf)
    }
}

words! {
    /// Sampling of the pupil in the model.
    #[derive(Copy)]
    PupilModel {
        /// Indicator function of each segment on a fine grid, low-passed and decimated: reaches the
        /// noise bound with few samples.
        BandLimited = "band-limited",
        /// Fraction of each sample's area in each segment; a sample at a border belongs to both
        /// segments.
        Area = "area",
        /// Amplitude of each sample without a low pass; each sample belongs to one segment.
        Hard = "hard",
    }
}

words! {
    /// Segment modes that are estimated.
    #[derive(Copy)]
    SegmentModes {
        /// None, except those in `modes.file`.
        None = "none",
        /// One piston for each segment.
        Piston = "piston",
        /// Piston, tip and tilt of each segment.
        PistonTipTilt = "piston-tip-tilt",
    }
}

words! {
    /// Basis of the non-common path aberrations.
    NcpaBasis {
        /// Karhunen-Loève modes of the mirror's influence functions under the turbulence's
        /// statistics.
        Kl = "kl",
        /// Zernike polynomials in Noll's order, from tip on.
        Zernike = "zernike",
        /// No basis (`modes.exact_zernikes` can still be estimated).
        None = "none",
        ;
        /// Modes from a FITS file, used without changes. Set by `modes.file`.
        File(PathBuf)
    }
}
