//! Lenslets that have moved: what they see of a pupil that stands elsewhere.

use crate::ao::footprint::Footprint;
use crate::ao::lines::Lines;
use crate::pupil::Pupil;
use ndarray::Array2;

/// A shift between the wavefront's samples and the lenslets'.
pub(super) struct Moved {
    /// For each sample of the lenslets with light its place, and the places and weights of the samples it sees.
    taps: Vec<(u32, [u32; 4], [f32; 4])>,
    map_nm: Lines,
}

impl Moved {
    /// Lenslets that have moved by `[x, y]` samples over `pupil`: the shift, and the pupil as they see it.
    ///
    /// Amplitudes between samples are interpolated linearly, phases likewise with the weight of their amplitude. Within a
    /// sample's width of a segment's edge that is the mean of the two pistons.
    pub(super) fn by(shift: [f64; 2], pupil: &Pupil, footprint: &Footprint) -> (Self, Pupil) {
        let (n, stride) = (pupil.grid.samples(), footprint.stride());
        let mut seen = Array2::zeros((n, n));
        let mut taps = Vec::new();
        for (y, x) in ndarray::indices((n, n)) {
            let (at_x, at_y) = (x as f64 + shift[0], y as f64 + shift[1]);
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
                seen[[y, x]] = whole;
                let weights = tap.map(|(_, weight)| (weight / whole) as f32);
                taps.push(((y * stride + x) as u32, tap.map(|(place, _)| place), weights));
            }
        }
        (Self { taps, map_nm: footprint.zeros() }, Pupil { amplitude: seen, ..pupil.clone() })
    }

    /// The map as the lenslets see it.
    pub(super) fn look(&mut self, opd_nm: &[f32]) -> &[f32] {
        for (place, from, weights) in &self.taps {
            let seen = from.iter().zip(weights).map(|(&from, weight)| weight * opd_nm[from as usize]);
            self.map_nm[*place as usize] = seen.sum();
        }
        &self.map_nm
    }
}
