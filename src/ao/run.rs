//! A run: the loop is closed until all images of the scene are taken, on three threads.
//!
//! ```text
//! turbulence thread ─ batches of frames ─> caller's thread: loop ─ residual wavefronts ─> detector thread
//!                   <─ empty batches ────                        <─ images ───────────────
//! ```
//!
//! Each thread draws from its own random number streams, so the result does not depend on their timing.

use super::aligned::AlignedBuffer;
use super::atmosphere::Atmosphere;
use super::camera::View;
use super::divergence::{Divergence, DivergenceMonitor};
use super::exposure::{DetectorThread, ExposedWavefront, FinishedImage};
use super::profile::{Profile, Stage};
use super::schedule::Schedule;
use super::simulator::{CorrectionLoop, Frame, Simulator, sections};
use crate::source::{DetectorPixels, flux_e};
use crate::{Error, Result};
use ndarray::Array2;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, channel, sync_channel};
use std::time::{Duration, Instant};

/// Frames of turbulence in a batch: enough to make the exchange between threads cheap, few enough to fit the cache.
const BATCH: usize = 8;
/// Batches in circulation.
const BATCHES: usize = 3;
/// Wavefronts that may queue for the detector thread.
const WAITING: usize = 32;

/// One image with the telemetry of its exposure.
#[derive(Debug, Clone)]
pub struct Shot {
    /// Its number, from 0.
    pub image: usize,
    /// Middle of the exposure, s since the loop was closed.
    pub time_s: f64,
    /// Electrons, `[y, x]`.
    pub image_e: Array2<f32>,
    /// Slopes in the frame at the middle of the exposure, `[all x, all y]`, mas.
    pub slopes_mas: Vec<f32>,
    /// Mean slopes over the frames of the exposure, mas.
    pub mean_slopes_mas: Vec<f32>,
    /// Commands in that frame, nm.
    pub commands_nm: Vec<f32>,
    /// RMS of the residual wavefront in that frame, nm.
    pub residual_rms_nm: f64,
}

/// Receiver of the frames and images of a run. An error that it returns stops the run.
pub trait Recorder {
    /// Receives every frame, in order.
    ///
    /// # Errors
    /// An error of the implementation; it stops the run.
    fn frame(&mut self, _frame: &Frame) -> Result<()> {
        Ok(())
    }

    /// Receives every image, in order, some time after its last frame.
    ///
    /// # Errors
    /// An error of the implementation; it stops the run.
    fn shot(&mut self, shot: Shot) -> Result<()>;
}

impl Recorder for Vec<Shot> {
    fn shot(&mut self, shot: Shot) -> Result<()> {
        self.push(shot);
        Ok(())
    }
}

/// Statistics of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct Summary {
    /// Frames.
    pub frames: u64,
    /// Images.
    pub images: usize,
    /// Wall-clock time, s.
    pub seconds: f64,
    /// RMS of the residual wavefront over the frames after settling, nm.
    pub residual_rms_nm: f64,
    /// Strehl ratio of a long exposure of the loop's residual at the scene's wavelength, without NCPA and diversity.
    pub strehl: f64,
    /// The same Strehl ratio by Maréchal's approximation from the RMS of every frame after settling.
    pub strehl_marechal: f64,
    /// Electrons of the star in an image.
    pub flux_e: f64,
    /// Divergence of the loop, at which the run stopped; `None` for a run that reached its end.
    pub divergence: Option<Divergence>,
    /// Time in each stage, over all threads.
    pub profile: Profile,
    /// Time of the detector thread, s.
    pub camera_s: f64,
}

impl Summary {
    /// Frames per second of wall-clock time.
    pub fn frames_per_s(&self) -> f64 {
        self.frames as f64 / self.seconds
    }
}

/// Progress report and cancellation of a run.
#[derive(Default)]
pub struct Progress<'a> {
    /// Called with (frames done, frames in all) every `LOOK_EVERY` frames.
    pub watch: Option<&'a mut dyn FnMut(u64, u64)>,
    /// Flag that stops the run when another thread sets it.
    pub cancel: Option<&'a AtomicBool>,
}

/// Frames between two checks of the cancel flag and of finished images.
const LOOK_EVERY: u64 = 128;

