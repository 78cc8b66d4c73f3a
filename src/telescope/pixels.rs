//! Pixels of a scene's detector.

use crate::fourier::PixelResponse;
use crate::scene::Scene;

/// Response of a pixel of the detector of `scene`, along either axis, in detector pixels.
pub fn pixel_response(scene: &Scene) -> PixelResponse {
    let image = &scene.image;
    PixelResponse { width_pixels: image.pixel_fill, diffusion_pixels: image.charge_diffusion_pixels }
}
