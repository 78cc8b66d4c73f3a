//! Memory of a retrieval that images and threads take in turn: optimisations and buffers of a
//! thread.

use super::model::MapModel;
use super::optimisation::MapOptimisation;
use super::preconditioner::PreconditionerScratch;
use crate::Result;
use crate::imaging::{Evaluation, LoadedImage, Polynomial, Scratch};
use std::sync::Mutex;

/// Buffers of one thread.
pub(super) struct ThreadBuffers<T: Polynomial> {
    pub(super) preconditioner: PreconditionerScratch<T>,
    pub(super) scratch: Scratch<T>,
    /// Derivative by the free phase of each sample, per turn.
    pub(super) turns_bar: Vec<T>,
    pub(super) loaded: LoadedImage<T>,
    pub(super) evaluation: Evaluation,
}

impl<T: Polynomial> ThreadBuffers<T> {
    fn new(model: &MapModel<T>) -> Self {
        let chain = &model.chain;
        Self {
            preconditioner: model.preconditioner.scratch(),
            scratch: chain.scratch(),
            turns_bar: vec![T::zero(); model.samples()],
            loaded: chain.empty_image(),
            evaluation: chain.evaluation(),
        }
    }
}

/// Idle memory that is used again.
pub(super) struct Pool<M>(Mutex<Vec<M>>);

impl<M> Pool<M> {
    fn new() -> Self {
        Self(Mutex::new(Vec::new()))
    }

    fn take(&self) -> Option<M> {
        self.0.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).pop()
    }

    pub(super) fn put_back(&self, memory: M) {
        self.0.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).push(memory);
    }
}

/// A MAP objective with the memory in which it is minimised.
pub(super) struct RetrievalWorkspace<T: Polynomial> {
    pub(super) model: MapModel<T>,
    pub(super) optimisations: Pool<MapOptimisation<T>>,
    pub(super) buffers: Pool<ThreadBuffers<T>>,
}

impl<T: Polynomial> RetrievalWorkspace<T> {
    pub(super) fn new(model: MapModel<T>) -> Self {
        Self { model, optimisations: Pool::new(), buffers: Pool::new() }
    }

    /// Takes an idle optimisation, or makes one.
    ///
    /// # Errors
    /// Broken promises of this module's.
    pub(super) fn take_optimisation(&self) -> Result<MapOptimisation<T>> {
        self.optimisations.take().map_or_else(|| MapOptimisation::new(&self.model), Ok)
    }

    /// Takes idle buffers, or makes them.
    pub(super) fn take_buffers(&self) -> ThreadBuffers<T> {
        self.buffers.take().unwrap_or_else(|| ThreadBuffers::new(&self.model))
    }
}
