//! One image's fit on the CPU, from its first evaluation to its last, on one thread: its data stay in that core's cache,
//! and no thread waits for another.

use super::prepare::Prepared;
use super::runner::{Next, Runner};
use crate::Result;
use crate::imaging::{CpuChain, Evaluation, Loaded, Polynomial, Scratch};
use ndarray::ArrayView1;

/// One thread's memory for it.
pub(super) struct Alone<T: Polynomial> {
    scratch: Scratch<T>,
    evaluation: Evaluation,
    /// A PSF in double precision: sums over it find flux, background and χ².
    psf: Vec<f64>,
}

impl<T: Polynomial> Alone<T> {
    pub(super) fn new(chain: &CpuChain<T>) -> Self {
        let pixels = chain.optics().sampling().pixels;
        Self { scratch: chain.scratch(), evaluation: chain.evaluation(), psf: vec![0.0; pixels * pixels] }
    }

    /// Leads a runner that has begun to the minimum of `image`, in the memory of `loaded`.
    ///
    /// # Errors
    /// As [`CpuChain::set`].
    pub(super) fn lead(
        &mut self,
        chain: &CpuChain<T>,
        runner: &mut Runner,
        image: &mut Prepared,
        loaded: &mut Loaded<T>,
    ) -> Result<()> {
        let mut next = Next::Reload;
        while next != Next::Nothing {
            if next == Next::Reload {
                chain.set(loaded, &image.exposure)?;
            }
            let point = ArrayView1::from(runner.point());
            if next == Next::Psf {
                let psf = chain.psf_in(point, &mut self.scratch);
                self.psf.iter_mut().zip(psf).for_each(|(wide, &value)| *wide = value.wide());
                next = runner.settle(&self.psf, image);
            } else {
                chain.evaluate_one(loaded, point, &mut self.scratch, &mut self.evaluation);
                next = runner.tell(&self.evaluation);
            }
        }
        Ok(())
    }

    /// Objective and gradient of `loaded` at a point.
    pub(super) fn evaluate(
        &mut self,
        chain: &CpuChain<T>,
        loaded: &Loaded<T>,
        coefficients_nm: ArrayView1<f64>,
    ) -> &Evaluation {
        chain.evaluate_one(loaded, coefficients_nm, &mut self.scratch, &mut self.evaluation);
        &self.evaluation
    }
}
