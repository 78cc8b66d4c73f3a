//! Petal modes: piston, tip and tilt of each part of a pupil that its spider separates (island or
//! low-wind effect; Sauvage et al. 2016, Proc. SPIE 9909, 990916).

use super::segment::{SegmentModes, TiltFrame, tilt_frames};
use crate::pupil::{Pupil, PupilParts};
use crate::{Error, Result};
use ndarray::{Array2, ArrayViewMut2};

/// Motions of the parts of a pupil, as functions of a point: 0 on all other parts.
#[derive(Debug, Clone, PartialEq)]
pub struct Petals {
    parts: PupilParts,
    /// Share of the light of the pupil that each part has.
    shares: Vec<f64>,
    /// Where the tip and the tilt of each part are 0; none without tips and tilts.
    frames: Vec<TiltFrame>,
}

impl Petals {
    /// The motions `modes` of each of the `parts` of `pupil`: pistons of 1, tips (along x) and
    /// tilts (along y) about the centroid of the part (weight A), of unit RMS over it.
    ///
    /// # Errors
    /// [`Error::Value`] for a pupil in one part, for a part without light, and for one with too few
    /// samples for its tilts.
    pub fn new(parts: PupilParts, pupil: &Pupil, modes: SegmentModes) -> Result<Self> {
        let count = parts.count();
        if count < 2 {
            return Err(Error::Value(
                "the pupil has one part, and petals need two or more: arms of a spider between them (pupil.spider_width_m, \
                 pupil.spider_angles_deg), or dark strips in the map of the pupil, are needed"
                    .into(),
            ));
        }
        let coordinate = |index: usize| pupil.grid.coordinate_m(index);
        let labels = Array2::from_shape_fn(pupil.amplitude.dim(), |(y, x)| match pupil.amplitude[[y, x]] > 0.0 {
            true => parts.part_at(coordinate(x), coordinate(y)) as i32,
            false => -1,
        });
        let (mut shares, whole) = (vec![0.0; count], pupil.weight_sum());
        for (&label, a) in labels.iter().zip(&pupil.amplitude).filter(|(label, _)| **label >= 0) {
            shares[label as usize] += a / whole;
        }
        if let Some(dark) = shares.iter().position(|share| *share == 0.0) {
            return Err(Error::Value(format!(
                "part {dark} of the {count} between the arms of the spider has no light: a spider whose arms have some of the pupil \
                 between them is needed"
            )));
        }
        let frames = match modes {
            SegmentModes::Piston => Vec::new(),
            SegmentModes::PistonTipTilt => {
                tilt_frames(&Pupil::from_maps(pupil.grid, pupil.amplitude.clone(), Some(labels))?)?
            }
        };
        Ok(Self { parts, shares, frames })
    }

    /// The parts.
    pub fn parts(&self) -> &PupilParts {
        &self.parts
    }

    /// Share of the light of the pupil that each part has.
    pub fn shares(&self) -> &[f64] {
        &self.shares
    }

    /// Number of motions: all pistons, then all tips, then all tilts.
    pub fn len(&self) -> usize {
        self.parts.count() + 2 * self.frames.len()
    }

    /// Whether there is no motion.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Names of the motions.
    pub(super) fn names(&self) -> Vec<String> {
        let motions: &[&str] = if self.frames.is_empty() { &["piston"] } else { &["piston", "tip", "tilt"] };
        let name = |motion| (0..self.parts.count()).map(move |part| format!("petal-{motion}-{part}"));
        motions.iter().flat_map(name).collect()
    }

    /// Writes the motions at the points into `values`, `[motion, point]`, which is 0.
    pub(super) fn fill(&self, xs_m: &[f64], ys_m: &[f64], mut values: ArrayViewMut2<f64>) {
        let count = self.parts.count();
        for (point, (&x_m, &y_m)) in xs_m.iter().zip(ys_m).enumerate() {
            let part = self.parts.part_at(x_m, y_m);
            values[[part, point]] = 1.0;
            if let Some(frame) = self.frames.get(part) {
                let [tip, tilt] = frame.tilts([x_m, y_m]);
                values[[count + part, point]] = tip;
                values[[2 * count + part, point]] = tilt;
            }
        }
    }
}
