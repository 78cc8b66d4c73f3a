//! What an image of the science camera shows, and the optics that it is made from.

use crate::ao::footprint::Footprint;
use crate::pupil::Pupil;
use crate::scene::ImageScene;
use crate::source::Truth;
use crate::telescope::{Diversity, Filter, Telescope};

/// Aberrations, wavelength and detector of an image, in addition to the loop's residual wavefront.
#[derive(Debug, Clone, Copy)]
pub struct View {
    /// Whether the segment errors are included, each with its own weight in the samples at the borders.
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
    /// Whether the filter curve and the temperature of the star in the scene apply, in place of a flat `bandwidth_fraction`; their
    /// wavelengths are relative to `wavelength_nm`.
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
}

/// Optics that a camera is built from.
pub struct Optics<'a> {
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
