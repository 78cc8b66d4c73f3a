//! Pyramid wavefront sensor: a four-sided pyramid in the focus with a circular modulation, four
//! images of the pupil, slopes.
//!
//! Behind the faces (u > 0, v > 0), (−, +), (+, −) and (−, −) a pixel has the intensities I₊₊, I₋₊,
//! I₊₋ and I₋₋. Its slopes are
//!
//! ```text
//! s_x = (I₊₊ + I₊₋ − I₋₊ − I₋₋) / n,    s_y = (I₊₊ + I₋₊ − I₊₋ − I₋₋) / n
//! ```
//!
//! with n the sum of its four intensities ("pixel"), or the mean of that sum over the pixels in use
//! ("global").

mod half_planes;
mod kernel;
mod modulation;
mod optics;
mod plane;

use super::lenslets::Lenslets;
use super::light::GuideStar;
use crate::ao::footprint::{Footprint, LANES};
use crate::scene::{SensorScene, SlopeNormalisation};
use kernel::Tile;
use modulation::Modulation;
use optics::PyramidOptics;

/// Signs of the faces along x and along y, in the order of the intensities.
const FACES: [[f64; 2]; 4] = [[1.0, 1.0], [-1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]];

/// Pyramid with its detector.
#[derive(Clone)]
pub(super) struct Pyramid {
    optics: PyramidOptics,
    pixels: Lenslets,
    normalisation: SlopeNormalisation,
    /// Sum and differences of the four intensities of each pixel in use: sum, along x, along y,
    /// relative to all light of a fully illuminated pixel, or in electrons.
    signals: Vec<[f64; 3]>,
}

impl Pyramid {
    /// Pyramid of `scene` behind the pupil of `footprint`. Its pixels are the subapertures of
    /// `pixels`.
    pub(super) fn new(scene: &SensorScene, pixels: &Lenslets, footprint: &Footprint) -> Self {
        let modulation = Modulation::new(scene.modulation_lambda_over_d.unwrap_or(0.0), scene.modulation_points);
        Self {
            optics: PyramidOptics::new(footprint, scene.wavelength_nm, modulation, tiles(pixels)),
            pixels: pixels.clone(),
            normalisation: scene.slope_normalisation.unwrap_or(SlopeNormalisation::Global),
            signals: vec![[0.0; 3]; pixels.subapertures.len()],
        }
    }

    /// Least operations of a frame.
    pub(super) fn operations(&self) -> f64 {
        self.optics.operations()
    }

    /// Measures slopes without a unit: x of all pixels in use, then y.
    pub(super) fn raw_slopes(&mut self, opd_nm: &[f32], light: Option<&mut GuideStar>, slopes: &mut [f32]) {
        self.optics.propagate(opd_nm);
        self.expose(light);
        let count = self.signals.len();
        let (along_x, along_y) = slopes.split_at_mut(count);
        let mean = self.signals.iter().map(|[sum, ..]| sum).sum::<f64>() / count as f64;
        for ((&[sum, x, y], slope_x), slope_y) in self.signals.iter().zip(along_x).zip(along_y) {
            let over = match self.normalisation {
                SlopeNormalisation::Global => mean,
                SlopeNormalisation::Pixel => sum,
            };
            // A sum that is not positive is noise, and its ratio is not usable.
            [*slope_x, *slope_y] = if over > 0.0 { [(x / over) as f32, (y / over) as f32] } else { [0.0; 2] };
        }
    }

    /// Signals of the pixels in use, with the noise of `light`.
    fn expose(&mut self, mut light: Option<&mut GuideStar>) {
        let samples = self.pixels.samples;
        // Four faces with 1/16 of the sums each, over the points of the modulation and the samples
        // of a pixel.
        let scale = 1.0 / (16 * self.optics.points() * samples * samples) as f64;
        for (&place, signal) in self.pixels.subapertures.iter().zip(&mut self.signals) {
            let (top, left) = (place / self.pixels.across * samples, place % self.pixels.across * samples);
            let mut sums = [0.0; 4];
            for (y, x) in (0..samples * samples).map(|i| (top + i / samples, left + i % samples)) {
                sums.iter_mut().zip(self.optics.sums_at(y, x)).for_each(|(sum, value)| *sum += f64::from(value));
            }
            let [t, x, y, z] = sums.map(|sum| sum * scale);
            *signal = match light.as_deref_mut() {
                None => [4.0 * t, 8.0 * x, 8.0 * y],
                Some(light) => {
                    let drawn = FACES.map(|[sx, sy]| {
                        let share = t + 2.0 * (sx * x + sy * y + sx * sy * z);
                        light.pixel(share.max(0.0) * light.electrons)
                    });
                    let with_signs =
                        |sign: fn(&[f64; 2]) -> f64| FACES.iter().zip(drawn).map(|(face, e)| sign(face) * e).sum();
                    [with_signs(|_| 1.0), with_signs(|face| face[0]), with_signs(|face| face[1])]
                }
            };
        }
    }
}

/// Vectors and rows that hold the pixels in use.
fn tiles(pixels: &Lenslets) -> Vec<Tile> {
    let (across, samples) = (pixels.across, pixels.samples);
    let vectors = (across * samples).div_ceil(LANES);
    let mut tiles: Vec<Tile> = Vec::new();
    for vector in 0..vectors {
        let is_in = |&&place: &&usize| {
            let left = place % across * samples;
            left < (vector + 1) * LANES && left + samples > vector * LANES
        };
        let mut rows: Vec<usize> = pixels.subapertures.iter().filter(is_in).map(|place| place / across).collect();
        // Ascending subapertures are in ascending rows.
        rows.dedup();
        for row in rows {
            let of_row = row * samples..(row + 1) * samples;
            match tiles.last_mut().filter(|tile| tile.vector == vector && tile.rows.end == of_row.start) {
                Some(tile) => tile.rows.end = of_row.end,
                None => tiles.push(Tile { vector, rows: of_row }),
            }
        }
    }
    tiles
}

#[cfg(test)]
mod tests;
