//! One frame of the loop between turbulence and camera: segments, mirror, sensor, controller.

use super::aligned::AlignedBuffer;
use super::control::{Controller, OpticalGains};
use super::drift::Drift;
use super::footprint::Footprint;
use super::profile::{LoopStage, Profile};
use super::sensor::{GuideStar, Sensor};
use super::surface::Surface;
use crate::Result;
use std::sync::Arc;
use std::time::Instant;

/// State of the loop in one frame.
#[derive(Debug, Clone, Copy)]
pub struct LoopFrame<'a> {
    /// Number of the frame, from 0.
    pub number: u64,
    /// Time since the loop was closed, s.
    pub time_s: f64,
    /// Residual wavefront, nm: turbulence plus segment errors minus the mirror's surface; a map
    /// over the footprint.
    pub residual_nm: &'a [f32],
    /// RMS of the residual wavefront over the pupil, piston removed, nm.
    pub residual_rms_nm: f64,
    /// Measured slopes of the residual wavefront less the reference slopes: `[all x, all y]`, mas.
    pub slopes_mas: &'a [f32],
    /// Commands on the mirror during the frame, nm.
    pub commands_nm: &'a [f32],
}

/// Segments, mirror, sensor and controller: the part of the loop between the turbulence and the
/// camera.
#[derive(Clone)]
pub(super) struct CorrectionLoop {
    pub(super) footprint: Footprint,
    pub(super) segments_nm: AlignedBuffer,
    /// Drift of the segment errors and of the NCPA.
    pub(super) drift: Option<Arc<Drift>>,
    pub(super) surface: Surface,
    pub(super) sensor: Sensor,
    pub(super) light: Option<GuideStar>,
    pub(super) controller: Controller,
    /// Dither of the mirror and the optical gains that it finds.
    pub(super) gains: Option<OpticalGains>,
    pub(super) slopes_mas: Vec<f32>,
    /// Reference slopes, mas; none where they are 0.
    pub(super) reference_mas: Vec<f32>,
    pub(super) commands_nm: Vec<f32>,
    pub(super) residual_rms_nm: f64,
    pub(super) number: u64,
    pub(super) frame_s: f64,
    pub(super) profile: Profile,
}

impl CorrectionLoop {
    /// Advances the loop by one frame: turns the turbulence `opd_nm` into the residual wavefront,
    /// in place, and updates the commands from its slopes.
    pub(super) fn step(&mut self, opd_nm: &mut [f32]) -> Result<()> {
        let started = Instant::now();
        self.commands_nm.copy_from_slice(self.controller.commands_nm());
        if let Some(gains) = &self.gains {
            gains.add_dither(&mut self.commands_nm);
        }
        if let Some(drift) = &self.drift {
            drift.segments_at(self.number, &mut self.segments_nm);
        }
        let moments = self.surface.correct(&self.commands_nm, &self.segments_nm, opd_nm)?;
        let mean = moments[0] / self.footprint.total();
        self.residual_rms_nm = (moments[1] / self.footprint.total() - mean * mean).max(0.0).sqrt();
        let corrected = self.profile.lap(LoopStage::Mirror, started);
        self.sensor.measure(opd_nm, self.light.as_mut(), &mut self.slopes_mas)?;
        self.slopes_mas.iter_mut().zip(&self.reference_mas).for_each(|(slope, reference)| *slope -= reference);
        let measured = self.profile.lap(LoopStage::Sensor, corrected);
        self.controller.step(&self.slopes_mas)?;
        if let Some(gains) = &mut self.gains
            && gains.update(&self.slopes_mas, &self.commands_nm)
        {
            self.controller.set_optical_gains(gains.gains());
        }
        self.profile.lap(LoopStage::Control, measured);
        self.number += 1;
        Ok(())
    }

