//! Sections `[mirror]`, `[turbulence]`, `[wavefront_sensor]` and `[control]`: the AO system and the
//! turbulence.

use super::table::{Check, Reader, default, section, unset};
use super::value::{ANY, above, at_least, below, between, even, inside};
use super::words::{
    ControlBasis, Fill, Influence, Loop, OpticalGainMethod, ReconstructorKind, SensorDetector, SensorKind, SensorMask,
    SlopeNormalisation, SlopeOrder,
};
use crate::Result;
use std::path::PathBuf;

section! {
    /// Deformable mirror. Its influence functions give the Karhunen-Loève modes.
    MirrorScene = "mirror" {
        /// Number of actuators across the grid.
        actuators_across: usize, between(2.0, 256.0), default(21usize);
        /// Distance between neighbouring actuators, projected on the pupil.
        pitch_m: f64, above(0.0, 100.0), default(0.5625);
        /// Influence function of an actuator at the neighbouring actuator, relative to its peak.
        coupling: f64, inside(0.0, 1.0), default(0.1458);
        /// Shape of the influence functions.
        influence: Influence, ANY, default(Influence::Gaussian);
        /// Measured influence functions, in place of coupling and influence: FITS cube [actuator,
        /// y, x] of the actuators in use, row by row from the smallest y, over pupil.grid_m, or as
        /// GRID_M or PUPLSCAL say; or one image for all, about its middle pixel [rows/2,
        /// columns/2], with the card PUPLSCAL. With a card BUNIT (nm, um, m) the wavefront that a
        /// command of 1 makes, where control.matrix_command_nm is that at the actuator; without it
        /// relative to the command, near 1 at the actuator.
        influence_file: Option<PathBuf>, ANY, unset("influence functions given by influence and coupling");
        /// Map of the actuators in use: text with a line of 0s and 1s for each row, smallest y
        /// first, or a FITS image; or a file of AOT, whose mirror has their places.
        actuator_file: Option<PathBuf>, ANY, unset("actuators at the corners of subapertures in use");
        /// Largest absolute command of an actuator, in wavefront.
        stroke_limit_nm: Option<f64>, above(0.0, 1e9), unset("no limit");
    }
}

impl Check for MirrorScene {}

section! {
    /// Turbulence. Its statistics (r0_m, outer_scale_m) order the Karhunen-Loève modes; its layers
    /// are simulated.
    TurbulenceScene = "turbulence" {
        /// Fried's parameter at 500 nm.
        r0_m: f64, above(0.0, 100.0), default(0.16);
        /// Outer scale of von Kármán's spectrum.
        outer_scale_m: f64, above(0.0, 1e9), default(50.0);
        /// Fraction of the turbulence (of Cn²) in each layer, with a sum of 1. Without layers the
        /// simulation has no turbulence.
        fractions: Vec<f64>, between(0.0, 1.0), default([]);
        /// Height of each layer. Simulations on the optical axis do not depend on it.
        heights_m: Vec<f64>, between(0.0, 1e5), default([]);
        /// Wind speed in each layer.
        wind_m_s: Vec<f64>, between(0.0, 1000.0), default([]);
        /// Direction of the wind in each layer, counter-clockwise from +x, modulo 2π.
        wind_dir_rad: Vec<f64>, between(-1000.0, 1000.0), default([]);
        /// Seed of the turbulence, of the sensor's noise and of the noise of the loop's images.
        /// Simulation only.
        seed: u64, at_least(0.0), default(1u64);
    }
}

/// Largest number of layers: more than in any published profile. Each needs a phase screen.
const MOST_LAYERS: usize = 100;

impl Check for TurbulenceScene {
    fn check(&self, reader: &Reader) -> Result<()> {
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
        // Profiles printed with two or three digits sum to 1 within 1 %.
        if layers > 0 && (sum - 1.0).abs() > 0.01 {
            let sentence = format!("turbulence.fractions sum to {sum:.4}; a sum of 1 (within 0.01) is needed");
            return Err(reader.error("fractions", sentence));
        }
        Ok(())
    }
}

