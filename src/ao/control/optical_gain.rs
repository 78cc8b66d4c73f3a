//! Optical gains of the controlled modes, measured in the running loop by dithering.
//!
//! A pyramid that looks at a residual wavefront responds less to a mode than at its calibration:
//! its slopes are those of g times the mode. The mirror therefore carries a sine of a few modes,
//! each at a frequency of its own above the loop's bandwidth. In every window of frames the
//! amplitudes of these sines in the slopes, Q, and in the commands, C, give g = −Re(Q C*)/|C|²,
//! independently of the response of the loop (Esposito et al. 2020, A&A 636, A88, section 2).
//! Between these modes, which are in the order of their singular values, the gains are
//! interpolated; the controller divides each mode by its own (modal compensation: Deo et al. 2019,
//! A&A 629, A107).

use super::reconstructor::Reconstructor;
use ndarray::Array2;
use std::f64::consts::TAU;

/// Frames of a window: a second of a loop at 1 kHz, over which seeing is steady, and a bin of 1 Hz
/// for the turbulence to leak into.
const WINDOW: u32 = 1000;
/// Modes with a sine: gains are smooth, and each sine costs wavefront error.
const PROBES: usize = 4;
/// Cycles of the sines in a window: an eighth of the frame rate and above, of differences without
/// common multiples.
const CYCLES: [u32; PROBES] = [125, 132, 143, 150];
/// Share of a new measurement in the gains.
const NEW_SHARE: f64 = 0.3;
/// Gains outside of this range are measurements that failed.
const RANGE: [f64; 2] = [0.05, 1.5];

/// Sine on one mode.
#[derive(Clone)]
struct Probe {
    /// Number of the mode among the controlled ones.
    mode: usize,
    cycles: u32,
    /// Commands of the sine's amplitude, nm.
    commands_nm: Vec<f32>,
    /// Coefficient of the mode from slopes, and from commands.
    from_slopes: Vec<f32>,
    from_commands: Vec<f32>,
    /// Sums of the coefficients times the cosine and the sine.
    in_slopes: [f64; 2],
    in_commands: [f64; 2],
    gain: f64,
}

/// Dither and the gains that it has measured.
#[derive(Clone)]
pub(in crate::ao) struct OpticalGains {
    probes: Vec<Probe>,
    /// Place in the window.
    frame: u32,
    windows: u32,
    /// Gain of each controlled mode; 1 before the first window.
    gains: Vec<f32>,
}

impl OpticalGains {
    /// Dither with an RMS command of `dither_nm` at the sine's peak, of modes that divide those of
    /// `reconstructor` into equal parts; `interaction` is the matrix that it inverts.
    pub(in crate::ao) fn new(reconstructor: &Reconstructor, interaction: &Array2<f64>, dither_nm: f64) -> Self {
        let controlled = reconstructor.controlled();
        let probe = |number: usize| {
            let mode = (2 * number + 1) * controlled / (2 * PROBES);
            let shape = reconstructor.modes().column(mode);
            let rms = (shape.dot(&shape) / shape.len() as f64).sqrt();
            let from_slopes = reconstructor.inverse().row(mode);
            let from_commands = from_slopes.dot(interaction);
            Probe {
                mode,
                cycles: CYCLES[number],
                commands_nm: shape.iter().map(|value| (value * dither_nm / rms) as f32).collect(),
                from_slopes: from_slopes.iter().map(|&value| value as f32).collect(),
                from_commands: from_commands.iter().map(|&value| value as f32).collect(),
                in_slopes: [0.0; 2],
                in_commands: [0.0; 2],
                gain: 1.0,
            }
        };
        // With fewer modes than probes some would share a mode.
        let mut probes: Vec<Probe> = (0..PROBES).map(probe).collect();
        probes.dedup_by_key(|probe| probe.mode);
        Self { probes, frame: 0, windows: 0, gains: vec![1.0; controlled] }
    }

    /// Gain of each controlled mode.
    pub(in crate::ao) fn gains(&self) -> &[f32] {
        &self.gains
    }

    /// Adds the sines of this frame to the commands.
    pub(in crate::ao) fn add_dither(&self, commands_nm: &mut [f32]) {
        for probe in &self.probes {
            let sine = self.phase(probe).sin() as f32;
            commands_nm.iter_mut().zip(&probe.commands_nm).for_each(|(out, nm)| *out = sine.mul_add(*nm, *out));
        }
    }

