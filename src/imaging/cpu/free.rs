//! The CPU chain with a free phase (one number per illuminated sample) and an amplitude per segment
//! in addition to the modes, for MAP wavefront retrieval. With a free phase of zero and amplitudes
//! of 1, an evaluation is bitwise that of the modes.

use super::{Backward, CpuChain, Evaluation, Field, LoadedImage, Polynomial, Scratch, check_batch, vectorised};
use crate::{Error, Result};
use ndarray::{ArrayView1, ArrayView2};
use pulp::NullaryFnOnce;
use rayon::prelude::*;

/// A wavefront: that of the coefficients of the model's modes, plus a free phase.
#[derive(Clone, Copy)]
pub struct FreeWavefront<'a, T> {
    /// Coefficient of each mode, nm.
    pub coefficients_nm: ArrayView1<'a, f64>,
    /// Free phase over 2π at each illuminated sample.
    pub turns: &'a [T],
}

impl<T: Polynomial> CpuChain<T> {
    /// Objective and gradient of one image at a wavefront. The gradient by the coefficients is
    /// written into `evaluation`, that by the free phase, per turn, into `free_gradient`. Nothing
    /// is allocated.
    ///
    /// # Panics
    /// If an argument was made by a chain of another model, or the free phase does not have one
    /// number per illuminated sample.
    pub fn evaluate_free(
        &self,
        image: &LoadedImage<T>,
        at: FreeWavefront<T>,
        scratch: &mut Scratch<T>,
        evaluation: &mut Evaluation,
        free_gradient: &mut [T],
    ) {
        let illuminated = self.optics.parts().weights.illuminated.len();
        assert_eq!(
            (at.turns.len(), free_gradient.len()),
            (illuminated, illuminated),
            "one number per illuminated sample"
        );
        vectorised(ForwardFree { chain: self, at, memory: scratch });
        vectorised(Backward { chain: self, image, memory: scratch, evaluation });
        free_gradient.fill(T::zero());
        for (stages, colour) in self.colours.iter().zip(&scratch.colours) {
            stages.field.free_gradient(&colour.field, free_gradient);
        }
    }

    /// As [`CpuChain::evaluate_free`] for `images` of the batch, on every core: `free_turns` and
    /// `free_gradient` are `[image][illuminated sample]`, rounded to the precision of the chain.
    ///
    /// # Errors
    /// [`Error::Shape`] where the arrays do not fit the batch and the model.
    pub fn evaluate_free_all(
        &self,
        images: &[usize],
        coefficients_nm: ArrayView2<f64>,
        free_turns: &[f64],
        free_gradient: &mut [f64],
    ) -> Result<Vec<Evaluation>> {
        check_batch(images, coefficients_nm, self.images.len(), self.optics.modes())?;
        let illuminated = self.optics.parts().weights.illuminated.len();
        let given = (free_turns.len(), free_gradient.len());
        if given != (images.len() * illuminated, images.len() * illuminated) {
            return Err(Error::Shape(format!(
                "{} free phases and space for {} derivatives were given for {} images of {illuminated} samples: one per sample is needed",
                given.0,
                given.1,
                images.len()
            )));
        }
        let rows = free_turns.par_chunks_exact(illuminated).zip(free_gradient.par_chunks_exact_mut(illuminated));
        let one = |i: usize, turns: &[f64], gradient: &mut [f64]| {
            let (mut memory, mut evaluation) = (self.take_scratch(), self.evaluation());
            let turns: Vec<T> = turns.iter().map(|&turns| T::narrow(turns)).collect();
            let mut slopes = vec![T::zero(); illuminated];
            let at = FreeWavefront { coefficients_nm: coefficients_nm.row(i), turns: &turns };
            self.evaluate_free(&self.images[images[i]], at, &mut memory, &mut evaluation, &mut slopes);
            self.return_scratch(memory);
            gradient.iter_mut().zip(slopes).for_each(|(out, slope)| *out = slope.widen());
            evaluation
        };
        Ok(rows.enumerate().map(|(i, (turns, gradient))| one(i, turns, gradient)).collect())
    }

    /// The PSF (m×m, `[y][x]`, sum 1 over an unbounded detector) at a wavefront, without
    /// allocation.
    ///
    /// # Panics
    /// As [`CpuChain::evaluate_free`].
    pub fn psf_free_in<'s>(&self, at: FreeWavefront<T>, scratch: &'s mut Scratch<T>) -> &'s [T] {
        assert_eq!(at.turns.len(), self.optics.parts().weights.illuminated.len(), "one number per illuminated sample");
        vectorised(ForwardFree { chain: self, at, memory: scratch });
        &scratch.psf
    }
}

impl<T: Polynomial> CpuChain<T> {
    /// Whether [`Scratch::set_amplitudes`] has an effect: not for a model whose segments tilt.
    pub fn has_amplitudes(&self) -> bool {
        self.fields().all(Field::has_amplitudes)
    }

    /// The gradient of the last [`CpuChain::evaluate_free`] in `scratch` by the logarithm of each
    /// segment's amplitude.
    pub fn amplitude_gradient(&self, scratch: &Scratch<T>, gradient: &mut [f64]) {
        gradient.fill(0.0);
        for (stages, colour) in self.colours.iter().zip(&scratch.colours) {
            stages.field.amplitude_gradient(&colour.field, gradient);
        }
    }
}

impl<T: Polynomial> Scratch<T> {
    /// Sets the amplitude of each segment relative to that of its weights, for all further
    /// evaluations; initially 1.
    pub fn set_amplitudes(&mut self, amplitudes: impl Iterator<Item = f64> + Clone) {
        for colour in &mut self.colours {
            let own = colour.field.amplitudes().iter_mut();
            own.zip(amplitudes.clone()).for_each(|(own, amplitude)| *own = T::narrow(amplitude));
        }
    }
}

/// Forward model: coefficients and free phase to PSF.
struct ForwardFree<'a, 'w, T: Polynomial> {
    chain: &'a CpuChain<T>,
    at: FreeWavefront<'w, T>,
    memory: &'a mut Scratch<T>,
}

impl<T: Polynomial> NullaryFnOnce for ForwardFree<'_, '_, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { chain, at: FreeWavefront { coefficients_nm, turns }, memory } = self;
        for (stages, colour) in chain.colours.iter().zip(&mut memory.colours) {
            stages.field.forward_free(coefficients_nm, turns, &mut colour.field, &mut colour.pupil);
        }
        chain.to_psf(memory);
    }
}
