//! Map of a frame by modes: slopes to controlled modes, a factor for each, modes to commands.

use super::step::{self, StepMatrix};
use ndarray::Array2;

/// Product `modes · diag(factors) · inverse`.
#[derive(Debug)]
pub(super) struct ModalStep {
    inverse: StepMatrix,
    modes: StepMatrix,
    controlled: usize,
}

/// Work arrays of a [`ModalStep`], and the factors.
#[derive(Debug, Clone)]
pub(super) struct ModalWorkspace {
    inverse: step::StepWorkspace,
    modes: step::StepWorkspace,
    coefficients: Vec<f32>,
    factors: Vec<f32>,
}

impl ModalStep {
    /// Step of `inverse`, `[controlled, slopes]`, and `modes`, `[actuators, controlled]`.
    pub(super) fn new(inverse: Array2<f64>, modes: Array2<f64>) -> Self {
        let controlled = inverse.nrows();
        Self { inverse: StepMatrix::new(&[inverse]), modes: StepMatrix::new(&[modes]), controlled }
    }

    /// Arrays of [`apply`](Self::apply), with factors of 1.
    pub(super) fn workspace(&self) -> ModalWorkspace {
        ModalWorkspace {
            inverse: self.inverse.workspace(),
            modes: self.modes.workspace(),
            coefficients: vec![0.0; self.controlled],
            factors: vec![1.0; self.controlled],
        }
    }

    /// Change of the commands by `slopes`.
    pub(super) fn apply<'a>(&self, slopes: &[f32], workspace: &'a mut ModalWorkspace) -> &'a [f32] {
        let found = self.inverse.apply(&[slopes], &mut workspace.inverse);
        for ((out, found), factor) in workspace.coefficients.iter_mut().zip(found).zip(&workspace.factors) {
            *out = found * factor;
        }
        self.modes.apply(&[&workspace.coefficients], &mut workspace.modes)
    }
}

impl ModalWorkspace {
    /// Divides each mode by its gain from now on.
    pub(super) fn divide_by(&mut self, gains: &[f32]) {
        self.factors.iter_mut().zip(gains).for_each(|(factor, gain)| *factor = 1.0 / gain);
    }
}
