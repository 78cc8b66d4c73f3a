//! Cube of images: electrons, bad pixels, read noise.

use ndarray::ArrayView3;

/// Images in electrons, with their bad pixels and their read noise.
#[derive(Debug, Clone, Copy)]
pub struct Cube<'a> {
    /// Electrons, `[image, y, x]`.
    pub images_e: ArrayView3<'a, f64>,
    /// Bad pixels, `[image, y, x]`.
    pub bad: ArrayView3<'a, bool>,
    /// Read noise of a pixel, RMS electrons; `None` for the scene's; where that has none, the scatter of each
    /// image's border.
    pub read_noise_e: Option<f64>,
}
