//! Segment modes: their names, and their maps for the model in which each sample belongs to one segment.

use super::basis::{Basis, Group, SparseMap};
use crate::pupil::Pupil;
use crate::{Error, Result};

/// Degrees of freedom of each segment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SegmentModes {
    /// Piston: 1 on the segment, 0 elsewhere.
    Piston,
    /// Piston, then tip (along x) and tilt (along y) about the segment's centroid (weight A), unit RMS over the segment.
    PistonTipTilt,
}

/// The motions, in the order of their modes.
const MOTIONS: [&str; 3] = ["piston", "tip", "tilt"];

impl SegmentModes {
    /// Number of modes per segment.
    pub fn per_segment(self) -> usize {
        match self {
            SegmentModes::Piston => 1,
            SegmentModes::PistonTipTilt => 3,
        }
    }

    /// Names of the modes: all the pistons (`segment-00-piston`, `segment-01-piston` …), then all the tips, then all
    /// the tilts.
    pub fn names(self, segments: usize) -> Vec<String> {
        // Zero-padded, so that alphabetic order is numeric order.
        let width = segments.saturating_sub(1).to_string().len().max(2);
        let motions = &MOTIONS[..self.per_segment()];
        let name = |motion| (0..segments).map(move |segment| format!("segment-{segment:0width$}-{motion}"));
        motions.iter().flat_map(name).collect()
    }

    /// The modes as maps on the grid of the pupil, from its owner map, in the order of [`names`](Self::names).
    ///
    /// # Errors
    /// [`Error::Shape`] where the pupil's arrays do not fit its grid; [`Error::Value`] for an owner that is not a
    /// segment, a pupil without segments, or a segment with too few samples for its mode.
    pub fn maps(self, pupil: &Pupil) -> Result<Basis> {
        let (n, segments) = (pupil.grid.samples(), pupil.segments.len());
        for shape in [pupil.amplitude.dim(), pupil.owner.dim()] {
            if shape != (n, n) {
                return Err(Error::Shape(format!(
                    "a pupil array of shape {shape:?} was given: {:?} is needed",
                    (n, n)
                )));
            }
        }
        if segments == 0 {
            return Err(Error::Value("the pupil has no segments: segment modes need at least one".into()));
        }
        if let Some(owner) = pupil.owner.iter().find(|&&owner| owner >= segments as i32 || owner < -1) {
            let text = format!("the owner map names segment {owner}: −1 to {} are accepted", segments - 1);
            return Err(Error::Value(text));
        }
        let names = self.names(segments);
        let mut maps: Vec<SparseMap> = vec![Vec::new(); segments * self.per_segment()];
        for ((row, column), segment) in pupil.owned_samples() {
            let at = (row * n + column) as u32;
            maps[segment].push((at, 1.0));
            if self == SegmentModes::PistonTipTilt {
                maps[segments + segment].push((at, pupil.grid.coordinate_m(column)));
                maps[2 * segments + segment].push((at, pupil.grid.coordinate_m(row)));
            }
        }
        for (map, name) in maps.iter_mut().zip(&names).skip(segments) {
            normalise(map, pupil, name)?;
        }
        Basis::from_lists(names, vec![Group::Segment; maps.len()], n, maps)
    }
}

/// Removes the mean over the mode's segment and scales to unit RMS over it, both weighted by the amplitude.
fn normalise(map: &mut SparseMap, pupil: &Pupil, name: &str) -> Result<()> {
    let n = pupil.grid.samples();
    let amplitude = |at: u32| pupil.amplitude[[at as usize / n, at as usize % n]];
    let weighted = |map: &SparseMap, power: i32| map.iter().map(|&(at, v)| amplitude(at) * v.powi(power)).sum::<f64>();
    let light = weighted(map, 0);
    let mean = weighted(map, 1) / light;
    map.iter_mut().for_each(|(_, value)| *value -= mean);
    let rms = (weighted(map, 2) / light).sqrt();
    // Two samples give half a pitch; rounding of the mean gives 1e-16 of the width of the grid.
    if !(light > 0.0 && rms > 1e-9 * pupil.grid.width_m()) {
        return Err(Error::Value(format!(
            "{name} is not resolved on this grid: the segment needs at least two illuminated samples"
        )));
    }
    map.iter_mut().for_each(|(_, value)| *value /= rms);
    Ok(())
}
