//! Closed-loop response to segment pistons, tips and tilts (AO leakage): the mirror's shape at
//! rest, from a simulation of the loop on the segments alone, without turbulence and noise.
//!
//! The response is nonlinear, as is a quad cell's to a step at a segment's edge. So it is simulated
//! for each set of coefficients, and its linear part serves for first estimates only.

use super::mirror_shape::MirrorShape;
use super::segment_surface::SegmentSurface;
use crate::Result;
use crate::ao::{LoopAtRest, Simulator, undisturb};
use crate::retrieval::IlluminatedSamples;
use crate::scene::{Sections, System};
use ndarray::{Array1, Array2, ArrayView1, Axis};
use rayon::prelude::*;
use std::ops::Range;

/// Piston, or RMS of a tip or tilt, with which the linear part is measured, nm.
const POKE_NM: f64 = 20.0;

/// Change of a command in a frame below which the mirror is at rest, nm.
const STILL_NM: f64 = 1e-3;

/// Change where the linear part is measured, nm, 1/2000 of a poke. What it lacks is in the rest,
/// which is simulated about the estimate.
const STILL_LINEAR_NM: f64 = 1e-2;

/// Least number of pokes that a thread takes at once: enough to pay for its copy of the loop.
const POKES_PER_THREAD: usize = 16;

/// Closed-loop response of a scene to its segments. Their coefficients are all pistons, or all
/// pistons, all tips and all tilts, nm.
pub struct ClosedLoopResponse {
    at_rest: LoopAtRest,
    /// Index in the loop's map of each sample that a segment owns.
    owned: Vec<u32>,
    surface: SegmentSurface,
    mirror: MirrorShape,
}

impl ClosedLoopResponse {
    /// The response of the loop of `scene`, at the illuminated `samples`.
    ///
    /// # Errors
    /// Those of [`Simulator::new`].
    pub fn new(scene: &System, samples: &IlluminatedSamples) -> Result<Self> {
        let simulator = Simulator::new(&scene.with(|sections| {
            undisturb(sections);
            flatten(sections);
        })?)?;
        let (stride, pupil) = (simulator.footprint().stride(), simulator.pupil());
        let owned: Vec<_> = pupil.owned_samples().collect();
        let surface = SegmentSurface::new(&owned, pupil, &simulator.telescope().pupil);
        let owned = owned.into_iter().map(|((y, x), _)| (y * stride + x) as u32).collect();
        let mirror = MirrorShape::new(simulator.influence(), samples);
        Ok(Self { at_rest: LoopAtRest::from(simulator), owned, surface, mirror })
    }

    /// Simulates the commands of the mirror at rest behind segments with these coefficients, nm,
    /// from those of the last simulation.
    ///
    /// # Errors
    /// [`Error::Shape`](crate::Error::Shape) for another number of coefficients; those of
    /// [`LoopAtRest::commands_nm`].
    pub fn commands_nm(&mut self, segments_nm: &[f64]) -> Result<Array1<f64>> {
        self.surface.check(segments_nm)?;
        let mut opd_nm = self.at_rest.footprint().zeros();
        self.fill(segments_nm, &mut opd_nm);
        self.at_rest.commands_nm(&opd_nm, STILL_NM)
    }

    /// Writes the wavefront of the segments into a map over the footprint.
    fn fill(&self, segments_nm: &[f64], opd_nm: &mut [f32]) {
        for (sample, &index) in self.owned.iter().enumerate() {
            opd_nm[index as usize] = self.surface.wavefront_nm(sample, segments_nm) as f32;
        }
    }

    /// Simulates the mirror's contribution to the wavefront at each illuminated sample behind
    /// segments with these coefficients, nm.
    ///
    /// # Errors
    /// As [`ClosedLoopResponse::commands_nm`].
    pub fn response_nm(&mut self, segments_nm: &[f64]) -> Result<Array1<f64>> {
        let commands_nm = self.commands_nm(segments_nm)?;
        Ok(self.wavefront_nm(commands_nm.view()))
    }

    /// Contribution of the mirror with these commands to the wavefront at each illuminated sample,
    /// nm.
    pub(crate) fn wavefront_nm(&self, commands_nm: ArrayView1<f64>) -> Array1<f64> {
        // The mirror's shape is subtracted from the wavefront.
        -self.mirror.wavefront_nm(commands_nm)
    }

    /// The wavefronts of [`ClosedLoopResponse::linear_commands`], `[mode, sample]`.
    ///
    /// # Errors
    /// As [`ClosedLoopResponse::commands_nm`].
    #[cfg(test)]
    pub(crate) fn linear_response(&mut self, about_nm: &[f64], modes: Range<usize>) -> Result<Array2<f64>> {
        let commands = self.linear_commands(about_nm, modes)?;
        let mut responses = Array2::zeros((commands.nrows(), self.mirror.len()));
        for (commands, mut response) in commands.outer_iter().zip(responses.outer_iter_mut()) {
            response.assign(&self.wavefront_nm(commands));
        }
        Ok(responses)
    }

    /// Measures the linear part of [`ClosedLoopResponse::commands_nm`] about segments of
    /// `about_nm`, for 1 nm of each of the coefficients `modes` (pistons, tips, tilts in turn),
    /// `[mode, actuator]`.
    ///
    /// # Errors
    /// As [`ClosedLoopResponse::commands_nm`].
    pub(crate) fn linear_commands(&mut self, about_nm: &[f64], modes: Range<usize>) -> Result<Array2<f64>> {
        let mut responses = Array2::zeros((modes.len(), self.at_rest.actuators()));
        // Of a mirror at rest behind even segments nothing moves.
        let offset_nm = match about_nm.iter().any(|nm| *nm != 0.0) {
            true => self.commands_nm(about_nm)?,
            false => Array1::zeros(self.at_rest.actuators()),
        };
        self.surface.check(about_nm)?;
        let copies = || (self.at_rest.clone(), self.at_rest.footprint().zeros(), about_nm.to_vec());
        let rows = responses.axis_iter_mut(Axis(0)).into_par_iter().with_min_len(POKES_PER_THREAD);
        rows.zip(modes).try_for_each_init(copies, |(at_rest, opd_nm, segments_nm), (mut row, mode)| {
            segments_nm[mode] += POKE_NM;
            self.fill(segments_nm, opd_nm);
            segments_nm[mode] = about_nm[mode];
            // From the same commands for each, so that none depends on those before.
            at_rest.hold(offset_nm.view());
            row.assign(&((at_rest.commands_nm(opd_nm, STILL_LINEAR_NM)? - &offset_nm) / POKE_NM));
            Ok(())
        })?;
        Ok(responses)
    }
}

/// Takes away all aberrations.
fn flatten(sections: &mut Sections) {
    let Some(aberrations) = &mut sections.aberrations else { return };
    (aberrations.ncpa_file, aberrations.petal_coefficients_nm) = (None, None);
    for rms_nm in [
        &mut aberrations.segment_piston_rms_nm,
        &mut aberrations.segment_tip_tilt_rms_nm,
        &mut aberrations.segment_figure_rms_nm,
        &mut aberrations.common_figure_rms_nm,
        &mut aberrations.ncpa_rms_nm,
        &mut aberrations.petal_piston_rms_nm,
        &mut aberrations.petal_tip_tilt_rms_nm,
    ] {
        *rms_nm = 0.0;
    }
    (sections.faults.segment_reflectivity_rms, sections.faults.drift_nm_per_min) = (0.0, 0.0);
}
