//! One image's fit on the CPU, from its first evaluation to its last, on one thread: its data stay in that core's cache,
//! and no thread waits for another.

use super::prepare::Prepared;
use super::runner::{Next, Runner};
use crate::Result;
use crate::imaging::{CpuChain, Evaluation, Flat, Loaded, Polynomial, Scratch};
use ndarray::ArrayView1;

/// One thread's memory for it.
pub(super) struct Alone<T: Polynomial> {
    scratch: Scratch<T>,
    /// Where most fits begin.
    flat: Flat<T>,
    evaluation: Evaluation,
    /// A PSF in double precision: sums over it find flux, background and χ².
    psf: Vec<f64>,
    /// The coefficients whose PSF stands in `scratch`, nm.
    seen_nm: Vec<f64>,
}

impl<T: Polynomial> Alone<T> {
    pub(super) fn new(chain: &CpuChain<T>) -> Self {
        let pixels = chain.optics().sampling().pixels;
        Self {
            scratch: chain.scratch(),
            flat: chain.flat(),
            evaluation: chain.evaluation(),
            psf: vec![0.0; pixels * pixels],
            seen_nm: vec![f64::NAN; chain.optics().modes()],
        }
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
        chain.set(loaded, &image.exposure)?;
        let mut next = Next::Evaluation;
        if runner.point().iter().all(|&nm| nm == 0.0) {
            chain.evaluate_flat(loaded, &mut self.flat, &mut self.evaluation);
            next = runner.tell(&self.evaluation);
        }
        loop {
            next = match next {
                Next::Evaluation => {
                    chain.evaluate_one(loaded, runner.point().into(), &mut self.scratch, &mut self.evaluation);
                    self.seen_nm.copy_from_slice(runner.point());
                    runner.tell(&self.evaluation)
                }
                Next::Renewal => {
                    self.see(chain, runner.point());
                    runner.renew(&self.psf, image)?;
                    chain.set(loaded, &image.exposure)?;
                    chain.evaluate_there(loaded, &mut self.scratch, &mut self.evaluation);
                    runner.tell(&self.evaluation)
                }
                Next::Psf => {
                    // Most fits end where they were evaluated last.
                    if self.seen_nm == runner.point() {
                        widen(self.scratch.psf(), &mut self.psf);
                    } else {
                        self.see(chain, runner.point());
                    }
                    runner.settle(&self.psf, image);
                    return Ok(());
                }
            };
        }
    }

    /// Makes the PSF at a point.
    fn see(&mut self, chain: &CpuChain<T>, point_nm: &[f64]) {
        widen(chain.psf_in(point_nm.into(), &mut self.scratch), &mut self.psf);
        self.seen_nm.copy_from_slice(point_nm);
    }

    /// Objective and gradient of `loaded` at a point.
    pub(super) fn evaluate(
        &mut self,
        chain: &CpuChain<T>,
        loaded: &Loaded<T>,
        coefficients_nm: ArrayView1<f64>,
    ) -> &Evaluation {
        chain.evaluate_one(loaded, coefficients_nm, &mut self.scratch, &mut self.evaluation);
        self.seen_nm.fill(f64::NAN);
        &self.evaluation
    }
}

fn widen<T: Polynomial>(from: &[T], to: &mut [f64]) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to = from.wide());
}
