//! Linear map of a frame, from slopes and commands to the change of the commands: a dense matrix,
//! or a sparse reconstructor.

use super::modal_step::{ModalStep, ModalWorkspace};
use super::regularized::{SparseStep, SparseWorkspace};
use super::step;
use super::step::StepMatrix;

/// Map of a control law.
#[derive(Debug)]
pub(super) enum StepMap {
    /// `[B]`, or `[B A]` if the law uses the command that was on the mirror while the slopes were
    /// measured.
    Dense(StepMatrix),
    /// `B` by modes, with the optical gain of each.
    Modal(ModalStep),
    Sparse(SparseStep),
}

/// Work arrays of a [`StepMap`].
#[derive(Debug, Clone)]
pub(super) enum StepMapWorkspace {
    Dense(step::StepWorkspace),
    Modal(ModalWorkspace),
    Sparse(SparseWorkspace),
}

impl StepMap {
    /// Allocates the arrays of [`apply`](Self::apply).
    pub(super) fn workspace(&self) -> StepMapWorkspace {
        match self {
            Self::Dense(matrix) => StepMapWorkspace::Dense(matrix.workspace()),
            Self::Modal(step) => StepMapWorkspace::Modal(step.workspace()),
            Self::Sparse(step) => StepMapWorkspace::Sparse(step.workspace()),
        }
    }

    /// Change of the commands by `slopes`, which were measured with `commands` on the mirror.
    /// `workspace` is one of this map.
    pub(super) fn apply<'a>(&self, slopes: &[f32], commands: &[f32], workspace: &'a mut StepMapWorkspace) -> &'a [f32] {
        match (self, workspace) {
            (Self::Dense(matrix), StepMapWorkspace::Dense(workspace)) => matrix.apply(&[slopes, commands], workspace),
            (Self::Modal(step), StepMapWorkspace::Modal(workspace)) => step.apply(slopes, workspace),
            (Self::Sparse(step), StepMapWorkspace::Sparse(workspace)) => step.apply(slopes, commands, workspace),
            _ => unreachable!("a workspace is made by the map that uses it"),
        }
    }
}
