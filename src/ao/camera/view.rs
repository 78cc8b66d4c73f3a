//! What an image of the science camera shows, and the optics that it is made from.

use crate::ao::footprint::Footprint;
use crate::pupil::Pupil;
use crate::scene::ImageScene;
use crate::source::Truth;
use crate::telescope::{Diversity, Filter, Telescope};

/// Width that aberrations and turbulence add to the band of pupil frequencies that affect an image,
/// cycles over the grid.
const ABERRATION_CYCLES: f64 = 8.0;
/// Least width of the low pass's transition between its pass band and the Nyquist frequency, cycles
/// over the grid.
const HALF_TRANSITION_CYCLES: f64 = 12.0;

/// The highest pupil frequency that `samples` across the grid represent without aliases, cycles
/// over the grid.
pub(super) fn largest_band_cycles(samples: usize) -> f64 {
    samples as f64 / 2.0 - HALF_TRANSITION_CYCLES
}

/// Aberrations, wavelength and detector of an image, in addition to the loop's residual wavefront.
#[derive(Debug, Clone, Copy)]
pub struct View {
    /// Whether the segment errors are included, each with its own weight in the samples at the
    /// borders.
    pub segments: bool,
    /// Whether the NCPA are included.
    pub ncpa: bool,
    /// Whether the diversity is included.
    pub diversity: bool,
    /// Wavelength, nm.
    pub wavelength_nm: f64,
    /// Rows of the image; the axis is on pixel `[rows/2, columns/2]`.
    pub rows: usize,
    /// Columns of the image.
    pub columns: usize,
    /// Pixels per λ/`grid_m` at `wavelength_nm`.
    pub samples_per_lambda_over_d: f64,
    /// Width of the filter as a fraction of the wavelength; 0 for one wavelength.
    pub bandwidth_fraction: f64,
    /// Whether the filter curve and the temperature of the star in the scene apply, in place of a
    /// flat `bandwidth_fraction`; their wavelengths are relative to `wavelength_nm`.
    pub spectrum: bool,
}

impl View {
    /// View of the scene's defocused images.
    pub fn from_scene(image: &ImageScene) -> Self {
        let (rows, columns) = image.frame_shape();
        Self {
            segments: true,
            ncpa: true,
            diversity: true,
            wavelength_nm: image.wavelength_nm,
            rows,
            columns,
            samples_per_lambda_over_d: image.samples_per_lambda_over_d,
            bandwidth_fraction: image.bandwidth_fraction,
            spectrum: image.filter_file.is_some() || image.star_temperature_k.is_some(),
        }
    }

    /// The highest pupil frequency that affects these images, cycles over the grid of `pupil`: what
    /// reaches their rim, with the defocused spot around it.
    pub(super) fn band_cycles(&self, pupil: &Pupil, diversity: &Diversity) -> f64 {
        let half_width = self.rows.max(self.columns) as f64 / (2.0 * self.samples_per_lambda_over_d);
        let spot = if self.diversity { diversity.spot(pupil, self.wavelength_nm) } else { 0.0 };
        half_width + spot + ABERRATION_CYCLES
    }

    /// Number of samples across the grid at which nothing is filtered away that affects these
    /// images.
    pub(in crate::ao) fn samples_needed(&self, pupil: &Pupil, diversity: &Diversity) -> usize {
        (2.0 * (self.band_cycles(pupil, diversity) + HALF_TRANSITION_CYCLES)).ceil() as usize
    }

    /// Share of the light that `samples` across the grid filter away from these images: a round
    /// pupil diffracts 2/(π² f) of its light beyond f λ/D (Born & Wolf, 8.5.2).
    pub(in crate::ao) fn light_filtered(&self, samples: usize, pupil: &Pupil, diversity: &Diversity) -> f64 {
        let beyond = |cycles: f64| 2.0 / (std::f64::consts::PI.powi(2) * cycles.max(1.0));
        let needed = self.band_cycles(pupil, diversity);
        beyond(largest_band_cycles(samples).min(needed)) - beyond(needed)
    }
}

/// Optics that a camera is built from.
pub struct CameraOptics<'a> {
    /// Telescope.
    pub telescope: &'a Telescope,
    /// Pupil on the simulator's grid.
    pub pupil: &'a Pupil,
    /// Illuminated part of that grid.
    pub footprint: &'a Footprint,
    /// Static aberrations.
    pub truth: &'a Truth,
    /// Diversity of the scene.
    pub diversity: &'a Diversity,
    /// Filter and star of the scene.
    pub filter: &'a Filter,
    /// Segment errors over the footprint, nm, as the residual wavefront contains them.
    pub segments_nm: &'a [f32],
}
