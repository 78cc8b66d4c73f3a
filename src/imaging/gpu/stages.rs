//! The kernels of the chain, their buffers, and the order in which they run.

use super::fold::{Blocks, GROUP, MODES_AT_ONCE, Shape, TALL, row_chunks};
use super::layout::GpuLayout;
use super::reals::Reals;
use super::{Folded, padded};
use crate::Result;
use crate::device::{Buffer, Build, Device, Kernel};

/// Bytes of a tile's arrays on a processor: what stays in a last-level cache.
const TILE_BYTES_CPU: usize = 16 << 20;
/// Bytes of a tile's arrays on a GPU: enough images to fill it, a small part of its memory.
const TILE_BYTES_GPU: usize = 256 << 20;

/// How the launches are cut, which is where a processor and a GPU differ: few long work-items, or many short ones.
#[derive(Debug, Clone, Copy)]
struct Cut {
    /// Images that go through the stages together; a multiple of `GROUP`.
    tile: usize,
    /// Work-items per image that share the groups of output rows, the blocks, the outputs.
    column_items: usize,
    pairs_per_item: usize,
    block_items: usize,
    output_items: usize,
    /// Work-items per block, or group of modes, that share the images of a tile.
    group_items: usize,
    /// Row pairs of a strip of pixels, work-items that share a strip.
    pairs_per_strip: usize,
    lanes: usize,
    blocks_per_chunk: usize,
}

impl Cut {
    fn new(build: Build, shape: &Shape, blocks: &Blocks, outputs: usize, capacity: usize) -> Self {
        let numbers = 2 * (shape.rows * 8 * shape.width) / 2 + shape.pairs * 8 * (shape.width + shape.span);
        let bytes = numbers * build.precision.bytes();
        let fits = |budget: usize| (budget / bytes / GROUP * GROUP).clamp(GROUP, padded(capacity));
        if build.is_scalar() {
            let tile = fits(TILE_BYTES_GPU);
            Cut {
                tile,
                column_items: usize::MAX,
                pairs_per_item: 1,
                block_items: blocks.count(),
                output_items: outputs,
                group_items: tile / GROUP,
                pairs_per_strip: 4,
                lanes: 32,
                blocks_per_chunk: 64,
            }
        } else {
            Cut {
                tile: fits(TILE_BYTES_CPU),
                column_items: 1,
                pairs_per_item: 16,
                block_items: 4,
                output_items: 1,
                group_items: 1,
                pairs_per_strip: 16,
                lanes: 1,
                blocks_per_chunk: 8,
            }
        }
    }
}

/// What changes from scene to scene, counted.
#[derive(Debug, Clone, Copy)]
struct Counts {
    blocks: usize,
    smooth: usize,
    segments: usize,
    mode_groups: usize,
    strips: usize,
    chunks: usize,
    outputs: usize,
}

pub(super) struct Stages {
    shape: Shape,
    cut: Cut,
    counts: Counts,
    // Inputs that change with every call.
    coefficients: Reals,
    segment_phasor: Reals,
    slot: Buffer<i32>,
    // Images.
    data: Reals,
    weight: Reals,
    kind: Buffer<i32>,
    known: Reals,
    // What comes down.
    focal: Reals,
    result: Reals,
    /// Buffers that only kernels touch: scratch of a tile, and the tables of the scene.
    _resident: Vec<Reals>,
    _lists: Vec<Buffer<i32>>,
    kernels: Kernels,
    capacity: usize,
}

/// One of each, bound to everything that does not change.
struct Kernels {
    pupil_field: Kernel,
    forward_columns: Kernel,
    forward_rows: Kernel,
    photometry_sums: Kernel,
    photometry_solve: Kernel,
    residuals: Kernel,
    adjoint_rows: Kernel,
    adjoint_columns: Kernel,
    pupil_gradient: Kernel,
    project_modes: Kernel,
    collect: Kernel,
}

