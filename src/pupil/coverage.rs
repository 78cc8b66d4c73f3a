//! Exact fraction of each grid cell that is covered by the mirror.

use super::aperture::{Aperture, SegmentShape};
use super::polygon::Polygon;
use super::sampled::Pupil;
use crate::grid::Grid;
use crate::{Error, Result};
use ndarray::Array2;
use rayon::prelude::*;

/// Smaller fractions are rounding errors of the subtraction of shadows.
const ROUNDING: f64 = 1e-12;

impl Aperture {
    /// The mirror on a grid: the amplitude is the exact illuminated fraction of each cell. A cell
    /// belongs to the segment at its centre; an illuminated cell whose centre is in a gap or beyond
    /// the edge belongs to the segment that covers most of it.
    ///
    /// # Errors
    /// [`Error::Value`] for a grid narrower than the mirror.
    pub fn pupil(&self, grid: &Grid) -> Result<Pupil> {
        let shares = self.shares(grid)?;
        let samples = grid.samples();
        let mut amplitude = vec![0.0f64; samples * samples];
        let mut owner = vec![-1; samples * samples];
        let mut largest = vec![0.0f64; samples * samples];
        for (segment, entries) in shares.iter().enumerate() {
            let outline = &self.shapes()[segment].outline;
            for &(cell, share) in entries {
                let cell = cell as usize;
                let centre = [grid.coordinate_m(cell % samples), grid.coordinate_m(cell / samples)];
                // The segment at the centre has priority over any fraction.
                let priority = if outline.contains(centre) { 2.0 } else { share };
                if priority > largest[cell] {
                    largest[cell] = priority;
                    owner[cell] = segment as i32;
                }
                amplitude[cell] = (amplitude[cell] + share).min(1.0);
            }
        }
        Ok(Pupil {
            grid: *grid,
            amplitude: Array2::from_shape_fn((samples, samples), |(y, x)| amplitude[y * samples + x]),
            owner: Array2::from_shape_fn((samples, samples), |(y, x)| owner[y * samples + x]),
            segments: self.segments().to_vec(),
        })
    }

    /// Fraction of each cell that each segment covers: per segment, `(y·samples + x, fraction)` in
    /// ascending order.
    pub(crate) fn shares(&self, grid: &Grid) -> Result<Vec<Vec<(u32, f64)>>> {
        self.check_width(grid)?;
        Ok(self.shapes().par_iter().map(|shape| shape_shares(shape, grid)).collect())
    }

    /// Checks that the grid encloses the mirror, within rounding.
    pub(crate) fn check_width(&self, grid: &Grid) -> Result<()> {
        let (mirror, width) = (self.width_m(), grid.width_m());
        if mirror <= width * (1.0 + 1e-12) {
            return Ok(());
        }
        Err(Error::Value(format!(
            "a grid {width} m wide is narrower than the mirror: at least {mirror:.4} m is needed"
        )))
    }
}

fn shape_shares(shape: &SegmentShape, grid: &Grid) -> Vec<(u32, f64)> {
    let samples = grid.samples();
    let (columns, rows) = (cells(shape.range(0), grid), cells(shape.range(1), grid));
    let mut share = vec![0.0; columns.len() * rows.len()];
    for (sign, piece) in &shape.pieces {
        for (line, y) in share.chunks_exact_mut(columns.len()).zip(rows.clone()) {
            let strip = piece.clip_band(1, edge(y, grid), edge(y + 1, grid));
            add_strip(&strip, *sign, y, columns.start, grid, line);
        }
    }
    let index = |i: usize| ((rows.start + i / columns.len()) * samples + columns.start + i % columns.len()) as u32;
    share.iter().enumerate().filter(|(_, share)| **share > ROUNDING).map(|(i, &share)| (index(i), share)).collect()
}

/// Adds the fractions of one row of cells. A strip of a convex polygon covers every cell between
/// its innermost borders completely; only the few cells at the borders are clipped.
fn add_strip(strip: &Polygon, sign: f64, y: usize, first: usize, grid: &Grid, line: &mut [f64]) {
    let full = full_range(strip, y, grid);
    let area = grid.pitch_m().powi(2);
    for x in cells(strip.range(0), grid) {
        let (left, right) = (edge(x, grid), edge(x + 1, grid));
        let covered =
            if full.0 <= left && right <= full.1 { 1.0 } else { strip.clip_band(0, left, right).area() / area };
        line[x - first] += sign * covered;
    }
}

/// The abscissae between which the strip spans its row from bottom to top; an empty range where it
/// does not.
fn full_range(strip: &Polygon, y: usize, grid: &Grid) -> (f64, f64) {
    let border = |at: f64| {
        let on = strip.0.iter().filter(|p| p[1] == at).map(|p| p[0]);
        on.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)))
    };
    let (bottom, top) = (border(edge(y, grid)), border(edge(y + 1, grid)));
    (bottom.0.max(top.0), bottom.1.min(top.1))
}

/// Left (or lower) edge of cell `j`, m.
fn edge(j: usize, grid: &Grid) -> f64 {
    (j as f64 - grid.samples() as f64 / 2.0) * grid.pitch_m()
}

/// The cells that a range of coordinates overlaps: at least one, possibly one more by rounding;
/// none for an empty range.
fn cells((low, high): (f64, f64), grid: &Grid) -> std::ops::Range<usize> {
    if low > high {
        return 0..0;
    }
    let samples = grid.samples();
    let position = |x: f64| (x / grid.pitch_m() + samples as f64 / 2.0).clamp(0.0, samples as f64);
    let first = (position(low).floor() as usize).min(samples - 1);
    first..(position(high).ceil() as usize).max(first + 1)
}
