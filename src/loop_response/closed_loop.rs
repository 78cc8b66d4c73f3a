//! What a loop makes of segment pistons: the loop closed on them alone, without turbulence and noise.
//!
//! The answer is not linear (a quad cell's is not, at a step of a segment's edge): it is run again for every set of
//! pistons rather than multiplied out.

use crate::ao::{CALM, Simulator};
use crate::retrieval::LitSamples;
use crate::scene::Scene;
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1};

/// No aberrations but those it is asked about.
const FLAT: [(&str, &str); 6] = [
    ("aberrations.ncpa_file", ""),
    ("aberrations.segment_piston_rms_nm", "0.0"),
    ("aberrations.segment_tip_tilt_rms_nm", "0.0"),
    ("aberrations.segment_reflectivity_rms", "0.0"),
    ("aberrations.ncpa_rms_nm", "0.0"),
    ("aberrations.drift_nm_per_min", "0.0"),
];

/// A mirror whose commands move by less than this from frame to frame is at rest: at a gain of 0.3 what is left to move is
/// three times that.
const STILL_NM: f32 = 1e-3;

/// Frames after which a mirror that does not rest is taken as it is: 30 s at most loops' rates. Directions that the
/// controller hardly sees drift on for long, and hardly.
const MOST_FRAMES: usize = 3000;

/// Piston with which the linear part is measured, nm.
const POKE_NM: f64 = 20.0;

/// The loop of a scene, without a sky.
pub struct CalmLoop {
    simulator: Simulator,
    /// For each sample of the simulator's map the segment that owns it, and its place.
    owned: Vec<(u32, u32)>,
    /// What 1 nm of each command shows at each lit sample, `[actuator, sample]`.
    influence: Array2<f64>,
    segments: usize,
}

impl CalmLoop {
    /// The loop of `scene`, its mirror seen at the samples of `lit`.
    ///
    /// # Errors
    /// Those of [`Simulator::new`].
    pub fn of(scene: &Scene, lit: &LitSamples) -> Result<Self> {
        let aberrations = scene.aberrations.iter().flat_map(|_| FLAT);
        let calm: Vec<_> = CALM.into_iter().chain(aberrations).collect();
        let simulator = Simulator::new(&scene.with(&calm)?)?;
        let stride = simulator.footprint().stride();
        let owner = simulator.pupil().owner.indexed_iter().filter(|(_, owner)| **owner >= 0);
        let owned = owner.map(|((y, x), &owner)| (owner as u32, (y * stride + x) as u32)).collect();
        let influence = simulator.influence().evaluate(&lit.xs_m, &lit.ys_m)?;
        let segments = simulator.pupil().segments.len();
        Ok(Self { simulator, owned, influence, segments })
    }

    /// The commands on the mirror when it rests behind segments with these pistons, nm.
    ///
    /// # Errors
    /// [`Error::Shape`] for another number of segments; those of [`Simulator::step_behind`].
    pub fn commands_nm(&mut self, pistons_nm: &[f64]) -> Result<Vec<f64>> {
        if pistons_nm.len() != self.segments {
            let (given, needed) = (pistons_nm.len(), self.segments);
            return Err(Error::Shape(format!("{given} pistons were given: the telescope has {needed} segments")));
        }
        let mut steps_nm = self.simulator.footprint().zeros();
        for &(segment, place) in &self.owned {
            steps_nm[place as usize] = pistons_nm[segment as usize] as f32;
        }
        let mut before_nm = vec![0.0; self.simulator.influence().len()];
        for frame in 0..MOST_FRAMES {
            let commands_nm = self.simulator.step_behind(&steps_nm)?.commands_nm;
            let moved = commands_nm.iter().zip(&before_nm).map(|(now, then)| (now - then).abs()).fold(0.0, f32::max);
            before_nm.copy_from_slice(commands_nm);
            // The first frames still show the commands for the pistons before.
            if moved < STILL_NM && frame > 1 {
                break;
            }
        }
        Ok(before_nm.into_iter().map(f64::from).collect())
    }

    /// What the mirror adds to the wavefront at each lit sample behind segments with these pistons, nm.
    ///
    /// # Errors
    /// As [`CalmLoop::commands_nm`].
    pub fn answer_nm(&mut self, pistons_nm: &[f64]) -> Result<Array1<f64>> {
        let commands_nm = self.commands_nm(pistons_nm)?;
        // A mirror is subtracted.
        Ok(-ArrayView1::from(&commands_nm).dot(&self.influence))
    }

    /// The linear part of [`CalmLoop::answer_nm`]: for 1 nm of each piston, `[segment, sample]`.
    ///
    /// # Errors
    /// As [`CalmLoop::commands_nm`].
    pub fn linear_answer(&mut self) -> Result<Array2<f64>> {
        let mut answers = Array2::zeros((self.segments, self.influence.ncols()));
        let mut pistons_nm = vec![0.0; self.segments];
        for (segment, mut row) in answers.outer_iter_mut().enumerate() {
            pistons_nm[segment] = POKE_NM;
            row.assign(&(self.answer_nm(&pistons_nm)? / POKE_NM));
            pistons_nm[segment] = 0.0;
        }
        Ok(answers)
    }
}