impl Stages {
    pub fn new(
        device: &Device,
        build: Build,
        shape: Shape,
        blocks: Blocks,
        layout: &GpuLayout,
        capacity: usize,
        twice_wavenumber: f64,
    ) -> Result<Self> {
        let (smooth, segments) = (layout.smooth.len(), layout.segments);
        let outputs = 3 + segments + smooth;
        let cut = Cut::new(build, &shape, &blocks, outputs, capacity);
        let counts = Counts {
            blocks: blocks.count(),
            smooth,
            segments,
            mode_groups: smooth.div_ceil(MODES_AT_ONCE),
            strips: shape.pairs.div_ceil(cut.pairs_per_strip),
            chunks: blocks.count().div_ceil(cut.blocks_per_chunk),
            outputs,
        };
        let precision = build.precision;
        let zeros = |len: usize| Reals::zeros(device, precision, len);
        let upload = |values: &[f64]| Reals::upload(device, precision, values);
        let batch = padded(capacity);
        let tile = cut.tile;
        let partials = counts.strips * cut.lanes;

        let field = zeros(tile * shape.rows * 8 * shape.width)?;
        let wave = zeros(tile * shape.pairs * 8 * shape.width)?;
        let focal = zeros(tile * shape.pairs * 8 * shape.span)?;
        let phasor = zeros(tile * counts.blocks * 8 * shape.vector)?;
        let slope = zeros(tile * counts.blocks * 4 * shape.vector)?;
        let segment_partial = zeros(tile * blocks.entries() * 2)?;
        let mode_partial = zeros(tile * counts.chunks * counts.mode_groups * MODES_AT_ONCE)?;
        let sums = zeros(tile * partials * 3)?;
        let objective = zeros(tile * partials)?;
        let photometry = zeros(tile * 2)?;
        let coefficients = zeros(batch * smooth)?;
        let segment_phasor = zeros(batch * segments * 2)?;
        let result = zeros(batch * outputs)?;
        let slot = device.buffer(batch)?;
        let data = zeros(capacity * shape.pixels())?;
        let weight = zeros(capacity * shape.pixels())?;
        let kind = device.buffer(capacity)?;
        let known = zeros(capacity * 4)?;

        let basis = upload(&blocks.basis)?;
        let diversity = upload(&blocks.diversity)?;
        let entry_weight = upload(&blocks.entry_weight)?;
        let place = device.upload(&blocks.place)?;
        let extent = device.upload(&blocks.extent)?;
        let entry_start = device.upload(&blocks.entry_start)?;
        let entry_segment = device.upload(&blocks.entry_segment)?;
        let segment_start = device.upload(&blocks.segment_start)?;
        let segment_entry = device.upload(&blocks.segment_entry)?;
        let [y_to_v, x_to_u, u_to_x, v_to_y] = shape.tables();
        let (y_to_v, x_to_u, u_to_x, v_to_y) =
            (upload(&y_to_v)?, upload(&x_to_u)?, upload(&u_to_x)?, upload(&v_to_y)?);

        let kernel = |name| device.kernel(name, build);
        let mut kernels = Kernels {
            pupil_field: kernel("pupil_field")?,
            forward_columns: kernel("forward_columns")?,
            forward_rows: kernel("forward_rows")?,
            photometry_sums: kernel("photometry_sums")?,
            photometry_solve: kernel("photometry_solve")?,
            residuals: kernel("residuals")?,
            adjoint_rows: kernel("adjoint_rows")?,
            adjoint_columns: kernel("adjoint_columns")?,
            pupil_gradient: kernel("pupil_gradient")?,
            project_modes: kernel("project_modes")?,
            collect: kernel("collect")?,
        };

        let k = &mut kernels.pupil_field;
        basis.bind(k, "basis")?;
        diversity.bind(k, "diversity")?;
        entry_weight.bind(k, "entry_weight")?;
        coefficients.bind(k, "coefficients")?;
        segment_phasor.bind(k, "segment_phasor")?;
        phasor.bind(k, "phasor")?;
        field.bind(k, "field")?;
        k.buffer("place", &place)?.buffer("entry_start", &entry_start)?.buffer("entry_segment", &entry_segment)?;
        k.int("blocks", counts.blocks)?.int("modes", smooth)?.int("segments", segments)?;
        k.int("rows", shape.rows)?.int("width", shape.width)?;
        k.int("block_stride", blocks.block_stride)?.int("mode_stride", blocks.mode_stride)?;
        k.int("quadrant_stride", blocks.quadrant_stride)?;

        for (k, table, groups) in [
            (&mut kernels.forward_columns, &y_to_v, shape.pairs.div_ceil(TALL)),
            (&mut kernels.adjoint_columns, &v_to_y, shape.rows.div_ceil(TALL)),
        ] {
            field.bind(k, "field")?;
            wave.bind(k, "wave")?;
            table.bind(k, "table")?.buffer("extent", &extent)?;
            k.int("rows", shape.rows)?.int("pairs", shape.pairs)?.int("groups", groups)?.int("width", shape.width)?;
        }

        for (k, table, inputs) in
            [(&mut kernels.forward_rows, &x_to_u, shape.rows), (&mut kernels.adjoint_rows, &u_to_x, shape.pairs)]
        {
            wave.bind(k, "wave")?;
            focal.bind(k, "focal")?;
            table.bind(k, "table")?.int("inputs", inputs)?;
            k.int("pairs", shape.pairs)?.int("pairs_per_item", cut.pairs_per_item)?;
        }
        kernels.forward_rows.int("in_width", shape.width)?.int("span", shape.span)?;
        kernels.adjoint_rows.int("in_width", shape.span)?.int("width", shape.width)?;

        for k in [&mut kernels.photometry_sums, &mut kernels.residuals] {
            focal.bind(k, "focal")?;
            data.bind(k, "data")?;
            weight.bind(k, "weight")?.buffer("slot", &slot)?;
            k.int("pairs", shape.pairs)?.int("pairs_per_strip", cut.pairs_per_strip)?.int("span", shape.span)?;
        }
        sums.bind(&mut kernels.photometry_sums, "partial")?;
        objective.bind(&mut kernels.residuals, "objective")?;
        photometry.bind(&mut kernels.residuals, "photometry")?;

        let k = &mut kernels.photometry_solve;
        sums.bind(k, "partial")?;
        known.bind(k, "known")?;
        photometry.bind(k, "photometry")?.buffer("slot", &slot)?.buffer("kind", &kind)?.int("partials", partials)?;

        let k = &mut kernels.pupil_gradient;
        field.bind(k, "field")?;
        phasor.bind(k, "phasor")?;
        entry_weight.bind(k, "entry_weight")?;
        segment_phasor.bind(k, "segment_phasor")?;
        slope.bind(k, "slope")?;
        segment_partial.bind(k, "segment_partial")?;
        k.buffer("place", &place)?.buffer("entry_start", &entry_start)?.buffer("entry_segment", &entry_segment)?;
        k.int("blocks", counts.blocks)?.int("segments", segments)?.int("entries", blocks.entries())?;
        k.int("rows", shape.rows)?.int("width", shape.width)?;

        let k = &mut kernels.project_modes;
        basis.bind(k, "basis")?;
        slope.bind(k, "slope")?;
        mode_partial.bind(k, "mode_partial")?;
        k.int("blocks", counts.blocks)?.int("groups", counts.mode_groups)?;
        k.int("blocks_per_chunk", cut.blocks_per_chunk)?.int("block_stride", blocks.block_stride)?;
        k.int("mode_stride", blocks.mode_stride)?.int("quadrant_stride", blocks.quadrant_stride)?;

        let k = &mut kernels.collect;
        mode_partial.bind(k, "mode_partial")?;
        segment_partial.bind(k, "segment_partial")?;
        segment_phasor.bind(k, "segment_phasor")?;
        objective.bind(k, "objective")?;
        photometry.bind(k, "photometry")?;
        result.bind(k, "result")?;
        k.buffer("segment_start", &segment_start)?.buffer("segment_entry", &segment_entry)?;
        k.int("segments", segments)?.int("smooth", smooth)?;
        k.int("padded_modes", counts.mode_groups * MODES_AT_ONCE)?.int("chunks", counts.chunks)?;
        k.int("entries", blocks.entries())?.int("partials", partials)?.real("twice_wavenumber", twice_wavenumber)?;

        Ok(Self {
            shape,
            cut,
            counts,
            coefficients,
            segment_phasor,
            slot,
            data,
            weight,
            kind,
            known,
            focal,
            result,
            _resident: vec![
                field, wave, phasor, slope, segment_partial, mode_partial, sums, objective, photometry, basis, diversity,
                entry_weight, y_to_v, x_to_u, u_to_x, v_to_y,
            ],
            _lists: vec![place, extent, entry_start, entry_segment, segment_start, segment_entry],
            kernels,
            capacity,
        })
    }

