//! Loop that the caller advances frame by frame, with an image of the present frame: the simulator
//! of the C, MATLAB and Python interfaces.

use super::correction::LoopFrame;
use super::detector::Detector;
use super::divergence::{Divergence, DivergenceMonitor};
use super::simulator::{Simulator, sections};
use crate::scene::System;
use crate::{Error, Result};
use ndarray::Array2;

/// First random number stream of the noise of images of single frames, under the seed of the
/// turbulence. Each frame has a stream of its own, so that an image does not depend on the other
/// images taken. The streams below are those of the layers, of the sensor and of a run's camera.
const FRAME_STREAM: u64 = 3 << 32;

/// Simulator with a science camera, on one thread. For a whole run, [`Simulator::run`] is faster:
/// it uses three threads.
pub struct Stepper {
    simulator: Simulator,
    detector: Detector,
    monitor: DivergenceMonitor,
    divergence: Option<Divergence>,
}

impl Stepper {
    /// Builds the system of `scene`, before its first frame.
    ///
    /// # Errors
    /// Those of [`Simulator::new`] and of its camera; [`Error::Scene`] for a scene with channels.
    pub fn new(scene: &System) -> Result<Self> {
        let (sensing, _) = sections(scene)?;
        scene.refuse_channels("steps of the AO simulator")?;
        let simulator = Simulator::new(scene)?;
        let Some(detector) = Detector::all(&simulator)?.pop() else {
            return Err(Error::Internal("a simulator without a channel".into()));
        };
        let monitor = DivergenceMonitor::new(simulator.frame_s(), sensing.wavelength_nm, simulator.stability());
        Ok(Self { simulator, detector, monitor, divergence: None })
    }

    /// Advances the loop by `frames` frames. A loop that diverges is not stopped: see
    /// [`Stepper::divergence`].
    ///
    /// # Errors
    /// As [`Simulator::step`].
    pub fn step(&mut self, frames: u64) -> Result<()> {
        for _ in 0..frames {
            let residual_rms_nm = self.simulator.step()?.residual_rms_nm;
            let divergence = self.monitor.update(residual_rms_nm);
            self.divergence = self.divergence.or(divergence);
        }
        Ok(())
    }

    /// The last frame.
    ///
    /// # Errors
    /// [`Error::Value`] before the first frame.
    pub fn last(&self) -> Result<LoopFrame<'_>> {
        if self.simulator.frames() == 0 {
            return Err(Error::Value("0 frames have been simulated; at least 1 is needed: step first".into()));
        }
        Ok(self.simulator.correction.last(&self.simulator.residual_nm))
    }

    /// The residual wavefront of the last frame on the simulator's grid, nm, `[y, x]`; NaN outside
    /// the pupil.
    ///
    /// # Errors
    /// As [`Stepper::last`].
    pub fn residual_nm(&self) -> Result<Array2<f32>> {
        let (frame, footprint) = (self.last()?, self.simulator.footprint());
        let (n, stride) = (footprint.samples(), footprint.stride());
        Ok(Array2::from_shape_fn((n, n), |(y, x)| {
            let place = y * stride + x;
            if footprint.amplitude()[place] > 0.0 { frame.residual_nm[place] } else { f32::NAN }
        }))
    }

    /// The scene's defocused image of the last frame, with frozen turbulence and the noise that the
    /// scene names, `[y, x]`, electrons. The same frame gives the same image.
    ///
    /// # Errors
    /// As [`Stepper::last`].
    pub fn image_e(&mut self) -> Result<Array2<f32>> {
        let number = self.last()?.number;
        let mut residual_nm = self.simulator.residual_nm.clone();
        if let Some(drift) = &self.simulator.correction.drift {
            drift.add_ncpa(number, &mut residual_nm);
        }
        let psf = self.detector.camera.psf(&residual_nm);
        Ok(self.detector.image_e(psf, FRAME_STREAM + number))
    }

    /// The first divergence of the loop; `None` if it has not diverged.
    pub fn divergence(&self) -> Option<Divergence> {
        self.divergence
    }

    /// The system.
    pub fn simulator(&self) -> &Simulator {
        &self.simulator
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ao::Shot;
    use crate::ao::testing::small;
    use crate::control::Control;
    use crate::scene::Scene;

    fn scene(settings: &[(&str, &str)]) -> Scene {
        small("", settings)
    }

    #[test]
    fn images_and_telemetry_of_a_frame_equal_those_of_a_run() {
        // Without the noise of the camera, whose streams differ. Everything else is equal to the
        // last bit.
        let quiet = scene(&[
            ("image.photon_noise", "false"),
            ("image.read_noise_e", "0.0"),
            ("image.flux_e", "1e6"),
            ("image.exposure_s", "0.0"),
            ("image.count", "2"),
        ]);
        let mut shots: Vec<Shot> = Vec::new();
        Simulator::new(&quiet).unwrap().run(&mut shots, &Control::default()).unwrap();
        let mut stepper = Stepper::new(&quiet).unwrap();
        assert_eq!(shots.len(), 2);
        for shot in shots {
            let frame = (shot.time_s / stepper.simulator().frame_s()).round() as u64;
            stepper.step(frame + 1 - stepper.simulator().frames()).unwrap();
            assert_eq!(stepper.image_e().unwrap(), shot.image_e);
            let last = stepper.last().unwrap();
            assert_eq!((last.number, last.residual_rms_nm), (frame, shot.residual_rms_nm));
            assert_eq!((last.slopes_mas, last.commands_nm), (&shot.slopes_mas[..], &shot.commands_nm[..]));
        }
    }

    #[test]
    fn a_scene_with_channels_is_refused() {
        match Stepper::new(&small("name = \"a\"\n", &[])).map(drop) {
            Err(Error::Scene(reason)) => {
                assert!(reason.contains("AO simulator") && reason.contains("one channel"), "{reason}");
            }
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn an_image_has_its_own_noise_and_does_not_change_later_frames() {
        let (mut watched, mut alone) = (Stepper::new(&scene(&[])).unwrap(), Stepper::new(&scene(&[])).unwrap());
        assert!(watched.image_e().is_err() && watched.residual_nm().is_err() && watched.last().is_err());
        watched.step(3).unwrap();
        let third = watched.image_e().unwrap();
        assert_eq!(watched.image_e().unwrap(), third);
        watched.step(2).unwrap();
        alone.step(5).unwrap();
        assert_ne!(watched.image_e().unwrap(), third);
        assert_eq!(watched.image_e().unwrap(), alone.image_e().unwrap());
        assert_eq!(watched.last().unwrap().slopes_mas, alone.last().unwrap().slopes_mas);
    }

    #[test]
    fn an_unstable_loop_diverges_once_and_is_not_stopped() {
        // Two frames of lag are stable up to a gain of 1; without a stroke limit the commands grow
        // without bound.
        let mut unstable = Stepper::new(&scene(&[("control.gain", "2.0"), ("control.lag_frames", "2")])).unwrap();
        unstable.step(2000).unwrap();
        let first = unstable.divergence().unwrap();
        unstable.step(2000).unwrap();
        assert_eq!(unstable.divergence(), Some(first));
        assert!(!unstable.simulator().stability().stable);
        unstable.image_e().unwrap();
        let mut stable = Stepper::new(&scene(&[])).unwrap();
        stable.step(2000).unwrap();
        assert_eq!(stable.divergence(), None);
    }
}
