//! The kernels of the chain, with the arguments bound that do not change between launches.

mod focus;

use super::colours::{ColourBuffers, PerColour};
use super::fold::{Blocks, FoldedShape, MODES_AT_ONCE, TALL};
use super::layout::GpuLayout;
use super::memory::{BatchBuffers, Counts, ModelBuffers, Partition, ScratchBuffers};
use crate::Result;
use crate::device::{Build, Device, Kernel, Reals};

/// The kernels between the coefficients and the phase, which all wavelengths share, and those of
/// its adjoint.
pub(super) struct PhaseKernels {
    pub(super) smooth_phase: Kernel,
    pub(super) add_free_phase: Kernel,
    pub(super) project_modes: Kernel,
    pub(super) free_phase_gradient: Kernel,
    pub(super) collect: Kernel,
}

/// The kernels of one wavelength.
pub(super) struct ColourKernels {
    pub(super) pupil_field: Kernel,
    pub(super) forward_columns: Kernel,
    pub(super) forward_rows: Kernel,
    pub(super) add_intensity: Kernel,
    pub(super) scale_field: Kernel,
    pub(super) adjoint_rows: Kernel,
    pub(super) adjoint_columns: Kernel,
    pub(super) pupil_gradient: Kernel,
    pub(super) project_segments: Kernel,
}

/// The kernels from the field, or from the stored intensity, to its residuals.
pub(super) struct PixelKernels {
    pub(super) sums: Kernel,
    pub(super) photometry_solve: Kernel,
    pub(super) residuals: Kernel,
    /// The convolution with the response of the pixels, along rows and then along columns.
    pub(super) convolve: [Kernel; 2],
    /// The kernel of `focus.cl` or of `fft.cl`.
    pub(super) focus: Kernel,
}

/// The buffers and sizes that arguments are bound to.
#[derive(Clone, Copy)]
pub(super) struct Bindings<'a> {
    pub(super) device: &'a Device,
    pub(super) build: Build,
    pub(super) layout: &'a GpuLayout,
    pub(super) shape: &'a FoldedShape,
    pub(super) partition: &'a Partition,
    pub(super) counts: &'a Counts,
    pub(super) blocks: &'a Blocks,
    pub(super) model: &'a ModelBuffers,
    pub(super) colours: &'a ColourBuffers,
    /// Index of the wavelength that kernels of one wavelength are bound to.
    pub(super) colour: usize,
    pub(super) batch: &'a BatchBuffers,
    pub(super) scratch: &'a ScratchBuffers,
}

