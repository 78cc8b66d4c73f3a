//! Buffers of the chain on the device, their sizes, and the sizes of the launches.

use super::fold::{Blocks, FoldedShape, GROUP, MODES_AT_ONCE};
use super::layout::GpuLayout;
use crate::Result;
use crate::device::{Buffer, Build, Device, DeviceInfo, Precision, Reals};

/// Bytes of the pupil arrays of a tile, per core of a CPU: a part of the core's share of the
/// last-level cache, through which the images pass too.
const TILE_BYTES_PER_CORE: usize = 4 << 20;
/// Bytes of the arrays of a tile on a GPU: enough images to use all of it, and a small part of its
/// memory.
const TILE_BYTES_GPU: usize = 256 << 20;
/// Work-items that share a sum on a GPU, as many as run in lockstep: the work-groups of the pixels'
/// kernels in `device/table.rs`, `SOLVERS` of `pixels.cl`.
const LOCKSTEP: usize = 32;
/// Work-items of `focus` per core: so many that every core has at least one, however they are
/// distributed.
const WORKERS_PER_CORE: usize = 3;

/// `count` rounded up to whole groups; the results of the surplus images are not read.
pub(super) fn padded(count: usize) -> usize {
    count.next_multiple_of(GROUP)
}

/// Partition of the work into tiles, strips and work-items: few long work-items on a CPU, many
/// short ones on a GPU.
#[derive(Debug, Clone, Copy)]
pub(super) struct Partition {
    /// Images that are processed together by each stage; a multiple of `GROUP`.
    pub tile: usize,
    /// Images whose fields fit in memory at once; a multiple of `GROUP`.
    pub focal_tile: usize,
    /// Work-items of `focus`; `None` on a GPU, where it is not used.
    pub workers: Option<usize>,
    /// Number of images from which `focus` uses every core.
    pub focus_from: usize,
    /// Work-items per vector of columns, which share its output rows.
    pub column_items: usize,
    /// Row pairs per work-item of the row products.
    pub pairs_per_item: usize,
    /// Work-items per image in the unfolding of the gradient, which share its blocks.
    pub block_items: usize,
    /// Work-items per image in the collection of the results, which share its outputs.
    pub output_items: usize,
    /// Work-items per block or group of modes, which share the images of a tile.
    pub group_items: usize,
    /// Row pairs per strip of pixels.
    pub pairs_per_strip: usize,
    /// Work-items per strip.
    pub lanes: usize,
    /// Blocks per work-item of the projection.
    pub blocks_per_chunk: usize,
}

impl Partition {
    fn new(
        info: &DeviceInfo,
        build: Build,
        layout: &GpuLayout,
        shape: &FoldedShape,
        blocks: usize,
        capacity: usize,
    ) -> Self {
        let (number, colours) = (build.precision.bytes(), layout.colours.len());
        let phase = blocks * 4 * shape.vector * number;
        let rest = (shape.rows * 8 * shape.width
            + shape.pairs * 8 * shape.width
            + colours * (blocks * 16 * shape.vector + shape.pairs * 8 * shape.span))
            * number;
        let fits = |budget: usize, bytes: usize| (budget / bytes / GROUP * GROUP).clamp(GROUP, padded(capacity));
        if build.is_scalar() {
            let tile = fits(TILE_BYTES_GPU, phase + rest);
            Partition {
                tile,
                focal_tile: tile,
                workers: None,
                focus_from: usize::MAX,
                column_items: usize::MAX,
                pairs_per_item: 1,
                block_items: blocks,
                output_items: layout.outputs(),
                group_items: tile / GROUP,
                pairs_per_strip: 4,
                lanes: LOCKSTEP,
                blocks_per_chunk: blocks.div_ceil(LOCKSTEP).max(1),
            }
        } else {
            let cores = info.compute_units.max(1) as usize;
            Partition {
                tile: fits(TILE_BYTES_PER_CORE * cores, phase),
                focal_tile: padded(WORKERS_PER_CORE * cores),
                workers: Some(WORKERS_PER_CORE * cores),
                focus_from: 2 * cores,
                column_items: 1,
                pairs_per_item: 16,
                block_items: 4,
                output_items: 1,
                group_items: 1,
                pairs_per_strip: 16,
                lanes: 1,
                blocks_per_chunk: 16,
            }
        }
    }
}

