//! Fits of a batch of frames: those that are kept are taken, the others made.

use super::engine::{self, FitState, FitTask, ImageFit, Watch};
use super::fitter::ModalFitter;
use super::kept_fits::{Hash, KeptFit};
use super::prepare::{Frame, PreparedFrame, Preparer, Ringing};
use crate::Result;
use crate::imaging::{Chain, Precision};
use ndarray::{Array1, ArrayView1};
use rayon::prelude::*;
use std::sync::Arc;

impl ModalFitter {
    /// Prepares `frames` and fits them, each from the start of its fit; fits that the fitter keeps are taken, others made and kept.
    ///
    /// # Errors
    /// As [`engine::fit`].
    pub(super) fn fit_frames(
        &self,
        chain: &mut Chain,
        task: &FitTask,
        frames: &[Frame],
        fits: &mut [ImageFit],
        watch: &mut Watch,
    ) -> Result<()> {
        let Some(kept) = &self.kept else {
            let prepare = |index: usize, preparer: &mut Preparer, prepared: &mut PreparedFrame| {
                preparer.prepare(frames[index], task.recipe, Ringing::Accepted, prepared)
            };
            return engine::fit(chain, task, &prepare, fits, watch);
        };
        let model = &with_chain(self.model_hash(), chain);
        let keys: Vec<u128> = frames.par_iter().zip(&*fits).map(|(frame, fit)| key(model, frame, fit)).collect();
        let (modes, pixels) = (self.model.optics.modes(), self.model.preparation.pixels.pow(2));
        let known: Vec<Option<Arc<KeptFit>>> = keys.iter().map(|key| kept.get(*key, modes, pixels)).collect();
        let (mut there, mut missing): (Vec<_>, Vec<_>) =
            fits.iter_mut().zip(frames).zip(&keys).zip(known).partition(|(_, known)| known.is_some());
        there.par_iter_mut().for_each_init(
            || Preparer::new(self.model.preparation),
            |preparer, (((fit, frame), _), known)| {
                fit.seconds = 0.0;
                match preparer.prepare(**frame, task.recipe, Ringing::Accepted, &mut fit.prepared) {
                    Ok(()) => known.iter().for_each(|known| known.write(fit)),
                    Err(refusal) => fit.state = FitState::Refused(refusal),
                }
            },
        );
        let (done, all) = (there.len(), frames.len());
        watch(done, all);
        if missing.is_empty() {
            return Ok(());
        }
        let mut own: Vec<ImageFit> = missing.iter().map(|(((fit, _), _), _)| (**fit).clone()).collect();
        let wanted: Vec<Frame> = missing.iter().map(|(((_, frame), _), _)| **frame).collect();
        let prepare = |index: usize, preparer: &mut Preparer, prepared: &mut _| {
            preparer.prepare(wanted[index], task.recipe, Ringing::Accepted, prepared)
        };
        engine::fit(chain, task, &prepare, &mut own, &mut |more, _| watch(done + more, all))?;
        for ((((fit, _), key), _), own) in missing.iter_mut().zip(own) {
            if own.is_fitted() {
                kept.put(**key, &own);
            }
            **fit = own;
        }
        Ok(())
    }

    /// PSF of the reference chain at `coefficients_nm`, which may be kept.
    pub(super) fn psf_at(&self, coefficients_nm: &[f64]) -> Arc<Vec<f64>> {
        let known = self.kept.as_ref().and_then(|kept| kept.psf(self.psf_key(coefficients_nm)));
        known.unwrap_or_else(|| Arc::new(self.reference.psf(ArrayView1::from(coefficients_nm))))
    }

    /// Keeps the PSFs at these coefficients of fits, nm, in place of those that were kept.
    pub(super) fn keep_psfs(&self, coefficients_nm: &[&[f64]]) {
        let Some(kept) = &self.kept else { return };
        let psf = |nm: &&[f64]| (self.psf_key(nm), self.psf_at(nm));
        kept.set_psfs(coefficients_nm.par_iter().map(psf).collect::<Vec<_>>());
    }

    fn psf_key(&self, coefficients_nm: &[f64]) -> u128 {
        self.model_hash().numbers(coefficients_nm).value()
    }

    /// Hash of what all fits have in common, independent of the chain. The image of a wavefront with a different coefficient of every
    /// mode represents the pupil, the modes, the diversity and the filter, also where they are from files.
    fn model_hash(&self) -> Hash {
        /// Fractions of its multiples are spread evenly.
        const GOLDEN: f64 = 0.618_033_988_749_894_9;
        self.hash
            .get_or_init(|| {
                let wavelength_nm = self.model.optics.parts().wavelength_nm;
                let nm = |mode: usize| wavelength_nm * 0.02 * (((mode + 1) as f64 * GOLDEN).fract() - 0.5);
                let psf = self.reference.psf(Array1::from_shape_fn(self.model.optics.modes(), nm).view());
                let hash = Hash::new().text(env!("CARGO_PKG_VERSION"));
                hash.text(&format!("{:?} {:?}", self.recipe, self.model.preparation)).numbers(&psf)
            })
            .clone()
    }
}

/// Hash of what distinguishes chains: precision, and whether it is the CPU's.
fn with_chain(model: Hash, chain: &Chain) -> Hash {
    let precision = match chain.precision() {
        Precision::F32 => "f32",
        Precision::F64 => "f64",
    };
    model.text(precision).text(if chain.device_name() == "cpu" { "cpu" } else { "device" })
}

/// Key of the fit of `frame` from the start of `fit`.
fn key(model: &Hash, frame: &Frame, fit: &ImageFit) -> u128 {
    let noise = frame.read_noise_e.unwrap_or(-1.0);
    model.clone().frame(frame.data_e, frame.bad).numbers(&[noise]).numbers(&fit.start_nm).value()
}
