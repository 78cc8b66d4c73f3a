//! What the chain keeps on the device, and how much of it there is.

use super::fold::{Blocks, GROUP, MODES_AT_ONCE, Shape};
use super::layout::GpuLayout;
use crate::Result;
use crate::device::{Buffer, Build, Device, DeviceInfo, Precision, Reals};

/// Bytes of a tile's pupil arrays for each core of a processor: what its share of the last cache holds beside the
/// images that stream through.
const TILE_BYTES_PER_CORE: usize = 4 << 20;
/// Bytes of a tile's arrays on a GPU: enough images to fill it, a small part of its memory.
const TILE_BYTES_GPU: usize = 256 << 20;
/// Work-items of `focus` for each core: so many that the core which is dealt the last of them still finds one.
const WORKERS_PER_CORE: usize = 3;

/// `count` images in whole groups; what the surplus images compute is never read.
pub(super) fn padded(count: usize) -> usize {
    count.next_multiple_of(GROUP)
}

/// How the launches are cut, which is where a processor and a GPU differ: few long work-items, or many short ones.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cut {
    /// Images that go through the stages together; a multiple of `GROUP`.
    pub tile: usize,
    /// Images whose fields have room at once; a multiple of `GROUP`.
    pub focal_tile: usize,
    /// Work-items of `focus`; `None` on a GPU, where no work-item carries an image.
    pub workers: Option<usize>,
    /// From so many images on, `focus` keeps every core busy.
    pub focus_from: usize,
    /// Work-items that share the output rows of one vector of columns.
    pub column_items: usize,
    /// Row pairs of a work-item of the row products.
    pub pairs_per_item: usize,
    /// Work-items that share the blocks of an image when its gradient is unfolded.
    pub block_items: usize,
    /// Work-items that share the numbers that come down for an image.
    pub output_items: usize,
    /// Work-items that share the images of a tile, for one block or one group of modes.
    pub group_items: usize,
    /// Row pairs of a strip of pixels.
    pub pairs_per_strip: usize,
    /// Work-items that share a strip.
    pub lanes: usize,
    /// Blocks over which a work-item of the projection sums.
    pub blocks_per_chunk: usize,
}

