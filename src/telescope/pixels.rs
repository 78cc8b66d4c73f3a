//! Pixels of a scene's detector.

use crate::fourier::PixelResponse;
use crate::scene::System;

/// Response of a pixel of the detector of `scene`, along either axis, in detector pixels.
pub fn pixel_response(scene: &System) -> PixelResponse {
    let image = &scene.image;
    PixelResponse { width_pixels: image.pixel_fill, diffusion_pixels: image.charge_diffusion_pixels }
}
