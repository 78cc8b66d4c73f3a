//! The sequence in which the kernels of the chain run, and their launch sizes.

use super::bind::{Bindings, Kernels};
use super::budget::MemoryBudget;
use super::fold::{Blocks, FoldedShape, GROUP, TALL, row_chunks};
use super::image::FoldedImage;
use super::layout::GpuLayout;
use super::memory::{BatchBuffers, Counts, ModelBuffers, Partition, ScratchBuffers, padded};
use crate::Result;
use crate::device::{Build, Device};

/// The stages of the chain with their kernels and buffers.
pub(super) struct Stages {
    bytes: u64,
    shape: FoldedShape,
    partition: Partition,
    counts: Counts,
    batch: BatchBuffers,
    scratch: ScratchBuffers,
    /// Owns the buffers that the kernels are bound to.
    _model: ModelBuffers,
    kernels: Kernels,
}

/// Step of the free phase.
#[derive(Clone, Copy)]
enum FreePhaseStep {
    /// Addition to the phase.
    Add,
    /// Gradient by the free phase.
    Gradient,
}

impl Stages {
    pub fn new(
        device: &Device,
        build: Build,
        layout: &GpuLayout,
        shape: FoldedShape,
        capacity: usize,
        memory_bytes: u64,
    ) -> Result<Self> {
        let blocks = &Blocks::new(layout, &shape);
        let (counts, partition) = Counts::new(device.info(), build, layout, &shape, blocks, capacity);
        let budget = MemoryBudget::new(build, &shape, blocks, &counts, &partition);
        let partition = budget.fit(partition, capacity, device.info(), memory_bytes)?;
        let model = ModelBuffers::new(device, build.precision, &shape, blocks)?;
        let batch = BatchBuffers::new(device, build.precision, &shape, &counts)?;
        let scratch = ScratchBuffers::new(device, build.precision, &shape, &counts, &partition)?;
        let parts = Bindings {
            device,
            build,
            shape: &shape,
            partition: &partition,
            counts: &counts,
            blocks,
            model: &model,
            batch: &batch,
            scratch: &scratch,
        };
        let kernels = parts.kernels(2.0 * std::f64::consts::TAU / layout.wavelength_nm)?;
        Ok(Self {
            bytes: budget.bytes(capacity, &partition),
            shape,
            partition,
            counts,
            batch,
            scratch,
            _model: model,
            kernels,
        })
    }

    /// Largest number of images whose focal fields are computed together.
    pub fn focal_tile(&self) -> usize {
        self.partition.focal_tile.min(self.partition.tile)
    }

    /// Device memory, bytes.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Largest number of images.
    pub fn capacity(&self) -> usize {
        self.counts.capacity
    }

    /// Uploads an image into `slot`.
    pub fn load(&mut self, slot: usize, image: &FoldedImage) -> Result<()> {
        let batch = &mut self.batch;
        batch.data.write(slot * self.shape.pixels(), &image.data)?;
        batch.weight.write(slot * self.shape.pixels(), &image.weights)?;
        batch.kind.write(slot, &[image.kind])?;
        batch.known.write(slot * 4, &image.known)
    }

    /// `[image][objective, flux, background, segments..., smooth modes...]` for the images in the slots `active`. Without
    /// `fitted`, all photometry is known. `free` is the free phase of a model that has one; the gradient by it is written
    /// into `slopes`.
    pub fn evaluate(
        &mut self,
        active: &[usize],
        turns: &[f64],
        poses: &[f64],
        (free, slopes): (&[f64], &mut [f64]),
        fitted: bool,
    ) -> Result<Vec<f64>> {
        let Counts { capacity, smooth, segments, outputs, free: free_samples, .. } = self.counts;
        let mut results = vec![0.0; active.len() * outputs];
        // A batch larger than the capacity (an image may be active more than once) is processed in several rounds.
        for (round, active) in active.chunks(capacity).enumerate() {
            let (from, count) = (round * capacity, active.len());
            self.write_inputs(count, &turns[from * smooth..], &poses[from * segments * 4..])?;
            let own = from * free_samples..(from + count) * free_samples;
            self.batch.free.write(0, &free[own.clone()])?;
            let slots: Vec<i32> = active.iter().map(|&slot| slot as i32).collect();
            self.batch.slot.write(0, &slots)?;
            // With few images each stage distributes its work over the cores.
            let workers =
                self.partition.workers.filter(|_| self.shape.fft.is_some() || count >= self.partition.focus_from);
            let limit = if workers.is_some() { self.partition.tile } else { self.focal_tile() };
            // Tiles of equal size, so that the last is not much smaller.
            let tile = padded(count.div_ceil(count.div_ceil(limit)));
            self.batch.next.write(0, &vec![0; count.div_ceil(tile)])?;
            for (tile_index, first) in (0..count).step_by(tile).enumerate() {
                let images = tile.min(count - first);
                self.smooth_phase(first, images)?;
                self.free_phase(first, images, FreePhaseStep::Add)?;
                match workers {
                    Some(workers) => self.focus(tile_index, first, images, workers)?,
                    None => {
                        self.pupil_field(first, images)?;
                        self.transform(images)?;
                        self.pixels(first, images, fitted)?;
                        self.transform_adjoint(images)?;
                        self.pupil_gradient(first, images)?;
                    }
                }
                self.project_modes(first, images)?;
                self.free_phase(first, images, FreePhaseStep::Gradient)?;
            }
            self.batch.result.read(0, &mut results[from * outputs..(from + count) * outputs])?;
            self.batch.free.read(0, &mut slopes[own])?;
        }
        Ok(results)
    }

