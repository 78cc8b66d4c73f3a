//! Device memory that the chain takes, as a formula, and the tile size that follows from it. A test
//! compares the formula with the allocated bytes.
//!
//! `bytes = model + image · capacity + tile_image · tile + in_work · images in work`
//!
//! `model` is pupil, basis and tables; `image` data, weights, coefficients and results of one
//! image; `tile_image` the phase and partial sums of one image of a tile; `in_work` fields and
//! scratch memory of one image being transformed.

use super::colours::ColourSizes;
use super::fold::{Blocks, FoldedShape, GROUP, MODES_AT_ONCE};
use super::memory::{Counts, Partition, padded};
use crate::device::{Build, DeviceInfo, DeviceKind};
use crate::{Error, Result};

/// Bytes of each term of the formula.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct MemoryBudget {
    model: usize,
    image: usize,
    /// Per image of the capacity rounded up to whole groups.
    active: usize,
    tile_image: usize,
    in_work: usize,
}

impl MemoryBudget {
    pub fn new(
        build: Build,
        shape: &FoldedShape,
        blocks: &Blocks,
        (counts, sizes, partition): (&Counts, &ColourSizes, &Partition),
    ) -> Self {
        let (real, int) = (build.precision.bytes(), size_of::<i32>());
        let lists = [&blocks.place, &blocks.extent, &blocks.entry_start, &blocks.entry_segment, &blocks.entry_place]
            .into_iter()
            .chain([&blocks.segment_start, &blocks.segment_entry, &blocks.sample_place])
            .map(|list| list.len().max(1))
            .sum::<usize>();
        let arrays = [&blocks.basis, &blocks.entry_weight, &blocks.entry_x, &blocks.entry_y]
            .map(|array| array.len().max(1))
            .iter()
            .sum::<usize>();
        let (colours, quadrants) = (counts.colours, counts.blocks * 4 * shape.vector);
        let colour = sizes.tables.iter().sum::<usize>() + sizes.excess + 1;
        let [.., twiddle] = shape.table_sizes();
        let partials = counts.strips * partition.lanes;
        let convolved = if counts.terms > 0 { counts.stored_pixels } else { 0 };
        let fields = shape.side_rows().max(shape.rows) * 8 * shape.width + shape.pairs * 8 * shape.width;
        let focus = shape.fft_scratch().iter().sum::<usize>() + counts.stored_pixels + convolved;
        let modes = counts.chunks * counts.mode_groups * MODES_AT_ONCE;
        // A buffer of length 0 is allocated with length 1.
        let shared =
            [shape.fft_scratch()[0], shape.fft_scratch()[1], modes, counts.free, counts.stored_pixels, convolved];
        let empty = shared.iter().filter(|numbers| **numbers == 0).count();
        let empty = empty + usize::from(counts.smooth == 0);
        Self {
            model: (arrays + quadrants + colours * colour + twiddle.max(1) + (2 * counts.terms).max(1) + empty) * real
                + lists * int,
            image: (2 * shape.pixels() + 4) * real + int,
            active: (counts.smooth + colours * sizes.pose + counts.free + counts.outputs) * real + int + int / GROUP,
            tile_image: (quadrants + 4 * partials + 2 + counts.segments * counts.poses + modes) * real,
            in_work: (fields + focus + colours * (2 * sizes.phasor + sizes.focal)) * real,
        }
    }

    /// Bytes of a chain for `capacity` images with this partition.
    pub fn bytes(&self, capacity: usize, partition: &Partition) -> u64 {
        let parts = [
            self.model,
            self.image * capacity,
            self.active * padded(capacity),
            self.tile_image * partition.tile,
            self.in_work * partition.focal_tile,
        ];
        parts.iter().map(|&part| part as u64).sum()
    }

    /// `partition` with tiles reduced, where necessary, to fit `memory_bytes`.
    ///
    /// # Errors
    /// [`Error::Device`] where the smallest tile does not fit.
    pub fn fit(
        &self,
        partition: Partition,
        capacity: usize,
        info: &DeviceInfo,
        memory_bytes: u64,
    ) -> Result<Partition> {
        let with = |tile: usize| match partition.workers {
            Some(_) => Partition { tile, ..partition },
            None => Partition { tile, focal_tile: tile, group_items: tile / GROUP, ..partition },
        };
        let (least, wanted) = (self.bytes(capacity, &with(GROUP)), self.bytes(capacity, &partition));
        if least > memory_bytes {
            return Err(Error::Device(format!(
                "this model needs {least} bytes for {capacity} images, and {memory_bytes} are available on {}: load fewer \
                 images at a time, or use f32",
                info.address()
            )));
        }
        if wanted <= memory_bytes {
            return Ok(partition);
        }
        let group = self.bytes(capacity, &with(2 * GROUP)) - least;
        Ok(with(GROUP + (memory_bytes - least) as usize / group as usize * GROUP))
    }
}

/// Device memory that a chain may use, bytes: nine tenths of a GPU's; three quarters of a CPU's,
/// which is shared with all other programs.
pub(super) fn usable_memory_bytes(info: &DeviceInfo) -> u64 {
    match info.kind {
        DeviceKind::Cpu => info.memory_bytes / 4 * 3,
        DeviceKind::Gpu | DeviceKind::Accelerator => info.memory_bytes / 10 * 9,
    }
}
