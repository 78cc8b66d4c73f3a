//! Optics of the images where they differ from the scene's.

use crate::Result;
use crate::scene::Scene;
use crate::telescope::Telescope;

/// Optics estimated from images, and the scene with them.
#[derive(Debug, Clone)]
pub struct RetrievedOptics {
    /// The scene, with the estimates in place of its own values.
    pub(crate) scene: Scene,
    /// Pixels per λ/D over those of the scene that was given; 1 where they were not estimated.
    pub plate_scale: f64,
    /// Diameter of the central obscuration, m, where it differs.
    pub central_obscuration_m: Option<f64>,
    /// Width of the spider's vanes, m, where it differs.
    pub spider_width_m: Option<f64>,
    /// Reflectivity of each segment over the pupil's mean; empty where they were not estimated.
    pub segment_reflectivities: Vec<f64>,
    telescope: Telescope,
}

impl RetrievedOptics {
    /// The estimated `scene` with segments of `amplitudes` (none: all alike), in place of the scene `given`.
    ///
    /// # Errors
    /// Those of building the telescope.
    pub(super) fn new(given: &Scene, scene: Scene, amplitudes: Vec<f64>) -> Result<Self> {
        let mut telescope = Telescope::new(&scene)?;
        if !amplitudes.is_empty() {
            telescope = telescope.with_amplitudes(amplitudes)?;
        }
        let other = |now: f64, before: f64| (now != before).then_some(now);
        Ok(Self {
            plate_scale: scene.image.samples_per_lambda_over_d / given.image.samples_per_lambda_over_d,
            central_obscuration_m: other(scene.pupil.central_obscuration_m, given.pupil.central_obscuration_m),
            spider_width_m: other(scene.pupil.spider_width_m, given.pupil.spider_width_m),
            segment_reflectivities: telescope.amplitudes().iter().map(|amplitude| amplitude * amplitude).collect(),
            scene,
            telescope,
        })
    }

    /// Telescope with the estimated optics.
    pub(crate) fn telescope(&self) -> &Telescope {
        &self.telescope
    }

    /// Warnings for users, a sentence for each estimate that differs from the scene.
    pub fn warnings(&self) -> Vec<String> {
        let mut sentences = Vec::new();
        if self.plate_scale != 1.0 {
            sentences.push(format!(
                "the images show pixels {:+.2} % finer than image.samples_per_lambda_over_d: the estimate uses those of the \
                 images",
                100.0 * (self.plate_scale - 1.0)
            ));
        }
        let pupil = [
            (self.central_obscuration_m, "a central obscuration", "pupil.central_obscuration_m"),
            (self.spider_width_m, "a spider", "pupil.spider_width_m"),
        ];
        for (metres, what, key) in pupil {
            if let Some(metres) = metres {
                sentences.push(format!(
                    "the images show {what} of {metres:.4} m, which differs from {key}: the estimate uses that of the images"
                ));
            }
        }
        let reflectivities = &self.segment_reflectivities;
        if !reflectivities.is_empty() {
            let square: f64 = reflectivities.iter().map(|value| (value - 1.0).powi(2)).sum();
            sentences.push(format!(
                "the images show segments whose reflectivities differ by {:.1} % RMS: the estimate uses those of the images",
                100.0 * (square / reflectivities.len() as f64).sqrt()
            ));
        }
        sentences
    }
}
