//! Lower bound of the work of a frame: floating-point operations and bytes, stage by stage, to
//! compare a profile with.

use super::profile::LoopStage;
use super::simulator::Simulator;
use crate::scene::{Loop, SensorDetector, SensorScene};

/// Least work of a stage in a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoopWork {
    /// Additions and multiplications; a fused pair counts as two.
    pub flops: f64,
    /// Bytes read from or written to memory outside the registers, each counted once.
    pub bytes: f64,
}

/// Operations of the polynomial phasor, including its product with the amplitude.
const PHASOR: f64 = 26.0;

impl Simulator {
    /// Least work of a stage in a frame. For the turbulence it is that of the interpolation alone;
    /// the work of new turbulence depends on the wind.
    pub fn work(&self, stage: LoopStage) -> LoopWork {
        let footprint = self.footprint();
        let samples: f64 = (0..footprint.samples()).map(|y| footprint.span(y).len() as f64).sum();
        let map = 4.0 * samples;
        match stage {
            LoopStage::Atmosphere => {
                let layers = self.scene().turbulence.fractions.len() as f64;
                // Four taps for each layer; each screen is read, the sum written.
                LoopWork { flops: 8.0 * layers * samples, bytes: (layers + 1.0) * map }
            }
            LoopStage::Mirror => {
                let (columns, rows) = self.surface_taps();
                // Turbulence read, residual written, amplitude and segments read; six operations
                // for the moments.
                LoopWork { flops: 2.0 * (columns + rows) + 6.0 * samples, bytes: 4.0 * map + self.surface_bytes() }
            }
            LoopStage::Sensor => {
                if let Some(flops) = self.correction.sensor.pyramid_operations() {
                    return LoopWork { flops, bytes: 2.0 * map };
                }
                let sensing = self.scene().wavefront_sensor.as_ref();
                let per_sample = sensing.map_or(0.0, operations_per_sample);
                LoopWork { flops: per_sample * samples, bytes: 2.0 * map }
            }
            LoopStage::Control => {
                if let Some([flops, bytes]) = self.law().sparse_work() {
                    return LoopWork { flops, bytes };
                }
                let actuators = self.influence().len() as f64;
                let slopes = 2.0 * self.lenslets().subapertures.len() as f64;
                let control = self.scene().control.as_ref();
                let full = control.is_some_and(|control| control.r#loop != Loop::Closed);
                let inputs = slopes + if full { actuators } else { 0.0 };
                LoopWork { flops: 2.0 * actuators * inputs, bytes: 4.0 * actuators * inputs }
            }
        }
    }
}

/// Operations of the sensor for each sample of the pupil.
fn operations_per_sample(sensing: &SensorScene) -> f64 {
    let n = sensing.samples_per_lenslet as f64;
    match sensing.detector {
        // Pairs at odd distances within a lenslet's line: n²/4 of them for n samples, along both
        // axes; a product of two complex numbers' imaginary part, weighted and added.
        SensorDetector::QuadCell => PHASOR + 2.0 * (n / 4.0) * 5.0,
        // Complex products with 2n × n matrices, of n lines and then of 2n: 6n³ of 8 operations for
        // n² samples; then the intensities of 4n² points, 3 operations each.
        SensorDetector::Pixels => PHASOR + 48.0 * n + 12.0,
        // Two differences, weighted, with their weights.
        SensorDetector::Geometric => 8.0,
    }
}