impl Simulator {
    /// Closes the loop until the scene's images are taken, or the loop diverges.
    ///
    /// The run starts at the simulator's present frame, and its times count from there. After a run that stopped early,
    /// the turbulence may be some frames ahead of the loop.
    ///
    /// # Errors
    /// [`Error::Interrupted`] if the cancel flag was set; the errors of `recorder` and of the camera.
    pub fn run(&mut self, recorder: &mut dyn Recorder, progress: &mut Progress) -> Result<Summary> {
        let started = Instant::now();
        let scene = self.scene().clone();
        let (sensing, control) = sections(&scene)?;
        let schedule = Schedule::new(&scene, control.settle_s, control.frame_rate_hz);
        let mut camera = self.camera(View::from_scene(&scene.image))?;
        // peak_snr refers to the PSF of the static aberrations alone, so that the flux does not depend on the loop.
        let pixels = DetectorPixels::new(&scene);
        let peak = pixels.apply(camera.psf(self.segments_nm()).mapv(f64::from)).fold(0.0, |a: f64, &b| a.max(b));
        let flux_e = flux_e(&scene.image, peak);
        let footprint = self.correction.footprint.clone();
        let first_frame = self.correction.number;
        let detector = DetectorThread {
            camera,
            pixels,
            drift: self.correction.drift.clone(),
            scene: scene.clone(),
            flux_e,
            footprint: footprint.clone(),
            first_frame,
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
            let turbulence = scope.spawn(move || make_turbulence(atmosphere, schedule.frames(), &full, &back));
            let (exposed, wavefronts) = sync_channel(WAITING);
            let (images, finished) = channel();
            let camera = scope.spawn(move || detector.run(&wavefronts, &images));
            // Both threads end when `close` returns, with or without an error, and drops their channels.
            let outcome = run.close(ready, empty, exposed, &finished, progress);
            let turbulence = turbulence.join().map_err(|_| Error::Internal("the turbulence thread panicked".into()));
            let camera = camera.join().map_err(|_| Error::Internal("the detector thread panicked".into()));
            // An error of the turbulence also stops the loop: it is the cause, so it is returned first.
            let turbulence = turbulence??;
            outcome?;
            run.collect(&finished)?;
            Ok::<_, Error>((turbulence, camera?))
        })?;
        let LoopRun { divergence, settled, square_nm2, strehl_marechal, finished, frame, .. } = run;
        self.correction.profile.add(Stage::Atmosphere, turbulence_time);
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

type Batch = Vec<AlignedBuffer>;

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

/// State of the loop during a run.
struct LoopRun<'a> {
    correction: &'a mut CorrectionLoop,
    schedule: Schedule,
    monitor: DivergenceMonitor,
    recorder: &'a mut dyn Recorder,
    /// Frames so far.
    frame: u64,
    /// Telemetry of exposures whose images are not finished, and the number of images that are.
    waiting: VecDeque<Shot>,
    finished: usize,
    /// Sum of the slopes over the exposure so far.
    slopes_mas: Vec<f32>,
    /// Sums over the frames after settling.
    settled: f64,
    square_nm2: f64,
    strehl_marechal: f64,
    divergence: Option<Divergence>,
}

impl<'a> LoopRun<'a> {
    fn new(
        correction: &'a mut CorrectionLoop,
        schedule: Schedule,
        monitor: DivergenceMonitor,
        recorder: &'a mut dyn Recorder,
    ) -> Self {
        Self {
            correction,
            schedule,
            monitor,
            recorder,
            frame: 0,
            waiting: VecDeque::new(),
            finished: 0,
            slopes_mas: Vec::new(),
            settled: 0.0,
            square_nm2: 0.0,
            strehl_marechal: 0.0,
            divergence: None,
        }
    }

