//! CPU worker: the MAP retrieval of one image on one thread.

use super::results::RetrievedImage;
use super::task::KnownOfImage;
use super::workspace::{RetrievalWorkspace, ThreadBuffers};
use crate::Result;
use crate::imaging::Polynomial;
use crate::modal::PreparedFrame;
use crate::optimize::Advance;

impl<T: Polynomial> RetrievalWorkspace<T> {
    /// Retrieves the wavefront of one image on this thread. `check_cancel` is called before each
    /// evaluation: an image of a large telescope takes seconds.
    ///
    /// # Errors
    /// Those of `check_cancel`; broken promises of this module's.
    pub(super) fn retrieve(
        &self,
        mut prepared: PreparedFrame,
        known: KnownOfImage,
        check_cancel: impl Fn() -> Result<()>,
    ) -> Result<RetrievedImage> {
        let model = &self.model;
        let (mut optimisation, mut buffers) = (self.take_optimisation()?, self.take_buffers());
        optimisation.begin(model, &mut prepared, known)?;
        model.chain.set(&mut buffers.loaded, &prepared.exposure)?;
        loop {
            check_cancel()?;
            optimisation.place(model, &mut buffers.preconditioner);
            let ThreadBuffers { preconditioner, scratch, turns_bar, loaded, evaluation } = &mut buffers;
            optimisation.set_amplitudes(scratch);
            model.chain.evaluate_free(loaded, optimisation.wavefront(), scratch, evaluation, turns_bar);
            let amplitude_gradient = |gradient: &mut [f64]| model.chain.amplitude_gradient(scratch, gradient);
            let progress = optimisation.advance(model, evaluation, turns_bar, amplitude_gradient, preconditioner)?;
            if progress == Advance::Done {
                break;
            }
        }
        let retrieved = optimisation.result(model, &prepared, &mut buffers.preconditioner, &mut buffers.scratch);
        self.optimisations.put_back(optimisation);
        self.buffers.put_back(buffers);
        Ok(retrieved)
    }
}
