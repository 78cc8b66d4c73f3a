//! `[mirror]`, `[turbulence]`, `[wavefront_sensor]` and `[control]`: the adaptive optics and what they correct.

use super::table::{Check, Reader, default, section, unset};
use super::value::{ANY, above, at_least, below, between, even, inside};
use super::words::{ControlBasis, Fill, Influence, Loop, SensorDetector, SensorKind, SensorMask};
use crate::Result;
use std::path::PathBuf;

section! {
    /// The deformable mirror; its influence functions give the Karhunen-Loève modes.
    MirrorScene = "mirror" {
        /// Actuators across the grid.
        actuators_across: usize, between(2.0, 256.0), default(21usize);
        /// Distance between neighbouring actuators, on the pupil.
        pitch_m: f64, above(0.0, 100.0), default(0.5625);
        /// Influence of an actuator at its neighbour, as a fraction of its own.
        coupling: f64, inside(0.0, 1.0), default(0.1458);
        /// Shape of an actuator's influence.
        influence: Influence, ANY, default(Influence::Gaussian);
        /// Map of the actuators in use, text: a line of 0s and 1s for each row, smallest y first.
        actuator_file: Option<PathBuf>, ANY, unset("those near the pupil's glass");
        /// Largest command of an actuator either way, nm of wavefront.
        stroke_limit_nm: Option<f64>, above(0.0, 1e9), unset("no limit");
    }
}

impl Check for MirrorScene {}

section! {
    /// The turbulence; its statistics order the Karhunen-Loève modes.
    TurbulenceScene = "turbulence" {
        /// Fried's parameter at 500 nm.
        r0_m: f64, above(0.0, 100.0), default(0.16);
        /// Von Kármán's outer scale.
        outer_scale_m: f64, above(0.0, 1e9), default(50.0);
        /// Share of each layer in the turbulence; they sum to 1. Without layers nothing moves.
        fractions: Vec<f64>, between(0.0, 1.0), default([]);
        /// Height of each layer.
        heights_m: Vec<f64>, between(0.0, 1e5), default([]);
        /// Wind speed in each layer.
        wind_m_s: Vec<f64>, between(0.0, 1000.0), default([]);
        /// Wind direction in each layer, counter-clockwise from +x, modulo 2π.
        wind_dir_rad: Vec<f64>, between(-1000.0, 1000.0), default([]);
        /// Seed of the screens and of the sensor's noise.
        seed: u64, at_least(0.0), default(1u64);
    }
}

/// More layers than any published profile; each costs a phase screen.
const MOST_LAYERS: usize = 100;

impl Check for TurbulenceScene {
    fn check(&mut self, reader: &Reader) -> Result<()> {
        let layers = self.fractions.len();
        if layers > MOST_LAYERS {
            let sentence = format!("turbulence.fractions has {layers} layers; at most {MOST_LAYERS} are accepted");
            return Err(reader.error("fractions", sentence));
        }
        let lists =
            [("heights_m", &self.heights_m), ("wind_m_s", &self.wind_m_s), ("wind_dir_rad", &self.wind_dir_rad)];
        if let Some((key, list)) = lists.iter().find(|(_, list)| list.len() != layers) {
            let sentence = format!(
                "turbulence.{key} has {} values but turbulence.fractions has {layers}; one for each layer is needed",
                list.len()
            );
            return Err(reader.error(key, sentence));
        }
        let sum: f64 = self.fractions.iter().sum();
        // A profile printed with two or three digits sums to 1 within a percent.
        if layers > 0 && (sum - 1.0).abs() > 0.01 {
            let sentence = format!("turbulence.fractions sum to {sum:.4}; a sum of 1 (within 0.01) is needed");
            return Err(reader.error("fractions", sentence));
        }
        Ok(())
    }
}

