//! Prior of the wavefront: an isotropic power spectral density (PSD), predicted for the residual of
//! an AO system or measured.
//!
//! Densities are in nm²·m² against cycles/m, so that `∫ S(f) 2πf df` is the variance in nm² on any
//! grid.

use super::ao_residual::AoResidual;
use crate::fourier::disc;
use crate::scene::System;
use crate::{Error, Result};
use std::f64::consts::{PI, TAU};

/// Isotropic power spectral density, tabulated over the modulus of the spatial frequency.
#[derive(Debug, Clone, PartialEq)]
pub struct RadialPsd {
    /// Distance between neighbouring entries, cycles/m; the first is at frequency 0.
    step_per_m: f64,
    /// Densities, positive.
    density_nm2_m2: Vec<f64>,
}

/// RMS of static aberrations that are not yet corrected or estimated, whose variance the prior
/// includes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StaticAberrationRms {
    /// RMS of the segments' pistons, nm.
    pub piston_rms_nm: f64,
    /// RMS of the NCPA, nm.
    pub ncpa_rms_nm: f64,
}

impl Default for StaticAberrationRms {
    /// 60 nm of pistons and 70 nm of NCPA, as of a telescope before it is phased this way. A factor
    /// of two either way changes little, because the data dominate the prior at the frequencies
    /// that an image resolves.
    fn default() -> Self {
        Self { piston_rms_nm: 60.0, ncpa_rms_nm: 70.0 }
    }
}

/// Entries of a predicted PSD up to the mirror's cut-off frequency.
const ENTRIES_IN_BAND: usize = 40;
/// Entries in all, up to five times the cut-off, which a pupil of ten samples an actuator does not
/// exceed. Beyond, the PSD is extrapolated.
const ENTRIES: usize = 5 * ENTRIES_IN_BAND;
/// Directions over which a predicted PSD is averaged: the corrected band is a square, and winds
/// have any direction.
const DIRECTIONS: usize = 96;
impl RadialPsd {
    /// A PSD of entries `step_per_m` apart, from frequency 0 on. Between them its logarithm is
    /// linear; beyond the last it falls as f^(−11/3).
    ///
    /// # Errors
    /// [`Error::Value`] for fewer than two entries, a step that is not positive, or an entry that
    /// is not positive.
    pub fn new(step_per_m: f64, density_nm2_m2: Vec<f64>) -> Result<Self> {
        if !(step_per_m.is_finite() && step_per_m > 0.0) || density_nm2_m2.len() < 2 {
            let entries = density_nm2_m2.len();
            return Err(Error::Value(format!(
                "a power spectral density of {entries} entries {step_per_m} cycles/m apart was given: two or more and a \
                 positive step are needed"
            )));
        }
        if let Some((k, value)) = density_nm2_m2.iter().enumerate().find(|(_, s)| !(s.is_finite() && **s > 0.0)) {
            return Err(Error::Value(format!(
                "entry {k} of a power spectral density is {value} nm²·m²: a positive number is needed"
            )));
        }
        Ok(Self { step_per_m, density_nm2_m2 })
    }

