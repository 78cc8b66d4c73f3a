//! One layer: the stretch of its ribbon that the wind carries over the pupil.
//!
//! The ribbon is extruded along the axis with the larger wind component, towards where the wind comes from, and kept in
//! a ring of rows (extruded along y) or of columns (along x, mirrored so that a window never wraps). The other component
//! moves the window across the ribbon. A row lives for about one window's length of motion along, during which the
//! window moves no further across: so only that much of the period is kept of it.

use super::ribbon::{BLOCK, Ribbon};
use crate::ao::LANES;

/// The present place of a window in the layer's memory.
pub(super) struct View<'a> {
    pub(super) values: &'a [f32],
    /// Where each of the rows 0..=samples of the window begins in `values`.
    pub(super) starts: &'a [usize],
    /// Fractions of a sample by which the window lies beyond its samples.
    pub(super) shift_x: f32,
    pub(super) shift_y: f32,
}

pub(super) struct Layer {
    ribbon: Ribbon,
    amplitude: f32,
    /// Extruded along x rather than y.
    along_x: bool,
    /// Motion of the window along and across the ribbon, samples per frame.
    step: [f64; 2],
    /// Samples of the window.
    samples: usize,
    /// Rows after which nothing of a ribbon is remembered.
    memory: i64,
    /// Rows in the ring, a multiple of [`BLOCK`].
    ring: usize,
    /// Positions across that are kept of each row.
    kept: usize,
    /// Furthest motion across in a row's life, samples, with its sign.
    drift: i64,
    /// Values from one row of the memory to the next.
    pitch: usize,
    values: Vec<f32>,
    /// First position across that is kept of each block in the ring.
    bases: Vec<i64>,
    /// The last block made.
    edge: i64,
    /// The rows of a block, for a transposition, `[row][kept]`.
    block: Vec<f32>,
    starts: Vec<usize>,
    shift: [f32; 2],
}

/// Positions, in samples, that leave room for arithmetic on 64-bit integers; no night is that long.
const FURTHEST: f64 = 1e18;

impl Layer {
    /// A layer of `samples` × `samples` points in rows of `stride`, each `amplitude` times the ribbon; the turbulence
    /// moves `velocity` = (x, y) samples per frame. A ribbon is forgotten after `memory` rows.
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
        // Wherever a window of samples + 1 rows begins in a block.
        let ring = (samples + BLOCK).next_multiple_of(BLOCK);
        let slant = if step[0] == 0.0 { 0.0 } else { step[1].abs() / step[0].abs() };
        let drift = ((ring + 1) as f64 * slant).ceil() as usize + 1;
        let kept = (stride + 2 + drift).next_multiple_of(LANES);
        // One vector more than the mirrored ring: rows a power of two apart would share the cache's ways.
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

    /// Moves the window to frame `frame`, not before the last.
    pub(super) fn seek(&mut self, frame: u64) {
        let position = self.step.map(|step| (frame as f64 * step).clamp(-FURTHEST, FURTHEST));
        let [along, across] = position.map(|x| x.floor() as i64);
        self.shift = [0, 1].map(|i| (position[i] - position[i].floor()) as f32);
        self.extrude(along, across);
        self.place(along, across);
    }

    /// Makes what the window lacks along the ribbon.
    fn extrude(&mut self, along: i64, across: i64) {
        let block = BLOCK as i64;
        let (first, last) = (along.div_euclid(block), (along + self.samples as i64).div_euclid(block));
        // Blocks ahead of the window, in the direction of motion.
        let (ahead, behind, onwards) = if self.step[0] < 0.0 { (first, last, -1) } else { (last, first, 1) };
        // More than the ribbon remembers lies unseen between the last block and the window: a new draw starts before it.
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

    /// Keeps of the block made last what a window now at `across` can still meet.
    fn store(&mut self, across: i64) {
        let slot = self.edge.rem_euclid((self.ring / BLOCK) as i64) as usize;
        let base = across + self.drift.min(0);
        self.bases[slot] = base;
        let period = self.ribbon.law().period();
        let first = base.rem_euclid(period as i64) as usize;
        // Against the direction of y or x, the rows come last to first.
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

    /// Puts the block into columns, twice. The row of a position across is the position modulo what is kept.
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

    /// Notes where the rows of the window begin.
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

    pub(super) fn view(&self) -> View<'_> {
        let [along, across] = self.shift;
        let (shift_x, shift_y) = if self.along_x { (along, across) } else { (across, along) };
        View { values: &self.values, starts: &self.starts, shift_x, shift_y }
    }
}
