//! The loop, advanced by hand, with an image of whatever frame it stands at: what C, MATLAB and Python drive.

use super::camera::{ScienceCamera, View};
use super::divergence::{Divergence, Watch};
use super::simulator::{Frame, Simulator, sections};
use crate::scene::Scene;
use crate::source::{Pixels, expose, flux_e, stream};
use crate::{Error, Result};
use ndarray::Array2;

/// First stream of the noise of images of single frames under the seed of the turbulence; one for each frame, so that
/// an image does not depend on which others were taken. Below it lie the layers', the sensor's and a run's camera's.
const FRAME_STREAM: u64 = 3 << 32;

/// A simulator with a camera that stands ready, on one thread. Where a whole run is wanted, [`Simulator::run`] uses every
/// core.
pub struct Stepper {
    simulator: Simulator,
    camera: ScienceCamera,
    pixels: Pixels,
    flux_e: f64,
    watch: Watch,
    divergence: Option<Divergence>,
}

impl Stepper {
    /// The system of `scene`, before its first frame.
    ///
    /// # Errors
    /// Those of [`Simulator::new`] and of its camera.
    pub fn new(scene: &Scene) -> Result<Self> {
        let (sensing, _) = sections(scene)?;
        let simulator = Simulator::new(scene)?;
        let mut camera = simulator.camera(View::of(&scene.image))?;
        // As in a run: the star's flux is that of the static aberrations alone.
        let pixels = Pixels::of(scene);
        let peak = pixels.see(camera.psf(simulator.segments_nm()).mapv(f64::from)).fold(0.0, |a: f64, &b| a.max(b));
        let flux_e = flux_e(&scene.image, peak);
        let watch = Watch::new(simulator.frame_s(), sensing.wavelength_nm, simulator.stability());
        Ok(Self { simulator, camera, pixels, flux_e, watch, divergence: None })
    }

    /// Advances the loop by `frames` frames. A loop that diverges goes on: see [`Stepper::divergence`].
    ///
    /// # Errors
    /// As [`Simulator::step`].
    pub fn step(&mut self, frames: u64) -> Result<()> {
        for _ in 0..frames {
            let residual_rms_nm = self.simulator.step()?.residual_rms_nm;
            let seen = self.watch.see(residual_rms_nm);
            self.divergence = self.divergence.or(seen);
        }
        Ok(())
    }

    /// The frame that was made last.
    ///
    /// # Errors
    /// [`Error::Value`] before the first one.
    pub fn last(&self) -> Result<Frame<'_>> {
        if self.simulator.frames() == 0 {
            return Err(Error::Value("0 frames have been made, and at least 1 is needed: step first".into()));
        }
        Ok(self.simulator.plant.last(&self.simulator.residual_nm))
    }

    /// The residual wavefront of that frame on the simulator's grid, nm, `[y, x]`; NaN where the pupil has no light.
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

    /// The scene's defocused image of that frame, its turbulence frozen, `[y, x]`, electrons, with the noise that the
    /// scene names. The same frame gives the same image.
    ///
    /// # Errors
    /// As [`Stepper::last`].
    pub fn image_e(&mut self) -> Result<Array2<f32>> {
        let number = self.last()?.number;
        let mut residual_nm = self.simulator.residual_nm.clone();
        if let Some(drift) = &self.simulator.plant.drift {
            drift.add_ncpa(number, &mut residual_nm);
        }
        let psf = self.pixels.see(self.camera.psf(&residual_nm).mapv(f64::from));
        let scene = self.simulator.scene();
        let mut rng = stream(scene.turbulence.seed, FRAME_STREAM + number);
        Ok(psf.mapv(|h| expose(&scene.image, h, self.flux_e, &mut rng) as f32))
    }

    /// When the loop ran away, if it has.
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
    use crate::ao::{Progress, Shot};

    fn scene(settings: &[(&str, &str)]) -> Scene {
        let small = include_str!("../../tests/c_api/small.toml");
        Scene::from_text(small, "".as_ref()).unwrap().with(settings).unwrap()
    }

    #[test]
    fn a_frame_looks_as_it_does_in_a_run() {
        // Without noise in the camera, whose random numbers differ: everything else is the same to the last bit.
        let quiet = scene(&[
            ("image.photon_noise", "false"),
            ("image.read_noise_e", "0.0"),
            ("image.exposure_s", "0.0"),
            ("image.count", "2"),
        ]);
        let mut shots: Vec<Shot> = Vec::new();
        Simulator::new(&quiet).unwrap().run(&mut shots, &mut Progress::default()).unwrap();
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
    fn an_image_has_its_own_noise_and_disturbs_nothing() {
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
    fn a_loop_past_its_margin_diverges_once_and_goes_on() {
        // Two frames of lag are stable up to a gain of 1; without a stroke limit the commands grow past every bound.
        let mut lost = Stepper::new(&scene(&[("control.gain", "2.0"), ("control.lag_frames", "2")])).unwrap();
        lost.step(2000).unwrap();
        let noticed = lost.divergence().unwrap();
        lost.step(2000).unwrap();
        assert_eq!(lost.divergence(), Some(noticed));
        assert!(!lost.simulator().stability().stable);
        lost.image_e().unwrap();
        let mut held = Stepper::new(&scene(&[])).unwrap();
        held.step(2000).unwrap();
        assert_eq!(held.divergence(), None);
    }
}
