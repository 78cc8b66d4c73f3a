//! Retrievals on a device: the images of a batch in lock-step, one evaluation of all that are on their way at a time.
//!
//! The device has the optics; coordinates, prior and steps are the host's, image by image on its threads. An image that ends
//! makes room for the next, so that the batch stays full while there are images.

use super::engine::Engine;
use super::optimisation::{Descent, Found};
use super::retriever::{RetrievalRecipe, Statics};
use crate::estimate::Prepared;
use crate::imaging::{Chain, Evaluation, Exposure, Polynomial};
use crate::optimize::{CancelFlag, Progress};
use crate::{Error, Result};
use ndarray::{Array2, Axis};
use rayon::prelude::*;
use std::sync::atomic::Ordering;

/// Bytes that the searches of a batch may take.
const SEARCHES_BYTES: usize = 512 << 20;

/// A chain that evaluates batches.
pub(super) struct Batch {
    pub(super) chain: Chain,
    /// Images that it has room for.
    capacity: usize,
}

/// An image as it is taken up: prepared, or why it cannot be used.
pub(super) type Taken = std::result::Result<Prepared, String>;

/// Where what was found of an image goes, or why it cannot be used.
pub(super) type Keep<'a> = dyn FnMut(usize, std::result::Result<Found, String>) + 'a;

/// What a batch is asked for.
pub(super) struct Asked<'a> {
    /// Number of images.
    pub(super) images: usize,
    /// Prepares one of them.
    pub(super) take: &'a (dyn Fn(usize) -> Result<Taken> + Sync),
    pub(super) statics: Option<&'a Statics>,
    pub(super) cancel: Option<&'a CancelFlag>,
}

/// An image on its way.
struct Lane<T: Polynomial> {
    image: usize,
    /// Where the chain has it.
    slot: usize,
    prepared: Prepared,
    descent: Descent<T>,
}

impl Batch {
    /// As many of `images` as go at once: a search has some twenty vectors of as many numbers as it varies.
    fn at_once<T: Polynomial>(engine: &Engine<T>, images: usize) -> usize {
        let RetrievalRecipe { memory, most_together, .. } = engine.recipe;
        let search_bytes = (2 * memory + 12) * engine.metric.dimension() * size_of::<f64>();
        images.min(most_together).min(SEARCHES_BYTES / search_bytes).max(1)
    }

    /// # Errors
    /// Those of [`Chain::open_free`].
    fn open<T: Polynomial>(engine: &Engine<T>, capacity: usize) -> Result<Self> {
        let RetrievalRecipe { device, precision, .. } = engine.recipe;
        Ok(Self { chain: Chain::open_free(engine.chain.optics().clone(), device, precision, capacity)?, capacity })
    }

    /// Whether it computes on a device.
    fn on_device(&self) -> bool {
        !matches!(self.chain, Chain::Cpu64(_) | Chain::Cpu32(_)) && self.chain.failure().is_none()
    }
}

impl<T: Polynomial> Engine<T> {
    /// The wavefronts behind all images, on a device, given to `keep` as they are found; `false` where there is no device, or
    /// none any more, and nothing was done.
    ///
    /// # Errors
    /// [`Error::Device`] where the device cannot run the model or fails; [`Error::Interrupted`]; those of preparing; broken
    /// promises of this module's.
    pub(super) fn retrieve_on_device(&self, asked: &Asked, keep: &mut Keep) -> Result<bool> {
        if !self.on_device {
            return Ok(false);
        }
        let mut held = self.batch.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        let capacity = Batch::at_once(self, asked.images);
        if held.as_ref().is_none_or(|batch| batch.on_device() && batch.capacity < capacity) {
            *held = Some(Batch::open(self, capacity)?);
        }
        let Some(batch) = held.as_mut().filter(|batch| batch.on_device()) else { return Ok(false) };
        Lockstep::new(self, batch, asked).run(keep)?;
        Ok(true)
    }

    /// Prepares an image and begins its search, or says why it cannot be used.
    fn take_up(&self, asked: &Asked, image: usize) -> Result<std::result::Result<(Prepared, Descent<T>), String>> {
        let mut prepared = match (asked.take)(image)? {
            Ok(prepared) => prepared,
            Err(refusal) => return Ok(Err(refusal)),
        };
        let mut descent = self.descent()?;
        descent.begin(self, &mut prepared, asked.statics)?;
        Ok(Ok((prepared, descent)))
    }
}

/// A batch at work.
struct Lockstep<'a, T: Polynomial> {
    engine: &'a Engine<T>,
    chain: &'a mut Chain,
    asked: &'a Asked<'a>,
    lanes: Vec<Lane<T>>,
    /// Slots without an image.
    idle: Vec<usize>,
    /// The image that is taken up next.
    next: usize,
    /// Images that are done.
    done: usize,
    /// Whether the chain has this call's images, which the next ones replace one by one.
    loaded: bool,
    // What goes up and comes down, `[lane]` first.
    coefficients_nm: Array2<f64>,
    turns: Vec<f64>,
    slopes: Vec<f64>,
}

