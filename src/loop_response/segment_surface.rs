//! Wavefront of segments with pistons, tips and tilts, at samples that each belong to one segment:
//! edges are sharp, as a wavefront sensor sees them.

use crate::modes::tilt_frames;
use crate::pupil::Pupil;
use crate::{Error, Result};

/// Segments at samples of a grid.
pub(super) struct SegmentSurface {
    segments: usize,
    /// Segment of each sample.
    owners: Vec<u32>,
    /// Wavefront of 1 nm of its tip and of its tilt at each sample; empty where a segment is too
    /// small for tilts.
    tilts: Vec<[f32; 2]>,
}

impl SegmentSurface {
    /// At `samples` of the grid of `pupil`, `(y, x)` with their segment. Tips and tilts are those
    /// of the modes of `telescope_pupil`, whose grid is another.
    pub(super) fn new(samples: &[((usize, usize), usize)], pupil: &Pupil, telescope_pupil: &Pupil) -> Self {
        let segments = pupil.segments.len();
        let owners = samples.iter().map(|&(_, owner)| owner as u32).collect();
        // Segments that are too small for tilts have pistons alone.
        let frames = tilt_frames(telescope_pupil).ok().filter(|frames| frames.len() == segments);
        let tilts = frames.iter().flat_map(|frames| {
            let at = |&((y, x), owner): &((usize, usize), usize)| {
                frames[owner].tilts([x, y].map(|index| pupil.grid.coordinate_m(index))).map(|nm| nm as f32)
            };
            samples.iter().map(at)
        });
        Self { segments, owners, tilts: tilts.collect() }
    }

    /// Number of segments.
    pub(super) fn segments(&self) -> usize {
        self.segments
    }

    /// Checks coefficients of the segments, nm: all pistons, or all pistons, all tips and all
    /// tilts.
    ///
    /// # Errors
    /// [`Error::Shape`] for another number.
    pub(super) fn check(&self, segments_nm: &[f64]) -> Result<()> {
        let (given, segments) = (segments_nm.len(), self.segments);
        if given == segments || given == 3 * segments && self.tilts.len() == self.owners.len() {
            return Ok(());
        }
        Err(Error::Shape(format!(
            "{given} segment coefficients were given: {segments} pistons, or as many pistons, tips and tilts each, are needed"
        )))
    }

    /// Wavefront of the segments at a sample, by its place among those of [`SegmentSurface::new`],
    /// nm.
    pub(super) fn wavefront_nm(&self, sample: usize, segments_nm: &[f64]) -> f64 {
        let owner = self.owners[sample] as usize;
        let piston_nm = segments_nm[owner];
        if segments_nm.len() == self.segments {
            return piston_nm;
        }
        let [tip, tilt] = self.tilts[sample].map(f64::from);
        piston_nm + tip * segments_nm[self.segments + owner] + tilt * segments_nm[2 * self.segments + owner]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::modes::SegmentModes;
    use crate::retrieval::tests::scene;
    use crate::telescope::Telescope;

    #[test]
    fn the_surface_is_that_of_the_segment_modes() {
        let pupil = Telescope::new(&scene()).unwrap().pupil;
        let surface = SegmentSurface::new(&pupil.owned_samples().collect::<Vec<_>>(), &pupil, &pupil);
        let count = surface.segments();
        let segments_nm: Vec<f64> = (0..3 * count).map(|mode| 30.0 * (1.7 * mode as f64).sin()).collect();
        for modes in [SegmentModes::Piston, SegmentModes::PistonTipTilt] {
            let segments_nm = &segments_nm[..modes.per_segment() * count];
            surface.check(segments_nm).unwrap();
            let maps = modes.maps(&pupil).unwrap().maps();
            for (sample, ((y, x), _)) in pupil.owned_samples().enumerate() {
                let nm: f64 = segments_nm.iter().zip(maps.outer_iter()).map(|(nm, map)| nm * map[[y, x]]).sum();
                // Shapes of up to 2 in single precision, times 30 nm.
                assert!((surface.wavefront_nm(sample, segments_nm) - nm).abs() < 1e-5);
            }
        }
        let sentence = surface.check(&segments_nm[..2 * count]).unwrap_err().to_string();
        assert!(["14 segment coefficients", "7 pistons"].iter().all(|fact| sentence.contains(fact)), "{sentence}");
    }
}
