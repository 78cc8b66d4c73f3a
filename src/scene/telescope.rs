//! `[pupil]`, `[image]` and `[aberrations]`: the telescope, its camera, and the truth of a simulated image.

use super::lists::Zernikes;
use super::purpose::Purpose;
use super::table::{Check, Reader, default, required, section, unset};
use super::value::{ANY, above, at_least, between, even};
use super::words::{Aperture, Crop, PupilModel};
use crate::Result;
use std::path::PathBuf;

section! {
    /// The telescope's pupil.
    PupilScene = "pupil" {
        /// Hexagons in rings; "keck" and "hexagonal" differ in the default of central_segment only.
        aperture: Aperture, ANY, default(Aperture::Keck);
        /// FITS pupil in place of hexagons: HDU PUPIL (amplitude) and, optional, SEGMENT (labels); needs grid_m.
        file: Option<PathBuf>, ANY, unset("hexagons, as aperture says");
        /// Rings of hexagons around the centre.
        rings: usize, between(0.0, 30.0), default(3usize);
        /// Side of a segment.
        segment_side_m: f64, above(0.0, 100.0), default(0.9);
        /// Distance between the edges of neighbouring segments: centres are √3·side + gap apart.
        segment_gap_m: f64, between(0.0, 10.0), default(0.003);
        /// Whether the central segment is there; true by default where aperture is "hexagonal".
        central_segment: bool, ANY, default(false);
        /// Diameter of the round central obscuration; 0 is none.
        central_obscuration_m: f64, between(0.0, 1000.0), default(0.0);
        /// Width of the spider's vanes; 0 is no spider.
        spider_width_m: f64, between(0.0, 10.0), default(0.0);
        /// Directions of the spider's lines through the centre, counter-clockwise from +x; two vanes each.
        spider_angles_deg: Vec<f64>, between(-360.0, 360.0), default([0.0, 60.0, 120.0]);
        /// Rotation of segments and spiders about the axis, counter-clockwise; modes, diversity and mirror stay.
        rotation_deg: f64, between(-360.0, 360.0), default(0.0);
        /// Side of the square grid; λ/D means λ/grid_m.
        grid_m: Option<f64>, above(0.0, 1000.0), unset("the smallest that holds the pupil");
        /// Samples along a side of the estimator's grid; a file with more is a fine map.
        samples: usize, even(16.0, 2048.0), default(120usize);
        /// How the model samples the pupil.
        model: Option<PupilModel>, ANY, unset("\"band-limited\"; for a file \"hard\", unless the file is a fine map");
        /// Band-limited model: up to this frequency the low pass is 1, in cycles per grid width.
        band_pass_cycles: Option<f64>, above(0.0, 1024.0), unset("what the image needs");
        /// Band-limited model: from this frequency on the low pass is 0, in cycles per grid width.
        band_stop_cycles: Option<f64>, above(0.0, 2048.0), unset("samples - band_pass_cycles");
    }
}

impl PupilScene {
    /// Side of the smallest square, centred on the axis, that holds the hexagons, m; `None` for a pupil from a file.
    ///
    /// Centres stand `p = √3·side + gap` apart, the outermost of R rings' corners `R·p` from the axis at 30° + k·60°, and the
    /// vertices of each hexagon `side` from its centre at k·60°: along u the mirror reaches the largest `R·p·cos` of the
    /// one and the largest `side·cos` of the other, of the angles to u.
    pub fn extent_m(&self) -> Option<f64> {
        if matches!(self.aperture, Aperture::File(_)) {
            return None;
        }
        let (side, reach) =
            (self.segment_side_m, self.rings as f64 * (3f64.sqrt() * self.segment_side_m + self.segment_gap_m));
        // The cosine of the least angle between u and one of six directions, the first of them at `first`.
        let nearest = |u_deg: f64, first_deg: f64| {
            let off_deg = (u_deg - first_deg - self.rotation_deg).rem_euclid(60.0);
            off_deg.min(60.0 - off_deg).to_radians().cos()
        };
        let along = |u_deg| reach * nearest(u_deg, 30.0) + side * nearest(u_deg, 0.0);
        Some(2.0 * f64::max(along(0.0), along(90.0)))
    }

    fn check_file(&self, file: &std::path::Path, reader: &Reader) -> Result<()> {
        reader.not_both("aperture", "file")?;
        let geometry = ["rings", "segment_side_m", "segment_gap_m", "central_segment", "rotation_deg"];
        let blocked = ["central_obscuration_m", "spider_width_m", "spider_angles_deg"];
        reader.refuse(&[geometry.as_slice(), &blocked].concat(), "where the pupil comes from a file")?;
        if self.grid_m.is_none() && reader.source.purpose == Purpose::Whole {
            let file = file.display();
            return Err(reader.error(
                "file",
                format_args!("'pupil.grid_m' is missing; the width of the grid of {file}, in m, is needed"),
            ));
        }
        Ok(())
    }