/// Numbers of images, blocks, segments, modes and outputs.
#[derive(Debug, Clone, Copy)]
pub(super) struct Counts {
    pub capacity: usize,
    pub blocks: usize,
    pub segments: usize,
    /// Degrees of freedom of a segment.
    pub poses: usize,
    pub smooth: usize,
    pub colours: usize,
    /// Pixels whose intensity is stored, in the padded layout; 0 where the image is the squared
    /// modulus of one field.
    pub stored_pixels: usize,
    /// Terms of the convolution with the response of the pixels, along one axis; 0 for pixels that
    /// are points.
    pub terms: usize,
    /// Groups of `MODES_AT_ONCE` smooth modes.
    pub mode_groups: usize,
    /// Strips of pixels per image.
    pub strips: usize,
    /// Chunks of blocks in the projection.
    pub chunks: usize,
    /// Number of samples with a free phase: all illuminated ones, or 0.
    pub free: usize,
    /// Objective, flux, background, and a derivative for each pose of each segment and each smooth
    /// mode.
    pub outputs: usize,
}

impl Counts {
    /// The counts, and the partition from which some of them follow.
    pub fn new(
        info: &DeviceInfo,
        build: Build,
        layout: &GpuLayout,
        shape: &FoldedShape,
        blocks: &Blocks,
        capacity: usize,
    ) -> (Self, Partition) {
        let (smooth, segments) = (layout.smooth.len(), layout.segments);
        let poses = layout.poses();
        let partition = Partition::new(info, build, layout, shape, blocks.count(), capacity);
        let counts = Self {
            capacity,
            blocks: blocks.count(),
            segments,
            poses,
            smooth,
            colours: layout.colours.len(),
            stored_pixels: if layout.is_one_field() { 0 } else { shape.pixels() },
            terms: layout.pixel_terms.as_ref().map_or(0, |[x, _]| x.len()),
            mode_groups: smooth.div_ceil(MODES_AT_ONCE),
            strips: shape
                .fft
                .map_or(shape.pairs.div_ceil(partition.pairs_per_strip), |fft| fft.points() / shape.vector),
            chunks: blocks.count().div_ceil(partition.blocks_per_chunk),
            free: if layout.free_phase { layout.illuminated.len() } else { 0 },
            outputs: layout.outputs(),
        };
        (counts, partition)
    }
}

/// Buffers of the model that all wavelengths share, constant after construction: the pupil, the
/// diversity of the first wavelength, the basis, the response of the pixels.
pub(super) struct ModelBuffers {
    /// At the first wavelength.
    pub diversity: Reals,
    pub basis: Reals,
    pub entry_weight: Reals,
    pub entry_x: Reals,
    pub entry_y: Reals,
    pub place: Buffer<i32>,
    pub extent: Buffer<i32>,
    pub entry_start: Buffer<i32>,
    pub entry_segment: Buffer<i32>,
    pub entry_place: Buffer<i32>,
    pub segment_start: Buffer<i32>,
    pub segment_entry: Buffer<i32>,
    pub sample_place: Buffer<i32>,
    /// `[along u, along v][term]`.
    pub terms: Reals,
    /// Twiddle factors of the FFT; empty without one.
    pub twiddle: Reals,
}

impl ModelBuffers {
    /// `shape` is that of the first wavelength.
    pub fn new(
        device: &Device,
        precision: Precision,
        layout: &GpuLayout,
        shape: &FoldedShape,
        blocks: &Blocks,
    ) -> Result<Self> {
        let upload = |values: &[f64]| Reals::upload(device, precision, values);
        Ok(Self {
            diversity: upload(&blocks.diversity(layout, &layout.colours[0], shape))?,
            basis: upload(&blocks.basis)?,
            entry_weight: upload(&blocks.entry_weight)?,
            entry_x: upload(&blocks.entry_x)?,
            entry_y: upload(&blocks.entry_y)?,
            place: device.upload(&blocks.place)?,
            extent: device.upload(&blocks.extent)?,
            entry_start: device.upload(&blocks.entry_start)?,
            entry_segment: device.upload(&blocks.entry_segment)?,
            entry_place: device.upload(&blocks.entry_place)?,
            segment_start: device.upload(&blocks.segment_start)?,
            segment_entry: device.upload(&blocks.segment_entry)?,
            sample_place: device.upload(&blocks.sample_place)?,
            terms: upload(&layout.pixel_terms.iter().flatten().flatten().copied().collect::<Vec<_>>())?,
            twiddle: upload(&shape.twiddles())?,
        })
    }
}