impl Cut {
    fn new(info: &DeviceInfo, build: Build, shape: &Shape, blocks: usize, outputs: usize, capacity: usize) -> Self {
        let number = build.precision.bytes();
        let phase = blocks * 4 * shape.vector * number;
        let rest =
            (shape.rows * 8 * shape.width + blocks * 16 * shape.vector + shape.pairs * 8 * (shape.width + shape.span))
                * number;
        let fits = |budget: usize, bytes: usize| (budget / bytes / GROUP * GROUP).clamp(GROUP, padded(capacity));
        if build.is_scalar() {
            let tile = fits(TILE_BYTES_GPU, phase + rest);
            Cut {
                tile,
                focal_tile: tile,
                workers: None,
                focus_from: usize::MAX,
                column_items: usize::MAX,
                pairs_per_item: 1,
                block_items: blocks,
                output_items: outputs,
                group_items: tile / GROUP,
                pairs_per_strip: 4,
                lanes: 32,
                blocks_per_chunk: 64,
            }
        } else {
            let cores = info.compute_units.max(1) as usize;
            Cut {
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

/// How many of everything there are.
#[derive(Debug, Clone, Copy)]
pub(super) struct Counts {
    pub capacity: usize,
    pub blocks: usize,
    pub segments: usize,
    /// Numbers that say how a segment stands.
    pub poses: usize,
    pub smooth: usize,
    /// Groups of `MODES_AT_ONCE` smooth modes.
    pub mode_groups: usize,
    /// Strips of pixels of an image.
    pub strips: usize,
    /// Chunks of blocks of the projection.
    pub chunks: usize,
    /// Lit samples with a phase of their own: all, or none.
    pub free: usize,
    /// Objective, flux, background, and a derivative for each pose of each segment and each smooth mode.
    pub outputs: usize,
}

impl Counts {
    /// The counts, and the cut that some of them follow from.
    pub fn new(
        info: &DeviceInfo,
        build: Build,
        layout: &GpuLayout,
        shape: &Shape,
        blocks: &Blocks,
        capacity: usize,
    ) -> (Self, Cut) {
        let (smooth, segments) = (layout.smooth.len(), layout.segments);
        let poses = layout.poses();
        let outputs = 3 + segments * poses + smooth;
        let cut = Cut::new(info, build, shape, blocks.count(), outputs, capacity);
        let counts = Self {
            capacity,
            blocks: blocks.count(),
            segments,
            poses,
            smooth,
            mode_groups: smooth.div_ceil(MODES_AT_ONCE),
            strips: shape.fft.map_or(shape.pairs.div_ceil(cut.pairs_per_strip), |fft| fft.points() / shape.vector),
            chunks: blocks.count().div_ceil(cut.blocks_per_chunk),
            free: if layout.free_phase { layout.lit.len() } else { 0 },
            outputs,
        };
        (counts, cut)
    }
}

/// What never changes: the pupil, the basis, the tables of the transform.
pub(super) struct Scene {
    pub basis: Reals,
    pub diversity: Reals,
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
    pub lit_place: Buffer<i32>,
    pub y_to_v: Reals,
    pub x_to_u: Reals,
    pub u_to_x: Reals,
    pub v_to_y: Reals,
    /// Of the FFT; empty without.
    pub twiddle: Reals,
}

impl Scene {
    pub fn new(device: &Device, precision: Precision, shape: &Shape, blocks: &Blocks) -> Result<Self> {
        let upload = |values: &[f64]| Reals::upload(device, precision, values);
        let [y_to_v, x_to_u, u_to_x, v_to_y] = if shape.fft.is_some() { Default::default() } else { shape.tables() };
        Ok(Self {
            basis: upload(&blocks.basis)?,
            diversity: upload(&blocks.diversity)?,
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
            lit_place: device.upload(&blocks.lit_place)?,
            y_to_v: upload(&y_to_v)?,
            x_to_u: upload(&x_to_u)?,
            u_to_x: upload(&u_to_x)?,
            v_to_y: upload(&v_to_y)?,
            twiddle: upload(&shape.twiddles())?,
        })
    }
}

/// What goes up and comes down: the images once, coefficients and results with every call.
pub(super) struct Batch {
    pub data: Reals,
    pub weight: Reals,
    /// How the photometry of each slot is found: 0 known, 1 flux fitted, 2 flux and background fitted.
    pub kind: Buffer<i32>,
    /// Of each slot, as `Folded::known`.
    pub known: Reals,
    /// The slot of each active image.
    pub slot: Buffer<i32>,
    /// The images of each tile that `focus` has taken so far.
    pub next: Buffer<i32>,
    pub coefficients: Reals,
    /// `[image][segment][re q, im q, tip, tilt]`.
    pub pose: Reals,
    /// `[image][lit sample]`: the free phase, turns, and after an evaluation the derivative by it.
    pub free: Reals,
    pub result: Reals,
}

impl Batch {
    pub fn new(device: &Device, precision: Precision, shape: &Shape, counts: &Counts) -> Result<Self> {
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
            pose: zeros(active * counts.segments * 4)?,
            free: zeros(active * counts.free)?,
            result: zeros(active * counts.outputs)?,
        })
    }
}

/// What the stages hand each other: `psi` to `mode_partial` for one tile, the rest for the images that are in work at once.
pub(super) struct Scratch {
    /// Smooth phase, then the derivative by it.
    pub psi: Reals,
    pub field: Reals,
    pub wave: Reals,
    /// One row of vectors in the FFT, and the samples of both sides before it.
    pub line: Reals,
    pub side: Reals,
    pub focal: Reals,
    pub phasor: Reals,
    pub lit_field: Reals,
    pub sums: Reals,
    pub objective: Reals,
    pub photometry: Reals,
    pub segment_sum: Reals,
    pub mode_partial: Reals,
}

impl Scratch {
    pub fn new(device: &Device, precision: Precision, shape: &Shape, counts: &Counts, cut: &Cut) -> Result<Self> {
        let zeros = |per_image: usize| Reals::zeros(device, precision, cut.tile * per_image);
        let in_work = |per_image: usize| Reals::zeros(device, precision, cut.focal_tile * per_image);
        let partials = counts.strips * cut.lanes;
        Ok(Self {
            // Zero where the pupil has no block: neither the field nor its adjoint is ever written there.
            field: in_work(shape.side_rows().max(shape.rows) * 8 * shape.width)?,
            wave: in_work(shape.pairs * 8 * shape.width)?,
            focal: in_work(shape.pixels() * 2)?,
            line: in_work(shape.fft_scratch()[0])?,
            side: in_work(shape.fft_scratch()[1])?,
            phasor: in_work(counts.blocks * 8 * shape.vector)?,
            lit_field: in_work(counts.blocks * 8 * shape.vector)?,
            psi: zeros(counts.blocks * 4 * shape.vector)?,
            sums: zeros(partials * 3)?,
            objective: zeros(partials)?,
            photometry: zeros(2)?,
            segment_sum: zeros(counts.segments * counts.poses)?,
            mode_partial: zeros(counts.chunks * counts.mode_groups * MODES_AT_ONCE)?,
        })
    }
}
