//! Turbulent layer: the part of its ribbon that the wind moves over the pupil.
//!
//! The ribbon is extruded along the axis with the larger wind component, towards the wind's origin.
//! It is kept in a ring of rows (extruded along y) or of columns (extruded along x, stored twice so
//! that a window never wraps). The smaller wind component moves the window across the ribbon. A row
//! stays in use while the window moves by about its own length along the ribbon; the window moves
//! by no more than that across, so only this part of the period is kept.

use super::ribbon::{BLOCK, Ribbon};
use crate::ao::footprint::LANES;

/// Position of the window over the pupil in the layer's memory.
pub(super) struct Window<'a> {
    pub(super) values: &'a [f32],
    /// Start of each of the rows 0..=samples of the window in `values`.
    pub(super) starts: &'a [usize],
    /// Fractional part of the window's position, samples.
    pub(super) shift_x: f32,
    pub(super) shift_y: f32,
}

/// Layer with its ribbon and the rows of it that are in use.
pub(super) struct Layer {
    ribbon: Ribbon,
    amplitude: f32,
    /// Whether the ribbon is extruded along x rather than y.
    along_x: bool,
    /// Motion of the window along and across the ribbon, samples per frame.
    step: [f64; 2],
    /// Samples along a side of the window.
    samples: usize,
    /// Rows after which the ribbon is independent of its past.
    memory: i64,
    /// Rows in the ring, a multiple of [`BLOCK`].
    ring: usize,
    /// Positions across that are kept of each row.
    kept: usize,
    /// Largest motion across while a row is in use, samples, with its sign.
    drift: i64,
    /// Values from one row of the memory to the next.
    pitch: usize,
    values: Vec<f32>,
    /// First position across that is kept of each block in the ring.
    bases: Vec<i64>,
    /// Number of the last block made.
    edge: i64,
    /// Rows of a block before their transposition, `[row][kept]`.
    block: Vec<f32>,
    starts: Vec<usize>,
    shift: [f32; 2],
}

/// Largest position, samples: leaves room for arithmetic on 64-bit integers, and is beyond any run.
const FURTHEST: f64 = 1e18;

impl Layer {
    /// Layer of `samples` × `samples` points in rows of `stride`, `amplitude` times the ribbon. The
    /// turbulence moves by `velocity` = (x, y) samples per frame. The ribbon is independent of its
    /// past after `memory` rows.
    pub(super) fn new(
        ribbon: Ribbon,
        amplitude: f32,
        velocity: [f64; 2],
        samples: usize,
        stride: usize,
        memory: i64,
    ) -> Self {
        // φ(r, t) = φ(r − vt, 0): the window moves against the wind.
        let [x, y] = velocity.map(|v| -v);
        let along_x = x.abs() >= y.abs();
        let step = if along_x { [x, y] } else { [y, x] };
        // Holds a window of samples + 1 rows that begins anywhere in a block.
        let ring = (samples + BLOCK).next_multiple_of(BLOCK);
        let slant = if step[0] == 0.0 { 0.0 } else { step[1].abs() / step[0].abs() };
        let drift = ((ring + 1) as f64 * slant).ceil() as usize + 1;
        let kept = (stride + 2 + drift).next_multiple_of(LANES);
        // One vector more than the ring stored twice: rows a power of two apart would conflict in
        // the cache.
        let (rows, pitch) = if along_x { (kept, 2 * ring + LANES) } else { (ring, kept) };
        let mut layer = Self {
            ribbon,
            amplitude,
            along_x,
            step,
            samples,
            memory,
            ring,
            kept,
            drift: if step[1] < 0.0 { -(drift as i64) } else { drift as i64 },
            pitch,
            values: vec![0.0; rows * pitch],
            bases: vec![0; ring / BLOCK],
            edge: if step[0] < 0.0 { ring as i64 / BLOCK as i64 } else { -1 },
            block: vec![0.0; BLOCK * kept],
            starts: vec![0; samples + 1],
            shift: [0.0; 2],
        };
        layer.seek(0);
        layer
    }

