//! Section `[faults]`: faults planted in simulated images.

use super::table::{Check, default, section};
use super::value::between;

section! {
    /// Faults planted in simulated images, to test the robustness of estimates. Simulation only.
    FaultScene = "faults" {
        /// RMS of the segment reflectivities about 1. Needs a section aberrations.
        segment_reflectivity_rms: f64, between(0.0, 0.3), default(0.0);
        /// RMS drift of the segment pistons, and of the NCPA, in nm per minute: linear in time, 0
        /// at the middle of the sequence. Needs a section aberrations, and an AO simulation.
        drift_nm_per_min: f64, between(0.0, 1e6), default(0.0);
        /// RMS of the pixel responses about 1, drawn with aberrations.seed.
        pixel_response_rms: f64, between(0.0, 0.3), default(0.0);
    }
}

impl Check for FaultScene {}
