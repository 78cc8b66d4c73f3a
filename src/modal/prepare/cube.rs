//! Cube of images: electrons, bad pixels, read noise.

use ndarray::{ArrayView2, ArrayView3};

/// Images in electrons, with their bad pixels and their read noise.
#[derive(Debug, Clone, Copy)]
pub struct Cube<'a> {
    /// Electrons, `[image, y, x]`.
    pub images_e: ArrayView3<'a, f64>,
    /// Bad pixels, `[image, y, x]`.
    pub bad: ArrayView3<'a, bool>,
    /// Read noise of a pixel, RMS electrons; `None` for the scene's; where that has none, the
    /// scatter of each image's border.
    pub read_noise_e: Option<f64>,
}

impl Cube<'_> {
    /// Whether a pixel of an image is bad.
    pub(in crate::modal) fn has_bad(&self) -> bool {
        self.bad.outer_iter().any(|image| has_true(image))
    }
}

/// Whether a pixel is true.
pub(in crate::modal) fn has_true(mask: ArrayView2<bool>) -> bool {
    // Many at once, which the compiler makes vectors of.
    const AT_ONCE: usize = 64;
    let Some(pixels) = mask.as_slice() else { return mask.iter().any(|pixel| *pixel) };
    let (chunks, rest) = pixels.as_chunks::<AT_ONCE>();
    chunks.iter().any(|chunk| chunk.iter().fold(false, |any, pixel| any | pixel)) || rest.contains(&true)
}
