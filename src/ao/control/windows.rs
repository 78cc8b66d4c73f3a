//! Local interaction matrix: each actuator moves the slopes of a small window of lenslets.
//!
//! ```text
//! map of lenslets, one for each axis        values of an actuator
//! . . . . . . . .                           [x: row 0 | row 1 | …][y: row 0 | row 1 | …]
//! . ┌───────┐ . .   origin: corner of       rows of `width` lenslets, a multiple of WIDE
//! . │   o   │ . .   the actuator's window
//! . └───────┘ . .
//! ```
//!
//! Slopes are spread over the map, so that a window is a few contiguous rows; lenslets that are not
//! in use hold 0. Sums have an order that does not depend on the length of the processor's vectors.

use crate::ao::aligned::AlignedBuffer;
use pulp::{Arch, NullaryFnOnce};

/// Values that are multiplied together: a row of a window is about as long.
const WIDE: usize = 8;

/// Entries of a row of the interaction matrix, `(actuator, value)`, actuators ascending.
pub(super) type SlopeRow = Vec<(u32, f64)>;

/// Interaction matrix in windows.
#[derive(Debug)]
pub(super) struct Windows {
    height: usize,
    width: usize,
    /// Lenslets from one row of the map to the next, and in the map of an axis.
    stride: usize,
    plane: usize,
    /// Place of each subaperture in the map of an axis.
    places: Vec<u32>,
    /// First lenslet of each actuator's window.
    origins: Vec<u32>,
    values: AlignedBuffer,
}

impl Windows {
    /// Windows of the matrix with `rows`, x and then y of `subapertures`, flat indices on a map of
    /// `across` lenslets a side.
    pub(super) fn new(across: usize, subapertures: &[usize], rows: &[SlopeRow], actuators: usize) -> Self {
        let count = subapertures.len();
        let place = |slope: usize| (subapertures[slope % count] / across, subapertures[slope % count] % across);
        // Smallest and largest row and column of each actuator's lenslets.
        let mut boxes = vec![[usize::MAX, 0, usize::MAX, 0]; actuators];
        let entries = || rows.iter().enumerate().flat_map(|(slope, row)| row.iter().map(move |entry| (slope, entry)));
        for (slope, &(actuator, _)) in entries() {
            let (y, x) = place(slope);
            let [y0, y1, x0, x1] = &mut boxes[actuator as usize];
            (*y0, *y1, *x0, *x1) = (y.min(*y0), y.max(*y1), x.min(*x0), x.max(*x1));
        }
        let used = || boxes.iter().filter(|edges| edges[0] != usize::MAX);
        let height = used().map(|edges| edges[1] + 1 - edges[0]).max().unwrap_or(1);
        let width = used().map(|edges| edges[3] + 1 - edges[2]).max().unwrap_or(1).next_multiple_of(WIDE);
        // Windows at the border reach beyond the lenslets.
        let stride = across + width;
        let corner = |edges: &[usize; 4]| if edges[0] == usize::MAX { (0, 0) } else { (edges[0], edges[2]) };
        let size = height * width;
        let mut values = AlignedBuffer::zeros(actuators * 2 * size);
        for (slope, &(actuator, value)) in entries() {
            let actuator = actuator as usize;
            let ((y, x), (y0, x0)) = (place(slope), corner(&boxes[actuator]));
            let axis = slope / count;
            values[(2 * actuator + axis) * size + (y - y0) * width + x - x0] = value as f32;
        }
        let at = |(y, x): (usize, usize)| (y * stride + x) as u32;
        Self {
            height,
            width,
            stride,
            plane: (across + height) * stride,
            places: (0..count).map(|slope| at(place(slope))).collect(),
            origins: boxes.iter().map(|edges| at(corner(edges))).collect(),
            values,
        }
    }

    /// Values of a map of both axes, for [`Windows::project`].
    pub(super) fn map(&self) -> Vec<f32> {
        vec![0.0; 2 * self.plane]
    }

    /// Bytes of the matrix.
    pub(super) fn bytes(&self) -> usize {
        size_of_val(&self.values[..])
    }

    /// Writes the slopes `[all x, all y]` onto `map`.
    pub(super) fn spread(&self, slopes: &[f32], map: &mut [f32]) {
        let (along_x, along_y) = map.split_at_mut(self.plane);
        let (slopes_x, slopes_y) = slopes.split_at(self.places.len());
        for ((&place, x), y) in self.places.iter().zip(slopes_x).zip(slopes_y) {
            (along_x[place as usize], along_y[place as usize]) = (*x, *y);
        }
    }

    /// Computes `Dᵀ·slopes` of the slopes on `map`, one number for each actuator.
    pub(super) fn project(&self, map: &[f32], out: &mut [f32]) {
        Arch::new().dispatch(Project { windows: self, map, out });
    }

    /// Adds the slopes of `commands` to those on `map`. Lenslets that are not in use keep 0.
    pub(super) fn add_response(&self, commands: &[f32], map: &mut [f32]) {
        Arch::new().dispatch(AddResponse { windows: self, commands, map });
    }
}

