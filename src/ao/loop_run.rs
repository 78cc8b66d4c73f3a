//! Thread of the loop during a run: closes the loop frame by frame, sends the exposed wavefronts to
//! the detector thread, and gives the finished images with their telemetry to the recorder.

use super::aligned::AlignedBuffer;
use super::correction::CorrectionLoop;
use super::divergence::{Divergence, DivergenceMonitor};
use super::exposure::{ExposedWavefront, FinishedImage};
use super::recorder::{Recorder, Shot};
use super::schedule::{Schedule, ScheduledExposure};
use crate::control::{Control, Stage};
use crate::{Error, Result};
use ndarray::Array2;
use std::collections::VecDeque;
use std::sync::mpsc::{Receiver, SyncSender};

/// Consecutive frames of turbulence.
pub(super) type Batch = Vec<AlignedBuffer>;

/// Frames between two checks for cancellation and of finished images.
const LOOK_EVERY: u64 = 128;

/// State of the loop during a run.
pub(super) struct LoopRun<'a> {
    correction: &'a mut CorrectionLoop,
    schedule: Schedule,
    monitor: DivergenceMonitor,
    recorder: &'a mut dyn Recorder,
    /// Frames so far.
    pub(super) frame: u64,
    /// Telemetry of exposures whose images are not finished, and the number of images that are.
    waiting: VecDeque<Shot>,
    pub(super) finished: usize,
    /// Sum of the slopes over the exposure so far.
    slopes_mas: Vec<f32>,
    /// Sums over the frames after settling.
    pub(super) settled: f64,
    pub(super) square_nm2: f64,
    pub(super) strehl_marechal: f64,
    pub(super) divergence: Option<Divergence>,
}

impl<'a> LoopRun<'a> {
    pub(super) fn new(
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
    pub(super) fn close(
        &mut self,
        ready: Receiver<Batch>,
        empty: SyncSender<Batch>,
        exposed: SyncSender<ExposedWavefront>,
        finished: &Receiver<FinishedImage>,
        control: &Control,
    ) -> Result<()> {
        let frames = self.schedule.frames();
        control.enter(Stage::Simulating, frames as usize);
        let mut exposure = 0;
        while let Ok(mut batch) = ready.recv() {
            for opd_nm in batch.iter_mut().take((frames - self.frame) as usize) {
                self.correction.step(opd_nm)?;
                exposure = self.expose(opd_nm, exposure, &exposed)?;
                self.recorder.frame(&self.correction.last(opd_nm))?;
                self.update_statistics();
                self.frame += 1;
                if self.divergence.is_some() || self.frame == frames {
                    control.step((self.frame - (self.frame - 1) / LOOK_EVERY * LOOK_EVERY) as usize);
                    return Ok(());
                }
                if self.frame.is_multiple_of(LOOK_EVERY) {
                    self.report(finished, control)?;
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
        if self.frame >= self.schedule.start() {
            self.settled += 1.0;
            self.square_nm2 += residual_rms_nm * residual_rms_nm;
            let phase = std::f64::consts::TAU * residual_rms_nm / self.schedule.wavelength_nm;
            self.strehl_marechal += (-phase * phase).exp();
        }
    }

    /// Sends the wavefront to the detector thread if it belongs to the exposure `number`; returns
    /// the number of the exposure that is next.
    fn expose(&mut self, residual_nm: &[f32], number: usize, exposed: &SyncSender<ExposedWavefront>) -> Result<usize> {
        let Some(exposure) = self.schedule.exposure(number) else { return Ok(number) };
        let Some(place) = exposure.place(self.frame) else { return Ok(number) };
        let share = 1.0 / exposure.frames as f32;
        let slopes_mas = self.correction.last(residual_nm).slopes_mas;
        if place == 0 {
            self.slopes_mas = vec![0.0; slopes_mas.len()];
        }
        self.slopes_mas.iter_mut().zip(slopes_mas).for_each(|(sum, slope)| *sum += share * slope);
        if place == exposure.frames / 2 {
            self.record_telemetry(residual_nm, &exposure);
        }
        let is_last = place + 1 == exposure.frames;
        if is_last {
            let shots = self.waiting.iter_mut().rev().take(exposure.channels.len());
            shots.for_each(|shot| shot.mean_slopes_mas.clone_from(&self.slopes_mas));
        }
        let ScheduledExposure { channels, image, .. } = exposure;
        let (frame, residual_nm) = (self.frame, residual_nm.to_vec());
        let wavefront = ExposedWavefront { channels, image, frame, residual_nm, share, is_last };
        // The send fails only if the detector thread panicked; joining it reports the panic.
        exposed.send(wavefront).map_err(|_| Error::Internal("the detector thread has ended".into()))?;
        Ok(if is_last { number + 1 } else { number })
    }

    /// Keeps the telemetry of the last frame for the image of each exposed channel.
    fn record_telemetry(&mut self, residual_nm: &[f32], exposure: &ScheduledExposure) {
        let frame = self.correction.last(residual_nm);
        self.waiting.extend(exposure.channels.clone().map(|channel| Shot {
            channel,
            image: exposure.image,
            time_s: (exposure.start as f64 + (exposure.frames - 1) as f64 / 2.0) / self.schedule.rate_hz,
            image_e: Array2::zeros((0, 0)),
            slopes_mas: frame.slopes_mas.to_vec(),
            mean_slopes_mas: Vec::new(),
            commands_nm: frame.commands_nm.to_vec(),
            residual_rms_nm: frame.residual_rms_nm,
        }));
    }

    /// Checks for cancellation, reports progress, and passes on finished images.
    fn report(&mut self, finished: &Receiver<FinishedImage>, control: &Control) -> Result<()> {
        control.check_with(|| format!("{} of {} frames were simulated", self.frame, self.schedule.frames()))?;
        control.step(LOOK_EVERY as usize);
        self.collect(finished)
    }

    /// Passes finished images on to the recorder.
    pub(super) fn collect(&mut self, finished: &Receiver<FinishedImage>) -> Result<()> {
        for FinishedImage { channel, image, image_e } in finished.try_iter() {
            // Images are finished in the order of their exposures, and of the channels.
            let shot = self.waiting.pop_front().filter(|shot| (shot.channel, shot.image) == (channel, image));
            let out_of_order = || Error::Internal(format!("image {image} of channel {channel} is out of order"));
            self.recorder.shot(Shot { image_e, ..shot.ok_or_else(out_of_order)? })?;
            self.finished += 1;
        }
        Ok(())
    }
}