    /// Images that go through the stages together.
    pub fn tile(&self) -> usize {
        self.cut.tile
    }

    /// Puts an image into `slot`.
    pub fn load(&mut self, slot: usize, image: &Folded) -> Result<()> {
        self.data.write(slot * self.shape.pixels(), &image.data)?;
        self.weight.write(slot * self.shape.pixels(), &image.weights)?;
        self.kind.write(slot, &[image.kind])?;
        self.known.write(slot * 4, &image.known)
    }

    /// `[image][objective, flux, background, segments..., smooth modes...]` for the images in the slots `active`.
    pub fn evaluate(&mut self, active: &[usize], turns: &[f64], phasors: &[f64], fitted: bool) -> Result<Vec<f64>> {
        let mut results = vec![0.0; active.len() * self.counts.outputs];
        // A batch larger than the capacity (an image may be active more than once) goes in several rounds.
        for (i, active) in active.chunks(self.capacity).enumerate() {
            let (from, count) = (i * self.capacity, active.len());
            self.write_inputs(count, &turns[from * self.counts.smooth..], &phasors[from * self.counts.segments * 2..])?;
            let slots: Vec<i32> = active.iter().map(|&slot| slot as i32).collect();
            self.slot.write(0, &slots)?;
            let tiles = count.div_ceil(self.cut.tile);
            let tile = padded(count.div_ceil(tiles));
            for first in (0..count).step_by(tile) {
                let images = padded(tile.min(count - first));
                self.forward(first, images)?;
                self.pixels(first, images, fitted)?;
                self.adjoint(first, images)?;
            }
            let outputs = self.counts.outputs;
            self.result.read(0, &mut results[from * outputs..(from + count) * outputs])?;
        }
        Ok(results)
    }

