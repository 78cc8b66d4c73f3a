//! The chain with a phase of its own at every lit sample, and an amplitude of its own for every segment: what a retrieval
//! of the whole wavefront varies. The modes are there too; an evaluation whose free phase is zero and whose amplitudes are
//! 1 is bitwise that of the modes alone.

use super::{Backward, CpuChain, Evaluation, Field, Loaded, Polynomial, Scratch, check_batch, vectorised};
use crate::{Error, Result};
use ndarray::{ArrayView1, ArrayView2};
use pulp::NullaryFnOnce;
use rayon::prelude::*;

impl<T: Polynomial> CpuChain<T> {
    /// Objective and gradient of one image at `coefficients_nm` and, at each lit sample, `free_turns` (phase over 2π)
    /// beside them: the gradient in the coefficients into `evaluation`, that in the free phase, per turn, into
    /// `free_gradient`. Nothing is allocated.
    ///
    /// # Panics
    /// Where the pieces were made by a chain of another model, or the free phase does not have a number for each lit
    /// sample.
    pub fn evaluate_free(
        &self,
        image: &Loaded<T>,
        coefficients_nm: ArrayView1<f64>,
        free_turns: &[T],
        scratch: &mut Scratch<T>,
        evaluation: &mut Evaluation,
        free_gradient: &mut [T],
    ) {
        let lit = self.optics.parts().weights.lit.len();
        assert_eq!((free_turns.len(), free_gradient.len()), (lit, lit), "a number for each lit sample");
        vectorised(ForwardFree { chain: self, coefficients_nm, free_turns, memory: scratch });
        vectorised(Backward { chain: self, image, memory: scratch, evaluation });
        free_gradient.fill(T::zero());
        for (stages, colour) in self.colours.iter().zip(&scratch.colours) {
            stages.field.free_gradient(&colour.field, free_gradient);
        }
    }

    /// As [`CpuChain::evaluate_free`] for `images` of the batch, on every core: `free_turns` and `free_gradient` are
    /// `[image][lit sample]`, rounded to the chain's precision.
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
        let lit = self.optics.parts().weights.lit.len();
        let given = (free_turns.len(), free_gradient.len());
        if given != (images.len() * lit, images.len() * lit) {
            return Err(Error::Shape(format!(
                "{} free phases and room for {} derivatives were given for {} images of {lit} samples",
                given.0,
                given.1,
                images.len()
            )));
        }
        let rows = free_turns.par_chunks_exact(lit).zip(free_gradient.par_chunks_exact_mut(lit));
        let one = |i: usize, turns: &[f64], gradient: &mut [f64]| {
            let (mut memory, mut evaluation) = (self.take(), self.evaluation());
            let turns: Vec<T> = turns.iter().map(|&turns| T::of(turns)).collect();
            let mut slopes = vec![T::zero(); lit];
            let (image, at) = (&self.images[images[i]], coefficients_nm.row(i));
            self.evaluate_free(image, at, &turns, &mut memory, &mut evaluation, &mut slopes);
            self.put_back(memory);
            gradient.iter_mut().zip(slopes).for_each(|(out, slope)| *out = slope.wide());
            evaluation
        };
        Ok(rows.enumerate().map(|(i, (turns, gradient))| one(i, turns, gradient)).collect())
    }

    /// The PSF (m×m, `[y][x]`, sum 1 over an unbounded detector) there, in the caller's memory.
    ///
    /// # Panics
    /// As [`CpuChain::evaluate_free`].
    pub fn psf_free_in<'s>(
        &self,
        coefficients_nm: ArrayView1<f64>,
        free_turns: &[T],
        scratch: &'s mut Scratch<T>,
    ) -> &'s [T] {
        assert_eq!(free_turns.len(), self.optics.parts().weights.lit.len(), "a number for each lit sample");
        vectorised(ForwardFree { chain: self, coefficients_nm, free_turns, memory: scratch });
        &scratch.psf
    }
}

impl<T: Polynomial> CpuChain<T> {
    /// Whether [`Scratch::set_amplitudes`] is heard: not where segments tilt.
    pub fn has_amplitudes(&self) -> bool {
        self.fields().all(Field::has_amplitudes)
    }

    /// The gradient of the last [`CpuChain::evaluate_free`] in `scratch` by the logarithm of each segment's amplitude.
    pub fn amplitude_gradient(&self, scratch: &Scratch<T>, gradient: &mut [f64]) {
        gradient.fill(0.0);
        for (stages, colour) in self.colours.iter().zip(&scratch.colours) {
            stages.field.amplitude_gradient(&colour.field, gradient);
        }
    }
}

impl<T: Polynomial> Scratch<T> {
    /// The amplitude of each segment over that of its weights, from now on; 1 where nothing was said.
    pub fn set_amplitudes(&mut self, amplitudes: impl Iterator<Item = f64> + Clone) {
        for colour in &mut self.colours {
            let own = colour.field.amplitudes().iter_mut();
            own.zip(amplitudes.clone()).for_each(|(own, amplitude)| *own = T::of(amplitude));
        }
    }
}

/// Coefficients and free phase to the PSF.
struct ForwardFree<'a, T: Polynomial> {
    chain: &'a CpuChain<T>,
    coefficients_nm: ArrayView1<'a, f64>,
    free_turns: &'a [T],
    memory: &'a mut Scratch<T>,
}

impl<T: Polynomial> NullaryFnOnce for ForwardFree<'_, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { chain, coefficients_nm, free_turns, memory } = self;
        for (stages, colour) in chain.colours.iter().zip(&mut memory.colours) {
            stages.field.forward_free(coefficients_nm, free_turns, &mut colour.field, &mut colour.pupil);
        }
        chain.to_psf(memory);
    }
}
