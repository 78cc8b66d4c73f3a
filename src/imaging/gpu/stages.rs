//! The order in which the kernels of the chain run, and what they run on.

use super::bind::{Kernels, Parts};
use super::fold::{Blocks, GROUP, Shape, TALL, row_chunks};
use super::folded::Folded;
use super::layout::GpuLayout;
use super::memory::{Batch, Counts, Cut, Scene, Scratch, padded};
use super::room::Room;
use crate::Result;
use crate::device::{Build, Device};

/// The stages of the chain with everything that they need on the device.
pub(super) struct Stages {
    bytes: u64,
    shape: Shape,
    cut: Cut,
    counts: Counts,
    batch: Batch,
    scratch: Scratch,
    /// Only kernels look at it.
    _scene: Scene,
    kernels: Kernels,
}

/// Which way the free phase goes.
#[derive(Clone, Copy)]
enum Way {
    /// To the images.
    There,
    /// The derivative, from them.
    Back,
}

impl Stages {
    pub fn new(
        device: &Device,
        build: Build,
        layout: &GpuLayout,
        shape: Shape,
        capacity: usize,
        memory_bytes: u64,
    ) -> Result<Self> {
        let blocks = &Blocks::new(layout, &shape);
        let (counts, cut) = Counts::new(device.info(), build, layout, &shape, blocks, capacity);
        let room = Room::new(build, &shape, blocks, &counts, &cut);
        let cut = room.fit(cut, capacity, device.info(), memory_bytes)?;
        let scene = Scene::new(device, build.precision, &shape, blocks)?;
        let batch = Batch::new(device, build.precision, &shape, &counts)?;
        let scratch = Scratch::new(device, build.precision, &shape, &counts, &cut)?;
        let parts = Parts {
            device,
            build,
            shape: &shape,
            cut: &cut,
            counts: &counts,
            blocks,
            scene: &scene,
            batch: &batch,
            scratch: &scratch,
        };
        let kernels = parts.kernels(2.0 * std::f64::consts::TAU / layout.wavelength_nm)?;
        Ok(Self { bytes: room.bytes(capacity, &cut), shape, cut, counts, batch, scratch, _scene: scene, kernels })
    }

    /// Images whose focal fields can be had together.
    pub fn focal_tile(&self) -> usize {
        self.cut.focal_tile.min(self.cut.tile)
    }

    /// Bytes on the device.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Room for images.
    pub fn capacity(&self) -> usize {
        self.counts.capacity
    }

    /// Puts an image into `slot`.
    pub fn load(&mut self, slot: usize, image: &Folded) -> Result<()> {
        let batch = &mut self.batch;
        batch.data.write(slot * self.shape.pixels(), &image.data)?;
        batch.weight.write(slot * self.shape.pixels(), &image.weights)?;
        batch.kind.write(slot, &[image.kind])?;
        batch.known.write(slot * 4, &image.known)
    }