impl<'a, T: Polynomial> Lockstep<'a, T> {
    fn new(engine: &'a Engine<T>, batch: &'a mut Batch, asked: &'a Asked<'a>) -> Self {
        Self {
            engine,
            asked,
            lanes: Vec::with_capacity(batch.capacity),
            idle: (0..batch.capacity).rev().collect(),
            chain: &mut batch.chain,
            next: 0,
            done: 0,
            loaded: false,
            coefficients_nm: Array2::zeros((0, 0)),
            turns: Vec::new(),
            slopes: Vec::new(),
        }
    }

    fn run(mut self, keep: &mut Keep) -> Result<()> {
        loop {
            if self.asked.cancel.is_some_and(|flag| flag.load(Ordering::Relaxed)) {
                let (done, all) = (self.done, self.asked.images);
                return Err(Error::Interrupted(format!("{done} of {all} wavefronts were retrieved")));
            }
            self.take_up(keep)?;
            if self.lanes.is_empty() {
                return Ok(());
            }
            self.place();
            let slots: Vec<usize> = self.lanes.iter().map(|lane| lane.slot).collect();
            let at = self.coefficients_nm.view();
            let evaluations = self.chain.evaluate_free(&slots, at, &self.turns, &mut self.slopes)?;
            let found = self.tell(&evaluations)?;
            for (lane, found) in std::mem::take(&mut self.lanes).into_iter().zip(found) {
                match found {
                    None => self.lanes.push(lane),
                    Some(found) => {
                        self.idle.push(lane.slot);
                        self.engine.descents.put_back(lane.descent);
                        self.done += 1;
                        keep(lane.image, Ok(found));
                    }
                }
            }
        }
    }

    /// Gives idle slots the next images, and the chain those.
    fn take_up(&mut self, keep: &mut Keep) -> Result<()> {
        let first = self.lanes.len();
        while self.next < self.asked.images && !self.idle.is_empty() {
            let images = self.next..self.asked.images.min(self.next + self.idle.len());
            self.next = images.end;
            let (engine, asked) = (self.engine, self.asked);
            let taken = images.clone().into_par_iter().map(|image| engine.take_up(asked, image));
            let taken = taken.collect::<Result<Vec<_>>>()?;
            for (image, taken) in images.zip(taken) {
                match taken {
                    Ok((prepared, descent)) => {
                        let slot = self.idle.pop();
                        let slot =
                            slot.ok_or_else(|| Error::Internal("more images than slots were taken up".into()))?;
                        self.lanes.push(Lane { image, slot, prepared, descent });
                    }
                    Err(refusal) => {
                        self.done += 1;
                        keep(image, Err(refusal));
                    }
                }
            }
        }
        let fresh = &self.lanes[first..];
        if fresh.is_empty() {
            return Ok(());
        }
        if std::mem::replace(&mut self.loaded, true) {
            let exposures: Vec<_> = fresh.iter().map(|lane| (lane.slot, &lane.prepared.exposure)).collect();
            return self.chain.replace_all(&exposures);
        }
        // The first images are in the first slots, in their order.
        let exposures: Vec<Exposure> = fresh.iter().map(|lane| lane.prepared.exposure.clone()).collect();
        self.chain.load(&exposures)
    }

    /// Brings every lane to its point.
    fn place(&mut self) {
        let (engine, lanes) = (self.engine, self.lanes.len());
        let (lit, modes) = (engine.lit(), engine.chain.optics().modes());
        self.coefficients_nm = Array2::zeros((lanes, modes));
        self.turns.resize(lanes * lit, 0.0);
        self.slopes.resize(lanes * lit, 0.0);
        let rows = self.coefficients_nm.axis_iter_mut(Axis(0)).into_par_iter();
        let lanes = self.lanes.par_iter_mut().zip(rows).zip(self.turns.par_chunks_exact_mut(lit));
        lanes.for_each(|((lane, mut coefficients_nm), turns)| {
            let mut room = engine.room();
            lane.descent.place(engine, &mut room.square);
            coefficients_nm.assign(&lane.descent.coefficients_nm());
            turns.iter_mut().zip(lane.descent.turns()).for_each(|(out, turns)| *out = turns.wide());
            engine.rooms.put_back(room);
        });
    }

    /// Tells every lane what was found there; what was found in the end of those that are done.
    fn tell(&mut self, evaluations: &[Evaluation]) -> Result<Vec<Option<Found>>> {
        let engine = self.engine;
        let lanes = self.lanes.par_iter_mut().zip(self.slopes.par_chunks_exact(engine.lit())).zip(evaluations);
        let one = |((lane, slopes), evaluation): ((&mut Lane<T>, &[f64]), &Evaluation)| {
            let mut room = engine.room();
            room.turns_bar.iter_mut().zip(slopes).for_each(|(out, &slope)| *out = T::of(slope));
            // Amplitudes of segments do not vary on a device.
            let progress = lane.descent.tell(engine, evaluation, &room.turns_bar, |_| {}, &mut room.square)?;
            let found = (progress == Progress::Done)
                .then(|| lane.descent.found(engine, &lane.prepared, &mut room.square, &mut room.scratch));
            engine.rooms.put_back(room);
            Ok(found)
        };
        lanes.map(one).collect()
    }
}