    /// Predicts the PSD of the residual of the AO system of `scene`, plus that of static
    /// aberrations `unknown`.
    ///
    /// Beyond the mirror's cut-off, |fx| or |fy| > 1/(2·pitch), it is the turbulence (fitting
    /// error). Within, where the scene has a loop and layers, it is each layer times the loop's
    /// rejection `1/(1 + g·z^(−lag)/(1 − z^(−1)))` (a fraction of a frame mixes both commands) at
    /// the temporal frequency f·v (servo-lag), plus the aliases of the sensor times the loop's
    /// response (Rigaut, Véran & Lai 1998, SPIE 3353, 1038: the ratio of the transfer functions of
    /// slopes that are means over a subaperture). Where it has no loop the band is as flat as the
    /// PSD at the cut-off. All terms are averaged over the motion of the layers in an exposure.
    ///
    /// The sensor's noise is left out: for stars bright enough for such images it is below 10 nm.
    ///
    /// # Errors
    /// Those of [`VonKarman::new`].
    pub fn ao_residual(scene: &System, unknown: StaticAberrationRms) -> Result<Self> {
        let residual = AoResidual::from_scene(scene)?;
        let step_per_m = residual.cut_off_per_m / ENTRIES_IN_BAND as f64;
        let aperture_m = scene.grid_m().unwrap_or(1.0);
        let segment_m2 = 1.5 * 3f64.sqrt() * scene.pupil.segment_side_m.powi(2);
        let density = |k: usize| {
            // Frequency 0 is the piston of the whole pupil, to which images are blind: its entry is
            // its neighbour's.
            let f = step_per_m * (k as f64).max(0.5);
            let turn = |i: usize| TAU * (i as f64 + 0.5) / DIRECTIONS as f64;
            let dynamic: f64 = (0..DIRECTIONS).map(|i| residual.density(f * turn(i).cos(), f * turn(i).sin())).sum();
            dynamic / DIRECTIONS as f64
                + unknown.piston_rms_nm.powi(2) * segment_m2 * disc(f * (segment_m2 / PI).sqrt())
                + low_order(f, aperture_m, residual.cut_off_per_m) * unknown.ncpa_rms_nm.powi(2)
        };
        Self::new(step_per_m, (0..ENTRIES).map(density).collect())
    }

    /// Density at a frequency, nm²·m².
    pub fn density_nm2_m2_at(&self, f_per_m: f64) -> f64 {
        let place = f_per_m.abs() / self.step_per_m;
        let last = self.density_nm2_m2.len() - 1;
        if place >= last as f64 {
            return self.density_nm2_m2[last] * (place / last as f64).powf(-11.0 / 3.0);
        }
        let (k, share) = (place as usize, place.fract());
        let [low, high] = [k, k + 1].map(|k| self.density_nm2_m2[k].ln());
        (low + share * (high - low)).exp()
    }

    /// Integrates the variance between two frequencies, nm²: `∫ S(f) 2πf df`.
    #[cfg(test)]
    pub fn variance_nm2(&self, from_per_m: f64, to_per_m: f64) -> f64 {
        // The midpoint rule, ten points an entry: a straight line in log S is then exact to 1e-3.
        let points = (((to_per_m - from_per_m) / self.step_per_m * 10.0).ceil() as usize).max(1);
        let step = (to_per_m - from_per_m) / points as f64;
        let term = |i: usize| {
            let f = from_per_m + (i as f64 + 0.5) * step;
            self.density_nm2_m2_at(f) * TAU * f * step
        };
        (0..points).map(term).sum()
    }
}

