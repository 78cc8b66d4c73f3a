//! A run: the loop closed for as long as the scene wants images, on every core there is.
//!
//! The turbulence of the coming frames is made on one thread, the loop is closed on the caller's, and images are made on
//! a third. What comes out does not depend on how they share the cores: each part draws from random numbers of its own.

use super::atmosphere::Atmosphere;
use super::camera::View;
use super::darkroom::{Darkroom, Film, Print};
use super::divergence::{Divergence, Watch};
use super::lines::Lines;
use super::profile::{Profile, Stage};
use super::simulator::{Frame, Plant, Simulator, sections};
use crate::scene::Scene;
use crate::source::{Pixels, flux_e};
use crate::{Error, Result};
use ndarray::Array2;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, channel, sync_channel};
use std::time::{Duration, Instant};

/// Frames that go from thread to thread at once: enough to make the exchange cheap, few enough for the cache.
const BATCH: usize = 8;
/// Batches on their way.
const BATCHES: usize = 3;
/// Wavefronts that may wait for the camera.
const WAITING: usize = 32;

/// When the images are taken, in frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Schedule {
    settle_s: f64,
    interval_s: f64,
    rate_hz: f64,
    wavelength_nm: f64,
    /// Frames in an exposure; 1 freezes the turbulence.
    pub exposure: u64,
    /// Number of images.
    pub images: usize,
}

impl Schedule {
    /// The schedule of `scene`, for a loop of `rate_hz`.
    pub fn of(scene: &Scene, settle_s: f64, rate_hz: f64) -> Self {
        let image = &scene.image;
        let exposure = (image.exposure_s * rate_hz).round().max(1.0);
        let interval_s = image.interval_s.max(exposure / rate_hz);
        Self {
            settle_s,
            interval_s,
            rate_hz,
            wavelength_nm: image.wavelength_nm,
            exposure: exposure as u64,
            images: image.count,
        }
    }

    /// The first frame of an image.
    pub fn start(&self, image: usize) -> u64 {
        ((self.settle_s + image as f64 * self.interval_s) * self.rate_hz).round() as u64
    }

    /// Frames until the last image is there.
    pub fn frames(&self) -> u64 {
        self.start(self.images.max(1) - 1) + self.exposure
    }

    /// Which frame of the exposure of `image` the run's frame is, if any.
    fn place(&self, frame: u64, image: usize) -> Option<u64> {
        let start = (image < self.images).then(|| self.start(image))?;
        (start..start + self.exposure).contains(&frame).then(|| frame - start)
    }
}

/// One image with what the loop did meanwhile.
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
    /// Their mean over the frames of the exposure, mas.
    pub mean_slopes_mas: Vec<f32>,
    /// Commands in that frame, nm.
    pub commands_nm: Vec<f32>,
    /// RMS of the residual wavefront in that frame, nm.
    pub residual_rms_nm: f64,
}

/// Who takes what a run delivers. An error stops the run.
pub trait Recorder {
    /// Every frame, in order.
    ///
    /// # Errors
    /// Whatever stops the run.
    fn frame(&mut self, _frame: &Frame) -> Result<()> {
        Ok(())
    }

    /// Every image, in order, some time after its last frame.
    ///
    /// # Errors
    /// Whatever stops the run.
    fn shot(&mut self, shot: Shot) -> Result<()>;
}

impl Recorder for Vec<Shot> {
    fn shot(&mut self, shot: Shot) -> Result<()> {
        self.push(shot);
        Ok(())
    }
}

/// What a run was like.
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
    /// The same by Maréchal's approximation from the RMS of every frame after settling.
    pub strehl_marechal: f64,
    /// Electrons of the star in an image.
    pub flux_e: f64,
    /// Whether and how the loop ran away; the run stopped there.
    pub divergence: Option<Divergence>,
    /// Time in each stage, on whatever thread.
    pub profile: Profile,
    /// Time in the camera, s, on a thread of its own.
    pub camera_s: f64,
}

impl Summary {
    /// Frames for each second of wall-clock time.
    pub fn frames_per_s(&self) -> f64 {
        self.frames as f64 / self.seconds
    }
}

/// What is asked of a run beside the scene.
#[derive(Default)]
pub struct Progress<'a> {
    /// Told (frames done, frames in all) now and then.
    pub watch: Option<&'a mut dyn FnMut(u64, u64)>,
    /// Stops the run when it goes up.
    pub cancel: Option<&'a AtomicBool>,
}

