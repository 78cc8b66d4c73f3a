//! A run: the loop is closed until all images of the scene are taken, on three threads.
//!
//! ```text
//! turbulence thread ─ batches of frames ─> caller's thread: loop ─ residual wavefronts ─> detector thread
//!                   <─ empty batches ────                        <─ images ───────────────
//! ```
//!
//! Each thread draws from its own random number streams, so the result does not depend on their
//! timing.

use super::atmosphere::Atmosphere;
use super::detector::Detector;
use super::divergence::DivergenceMonitor;
use super::exposure::DetectorThread;
use super::loop_run::{Batch, LoopRun};
use super::profile::LoopStage;
use super::recorder::{Recorder, Summary};
use super::schedule::Schedule;
use super::simulator::{Simulator, sections};
use crate::control::Control;
use crate::{Error, Result};
use std::sync::mpsc::{Receiver, SyncSender, channel, sync_channel};
use std::time::{Duration, Instant};

/// Frames of turbulence in a batch: enough to make the exchange between threads cheap, few enough
/// to fit the cache.
const BATCH: usize = 8;
/// Batches in circulation.
const BATCHES: usize = 3;
/// Wavefronts that may queue for the detector thread.
const WAITING: usize = 32;

impl Simulator {
    /// Closes the loop until the scene's images are taken, or the loop diverges.
    ///
    /// The run starts at the simulator's present frame, and its times count from there. After a run
    /// that stopped early, the turbulence may be some frames ahead of the loop.
    ///
    /// # Errors
    /// [`Error::Interrupted`] where `control` was cancelled; the errors of `recorder` and of the
    /// camera.
    pub fn run(&mut self, recorder: &mut dyn Recorder, control: &Control) -> Result<Summary> {
        let started = Instant::now();
        let scene = self.scene().clone();
        let (sensing, controller) = sections(&scene)?;
        let schedule = Schedule::new(&scene, controller.settle_s, controller.frame_rate_hz)?;
        let frames = schedule.frames();
        let detectors = Detector::all(self)?;
        let flux_e = detectors.iter().map(|detector| detector.flux_e).collect();
        let footprint = self.correction.footprint.clone();
        let detector = DetectorThread {
            detectors,
            drift: self.correction.drift.clone(),
            wavelength_nm: scene.image.wavelength_nm,
            footprint: footprint.clone(),
            first_frame: self.correction.number,
        };
        let before = self.correction.profile;
        let monitor = DivergenceMonitor::new(self.frame_s(), sensing.wavelength_nm, self.stability());
        let (atmosphere, correction) = (&mut self.atmosphere, &mut self.correction);
        let mut run = LoopRun::new(correction, schedule, monitor, recorder);
        let (turbulence_time, exposed) = std::thread::scope(|scope| {
            let (full, ready) = sync_channel(BATCHES);
            let (empty, back) = sync_channel(BATCHES);
            for _ in 0..BATCHES {
                // Cannot fail: the channel holds all of them, and its receiver exists.
                let _ = empty.send((0..BATCH).map(|_| footprint.zeros()).collect());
            }
            let turbulence = scope.spawn(move || make_turbulence(atmosphere, frames, &full, &back));
            let (exposed, wavefronts) = sync_channel(WAITING);
            let (images, finished) = channel();
            let camera = scope.spawn(move || detector.run(&wavefronts, &images));
            // Both threads end when `close` returns, with or without an error, and drops their
            // channels.
            let outcome = run.close(ready, empty, exposed, &finished, control);
            let turbulence = turbulence.join().map_err(|_| Error::Internal("the turbulence thread panicked".into()));
            let camera = camera.join().map_err(|_| Error::Internal("the detector thread panicked".into()));
            // An error of the turbulence also stops the loop: it is the cause, so it is returned
            // first.
            let turbulence = turbulence??;
            outcome?;
            run.collect(&finished)?;
            Ok::<_, Error>((turbulence, camera?))
        })?;
        let LoopRun { divergence, settled, square_nm2, strehl_marechal, finished, frame, .. } = run;
        self.correction.profile.add(LoopStage::Atmosphere, turbulence_time);
        Ok(Summary {
            frames: frame,
            images: finished,
            seconds: started.elapsed().as_secs_f64(),
            residual_rms_nm: (square_nm2 / settled).sqrt(),
            strehl: exposed.strehl,
            strehl_marechal: strehl_marechal / settled,
            flux_e,
            divergence,
            profile: self.correction.profile.since(&before),
            camera_s: exposed.spent.as_secs_f64(),
        })
    }
}