/// PSD of variance 1 that falls as f⁻³ (Zernike polynomials whose variance falls as the square of
/// their order) from one cycle over the aperture on, and is 0 beyond the mirror's cut-off, where a
/// mirror can correct no NCPA.
fn low_order(f: f64, aperture_m: f64, cut_off_per_m: f64) -> f64 {
    let first = 1.0 / aperture_m;
    if f > cut_off_per_m {
        return 0.0;
    }
    // ∫ 2πf (f² + f₁²)^(−3/2) df = 2π/f₁·(1 − 1/√(1 + (cut-off/f₁)²)).
    let whole = TAU / first * (1.0 - 1.0 / (1.0 + (cut_off_per_m / first).powi(2)).sqrt());
    (f * f + first * first).powf(-1.5) / whole
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;

    fn scene() -> Scene {
        Scene::preset("keck-onsky").unwrap()
    }

    /// Beyond the cut-off nothing is corrected: 0.23·(pitch/r0)^(5/3) rad² of Kolmogorov turbulence
    /// outside of a square (Rigaut et al. 1998), 0.28 with a real mirror's edges.
    #[test]
    fn fitting_error_agrees_with_the_textbook() {
        let scene = scene().with_override("image.exposure_s", "1e-6").unwrap();
        let nothing = StaticAberrationRms { piston_rms_nm: 0.0, ncpa_rms_nm: 0.0 };
        let psd = RadialPsd::ao_residual(&scene, nothing).unwrap();
        let cut_off = 0.5 / scene.mirror.pitch_m;
        let nm2 = (500.0 / TAU).powi(2) * (scene.mirror.pitch_m / scene.turbulence.r0_m).powf(5.0 / 3.0);
        // The corners of the square hold what the in-band error does not reach: from √2 times the
        // cut-off on all of it is fitting error. Kolmogorov beyond f: 0.0229·6π/5·f^(−5/3); the
        // tail beyond the tables' end by its power law.
        let from = 2f64.sqrt() * cut_off;
        let tail = 0.0229 * 6.0 * PI / 5.0 * (from * scene.mirror.pitch_m).powf(-5.0 / 3.0) * nm2;
        let found = psd.variance_nm2(from, 200.0 * cut_off);
        // 0.0229 has three digits; the outer scale takes 3e-4, the end 1e-4.
        assert!((found / tail - 1.0).abs() < 5e-3, "{found} {tail}");
        let whole = psd.variance_nm2(cut_off, 200.0 * cut_off) / nm2;
        assert!((0.2..0.3).contains(&whole), "{whole}");
    }

    #[test]
    fn unknown_aberrations_add_their_variance() {
        let variance = |piston_rms_nm, ncpa_rms_nm| {
            let psd = RadialPsd::ao_residual(&scene(), StaticAberrationRms { piston_rms_nm, ncpa_rms_nm }).unwrap();
            psd.variance_nm2(0.0, 20.0)
        };
        let none = variance(0.0, 0.0);
        // A disc's PSD falls as f⁻³, so that 2/(2π²·f·a) of it lie beyond f: 2.8 % beyond the
        // table's end at 4.4 cycles/m (a = 0.82 m), where the extrapolation falls too fast. The
        // entry at frequency 0 and the interpolation between entries are good to a few percent of
        // the NCPA, which fall over a few entries.
        let pistons = variance(60.0, 0.0) - none;
        assert!((0.96..1.0).contains(&(pistons / 3600.0)), "{pistons}");
        let ncpa = variance(0.0, 70.0) - none;
        assert!((ncpa / 4900.0 - 1.0).abs() < 0.05, "{ncpa}");
    }

    /// The residual in the band falls with the frame rate.
    #[test]
    fn a_faster_loop_rejects_more() {
        let nothing = StaticAberrationRms { piston_rms_nm: 0.0, ncpa_rms_nm: 0.0 };
        let in_band = |settings: &[(&str, &str)]| {
            let scene = scene().with(settings).unwrap();
            RadialPsd::ao_residual(&scene, nothing).unwrap().variance_nm2(0.0, 0.5 / scene.mirror.pitch_m).sqrt()
        };
        let (own, slow) = (in_band(&[]), in_band(&[("control.frame_rate_hz", "200")]));
        assert!(own < 0.6 * slow, "{own} {slow}");
        // Servo-lag with an integrator of gain 0.3 is a delay of 1/0.3 + 1/2 frames: σ² =
        // (2π)²·τ²·∫ (f·v)² W, which for Greenwood's time comes to some 40 nm; aliasing to
        // 0.28·(d/r0)^(5/6) rad, some 60.
        assert!((40.0..120.0).contains(&own), "{own}");
    }

    #[test]
    fn invalid_psds_are_refused() {
        assert!(RadialPsd::new(0.0, vec![1.0; 4]).is_err());
        assert!(RadialPsd::new(0.1, vec![1.0]).is_err());
        assert!(RadialPsd::new(0.1, vec![1.0, 0.0]).unwrap_err().to_string().contains("entry 1"));
    }
}
