//! The kernels of the chain, bound to their buffers, and the order in which they run.

use super::chain::Folded;
use super::fold::{Blocks, GROUP, MODES_AT_ONCE, Shape, TALL, row_chunks};
use super::layout::GpuLayout;
use super::memory::{Batch, Counts, Cut, Scene, Scratch, padded};
use super::room::Room;
use crate::Result;
use crate::device::{Build, Device, Kernel, Reals};

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

/// One of each, bound to everything that does not change.
struct Kernels {
    smooth_phase: Kernel,
    add_free: Kernel,
    take_free: Kernel,
    pupil_field: Kernel,
    forward_columns: Kernel,
    forward_rows: Kernel,
    photometry_sums: Kernel,
    photometry_solve: Kernel,
    residuals: Kernel,
    focus: Kernel,
    adjoint_rows: Kernel,
    adjoint_columns: Kernel,
    pupil_gradient: Kernel,
    project_modes: Kernel,
    project_segments: Kernel,
    collect: Kernel,
}

/// Which way the free phase goes.
#[derive(Clone, Copy)]
enum Way {
    /// To the images.
    There,
    /// The derivative, from them.
    Back,
}

/// What the binding functions read.
struct Parts<'a> {
    device: &'a Device,
    build: Build,
    shape: &'a Shape,
    cut: &'a Cut,
    counts: &'a Counts,
    blocks: &'a Blocks,
    scene: &'a Scene,
    batch: &'a Batch,
    scratch: &'a Scratch,
}