    /// Moves the window to `frame`, which is not before the last one.
    pub(super) fn seek(&mut self, frame: u64) {
        let position = self.step.map(|step| (frame as f64 * step).clamp(-FURTHEST, FURTHEST));
        let [along, across] = position.map(|x| x.floor() as i64);
        self.shift = [0, 1].map(|i| (position[i] - position[i].floor()) as f32);
        self.extrude(along, across);
        self.place(along, across);
    }

    /// Extends the ribbon to the end of the window.
    fn extrude(&mut self, along: i64, across: i64) {
        let block = BLOCK as i64;
        let (first, last) = (along.div_euclid(block), (along + self.samples as i64).div_euclid(block));
        // Blocks ahead of the window, in the direction of motion.
        let (ahead, behind, onwards) = if self.step[0] < 0.0 { (first, last, -1) } else { (last, first, 1) };
        // If the window is farther from the last block than the ribbon's memory, a new ribbon is
        // drawn in front of it.
        if (behind - self.edge) * onwards > self.memory / block + 1 {
            self.ribbon.restart();
            self.edge = behind - onwards;
        }
        while (ahead - self.edge) * onwards > 0 {
            self.edge += onwards;
            self.ribbon.extend();
            if (self.edge - behind) * onwards >= 0 {
                self.store(across);
            }
        }
    }

    /// Stores the part of the last block that a window at `across` can reach while the block is in
    /// use.
    fn store(&mut self, across: i64) {
        let slot = self.edge.rem_euclid((self.ring / BLOCK) as i64) as usize;
        let base = across + self.drift.min(0);
        self.bases[slot] = base;
        let period = self.ribbon.law().period();
        let first = base.rem_euclid(period as i64) as usize;
        // For motion in the negative direction the rows are stored in reverse order.
        let reverse = self.step[0] < 0.0;
        for pair in 0..BLOCK / 2 {
            let places = [0, 1].map(|i| if reverse { BLOCK - 1 - (2 * pair + i) } else { 2 * pair + i });
            let rows = self.ribbon.rows(pair);
            let (out, offset) =
                if self.along_x { (&mut self.block, 0) } else { (&mut self.values, slot * BLOCK * self.kept) };
            let out = &mut out[offset..][..BLOCK * self.kept];
            let mut done = 0;
            let mut from = first;
            while done < self.kept {
                let count = (self.kept - done).min(period - from);
                let piece = &rows[from..][..count];
                for (x, value) in out[places[0] * self.kept + done..].iter_mut().zip(piece) {
                    *x = self.amplitude * value.re;
                }
                for (x, value) in out[places[1] * self.kept + done..].iter_mut().zip(piece) {
                    *x = self.amplitude * value.im;
                }
                done += count;
                from = 0;
            }
        }
        if self.along_x {
            self.transpose(slot, base);
        }
    }

    /// Stores the block as columns, twice. The row of a position across is the position modulo
    /// `kept`.
    fn transpose(&mut self, slot: usize, base: i64) {
        let mut row = base.rem_euclid(self.kept as i64) as usize;
        for position in 0..self.kept {
            let column: [f32; BLOCK] = std::array::from_fn(|i| self.block[i * self.kept + position]);
            for place in [slot * BLOCK, slot * BLOCK + self.ring] {
                self.values[row * self.pitch + place..][..BLOCK].copy_from_slice(&column);
            }
            row = if row + 1 == self.kept { 0 } else { row + 1 };
        }
    }

    /// Updates the starts of the window's rows.
    fn place(&mut self, along: i64, across: i64) {
        let slot = along.rem_euclid(self.ring as i64) as usize;
        if self.along_x {
            let mut row = across.rem_euclid(self.kept as i64) as usize;
            for start in &mut self.starts {
                *start = row * self.pitch + slot;
                row = if row + 1 == self.kept { 0 } else { row + 1 };
            }
        } else {
            let mut row = slot;
            for start in &mut self.starts {
                *start = row * self.pitch + (across - self.bases[row / BLOCK]) as usize;
                row = if row + 1 == self.ring { 0 } else { row + 1 };
            }
        }
    }

    /// Present window.
    pub(super) fn window(&self) -> Window<'_> {
        let [along, across] = self.shift;
        let (shift_x, shift_y) = if self.along_x { (along, across) } else { (across, along) };
        Window { values: &self.values, starts: &self.starts, shift_x, shift_y }
    }
}