section! {
    /// The wavefront sensor of the AO loop.
    SensorScene = "wavefront_sensor" {
        /// Kind of sensor.
        kind: SensorKind, ANY, default(SensorKind::ShackHartmann);
        /// Lenslets across the grid.
        lenslets_across: usize, between(1.0, 256.0), default(20usize);
        /// Pupil samples across a lenslet.
        samples_per_lenslet: usize, even(2.0, 64.0), default(12usize);
        /// How a spot becomes slopes.
        detector: SensorDetector, ANY, default(SensorDetector::QuadCell);
        /// Least light of a subaperture that is used, as a fraction of a full one.
        min_light_ratio: f64, between(0.0, 1.0), default(0.5);
        /// Map of the subapertures in use, text: a line of 0s and 1s for each row, smallest y first.
        subaperture_file: Option<PathBuf>, ANY, unset("what min_light_ratio says");
        /// Pixels across a lenslet of detector = "pixels"; they divide twice samples_per_lenslet.
        pixels_per_lenslet: Option<usize>, even(2.0, 128.0), unset("8, or the largest that divides evenly below");
        /// detector = "pixels": pixels with less than this count as dark.
        threshold_e: f64, between(0.0, 1e9), default(0.0);
        /// How far the lenslets have moved along x and y since the interaction matrix was taken, in subapertures.
        shift_subapertures: Vec<f64>, between(-0.5, 0.5), default([0.0, 0.0]);
        /// Slopes over those when the interaction matrix was taken: below 1 where spots have grown since.
        slope_gain: f64, above(0.0, 10.0), default(1.0);
        /// Wavelength at which the sensor works.
        wavelength_nm: f64, above(0.0, 1e6), default(640.0);
        /// Photons of a star of magnitude 0 (default: 4.01e12 / 368, the R band).
        zero_point_photons_s_m2: f64, above(0.0, 1e30), default(4.01e12 / 368.0);
        /// Share of those photons that the sensor detects.
        throughput: f64, above(0.0, 1.0), default(1.0);
        /// Read noise of a pixel, RMS electrons.
        read_noise_e: f64, between(0.0, 1e6), default(0.0);
        /// R magnitude of the guide star.
        star_magnitude_r: f64, between(-10.0, 30.0), default(4.0);
        /// Whether the sensor has photon noise.
        photon_noise: bool, ANY, default(true);
        /// Which subapertures the reconstructor leaves out.
        mask: SensorMask, ANY, default(SensorMask::None);
        /// mask = "segments": a subaperture stays where one segment holds this share of its light.
        mask_dominant_fraction: f64, between(0.0, 1.0), default(0.75);
    }
}

impl Check for SensorScene {
    fn check(&mut self, reader: &Reader) -> Result<()> {
        if let Some(pixels) = self.pixels_per_lenslet
            && !(2 * self.samples_per_lenslet).is_multiple_of(pixels)
        {
            let sentence = format!(
                "wavefront_sensor.pixels_per_lenslet = {pixels} does not divide {}, twice samples_per_lenslet, as it must",
                2 * self.samples_per_lenslet
            );
            return Err(reader.error("pixels_per_lenslet", sentence));
        }
        if self.shift_subapertures.len() != 2 {
            let count = self.shift_subapertures.len();
            let sentence = format!("wavefront_sensor.shift_subapertures has {count} values; [x, y] is needed");
            return Err(reader.error("shift_subapertures", sentence));
        }
        Ok(())
    }
}

section! {
    /// The control of the AO loop; needs a wavefront sensor.
    ControlScene = "control" {
        /// The space in which the slopes are inverted.
        basis: ControlBasis, ANY, default(ControlBasis::Zonal);
        /// Weakest modes left out of the inversion; 0 unless condition_number is given.
        filtered_modes: Option<usize>, between(0.0, 65_536.0), unset("0, or what condition_number gives");
        /// Modes weaker than the strongest by more than this factor are left out of the inversion.
        condition_number: Option<f64>, at_least(1.0), unset("what filtered_modes says");
        /// How the loop is closed.
        r#loop: Loop, ANY, default(Loop::Closed);
        /// What stands in for masked slopes.
        fill: Fill, ANY, default(Fill::None);
        /// Gain of the integrator.
        gain: f64, above(0.0, 2.0), default(0.3);
        /// Share of the command that leaks away in a frame.
        leak: f64, below(0.0, 1.0), default(0.0);
        /// Frames per second.
        frame_rate_hz: f64, above(0.0, 1e6), default(1054.0);
        /// Frames from a measurement to its correction.
        lag_frames: usize, between(1.0, 100.0), default(1usize);
        /// Loop time before the first image.
        settle_s: f64, between(0.0, 1e6), default(1.0);
    }
}

impl Check for ControlScene {
    fn check(&mut self, reader: &Reader) -> Result<()> {
        reader.not_both("filtered_modes", "condition_number")?;
        if self.condition_number.is_none() {
            self.filtered_modes.get_or_insert(0);
        }
        Ok(())
    }
}
