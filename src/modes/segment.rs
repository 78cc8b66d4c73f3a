//! Segment modes: their names, and their maps for the model in which each sample belongs to one
//! segment.

use super::basis::{Basis, Group, SparseMap};
use crate::pupil::{Pupil, Segment};
use crate::{Error, Result};

/// Degrees of freedom of each segment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SegmentModes {
    /// Piston: 1 on the segment, 0 elsewhere.
    Piston,
    /// Piston, then tip (along x) and tilt (along y) about the segment's centroid (weight A), unit
    /// RMS over the segment.
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

    /// Names of the modes: all the pistons (`segment-00-piston`, `segment-01-piston` …), then all
    /// the tips, then all the tilts.
    pub fn names(self, segments: usize) -> Vec<String> {
        // Zero-padded, so that alphabetic order is numeric order.
        let width = segments.saturating_sub(1).to_string().len().max(2);
        let motions = &MOTIONS[..self.per_segment()];
        let name = |motion| (0..segments).map(move |segment| format!("segment-{segment:0width$}-{motion}"));
        motions.iter().flat_map(name).collect()
    }

    /// The modes as maps on the grid of the pupil, from its owner map, in the order of
    /// [`names`](Self::names).
    ///
    /// # Errors
    /// [`Error::Shape`] where the pupil's arrays do not fit its grid; [`Error::Value`] for an owner
    /// that is not a segment, a pupil without segments, or a segment with too few samples for its
    /// mode.
    pub fn maps(self, pupil: &Pupil) -> Result<Basis> {
        self.maps_in(pupil, tilt_frames)
    }

    /// As [`SegmentModes::maps`], with tips and tilts in these frames of `pupil`.
    pub(crate) fn maps_in(self, pupil: &Pupil, frames: fn(&Pupil) -> Result<Vec<TiltFrame>>) -> Result<Basis> {
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
        let frames = if self == SegmentModes::PistonTipTilt { frames(pupil)? } else { Vec::new() };
        for ((row, column), segment) in pupil.owned_samples() {
            let at = (row * n + column) as u32;
            maps[segment].push((at, 1.0));
            if let Some(frame) = frames.get(segment) {
                let [tip, tilt] = frame.tilts([column, row].map(|index| pupil.grid.coordinate_m(index)));
                maps[segments + segment].push((at, tip));
                maps[2 * segments + segment].push((at, tilt));
            }
        }
        Basis::from_lists(names, vec![Group::Segment; maps.len()], n, maps)
    }
}

/// Where the tip and the tilt of a segment are 0, and their unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct TiltFrame {
    /// Centroid (weight A), x and y, m. Shadows move it away from the centre.
    centroid_m: [f64; 2],
    /// RMS over the segment of the distance from it, along x and along y, m.
    rms_m: [f64; 2],
}

impl TiltFrame {
    /// RMS over the segment of the distance from its centroid, along x and along y, m.
    pub(crate) fn rms_m(&self) -> [f64; 2] {
        self.rms_m
    }

    /// Tip and tilt of unit RMS over the segment, at a point.
    pub(crate) fn tilts(&self, point_m: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|axis| (point_m[axis] - self.centroid_m[axis]) / self.rms_m[axis])
    }
}

/// The frames of all segments of `pupil`.
///
/// # Errors
/// [`Error::Value`] for a segment with too few samples.
pub(crate) fn tilt_frames(pupil: &Pupil) -> Result<Vec<TiltFrame>> {
    let resolved = |(segment, frame): (usize, Option<TiltFrame>)| {
        frame.ok_or_else(|| {
            Error::Value(format!(
                "segment {segment} is not resolved on this grid: its tip and tilt need at least two illuminated samples in each direction"
            ))
        })
    };
    resolved_frames(pupil).into_iter().enumerate().map(resolved).collect()
}

/// As [`tilt_frames`]; a segment with too few samples, such as one without light, has the mean unit
/// of the others about its centre.
///
/// # Errors
/// [`Error::Value`] where that holds for all of them.
pub(crate) fn tilt_frames_of_lit(pupil: &Pupil) -> Result<Vec<TiltFrame>> {
    let frames = resolved_frames(pupil);
    let lit: Vec<f64> = frames.iter().flatten().flat_map(|frame| frame.rms_m).collect();
    if lit.is_empty() {
        return tilt_frames(pupil);
    }
    let rms_m = [lit.iter().sum::<f64>() / lit.len() as f64; 2];
    let of_segment = |(frame, segment): (Option<TiltFrame>, &Segment)| {
        frame.unwrap_or(TiltFrame { centroid_m: [segment.x_m, segment.y_m], rms_m })
    };
    Ok(frames.into_iter().zip(&pupil.segments).map(of_segment).collect())
}

/// The frame of each segment of `pupil`; `None` where it has too few samples.
fn resolved_frames(pupil: &Pupil) -> Vec<Option<TiltFrame>> {
    // Sums of A, A r and A r² along x and y, about the segment's centre.
    let mut sums = vec![[[0.0; 3]; 2]; pupil.segments.len()];
    let centre = |segment: usize| [pupil.segments[segment].x_m, pupil.segments[segment].y_m];
    for ((row, column), segment) in pupil.owned_samples() {
        let amplitude = pupil.amplitude[[row, column]];
        for (axis, index) in [column, row].into_iter().enumerate() {
            let r = pupil.grid.coordinate_m(index) - centre(segment)[axis];
            let [weight, first, second] = &mut sums[segment][axis];
            (*weight, *first, *second) = (*weight + amplitude, *first + amplitude * r, *second + amplitude * r * r);
        }
    }
    let frames = sums.iter().enumerate().map(|(segment, sums)| {
        let [mean_m, rms_m] = [
            sums.map(|[weight, first, _]| first / weight),
            sums.map(|[weight, first, second]| (second / weight - (first / weight).powi(2)).max(0.0).sqrt()),
        ];
        // Two samples give half a pitch; rounding of the mean gives 1e-8 of the segment.
        rms_m
            .iter()
            .all(|rms_m| *rms_m > 1e-6 * pupil.grid.pitch_m())
            .then(|| TiltFrame { centroid_m: [0, 1].map(|axis| centre(segment)[axis] + mean_m[axis]), rms_m })
    });
    frames.collect()
}
