//! Detector thread: accumulates the PSFs of an exposure and draws the noise of its image.

use super::camera::{ScienceCamera, strehl_on_axis};
use super::drift::Drift;
use super::footprint::Footprint;
use crate::scene::Scene;
use crate::source::{DetectorPixels, expose, stream};
use ndarray::Array2;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender};
use std::time::{Duration, Instant};

/// First stream of the camera's noise under the seed of the turbulence. Each image has a stream of its own, so that its
/// noise does not depend on the images before it. A later run of the same loop adds its first frame to the stream's
/// number, which exceeds the number of images of the runs before.
const CAMERA_STREAM: u64 = 2 << 32;

/// Residual wavefront of one frame of an exposure.
pub(super) struct ExposedWavefront {
    pub(super) image: usize,
    /// Frame of the run, from 0.
    pub(super) frame: u64,
    pub(super) residual_nm: Vec<f32>,
    /// Fraction of the exposure that this frame takes.
    pub(super) share: f32,
    /// Whether this frame ends the exposure.
    pub(super) is_last: bool,
}

/// Image at the end of its exposure.
pub(super) struct FinishedImage {
    pub(super) image: usize,
    pub(super) image_e: Array2<f32>,
}

/// Statistics of all exposed wavefronts of a run.
pub(super) struct ExposureStatistics {
    /// Mean Strehl ratio at the scene's wavelength; NaN if no wavefront was exposed.
    pub(super) strehl: f64,
    /// Time spent on images.
    pub(super) spent: Duration,
}

/// State of the detector thread.
pub(super) struct DetectorThread {
    pub(super) camera: ScienceCamera,
    pub(super) pixels: DetectorPixels,
    pub(super) drift: Option<Arc<Drift>>,
    pub(super) scene: Scene,
    pub(super) flux_e: f64,
    pub(super) footprint: Footprint,
    /// Frame of the loop at which the run begins.
    pub(super) first_frame: u64,
}

impl DetectorThread {
    /// Accumulates `wavefronts` in order and sends an image at the end of each exposure, until the channel closes.
    pub(super) fn run(
        mut self,
        wavefronts: &Receiver<ExposedWavefront>,
        images: &Sender<FinishedImage>,
    ) -> ExposureStatistics {
        let mut sum = vec![0.0f32; self.camera.pixels()];
        let (mut strehl, mut count, mut spent) = (0.0, 0.0, Duration::ZERO);
        while let Ok(mut wavefront) = wavefronts.recv() {
            let started = Instant::now();
            // Without NCPA and diversity: this Strehl ratio measures the loop, which does not see them.
            strehl += strehl_on_axis(&self.footprint, &wavefront.residual_nm, self.scene.image.wavelength_nm);
            count += 1.0;
            if let Some(drift) = &self.drift {
                drift.add_ncpa(self.first_frame + wavefront.frame, &mut wavefront.residual_nm);
            }
            self.camera.add(&wavefront.residual_nm, &mut sum);
            if wavefront.is_last {
                let psf = self.pixels.apply((self.camera.to_image(&sum) * wavefront.share).mapv(f64::from));
                let number = CAMERA_STREAM + self.first_frame + wavefront.image as u64;
                let mut rng = stream(self.scene.turbulence.seed, number);
                let image_e = psf.mapv(|h| expose(&self.scene.image, h, self.flux_e, &mut rng) as f32);
                sum.fill(0.0);
                // The send fails only if the loop has stopped and dropped the receiver.
                let _ = images.send(FinishedImage { image: wavefront.image, image_e });
            }
            spent += started.elapsed();
        }
        ExposureStatistics { strehl: strehl / count, spent }
    }
}
