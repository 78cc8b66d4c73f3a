//! Misregistration: shift, rotation and magnification of the lenslets relative to the pupil since
//! the calibration.

use crate::ao::aligned::AlignedBuffer;
use crate::ao::footprint::Footprint;
use crate::pupil::Pupil;
use crate::scene::SensorScene;
use ndarray::Array2;

/// Interpolation from the wavefront's samples to those of the moved lenslets.
#[derive(Clone)]
pub(super) struct Misregistration {
    /// For each illuminated sample of the lenslets: its index, and the indices and weights of the
    /// samples around it.
    taps: Vec<(u32, [u32; 4], [f32; 4])>,
    map_nm: AlignedBuffer,
}

impl Misregistration {
    /// That of `scene` over `pupil`, with the pupil in the lenslets' coordinates; `None` for
    /// lenslets where they were calibrated. A lenslet at p, about the axis, sees what is at m·R·p +
    /// s of the pupil, with the magnification m, the rotation R and the shift s.
    ///
    /// Amplitudes are interpolated bilinearly; phases too, with the weight of their amplitude.
    /// Within one sample of a segment's edge the result is the mean of the two pistons.
    pub(super) fn new(scene: &SensorScene, pupil: &Pupil, footprint: &Footprint) -> Option<(Self, Pupil)> {
        let samples = scene.samples_per_lenslet as f64;
        let shift = [0, 1].map(|axis| samples * scene.shift_subapertures.get(axis).copied().unwrap_or(0.0));
        let (turn_deg, magnification) = (scene.rotation_deg, scene.magnification);
        if shift == [0.0; 2] && turn_deg == 0.0 && magnification == 1.0 {
            return None;
        }
        let (sin, cos) = turn_deg.to_radians().sin_cos();
        let (n, stride) = (pupil.grid.samples(), footprint.stride());
        let centre = (n as f64 - 1.0) / 2.0;
        let mut moved = Array2::zeros((n, n));
        let mut taps = Vec::new();
        for (y, x) in ndarray::indices((n, n)) {
            let (from_x, from_y) = (x as f64 - centre, y as f64 - centre);
            let at_x = centre + magnification * (cos * from_x - sin * from_y) + shift[0];
            let at_y = centre + magnification * (sin * from_x + cos * from_y) + shift[1];
            let (left, below) = (at_x.floor(), at_y.floor());
            let (fx, fy) = (at_x - left, at_y - below);
            let corners = [
                (0.0, 0.0, (1.0 - fx) * (1.0 - fy)),
                (1.0, 0.0, fx * (1.0 - fy)),
                (0.0, 1.0, (1.0 - fx) * fy),
                (1.0, 1.0, fx * fy),
            ];
            let inside = |c: f64| (c >= 0.0 && c < n as f64).then_some(c as usize);
            let tap = corners.map(|(dx, dy, share)| match (inside(left + dx), inside(below + dy)) {
                (Some(u), Some(v)) => ((v * stride + u) as u32, share * pupil.amplitude[[v, u]]),
                _ => (0, 0.0),
            });
            let whole: f64 = tap.iter().map(|(_, weight)| weight).sum();
            if whole > 0.0 {
                moved[[y, x]] = whole;
                let weights = tap.map(|(_, weight)| (weight / whole) as f32);
                taps.push(((y * stride + x) as u32, tap.map(|(place, _)| place), weights));
            }
        }
        Some((Self { taps, map_nm: footprint.zeros() }, Pupil { amplitude: moved, ..pupil.clone() }))
    }

    /// Interpolates a map to the samples of the lenslets.
    pub(super) fn apply(&mut self, opd_nm: &[f32]) -> &[f32] {
        for (place, from, weights) in &self.taps {
            let terms = from.iter().zip(weights).map(|(&from, weight)| weight * opd_nm[from as usize]);
            self.map_nm[*place as usize] = terms.sum();
        }
        &self.map_nm
    }
}