section! {
    /// Wavefront sensor of the AO loop. Read by simulations, and by full-phase estimates with
    /// telemetry.
    SensorScene = "wavefront_sensor" {
        /// Kind of sensor.
        kind: SensorKind, ANY, default(SensorKind::ShackHartmann);
        /// Number of lenslets across the grid.
        lenslets_across: usize, between(1.0, 256.0), default(20usize);
        /// Number of pupil samples across a lenslet.
        samples_per_lenslet: usize, even(2.0, 64.0), default(12usize);
        /// Number of detector pixels across the grid in each of the four images of the pupil, for
        /// kind = "pyramid": its subapertures.
        pixels_across: Option<usize>, between(1.0, 256.0), unset("20 for kind = \"pyramid\"");
        /// Number of pupil samples across such a pixel.
        samples_per_pixel: Option<usize>, even(2.0, 64.0), unset("6 for kind = \"pyramid\"");
        /// Radius of the pyramid's circular modulation; 0 for none.
        modulation_lambda_over_d: Option<f64>, between(0.0, 30.0), unset("3 for kind = \"pyramid\"");
        /// Number of points on the circle of the modulation, a multiple of 4.
        modulation_points: Option<usize>, between(4.0, 1024.0), unset("the least multiple of 4 from 16 on that is 2πr + 3(2πr)^(1/3) or more for a radius r");
        /// Normalisation of the slopes of a pyramid.
        slope_normalisation: Option<SlopeNormalisation>, ANY, unset("\"global\" for kind = \"pyramid\"");
        /// Detector behind the lenslets, and the calculation of slopes from its spots.
        detector: SensorDetector, ANY, default(SensorDetector::QuadCell);
        /// Least light of a subaperture in use, as a fraction of that of a fully illuminated one.
        min_light_ratio: f64, between(0.0, 1.0), default(0.5);
        /// Map of the subapertures in use: text with a line of 0s and 1s for each row, smallest y
        /// first, or a FITS image.
        subaperture_file: Option<PathBuf>, ANY, unset("subapertures with at least min_light_ratio");
        /// Number of pixels across a lenslet for detector = "pixels"; a divisor of twice
        /// samples_per_lenslet.
        pixels_per_lenslet: Option<usize>, even(2.0, 128.0), unset("the largest even divisor up to 8");
        /// Pixels across a lenslet that are read, the central ones: a field of view of field_pixels
        /// over pixels_per_lenslet of samples_per_lenslet times the wavelength over the side of a
        /// lenslet.
        field_pixels: Option<usize>, even(2.0, 128.0), unset("pixels_per_lenslet");
        /// Signal below which a pixel counts as 0, for detector = "pixels". Simulation only.
        threshold_e: f64, between(0.0, 1e9), default(0.0);
        /// Shift of the lenslets along x and y since the measurement of the interaction matrix, in
        /// subapertures.
        shift_subapertures: Vec<f64>, between(-0.5, 0.5), default([0.0, 0.0]);
        /// Rotation of the lenslets about the axis since then, counter-clockwise.
        rotation_deg: f64, between(-10.0, 10.0), default(0.0);
        /// Size of the pupil that the lenslets cover, relative to that at the measurement of the
        /// interaction matrix.
        magnification: f64, between(0.9, 1.1), default(1.0);
        /// Ratio of the slopes to those at the measurement of the interaction matrix; below 1 for
        /// spots that have grown since.
        slope_gain: f64, above(0.0, 10.0), default(1.0);
        /// Order, axes and signs of measured slopes and of the rows of measured matrices, where
        /// they are not all x, then all y, row by row: undone one after the other.
        slope_order: Vec<SlopeOrder>, ANY, default([]);
        /// Unit of measured slopes, and of those in measured matrices, as an angle on the sky;
        /// negative where they have the opposite sign. Simulations write this unit and slope_order.
        slope_unit_mas: f64, between(-1e6, 1e6), default(1.0);
        /// FITS row of the reference slopes, in the order and unit of slope_order and
        /// slope_unit_mas, about which the loop is closed: the slopes of the telemetry are those
        /// seen less these.
        reference_file: Option<PathBuf>, ANY, unset("0");
        /// FITS row, in that order and unit, or a file of 'cophase estimate --commands': by how
        /// much corrections of the NCPA have moved the reference slopes, to which the telemetry is
        /// relative. Error bars then have how well the mirror's shape is known. Estimate only.
        moved_reference_file: Option<PathBuf>, ANY, unset("0");
        /// Wavelength of the sensor.
        wavelength_nm: f64, above(0.0, 1e6), default(640.0);
        /// Photons per second and m² of a star of magnitude 0 (default: 4.01e12 / 368, the R band).
        /// Simulation only.
        zero_point_photons_s_m2: f64, above(0.0, 1e30), default(4.01e12 / 368.0);
        /// Fraction of those photons that the sensor detects. Simulation only.
        throughput: f64, above(0.0, 1.0), default(1.0);
        /// Read noise of a pixel of the sensor, RMS. Simulation only.
        read_noise_e: f64, between(0.0, 1e6), default(0.0);
        /// Magnitude of the guide star in the band of zero_point_photons_s_m2. Simulation only.
        star_magnitude_r: f64, between(-10.0, 30.0), default(4.0);
        /// Whether the sensor has photon noise. Simulation only.
        photon_noise: bool, ANY, default(true);
        /// Subapertures that are masked in the reconstruction.
        mask: SensorMask, ANY, default(SensorMask::None);
        /// Fraction of its light that one segment must have for a subaperture with two segments not
        /// to be masked, for mask = "segments".
        mask_dominant_fraction: f64, between(0.0, 1.0), default(0.75);
    }
}

