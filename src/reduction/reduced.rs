//! Reduced images with the log of their frames.

use super::log::LogRow;
use ndarray::Array3;

/// Reduced images of a channel.
#[derive(Debug, Clone)]
pub struct ReducedChannel {
    /// Its name; `None` in a scene without channels.
    pub name: Option<String>,
    /// Electrons, `[image, y, x]`.
    pub images_e: Array3<f64>,
    /// Bad pixels, `[image, y, x]`.
    pub bad: Array3<bool>,
    /// Noise of a pixel without the star's light, RMS electrons, mean over the images.
    pub noise_e: f64,
    /// Read noise of one coadd, RMS electrons, that the scene or a card stated.
    pub stated_read_noise_e: Option<f64>,
    /// Integration time of a coadd, s, and number of coadds, where all images have the same.
    pub exposure: Option<(f64, u32)>,
    /// Wavelengths that the header of the first image states: keyword and nm.
    pub wavelengths_nm: Vec<(&'static str, f64)>,
    /// Turn of the pupil in each image, degrees, where the scene names its card.
    pub pupil_turns_deg: Option<Vec<f64>>,
}

/// Reduced images with the log of the frames.
#[derive(Debug, Clone)]
pub struct Reduction {
    /// The channels of the scene in order, or one.
    pub channels: Vec<ReducedChannel>,
    /// One row for each frame, in the order of the frames; then files that are no frames.
    pub log: Vec<LogRow>,
    /// What a user should know.
    pub warnings: Vec<String>,
    /// What was read of the files in another way than a user may expect, which puts nothing in
    /// doubt.
    pub remarks: Vec<String>,
    /// Pixels of the detector that the mask, the darks or the flats mark.
    pub bad_pixels: usize,
    /// What was subtracted and divided, in words.
    pub steps: Vec<String>,
}
