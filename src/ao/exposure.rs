//! Detector thread: accumulates the PSFs of an exposure and draws the noise of its images.

use super::camera::strehl_on_axis;
use super::detector::Detector;
use super::drift::Drift;
use super::footprint::Footprint;
use ndarray::Array2;
use std::ops::Range;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender};
use std::time::{Duration, Instant};

/// First stream of the cameras' noise under the seed of the turbulence. Each image has a stream of
/// its own, so that its noise does not depend on the images before it. A later run of the same loop
/// adds its first frame to the stream's number, which exceeds the number of images of the runs
/// before.
const CAMERA_STREAM: u64 = 2 << 32;
/// Streams from one channel to the next: more than a loop has frames, and than there are streams of
/// other noise.
const CHANNEL_STREAMS: u64 = 1 << 40;

/// Residual wavefront of one frame of an exposure.
pub(super) struct ExposedWavefront {
    /// Channels that are exposed.
    pub(super) channels: Range<usize>,
    /// Number of the image within each of them.
    pub(super) image: usize,
    /// Frame of the run, from 0.
    pub(super) frame: u64,
    pub(super) residual_nm: Vec<f32>,
    /// Fraction of the exposure that this frame takes.
    pub(super) share: f32,
    /// Whether this frame ends the exposure.
    pub(super) is_last: bool,
}

/// Image at the end of its exposure.
pub(super) struct FinishedImage {
    pub(super) channel: usize,
    pub(super) image: usize,
    pub(super) image_e: Array2<f32>,
}

/// Statistics of all exposed wavefronts of a run.
pub(super) struct ExposureStatistics {
    /// Mean Strehl ratio at the scene's wavelength; NaN if no wavefront was exposed.
    pub(super) strehl: f64,
    /// Time spent on images.
    pub(super) spent: Duration,
}

/// State of the detector thread.
pub(super) struct DetectorThread {
    /// One for each channel.
    pub(super) detectors: Vec<Detector>,
    pub(super) drift: Option<Arc<Drift>>,
    /// Wavelength of the Strehl ratio, nm.
    pub(super) wavelength_nm: f64,
    pub(super) footprint: Footprint,
    /// Frame of the loop at which the run begins.
    pub(super) first_frame: u64,
}

impl DetectorThread {
    /// Accumulates `wavefronts` in order and sends the image of each exposed channel at the end of
    /// each exposure, until the channel of the thread closes.
    pub(super) fn run(
        mut self,
        wavefronts: &Receiver<ExposedWavefront>,
        images: &Sender<FinishedImage>,
    ) -> ExposureStatistics {
        let mut sums: Vec<Vec<f32>> =
            self.detectors.iter().map(|detector| vec![0.0; detector.camera.pixels()]).collect();
        let (mut strehl, mut count, mut spent) = (0.0, 0.0, Duration::ZERO);
        while let Ok(mut wavefront) = wavefronts.recv() {
            let started = Instant::now();
            // Without NCPA and diversity: this Strehl ratio measures the loop, which does not see
            // them.
            strehl += strehl_on_axis(&self.footprint, &wavefront.residual_nm, self.wavelength_nm);
            count += 1.0;
            if let Some(drift) = &self.drift {
                drift.add_ncpa(self.first_frame + wavefront.frame, &mut wavefront.residual_nm);
            }
            for channel in wavefront.channels.clone() {
                self.expose(channel, &wavefront, &mut sums[channel], images);
            }
            spent += started.elapsed();
        }
        ExposureStatistics { strehl: strehl / count, spent }
    }

    /// Adds the PSF of `wavefront` in a channel to `sum`; at the end of the exposure sends the
    /// image and clears the sum.
    fn expose(
        &mut self,
        channel: usize,
        wavefront: &ExposedWavefront,
        sum: &mut [f32],
        images: &Sender<FinishedImage>,
    ) {
        let detector = &mut self.detectors[channel];
        detector.camera.add(&wavefront.residual_nm, sum);
        if wavefront.is_last {
            let image = wavefront.image;
            let number = CAMERA_STREAM + channel as u64 * CHANNEL_STREAMS + self.first_frame + image as u64;
            let image_e = detector.image_e(detector.camera.to_image(sum) * wavefront.share, number);
            sum.fill(0.0);
            // The send fails only if the loop has stopped and dropped the receiver.
            let _ = images.send(FinishedImage { channel, image, image_e });
        }
    }
}
