//! What a run gives to its caller: frames, images with their telemetry, statistics.

use super::correction::LoopFrame;
use super::divergence::Divergence;
use super::profile::Profile;
use crate::Result;
use ndarray::Array2;

/// One image with the telemetry of its exposure.
#[derive(Debug, Clone)]
pub struct Shot {
    /// The channel that took it, from 0; 0 for a scene without channels.
    pub channel: usize,
    /// Its number within the channel, from 0.
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
    fn frame(&mut self, _frame: &LoopFrame) -> Result<()> {
        Ok(())
    }

    /// Receives every image some time after its last frame: in the order of the exposures, those of
    /// one exposure in the order of the channels.
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
    /// Images, of all channels together.
    pub images: usize,
    /// Wall-clock time, s.
    pub seconds: f64,
    /// RMS of the residual wavefront over the frames after settling, nm.
    pub residual_rms_nm: f64,
    /// Strehl ratio of a long exposure of the loop's residual at the wavelength of the scene, or of
    /// its first channel, without NCPA and diversity.
    pub strehl: f64,
    /// The same Strehl ratio by Maréchal's approximation from the RMS of every frame after
    /// settling.
    pub strehl_marechal: f64,
    /// Electrons of the star in an image of each channel; one number for a scene without channels.
    pub flux_e: Vec<f64>,
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
