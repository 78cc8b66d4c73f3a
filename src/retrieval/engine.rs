//! Retrieval of the images of a task in one precision: on a device where one was chosen, else on
//! every core of the CPU.

use super::device_batch::DeviceBatch;
use super::model::MapModel;
use super::results::RetrievedWavefronts;
use super::task::RetrievalTask;
use super::workspace::RetrievalWorkspace;
use crate::Result;
use crate::imaging::Polynomial;
use crate::machine;
use rayon::prelude::*;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Retrievals in one precision.
pub(super) struct RetrievalEngine<T: Polynomial> {
    workspace: RetrievalWorkspace<T>,
    /// Whether a device was chosen; never where amplitudes vary, which no device kernel supports.
    on_device: bool,
    /// The chain there, once it was opened.
    batch: Mutex<Option<DeviceBatch>>,
}

impl<T: Polynomial> RetrievalEngine<T> {
    /// # Errors
    /// Those of finding the device; [`Error::Value`](crate::Error::Value) where the machine has
    /// less memory than the retrievals take that run at once.
    pub(super) fn new(model: MapModel<T>) -> Result<Self> {
        let on_device = model.segment_samples.is_empty() && model.settings.device.resolve()?.is_some();
        let at_once = if on_device { model.settings.max_batch } else { rayon::current_num_threads() };
        let unknowns = model.metric.dimension();
        // Ten vectors of the optimiser and two for each pair of its memory; start, gradient, gain
        // and prior; three of the preconditioner's work.
        let vectors = 10 + 2 * model.settings.memory + 4 + 3;
        machine::check_memory(
            format_args!("the retrieval of {at_once} wavefronts of {unknowns} unknowns at once"),
            (size_of::<f64>() * at_once * unknowns * vectors) as u64,
            "set fewer estimate.samples, or take fewer threads (RAYON_NUM_THREADS)",
        )?;
        Ok(Self { workspace: RetrievalWorkspace::new(model), on_device, batch: Mutex::new(None) })
    }

    #[cfg(test)]
    pub(super) fn model(&self) -> &MapModel<T> {
        &self.workspace.model
    }

    /// Name of the device of the last retrievals, and the failure with which it was lost, if it
    /// was.
    pub(super) fn device(&self) -> (String, Option<String>) {
        let batch = self.batch.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        let describe = |batch: &DeviceBatch| (batch.chain.device_name(), batch.chain.failure().map(str::to_owned));
        batch.as_ref().map_or_else(|| ("cpu".into(), None), describe)
    }

    /// Retrieves all images into `wavefronts`; each is a step of the progress.
    ///
    /// # Errors
    /// [`Error::Device`](crate::Error::Device), [`Error::Interrupted`](crate::Error::Interrupted),
    /// those of preparing.
    pub(super) fn retrieve(&self, task: &RetrievalTask, wavefronts: &mut RetrievedWavefronts) -> Result<()> {
        if self.on_device && self.retrieve_on_device(task, wavefronts)? {
            return Ok(());
        }
        let done = AtomicUsize::new(0);
        let images: Vec<_> = wavefronts.images_mut().enumerate().collect();
        images.into_par_iter().try_for_each(|(image, out)| {
            let check_cancel = || task.check_cancel(|| done.load(Ordering::Relaxed));
            check_cancel()?;
            let result = match (task.prepare)(image)? {
                Ok(prepared) => Ok(self.workspace.retrieve(prepared, task.known(image), check_cancel)?),
                Err(refusal) => Err(refusal),
            };
            out.store(result);
            done.fetch_add(1, Ordering::Relaxed);
            task.control.step(1);
            Ok(())
        })
    }

    /// As [`RetrievalEngine::retrieve`]; `false`, with nothing done, where no device computes any
    /// more.
    fn retrieve_on_device(&self, task: &RetrievalTask, wavefronts: &mut RetrievedWavefronts) -> Result<bool> {
        let mut batch = self.batch.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        // The images of a batch end in any order.
        DeviceBatch::retrieve(&mut batch, &self.workspace, task, &mut |image, result| {
            wavefronts.store(image, result);
            task.control.step(1);
        })
    }
}
