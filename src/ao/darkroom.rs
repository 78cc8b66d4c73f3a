//! Where exposed wavefronts become images, on a thread of its own.

use super::camera::{ScienceCamera, strehl_on_axis};
use super::drift::Drift;
use super::footprint::Footprint;
use crate::scene::Scene;
use crate::source::{Pixels, expose, stream};
use ndarray::Array2;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender};
use std::time::{Duration, Instant};

/// First stream of the camera's noise under the seed of the turbulence; one for each image, so that no image depends on
/// those before it. A later run of the same loop counts on from its first frame, beyond any image of the runs before.
const CAMERA_STREAM: u64 = 2 << 32;

/// One wavefront of an exposure.
pub(super) struct Film {
    pub(super) image: usize,
    /// The run's frame.
    pub(super) frame: u64,
    pub(super) residual_nm: Vec<f32>,
    /// Its share of the exposure.
    pub(super) share: f32,
    /// Whether it is the last.
    pub(super) last: bool,
}

/// A finished image.
pub(super) struct Print {
    pub(super) image: usize,
    pub(super) image_e: Array2<f32>,
}

/// What is left when no more films come.
pub(super) struct Developed {
    /// Mean Strehl ratio of the wavefronts at the scene's wavelength; NaN without any.
    pub(super) strehl: f64,
    /// Time at work.
    pub(super) spent: Duration,
}

/// The camera and what it needs.
pub(super) struct Darkroom {
    pub(super) camera: ScienceCamera,
    pub(super) pixels: Pixels,
    pub(super) drift: Option<Arc<Drift>>,
    pub(super) scene: Scene,
    pub(super) flux_e: f64,
    pub(super) footprint: Footprint,
    /// The loop's frame with which the run begins.
    pub(super) first_frame: u64,
}

impl Darkroom {
    /// Develops `films` in order, until no more come.
    pub(super) fn work(mut self, films: &Receiver<Film>, prints: &Sender<Print>) -> Developed {
        let mut sum = vec![0.0f32; self.camera.pixels()];
        let (mut strehl, mut count, mut spent) = (0.0, 0.0, Duration::ZERO);
        while let Ok(mut film) = films.recv() {
            let started = Instant::now();
            // The wavefront that the sensor could have flattened: without NCPA and diversity.
            strehl += strehl_on_axis(&self.footprint, &film.residual_nm, self.scene.image.wavelength_nm);
            count += 1.0;
            if let Some(drift) = &self.drift {
                drift.add_ncpa(self.first_frame + film.frame, &mut film.residual_nm);
            }
            self.camera.add(&film.residual_nm, &mut sum);
            if film.last {
                let psf = self.pixels.see((self.camera.upright(&sum) * film.share).mapv(f64::from));
                let mut rng = stream(self.scene.turbulence.seed, CAMERA_STREAM + self.first_frame + film.image as u64);
                let image_e = psf.mapv(|h| expose(&self.scene.image, h, self.flux_e, &mut rng) as f32);
                sum.fill(0.0);
                // A receiver that is gone no longer wants images.
                let _ = prints.send(Print { image: film.image, image_e });
            }
            spent += started.elapsed();
        }
        Developed { strehl: strehl / count, spent }
    }
}
