//! Sections `[image]` and `[aberrations]`: science camera, true aberrations of simulated images.

use super::forms;
use super::lists::NollRange;
use super::purpose::Purpose;
use super::table::{Check, Reader, Section, Source, default, required, section, unset};
use super::value::{ANY, above, at_least, between, even};
use super::words::Crop;
use crate::Result;
use std::path::PathBuf;

/// Least sampling with which the area of a pixel is modelled on the samples of the image: they hold
/// all of its spatial frequencies from 2 pixels per λ/D on, and all but the last 5 %, where the
/// contrast is 1.4 % or less, from 1.9 on.
const LEAST_SAMPLING_OF_PIXELS: f64 = 1.9;

section! {
    /// Science camera and its images.
    ImageScene = "image" {
        /// Wavelength of the filter, to which its sampling and the waves of the diversity belong:
        /// its middle, or one that filter_file passes.
        wavelength_nm: f64, between(100.0, 100_000.0), required();
        /// Full width of the filter relative to the wavelength; 0 for monochromatic light.
        bandwidth_fraction: f64, between(0.0, 0.5), default(0.0);
        /// Transmission of the filter, in place of bandwidth_fraction: text table of wavelength in
        /// nm, ascending, and relative number of detected photons per photon, linear between its
        /// rows and 0 outside. Comments begin with #.
        filter_file: Option<PathBuf>, ANY, unset("bandwidth_fraction");
        /// Temperature of the star, whose photons are those of a black body over the filter;
        /// without effect on monochromatic light.
        star_temperature_k: Option<f64>, between(100.0, 1e6), unset("as many photons at each wavelength");
        /// Sampling of the image: detector pixels per λ/grid_m.
        samples_per_lambda_over_d: f64, above(0.0, 64.0), default(2.0);
        /// Pixel on the sky, in place of samples_per_lambda_over_d.
        pixel_mas: Option<f64>, above(0.0, 1e5), unset("given by samples_per_lambda_over_d");
        /// Pixel on the sky, in place of samples_per_lambda_over_d.
        pixel_arcsec: Option<f64>, above(0.0, 100.0), unset("given by samples_per_lambda_over_d");
        /// Pitch of the pixels at the focus of focal_length_m or focal_ratio, in place of
        /// samples_per_lambda_over_d.
        pixel_pitch_um: Option<f64>, above(0.0, 1e4), unset("given by samples_per_lambda_over_d");
        /// Focal length over pupil.grid_m, with which pixel_pitch_um and diversity_stage_mm are
        /// converted.
        focal_ratio: Option<f64>, above(0.0, 1e4), unset("not needed");
        /// Focal length of telescope and camera together, in place of focal_ratio.
        focal_length_m: Option<f64>, above(0.0, 1e6), unset("given by focal_ratio");
        /// Number of pixels along a side of the image; the axis is on pixel pixels/2, rounded down.
        /// Images of an odd size are fitted without their last row or column, also where the scene
        /// says one less.
        pixels: usize, between(8.0, 8192.0), required();
        /// Number of columns of a detector frame, centred in the image; at most pixels. The axis is
        /// on column columns/2.
        columns: Option<usize>, between(8.0, 8192.0), unset("pixels");
        /// Number of rows of a detector frame, centred in the image; at most pixels. The axis is on
        /// row rows/2.
        rows: Option<usize>, between(8.0, 8192.0), unset("pixels");
        /// Number of pixels along a side of the square that is fitted; "auto" is the square with
        /// signal. Estimate only.
        crop_pixels: Crop, even(8.0, 8192.0), default(Crop::Auto);
        /// Exposure of one image; 0 for frozen turbulence. Read by AO simulations and full-phase
        /// estimates.
        exposure_s: f64, between(0.0, 86_400.0), default(0.01);
        /// Focus of the diversity, RMS over the pupil, positive at its edge; 1.5 unless
        /// diversity_file is given.
        diversity_focus_waves_rms: f64, between(-20.0, 20.0), default(1.5);
        /// Focus of the diversity, peak to valley over the circle around the hexagons of the pupil,
        /// in place of the waves RMS.
        diversity_focus_waves_pv: Option<f64>, between(-80.0, 80.0), unset("given by diversity_focus_waves_rms");
        /// Focus of the diversity, RMS over the pupil, in place of the waves RMS.
        diversity_focus_nm_rms: Option<f64>, between(-2e6, 2e6), unset("given by diversity_focus_waves_rms");
        /// Travel of the detector along the axis at the focus of focal_length_m or focal_ratio, in
        /// place of the waves RMS; positive towards the telescope, where the image's axes are those
        /// of the pupil.
        diversity_stage_mm: Option<f64>, between(-1e4, 1e4), unset("given by diversity_focus_waves_rms");
        /// FITS map of the diversity in place of a focus, or a cube of maps: nm, or the unit of its
        /// card BUNIT; over pupil.grid_m, or as GRID_M or PUPLSCAL say.
        diversity_file: Option<PathBuf>, ANY, unset("a focus");
        /// Maps of a cube diversity_file, counted from 0, one for each image in order or one for
        /// all; -1 for an image without diversity, such as that of a mirror at rest.
        diversity_planes: Option<Vec<i64>>, between(-1.0, 1e6), unset("the map of diversity_file");
        /// Factor of the map of diversity_file.
        diversity_scale: f64, between(-1e3, 1e3), default(1.0);
        /// Signal-to-noise ratio of the brightest pixel, which photon_noise or read_noise_e limits.
        /// Simulation only.
        peak_snr: Option<f64>, above(0.0, 1e9), unset("500, or given by flux_e");
        /// Electrons of the star in an image. Simulation only.
        flux_e: Option<f64>, above(0.0, 1e18), unset("given by peak_snr");
        /// Side of a pixel's sensitive square relative to the pixel pitch; 0 for pixels that are
        /// points, 1 for pixels without gaps, more for pixels that share light.
        pixel_fill: f64, between(0.0, 1.2), default(0.0);
        /// Diffusion of charge between pixels: standard deviation of a Gaussian along each axis, in
        /// pixels.
        charge_diffusion_pixels: f64, between(0.0, 1.5), default(0.0);
        /// Read noise of a pixel, RMS; 0 for none. An image file that says otherwise is refused.
        read_noise_e: Option<f64>, between(0.0, 1e9), unset("given by the image file; else the scatter of the image's border, and none in a simulation");
        /// Gain: electrons per count of images in counts (ADU). An image file that is in electrons
        /// is not converted. Estimate only.
        gain_e_per_adu: Option<f64>, above(0.0, 1e9), unset("given by the image file; images without a unit are in electrons");
        /// Counts of one coadd from which a pixel is saturated. Read by 'cophase reduce'.
        saturation_adu: Option<f64>, above(0.0, 1e9), unset("given by the raw frame; else several pixels with one largest value");
        /// Whether the camera averages its coadds, where others sum them. Read by 'cophase reduce'.
        coadds_are_averaged: bool, ANY, default(false);
        /// Background of a pixel. Read by simulations and full-phase estimates; modal estimates fit
        /// it.
        background_e: f64, between(0.0, 1e12), default(0.0);
        /// Whether the images have photon noise. Simulation only.
        photon_noise: bool, ANY, default(true);
        /// Number of images in a simulated sequence. Simulation only.
        count: usize, between(1.0, 1e6), default(1usize);
        /// Time from the start of one image to the start of the next; 0 for no pause between
        /// exposures. AO simulation only.
        interval_s: f64, between(0.0, 1e6), default(0.0);
        /// Whether the detector's columns run opposite to +x. Estimate only.
        flip_x: bool, ANY, default(false);
        /// Whether the detector's rows run opposite to +y. Estimate only.
        flip_y: bool, ANY, default(false);
        /// Turn of the pupil on the detector beyond pupil.rotation_deg, one for each image in order
        /// or one for all, counter-clockwise: segments and spider turn with it, NCPA and diversity
        /// do not.
        pupil_turns_deg: Option<Vec<f64>>, between(-360.0, 360.0), unset("that of the file that 'cophase reduce' wrote, where pupil_turn_card is named; else the pupil does not turn");
        /// Card of the raw frames with the angle of the pupil on the detector, counter-clockwise,
        /// in degrees; -CARD for a clockwise one. Read by 'cophase reduce', which writes
        /// pupil_turns_deg.
        pupil_turn_card: Option<String>, ANY, unset("the pupil does not turn");
        /// Value of pupil_turn_card where the pupil stands as pupil.rotation_deg says, in degrees.
        pupil_turn_zero_deg: f64, between(-360.0, 360.0), default(0.0);
        /// Whether exposures of all channels with one number are of one wavefront (a beam splitter,
        /// with one count, exposure_s and interval_s); otherwise channels are exposed one after the
        /// other and share its static part only. Read by AO simulations and full-phase estimates.
        simultaneous: bool, ANY, default(false);
    }
}