    /// `[image][objective, flux, background, segments..., smooth modes...]` for the images in the slots `active`. Without
    /// `fitted`, none of them fits its photometry. `free` is the free phase of a model that has one, and the derivative by
    /// it goes into `slopes`.
    pub fn evaluate(
        &mut self,
        active: &[usize],
        turns: &[f64],
        poses: &[f64],
        (free, slopes): (&[f64], &mut [f64]),
        fitted: bool,
    ) -> Result<Vec<f64>> {
        let Counts { capacity, smooth, segments, outputs, free: lit, .. } = self.counts;
        let mut results = vec![0.0; active.len() * outputs];
        // A batch beyond the capacity (an image may be active more than once) goes in several rounds.
        for (round, active) in active.chunks(capacity).enumerate() {
            let (from, count) = (round * capacity, active.len());
            self.write_inputs(count, &turns[from * smooth..], &poses[from * segments * 4..])?;
            let own = from * lit..(from + count) * lit;
            self.batch.free.write(0, &free[own.clone()])?;
            let slots: Vec<i32> = active.iter().map(|&slot| slot as i32).collect();
            self.batch.slot.write(0, &slots)?;
            // Few images are shared out among the cores stage by stage.
            let workers = self.cut.workers.filter(|_| self.shape.fft.is_some() || count >= self.cut.focus_from);
            let limit = if workers.is_some() { self.cut.tile } else { self.focal_tile() };
            // Tiles of equal size: the last is not left with a few images.
            let tile = padded(count.div_ceil(count.div_ceil(limit)));
            self.batch.next.write(0, &vec![0; count.div_ceil(tile)])?;
            for (turn, first) in (0..count).step_by(tile).enumerate() {
                let images = tile.min(count - first);
                self.smooth_phase(first, images)?;
                self.free_phase(first, images, Way::There)?;
                match workers {
                    Some(workers) => self.focus(turn, first, images, workers)?,
                    None => {
                        self.pupil_field(first, images)?;
                        self.transform(images)?;
                        self.pixels(first, images, fitted)?;
                        self.transform_adjoint(images)?;
                        self.pupil_gradient(first, images)?;
                    }
                }
                self.project_modes(first, images)?;
                self.free_phase(first, images, Way::Back)?;
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

    // Kernels that carry GROUP images together take whole groups: what they compute beyond `images` is of leftovers of an
    // earlier tile (or zeros), and nothing reads it.

    fn smooth_phase(&mut self, first: usize, images: usize) -> Result<()> {
        let (images, k) = (padded(images), &mut self.kernels.smooth_phase);
        k.int("first", first)?.int("images", images)?;
        k.launch([self.counts.blocks, self.cut.group_items.min(images / GROUP), 1])
    }

    fn free_phase(&mut self, first: usize, images: usize, way: Way) -> Result<()> {
        let k = match way {
            Way::There => &mut self.kernels.add_free,
            Way::Back => &mut self.kernels.take_free,
        };
        if self.counts.free == 0 {
            return Ok(());
        }
        // As many work-items as for the blocks, of which a sample is a small part.
        k.int("first", first)?.launch([self.cut.block_items, images, 1])
    }

    fn pupil_field(&mut self, first: usize, images: usize) -> Result<()> {
        self.kernels.pupil_field.int("first", first)?.launch([self.counts.blocks, images, 1])
    }

    fn focus(&mut self, turn: usize, first: usize, images: usize, workers: usize) -> Result<()> {
        let k = &mut self.kernels.focus;
        k.int("turn", turn)?.int("first", first)?.int("images", images)?.launch([workers, 1, 1])
    }

    fn transform(&mut self, images: usize) -> Result<()> {
        let (shape, cut, k) = (&self.shape, &self.cut, &mut self.kernels);
        let groups = shape.pairs.div_ceil(TALL);
        k.forward_columns.launch([2 * shape.width / shape.vector, groups.min(cut.column_items), images])?;
        let chunks = row_chunks(shape.span / shape.vector);
        k.forward_rows.launch([chunks, shape.pairs.div_ceil(cut.pairs_per_item), images])
    }

    fn pixels(&mut self, first: usize, images: usize, fitted: bool) -> Result<()> {
        let (cut, k) = (&self.cut, &mut self.kernels);
        let strips = [cut.lanes, self.counts.strips, images];
        if fitted {
            k.photometry_sums.int("first", first)?.launch(strips)?;
        }
        k.photometry_solve.int("first", first)?.int("images", images)?.launch([images, 1, 1])?;
        k.residuals.int("first", first)?.launch(strips)
    }

    fn transform_adjoint(&mut self, images: usize) -> Result<()> {
        let (shape, cut, k) = (&self.shape, &self.cut, &mut self.kernels);
        let chunks = row_chunks(shape.width / shape.vector);
        k.adjoint_rows.launch([chunks, shape.pairs.div_ceil(cut.pairs_per_item), images])?;
        let groups = shape.rows.div_ceil(TALL);
        k.adjoint_columns.launch([2 * shape.width / shape.vector, groups.min(cut.column_items), images])
    }

    fn pupil_gradient(&mut self, first: usize, images: usize) -> Result<()> {
        let (cut, counts, k) = (&self.cut, &self.counts, &mut self.kernels);
        k.pupil_gradient.launch([cut.block_items, images, 1])?;
        k.project_segments.int("first", first)?.launch([counts.segments, images, 1])
    }

    fn project_modes(&mut self, first: usize, images: usize) -> Result<()> {
        let (cut, counts, k) = (&self.cut, &self.counts, &mut self.kernels);
        let groups = images.div_ceil(GROUP);
        k.project_modes.int("images", groups * GROUP)?;
        k.project_modes.launch([counts.mode_groups, counts.chunks, groups.min(cut.group_items)])?;
        k.collect.int("first", first)?.launch([cut.output_items, images, 1])
    }
}