impl Bindings<'_> {
    fn kernel(&self, name: &'static str) -> Result<Kernel> {
        self.device.kernel(name, self.build)
    }

    /// The array of this wavelength.
    fn own<'a>(&self, array: &'a PerColour) -> &'a Reals {
        &array.parts[self.colour]
    }

    /// A kernel over blocks of the pupil, with the arguments that those have in common.
    fn pupil(&self, name: &'static str) -> Result<Kernel> {
        let mut k = self.kernel(name)?;
        self.own(&self.colours.phasor).bind(&mut k, "phasor")?;
        self.own(&self.colours.sample_field).bind(&mut k, "sample_field")?;
        k.real("scale", self.layout.phase_scale(self.colour))?;
        self.scratch.psi.bind(&mut k, "psi")?;
        self.scratch.field.bind(&mut k, "field")?;
        k.buffer("place", &self.model.place)?.int("blocks", self.counts.blocks)?;
        k.int("rows", self.shape.rows)?.int("width", self.shape.width)?;
        Ok(k)
    }

    fn smooth_phase(&self) -> Result<Kernel> {
        let mut k = self.kernel("smooth_phase")?;
        self.model.diversity.bind(&mut k, "diversity")?;
        self.batch.coefficients.bind(&mut k, "coefficients")?.int("modes", self.counts.smooth)?;
        self.scratch.psi.bind(&mut k, "psi")?.int("blocks", self.counts.blocks)?;
        self.basis(&mut k)?;
        Ok(k)
    }

    /// The kernels of the free phase: its addition to the phase, and the gradient by it.
    fn free(&self, name: &'static str) -> Result<Kernel> {
        let mut k = self.kernel(name)?;
        let scale = self.layout.free_wavelength_nm / self.layout.colours[0].wavelength_nm;
        self.scratch.psi.bind(&mut k, "psi")?;
        self.batch.free.bind(&mut k, "free")?;
        k.buffer("sample_place", &self.model.sample_place)?;
        k.int("samples", self.counts.free)?.int("blocks", self.counts.blocks)?;
        if name == "free_phase_gradient" {
            k.real("twice_turn", 2.0 * std::f64::consts::TAU * scale)?;
        } else {
            k.real("scale", scale)?;
        }
        Ok(k)
    }

    fn pupil_field(&self) -> Result<Kernel> {
        let (model, mut k) = (self.model, self.pupil("pupil_field")?);
        self.poses(&mut k, self.own(&self.colours.pose))?;
        self.own(&self.colours.excess).bind(&mut k, "excess")?;
        k.buffer("entry_start", &model.entry_start)?.buffer("entry_segment", &model.entry_segment)?;
        Ok(k)
    }

    /// Piston, tip and tilt of the segments, and the weights and coordinates of their entries.
    fn poses(&self, k: &mut Kernel, pose: &Reals) -> Result<()> {
        self.model.entry_weight.bind(k, "entry_weight")?;
        self.model.entry_x.bind(k, "entry_x")?;
        self.model.entry_y.bind(k, "entry_y")?;
        pose.bind(k, "pose")?.int("segments", self.counts.segments)?.int("poses", self.counts.poses)?;
        Ok(())
    }

    fn basis(&self, k: &mut Kernel) -> Result<()> {
        self.model.basis.bind(k, "basis")?.int("block_stride", self.blocks.block_stride)?;
        k.int("mode_stride", self.blocks.mode_stride)?.int("quadrant_stride", self.blocks.quadrant_stride)?;
        Ok(())
    }

    fn columns(&self, name: &'static str) -> Result<Kernel> {
        let mut k = self.kernel(name)?;
        let (table, outputs) = match name {
            "forward_columns" => (self.own(&self.colours.y_to_v), self.shape.pairs),
            _ => (self.own(&self.colours.v_to_y), self.shape.rows),
        };
        self.scratch.field.bind(&mut k, "field")?;
        self.scratch.wave.bind(&mut k, "wave")?;
        table.bind(&mut k, "table")?.buffer("extent", &self.model.extent)?;
        k.int("rows", self.shape.rows)?.int("pairs", self.shape.pairs)?;
        k.int("groups", outputs.div_ceil(TALL))?.int("width", self.shape.width)?;
        Ok(k)
    }

    fn rows(&self, name: &'static str) -> Result<Kernel> {
        let (shape, mut k) = (self.shape, self.kernel(name)?);
        if name == "forward_rows" {
            self.own(&self.colours.x_to_u).bind(&mut k, "table")?.int("inputs", shape.rows)?;
            k.int("in_width", shape.width)?.int("span", shape.span)?;
        } else {
            self.own(&self.colours.u_to_x).bind(&mut k, "table")?.int("inputs", shape.pairs)?;
            k.int("in_width", shape.span)?.int("width", shape.width)?;
        }
        self.scratch.wave.bind(&mut k, "wave")?;
        self.own(&self.colours.focal).bind(&mut k, "focal")?;
        k.int("pairs", shape.pairs)?.int("pairs_per_item", self.partition.pairs_per_item)?;
        Ok(k)
    }

    /// A kernel over pixels, with the arguments that those have in common.
    fn pixels(&self, name: &'static str) -> Result<Kernel> {
        let mut k = self.strips(name)?;
        if self.counts.stored_pixels == 0 {
            self.own(&self.colours.focal).bind(&mut k, "focal")?;
        } else {
            self.scratch.intensity.bind(&mut k, "intensity")?;
        }
        self.batch.data.bind(&mut k, "data")?;
        self.batch.weight.bind(&mut k, "weight")?.buffer("slot", &self.batch.slot)?;
        Ok(k)
    }

    /// A kernel over strips of pixels.
    fn strips(&self, name: &'static str) -> Result<Kernel> {
        let mut k = self.kernel(name)?;
        k.int("pairs", self.shape.pairs)?.int("pairs_per_strip", self.partition.pairs_per_strip)?;
        k.int("span", self.shape.span)?;
        Ok(k)
    }

    /// The kernels between the field of a wavelength and the stored intensity.
    fn intensity(&self, name: &'static str) -> Result<Kernel> {
        let mut k = self.strips(name)?;
        self.own(&self.colours.focal).bind(&mut k, "focal")?;
        self.scratch.intensity.bind(&mut k, "intensity")?;
        Ok(k)
    }

    /// One axis of the convolution: along rows from the intensity, along columns back into it.
    fn convolve(&self, name: &'static str, from: &Reals, into: &Reals) -> Result<Kernel> {
        let mut k = self.strips(name)?;
        from.bind(&mut k, "in")?;
        into.bind(&mut k, "out")?;
        self.model.terms.bind(&mut k, "terms")?.int("reach", self.counts.terms.saturating_sub(1))?;
        Ok(k)
    }

    fn sums(&self) -> Result<Kernel> {
        let stored = self.counts.stored_pixels > 0;
        let mut k = self.pixels(if stored { "intensity_sums" } else { "photometry_sums" })?;
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
        let stored = self.counts.stored_pixels > 0;
        let mut k = self.pixels(if stored { "intensity_residuals" } else { "residuals" })?;
        self.scratch.objective.bind(&mut k, "objective")?;
        self.scratch.photometry.bind(&mut k, "photometry")?;
        Ok(k)
    }

    fn partials(&self) -> usize {
        self.counts.strips * self.partition.lanes
    }

    fn add_intensity(&self) -> Result<Kernel> {
        let mut k = self.intensity("add_intensity")?;
        k.int("is_first", usize::from(self.colour == 0))?;
        Ok(k)
    }

    fn pupil_gradient(&self) -> Result<Kernel> {
        let mut k = self.pupil("pupil_gradient")?;
        k.int("is_first", usize::from(self.colour == 0))?;
        Ok(k)
    }

    fn project_segments(&self) -> Result<Kernel> {
        let (model, mut k) = (self.model, self.kernel("project_segments")?);
        self.own(&self.colours.phasor).bind(&mut k, "phasor")?.int("blocks", self.counts.blocks)?;
        self.poses(&mut k, self.own(&self.colours.pose))?;
        k.real("scale", self.layout.phase_scale(self.colour))?.int("is_first", usize::from(self.colour == 0))?;
        k.buffer("segment_start", &model.segment_start)?.buffer("segment_entry", &model.segment_entry)?;
        k.buffer("entry_place", &model.entry_place)?;
        self.scratch.segment_sum.bind(&mut k, "segment_sum")?;
        Ok(k)
    }

    fn project_modes(&self) -> Result<Kernel> {
        let mut k = self.kernel("project_modes")?;
        self.basis(&mut k)?;
        self.scratch.psi.bind(&mut k, "psi")?;
        self.scratch.mode_partial.bind(&mut k, "mode_partial")?;
        k.int("blocks", self.counts.blocks)?
            .int("groups", self.counts.mode_groups)?
            .int("chunks", self.counts.chunks)?;
        k.int("blocks_per_chunk", self.partition.blocks_per_chunk)?;
        Ok(k)
    }

    fn collect(&self) -> Result<Kernel> {
        let (counts, scratch, mut k) = (self.counts, self.scratch, self.kernel("collect")?);
        let twice_wavenumber = 2.0 * std::f64::consts::TAU / self.layout.colours[0].wavelength_nm;
        scratch.mode_partial.bind(&mut k, "mode_partial")?;
        scratch.segment_sum.bind(&mut k, "segment_sum")?;
        scratch.objective.bind(&mut k, "objective")?;
        scratch.photometry.bind(&mut k, "photometry")?;
        self.batch.result.bind(&mut k, "result")?;
        k.int("pose_outputs", counts.segments * counts.poses)?.int("smooth", counts.smooth)?;
        k.int("padded_modes", counts.mode_groups * MODES_AT_ONCE)?.int("chunks", counts.chunks)?;
        k.int("partials", self.partials())?.real("twice_wavenumber", twice_wavenumber)?;
        Ok(k)
    }

    /// The kernels of pixels.
    pub(super) fn pixel_kernels(&self) -> Result<PixelKernels> {
        let (intensity, convolved) = (&self.scratch.intensity, &self.scratch.convolved);
        Ok(PixelKernels {
            sums: self.sums()?,
            photometry_solve: self.photometry_solve()?,
            residuals: self.residuals()?,
            convolve: [
                self.convolve("convolve_rows", intensity, convolved)?,
                self.convolve("convolve_columns", convolved, intensity)?,
            ],
            focus: self.focus()?,
        })
    }

    /// The kernels of the phase.
    pub(super) fn phase_kernels(&self) -> Result<PhaseKernels> {
        Ok(PhaseKernels {
            smooth_phase: self.smooth_phase()?,
            add_free_phase: self.free("add_free_phase")?,
            project_modes: self.project_modes()?,
            free_phase_gradient: self.free("free_phase_gradient")?,
            collect: self.collect()?,
        })
    }

    /// The kernels of this wavelength.
    pub(super) fn colour_kernels(&self) -> Result<ColourKernels> {
        Ok(ColourKernels {
            pupil_field: self.pupil_field()?,
            forward_columns: self.columns("forward_columns")?,
            forward_rows: self.rows("forward_rows")?,
            add_intensity: self.add_intensity()?,
            scale_field: self.intensity("scale_field")?,
            adjoint_rows: self.rows("adjoint_rows")?,
            adjoint_columns: self.columns("adjoint_columns")?,
            pupil_gradient: self.pupil_gradient()?,
            project_segments: self.project_segments()?,
        })
    }
}
