//! Optics that the images said are others than the scene's.

use crate::Result;
use crate::scene::Scene;
use crate::telescope::Telescope;

/// What was found of the optics, and the scene with it.
#[derive(Debug, Clone)]
pub struct OpticsFound {
    /// The scene, with the numbers that were found in place of its own.
    pub(crate) scene: Scene,
    /// Pixels per λ/D over those of the scene that was given; 1 where they were not called into question.
    pub plate_scale: f64,
    /// Diameter of the central obscuration, where another was found, m.
    pub central_obscuration_m: Option<f64>,
    /// Width of the spider's vanes likewise, m.
    pub spider_width_m: Option<f64>,
    /// Reflectivity of each segment over the mean of the pupil's light; none where they were not called into question.
    pub segment_reflectivities: Vec<f64>,
    telescope: Telescope,
}

impl OpticsFound {
    /// `scene` and segments of `amplitudes` (none: all alike), where `given` was asked for.
    ///
    /// # Errors
    /// Those of building the telescope.
    pub(super) fn of(given: &Scene, scene: Scene, amplitudes: Vec<f64>) -> Result<Self> {
        let mut telescope = Telescope::of(&scene)?;
        if !amplitudes.is_empty() {
            telescope = telescope.with_amplitudes(amplitudes)?;
        }
        let other = |now: f64, then: f64| (now != then).then_some(now);
        Ok(Self {
            plate_scale: scene.image.samples_per_lambda_over_d / given.image.samples_per_lambda_over_d,
            central_obscuration_m: other(scene.pupil.central_obscuration_m, given.pupil.central_obscuration_m),
            spider_width_m: other(scene.pupil.spider_width_m, given.pupil.spider_width_m),
            segment_reflectivities: telescope.amplitudes().iter().map(|amplitude| amplitude * amplitude).collect(),
            scene,
            telescope,
        })
    }

    /// The telescope that was found.
    pub(crate) fn telescope(&self) -> &Telescope {
        &self.telescope
    }

    /// What somebody should know of it, in a sentence each.
    pub fn warnings(&self) -> Vec<String> {
        let mut sentences = Vec::new();
        if self.plate_scale != 1.0 {
            sentences.push(format!(
                "pixels are {:+.2} % finer than image.samples_per_lambda_over_d says, and were taken so",
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
                    "the images show {what} of {metres:.4} m where {key} says otherwise, and were read so"
                ));
            }
        }
        let reflectivities = &self.segment_reflectivities;
        if !reflectivities.is_empty() {
            let square: f64 = reflectivities.iter().map(|value| (value - 1.0).powi(2)).sum();
            sentences.push(format!(
                "the segments reflect {:.1} % RMS differently from each other, and were taken so",
                100.0 * (square / reflectivities.len() as f64).sqrt()
            ));
        }
        sentences
    }
}