/// Frames between two looks at the cancel flag and at finished images.
const LOOK_EVERY: u64 = 128;

impl Simulator {
    /// Closes the loop until the scene's images are taken, or the loop diverges.
    ///
    /// The run starts where the simulator is, and its times count from there. Where it stops early, the sky may be some
    /// frames ahead of the loop.
    ///
    /// # Errors
    /// [`Error::Interrupted`] where the cancel flag went up; what `recorder` returns; those of the camera.
    pub fn run(&mut self, recorder: &mut dyn Recorder, progress: &mut Progress) -> Result<Summary> {
        let started = Instant::now();
        let scene = self.scene().clone();
        let (sensing, control) = sections(&scene)?;
        let schedule = Schedule::of(&scene, control.settle_s, control.frame_rate_hz);
        let mut camera = self.camera(View::of(&scene.image))?;
        // The star's flux is that of the static aberrations alone: what peak_snr means does not hang on the loop.
        let pixels = Pixels::of(&scene);
        let peak = pixels.see(camera.psf(self.segments_nm()).mapv(f64::from)).fold(0.0, |a: f64, &b| a.max(b));
        let flux_e = flux_e(&scene.image, peak);
        let footprint = self.plant.footprint.clone();
        let first_frame = self.plant.number;
        let darkroom = Darkroom {
            camera,
            pixels,
            drift: self.plant.drift.clone(),
            scene: scene.clone(),
            flux_e,
            footprint: footprint.clone(),
            first_frame,
        };
        let before = self.plant.profile;
        let watch = Watch::new(self.frame_s(), sensing.wavelength_nm, self.stability());
        let (atmosphere, plant) = (&mut self.atmosphere, &mut self.plant);
        let mut closing = Closing::new(plant, schedule, watch, recorder);
        let (sky_time, developed) = std::thread::scope(|scope| {
            let (full, ready) = sync_channel(BATCHES);
            let (empty, back) = sync_channel(BATCHES);
            for _ in 0..BATCHES {
                // The channel has room for all of them, and both ends are here.
                let _ = empty.send((0..BATCH).map(|_| footprint.zeros()).collect());
            }
            let sky = scope.spawn(move || make_sky(atmosphere, schedule.frames(), &full, &back));
            let (exposed, films) = sync_channel(WAITING);
            let (prints, finished) = channel();
            let camera = scope.spawn(move || darkroom.work(&films, &prints));
            // Whatever becomes of the loop, both threads end when it lets go of their channels.
            let outcome = closing.close(ready, empty, exposed, &finished, progress);
            let sky = sky.join().map_err(|_| Error::Internal("the thread of the turbulence panicked".into()));
            let camera = camera.join().map_err(|_| Error::Internal("the thread of the camera panicked".into()));
            // What stopped the sky stopped the loop, and is the reason.
            let sky = sky??;
            outcome?;
            closing.collect(&finished)?;
            Ok::<_, Error>((sky, camera?))
        })?;
        let Closing { divergence, settled, square_nm2, strehl_marechal, next, run, .. } = closing;
        self.plant.profile.add(Stage::Atmosphere, sky_time);
        Ok(Summary {
            frames: run,
            images: next,
            seconds: started.elapsed().as_secs_f64(),
            residual_rms_nm: (square_nm2 / settled).sqrt(),
            strehl: developed.strehl,
            strehl_marechal: strehl_marechal / settled,
            flux_e,
            divergence,
            profile: self.plant.profile.since(&before),
            camera_s: developed.spent.as_secs_f64(),
        })
    }
}

type Batch = Vec<Lines>;

/// Makes the turbulence of `frames` frames, until nobody wants more; returns the time it took.
fn make_sky(
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
        // No frame more than the run has: the next one goes on where this one ends.
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

/// The loop on its way through a run.
struct Closing<'a> {
    plant: &'a mut Plant,
    schedule: Schedule,
    watch: Watch,
    recorder: &'a mut dyn Recorder,
    /// Frames so far.
    run: u64,
    /// Images that were exposed and wait for the darkroom, and the number of those that came back.
    waiting: VecDeque<Shot>,
    next: usize,
    /// Sum of the slopes over the exposure so far.
    slopes_mas: Vec<f32>,
    /// Sums over the frames after settling.
    settled: f64,
    square_nm2: f64,
    strehl_marechal: f64,
    divergence: Option<Divergence>,
}

