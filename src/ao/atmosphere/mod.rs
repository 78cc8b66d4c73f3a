//! Atmosphere over the pupil: von Kármán layers with frozen flow, each moved by its wind.
//!
//! ```text
//! Lattice ── Process (one for each frequency across) ── Law ── Ribbon ── Layer ┐
//!  aliased    a recursion of five poles along          shared   endless  ring   ├ Blend → map
//!  spectrum                                                              Layer ┘
//! ```
//!
//! A *ribbon* is a strip of turbulence that is periodic across the wind and extended row by row
//! along it. The turbulence does not repeat, and only the rows over the pupil are kept, so memory
//! does not grow with the run. The covariance of the samples is that of von Kármán's spectrum at
//! every whole-sample separation of the pupil, within 0.1 % of the structure function.
//!
//! Two approximations:
//! - Between samples the interpolation is bilinear. At a shift δ of a sample along an axis it
//!   multiplies the power at k radians per sample by 1 − 2δ(1−δ)(1 − cos k): on average over shifts
//!   0.96 at 12 samples per period, 0.83 at 6, 0.67 at 4 and 1/3 at the Nyquist frequency, along
//!   each axis.
//! - An outer scale beyond [`LARGEST_OUTER_SCALE`] grid widths is replaced by that many.

mod blend;
mod layer;
mod ribbon;
mod spectrum;
#[cfg(test)]
mod tests;

use crate::ao::aligned::AlignedBuffer;
use crate::ao::footprint::Footprint;
use crate::grid::Grid;
use crate::modes::VonKarman;
use crate::scene::TurbulenceScene;
use crate::{Error, Result};
use blend::Blend;
use layer::Layer;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use ribbon::{Law, Ribbon};
use std::sync::Arc;

/// Longest outer scale that is modelled, in widths of the grid. A longer one adds little more than
/// tilt over the pupil, and would make the ribbon wider in proportion.
pub const LARGEST_OUTER_SCALE: f64 = 20.0;
/// Shortest outer scale that is modelled, in samples: the wavefront is then white, and its variance
/// negligible.
const SMALLEST_OUTER_SCALE: f64 = 1e-6;
/// Distance, in outer scales, at which the wavefront counts as independent: its correlation at x =
/// 2π·4 is 1e-10.
const MEMORY: f64 = 4.0;
/// Outer scales by which the ribbon's period exceeds the pupil: the correlation at that distance is
/// 2e-4.
const MARGIN: f64 = 1.5;
/// Largest motion in a frame, samples; a larger one is replaced by it. Both give independent
/// wavefronts.
const LARGEST_STEP: f64 = 1e9;

/// Layers of turbulence over a footprint, frame by frame.
pub struct Atmosphere {
    layers: Vec<Layer>,
    footprint: Footprint,
    /// Number of the next frame.
    frame: u64,
}

impl Atmosphere {
    /// Layers of `turbulence` over `footprint` on `grid`, a frame every `frame_s` seconds. Without
    /// layers the wavefront is flat.
    ///
    /// Fractions are those of Cn² (of r0^(−5/3)) relative to their sum. The same seed gives the
    /// same turbulence; layer i draws from the stream 2³² + i of [`ChaCha8Rng`].
    ///
    /// # Errors
    /// [`Error::Shape`] for a footprint of another grid, or lists of `turbulence` of different
    /// lengths; [`Error::Value`] for a frame without a positive, finite duration, a wind that is
    /// not finite, fractions without a positive sum, statistics that [`VonKarman`] refuses, or
    /// wavefronts too large for single precision.
    pub fn new(
        turbulence: &TurbulenceScene,
        grid: &Grid,
        footprint: &Footprint,
        frame_s: f64,
        seed: u64,
    ) -> Result<Self> {
        check(turbulence, grid, footprint, frame_s)?;
        let mut layers = Vec::with_capacity(turbulence.fractions.len());
        if !turbulence.fractions.is_empty() {
            let law = Arc::new(law(turbulence, grid, footprint)?);
            let total: f64 = turbulence.fractions.iter().sum();
            let outer_scale = outer_scale(turbulence, grid);
            for (index, fraction) in turbulence.fractions.iter().enumerate() {
                // The ribbon is that of a Fried parameter of one sample.
                let r0 = turbulence.r0_m / grid.pitch_m();
                let amplitude = ((fraction / total).sqrt() * r0.powf(-5.0 / 6.0)) as f32;
                let (speed, direction) = (turbulence.wind_m_s[index], turbulence.wind_dir_rad[index]);
                let step = (speed * frame_s / grid.pitch_m()).clamp(-LARGEST_STEP, LARGEST_STEP);
                let mut rng = ChaCha8Rng::seed_from_u64(seed);
                rng.set_stream((1 << 32) + index as u64);
                layers.push(Layer::new(
                    Ribbon::new(law.clone(), rng),
                    amplitude,
                    [step * direction.cos(), step * direction.sin()],
                    footprint.samples(),
                    footprint.stride(),
                    (MEMORY * outer_scale).ceil() as i64,
                ));
            }
        }
        Ok(Self { layers, footprint: footprint.clone(), frame: 0 })
    }