    fn check_geometry(&self, extent_m: f64, reader: &Reader) -> Result<()> {
        let Self { segment_side_m: side, segment_gap_m: gap, central_obscuration_m: obscuration, rings, .. } = *self;
        if gap >= side {
            let sentence = format_args!(
                "pupil.segment_gap_m = {gap} is not accepted; less than segment_side_m = {side} is needed"
            );
            return Err(reader.error("segment_gap_m", sentence));
        }
        if rings == 0 && !self.central_segment {
            let sentence = "pupil.rings = 0 without a central segment leaves no segment; rings from 1 or central_segment = true is needed";
            return Err(reader.error("rings", sentence));
        }
        if obscuration >= extent_m {
            let sentence = format!(
                "pupil.central_obscuration_m = {obscuration} hides the whole pupil; a diameter below the pupil's {extent_m:.4} m is needed"
            );
            return Err(reader.error("central_obscuration_m", sentence));
        }
        // A grid written with a few digits less than the extent's is meant to hold it: a part in 10⁹ is far below a sample.
        match self.grid_m {
            Some(grid_m) if grid_m * (1.0 + 1e-9) < extent_m => {
                let sentence = format!(
                    "pupil.grid_m = {grid_m} is not accepted; {rings} rings of hexagons of side {side} m are {extent_m:.4} m across and need a grid that holds them"
                );
                Err(reader.error("grid_m", sentence))
            }
            _ => Ok(()),
        }
    }

    fn check_band(&self, reader: &Reader) -> Result<()> {
        if matches!(self.model, Some(PupilModel::Area | PupilModel::Hard)) {
            reader
                .refuse(&["band_pass_cycles", "band_stop_cycles"], "where the pupil's model is not \"band-limited\"")?;
        }
        let samples = self.samples;
        if let Some(pass) = self.band_pass_cycles.filter(|&pass| 2.0 * pass >= samples as f64) {
            let sentence = format!(
                "pupil.band_pass_cycles = {pass} is not accepted; less than half of samples = {samples} is needed"
            );
            return Err(reader.error("band_pass_cycles", sentence));
        }
        match (self.band_pass_cycles, self.band_stop_cycles) {
            (pass, Some(stop)) if stop > samples as f64 || pass.is_some_and(|pass| pass >= stop) => {
                let sentence = format!(
                    "pupil.band_stop_cycles = {stop} is not accepted; more than band_pass_cycles and at most samples = {samples} is needed"
                );
                Err(reader.error("band_stop_cycles", sentence))
            }
            _ => Ok(()),
        }
    }
}

impl Check for PupilScene {
    fn check(&mut self, reader: &Reader) -> Result<()> {
        if let Some(file) = &self.file {
            self.check_file(file, reader)?;
            self.aperture = Aperture::File(file.clone());
        } else {
            self.model.get_or_insert(PupilModel::BandLimited);
            if !reader.named("central_segment") {
                self.central_segment = self.aperture == Aperture::Hexagonal;
            }
        }
        if let Some(extent_m) = self.extent_m().filter(|_| reader.source.purpose == Purpose::Whole) {
            self.check_geometry(extent_m, reader)?;
        }
        self.check_band(reader)
    }
}

section! {
    /// The camera and its images.
    ImageScene = "image" {
        /// Wavelength.
        wavelength_nm: f64, between(100.0, 100_000.0), required();
        /// Full width of the filter over the wavelength; 0 is monochromatic.
        bandwidth_fraction: f64, between(0.0, 0.5), default(0.0);
        /// Detector pixels per λ/grid_m.
        samples_per_lambda_over_d: f64, above(0.0, 64.0), default(2.0);
        /// Pixels along a side of the image.
        pixels: usize, even(8.0, 8192.0), required();
        /// Columns of a detector frame: the middle of the image's, its axis at half of them; at most pixels.
        columns: Option<usize>, even(8.0, 8192.0), unset("pixels");
        /// Rows of a detector frame, likewise.
        rows: Option<usize>, even(8.0, 8192.0), unset("pixels");
        /// Pixels along a side of the part that is fitted; "auto" is what carries signal.
        crop_pixels: Crop, even(8.0, 8192.0), default(Crop::Auto);
        /// Exposure of one image; 0 freezes the turbulence.
        exposure_s: f64, between(0.0, 86_400.0), default(0.01);
        /// Focus added for the diversity, in waves RMS over the pupil, positive at its edge; 1.5 unless diversity_file is given.
        diversity_focus_waves_rms: f64, between(-20.0, 20.0), default(1.5);
        /// FITS map of the diversity, nm on the pupil's grid, in place of a focus.
        diversity_file: Option<PathBuf>, ANY, unset("a focus");
        /// Signal over noise at the brightest pixel of a simulated image; 500 unless flux_e is given.
        peak_snr: Option<f64>, above(0.0, 1e9), unset("500, or what flux_e gives");
        /// Electrons of the star in a simulated image.
        flux_e: Option<f64>, above(0.0, 1e18), unset("what peak_snr asks");
        /// Read noise of a pixel, RMS electrons.
        read_noise_e: f64, between(0.0, 1e9), default(0.0);
        /// Background of a pixel in a simulated image.
        background_e: f64, between(0.0, 1e12), default(0.0);
        /// Whether a simulated image has photon noise.
        photon_noise: bool, ANY, default(true);
        /// RMS over a simulated detector of its pixels' responses about 1.
        pixel_response_rms: f64, between(0.0, 0.3), default(0.0);
        /// Side of the square over which a pixel of a simulated image gathers light, over the pitch; 0 is a point.
        pixel_fill: f64, between(0.0, 1.0), default(0.0);
        /// Images in a simulated sequence.
        count: usize, between(1.0, 1e6), default(1usize);
        /// From the start of one image to the start of the next; 0 is back to back.
        interval_s: f64, between(0.0, 1e6), default(0.0);
        /// Whether the detector's columns run against +x.
        flip_x: bool, ANY, default(false);
        /// Whether the detector's rows run against +y.
        flip_y: bool, ANY, default(false);
    }
}