    /// The focal fields of at most a tile of images, folded.
    pub fn focal(&mut self, count: usize, turns: &[f64], poses: &[f64]) -> Result<Vec<f64>> {
        self.write_inputs(count, turns, poses)?;
        self.smooth_phase(0, count)?;
        self.pupil_field(0, count)?;
        self.transform(count)?;
        let mut focal = vec![0.0; count * self.shape.pixels() * 2];
        self.scratch.focal.read(0, &mut focal)?;
        Ok(focal)
    }

    fn write_inputs(&mut self, images: usize, turns: &[f64], poses: &[f64]) -> Result<()> {
        self.batch.coefficients.write(0, &turns[..images * self.counts.smooth])?;
        self.batch.pose.write(0, &poses[..images * self.counts.segments * 4])
    }

    // Kernels that process GROUP images together are launched for whole groups. Beyond `images` they process leftovers of an
    // earlier tile (or zeros), and their results are not read.

    fn smooth_phase(&mut self, first: usize, images: usize) -> Result<()> {
        let (images, k) = (padded(images), &mut self.kernels.smooth_phase);
        k.int("first", first)?.int("images", images)?;
        k.launch([self.counts.blocks, self.partition.group_items.min(images / GROUP), 1])
    }

    fn free_phase(&mut self, first: usize, images: usize, step: FreePhaseStep) -> Result<()> {
        let k = match step {
            FreePhaseStep::Add => &mut self.kernels.add_free_phase,
            FreePhaseStep::Gradient => &mut self.kernels.free_phase_gradient,
        };
        if self.counts.free == 0 {
            return Ok(());
        }
        // As many work-items as for the blocks: the work per sample is small.
        k.int("first", first)?.launch([self.partition.block_items, images, 1])
    }

    fn pupil_field(&mut self, first: usize, images: usize) -> Result<()> {
        self.kernels.pupil_field.int("first", first)?.launch([self.counts.blocks, images, 1])
    }

    fn focus(&mut self, tile: usize, first: usize, images: usize, workers: usize) -> Result<()> {
        let k = &mut self.kernels.focus;
        k.int("tile", tile)?.int("first", first)?.int("images", images)?.launch([workers, 1, 1])
    }

    fn transform(&mut self, images: usize) -> Result<()> {
        let (shape, partition, k) = (&self.shape, &self.partition, &mut self.kernels);
        let groups = shape.pairs.div_ceil(TALL);
        k.forward_columns.launch([2 * shape.width / shape.vector, groups.min(partition.column_items), images])?;
        let chunks = row_chunks(shape.span / shape.vector);
        k.forward_rows.launch([chunks, shape.pairs.div_ceil(partition.pairs_per_item), images])
    }

    fn pixels(&mut self, first: usize, images: usize, fitted: bool) -> Result<()> {
        let (partition, k) = (&self.partition, &mut self.kernels);
        let strips = [partition.lanes, self.counts.strips, images];
        if fitted {
            k.photometry_sums.int("first", first)?.launch(strips)?;
        }
        k.photometry_solve.int("first", first)?.int("images", images)?.launch([images, 1, 1])?;
        k.residuals.int("first", first)?.launch(strips)
    }

    fn transform_adjoint(&mut self, images: usize) -> Result<()> {
        let (shape, partition, k) = (&self.shape, &self.partition, &mut self.kernels);
        let chunks = row_chunks(shape.width / shape.vector);
        k.adjoint_rows.launch([chunks, shape.pairs.div_ceil(partition.pairs_per_item), images])?;
        let groups = shape.rows.div_ceil(TALL);
        k.adjoint_columns.launch([2 * shape.width / shape.vector, groups.min(partition.column_items), images])
    }

    fn pupil_gradient(&mut self, first: usize, images: usize) -> Result<()> {
        let (partition, counts, k) = (&self.partition, &self.counts, &mut self.kernels);
        k.pupil_gradient.launch([partition.block_items, images, 1])?;
        k.project_segments.int("first", first)?.launch([counts.segments, images, 1])
    }

    fn project_modes(&mut self, first: usize, images: usize) -> Result<()> {
        let (partition, counts, k) = (&self.partition, &self.counts, &mut self.kernels);
        let groups = images.div_ceil(GROUP);
        k.project_modes.int("images", groups * GROUP)?;
        k.project_modes.launch([counts.mode_groups, counts.chunks, groups.min(partition.group_items)])?;
        k.collect.int("first", first)?.launch([partition.output_items, images, 1])
    }
}