/// Keys that a pyramid alone has, and those that lenslets alone have.
const PYRAMID_KEYS: [&str; 5] =
    ["pixels_across", "samples_per_pixel", "modulation_lambda_over_d", "modulation_points", "slope_normalisation"];
const LENSLET_KEYS: [&str; 6] =
    ["lenslets_across", "samples_per_lenslet", "detector", "pixels_per_lenslet", "field_pixels", "threshold_e"];

impl SensorScene {
    /// Whether the sensor is a pyramid.
    pub fn is_pyramid(&self) -> bool {
        self.kind == SensorKind::Pyramid
    }

    /// The key that sets the number of pupil samples across a subaperture.
    pub(crate) fn samples_key(&self) -> &'static str {
        if self.is_pyramid() { "samples_per_pixel" } else { "samples_per_lenslet" }
    }

    /// Refuses the keys of the other kind of sensor, and sets those of a pyramid. The pixels of a
    /// pyramid are its subapertures: the keys lenslets_across and samples_per_lenslet, which all
    /// users of subapertures read, take their numbers.
    fn complete_kind(&mut self, reader: &Reader) -> Result<()> {
        if !self.is_pyramid() {
            return reader.refuse(&PYRAMID_KEYS, "where wavefront_sensor.kind = \"shack-hartmann\"");
        }
        reader.refuse(&LENSLET_KEYS, "where wavefront_sensor.kind = \"pyramid\"")?;
        self.lenslets_across = *self.pixels_across.get_or_insert(20);
        self.samples_per_lenslet = *self.samples_per_pixel.get_or_insert(6);
        let radius = *self.modulation_lambda_over_d.get_or_insert(3.0);
        self.slope_normalisation.get_or_insert(SlopeNormalisation::Global);
        // A spot at the Nyquist frequency of the samples has no side of the edge left to move to.
        let nyquist = (self.lenslets_across * self.samples_per_lenslet) as f64 / 2.0;
        if radius >= nyquist {
            let sentence = format!(
                "wavefront_sensor.modulation_lambda_over_d = {radius} is not accepted; less than {nyquist}, half the pupil samples across the grid, is needed"
            );
            return Err(reader.error("modulation_lambda_over_d", sentence));
        }
        match self.modulation_points {
            Some(points) if !points.is_multiple_of(4) => {
                let sentence =
                    format!("wavefront_sensor.modulation_points = {points} is not accepted; a multiple of 4 is needed");
                Err(reader.error("modulation_points", sentence))
            }
            _ => Ok(()),
        }
    }
}

impl Check for SensorScene {
    fn complete(&mut self, reader: &Reader) -> Result<()> {
        self.complete_kind(reader)
    }

