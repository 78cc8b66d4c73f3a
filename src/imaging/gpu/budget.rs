//! How much of the device's memory the chain takes: a formula, held against what is really allocated by a test, and the
//! tile that follows from it.
//!
//! `bytes = scene + image · capacity + tile_image · tile + in_work · images in work`
//!
//! `scene` is pupil, basis and tables; `image` data, weights, coefficients and results of one image; `tile_image` what waits
//! between the matrix products over modes and the rest; `in_work` fields and scratch of an image that is being transformed.

use super::fold::{Blocks, GROUP, MODES_AT_ONCE, Shape};
use super::memory::{Counts, Cut, padded};
use crate::device::{Build, DeviceInfo, DeviceKind};
use crate::{Error, Result};

/// Bytes of each part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Room {
    scene: usize,
    image: usize,
    /// Of an image for which results have room: capacity in whole groups.
    active: usize,
    tile_image: usize,
    in_work: usize,
}

impl Room {
    pub fn new(build: Build, shape: &Shape, blocks: &Blocks, counts: &Counts, cut: &Cut) -> Self {
        let (real, int) = (build.precision.bytes(), size_of::<i32>());
        let lists = [&blocks.place, &blocks.extent, &blocks.entry_start, &blocks.entry_segment, &blocks.entry_place]
            .into_iter()
            .chain([&blocks.segment_start, &blocks.segment_entry, &blocks.lit_place])
            .map(|list| list.len().max(1))
            .sum::<usize>();
        let arrays = [&blocks.basis, &blocks.diversity, &blocks.entry_weight, &blocks.entry_x, &blocks.entry_y]
            .map(|array| array.len().max(1))
            .iter()
            .sum::<usize>();
        let tables = shape.table_sizes().map(|size| size.max(1)).iter().sum::<usize>();
        let partials = counts.strips * cut.lanes;
        let pupil = shape.side_rows().max(shape.rows) * 8 * shape.width + counts.blocks * 16 * shape.vector;
        let focus = shape.pairs * 8 * shape.width + shape.pixels() * 2 + shape.fft_scratch().iter().sum::<usize>();
        let modes = counts.chunks * counts.mode_groups * MODES_AT_ONCE;
        // A buffer of nothing is one of one number.
        let empty = [shape.fft_scratch()[0], shape.fft_scratch()[1], counts.smooth, modes, counts.free];
        let empty = empty.iter().filter(|numbers| **numbers == 0).count();
        Self {
            scene: (arrays + tables + empty) * real + lists * int,
            image: (2 * shape.pixels() + 4) * real + int,
            active: (counts.smooth + 4 * counts.segments + counts.free + counts.outputs) * real + int + int / GROUP,
            tile_image: (counts.blocks * 4 * shape.vector + 4 * partials + 2 + counts.segments * counts.poses + modes)
                * real,
            in_work: (pupil + focus) * real,
        }
    }

    /// Bytes of a chain for `capacity` images, cut as `cut` says.
    pub fn bytes(&self, capacity: usize, cut: &Cut) -> u64 {
        let parts = [
            self.scene,
            self.image * capacity,
            self.active * padded(capacity),
            self.tile_image * cut.tile,
            self.in_work * cut.focal_tile,
        ];
        parts.iter().map(|&part| part as u64).sum()
    }

    /// `cut` with tiles that fit `memory_bytes`: those it has, or smaller ones.
    ///
    /// # Errors
    /// [`Error::Device`] where not even the smallest tile fits.
    pub fn fit(&self, cut: Cut, capacity: usize, info: &DeviceInfo, memory_bytes: u64) -> Result<Cut> {
        let with = |tile: usize| match cut.workers {
            Some(_) => Cut { tile, ..cut },
            None => Cut { tile, focal_tile: tile, group_items: tile / GROUP, ..cut },
        };
        let (least, wanted) = (self.bytes(capacity, &with(GROUP)), self.bytes(capacity, &cut));
        if least > memory_bytes {
            return Err(Error::Device(format!(
                "this model with room for {capacity} images takes {least} bytes, and {} gives {memory_bytes}: load fewer \
                 images at a time, or use f32",
                info.address()
            )));
        }
        if wanted <= memory_bytes {
            return Ok(cut);
        }
        let group = self.bytes(capacity, &with(2 * GROUP)) - least;
        Ok(with(GROUP + (memory_bytes - least) as usize / group as usize * GROUP))
    }
}

/// What a chain may take of a device: most of a GPU's memory; of a processor's, which is everybody's, three quarters.
pub(super) fn memory_of(info: &DeviceInfo) -> u64 {
    match info.kind {
        DeviceKind::Cpu => info.memory_bytes / 4 * 3,
        DeviceKind::Gpu | DeviceKind::Accelerator => info.memory_bytes / 10 * 9,
    }
}
