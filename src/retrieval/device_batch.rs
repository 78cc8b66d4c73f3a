//! Device batch: the retrievals of many images in lock-step, one evaluation of all images at a
//! time.
//!
//! The device evaluates the optics; coordinates, prior and steps are taken on the host, in a thread
//! for each image. The slot of a finished image takes the next one, so that the batch stays full
//! while there are images.

use super::optimisation::MapOptimisation;
use super::results::RetrievedImage;
use super::settings::RetrievalSettings;
use super::task::RetrievalTask;
use super::workspace::RetrievalWorkspace;
use crate::imaging::{Chain, Evaluation, Exposure, Polynomial};
use crate::modal::{PreparedFrame, Refusal};
use crate::optimize::Advance;
use crate::{Error, Result};
use ndarray::{Array2, Axis};
use rayon::prelude::*;

/// Largest memory of the optimisations of a batch.
const OPTIMISATION_BYTES: usize = 512 << 20;

/// Takes the result of an image, or the reason why it is unusable.
pub(super) type Store<'a> = dyn FnMut(usize, std::result::Result<RetrievedImage, Refusal>) + 'a;

/// A chain that evaluates batches.
pub(super) struct DeviceBatch {
    pub(super) chain: Chain,
    /// Number of slots.
    capacity: usize,
}

/// An image in a slot of the batch.
struct Lane<T: Polynomial> {
    image: usize,
    /// Index of the image in the chain.
    slot: usize,
    prepared: PreparedFrame,
    optimisation: MapOptimisation<T>,
}

impl DeviceBatch {
    /// Size of the batch for `images`: an optimisation has some twenty vectors of as many numbers
    /// as it has unknowns.
    fn size<T: Polynomial>(workspace: &RetrievalWorkspace<T>, images: usize) -> usize {
        let RetrievalSettings { memory, max_batch, .. } = workspace.model.settings;
        let bytes = (2 * memory + 12) * workspace.model.metric.dimension() * size_of::<f64>();
        images.min(max_batch).min(OPTIMISATION_BYTES / bytes).max(1)
    }

    /// # Errors
    /// Those of [`Chain::open_free`].
    fn open<T: Polynomial>(workspace: &RetrievalWorkspace<T>, capacity: usize) -> Result<Self> {
        let RetrievalSettings { device, precision, .. } = workspace.model.settings;
        let optics = workspace.model.chain.optics().clone();
        Ok(Self { chain: Chain::open_free(optics, device, precision, capacity)?, capacity })
    }

    fn is_on_device(&self) -> bool {
        !matches!(self.chain, Chain::Cpu64(_) | Chain::Cpu32(_)) && self.chain.failure().is_none()
    }

    /// Retrieves all images on a device and gives the results to `store` as they come; returns
    /// `false`, and does nothing, where there is no device, or where it was lost. `batch` is
    /// opened, and opened anew where it is too small.
    ///
    /// # Errors
    /// [`Error::Device`] where the device cannot run the model or fails; [`Error::Interrupted`];
    /// those of preparing; broken promises of this module's.
    pub(super) fn retrieve<T: Polynomial>(
        batch: &mut Option<Self>,
        workspace: &RetrievalWorkspace<T>,
        task: &RetrievalTask,
        store: &mut Store,
    ) -> Result<bool> {
        let capacity = Self::size(workspace, task.images);
        if batch.as_ref().is_none_or(|batch| batch.is_on_device() && batch.capacity < capacity) {
            *batch = Some(Self::open(workspace, capacity)?);
        }
        let Some(batch) = batch.as_mut().filter(|batch| batch.is_on_device()) else { return Ok(false) };
        Lockstep::new(workspace, batch, task).run(store)?;
        Ok(true)
    }
}

impl<T: Polynomial> RetrievalWorkspace<T> {
    /// Prepares an image and begins its optimisation, or returns the reason why it is unusable.
    fn begin(
        &self,
        task: &RetrievalTask,
        image: usize,
    ) -> Result<std::result::Result<(PreparedFrame, MapOptimisation<T>), Refusal>> {
        let mut prepared = match (task.prepare)(image)? {
            Ok(prepared) => prepared,
            Err(refusal) => return Ok(Err(refusal)),
        };
        let mut optimisation = self.take_optimisation()?;
        optimisation.begin(&self.model, &mut prepared, task.known(image))?;
        Ok(Ok((prepared, optimisation)))
    }
}

/// State of a batch while it runs.
struct Lockstep<'a, T: Polynomial> {
    workspace: &'a RetrievalWorkspace<T>,
    chain: &'a mut Chain,
    task: &'a RetrievalTask<'a>,
    lanes: Vec<Lane<T>>,
    /// Slots without an image.
    idle: Vec<usize>,
    /// The next image to begin.
    next: usize,
    /// Number of finished images.
    done: usize,
    /// Whether the chain has images of this task, which the next ones replace one by one.
    is_loaded: bool,
    // Transfers to and from the device, `[lane]` first.
    coefficients_nm: Array2<f64>,
    turns: Vec<f64>,
    turns_bar: Vec<f64>,
}

