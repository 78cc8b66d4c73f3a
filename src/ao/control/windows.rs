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
//! Slopes are spread over the map, so that a window is a few contiguous rows; lenslets that are not in use hold 0. Sums have an order
//! that does not depend on the length of the processor's vectors.

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
    /// Windows of the matrix with `rows`, x and then y of `subapertures`, flat indices on a map of `across` lenslets a side.
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

    /// Rows of an actuator's window on each axis: place in the map, place in the values.
    #[inline(always)]
    fn rows(&self, actuator: usize) -> impl Iterator<Item = (usize, usize)> + use<> {
        let (height, width, stride, plane) = (self.height, self.width, self.stride, self.plane);
        let (origin, first) = (self.origins[actuator] as usize, 2 * actuator * height * width);
        (0..2 * height).map(move |row| (row / height * plane + origin + row % height * stride, first + row * width))
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

    #[inline(always)]
    fn call(self) {
        let Self { windows, map, out } = self;
        let width = windows.width;
        for (actuator, out) in out.iter_mut().enumerate().take(windows.origins.len()) {
            let mut sums = [0.0f32; WIDE];
            for (place, first) in windows.rows(actuator) {
                let slopes = map[place..][..width].as_chunks::<WIDE>().0;
                let values = windows.values[first..][..width].as_chunks::<WIDE>().0;
                for (slopes, values) in slopes.iter().zip(values) {
                    for lane in 0..WIDE {
                        sums[lane] = values[lane].mul_add(slopes[lane], sums[lane]);
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
        let width = windows.width;
        for (actuator, &command) in commands.iter().enumerate() {
            for (place, first) in windows.rows(actuator) {
                let slopes = map[place..][..width].as_chunks_mut::<WIDE>().0;
                let values = windows.values[first..][..width].as_chunks::<WIDE>().0;
                for (slopes, values) in slopes.iter_mut().zip(values) {
                    for lane in 0..WIDE {
                        slopes[lane] = values[lane].mul_add(command, slopes[lane]);
                    }
                }
            }
        }
    }
}