impl ImageScene {
    /// Read noise of a pixel of simulated images, RMS electrons: none where the scene does not name
    /// it.
    pub fn simulated_read_noise_e(&self) -> f64 {
        self.read_noise_e.unwrap_or(0.0)
    }

    /// Turn of the pupil in all images beyond `pupil.rotation_deg`, degrees; `None` where images
    /// have turns of their own.
    pub fn pupil_turn_deg(&self) -> Option<f64> {
        match self.pupil_turns_deg.as_deref() {
            None => Some(0.0),
            Some([turn_deg]) => Some(*turn_deg),
            Some(_) => None,
        }
    }

    /// The map of a cube of diversities that all images have: -1 for none; `None` where images have
    /// maps of their own.
    pub fn diversity_plane(&self) -> Option<i64> {
        match self.diversity_planes.as_deref() {
            None => Some(0),
            Some([plane]) => Some(*plane),
            Some(_) => None,
        }
    }

    /// Whether the pupil of an image is turned.
    pub fn is_pupil_turned(&self) -> bool {
        self.pupil_turns_deg.iter().flatten().any(|turn_deg| *turn_deg != 0.0)
    }

    /// The other form of the sampling that the scene names, and its value. A pixel is inversely
    /// proportional to the sampling.
    pub(super) fn named_sampling(&self) -> Option<(&'static str, f64)> {
        named(forms::SAMPLING, [self.pixel_mas, self.pixel_arcsec, self.pixel_pitch_um])
    }