    /// The focal fields of at most a tile of images, folded.
    pub fn focal(&mut self, count: usize, turns: &[f64], phasors: &[f64]) -> Result<Vec<f64>> {
        self.write_inputs(count, turns, phasors)?;
        self.forward(0, padded(count))?;
        let mut focal = vec![0.0; count * self.shape.pixels() * 2];
        self.focal.read(0, &mut focal)?;
        Ok(focal)
    }

    fn write_inputs(&mut self, images: usize, turns: &[f64], phasors: &[f64]) -> Result<()> {
        self.coefficients.write(0, &turns[..images * self.counts.smooth])?;
        self.segment_phasor.write(0, &phasors[..images * self.counts.segments * 2])
    }

    fn forward(&mut self, first: usize, images: usize) -> Result<()> {
        let (shape, cut, k) = (&self.shape, &self.cut, &mut self.kernels);
        k.pupil_field.int("first", first)?.int("images", images)?;
        k.pupil_field.launch([self.counts.blocks, cut.group_items.min(images / GROUP), 1])?;
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

    fn adjoint(&mut self, first: usize, images: usize) -> Result<()> {
        let (shape, cut, k) = (&self.shape, &self.cut, &mut self.kernels);
        let chunks = row_chunks(shape.width / shape.vector);
        k.adjoint_rows.launch([chunks, shape.pairs.div_ceil(cut.pairs_per_item), images])?;
        let groups = shape.rows.div_ceil(TALL);
        k.adjoint_columns.launch([2 * shape.width / shape.vector, groups.min(cut.column_items), images])?;
        k.pupil_gradient.int("first", first)?.launch([cut.block_items, images, 1])?;
        let groups = cut.group_items.min(images / GROUP);
        k.project_modes.int("images", images)?.launch([self.counts.mode_groups, self.counts.chunks, groups])?;
        k.collect.int("first", first)?.launch([cut.output_items, images, 1])
    }
}