    /// Closes the loop for all frames of the run, or until it diverges.
    fn close(
        &mut self,
        ready: Receiver<Batch>,
        empty: SyncSender<Batch>,
        exposed: SyncSender<ExposedWavefront>,
        finished: &Receiver<FinishedImage>,
        progress: &mut Progress,
    ) -> Result<()> {
        let frames = self.schedule.frames();
        let mut image = 0;
        while let Ok(mut batch) = ready.recv() {
            for opd_nm in batch.iter_mut().take((frames - self.frame).min(BATCH as u64) as usize) {
                self.correction.step(opd_nm)?;
                image = self.expose(opd_nm, image, &exposed)?;
                self.recorder.frame(&self.correction.last(opd_nm))?;
                self.update_statistics();
                self.frame += 1;
                if self.divergence.is_some() || self.frame == frames {
                    return Ok(());
                }
                if self.frame.is_multiple_of(LOOK_EVERY) {
                    self.report(finished, progress)?;
                }
            }
            // The send fails if the turbulence thread has made its last batch and ended.
            let _ = empty.send(batch);
        }
        Err(Error::Internal("the turbulence ended before the run".into()))
    }

    /// Adds the last frame to the statistics.
    fn update_statistics(&mut self) {
        let residual_rms_nm = self.correction.residual_rms_nm;
        self.divergence = self.monitor.update(residual_rms_nm);
        if self.frame >= self.schedule.start(0) {
            self.settled += 1.0;
            self.square_nm2 += residual_rms_nm * residual_rms_nm;
            let phase = std::f64::consts::TAU * residual_rms_nm / self.schedule.wavelength_nm;
            self.strehl_marechal += (-phase * phase).exp();
        }
    }

    /// Sends the wavefront to the detector thread if it belongs to the exposure of `image`; returns the number of the
    /// image that is exposed next.
    fn expose(&mut self, residual_nm: &[f32], image: usize, exposed: &SyncSender<ExposedWavefront>) -> Result<usize> {
        let Some(place) = self.schedule.place(self.frame, image) else { return Ok(image) };
        let share = 1.0 / self.schedule.exposure as f32;
        let slopes_mas = self.correction.last(residual_nm).slopes_mas;
        if place == 0 {
            self.slopes_mas = vec![0.0; slopes_mas.len()];
        }
        self.slopes_mas.iter_mut().zip(slopes_mas).for_each(|(sum, slope)| *sum += share * slope);
        if place == self.schedule.exposure / 2 {
            let frame = self.correction.last(residual_nm);
            self.waiting.push_back(Shot {
                image,
                time_s: (self.schedule.start(image) as f64 + (self.schedule.exposure - 1) as f64 / 2.0)
                    / self.schedule.rate_hz,
                image_e: Array2::zeros((0, 0)),
                slopes_mas: frame.slopes_mas.to_vec(),
                mean_slopes_mas: Vec::new(),
                commands_nm: frame.commands_nm.to_vec(),
                residual_rms_nm: frame.residual_rms_nm,
            });
        }
        let is_last = place + 1 == self.schedule.exposure;
        if let Some(shot) = self.waiting.back_mut().filter(|_| is_last) {
            shot.mean_slopes_mas = std::mem::take(&mut self.slopes_mas);
        }
        let wavefront =
            ExposedWavefront { image, frame: self.frame, residual_nm: residual_nm.to_vec(), share, is_last };
        // The send fails only if the detector thread panicked; joining it reports the panic.
        exposed.send(wavefront).map_err(|_| Error::Internal("the detector thread has ended".into()))?;
        Ok(if is_last { image + 1 } else { image })
    }

    /// Checks for cancellation, reports progress, and passes on finished images.
    fn report(&mut self, finished: &Receiver<FinishedImage>, progress: &mut Progress) -> Result<()> {
        let frames = self.schedule.frames();
        if progress.cancel.is_some_and(|flag| flag.load(Ordering::Relaxed)) {
            return Err(Error::Interrupted(format!("{} of {frames} frames were simulated", self.frame)));
        }
        if let Some(watch) = &mut progress.watch {
            watch(self.frame, frames);
        }
        self.collect(finished)
    }

    /// Passes finished images on to the recorder.
    fn collect(&mut self, finished: &Receiver<FinishedImage>) -> Result<()> {
        for FinishedImage { image, image_e } in finished.try_iter() {
            // Images are finished in the order of their exposures.
            let shot = self.waiting.pop_front().filter(|shot| shot.image == image);
            let shot = shot.ok_or_else(|| Error::Internal(format!("image {image} is out of order")))?;
            self.recorder.shot(Shot { image_e, ..shot })?;
            self.finished = image + 1;
        }
        Ok(())
    }
}