    /// The other form of the defocus in waves that the scene names, and its value. All forms are
    /// proportional to each other.
    pub(super) fn named_focus(&self) -> Option<(&'static str, f64)> {
        named(forms::FOCUS, [self.diversity_focus_waves_pv, self.diversity_focus_nm_rms, self.diversity_stage_mm])
    }

    /// The form of the focal length that the scene names, and its value.
    pub(super) fn named_focal(&self) -> Option<(&'static str, f64)> {
        let values = [self.focal_ratio, self.focal_length_m];
        forms::FOCAL.into_iter().zip(values).find_map(|(key, value)| Some((key, value?)))
    }

    /// Whether the samples of the image hold the frequencies of the area of a pixel.
    pub(crate) fn has_samples_of_pixels(&self) -> bool {
        self.samples_per_lambda_over_d >= LEAST_SAMPLING_OF_PIXELS
    }

    /// Refuses an area of the pixels that the sampling does not hold.
    pub(super) fn check_sampling(&self, reader: &Reader) -> Result<()> {
        let sampling = self.samples_per_lambda_over_d;
        for (key, value) in [("pixel_fill", self.pixel_fill), ("charge_diffusion_pixels", self.charge_diffusion_pixels)]
        {
            if value > 0.0 && !self.has_samples_of_pixels() {
                let sentence = format!(
                    "image.{key} = {value} is not accepted with image.samples_per_lambda_over_d = {sampling}; a sampling of \
                     {LEAST_SAMPLING_OF_PIXELS} or more is needed"
                );
                return Err(reader.error(key, sentence));
            }
        }
        Ok(())
    }

