//! The sequence in which the kernels of the chain run, and their launch sizes.

use super::bind::{Bindings, ColourKernels, PhaseKernels, PixelKernels};
use super::budget::MemoryBudget;
use super::colours::{ColourBuffers, ColourSizes};
use super::fold::{Blocks, FoldedShape, GROUP, TALL};
use super::image::FoldedImage;
use super::layout::GpuLayout;
use super::memory::{BatchBuffers, Counts, ModelBuffers, Partition, ScratchBuffers, padded};
use crate::Result;
use crate::device::{Build, Device, Reals};

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
    colours: ColourBuffers,
    phase_kernels: PhaseKernels,
    /// Of each wavelength.
    colour_kernels: Vec<ColourKernels>,
    pixel_kernels: PixelKernels,
}

/// Coefficients of a batch.
pub(super) struct Inputs {
    /// Smooth coefficients, turns of the first wavelength, `[image][smooth mode]`.
    pub turns: Vec<f64>,
    /// Poses of the segments at each wavelength, `[image][segment][re q, im q, tip, tilt]`.
    pub poses: Vec<Vec<f64>>,
}

/// Images in focus, folded.
pub(super) enum Focal {
    /// Focal fields.
    Field(Vec<f64>),
    /// PSFs.
    Intensity(Vec<f64>),
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
    pub fn new(device: &Device, build: Build, layout: &GpuLayout, capacity: usize, memory_bytes: u64) -> Result<Self> {
        let shape = FoldedShape::new(layout, &layout.colours[0], build);
        let blocks = &Blocks::new(layout, &shape);
        let (counts, partition) = Counts::new(device.info(), build, layout, &shape, blocks, capacity);
        let sizes = ColourSizes::new(device, build.precision, &shape, &counts)?;
        let budget = MemoryBudget::new(build, &shape, blocks, (&counts, &sizes, &partition));
        let partition = budget.fit(partition, capacity, device.info(), memory_bytes)?;
        let model = ModelBuffers::new(device, build.precision, layout, &shape, blocks)?;
        let batch = BatchBuffers::new(device, build.precision, &shape, &counts)?;
        let scratch = ScratchBuffers::new(device, build.precision, &shape, &counts, &partition)?;
        let colours = ColourBuffers::new(device, build, (layout, blocks), (&counts, &sizes, &partition))?;
        let first = Bindings {
            device,
            build,
            layout,
            shape: &shape,
            partition: &partition,
            counts: &counts,
            blocks,
            model: &model,
            colours: &colours,
            colour: 0,
            batch: &batch,
            scratch: &scratch,
        };
        let (phase_kernels, pixel_kernels) = (first.phase_kernels()?, first.pixel_kernels()?);
        let colour_kernels = |colour| Bindings { colour, ..first }.colour_kernels();
        let colour_kernels = (0..counts.colours).map(colour_kernels).collect::<Result<Vec<_>>>()?;
        Ok(Self {
            bytes: budget.bytes(capacity, &partition),
            shape,
            partition,
            counts,
            batch,
            scratch,
            _model: model,
            colours,
            phase_kernels,
            colour_kernels,
            pixel_kernels,
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

    /// Uploads images into their slots, neighbours together: even a copy of a few bytes to a GPU
    /// takes some 7 µs (H100).
    pub fn load(&mut self, images: &[(usize, FoldedImage)]) -> Result<()> {
        let (batch, pixels) = (&mut self.batch, self.shape.pixels());
        for run in images.chunk_by(|(one, _), (next, _)| *next == one + 1) {
            let Some((slot, _)) = run.first() else { continue };
            let all =
                |of: fn(&FoldedImage) -> &[f64]| run.iter().map(|(_, image)| of(image)).collect::<Vec<_>>().concat();
            let kinds: Vec<i32> = run.iter().map(|(_, image)| image.kind).collect();
            batch.data.write(slot * pixels, &all(|image| &image.data))?;
            batch.weight.write(slot * pixels, &all(|image| &image.weights))?;
            batch.kind.write(*slot, &kinds)?;
            batch.known.write(slot * 4, &all(|image| &image.known))?;
        }
        Ok(())
    }

    /// Whether the intensity is stored: see `intensity.cl`.
    fn stores_intensity(&self) -> bool {
        self.counts.stored_pixels > 0
    }

    /// `[image][objective, flux, background, segments..., smooth modes...]` for the images in the
    /// slots `active`. Without `fitted`, all photometry is known. `free` is the free phase of a
    /// model that has one; the gradient by it is written into `slopes`.
    pub fn evaluate(
        &mut self,
        active: &[usize],
        inputs: &Inputs,
        (free, slopes): (&[f64], &mut [f64]),
        fitted: bool,
    ) -> Result<Vec<f64>> {
        let Counts { capacity, outputs, free: free_samples, .. } = self.counts;
        let mut results = vec![0.0; active.len() * outputs];
        // A batch larger than the capacity (an image may be active more than once) is processed in
        // several rounds.
        for (round, active) in active.chunks(capacity).enumerate() {
            let (from, count) = (round * capacity, active.len());
            self.write_inputs(from, count, inputs)?;
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
                match workers {
                    Some(workers) => {
                        self.phase(first, images)?;
                        self.focus(tile_index, first, images, workers)?;
                        self.project(first, images)?;
                    }
                    None => self.tile(first, images, fitted)?,
                }
            }
            self.batch.result.read(0, &mut results[from * outputs..(from + count) * outputs])?;
            self.batch.free.read(0, &mut slopes[own])?;
        }
        Ok(results)
    }

    /// One tile, stage by stage.
    fn tile(&mut self, first: usize, images: usize, fitted: bool) -> Result<()> {
        self.phase(first, images)?;
        for colour in 0..self.counts.colours {
            self.field(colour, first, images)?;
        }
        self.convolve(images)?;
        self.pixels(first, images, fitted)?;
        self.convolve(images)?;
        for colour in 0..self.counts.colours {
            self.field_adjoint(colour, first, images)?;
        }
        self.project(first, images)
    }

    /// The PSFs of at most a tile of images at the first of `inputs`: the focal field, folded, or
    /// the intensity where it is stored.
    pub fn focal(&mut self, count: usize, inputs: &Inputs) -> Result<Focal> {
        self.write_inputs(0, count, inputs)?;
        self.smooth_phase(0, count)?;
        for colour in 0..self.counts.colours {
            self.field(colour, 0, count)?;
        }
        self.convolve(count)?;
        let read = |reals: &Reals, numbers: usize| {
            let mut values = vec![0.0; count * numbers];
            reals.read(0, &mut values).map(|()| values)
        };
        let pixels = self.shape.pixels();
        Ok(if self.stores_intensity() {
            Focal::Intensity(read(&self.scratch.intensity, pixels)?)
        } else {
            Focal::Field(read(&self.colours.focal.whole, 2 * pixels)?)
        })
    }

    /// Uploads the inputs of `count` images from image `from` on.
    fn write_inputs(&mut self, from: usize, count: usize, inputs: &Inputs) -> Result<()> {
        let Counts { smooth, segments, .. } = self.counts;
        self.batch.coefficients.write(0, &inputs.turns[from * smooth..(from + count) * smooth])?;
        for (part, poses) in self.colours.pose.parts.iter_mut().zip(&inputs.poses) {
            part.write(0, &poses[from * segments * 4..(from + count) * segments * 4])?;
        }
        Ok(())
    }

    /// The phase, which all wavelengths share.
    fn phase(&mut self, first: usize, images: usize) -> Result<()> {
        self.smooth_phase(first, images)?;
        self.free_phase(first, images, FreePhaseStep::Add)
    }

    /// From the phase to the focal field of a wavelength, whose intensity is added where it is
    /// stored.
    fn field(&mut self, colour: usize, first: usize, images: usize) -> Result<()> {
        self.pupil_field(colour, first, images)?;
        self.transform(colour, images)?;
        if self.stores_intensity() {
            let strips = [self.partition.lanes, self.counts.strips, images];
            self.colour_kernels[colour].add_intensity.launch(strips)?;
        }
        Ok(())
    }

    /// From the source of the adjoint to the gradient by the phase, of a wavelength.
    fn field_adjoint(&mut self, colour: usize, first: usize, images: usize) -> Result<()> {
        if self.stores_intensity() {
            let strips = [self.partition.lanes, self.counts.strips, images];
            self.colour_kernels[colour].scale_field.launch(strips)?;
        }
        self.transform_adjoint(colour, images)?;
        self.pupil_gradient(colour, first, images)
    }

    /// From the gradient by the phase to that by the modes and by the free phase.
    fn project(&mut self, first: usize, images: usize) -> Result<()> {
        self.project_modes(first, images)?;
        self.free_phase(first, images, FreePhaseStep::Gradient)
    }

    /// The response of the pixels, on what is stored: the intensity, or the source of the adjoint.
    fn convolve(&mut self, images: usize) -> Result<()> {
        if self.counts.terms == 0 {
            return Ok(());
        }
        let strips = [self.partition.lanes, self.counts.strips, images];
        self.pixel_kernels.convolve.iter_mut().try_for_each(|kernel| kernel.launch(strips))
    }

    // Kernels that process GROUP images together are launched for whole groups. Beyond `images`
    // they process leftovers of an earlier tile (or zeros), and their results are not read.

    fn smooth_phase(&mut self, first: usize, images: usize) -> Result<()> {
        let (images, k) = (padded(images), &mut self.phase_kernels.smooth_phase);
        k.int("first", first)?.int("images", images)?;
        k.launch([self.counts.blocks, self.partition.group_items.min(images / GROUP), 1])
    }

    fn free_phase(&mut self, first: usize, images: usize, step: FreePhaseStep) -> Result<()> {
        if self.counts.free == 0 {
            return Ok(());
        }
        let k = match step {
            FreePhaseStep::Add => &mut self.phase_kernels.add_free_phase,
            FreePhaseStep::Gradient => &mut self.phase_kernels.free_phase_gradient,
        };
        // As many work-items as for the blocks: the work per sample is small.
        k.int("first", first)?.launch([self.partition.block_items, images, 1])
    }

    fn pupil_field(&mut self, colour: usize, first: usize, images: usize) -> Result<()> {
        self.colour_kernels[colour].pupil_field.int("first", first)?.launch([self.counts.blocks, images, 1])
    }

    fn focus(&mut self, tile: usize, first: usize, images: usize, workers: usize) -> Result<()> {
        let k = &mut self.pixel_kernels.focus;
        k.int("tile", tile)?.int("first", first)?.int("images", images)?.launch([workers, 1, 1])
    }

    fn transform(&mut self, colour: usize, images: usize) -> Result<()> {
        let (shape, partition, k) = (&self.shape, &self.partition, &mut self.colour_kernels[colour]);
        let groups = shape.pairs.div_ceil(TALL);
        k.forward_columns.launch([2 * shape.width / shape.vector, groups.min(partition.column_items), images])?;
        let items = shape.row_chunks(shape.span) * shape.pairs.div_ceil(partition.pairs_per_item);
        k.forward_rows.launch([items, 1, images])
    }

    fn pixels(&mut self, first: usize, images: usize, fitted: bool) -> Result<()> {
        let (partition, k) = (&self.partition, &mut self.pixel_kernels);
        let strips = [partition.lanes, self.counts.strips, images];
        if fitted {
            k.sums.int("first", first)?.launch(strips)?;
        }
        k.photometry_solve.int("first", first)?.launch([partition.lanes, images, 1])?;
        k.residuals.int("first", first)?.launch(strips)
    }

    fn transform_adjoint(&mut self, colour: usize, images: usize) -> Result<()> {
        let (shape, partition, k) = (&self.shape, &self.partition, &mut self.colour_kernels[colour]);
        let items = shape.row_chunks(shape.width) * shape.pairs.div_ceil(partition.pairs_per_item);
        k.adjoint_rows.launch([items, 1, images])?;
        let groups = shape.rows.div_ceil(TALL);
        k.adjoint_columns.launch([2 * shape.width / shape.vector, groups.min(partition.column_items), images])
    }

    fn pupil_gradient(&mut self, colour: usize, first: usize, images: usize) -> Result<()> {
        let (partition, counts, k) = (&self.partition, &self.counts, &mut self.colour_kernels[colour]);
        k.pupil_gradient.launch([partition.block_items, images, 1])?;
        k.project_segments.int("first", first)?.launch([counts.segments, images, 1])
    }

    fn project_modes(&mut self, first: usize, images: usize) -> Result<()> {
        let (partition, counts, k) = (&self.partition, &self.counts, &mut self.phase_kernels);
        let groups = images.div_ceil(GROUP);
        k.project_modes.int("images", groups * GROUP)?;
        let (modes, chunks) = (counts.mode_groups, counts.chunks);
        let [x, y] = if self.shape.vector == 1 { [chunks, modes] } else { [modes, chunks] };
        k.project_modes.launch([x, y, groups.min(partition.group_items)])?;
        k.collect.int("first", first)?.launch([partition.output_items, images, 1])
    }
}
