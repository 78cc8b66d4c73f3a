//! Control laws, folded into one linear step.

use super::controller::{ControlStep, Controller};
use super::inpaint::Inpainting;
use super::modal_step::ModalStep;
use super::plant::Plant;
use super::reconstructor::Reconstructor;
use super::regularized::{SparseReconstructor, SparseStep};
use super::stability::{Stability, retained};
use super::step::StepMatrix;
use super::step_map::StepMap;
use crate::scene::{ControlScene, Fill, Loop, OpticalGainMethod, ReconstructorKind};
use crate::{Error, Result};
use ndarray::Array2;
use std::sync::Arc;

/// Control law of a scene for a plant. It is built once; [`ControlLaw::start`] creates a controller
/// for each run.
#[derive(Debug, Clone)]
pub struct ControlLaw {
    step: Arc<ControlStep>,
    inverse: Inverse,
    inpainting: Option<Inpainting>,
    stability: Stability,
}

/// The reconstructor of a law.
#[derive(Debug, Clone)]
enum Inverse {
    Dense(Reconstructor),
    Sparse(Arc<SparseReconstructor>),
}

impl ControlLaw {
    /// Inverts the interaction matrix of `plant` with the settings of `scene`, and folds the law
    /// into one step.
    ///
    /// # Errors
    /// [`Error::Shape`] for arrays of the plant with inconsistent shapes; [`Error::Value`] for
    /// values that are not finite, a stroke that is not positive, subapertures out of order, too
    /// few unmasked ones to inpaint, no mode left to control, `basis = "kl"` without modes, or a
    /// gain, leak or lag outside the scene's ranges.
    pub fn new(scene: &ControlScene, plant: &Plant) -> Result<Self> {
        check(scene)?;
        plant.check()?;
        match scene.reconstructor {
            ReconstructorKind::Dense => Self::dense(scene, plant),
            ReconstructorKind::Sparse => Self::sparse(scene, plant),
        }
    }