    fn check(&self, reader: &Reader) -> Result<()> {
        if let Some(pixels) = self.pixels_per_lenslet
            && !(2 * self.samples_per_lenslet).is_multiple_of(pixels)
        {
            let sentence = format!(
                "wavefront_sensor.pixels_per_lenslet = {pixels} is not accepted; a divisor of {}, twice samples_per_lenslet, is needed",
                2 * self.samples_per_lenslet
            );
            return Err(reader.error("pixels_per_lenslet", sentence));
        }
        if let Some(field) = self.field_pixels {
            let Some(pixels) = self.pixels_per_lenslet.filter(|_| self.detector == SensorDetector::Pixels) else {
                let sentence = "wavefront_sensor.field_pixels needs detector = \"pixels\" and pixels_per_lenslet, of which it is a part";
                return Err(reader.error("field_pixels", sentence));
            };
            if field > pixels {
                let sentence = format!(
                    "wavefront_sensor.field_pixels = {field} is not accepted; at most pixels_per_lenslet = {pixels} is needed"
                );
                return Err(reader.error("field_pixels", sentence));
            }
        }
        if self.slope_unit_mas == 0.0 {
            let sentence =
                "wavefront_sensor.slope_unit_mas = 0 is not accepted; the angle that a slope of 1 means is needed";
            return Err(reader.error("slope_unit_mas", sentence));
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
    /// Control of the AO loop; needs a section wavefront_sensor. Read by simulations, and by
    /// full-phase estimates that use the loop.
    ControlScene = "control" {
        /// Basis in which the interaction matrix is inverted.
        basis: ControlBasis, ANY, default(ControlBasis::Zonal);
        /// Calculation of commands from slopes: "dense" inverts the interaction matrix by its
        /// singular values, "sparse" solves regularised least squares in every frame, with memory
        /// and time that do not grow with the square of the actuators.
        reconstructor: ReconstructorKind, ANY, default(ReconstructorKind::Dense);
        /// Number of modes with the smallest singular values that are removed from the inversion.
        filtered_modes: Option<usize>, between(0.0, 65_536.0), unset("0, or given by condition_number");
        /// Largest ratio of singular values: modes with smaller ones than the largest over this are
        /// removed from the inversion. For reconstructor = "sparse" the regularisation of a mode
        /// that varies from actuator to actuator is that of a singular value of the largest over
        /// this; smoother modes have less.
        condition_number: Option<f64>, at_least(1.0), unset("given by filtered_modes; 10 for reconstructor = \"sparse\"");
        /// Measured interaction matrix, in place of the sensor's model: FITS image of a row for
        /// each slope and a column for each actuator in use.
        interaction_file: Option<PathBuf>, ANY, unset("the response of the modelled sensor to the modelled mirror");
        /// Command matrix of the loop, in place of an inverse of the interaction matrix: FITS image
        /// of a row for each actuator in use and a column for each slope. The loop's gain
        /// multiplies it.
        command_matrix_file: Option<PathBuf>, ANY, unset("the inverse of the interaction matrix in the basis");
        /// Wavefront that a command of 1 in these matrices adds at its actuator, as the sensor sees
        /// it. The loop subtracts gain × command matrix × slopes.
        matrix_command_nm: f64, between(-1e9, 1e9), default(1.0);
        /// Control law.
        r#loop: Loop, ANY, default(Loop::Closed);
        /// Treatment of masked slopes.
        fill: Fill, ANY, default(Fill::None);
        /// Gain of the integrator.
        gain: f64, above(0.0, 2.0), default(0.3);
        /// Leak of the integrator: fraction of the command that is lost in a frame.
        leak: f64, below(0.0, 1.0), default(0.0);
        /// Optical gains of the controlled modes: the response of a pyramid to a mode behind a
        /// residual wavefront, relative to that at the measurement of the interaction matrix.
        optical_gains: OpticalGainMethod, ANY, default(OpticalGainMethod::None);
        /// RMS over the actuators of the command of each of the four sines, at their peak, for
        /// optical_gains = "dither".
        dither_nm: f64, above(0.0, 1e4), default(10.0);
        /// Frame rate of the loop.
        frame_rate_hz: f64, above(0.0, 1e6), default(1054.0);
        /// Frames from a measurement to its correction, with a fraction where a command takes
        /// effect within a frame: the mean correction of that frame is then a mixture of both
        /// commands.
        lag_frames: f64, between(1.0, 100.0), default(1.0);
        /// Time from closing the loop to the first image.
        settle_s: f64, between(0.0, 1e6), default(1.0);
    }
}

impl Check for ControlScene {
    fn complete(&mut self, reader: &Reader) -> Result<()> {
        reader.not_both("filtered_modes", "condition_number")?;
        if self.command_matrix_file.is_some() {
            reader.refuse(
                &["basis", "filtered_modes", "condition_number"],
                "where control.command_matrix_file is given",
            )?;
        }
        if self.reconstructor == ReconstructorKind::Sparse {
            self.complete_sparse(reader)?;
        }
        if self.optical_gains == OpticalGainMethod::Dither {
            self.check_dither(reader)?;
        }
        if self.matrix_command_nm == 0.0 {
            let sentence =
                "control.matrix_command_nm = 0 is not accepted; the wavefront that a command of 1 makes is needed";
            return Err(reader.error("matrix_command_nm", sentence));
        }
        if self.condition_number.is_none() {
            self.filtered_modes.get_or_insert(0);
        }
        Ok(())
    }
}

/// Lag of a loop on the grid of its frames: the mean correction of a frame is `1 − newer` of the
/// command `frames` frames behind, and `newer` of the next command, which takes effect within the
/// frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoopLag {
    /// Frames from a measurement to the first that its command corrects as a whole.
    pub frames: usize,
    /// Share of the next command, from 0 for a whole number of frames to below 1.
    pub newer: f64,
}

impl LoopLag {
    /// Of `lag_frames` frames, 1 or more.
    pub fn new(lag_frames: f64) -> Self {
        let whole = lag_frames.ceil();
        Self { frames: whole as usize, newer: whole - lag_frames }
    }
}

/// Default of `control.condition_number` for `reconstructor = "sparse"`: the waffle of a quad cell,
/// which is measured with a sixtieth to a hundredth of the largest singular value, is then as good
/// as filtered (600 frames of keck-onsky: Strehl 0.786 with 10, 0.777 with 20; 0.784 by the
/// singular values).
const SPARSE_CONDITION_NUMBER: f64 = 10.0;

impl ControlScene {
    /// Lag of the loop.
    pub fn lag(&self) -> LoopLag {
        LoopLag::new(self.lag_frames)
    }

