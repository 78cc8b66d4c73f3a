//! Retrievals on the CPU: each thread has its own image.

use super::engine::Engine;
use super::optimisation::Found;
use super::preconditioner::SquareScratch;
use super::retriever::Statics;
use crate::Result;
use crate::estimate::Prepared;
use crate::imaging::{Evaluation, Loaded, Polynomial, Scratch};
use crate::optimize::Progress;

/// What one thread works in.
pub(super) struct Room<T: Polynomial> {
    pub(super) square: SquareScratch<T>,
    pub(super) scratch: Scratch<T>,
    /// Derivative by the free phase.
    pub(super) turns_bar: Vec<T>,
    loaded: Loaded<T>,
    evaluation: Evaluation,
}

impl<T: Polynomial> Room<T> {
    pub(super) fn new(engine: &Engine<T>) -> Self {
        let chain = &engine.chain;
        Self {
            square: engine.square.scratch(),
            scratch: chain.scratch(),
            turns_bar: vec![T::zero(); engine.lit()],
            loaded: chain.room(),
            evaluation: chain.evaluation(),
        }
    }
}

impl<T: Polynomial> Engine<T> {
    /// The wavefront behind one image, on this thread.
    ///
    /// # Errors
    /// Broken promises of this module's.
    pub(super) fn retrieve(&self, mut prepared: Prepared, statics: Option<&Statics>) -> Result<Found> {
        let (mut descent, mut room) = (self.descent()?, self.room());
        descent.begin(self, &mut prepared, statics)?;
        self.chain.set(&mut room.loaded, &prepared.exposure)?;
        loop {
            descent.place(self, &mut room.square);
            let Room { square, scratch, turns_bar, loaded, evaluation } = &mut room;
            descent.show_amplitudes(scratch);
            let (at, turns) = (descent.coefficients_nm(), descent.turns());
            self.chain.evaluate_free(loaded, at, turns, scratch, evaluation, turns_bar);
            let of_amplitudes = |gradient: &mut [f64]| self.chain.amplitude_gradient(scratch, gradient);
            if descent.tell(self, evaluation, turns_bar, of_amplitudes, square)? == Progress::Done {
                break;
            }
        }
        let found = descent.found(self, &prepared, &mut room.square, &mut room.scratch);
        self.descents.put_back(descent);
        self.rooms.put_back(room);
        Ok(found)
    }
}