impl<'a, T: Polynomial> Lockstep<'a, T> {
    fn new(workspace: &'a RetrievalWorkspace<T>, batch: &'a mut DeviceBatch, task: &'a RetrievalTask<'a>) -> Self {
        Self {
            workspace,
            task,
            lanes: Vec::with_capacity(batch.capacity),
            idle: (0..batch.capacity).rev().collect(),
            chain: &mut batch.chain,
            next: 0,
            done: 0,
            is_loaded: false,
            coefficients_nm: Array2::zeros((0, 0)),
            turns: Vec::new(),
            turns_bar: Vec::new(),
        }
    }

    fn run(mut self, store: &mut Store) -> Result<()> {
        loop {
            self.task.check_cancel(|| self.done)?;
            self.fill_slots(store)?;
            if self.lanes.is_empty() {
                return Ok(());
            }
            self.place();
            let slots: Vec<usize> = self.lanes.iter().map(|lane| lane.slot).collect();
            let at = self.coefficients_nm.view();
            let evaluations = self.chain.evaluate_free(&slots, at, &self.turns, &mut self.turns_bar)?;
            let results = self.advance(&evaluations)?;
            for (lane, result) in std::mem::take(&mut self.lanes).into_iter().zip(results) {
                match result {
                    None => self.lanes.push(lane),
                    Some(result) => {
                        self.idle.push(lane.slot);
                        self.workspace.optimisations.put_back(lane.optimisation);
                        self.done += 1;
                        store(lane.image, Ok(result));
                    }
                }
            }
        }
    }

    /// Begins the next images in the idle slots and loads them into the chain.
    fn fill_slots(&mut self, store: &mut Store) -> Result<()> {
        let first = self.lanes.len();
        while self.next < self.task.images && !self.idle.is_empty() {
            let images = self.next..self.task.images.min(self.next + self.idle.len());
            self.next = images.end;
            let (workspace, task) = (self.workspace, self.task);
            let begun = images.clone().into_par_iter().map(|image| workspace.begin(task, image));
            let begun = begun.collect::<Result<Vec<_>>>()?;
            for (image, begun) in images.zip(begun) {
                match begun {
                    Ok((prepared, optimisation)) => {
                        let slot = self.idle.pop();
                        let slot = slot.ok_or_else(|| Error::Internal("more images than slots were begun".into()))?;
                        self.lanes.push(Lane { image, slot, prepared, optimisation });
                    }
                    Err(refusal) => {
                        self.done += 1;
                        store(image, Err(refusal));
                    }
                }
            }
        }
        let fresh = &self.lanes[first..];
        if fresh.is_empty() {
            return Ok(());
        }
        if std::mem::replace(&mut self.is_loaded, true) {
            let exposures: Vec<_> = fresh.iter().map(|lane| (lane.slot, &lane.prepared.exposure)).collect();
            return self.chain.replace_all(&exposures);
        }
        // The first images are in the first slots, in their order.
        let exposures: Vec<Exposure> = fresh.iter().map(|lane| lane.prepared.exposure.clone()).collect();
        self.chain.load(&exposures)
    }

    /// Moves every lane to its trial point.
    fn place(&mut self) {
        let (workspace, lanes) = (self.workspace, self.lanes.len());
        let (samples, modes) = (workspace.model.samples(), workspace.model.chain.optics().modes());
        self.coefficients_nm = Array2::zeros((lanes, modes));
        self.turns.resize(lanes * samples, 0.0);
        self.turns_bar.resize(lanes * samples, 0.0);
        let rows = self.coefficients_nm.axis_iter_mut(Axis(0)).into_par_iter();
        let lanes = self.lanes.par_iter_mut().zip(rows).zip(self.turns.par_chunks_exact_mut(samples));
        lanes.for_each(|((lane, mut coefficients_nm), turns)| {
            let mut buffers = workspace.take_buffers();
            lane.optimisation.place(&workspace.model, &mut buffers.preconditioner);
            let at = lane.optimisation.wavefront();
            coefficients_nm.assign(&at.coefficients_nm);
            turns.iter_mut().zip(at.turns).for_each(|(out, turns)| *out = turns.widen());
            workspace.buffers.put_back(buffers);
        });
    }

    /// Takes every lane's step; returns the results of those that are done.
    fn advance(&mut self, evaluations: &[Evaluation]) -> Result<Vec<Option<RetrievedImage>>> {
        let (workspace, model) = (self.workspace, &self.workspace.model);
        let lanes = self.lanes.par_iter_mut().zip(self.turns_bar.par_chunks_exact(model.samples())).zip(evaluations);
        let advance = |((lane, turns_bar), evaluation): ((&mut Lane<T>, &[f64]), &Evaluation)| {
            let mut buffers = workspace.take_buffers();
            buffers.turns_bar.iter_mut().zip(turns_bar).for_each(|(out, &bar)| *out = T::narrow(bar));
            let optimisation = &mut lane.optimisation;
            // Amplitudes of segments do not vary on a device.
            let progress =
                optimisation.advance(model, evaluation, &buffers.turns_bar, |_| {}, &mut buffers.preconditioner)?;
            let result = (progress == Advance::Done)
                .then(|| optimisation.result(model, &lane.prepared, &mut buffers.preconditioner, &mut buffers.scratch));
            workspace.buffers.put_back(buffers);
            Ok(result)
        };
        lanes.map(advance).collect()
    }
}