    /// Checks the keys that a loop with optical gains cannot have: its controlled modes must be an
    /// inverse of the interaction matrix.
    fn check_dither(&self, reader: &Reader) -> Result<()> {
        reader.refuse(&["command_matrix_file"], "where control.optical_gains = \"dither\"")?;
        if self.reconstructor == ReconstructorKind::Sparse {
            let sentence = "control.reconstructor = \"sparse\" is not accepted where control.optical_gains = \"dither\"; \"dense\" is needed";
            return Err(reader.error("reconstructor", sentence));
        }
        if self.r#loop != Loop::Closed {
            let sentence = format!(
                "control.loop = \"{}\" is not accepted where control.optical_gains = \"dither\"; \"closed\" is needed",
                self.r#loop.word()
            );
            return Err(reader.error("loop", sentence));
        }
        Ok(())
    }

    /// Checks the keys that a sparse reconstructor cannot have, and sets its regularisation.
    fn complete_sparse(&mut self, reader: &Reader) -> Result<()> {
        reader.refuse(
            &["filtered_modes", "interaction_file", "command_matrix_file"],
            "where control.reconstructor = \"sparse\"",
        )?;
        if self.basis != ControlBasis::Zonal {
            let sentence = "control.basis = \"kl\" is not accepted where control.reconstructor = \"sparse\"; basis = \"zonal\", or reconstructor = \"dense\" is needed";
            return Err(reader.error("basis", sentence));
        }
        if self.fill == Fill::Inpaint {
            let sentence = "control.fill = \"inpaint\" is not accepted where control.reconstructor = \"sparse\"; another fill, or reconstructor = \"dense\" is needed";
            return Err(reader.error("fill", sentence));
        }
        self.condition_number.get_or_insert(SPARSE_CONDITION_NUMBER);
        Ok(())
    }
}
