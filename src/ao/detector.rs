//! Detector of a channel: PSFs of wavefronts at its pixels, and images with noise.

use super::camera::{ScienceCamera, View};
use super::simulator::Simulator;
use crate::Result;
use crate::scene::System;
use crate::source::{DetectorPixels, expose, flux_e, stream};
use ndarray::Array2;

/// Camera, pixels and star of a channel.
pub(super) struct Detector {
    pub(super) camera: ScienceCamera,
    pixels: DetectorPixels,
    scene: System,
    /// Electrons of the star in an image.
    pub(super) flux_e: f64,
}

impl Detector {
    /// Detectors of all channels of `simulator`, in order.
    ///
    /// # Errors
    /// As [`ScienceCamera::new`], with the name of the channel.
    pub(super) fn all(simulator: &Simulator) -> Result<Vec<Self>> {
        let each = simulator.channels.iter().map(|channel| {
            let (scene, view) = (channel.scene.clone(), View::from_scene(&channel.scene.image));
            let camera = simulator.camera_of(channel, view);
            let mut camera =
                camera.map_err(|error| channel.name.iter().fold(error, |error, name| error.of_channel(name)))?;
            let pixels = DetectorPixels::new(&scene);
            // peak_snr refers to the PSF of the static aberrations alone, so that the flux does not
            // depend on the loop.
            let psf = pixels.apply(camera.psf(simulator.segments_nm()).mapv(f64::from));
            let flux_e = flux_e(&scene.image, psf.fold(0.0, |a: f64, &b| a.max(b)));
            Ok(Self { camera, pixels, scene, flux_e })
        });
        each.collect()
    }

    /// Draws the image of an exposure with noise of the random number stream `number`, `[y, x]`,
    /// electrons; `psf` is the mean PSF over its frames.
    pub(super) fn image_e(&self, psf: Array2<f32>, number: u64) -> Array2<f32> {
        let psf = self.pixels.apply(psf.mapv(f64::from));
        let mut rng = stream(self.scene.turbulence.seed, number);
        psf.mapv(|h| expose(&self.scene.image, h, self.flux_e, &mut rng) as f32)
    }
}