/// Makes the turbulence of `frames` frames, or fewer if a channel closes; returns the time it took.
fn make_turbulence(
    atmosphere: &mut Atmosphere,
    frames: u64,
    full: &SyncSender<Batch>,
    back: &Receiver<Batch>,
) -> Result<Duration> {
    let mut spent = Duration::ZERO;
    let mut made = 0;
    while made < frames {
        let Ok(mut batch) = back.recv() else { break };
        let started = Instant::now();
        // No frame beyond the run's last: the next run starts with the turbulence after it.
        let wanted = (frames - made).min(BATCH as u64);
        batch.iter_mut().take(wanted as usize).try_for_each(|opd_nm| atmosphere.next_frame(opd_nm))?;
        spent += started.elapsed();
        made += wanted;
        if full.send(batch).is_err() {
            break;
        }
    }
    Ok(spent)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ao::Shot;
    use crate::ao::testing::small;
    use crate::scene::Scene;

    /// Two channels that differ in nothing but their names.
    const EQUAL: &str = "name = \"a\"\n[[image.channel]]\nname = \"b\"\n";
    /// Exposures of three frames, with segments and NCPA that drift.
    const MOVING: [(&str, &str); 3] =
        [("image.exposure_s", "0.003"), ("image.count", "2"), ("faults.drift_nm_per_min", "1e5")];
    /// A star without noise.
    const QUIET: [(&str, &str); 3] =
        [("image.photon_noise", "false"), ("image.read_noise_e", "0"), ("image.flux_e", "1e6")];

    fn run(scene: &Scene) -> (Vec<Shot>, Summary) {
        let mut shots: Vec<Shot> = Vec::new();
        let summary = Simulator::new(scene).unwrap().run(&mut shots, &Control::default()).unwrap();
        (shots, summary)
    }

    fn order(shots: &[Shot]) -> Vec<(usize, usize)> {
        shots.iter().map(|shot| (shot.channel, shot.image)).collect()
    }

    fn has_same_telemetry(one: &Shot, other: &Shot) -> bool {
        let of = |shot: &Shot| {
            let slopes_mas = [&shot.slopes_mas, &shot.mean_slopes_mas].map(Vec::clone);
            (shot.time_s, slopes_mas, shot.commands_nm.clone(), shot.residual_rms_nm)
        };
        of(one) == of(other)
    }

    #[test]
    fn simultaneous_channels_share_wavefronts_but_not_noise() {
        let both = ("image.simultaneous", "true");
        for is_quiet in [true, false] {
            let noise = if is_quiet { QUIET.as_slice() } else { &QUIET[2..] };
            let settings = [&MOVING, noise].concat();
            let (alone, of_one) = run(&small("", &settings));
            let (shots, of_both) = run(&small(EQUAL, &[&settings[..], &[both]].concat()));
            assert_eq!(order(&shots), [(0, 0), (1, 0), (0, 1), (1, 1)]);
            assert_eq!((of_both.images, of_both.frames), (4, of_one.frames));
            assert_eq!((of_both.flux_e, of_both.strehl), (vec![1e6, 1e6], of_one.strehl));
            for (pair, alone) in shots.chunks(2).zip(&alone) {
                assert!(pair.iter().all(|shot| has_same_telemetry(shot, alone)));
                // The first channel has the noise of a scene without channels.
                assert!(pair[0].image_e == alone.image_e && alone.image_e.iter().any(|&e| e > 1000.0));
                assert_eq!(pair[1].image_e == alone.image_e, is_quiet);
            }
        }
    }

    #[test]
    fn successive_channels_are_one_run_of_the_loop() {
        let settings = [MOVING.as_slice(), &QUIET].concat();
        let (shots, summary) = run(&small(EQUAL, &settings));
        assert_eq!(order(&shots), [(0, 0), (0, 1), (1, 0), (1, 1)]);
        // Those of one channel with all images: the same wavefronts, with the same drift.
        let (alone, of_one) = run(&small("", &[&settings[..], &[("image.count", "4")]].concat()));
        assert_eq!((summary.images, summary.frames), (4, of_one.frames));
        for (shot, alone) in shots.iter().zip(&alone) {
            assert!(has_same_telemetry(shot, alone) && shot.image_e == alone.image_e);
        }
        let [last, next] = [&shots[1], &shots[2]];
        assert!((next.time_s - last.time_s - 0.01).abs() < 1e-3, "{} {}", last.time_s, next.time_s);
        assert!(last.image_e != next.image_e && last.mean_slopes_mas != next.mean_slopes_mas);
    }

    #[test]
    fn a_channel_has_its_own_camera_and_star() {
        let channels = "name = \"K\"\n[[image.channel]]\nname = \"H\"\nwavelength_nm = 1640.0\nsamples_per_lambda_over_d = 2\nbandwidth_fraction = 0.05\n\
                        diversity_focus_waves_rms = -0.8\nrows = 36\ncolumns = 40\npeak_snr = 50.0\npixel_fill = 0.9\n";
        let settings = [("image.simultaneous", "true"), ("image.photon_noise", "false")];
        let scene = small(channels, &settings).with_override("image.exposure_s", "0.003").unwrap();
        let (shots, summary) = run(&scene);
        for (number, (shot, channel)) in shots.iter().zip(scene.channels()).enumerate() {
            let (alone, of_one) = run(&channel.scene);
            assert_eq!(summary.flux_e[number], of_one.flux_e[0]);
            assert_eq!(shot.image_e.dim(), channel.scene.image.frame_shape());
            // Read noise of 20 electrons in each of two images.
            let rms_e = ((&shot.image_e - &alone[0].image_e).mapv(|e| e * e).mean().unwrap() / 2.0).sqrt();
            let expected_e = if number == 0 { 0.0 } else { 20.0 };
            assert!((rms_e - expected_e).abs() < 2.0, "{rms_e}");
        }
        assert_eq!(shots.len(), 2);
    }

    #[test]
    #[ignore = "merge: 4 s"]
    fn a_sparse_reconstructor_has_the_strehl_ratio_of_the_dense_one() {
        // Keck's loop with its noise on the same turbulence.
        let settings = [("control.settle_s", "0.2"), ("image.count", "20"), ("image.interval_s", "0.02")];
        let preset = Scene::preset("keck-onsky").unwrap().with(&settings).unwrap();
        for r#loop in ["closed", "pseudo-open-loop"] {
            let dense = preset.with(&[("control.loop", r#loop)]).unwrap();
            let sparse = dense.with(&[("control.filtered_modes", ""), ("control.reconstructor", "sparse")]).unwrap();
            let [dense, sparse] = [dense, sparse].map(|scene| run(&scene).1);
            println!("{}: {:.4} {:.4}", r#loop, dense.strehl_marechal, sparse.strehl_marechal);
            // The same loop but for a handful of weak modes, in which the regularisation may save a
            // little noise. It must not cost half of the 1 % by which a user would see it.
            let ratio = sparse.strehl_marechal / dense.strehl_marechal;
            assert!(sparse.divergence.is_none() && (0.995..1.02).contains(&ratio), "{}: {ratio}", r#loop);
        }
    }
}