    /// The last frame; `residual_nm` is the map that [`CorrectionLoop::step`] wrote.
    pub(super) fn last<'a>(&'a self, residual_nm: &'a [f32]) -> LoopFrame<'a> {
        let number = self.number.saturating_sub(1);
        LoopFrame {
            number,
            time_s: number as f64 * self.frame_s,
            residual_nm,
            residual_rms_nm: self.residual_rms_nm,
            slopes_mas: &self.slopes_mas,
            commands_nm: &self.commands_nm,
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::ao::Simulator;
    use crate::scene::Scene;

    #[test]
    #[ignore = "merge: 10 s"]
    fn optical_gains_equal_push_pull_gains_about_the_residual() {
        let small = [
            ("wavefront_sensor.pixels_across", "20"),
            ("wavefront_sensor.modulation_lambda_over_d", "3.0"),
            ("wavefront_sensor.photon_noise", "false"),
            ("wavefront_sensor.read_noise_e", "0.0"),
            ("control.filtered_modes", "10"),
        ];
        let preset = Scene::preset("keck-pyramid").unwrap().with(&small).unwrap();
        for basis in ["kl", "zonal"] {
            let scene = preset.with_override("control.basis", basis).unwrap();
            let mut simulator = Simulator::new(&scene).unwrap();
            (0..1000).for_each(|_| assert!(simulator.step().is_ok()));
            // Means over the next windows, as the loop's own gains.
            let reconstructor = simulator.law().reconstructor().unwrap().clone();
            let modes = [0.2, 0.5, 0.8].map(|part| (part * reconstructor.controlled() as f64) as usize);
            let mut sums = [0.0; 3];
            let (windows, pokes) = (2000, 40);
            let mut residual_nm = 0.0;
            for frame in 0..windows {
                let rms_nm = simulator.step().unwrap().residual_rms_nm;
                residual_nm += rms_nm / f64::from(windows);
                if frame % (windows / pokes) != 0 {
                    continue;
                }
                for (sum, &mode) in sums.iter_mut().zip(&modes) {
                    let shape = reconstructor.modes().column(mode);
                    let rms = (shape.dot(&shape) / shape.len() as f64).sqrt();
                    // Commands of 10 nm RMS.
                    let measured = [10.0, -10.0].map(|nm| {
                        let commands: Vec<f32> = shape.iter().map(|value| (value * nm / rms) as f32).collect();
                        let mut map = simulator.correction.footprint.zeros();
                        map.copy_from_slice(&simulator.residual_nm);
                        simulator.correction.surface.add(&commands, 1.0, &mut map).unwrap();
                        let mut slopes = vec![0.0; simulator.correction.sensor.slopes()];
                        simulator.correction.sensor.measure(&map, None, &mut slopes).unwrap();
                        let slopes = slopes.iter().zip(reconstructor.inverse().row(mode));
                        slopes.map(|(slope, weight)| f64::from(*slope) * weight).sum::<f64>()
                    });
                    *sum += (measured[0] - measured[1]) / (20.0 / rms) / f64::from(pokes);
                }
            }
            let gains = simulator.correction.gains.as_ref().unwrap().gains();
            for (mode, pushed) in modes.into_iter().zip(sums) {
                let dithered = f64::from(gains[mode]);
                println!(
                    "{basis} {mode}: {dithered:.3} by dithering, {pushed:.3} by pushes, residual {residual_nm:.0} nm RMS"
                );
                // The turbulence in the bin of a sine is some 10 % of it, in a mean of about three
                // windows; between the four modes the gains are interpolated.
                assert!((dithered / pushed - 1.0).abs() < 0.15, "{basis} {mode}: {dithered} {pushed}");
                assert!((0.2..0.97).contains(&pushed), "{basis} {mode}: {pushed}");
            }
            // A loop that closes: the wavefront of the turbulence alone is some 1,500 nm, and 120
            // nm are left with noise. The bound excludes a zonal loop that filters 60 modes (221
            // nm): among the weakest singular values of a pyramid are low orders.
            assert!(residual_nm < 200.0, "{basis}: {residual_nm}");
        }
    }
}
