//! Optics of the images where they differ from the scene's.

use super::optics_parameter::SearchedParameter;
use crate::Result;
use crate::scene::{OpticalParameter, System};
use crate::telescope::Telescope;

/// Optics estimated from images, and the scene with them.
#[derive(Debug, Clone)]
pub struct RetrievedOptics {
    /// The scene, with the estimates in place of its own values.
    pub(crate) scene: System,
    /// Numbers of the scene that differ.
    pub(crate) changes: Vec<OpticalParameter>,
    /// Reflectivity of each segment over the pupil's mean; empty where they were not estimated.
    pub segment_reflectivities: Vec<f64>,
    telescope: Telescope,
}

/// The sentence for users on a `change` of the optics.
fn sentence(change: &OpticalParameter) -> String {
    let OpticalParameter { key, scene, value, .. } = change;
    let what = match key.as_str() {
        "image.samples_per_lambda_over_d" => {
            format!("pixels {:+.2} % finer than {key}", 100.0 * (value / scene - 1.0))
        }
        "image.bandwidth_fraction" => format!("a filter of {:.1} %, where {key} is {scene}", 100.0 * value),
        "image.pixel_fill" => format!("pixels whose side is {value:.2} of their pitch, where {key} is {scene}"),
        _ => format!("{key} = {value:.4}, which the scene gives as {scene}"),
    };
    format!("the images show {what}: the estimate uses that of the images")
}

impl RetrievedOptics {
    /// The estimated `scene` with segments of `amplitudes` (none: all alike), in place of the scene
    /// `given`.
    ///
    /// # Errors
    /// Those of building the telescope.
    pub(super) fn new(given: &System, scene: System, amplitudes: Vec<f64>) -> Result<Self> {
        let mut telescope = Telescope::new(&scene)?;
        if !amplitudes.is_empty() {
            telescope = telescope.with_amplitudes(amplitudes)?;
        }
        let [given, found] = [given, &scene].map(SearchedParameter::all);
        let change = given.iter().filter_map(|given| {
            let found = found.iter().find(|found| found.parameter == given.parameter)?;
            let values = [given.own, found.own];
            (found.own != given.own).then(|| OpticalParameter::of_key(given.optic, given.parameter.key, values))
        });
        Ok(Self {
            changes: change.collect(),
            segment_reflectivities: telescope.amplitudes().iter().map(|amplitude| amplitude * amplitude).collect(),
            scene,
            telescope,
        })
    }

    /// The optics of `scene` as they are.
    ///
    /// # Errors
    /// Those of building the telescope.
    pub(crate) fn of(scene: &System) -> Result<Self> {
        Self::new(scene, scene.clone(), Vec::new())
    }

    /// Telescope with the estimated optics.
    pub(crate) fn telescope(&self) -> &Telescope {
        &self.telescope
    }

    /// Warnings for users, a sentence for each estimate that differs from the scene.
    pub fn warnings(&self) -> Vec<String> {
        let mut sentences: Vec<String> = self.changes.iter().map(sentence).collect();
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