    /// Takes the slopes of this frame, measured with these commands on the mirror; whether a window
    /// ended, with new gains.
    pub(in crate::ao) fn update(&mut self, slopes: &[f32], commands_nm: &[f32]) -> bool {
        for number in 0..self.probes.len() {
            let (sin, cos) = self.phase(&self.probes[number]).sin_cos();
            let probe = &mut self.probes[number];
            let slope = dot(&probe.from_slopes, slopes);
            let command = dot(&probe.from_commands, commands_nm);
            for (sums, value) in [(&mut probe.in_slopes, slope), (&mut probe.in_commands, command)] {
                sums[0] += value * cos;
                sums[1] += value * sin;
            }
        }
        self.frame = (self.frame + 1) % WINDOW;
        if self.frame == 0 {
            self.end_window();
        }
        self.frame == 0
    }

    fn phase(&self, probe: &Probe) -> f64 {
        TAU * f64::from(probe.cycles * self.frame % WINDOW) / f64::from(WINDOW)
    }

    /// New gains from the sums of a window.
    fn end_window(&mut self) {
        let share = if self.windows == 0 { 1.0 } else { NEW_SHARE };
        self.windows += 1;
        for probe in &mut self.probes {
            let [q, c] = [probe.in_slopes, probe.in_commands];
            let measured = -(q[0] * c[0] + q[1] * c[1]) / (c[0] * c[0] + c[1] * c[1]);
            if measured.is_finite() {
                probe.gain += share * (measured.clamp(RANGE[0], RANGE[1]) - probe.gain);
            }
            (probe.in_slopes, probe.in_commands) = ([0.0; 2], [0.0; 2]);
        }
        for (mode, gain) in self.gains.iter_mut().enumerate() {
            *gain = interpolate(&self.probes, mode) as f32;
        }
    }
}

/// Gain of a mode between the probes; that of the nearest one outside of them.
fn interpolate(probes: &[Probe], mode: usize) -> f64 {
    let after = probes.iter().position(|probe| probe.mode >= mode);
    match after {
        None => probes.last().map_or(1.0, |last| last.gain),
        Some(0) => probes[0].gain,
        Some(after) => {
            let (left, right) = (&probes[after - 1], &probes[after]);
            let share = (mode - left.mode) as f64 / (right.mode - left.mode) as f64;
            left.gain + share * (right.gain - left.gain)
        }
    }
}

fn dot(weights: &[f32], values: &[f32]) -> f64 {
    weights.iter().zip(values).map(|(weight, value)| f64::from(weight * value)).sum()
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Bench, scene};
    use super::super::{ControlLaw, Plant};
    use super::*;

    #[test]
    fn weak_sensor_gains_are_estimated_and_restore_the_loop() {
        // A sensor that measures 0.6 of every slope, with a loop behind it that fights the sines.
        let bench = Bench::small();
        let plant: Plant = bench.plant();
        let law = ControlLaw::new(&scene("filtered_modes = 2\noptical_gains = \"dither\""), &plant).unwrap();
        let mut gains = OpticalGains::new(law.reconstructor().unwrap(), plant.interaction, 10.0);
        let mut controller = law.start();
        let mut drive = |gains: &mut OpticalGains, frames: u32| {
            let mut changes = 0.0;
            for frame in 0..frames {
                let mut commands = controller.commands_nm().to_vec();
                gains.add_dither(&mut commands);
                let on_mirror = ndarray::Array1::from_iter(commands.iter().map(|&nm| f64::from(nm)));
                let slopes: Vec<f32> = (-0.6 * plant.interaction.dot(&on_mirror)).iter().map(|&s| s as f32).collect();
                let before = controller.commands_nm().to_vec();
                controller.step(&slopes).unwrap();
                if frame >= frames / 2 {
                    let change = before.iter().zip(controller.commands_nm()).map(|(a, b)| f64::from((a - b).powi(2)));
                    changes += change.sum::<f64>();
                }
                if gains.update(&slopes, &commands) {
                    controller.set_optical_gains(gains.gains());
                }
            }
            f64::sqrt(changes)
        };
        let weak = drive(&mut gains, WINDOW);
        // Windows hold whole periods; what is not a sine is the transient of the first ten frames
        // of a thousand.
        assert!(gains.gains().iter().all(|gain| (gain - 0.6).abs() < 0.01), "{:?}", gains.gains());
        // An integrator of the gain k follows a sine of the angular frequency w per frame with the
        // changes k·D/|exp(iw) − 1 + k|, D = |exp(iw) − 1|: with w from 2π/8 to 2π·0.15 those of k
        // = 0.3 are 1.69 to 1.72 times those of 0.6·0.3.
        let restored = drive(&mut gains, WINDOW);
        assert!((restored / weak - 1.7).abs() < 0.06, "{restored} {weak}");
    }
}
