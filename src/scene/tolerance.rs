//! Section `[tolerance]`: how well the instrument is known.

use super::purpose::Purpose;
use super::table::{Check, Reader, Section, Source, default, section};
use super::value::between;
use crate::Result;

section! {
    /// Standard deviations of what the scene takes to be exact, within which the images decide,
    /// and which the error bars hold unless estimate.posterior = false; 0 is exact. Estimate only.
    ToleranceScene = "tolerance" {
        /// Amplitude of the defocus, or of the diversity from a file: an error of it appears as
        /// NCPA, and one image does not show it. It is in the error bars of every method.
        defocus_fraction: f64, between(0.0, 1.0), default(0.0);
        /// Scale of the image along x and along y, and its shear.
        pixel_scale_fraction: f64, between(0.0, 0.1), default(1e-3);
        /// Angle of the camera.
        rotation_deg: f64, between(0.0, 10.0), default(0.1);
        /// Gain of one half of the detector over the other, along x, along y, and of two opposite
        /// quadrants over the others.
        gain_fraction: f64, between(0.0, 1.0), default(0.01);
        /// Loss of the detector's response at the peak of the star.
        response_fraction: f64, between(0.0, 1.0), default(0.02);
        /// Light in a halo with a scale length of 10 pixels.
        halo_fraction: f64, between(0.0, 1.0), default(0.01);
        /// RMS of a blur along an axis, pixels: jitter, or charge that spreads.
        blur_pixels: f64, between(0.0, 2.0), default(0.1);
        /// Slopes of the illumination of the pupil along x and y, and its rise to the rim, as in
        /// pupil.illumination_x.
        illumination_fraction: f64, between(0.0, 1.0), default(0.1);
        /// Focus and two astigmatisms that all segments share, RMS of each.
        common_figure_nm: f64, between(0.0, 1000.0), default(5.0);
    }
}

impl Check for ToleranceScene {}

impl ToleranceScene {
    /// Those of a scene that names none.
    ///
    /// # Errors
    /// None: every key has a default.
    pub(super) fn usual() -> Result<Self> {
        let source = Source { name: "", text: "", purpose: Purpose::Whole, settings: &[] };
        Self::read(&Reader { source, section: Self::NAME, item: None })
    }
}
