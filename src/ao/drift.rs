//! Linear drift of the segment pistons and the NCPA, zero at the middle of a sequence.

use super::aligned::AlignedBuffer;
use super::footprint::Footprint;
use super::schedule::Schedule;
use crate::Result;
use crate::pupil::Pupil;
use crate::source::Truth;

/// Drift rates, as maps over the footprint.
pub(super) struct Drift {
    /// Piston drift, nm per minute.
    pistons_nm: AlignedBuffer,
    /// NCPA drift, nm per minute.
    ncpa_nm: AlignedBuffer,
    /// Segment errors at the middle of the sequence, nm.
    segments_nm: AlignedBuffer,
    frames_per_min: f64,
    middle: f64,
}

impl Drift {
    /// Drift of `truth`; `None` if it does not drift.
    ///
    /// # Errors
    /// Those of evaluating the NCPA.
    pub(super) fn new(
        truth: &Truth,
        pupil: &Pupil,
        footprint: &Footprint,
        segments_nm: &AlignedBuffer,
        schedule: &Schedule,
        frame_s: f64,
    ) -> Result<Option<Self>> {
        let Some(pistons) = truth.piston_drift_nm() else { return Ok(None) };
        let illuminated: Vec<((usize, usize), usize)> = pupil.owned_samples().collect();
        let xs_m: Vec<f64> = illuminated.iter().map(|((_, x), _)| pupil.grid.coordinate_m(*x)).collect();
        let ys_m: Vec<f64> = illuminated.iter().map(|((y, _), _)| pupil.grid.coordinate_m(*y)).collect();
        let (mut pistons_nm, mut ncpa_nm) = (footprint.zeros(), footprint.zeros());
        for (((y, x), owner), ncpa) in illuminated.into_iter().zip(truth.ncpa_drift_at(&xs_m, &ys_m)?) {
            let place = y * footprint.stride() + x;
            (pistons_nm[place], ncpa_nm[place]) = (pistons[owner] as f32, ncpa as f32);
        }
        let middle = (schedule.start() + schedule.frames()) as f64 / 2.0;
        Ok(Some(Self { pistons_nm, ncpa_nm, segments_nm: segments_nm.clone(), frames_per_min: 60.0 / frame_s, middle }))
    }

    /// Minutes from the middle of the sequence to a frame.
    fn minutes(&self, frame: u64) -> f32 {
        ((frame as f64 - self.middle) / self.frames_per_min) as f32
    }

    /// Writes the segment errors at a frame, nm.
    pub(super) fn segments_at(&self, frame: u64, segments_nm: &mut [f32]) {
        let minutes = self.minutes(frame);
        for ((out, still), drift) in segments_nm.iter_mut().zip(&*self.segments_nm).zip(&*self.pistons_nm) {
            *out = still + minutes * drift;
        }
    }

    /// Adds the drift of the NCPA at a frame to `residual_nm`, nm.
    pub(super) fn add_ncpa(&self, frame: u64, residual_nm: &mut [f32]) {
        let minutes = self.minutes(frame);
        residual_nm.iter_mut().zip(&*self.ncpa_nm).for_each(|(out, drift)| *out += minutes * drift);
    }
}

#[cfg(test)]
mod tests {
    use crate::ao::{LoopFrame, Recorder, Shot, Simulator, undisturb};
    use crate::control::Control;
    use crate::scene::Scene;
    use ndarray::Array2;

    /// The residual wavefront of the first and of the last frame, and the images.
    #[derive(Default)]
    struct Ends {
        first_nm: Vec<f32>,
        last_nm: Vec<f32>,
        images_e: Vec<Array2<f32>>,
    }

    impl Recorder for Ends {
        fn frame(&mut self, frame: &LoopFrame) -> crate::Result<()> {
            if frame.number == 0 {
                self.first_nm = frame.residual_nm.to_vec();
            }
            self.last_nm = frame.residual_nm.to_vec();
            Ok(())
        }
        fn shot(&mut self, shot: Shot) -> crate::Result<()> {
            self.images_e.push(shot.image_e);
            Ok(())
        }
    }

    #[test]
    fn static_errors_drift_linearly_about_the_middle() {
        let small = include_str!("../../tests/c_api/small.toml");
        let scene = Scene::from_text(small, "".as_ref()).unwrap();
        let quiet = [
            ("control.settle_s", "0"),
            // A negligible gain: only the segments change the residual.
            ("control.gain", "1e-9"),
            ("image.exposure_s", "0"),
            ("image.interval_s", "0.1"),
            ("image.count", "7"),
            ("image.photon_noise", "false"),
            // peak_snr sets the star's flux and needs some noise to do so.
            ("image.read_noise_e", "1"),
            ("image.peak_snr", "1e5"),
            ("faults.drift_nm_per_min", "2000"),
        ];
        let scene = scene.with(&quiet).unwrap();
        let mut simulator = Simulator::new(&scene.system().with(undisturb).unwrap()).unwrap();
        let still_nm = simulator.segments_nm().to_vec();
        let mut ends = Ends::default();
        simulator.run(&mut ends, &Control::default()).unwrap();
        let rms = |map_nm: &[f32]| {
            let amplitude = simulator.footprint().amplitude();
            let square = |(nm, a): (&f32, &f32)| f64::from(a * nm * nm);
            (map_nm.iter().zip(amplitude).map(square).sum::<f64>() / simulator.footprint().total()).sqrt()
        };
        let gained: Vec<f32> = ends.last_nm.iter().zip(&ends.first_nm).map(|(last, first)| last - first).collect();
        // 0.6 s at 2,000 nm per minute. Partly covered samples at the edges take the whole piston
        // of their owner: 1 %.
        assert!((rms(&gained) / 20.0 - 1.0).abs() < 0.02, "{}", rms(&gained));
        let middle: Vec<f32> =
            (0..still_nm.len()).map(|i| (ends.last_nm[i] + ends.first_nm[i]) / 2.0 - still_nm[i]).collect();
        // Half of a frame's 0.03 nm, and single precision.
        assert!(rms(&middle) < 0.1, "{}", rms(&middle));
        // The NCPA are not in the residual wavefront; since the middle they have drifted by half of
        // the total.
        let mut ncpa_nm = simulator.footprint().zeros();
        simulator.correction.drift.as_ref().unwrap().add_ncpa(simulator.frames(), &mut ncpa_nm);
        assert!((rms(&ncpa_nm) / 10.0 - 1.0).abs() < 0.02, "{}", rms(&ncpa_nm));
        // The squared difference of two images grows with the square of the drift between them.
        let far = |a: &Array2<f32>, b: &Array2<f32>| (a - b).mapv(|e| e * e).sum();
        let [first, next, last] = [0, 1, 6].map(|i| &ends.images_e[i]);
        assert!(far(first, last) > 10.0 * far(first, next), "{} {}", far(first, last), far(first, next));
    }
}