/// Kernel of [`Windows::project`].
struct Project<'a> {
    windows: &'a Windows,
    map: &'a [f32],
    out: &'a mut [f32],
}

impl NullaryFnOnce for Project<'_> {
    type Output = ();

    // As in `step`, sums are loaded and stored explicitly, so that the compiler keeps them in
    // registers.
    #[inline(always)]
    fn call(self) {
        let Self { windows, map, out } = self;
        let Windows { height, width, stride, plane, .. } = *windows;
        let (along_x, along_y) = map.split_at(plane);
        let windows = windows.values.chunks_exact(2 * height * width).zip(&windows.origins);
        for ((values, &origin), out) in windows.zip(out) {
            let mut sums = [0.0f32; WIDE];
            for (map, values) in [along_x, along_y].into_iter().zip(values.chunks_exact(height * width)) {
                let map = &map[origin as usize..];
                for (row, values) in values.chunks_exact(width).enumerate() {
                    let slopes = map[row * stride..][..width].as_chunks::<WIDE>().0;
                    for (slopes, values) in slopes.iter().zip(values.as_chunks::<WIDE>().0) {
                        let mut sum = sums;
                        for lane in 0..WIDE {
                            sum[lane] = values[lane].mul_add(slopes[lane], sum[lane]);
                        }
                        sums = sum;
                    }
                }
            }
            let [a, b, c, d, e, f, g, h] = sums;
            *out = ((a + e) + (c + g)) + ((b + f) + (d + h));
        }
    }
}

/// Kernel of [`Windows::add_response`].
struct AddResponse<'a> {
    windows: &'a Windows,
    commands: &'a [f32],
    map: &'a mut [f32],
}

impl NullaryFnOnce for AddResponse<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { windows, commands, map } = self;
        let Windows { height, width, stride, plane, .. } = *windows;
        let (along_x, along_y) = map.split_at_mut(plane);
        let windows = windows.values.chunks_exact(2 * height * width).zip(&windows.origins);
        for ((values, &origin), &command) in windows.zip(commands) {
            let (values_x, values_y) = values.split_at(height * width);
            for (map, values) in [(&mut *along_x, values_x), (&mut *along_y, values_y)] {
                let map = &mut map[origin as usize..];
                for (row, values) in values.chunks_exact(width).enumerate() {
                    let slopes = map[row * stride..][..width].as_chunks_mut::<WIDE>().0;
                    for (slopes, values) in slopes.iter_mut().zip(values.as_chunks::<WIDE>().0) {
                        for lane in 0..WIDE {
                            slopes[lane] = values[lane].mul_add(command, slopes[lane]);
                        }
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_hold_the_matrix() {
        // 5×5 lenslets without a corner and the middle, seven actuators with two to five lenslets
        // each; one moves none.
        let subapertures: Vec<usize> = (0..25).filter(|place| ![4, 12].contains(place)).collect();
        let (count, actuators) = (subapertures.len(), 7);
        let value = |slope: usize, actuator: usize| ((slope * 13 + actuator * 5) as f64).sin();
        let is_moved = |slope: usize, actuator: usize| actuator != 3 && (slope % count).abs_diff(3 * actuator) <= 2;
        let row = |slope: usize| {
            (0..actuators).filter(|&a| is_moved(slope, a)).map(|a| (a as u32, value(slope, a))).collect::<SlopeRow>()
        };
        let rows: Vec<SlopeRow> = (0..2 * count).map(row).collect();
        let windows = Windows::new(5, &subapertures, &rows, actuators);
        let slopes: Vec<f32> = (0..2 * count).map(|slope| (slope as f32 * 0.3).cos()).collect();
        let commands: Vec<f32> = (0..actuators).map(|actuator| (actuator as f32 + 0.5).sin()).collect();
        let mut map = windows.map();
        windows.spread(&slopes, &mut map);
        let mut projected = vec![f32::NAN; actuators];
        windows.project(&map, &mut projected);
        // At most ten terms below 1, each rounded to ε/2 = 6e-8.
        const ROUNDING: f64 = 1.2e-6;
        for (actuator, projected) in projected.iter().enumerate() {
            let moved = (0..2 * count).filter(|&slope| is_moved(slope, actuator));
            let sum: f64 = moved.map(|slope| value(slope, actuator) * f64::from(slopes[slope])).sum();
            assert!((f64::from(*projected) - sum).abs() < ROUNDING, "{actuator}: {projected} {sum}");
        }
        windows.add_response(&commands, &mut map);
        for (slope, row) in rows.iter().enumerate() {
            let response: f64 = row.iter().map(|&(a, value)| value * f64::from(commands[a as usize])).sum();
            let place = windows.places[slope % count] as usize + slope / count * windows.plane;
            let found = f64::from(map[place]);
            assert!((found - f64::from(slopes[slope]) - response).abs() < ROUNDING, "{slope}: {found}");
        }
    }
}
