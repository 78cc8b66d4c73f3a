//! Linear map of a frame, from slopes and commands to the change of the commands: a dense matrix, or a sparse reconstructor.

use super::modal_step::{ModalStep, ModalWorkspace};
use super::regularized::{SparseStep, SparseWorkspace};
use super::step;
use super::step::StepMatrix;

/// Map of a control law.
#[derive(Debug)]
pub(super) enum StepMap {
    /// `[B]`, or `[B A]` if the law uses the command that was on the mirror while the slopes were measured.
    Dense(StepMatrix),
    /// `B` by modes, with the optical gain of each.
    Modal(ModalStep),
    Sparse(SparseStep),
}

/// Work arrays of a [`StepMap`].
#[derive(Debug, Clone)]
pub(super) enum Workspace {
    Dense(step::Workspace),
    Modal(ModalWorkspace),
    Sparse(SparseWorkspace),
}

impl StepMap {
    /// Allocates the arrays of [`apply`](Self::apply).
    pub(super) fn workspace(&self) -> Workspace {
        match self {
            Self::Dense(matrix) => Workspace::Dense(matrix.workspace()),
            Self::Modal(step) => Workspace::Modal(step.workspace()),
            Self::Sparse(step) => Workspace::Sparse(step.workspace()),
        }
    }

    /// Change of the commands by `slopes`, which were measured with `commands` on the mirror. `workspace` is one of this map.
    pub(super) fn apply<'a>(&self, slopes: &[f32], commands: &[f32], workspace: &'a mut Workspace) -> &'a [f32] {
        match (self, workspace) {
            (Self::Dense(matrix), Workspace::Dense(workspace)) => matrix.apply(&[slopes, commands], workspace),
            (Self::Modal(step), Workspace::Modal(workspace)) => step.apply(slopes, workspace),
            (Self::Sparse(step), Workspace::Sparse(workspace)) => step.apply(slopes, commands, workspace),
            _ => unreachable!("a workspace is made by the map that uses it"),
        }
    }
}