    /// Rows and columns of a detector frame.
    pub fn frame_shape(&self) -> (usize, usize) {
        (self.rows.unwrap_or(self.pixels), self.columns.unwrap_or(self.pixels))
    }

    /// Rows and columns of a frame that an estimate takes: even, without the last of an odd number.
    /// The axis stays on the same pixel.
    pub fn fitted_shape(&self) -> (usize, usize) {
        let (rows, columns) = self.frame_shape();
        (rows / 2 * 2, columns / 2 * 2)
    }
}

/// The key behind the first of `keys` that has a value, and the value.
fn named(keys: [&'static str; 4], values: [Option<f64>; 3]) -> Option<(&'static str, f64)> {
    let [_, others @ ..] = keys;
    others.into_iter().zip(values).find_map(|(key, value)| Some((key, value?)))
}

impl Check for ImageScene {
    fn complete(&mut self, reader: &Reader) -> Result<()> {
        reader.not_both("peak_snr", "flux_e")?;
        reader.not_several(&forms::SAMPLING)?;
        reader.not_several(&forms::FOCUS)?;
        forms::FOCUS.iter().try_for_each(|key| reader.not_both(key, "diversity_file"))?;
        if self.flux_e.is_none() {
            self.peak_snr.get_or_insert(500.0);
        }
        if self.diversity_file.is_some() {
            self.diversity_focus_waves_rms = 0.0;
        } else {
            reader.refuse(&["diversity_planes", "diversity_scale"], "without image.diversity_file")?;
        }
        Ok(())
    }

    fn check(&self, reader: &Reader) -> Result<()> {
        if self.filter_file.is_some() && self.bandwidth_fraction > 0.0 {
            let sentence = format!(
                "'image.filter_file' and image.bandwidth_fraction = {} are both given; name only one of them",
                self.bandwidth_fraction
            );
            return Err(reader.error("filter_file", sentence));
        }
        // Without noise the ratio is infinite for any flux.
        if let (None, Some(snr)) = (self.flux_e, self.peak_snr)
            && !self.photon_noise
            && self.simulated_read_noise_e() == 0.0
        {
            let read_noise =
                if self.read_noise_e.is_some() { "image.read_noise_e = 0" } else { "no image.read_noise_e" };
            let sentence = format!(
                "image.peak_snr = {snr} gives no flux where there is no noise (image.photon_noise = false and {read_noise}); \
                 image.flux_e in its place, or one of the two noises, is needed"
            );
            return Err(reader.error("photon_noise", sentence));
        }
        let lists = [
            ("pupil_turns_deg", self.pupil_turns_deg.as_ref().is_some_and(Vec::is_empty)),
            ("diversity_planes", self.diversity_planes.as_ref().is_some_and(Vec::is_empty)),
        ];
        if let Some((key, _)) = lists.into_iter().find(|(_, is_empty)| *is_empty) {
            let sentence = format!("image.{key} = [] is not accepted; one number, or one for each image, is needed");
            return Err(reader.error(key, sentence));
        }
        let (pixels, exposure_s, interval_s) = (self.pixels, self.exposure_s, self.interval_s);
        for (key, value) in [("columns", self.columns), ("rows", self.rows)] {
            if let Some(value) = value.filter(|&value| value > pixels) {
                let sentence =
                    format!("image.{key} = {value} is not accepted; at most image.pixels = {pixels} is needed");
                return Err(reader.error(key, sentence));
            }
        }
        // A sampling in other words is converted, and checked, when the pupil is known.
        if self.named_sampling().is_none() {
            self.check_sampling(reader)?;
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
    /// True aberrations of simulated images. Simulation only. Without this section the wavefront is
    /// flat.
    AberrationScene = "aberrations" {
        /// RMS of the segment pistons over the segments.
        segment_piston_rms_nm: f64, between(0.0, 1e6), default(0.0);
        /// RMS of the segment tips and tilts over the pupil.
        segment_tip_tilt_rms_nm: f64, between(0.0, 1e6), default(0.0);
        /// RMS over the pupil of focus and astigmatisms of the segments, each segment its own.
        segment_figure_rms_nm: f64, between(0.0, 1e6), default(0.0);
        /// RMS over the pupil of a focus and astigmatisms that all segments share.
        common_figure_rms_nm: f64, between(0.0, 1e6), default(0.0);
        /// RMS of the non-common path aberrations over the pupil.
        ncpa_rms_nm: f64, between(0.0, 1e6), default(0.0);
        /// First and last Noll index of the Zernike polynomials of the non-common path aberrations.
        ncpa_zernikes: NollRange, between(1.0, 1000.0), default(NollRange::Span { first: 4, last: 18 });
        /// Exponent p of the spectrum: the variance of a Zernike coefficient is proportional to
        /// (radial order)^p.
        ncpa_power_law: f64, between(-20.0, 20.0), default(-2.0);
        /// FITS map of the non-common path aberrations in place of Zernike polynomials: nm, or the
        /// unit of its card BUNIT; over pupil.grid_m, or as GRID_M or PUPLSCAL say; with cards
        /// S01PISTN, ... also the segments' pistons and tilts.
        ncpa_file: Option<PathBuf>, ANY, unset("Zernike polynomials");
        /// RMS of the pistons of the petals over the pupil. Petals are the parts of the pupil that
        /// the spider separates; their errors are non-common path aberrations, in addition to the
        /// others.
        petal_piston_rms_nm: f64, between(0.0, 1e6), default(0.0);
        /// RMS of the tips and tilts of the petals over the pupil.
        petal_tip_tilt_rms_nm: f64, between(0.0, 1e6), default(0.0);
        /// Pistons of the petals, or all pistons, all tips and all tilts, in place of their RMS;
        /// tips and tilts are nm RMS over the petal. Petals are counted by the direction of their
        /// centre, counter-clockwise from +x. The mean piston is removed.
        petal_coefficients_nm: Option<Vec<f64>>, between(-1e6, 1e6), unset("drawn with the RMS above");
        /// Number of samples along a side of the grid on which the images are computed.
        truth_samples: Option<usize>, even(16.0, 16_384.0), unset("8 times pupil.samples, or the samples of pupil.file");
        /// Seed of the aberrations, and of the noise of an artificial source's images.
        seed: u64, at_least(0.0), default(1u64);
    }
}

impl AberrationScene {
    /// Those of a flat wavefront.
    ///
    /// # Errors
    /// [`Error::Scene`](crate::Error::Scene) for a key without a default, of which there is none.
    pub(crate) fn flat() -> Result<Self> {
        let source = Source { name: "", text: "", purpose: Purpose::Whole, settings: &[] };
        Self::read(&Reader { source, section: Self::NAME, item: None })
    }

    /// Whether the petals have aberrations of their own.
    pub(super) fn has_petals(&self) -> bool {
        self.petal_piston_rms_nm > 0.0 || self.petal_tip_tilt_rms_nm > 0.0 || self.petal_coefficients_nm.is_some()
    }
}

impl Check for AberrationScene {
    fn complete(&mut self, reader: &Reader) -> Result<()> {
        if self.ncpa_file.is_some() {
            reader.refuse(&forms::ZERNIKES, "where the non-common path aberrations come from a file")?;
        }
        for key in forms::PETALS {
            reader.not_both(key, "petal_coefficients_nm")?;
        }
        Ok(())
    }

    fn check(&self, reader: &Reader) -> Result<()> {
        if self.ncpa_rms_nm > 0.0 && self.ncpa_zernikes == NollRange::None {
            let rms_nm = self.ncpa_rms_nm;
            let sentence = format!(
                "aberrations.ncpa_zernikes is empty but ncpa_rms_nm = {rms_nm}; [first, last] Noll index is needed"
            );
            return Err(reader.error("ncpa_zernikes", sentence));
        }
        Ok(())
    }
}