impl Parts<'_> {
    fn kernel(&self, name: &'static str) -> Result<Kernel> {
        self.device.kernel(name, self.build)
    }

    /// What every kernel over blocks of the pupil takes.
    fn pupil(&self, name: &'static str) -> Result<Kernel> {
        let mut k = self.kernel(name)?;
        self.scratch.phasor.bind(&mut k, "phasor")?;
        self.scratch.lit_field.bind(&mut k, "lit_field")?;
        self.scratch.psi.bind(&mut k, "psi")?;
        self.scratch.field.bind(&mut k, "field")?;
        k.buffer("place", &self.scene.place)?.int("blocks", self.counts.blocks)?;
        k.int("rows", self.shape.rows)?.int("width", self.shape.width)?;
        Ok(k)
    }

    fn smooth_phase(&self) -> Result<Kernel> {
        let mut k = self.kernel("smooth_phase")?;
        self.scene.diversity.bind(&mut k, "diversity")?;
        self.batch.coefficients.bind(&mut k, "coefficients")?.int("modes", self.counts.smooth)?;
        self.scratch.psi.bind(&mut k, "psi")?.int("blocks", self.counts.blocks)?;
        self.basis(&mut k)?;
        Ok(k)
    }

    /// Free phases, and the derivatives by them.
    fn free(&self, name: &'static str) -> Result<Kernel> {
        let mut k = self.kernel(name)?;
        self.scratch.psi.bind(&mut k, "psi")?;
        self.batch.free.bind(&mut k, "free")?;
        k.buffer("lit_place", &self.scene.lit_place)?;
        k.int("lit", self.counts.free)?.int("blocks", self.counts.blocks)?;
        if name == "take_free" {
            k.real("twice_turn", 2.0 * std::f64::consts::TAU)?;
        }
        Ok(k)
    }

    fn pupil_field(&self) -> Result<Kernel> {
        let (scene, mut k) = (self.scene, self.pupil("pupil_field")?);
        self.poses(&mut k)?;
        k.buffer("entry_start", &scene.entry_start)?.buffer("entry_segment", &scene.entry_segment)?;
        Ok(k)
    }

    /// How the segments stand, and where.
    fn poses(&self, k: &mut Kernel) -> Result<()> {
        self.scene.entry_weight.bind(k, "entry_weight")?;
        self.scene.entry_x.bind(k, "entry_x")?;
        self.scene.entry_y.bind(k, "entry_y")?;
        self.batch.pose.bind(k, "pose")?.int("segments", self.counts.segments)?.int("poses", self.counts.poses)?;
        Ok(())
    }

    fn basis(&self, k: &mut Kernel) -> Result<()> {
        self.scene.basis.bind(k, "basis")?.int("block_stride", self.blocks.block_stride)?;
        k.int("mode_stride", self.blocks.mode_stride)?.int("quadrant_stride", self.blocks.quadrant_stride)?;
        Ok(())
    }

    fn columns(&self, name: &'static str) -> Result<Kernel> {
        let mut k = self.kernel(name)?;
        let (table, outputs) = match name {
            "forward_columns" => (&self.scene.y_to_v, self.shape.pairs),
            _ => (&self.scene.v_to_y, self.shape.rows),
        };
        self.scratch.field.bind(&mut k, "field")?;
        self.scratch.wave.bind(&mut k, "wave")?;
        table.bind(&mut k, "table")?.buffer("extent", &self.scene.extent)?;
        k.int("rows", self.shape.rows)?.int("pairs", self.shape.pairs)?;
        k.int("groups", outputs.div_ceil(TALL))?.int("width", self.shape.width)?;
        Ok(k)
    }

    fn rows(&self, name: &'static str) -> Result<Kernel> {
        let (shape, mut k) = (self.shape, self.kernel(name)?);
        if name == "forward_rows" {
            self.scene.x_to_u.bind(&mut k, "table")?.int("inputs", shape.rows)?;
            k.int("in_width", shape.width)?.int("span", shape.span)?;
        } else {
            self.scene.u_to_x.bind(&mut k, "table")?.int("inputs", shape.pairs)?;
            k.int("in_width", shape.span)?.int("width", shape.width)?;
        }
        self.scratch.wave.bind(&mut k, "wave")?;
        self.scratch.focal.bind(&mut k, "focal")?;
        k.int("pairs", shape.pairs)?.int("pairs_per_item", self.cut.pairs_per_item)?;
        Ok(k)
    }

    /// What the two passes over pixels take.
    fn pixels(&self, name: &'static str) -> Result<Kernel> {
        let mut k = self.kernel(name)?;
        self.scratch.focal.bind(&mut k, "focal")?;
        self.batch.data.bind(&mut k, "data")?;
        self.batch.weight.bind(&mut k, "weight")?.buffer("slot", &self.batch.slot)?;
        k.int("pairs", self.shape.pairs)?.int("pairs_per_strip", self.cut.pairs_per_strip)?;
        k.int("span", self.shape.span)?;
        Ok(k)
    }

    fn photometry_sums(&self) -> Result<Kernel> {
        let mut k = self.pixels("photometry_sums")?;
        self.scratch.sums.bind(&mut k, "sums")?;
        Ok(k)
    }

    fn photometry_solve(&self) -> Result<Kernel> {
        let mut k = self.kernel("photometry_solve")?;
        self.scratch.sums.bind(&mut k, "sums")?.int("partials", self.partials())?;
        self.scratch.photometry.bind(&mut k, "photometry")?;
        self.batch.known.bind(&mut k, "known")?.buffer("kind", &self.batch.kind)?.buffer("slot", &self.batch.slot)?;
        Ok(k)
    }

    fn residuals(&self) -> Result<Kernel> {
        let mut k = self.pixels("residuals")?;
        self.scratch.objective.bind(&mut k, "objective")?;
        self.scratch.photometry.bind(&mut k, "photometry")?;
        Ok(k)
    }

    /// The kernels from the field to the projection on segments in one.
    fn focus(&self) -> Result<Kernel> {
        let (scene, scratch, batch, shape) = (self.scene, self.scratch, self.batch, self.shape);
        let mut k = self.kernel(if shape.fft.is_some() { "focus_fft" } else { "focus" })?;
        let transform: &[(&str, &Reals)] = if shape.fft.is_some() {
            &[("twiddle", &scene.twiddle), ("line", &scratch.line), ("side", &scratch.side)]
        } else {
            &[
                ("y_to_v", &scene.y_to_v),
                ("x_to_u", &scene.x_to_u),
                ("u_to_x", &scene.u_to_x),
                ("v_to_y", &scene.v_to_y),
            ]
        };
        for &(argument, reals) in transform {
            reals.bind(&mut k, argument)?;
        }
        for (argument, reals) in [
            ("psi", &scratch.psi),
            ("phasor", &scratch.phasor),
            ("lit_field", &scratch.lit_field),
            ("segment_sum", &scratch.segment_sum),
            ("field", &scratch.field),
            ("wave", &scratch.wave),
            ("focal", &scratch.focal),
            ("sums", &scratch.sums),
            ("objective", &scratch.objective),
            ("photometry", &scratch.photometry),
            ("data", &batch.data),
            ("weight", &batch.weight),
            ("known", &batch.known),
        ] {
            reals.bind(&mut k, argument)?;
        }
        self.poses(&mut k)?;
        k.buffer("place", &scene.place)?.int("blocks", self.counts.blocks)?;
        k.buffer("entry_start", &scene.entry_start)?.buffer("entry_segment", &scene.entry_segment)?;
        k.buffer("segment_start", &scene.segment_start)?.buffer("segment_entry", &scene.segment_entry)?;
        k.buffer("entry_place", &scene.entry_place)?;
        k.buffer("extent", &scene.extent)?.buffer("slot", &batch.slot)?.buffer("kind", &batch.kind)?;
        k.buffer("next", &batch.next)?;
        k.int("width", shape.width)?;
        if shape.fft.is_some() {
            k.int("side_rows", shape.side_rows())?;
        } else {
            k.int("rows", shape.rows)?.int("pairs", shape.pairs)?.int("span", shape.span)?;
            k.int("pairs_per_strip", self.cut.pairs_per_strip)?.int("strips", self.counts.strips)?;
        }
        Ok(k)
    }

    fn partials(&self) -> usize {
        self.counts.strips * self.cut.lanes
    }

    fn pupil_gradient(&self) -> Result<Kernel> {
        self.pupil("pupil_gradient")
    }

    fn project_segments(&self) -> Result<Kernel> {
        let (scene, mut k) = (self.scene, self.kernel("project_segments")?);
        self.scratch.phasor.bind(&mut k, "phasor")?.int("blocks", self.counts.blocks)?;
        self.poses(&mut k)?;
        k.buffer("segment_start", &scene.segment_start)?.buffer("segment_entry", &scene.segment_entry)?;
        k.buffer("entry_place", &scene.entry_place)?;
        self.scratch.segment_sum.bind(&mut k, "segment_sum")?;
        Ok(k)
    }

    fn project_modes(&self) -> Result<Kernel> {
        let mut k = self.kernel("project_modes")?;
        self.basis(&mut k)?;
        self.scratch.psi.bind(&mut k, "psi")?;
        self.scratch.mode_partial.bind(&mut k, "mode_partial")?;
        k.int("blocks", self.counts.blocks)?.int("groups", self.counts.mode_groups)?;
        k.int("blocks_per_chunk", self.cut.blocks_per_chunk)?;
        Ok(k)
    }

    fn collect(&self, twice_wavenumber: f64) -> Result<Kernel> {
        let (counts, scratch, mut k) = (self.counts, self.scratch, self.kernel("collect")?);
        scratch.mode_partial.bind(&mut k, "mode_partial")?;
        scratch.segment_sum.bind(&mut k, "segment_sum")?;
        scratch.objective.bind(&mut k, "objective")?;
        scratch.photometry.bind(&mut k, "photometry")?;
        self.batch.result.bind(&mut k, "result")?;
        k.int("stands", counts.segments * counts.poses)?.int("smooth", counts.smooth)?;
        k.int("padded_modes", counts.mode_groups * MODES_AT_ONCE)?.int("chunks", counts.chunks)?;
        k.int("partials", self.partials())?.real("twice_wavenumber", twice_wavenumber)?;
        Ok(k)
    }

    fn kernels(&self, twice_wavenumber: f64) -> Result<Kernels> {
        Ok(Kernels {
            smooth_phase: self.smooth_phase()?,
            add_free: self.free("add_free")?,
            take_free: self.free("take_free")?,
            pupil_field: self.pupil_field()?,
            forward_columns: self.columns("forward_columns")?,
            forward_rows: self.rows("forward_rows")?,
            photometry_sums: self.photometry_sums()?,
            photometry_solve: self.photometry_solve()?,
            residuals: self.residuals()?,
            focus: self.focus()?,
            adjoint_rows: self.rows("adjoint_rows")?,
            adjoint_columns: self.columns("adjoint_columns")?,
            pupil_gradient: self.pupil_gradient()?,
            project_modes: self.project_modes()?,
            project_segments: self.project_segments()?,
            collect: self.collect(twice_wavenumber)?,
        })
    }
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