    fn dense(scene: &ControlScene, plant: &Plant) -> Result<Self> {
        let reconstructor = Reconstructor::new(scene, plant)?;
        let inpainting = match scene.fill {
            Fill::Inpaint if plant.mask.contains(&true) => {
                Some(Inpainting::new(plant.lenslets_across, plant.subapertures, plant.mask)?)
            }
            _ => None,
        };
        let stability = Stability::new(scene, &reconstructor, inpainting.as_ref(), plant.interaction)?;

        if scene.optical_gains == OpticalGainMethod::Dither {
            let inverse = reconstructor.inverse();
            let inverse =
                inpainting.as_ref().map_or_else(|| inverse.clone(), |inpainting| inpainting.fold_into(inverse));
            let modal = ModalStep::new(inverse, reconstructor.modes() * scene.gain);
            let step = step(scene, plant, StepMap::Modal(modal));
            return Ok(Self { step: Arc::new(step), inverse: Inverse::Dense(reconstructor), inpainting, stability });
        }
        let command = reconstructor.command_matrix() * scene.gain;
        let filled = inpainting.as_ref().map(|inpainting| inpainting.fold_into(&command));
        let on_commands = on_commands(scene.r#loop, &command, filled.as_ref(), plant.interaction);
        let parts: Vec<_> = [Some(filled.unwrap_or(command)), on_commands].into_iter().flatten().collect();
        let step = step(scene, plant, StepMap::Dense(StepMatrix::new(&parts)));
        Ok(Self { step: Arc::new(step), inverse: Inverse::Dense(reconstructor), inpainting, stability })
    }

    fn sparse(scene: &ControlScene, plant: &Plant) -> Result<Self> {
        if plant.command_matrix.is_some() || scene.fill == Fill::Inpaint {
            let sentence = "control.reconstructor = \"sparse\" with a command matrix or fill = \"inpaint\" is not accepted; \"dense\" is needed";
            return Err(Error::Value(sentence.into()));
        }
        let reconstructor = Arc::new(SparseReconstructor::new(scene, plant)?);
        let stability = Stability::of_regularised(scene, reconstructor.controlled(), plant.actuators())?;
        let step = step(scene, plant, StepMap::Sparse(SparseStep::new(scene, Arc::clone(&reconstructor))));
        Ok(Self { step: Arc::new(step), inverse: Inverse::Sparse(reconstructor), inpainting: None, stability })
    }

    /// Stability of the loop for a sensor and a mirror that the interaction matrix describes
    /// exactly.
    pub fn stability(&self) -> &Stability {
        &self.stability
    }

    /// The inverse of the interaction matrix; `None` for `reconstructor = "sparse"`.
    pub fn reconstructor(&self) -> Option<&Reconstructor> {
        match &self.inverse {
            Inverse::Dense(reconstructor) => Some(reconstructor),
            Inverse::Sparse(_) => None,
        }
    }

    /// Command matrix R, `[actuators, 2·subapertures]`, nm per slope.
    pub fn command_matrix(&self) -> Array2<f64> {
        match &self.inverse {
            Inverse::Dense(reconstructor) => reconstructor.command_matrix(),
            Inverse::Sparse(reconstructor) => reconstructor.command_matrix(),
        }
    }

    /// Least operations and bytes of a frame with a sparse reconstructor.
    pub(in crate::ao) fn sparse_work(&self) -> Option<[f64; 2]> {
        match &self.step.matrix {
            StepMap::Dense(_) | StepMap::Modal(_) => None,
            StepMap::Sparse(step) => Some(step.work()),
        }
    }

    /// Inpainting of masked slopes; `None` if the law uses none.
    pub fn inpainting(&self) -> Option<&Inpainting> {
        self.inpainting.as_ref()
    }

    /// Creates a controller with a flat mirror.
    pub fn start(&self) -> Controller {
        Controller::new(Arc::clone(&self.step))
    }
}

/// The step of a law with the given map.
fn step(scene: &ControlScene, plant: &Plant, matrix: StepMap) -> ControlStep {
    ControlStep {
        slopes: plant.interaction.nrows(),
        actuators: plant.actuators(),
        lag: scene.lag(),
        retained: retained(scene, scene.gain) as f32,
        matrix,
        stroke_limit_nm: plant.stroke_limit_nm.map_or(f32::INFINITY, |limit| limit as f32),
    }
}

/// Matrix from the commands on the mirror to the next commands, for laws that add back the mirror's
/// own slopes; `command` is gR, `filled` is gRM if slopes are filled.
fn on_commands(
    r#loop: Loop,
    command: &Array2<f64>,
    filled: Option<&Array2<f64>>,
    interaction: &Array2<f64>,
) -> Option<Array2<f64>> {
    match r#loop {
        Loop::Closed => None,
        Loop::PseudoOpenLoop => Some(filled.unwrap_or(command).dot(interaction)),
        // Without a fill the mirror's slopes are added and subtracted unchanged, and cancel.
        Loop::FullTurbulenceSlopes => filled.map(|filled| (filled - command).dot(interaction)),
    }
}

/// Checks the values that the scene's validation also checks: the struct's fields are public and
/// may have been changed.
fn check(scene: &ControlScene) -> Result<()> {
    let value = |text: String| Err(Error::Value(text));
    if !(scene.gain.is_finite() && scene.gain > 0.0) {
        return value(format!("a gain of {} is impossible; a positive number is needed", scene.gain));
    }
    if !(0.0..1.0).contains(&scene.leak) {
        return value(format!("a leak of {} is impossible; 0 to below 1 is accepted", scene.leak));
    }
    if !(1.0..=100.0).contains(&scene.lag_frames) {
        return value(format!("a lag of {} frames is impossible; 1 to 100 are accepted", scene.lag_frames));
    }
    if let Some(number) = scene.condition_number.filter(|number| number.is_nan() || *number < 1.0) {
        return value(format!("a condition number of {number} is impossible; 1 or more is accepted"));
    }
    Ok(())
}
