//! Fits on a device: all images in lock-step.

use super::{Call, Image, ImageResult, Minimum, Shared, interrupted, unusable, write_start};
use crate::estimate::fit::Fitter;
use crate::estimate::prepare::{Prepared, Preparer, Refusal, Ringing};
use crate::estimate::runner::{Runner, settings};
use crate::estimate::status::judge;
use crate::imaging::{Chain, Exposure};
use crate::{Error, Result};
use ndarray::ArrayView2;
use rayon::prelude::*;
use std::time::Instant;

/// The device's chain.
pub(super) struct Batch {
    chain: Chain,
}

impl Batch {
    /// # Errors
    /// [`Error::Value`] for settings out of range.
    pub(super) fn new(chain: Chain, shared: &Shared) -> Result<Self> {
        let estimator = &shared.estimator;
        let settings = settings(&estimator.model, &shared.recipe, chain.precision(), None);
        Runner::new(estimator.metrics.any(&estimator.judge)?, &shared.recipe, settings)?;
        Ok(Self { chain })
    }

    /// That the device was lost and the CPU has taken its place, as a sentence.
    pub(super) fn failure(&self) -> Option<&str> {
        self.chain.failure()
    }

    pub(super) fn device_name(&self) -> String {
        self.chain.device_name()
    }

    pub(super) fn fit(&mut self, call: &Call, images: &mut [Image], results: &mut [ImageResult]) -> Result<()> {
        let began = Instant::now();
        let refused = prepare(call, images);
        call.go_on()?;
        let modes = call.shared.modes();
        let mut starts_nm = vec![vec![0.0; modes]; images.len()];
        for (index, start_nm) in starts_nm.iter_mut().enumerate() {
            write_start(start_nm, call.start_of(index));
        }
        let late = call.is_late();
        let taken: Vec<usize> = (0..images.len()).filter(|&image| refused[image].is_none() && !late).collect();
        let places = images.iter_mut().zip(&refused);
        let mut prepared: Vec<&mut Prepared> =
            places.filter(|(_, refused)| refused.is_none() && !late).map(|(image, _)| &mut image.prepared).collect();
        let starts: Vec<&[f64]> = taken.iter().map(|&image| starts_nm[image].as_slice()).collect();
        let minima = if taken.is_empty() { Vec::new() } else { self.minima(call, &mut prepared, &starts)? };
        for (index, (refused, result)) in refused.iter().zip(results.iter_mut()).enumerate() {
            match refused {
                Some(refusal) => result.refuse(*refusal),
                None => result.not_begun(call.start_of(index)),
            }
        }
        let Shared { estimator, tilts, pistons, .. } = call.shared;
        for (&index, mut minimum) in taken.iter().zip(minima) {
            pistons.centre(&mut minimum.coefficients_nm);
            let (image, result) = (&mut images[index], &mut results[index]);
            result.report = judge(&estimator.model, tilts, &image.prepared, &minimum);
            result.coefficients_nm.copy_from_slice(&minimum.coefficients_nm);
            (image.minimum, image.fitted) = (minimum, true);
        }
        let seconds = began.elapsed().as_secs_f64();
        taken.iter().for_each(|&image| results[image].seconds = seconds);
        Ok(())
    }

    fn minima(&mut self, call: &Call, prepared: &mut [&mut Prepared], start_nm: &[&[f64]]) -> Result<Vec<Minimum>> {
        let Shared { estimator, recipe, cancel, .. } = call.shared;
        let fitter = Fitter {
            model: &estimator.model,
            judge: &estimator.judge,
            metrics: &estimator.metrics,
            recipe,
            cancel: Some(cancel),
            deadline: call.deadline,
        };
        fitter.fit(&mut self.chain, prepared, start_nm, &mut |_, _| {}).map_err(|error| match error {
            Error::Interrupted(_) => interrupted(),
            other => other,
        })
    }

    pub(super) fn load(&mut self, call: &Call, images: &mut [Image]) -> Result<()> {
        let refused = prepare(call, images);
        if let Some((index, refusal)) = refused.iter().enumerate().find_map(|(i, r)| r.map(|refusal| (i, refusal))) {
            return Err(unusable(index, refusal));
        }
        let exposures: Vec<Exposure> = images.iter().map(|image| image.prepared.exposure.clone()).collect();
        self.chain.load(&exposures)
    }

    pub(super) fn evaluate(
        &mut self,
        coefficients_nm: ArrayView2<f64>,
        objectives: &mut [f64],
        gradients: &mut [f64],
    ) -> Result<()> {
        let images: Vec<usize> = (0..coefficients_nm.nrows()).collect();
        let found = self.chain.evaluate(&images, coefficients_nm)?;
        let outputs = objectives.iter_mut().zip(gradients.chunks_exact_mut(coefficients_nm.ncols()));
        for (found, (objective, gradient)) in found.iter().zip(outputs) {
            *objective = found.objective;
            gradient.copy_from_slice(&found.gradient);
        }
        Ok(())
    }
}

/// Prepares the frames; why each that cannot be used cannot.
fn prepare(call: &Call, images: &mut [Image]) -> Vec<Option<Refusal>> {
    let preparation = call.shared.estimator.model.preparation;
    let one = |preparer: &mut Preparer, image: &mut Image| {
        image.fitted = false;
        let Image { data_e, bad, prepared, .. } = image;
        let frame = super::Frame { data_e: data_e.view(), bad: bad.view(), read_noise_e: call.read_noise_e };
        preparer.prepare(frame, &call.shared.recipe, Ringing::Refused, prepared).err()
    };
    images.par_iter_mut().map_init(|| Preparer::new(preparation), one).collect()
}