    /// Writes the OPD of the next frame, nm, over the spans of the footprint: a map of
    /// [`Footprint::len`] values. The first frame is at time 0.
    ///
    /// # Errors
    /// [`Error::Shape`] for a map of wrong length.
    pub fn next_frame(&mut self, opd_nm: &mut [f32]) -> Result<()> {
        if opd_nm.len() != self.footprint.len() {
            return Err(Error::Shape(format!(
                "a map of {} values does not match the footprint; {} are needed",
                opd_nm.len(),
                self.footprint.len()
            )));
        }
        for layer in &mut self.layers {
            layer.seek(self.frame);
        }
        self.frame += 1;
        self.blend(&self.layers, opd_nm);
        Ok(())
    }

    /// OPD of each layer at the last frame (before the first frame: at time 0), nm: maps over the
    /// spans of the footprint.
    pub fn layers_nm(&self) -> Vec<AlignedBuffer> {
        let map = |layer| {
            let mut opd_nm = self.footprint.zeros();
            self.blend(std::slice::from_ref(layer), &mut opd_nm);
            opd_nm
        };
        self.layers.iter().map(map).collect()
    }

    fn blend(&self, layers: &[Layer], opd_nm: &mut [f32]) {
        pulp::Arch::new().dispatch(Blend { layers, footprint: &self.footprint, opd_nm });
    }
}

fn check(turbulence: &TurbulenceScene, grid: &Grid, footprint: &Footprint, frame_s: f64) -> Result<()> {
    if footprint.samples() != grid.samples() {
        return Err(Error::Shape(format!(
            "a footprint of {} samples across does not match a grid of {}; one grid is needed",
            footprint.samples(),
            grid.samples()
        )));
    }
    if !(frame_s.is_finite() && frame_s > 0.0) {
        return Err(Error::Value(format!("a frame of {frame_s} s is impossible; a positive duration is needed")));
    }
    let layers = turbulence.fractions.len();
    let lists = [("wind speeds", &turbulence.wind_m_s), ("wind directions", &turbulence.wind_dir_rad)];
    for (name, list) in lists {
        if list.len() != layers {
            return Err(Error::Shape(format!("{layers} layers have {} {name}; one each is needed", list.len())));
        }
        if let Some(value) = list.iter().find(|value| !value.is_finite()) {
            return Err(Error::Value(format!("{name} of {value} are impossible; finite numbers are needed")));
        }
    }
    let total: f64 = turbulence.fractions.iter().sum();
    let negative = turbulence.fractions.iter().any(|&fraction| fraction < 0.0);
    if layers > 0 && (negative || !(total.is_finite() && total > 0.0)) {
        return Err(Error::Value(format!(
            "the layers' fractions {:?} are impossible; none may be negative, and a positive sum is needed",
            turbulence.fractions
        )));
    }
    let rms_nm = VonKarman::new(turbulence.r0_m, LARGEST_OUTER_SCALE * grid.width_m())?.variance_nm2().sqrt();
    VonKarman::new(turbulence.r0_m, turbulence.outer_scale_m)?;
    // A factor of 1e6 below the largest f32 leaves room for peaks and for intermediate results.
    if layers > 0 && (rms_nm.is_nan() || rms_nm >= 1e32) {
        return Err(Error::Value(format!(
            "a Fried parameter of {} m makes wavefronts of {rms_nm:.1e} nm; less than 1e32 nm is needed",
            turbulence.r0_m
        )));
    }
    Ok(())
}

/// Modelled outer scale, samples.
fn outer_scale(turbulence: &TurbulenceScene, grid: &Grid) -> f64 {
    let samples = turbulence.outer_scale_m / grid.pitch_m();
    samples.clamp(SMALLEST_OUTER_SCALE, LARGEST_OUTER_SCALE * grid.samples() as f64)
}

fn law(turbulence: &TurbulenceScene, grid: &Grid, footprint: &Footprint) -> Result<Law> {
    let outer_scale = outer_scale(turbulence, grid);
    // The interpolation reads one sample beyond the stride.
    let least = footprint.stride() + 2 + (MARGIN * outer_scale).ceil() as usize;
    Law::new(even_smooth(least), outer_scale)
}

/// The least even number from `least` on without prime factors beyond 5, for a fast transform.
fn even_smooth(least: usize) -> usize {
    let smooth = |mut n: usize| {
        for factor in [2, 3, 5] {
            while n.is_multiple_of(factor) {
                n /= factor;
            }
        }
        n == 1
    };
    (least..).find(|&n| n.is_multiple_of(2) && smooth(n)).unwrap_or(least)
}
