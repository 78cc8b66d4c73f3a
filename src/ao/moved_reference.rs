//! A loop whose reference slopes were moved, as a correction of the NCPA moves them: the loop
//! itself then puts the correction on the mirror.

use super::Simulator;
use super::simulator::sections;
use super::undisturbed::take_noise;
use crate::modes::SmoothBasis;
use crate::scene::System;
use crate::source::Truth;
use crate::telescope::Telescope;
use crate::{Error, Result};
use ndarray::{Array1, ArrayView1};

/// How long the mirror's commands are averaged after the loop has settled, s. Only the difference
/// of two loops behind the same turbulence counts, in which the turbulence cancels; but the gain of
/// each spot changes with it, by which reference slopes of 72 nm of NCPA move Keck's mirror by 5 nm
/// RMS in means over 0.25 s, by 1.6 nm over 3 s, and by 0.9 nm in these (as the root of the time).
const AVERAGED_S: f64 = 10.0;

impl Simulator {
    /// The system of `scene` with the aberrations of `truth`, its loop settled about reference
    /// slopes that are further by `moved_mas` (`[all x, all y]`) than those of the scene.
    ///
    /// The mirror then differs by a constant shape, found by simulating the loop with and without
    /// the move: blurred spots change less than sharp ones, so the mirror moves further than a
    /// calibration without turbulence expects. [`Simulator::truth`] is what this leaves on the
    /// camera's path. Slopes are relative to the moved reference.
    ///
    /// # Errors
    /// [`Error::Shape`] for another number of slopes; as [`Simulator::with_truth`].
    pub fn with_moved_reference(scene: &System, telescope: Telescope, truth: Truth, moved_mas: &[f64]) -> Result<Self> {
        // Noise would not cancel: other spots make other draws of it.
        let noise_free = scene.with(take_noise)?;
        let build = |scene: &System| Self::with_truth(scene, telescope.clone(), truth.clone());
        let plain_nm = build(&noise_free)?.settled_commands_nm()?;
        let mut probe = build(&noise_free)?;
        probe.move_reference(moved_mas)?;
        let shift_nm = probe.settled_commands_nm()? - plain_nm;
        drop(probe);
        let mut simulator = build(scene)?;
        simulator.move_reference(moved_mas)?;
        simulator.correction.controller.hold(shift_nm.view());
        let on_camera_nm = shift_nm.iter().map(|nm| -nm).collect();
        let mirror = SmoothBasis::influence(simulator.influence.clone());
        simulator.seen_truth = Some(truth.with_added_ncpa(&telescope, mirror, on_camera_nm)?);
        Ok(simulator)
    }

    /// By how much corrections have moved the reference slopes, `[all x, all y]`, mas; `None` where
    /// they have not.
    pub fn moved_reference_mas(&self) -> Option<ArrayView1<'_, f64>> {
        Some(ArrayView1::from(&self.moved_reference_mas)).filter(|moved_mas| !moved_mas.is_empty())
    }

    fn move_reference(&mut self, moved_mas: &[f64]) -> Result<()> {
        let (given, needed) = (moved_mas.len(), self.correction.sensor.slopes());
        if given != needed {
            return Err(Error::Shape(format!("{given} reference slopes were given for a sensor of {needed} slopes")));
        }
        let reference_mas = &mut self.correction.reference_mas;
        reference_mas.resize(needed, 0.0);
        reference_mas.iter_mut().zip(moved_mas).for_each(|(reference, moved)| *reference += *moved as f32);
        self.moved_reference_mas = moved_mas.to_vec();
        Ok(())
    }

    /// Mean of the commands after the loop has settled, nm.
    fn settled_commands_nm(&mut self) -> Result<Array1<f64>> {
        let settle_s = sections(&self.scene)?.1.settle_s;
        let frames = |seconds: f64| (seconds / self.frame_s()).ceil() as usize;
        let (settling, averaged) = (frames(settle_s), frames(AVERAGED_S).max(1));
        let mut sum_nm = Array1::zeros(self.influence.len());
        for frame in 0..settling + averaged {
            let commands_nm = self.step()?.commands_nm;
            if frame >= settling {
                sum_nm.iter_mut().zip(commands_nm).for_each(|(sum, nm)| *sum += f64::from(*nm));
            }
        }
        Ok(sum_nm / averaged as f64)
    }
}

#[cfg(test)]
mod tests {
    use crate::ao::testing::small;
    use crate::ao::{Simulator, View, undisturb};
    use crate::scene::System;
    use crate::source::{Truth, stream};
    use crate::telescope::Telescope;
    use ndarray::{Array1, Array2};

    /// Shape of 15 nm RMS per actuator over the aperture: focus.
    fn shape_nm(simulator: &Simulator) -> Array1<f64> {
        let places = simulator.influence().positions_m();
        let squares: Vec<f64> = places.iter().map(|(x_m, y_m)| x_m * x_m + y_m * y_m).collect();
        let mean = squares.iter().sum::<f64>() / squares.len() as f64;
        let shape: Array1<f64> = squares.iter().map(|square| square - mean).collect();
        let rms = (shape.dot(&shape) / shape.len() as f64).sqrt();
        shape * (15.0 / rms)
    }

