//! The loop at rest behind a constant wavefront: the commands that a control step does not change.
//!
//! In plain steps a mode of response λ approaches them as (1 − gλ)ⁿ, which takes hundreds of frames
//! where the reconstructor is regularised. The commands at rest are the fixed point of the control
//! step and do not depend on the lag. Anderson acceleration (Walker and Ni 2011, SIAM J. Numer.
//! Anal. 49, 1715) finds it in some tens of frames.

use super::Simulator;
use super::aligned::AlignedBuffer;
use super::correction::CorrectionLoop;
use super::footprint::Footprint;
use crate::linear_algebra::SpdInverse;
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1};
use std::collections::VecDeque;

/// Frames after which a mirror that still moves is taken as at rest: directions of weak singular
/// values drift for long, and little.
const MAX_FRAMES: usize = 300;

/// Earlier frames that an extrapolation uses.
const DEPTH: usize = 12;

/// Regularisation of an extrapolation, relative to the largest square of a difference: single
/// precision leaves of the smallest.
const ROUNDING: f64 = 1e-10;

/// Mirror, sensor and controller of a loop without turbulence. Clones are independent of each
/// other.
#[derive(Clone)]
pub struct LoopAtRest {
    correction: CorrectionLoop,
    residual_nm: AlignedBuffer,
}

impl From<Simulator> for LoopAtRest {
    fn from(simulator: Simulator) -> Self {
        Self { correction: simulator.correction, residual_nm: simulator.residual_nm }
    }
}

impl LoopAtRest {
    /// The illuminated part of the simulator's grid.
    pub fn footprint(&self) -> &Footprint {
        &self.correction.footprint
    }

    /// Number of actuators.
    pub fn actuators(&self) -> usize {
        self.correction.surface.actuators()
    }

    /// Holds the mirror at these commands, nm, as if they had been on it in every frame before.
    pub fn hold(&mut self, commands_nm: ArrayView1<f64>) {
        self.correction.controller.hold(commands_nm);
    }

    /// Commands of the mirror at rest behind the wavefront `opd_nm`, a map over the footprint, from
    /// those that it holds. No command changes by `still_nm` or more in a frame; at a gain of 0.3
    /// the remaining change is three times that.
    ///
    /// # Errors
    /// [`Error::Shape`] for a map of another size; [`Error::Internal`] for commands that are not
    /// finite.
    pub fn commands_nm(&mut self, opd_nm: &[f32], still_nm: f64) -> Result<Array1<f64>> {
        let mut commands_nm = as_f64(self.correction.controller.commands_nm());
        let mut extrapolation = Extrapolation::default();
        // The commands that changed least, for a mirror that still moves at the end.
        let mut best = (f64::INFINITY, commands_nm.clone());
        for _ in 0..MAX_FRAMES {
            let next_nm = self.next_commands_nm(opd_nm, &commands_nm)?;
            let change_nm = &next_nm - &commands_nm;
            let largest_nm = change_nm.iter().fold(0.0, |largest: f64, nm| largest.max(nm.abs()));
            if !change_nm.iter().all(|nm| nm.is_finite()) {
                return Err(Error::Internal("commands of the mirror at rest are not finite".into()));
            }
            if largest_nm < best.0 {
                best = (largest_nm, next_nm.clone());
            }
            if largest_nm < still_nm {
                break;
            }
            commands_nm = extrapolation.next(next_nm, change_nm)?;
        }
        Ok(best.1)
    }

    /// Commands that a frame behind `opd_nm` leads to, with `commands_nm` on the mirror in it and
    /// in those before.
    fn next_commands_nm(&mut self, opd_nm: &[f32], commands_nm: &Array1<f64>) -> Result<Array1<f64>> {
        if opd_nm.len() != self.residual_nm.len() {
            let (given, needed) = (opd_nm.len(), self.residual_nm.len());
            return Err(Error::Shape(format!("a map of {given} samples was given; {needed} are needed")));
        }
        self.correction.controller.hold(commands_nm.view());
        self.residual_nm.copy_from_slice(opd_nm);
        self.correction.step(&mut self.residual_nm)?;
        Ok(as_f64(self.correction.controller.newest_nm()))
    }
}

