//! The control laws, folded into one linear step.

use super::controller::{Controller, Step};
use super::step::StepMatrix;
use super::{Inpainting, Plant, Reconstructor, Stability};
use crate::scene::{ControlScene, Fill, Loop};
use crate::{Error, Result};
use ndarray::Array2;
use std::sync::Arc;

/// A scene's controller for a plant: built once, started for each run.
#[derive(Debug, Clone)]
pub struct ControlLaw {
    step: Arc<Step>,
    reconstructor: Reconstructor,
    inpainting: Option<Inpainting>,
    stability: Stability,
}

impl ControlLaw {
    /// Inverts the interaction matrix of `plant` as `scene` says, and folds the law into one step.
    ///
    /// # Errors
    /// [`Error::Shape`] where the plant's arrays do not fit each other; [`Error::Value`] for values in it that are not
    /// finite, a stroke that is not positive, subapertures out of order, too few good ones to inpaint, no mode left to
    /// control, `basis = "kl"` without modes, or a gain, leak or lag that the scene would have refused.
    pub fn new(scene: &ControlScene, plant: &Plant) -> Result<Self> {
        check(scene)?;
        plant.check()?;
        let reconstructor = Reconstructor::new(scene, plant)?;
        let inpainting = match scene.fill {
            Fill::Inpaint if plant.mask.contains(&true) => {
                Some(Inpainting::new(plant.lenslets_across, plant.subapertures, plant.mask)?)
            }
            _ => None,
        };
        let stability = Stability::of(scene, &reconstructor, inpainting.as_ref(), plant.interaction)?;

        let command = reconstructor.command_matrix() * scene.gain;
        let filled = inpainting.as_ref().map(|inpainting| inpainting.before(&command));
        let on_commands = on_commands(scene.r#loop, &command, filled.as_ref(), plant.interaction);
        let retained = retained(scene, scene.gain) as f32;
        let parts: Vec<_> = [Some(filled.unwrap_or(command)), on_commands].into_iter().flatten().collect();
        let step = Step {
            slopes: plant.interaction.nrows(),
            actuators: plant.actuators(),
            lag_frames: scene.lag_frames,
            retained,
            matrix: StepMatrix::new(&parts),
            stroke_limit_nm: plant.stroke_limit_nm.map_or(f32::INFINITY, |limit| limit as f32),
        };
        Ok(Self { step: Arc::new(step), reconstructor, inpainting, stability })
    }

    /// How the loop behaves where the sensor and the mirror are as the interaction matrix says.
    pub fn stability(&self) -> &Stability {
        &self.stability
    }

    /// The inverse of the interaction matrix.
    pub fn reconstructor(&self) -> &Reconstructor {
        &self.reconstructor
    }

    /// What stands in for masked slopes, where the law inpaints any.
    pub fn inpainting(&self) -> Option<&Inpainting> {
        self.inpainting.as_ref()
    }

    /// A controller with a flat mirror.
    pub fn start(&self) -> Controller {
        Controller::new(Arc::clone(&self.step))
    }
}

/// The share of the last command that a law keeps, whatever the slopes.
pub(super) fn retained(scene: &ControlScene, gain: f64) -> f64 {
    match scene.r#loop {
        Loop::Closed | Loop::FullTurbulenceSlopes => 1.0 - scene.leak,
        Loop::PseudoOpenLoop => 1.0 - scene.leak - gain,
    }
}

/// What the command on the mirror adds by way of its own slopes: `command` is gR, `filled` is gRM where it differs.
fn on_commands(
    r#loop: Loop,
    command: &Array2<f64>,
    filled: Option<&Array2<f64>>,
    interaction: &Array2<f64>,
) -> Option<Array2<f64>> {
    match r#loop {
        Loop::Closed => None,
        Loop::PseudoOpenLoop => Some(filled.unwrap_or(command).dot(interaction)),
        // Without a fill the mirror's slopes come and go.
        Loop::FullTurbulenceSlopes => filled.map(|filled| (filled - command).dot(interaction)),
    }
}

/// Values that the scene's own validation refuses, for a scene that was changed after it.
fn check(scene: &ControlScene) -> Result<()> {
    let value = |text: String| Err(Error::Value(text));
    if !(scene.gain.is_finite() && scene.gain > 0.0) {
        return value(format!("a gain of {} is impossible: it must be positive", scene.gain));
    }
    if !(0.0..1.0).contains(&scene.leak) {
        return value(format!("a leak of {} is impossible: 0 to below 1 is accepted", scene.leak));
    }
    if !(1..=100).contains(&scene.lag_frames) {
        return value(format!("a lag of {} frames is impossible: 1 to 100 are accepted", scene.lag_frames));
    }
    if let Some(number) = scene.condition_number.filter(|number| number.is_nan() || *number < 1.0) {
        return value(format!("a condition number of {number} is impossible: 1 or more is accepted"));
    }
    Ok(())
}