    fn moved(scene: &System) -> (Simulator, Simulator, Array1<f64>) {
        let plain = Simulator::new(scene).unwrap();
        let commands_nm = shape_nm(&plain);
        let moved_mas = plain.interaction().dot(&commands_nm).mapv(|mas| -mas).to_vec();
        let telescope = Telescope::new(scene).unwrap();
        let truth = Truth::draw(scene, &telescope, &mut stream(3, 0)).unwrap();
        let system = Simulator::with_moved_reference(scene, telescope, truth, &moved_mas).unwrap();
        (plain, system, commands_nm)
    }

    /// Least-squares amplitude of the surface of `commands_nm` in what the truth of `system` has
    /// lost.
    fn amplitude(plain: &Simulator, system: &Simulator, commands_nm: &Array1<f64>) -> f64 {
        let pupil = &plain.telescope().pupil;
        let lit: Vec<(usize, usize)> = pupil.owned_samples().map(|(at, _)| at).collect();
        let place = |k: usize| pupil.grid.coordinate_m(k);
        let (xs_m, ys_m): (Vec<f64>, Vec<f64>) = lit.iter().map(|&(y, x)| (place(x), place(y))).unzip();
        let surface_nm = commands_nm.dot(&plain.influence().evaluate(&xs_m, &ys_m).unwrap());
        let surface_nm = &surface_nm - surface_nm.mean().unwrap();
        let lost: Array1<f64> = lit.iter().map(|&at| plain.truth().ncpa_nm[at] - system.truth().ncpa_nm[at]).collect();
        lost.dot(&surface_nm) / surface_nm.dot(&surface_nm)
    }

    #[test]
    fn mirror_takes_the_sent_shape_and_the_camera_images_it() {
        // Steps between segments would lower the gain of the quad cells that see them, by some 5 %
        // in all.
        let even = ["aberrations.segment_piston_rms_nm", "aberrations.segment_tip_tilt_rms_nm"].map(|key| (key, "0"));
        let scene = small("", &even).system().with(undisturb).unwrap();
        let (plain, mut system, commands_nm) = moved(&scene);
        let found = amplitude(&plain, &system, &commands_nm);
        println!("undisturbed: {found:.4} of what was sent");
        // The loop controls focus, with singular values that are filtered left out.
        assert!((found - 1.0).abs() < 0.02, "{found}");
        let view = View {
            segments: true,
            ncpa: true,
            diversity: false,
            wavelength_nm: system.scene().image.wavelength_nm,
            rows: 64,
            columns: 64,
            samples_per_lambda_over_d: 3.0,
            bandwidth_fraction: 0.0,
            spectrum: false,
        };
        // Through the mirror of the running loop, and by the truth alone behind a loop without the
        // move.
        let mut camera = system.camera(view).unwrap();
        let residual_nm = (0..20).map(|_| system.step().unwrap().residual_nm.to_vec()).next_back().unwrap();
        let seen: Array2<f32> = camera.psf(&residual_nm);
        let mut still = Simulator::new(&scene).unwrap();
        let segments_nm = (0..200).map(|_| still.step().unwrap().residual_nm.to_vec()).next_back().unwrap();
        let before = still.camera(view).unwrap().psf(&segments_nm);
        let by_truth = Simulator::with_truth(&scene, system.telescope().clone(), system.truth().clone()).unwrap();
        let expected = by_truth.camera(view).unwrap().psf(&segments_nm);
        let off = |image: &Array2<f32>| (image - &expected).mapv(|v| v * v).sum().sqrt();
        println!("image: off by {:.1e}, by {:.1e} without the move", off(&seen), off(&before));
        // The mirror at the end of the steps is where the probe's mean was.
        assert!(off(&seen) < 0.05 * off(&before), "{} of {}", off(&seen), off(&before));
    }

    #[test]
    fn spots_that_turbulence_blurs_move_the_mirror_further() {
        let (plain, system, commands_nm) = moved(&small("", &[]));
        let found = amplitude(&plain, &system, &commands_nm);
        println!("behind turbulence: {found:.3} of what was sent");
        // 1.85: the slope of a quad cell is the shift over the size of its spot. Sharp spots have
        // 0.99; a move that acted twice would have 3.7.
        assert!((1.5..2.2).contains(&found), "{found}");
    }

    #[test]
    fn another_number_of_slopes_is_refused() {
        let scene = small("", &[]);
        let telescope = Telescope::new(&scene).unwrap();
        let truth = Truth::draw(&scene, &telescope, &mut stream(3, 0)).unwrap();
        let error = Simulator::with_moved_reference(&scene, telescope, truth, &[1.0]).err().unwrap().to_string();
        assert!(error.contains("1 reference slopes") && error.contains("sensor of"), "{error}");
    }
}