fn as_f64(values: &[f32]) -> Array1<f64> {
    values.iter().map(|&value| f64::from(value)).collect()
}

/// Anderson acceleration of a fixed-point iteration.
#[derive(Default)]
struct Extrapolation {
    /// Result of the last frame and its change of the commands.
    last: Option<(Array1<f64>, Array1<f64>)>,
    /// Differences of results and of changes from frame to frame.
    differences: VecDeque<(Array1<f64>, Array1<f64>)>,
}

impl Extrapolation {
    /// Next commands, from those that a frame led to and its change of them.
    fn next(&mut self, result: Array1<f64>, change: Array1<f64>) -> Result<Array1<f64>> {
        if let Some((result_before, change_before)) = self.last.take() {
            self.differences.push_back((&result - &result_before, &change - &change_before));
            if self.differences.len() > DEPTH {
                self.differences.pop_front();
            }
        }
        let count = self.differences.len();
        let mut next = result.clone();
        if count > 0 {
            // Least squares: the combination of differences that cancels the change.
            let dot = |i: usize, j: usize| self.differences[i].1.dot(&self.differences[j].1);
            let mut normal = Array2::from_shape_fn((count, count), |(i, j)| dot(i, j));
            let rounding = ROUNDING * normal.diag().iter().copied().fold(f64::MIN_POSITIVE, f64::max);
            normal.diag_mut().iter_mut().for_each(|square| *square += rounding);
            let right_side: Array1<f64> =
                self.differences.iter().map(|(_, of_change)| of_change.dot(&change)).collect();
            for (share, (of_result, _)) in
                SpdInverse::new(&normal)?.inverse.dot(&right_side).iter().zip(&self.differences)
            {
                next.scaled_add(-share, of_result);
            }
        }
        self.last = Some((result, change));
        Ok(next)
    }
}

#[cfg(test)]
mod tests {
    use super::LoopAtRest;
    use crate::ao::testing::small;
    use crate::ao::{Simulator, undisturb};

    #[test]
    #[ignore = "merge: 2 s"]
    fn the_mirror_is_that_of_a_long_simulation() {
        let laws: [&[(&str, &str)]; 5] = [
            &[],
            &[("control.lag_frames", "2.6"), ("control.gain", "0.2")],
            &[("control.filtered_modes", ""), ("control.reconstructor", "sparse")],
            &[("control.loop", "pseudo-open-loop"), ("control.leak", "0.01")],
            &[("wavefront_sensor.mask", "segments"), ("control.fill", "inpaint")],
        ];
        for law in laws {
            let scene = small("", law).system().with(undisturb).unwrap();
            let simulator = Simulator::new(&scene).unwrap();
            let pupil = simulator.pupil();
            let stride = simulator.footprint().stride();
            let mut opd_nm = simulator.footprint().zeros();
            // 40 nm of piston on one side of the pupil.
            for (y, x) in (0..pupil.grid.samples()).flat_map(|y| (0..pupil.grid.samples() / 2).map(move |x| (y, x))) {
                opd_nm[y * stride + x] = 40.0;
            }
            let mut at_rest = LoopAtRest::from(simulator);
            let found_nm = at_rest.commands_nm(&opd_nm, 1e-3).unwrap();
            let frames = at_rest.correction.number;
            let mut long = Simulator::new(&scene).unwrap();
            let mut expected_nm = Vec::new();
            for _ in 0..2000 {
                expected_nm = long.step_with_opd(&opd_nm).unwrap().commands_nm.to_vec();
            }
            let square = |values: &mut dyn Iterator<Item = f64>| values.map(|nm| nm * nm).sum::<f64>();
            let off = square(&mut found_nm.iter().zip(&expected_nm).map(|(found, nm)| found - f64::from(*nm)));
            let ratio = (off / square(&mut found_nm.iter().copied())).sqrt();
            println!("{law:?}: {frames} frames, {ratio:.1e}");
            // At rest a command moves by 1e-3 nm a frame, 0.01 nm of some 20 from its end with a
            // gain of 0.1 or more. Plain steps of a gain of 0.2 take 60 frames and more to 1e-3 nm.
            assert!(ratio < 1e-3 && frames < 50, "{law:?}: {ratio}, {frames}");
        }
    }
}