impl ImageScene {
    /// Rows and columns of a detector frame.
    pub fn frame_shape(&self) -> (usize, usize) {
        (self.rows.unwrap_or(self.pixels), self.columns.unwrap_or(self.pixels))
    }
}

impl Check for ImageScene {
    fn check(&mut self, reader: &Reader) -> Result<()> {
        reader.not_both("peak_snr", "flux_e")?;
        reader.not_both("diversity_focus_waves_rms", "diversity_file")?;
        if self.flux_e.is_none() {
            self.peak_snr.get_or_insert(500.0);
        }
        if self.diversity_file.is_some() {
            self.diversity_focus_waves_rms = 0.0;
        }
        let (pixels, exposure_s, interval_s) = (self.pixels, self.exposure_s, self.interval_s);
        for (key, value) in [("columns", self.columns), ("rows", self.rows)] {
            if let Some(value) = value.filter(|&value| value > pixels) {
                let sentence =
                    format!("image.{key} = {value} is not accepted; at most image.pixels = {pixels} is needed");
                return Err(reader.error(key, sentence));
            }
        }
        let (rows, columns) = self.frame_shape();
        let (larger, key) = match (rows.max(columns), rows > columns) {
            (larger, _) if larger == pixels => (larger, "pixels"),
            (larger, true) => (larger, "rows"),
            (larger, false) => (larger, "columns"),
        };
        if let Crop::Pixels(crop) = self.crop_pixels
            && crop > larger
        {
            let sentence =
                format!("image.crop_pixels = {crop} is not accepted; at most image.{key} = {larger} is needed");
            return Err(reader.error("crop_pixels", sentence));
        }
        if interval_s > 0.0 && interval_s < exposure_s {
            let sentence = format!(
                "image.interval_s = {interval_s} is not accepted; 0 (back to back) or at least exposure_s = {exposure_s} is needed"
            );
            return Err(reader.error("interval_s", sentence));
        }
        Ok(())
    }
}

section! {
    /// The truth of a simulated image; without this section the wavefront is flat.
    AberrationScene = "aberrations" {
        /// RMS over the segments of their pistons.
        segment_piston_rms_nm: f64, between(0.0, 1e6), default(0.0);
        /// RMS over the pupil of the segments' tips and tilts.
        segment_tip_tilt_rms_nm: f64, between(0.0, 1e6), default(0.0);
        /// RMS over the segments of their reflectivities about 1.
        segment_reflectivity_rms: f64, between(0.0, 0.3), default(0.0);
        /// RMS over the pupil of the non-common path aberrations.
        ncpa_rms_nm: f64, between(0.0, 1e6), default(0.0);
        /// First and last Noll index of the Zernikes that they are made of.
        ncpa_zernikes: Zernikes, between(1.0, 1000.0), default(Zernikes::Span { first: 4, last: 18 });
        /// The variance of a Zernike goes as its radial order to this power.
        ncpa_power_law: f64, between(-20.0, 20.0), default(-2.0);
        /// FITS map of the non-common path aberrations, nm, in place of Zernikes.
        ncpa_file: Option<PathBuf>, ANY, unset("Zernikes");
        /// RMS by which the pistons drift in a minute, and as much the NCPA: evenly, about the middle of a loop's images.
        drift_nm_per_min: f64, between(0.0, 1e6), default(0.0);
        /// Samples along a side of the grid on which the truth is made.
        truth_samples: Option<usize>, even(16.0, 16_384.0), unset("8 for each of the pupil's, or those of its file");
        /// Seed of the draw, and of the images' noise.
        seed: u64, at_least(0.0), default(1u64);
    }
}

impl Check for AberrationScene {
    fn check(&mut self, reader: &Reader) -> Result<()> {
        if self.ncpa_file.is_some() {
            let zernikes = ["ncpa_rms_nm", "ncpa_zernikes", "ncpa_power_law"];
            reader.refuse(&zernikes, "where the non-common path aberrations come from a file")?;
        }
        if self.ncpa_rms_nm > 0.0 && self.ncpa_zernikes == Zernikes::None {
            let rms_nm = self.ncpa_rms_nm;
            let sentence = format!(
                "aberrations.ncpa_zernikes is empty but ncpa_rms_nm = {rms_nm}; [first, last] Noll index is needed"
            );
            return Err(reader.error("ncpa_zernikes", sentence));
        }
        Ok(())
    }
}