impl<'a> Closing<'a> {
    fn new(plant: &'a mut Plant, schedule: Schedule, watch: Watch, recorder: &'a mut dyn Recorder) -> Self {
        Self {
            plant,
            schedule,
            watch,
            recorder,
            run: 0,
            waiting: VecDeque::new(),
            next: 0,
            slopes_mas: Vec::new(),
            settled: 0.0,
            square_nm2: 0.0,
            strehl_marechal: 0.0,
            divergence: None,
        }
    }

    /// All frames, or those until the loop diverges.
    fn close(
        &mut self,
        ready: Receiver<Batch>,
        empty: SyncSender<Batch>,
        exposed: SyncSender<Film>,
        finished: &Receiver<Print>,
        progress: &mut Progress,
    ) -> Result<()> {
        let frames = self.schedule.frames();
        let mut image = 0;
        while let Ok(mut batch) = ready.recv() {
            for opd_nm in batch.iter_mut().take((frames - self.run).min(BATCH as u64) as usize) {
                self.plant.frame(opd_nm)?;
                image = self.expose(opd_nm, image, &exposed)?;
                self.recorder.frame(&self.plant.last(opd_nm))?;
                self.count();
                self.run += 1;
                if self.divergence.is_some() || self.run == frames {
                    return Ok(());
                }
                if self.run.is_multiple_of(LOOK_EVERY) {
                    self.look(finished, progress)?;
                }
            }
            // A sky that has made its last batch wants none back.
            let _ = empty.send(batch);
        }
        Err(Error::Internal("the turbulence ended before the run".into()))
    }

    /// Statistics of the frame just made.
    fn count(&mut self) {
        let residual_rms_nm = self.plant.residual_rms_nm;
        self.divergence = self.watch.see(residual_rms_nm);
        if self.run >= self.schedule.start(0) {
            self.settled += 1.0;
            self.square_nm2 += residual_rms_nm * residual_rms_nm;
            let phase = std::f64::consts::TAU * residual_rms_nm / self.schedule.wavelength_nm;
            self.strehl_marechal += (-phase * phase).exp();
        }
    }

    /// Hands the wavefront to the darkroom if an image is being taken; returns the image that comes next.
    fn expose(&mut self, residual_nm: &[f32], image: usize, exposed: &SyncSender<Film>) -> Result<usize> {
        let Some(place) = self.schedule.place(self.run, image) else { return Ok(image) };
        let share = 1.0 / self.schedule.exposure as f32;
        let slopes_mas = self.plant.last(residual_nm).slopes_mas;
        if place == 0 {
            self.slopes_mas = vec![0.0; slopes_mas.len()];
        }
        self.slopes_mas.iter_mut().zip(slopes_mas).for_each(|(sum, slope)| *sum += share * slope);
        if place == self.schedule.exposure / 2 {
            let frame = self.plant.last(residual_nm);
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
        let last = place + 1 == self.schedule.exposure;
        if let Some(shot) = self.waiting.back_mut().filter(|_| last) {
            shot.mean_slopes_mas = std::mem::take(&mut self.slopes_mas);
        }
        let film = Film { image, frame: self.run, residual_nm: residual_nm.to_vec(), share, last };
        // A darkroom that is gone has panicked, which its own end reports.
        exposed.send(film).map_err(|_| Error::Internal("the thread of the camera is gone".into()))?;
        Ok(if last { image + 1 } else { image })
    }

    /// Progress, cancellation, and images that are ready.
    fn look(&mut self, finished: &Receiver<Print>, progress: &mut Progress) -> Result<()> {
        let frames = self.schedule.frames();
        if progress.cancel.is_some_and(|flag| flag.load(Ordering::Relaxed)) {
            return Err(Error::Interrupted(format!("{} of {frames} frames were simulated", self.run)));
        }
        if let Some(watch) = &mut progress.watch {
            watch(self.run, frames);
        }
        self.collect(finished)
    }

    /// Passes on the images that are ready.
    fn collect(&mut self, finished: &Receiver<Print>) -> Result<()> {
        for print in finished.try_iter() {
            // The darkroom works in order, so the first that waits is the one that came.
            let shot = self.waiting.pop_front().filter(|shot| shot.image == print.image);
            let shot = shot.ok_or_else(|| Error::Internal(format!("image {} came out of order", print.image)))?;
            self.recorder.shot(Shot { image_e: print.image_e, ..shot })?;
            self.next = print.image + 1;
        }
        Ok(())
    }
}