/// Buffers of the batch: images, uploaded once; coefficients, the free phase and results,
/// transferred with every call.
pub(super) struct BatchBuffers {
    pub data: Reals,
    pub weight: Reals,
    /// Photometry of each slot: 0 known, 1 flux fitted, 2 flux and background fitted.
    pub kind: Buffer<i32>,
    /// `FoldedImage::known` of each slot.
    pub known: Reals,
    /// The slot of each active image.
    pub slot: Buffer<i32>,
    /// Number of images of each tile that `focus` has started.
    pub next: Buffer<i32>,
    /// `[image][smooth mode]`, turns of the first wavelength.
    pub coefficients: Reals,
    /// `[image][illuminated sample]`: the free phase, turns, and after an evaluation the gradient
    /// by it.
    pub free: Reals,
    pub result: Reals,
}

impl BatchBuffers {
    pub fn new(device: &Device, precision: Precision, shape: &FoldedShape, counts: &Counts) -> Result<Self> {
        let zeros = |len: usize| Reals::zeros(device, precision, len);
        let (slots, active) = (counts.capacity, padded(counts.capacity));
        Ok(Self {
            data: zeros(slots * shape.pixels())?,
            weight: zeros(slots * shape.pixels())?,
            kind: device.buffer(slots)?,
            known: zeros(slots * 4)?,
            slot: device.buffer(active)?,
            next: device.buffer(active / GROUP)?,
            coefficients: zeros(active * counts.smooth)?,
            free: zeros(active * counts.free)?,
            result: zeros(active * counts.outputs)?,
        })
    }
}

/// Buffers between the stages that all wavelengths share: `psi` and `sums` to `mode_partial` for
/// one tile, the others for the images processed at a time.
pub(super) struct ScratchBuffers {
    /// Phase at the first wavelength, then the gradient by it.
    pub psi: Reals,
    pub field: Reals,
    pub wave: Reals,
    /// One line of vectors in the FFT, and its input samples on both sides of the axis.
    pub line: Reals,
    pub side: Reals,
    /// The stored intensity, and its convolution along one axis; empty where it is not stored.
    pub intensity: Reals,
    pub convolved: Reals,
    pub sums: Reals,
    pub objective: Reals,
    pub photometry: Reals,
    pub segment_sum: Reals,
    pub mode_partial: Reals,
}

impl ScratchBuffers {
    pub fn new(
        device: &Device,
        precision: Precision,
        shape: &FoldedShape,
        counts: &Counts,
        partition: &Partition,
    ) -> Result<Self> {
        let zeros = |per_image: usize| Reals::zeros(device, precision, partition.tile * per_image);
        let in_work = |per_image: usize| Reals::zeros(device, precision, partition.focal_tile * per_image);
        let partials = counts.strips * partition.lanes;
        Ok(Self {
            psi: zeros(counts.blocks * 4 * shape.vector)?,
            // Zero where the pupil has no block: no kernel writes there.
            field: in_work(shape.side_rows().max(shape.rows) * 8 * shape.width)?,
            wave: in_work(shape.pairs * 8 * shape.width)?,
            line: in_work(shape.fft_scratch()[0])?,
            side: in_work(shape.fft_scratch()[1])?,
            intensity: in_work(counts.stored_pixels)?,
            convolved: in_work(if counts.terms > 0 { counts.stored_pixels } else { 0 })?,
            sums: zeros(partials * 3)?,
            objective: zeros(partials)?,
            photometry: zeros(2)?,
            segment_sum: zeros(counts.segments * counts.poses)?,
            mode_partial: zeros(counts.chunks * counts.mode_groups * MODES_AT_ONCE)?,
        })
    }
}
