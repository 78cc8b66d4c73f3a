//! Schedule of the images of a run, in frames of the loop.

use crate::scene::Scene;

/// Start and length of every exposure, in frames of the loop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Schedule {
    settle_s: f64,
    interval_s: f64,
    pub(super) rate_hz: f64,
    pub(super) wavelength_nm: f64,
    /// Frames in an exposure; 1 freezes the turbulence.
    pub exposure: u64,
    /// Number of images.
    pub images: usize,
}

impl Schedule {
    /// The schedule of `scene`, for a loop of `rate_hz`.
    pub fn new(scene: &Scene, settle_s: f64, rate_hz: f64) -> Self {
        let image = &scene.image;
        let exposure = (image.exposure_s * rate_hz).round().max(1.0);
        let interval_s = image.interval_s.max(exposure / rate_hz);
        Self {
            settle_s,
            interval_s,
            rate_hz,
            wavelength_nm: image.wavelength_nm,
            exposure: exposure as u64,
            images: image.count,
        }
    }

    /// The first frame of an image.
    pub fn start(&self, image: usize) -> u64 {
        ((self.settle_s + image as f64 * self.interval_s) * self.rate_hz).round() as u64
    }

    /// Frames of a run: up to the end of the last exposure.
    pub fn frames(&self) -> u64 {
        self.start(self.images.max(1) - 1) + self.exposure
    }

    /// Index of `frame` within the exposure of `image`; `None` if it lies outside.
    pub(super) fn place(&self, frame: u64, image: usize) -> Option<u64> {
        let start = (image < self.images).then(|| self.start(image))?;
        (start..start + self.exposure).contains(&frame).then(|| frame - start)
    }
}
