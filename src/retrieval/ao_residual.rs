//! Residual of an AO system as predicted from its scene: power spectral densities of what an
//! exposure averages, and of what changes during it.

use crate::Result;
use crate::modes::VonKarman;
use crate::scene::{LoopLag, System};
use crate::telescope::Telescope;
use std::f64::consts::{PI, TAU};

/// Aliases on either side of the band along x and y that are summed: the von Kármán PSD falls by
/// 2⁻¹¹ᐟ³ to the second.
const ALIASES: i32 = 2;

/// Parameters of a scene from which its AO residual is predicted.
pub(super) struct AoResidual {
    turbulence: VonKarman,
    pub(super) cut_off_per_m: f64,
    lenslet_m: f64,
    /// Share and velocity of each layer, m/s.
    layers: Vec<(f64, [f64; 2])>,
    /// Gain, lag, seconds a frame.
    control: Option<(f64, LoopLag, f64)>,
    exposure_s: f64,
}

impl AoResidual {
    pub(super) fn from_scene(scene: &System) -> Result<Self> {
        let air = &scene.turbulence;
        let layer = |((&share, &speed), &direction): ((&f64, &f64), &f64)| {
            (share, [speed * f64::cos(direction), speed * f64::sin(direction)])
        };
        let lenslets = scene.wavefront_sensor.as_ref().map(|sensor| sensor.lenslets_across as f64);
        let width_m = scene.grid_m();
        Ok(Self {
            turbulence: Telescope::turbulence(scene)?,
            cut_off_per_m: 0.5 / scene.mirror.pitch_m,
            lenslet_m: width_m.zip(lenslets).map_or(scene.mirror.pitch_m, |(width, lenslets)| width / lenslets),
            layers: air.fractions.iter().zip(&air.wind_m_s).zip(&air.wind_dir_rad).map(layer).collect(),
            exposure_s: scene.image.exposure_s,
            control: scene.control.as_ref().map(|c| (c.gain, c.lag(), 1.0 / c.frame_rate_hz)),
        })
    }

    /// Whether the scene says how its turbulence moves.
    pub(super) fn has_layers(&self) -> bool {
        !self.layers.is_empty()
    }

    /// PSD at a frequency, averaged over an exposure, nm²·m².
    pub(super) fn density(&self, fx: f64, fy: f64) -> f64 {
        // Motion in an exposure averages the layers.
        self.sum_over_layers(fx, fy, |turns| sinc(turns).powi(2))
    }

    /// PSD at a frequency of what changes during an exposure, about the mean of the exposure,
    /// nm²·m²; 0 where the layers are not known.
    pub(super) fn change_density(&self, fx: f64, fy: f64) -> f64 {
        if self.layers.is_empty() { 0.0 } else { self.sum_over_layers(fx, fy, |turns| 1.0 - sinc(turns).powi(2)) }
    }

    /// PSD at a frequency, nm²·m², each layer times `share` of the turns of its phase during an
    /// exposure.
    fn sum_over_layers(&self, fx: f64, fy: f64, share_of: impl Fn(f64) -> f64) -> f64 {
        let own = self.turbulence.psd_nm2_m2(fx.hypot(fy));
        let in_band = fx.abs().max(fy.abs()) <= self.cut_off_per_m;
        if self.layers.is_empty() {
            return if in_band { self.turbulence.psd_nm2_m2(self.cut_off_per_m) } else { own };
        }
        let layer = |&(share, velocity): &(f64, [f64; 2])| {
            let passing_hz = fx * velocity[0] + fy * velocity[1];
            let density = match &self.control {
                _ if !in_band => own,
                None => self.turbulence.psd_nm2_m2(self.cut_off_per_m),
                Some(control) => responses(control, passing_hz)[0] * own + self.aliased(fx, fy, velocity, control),
            };
            share * share_of(self.exposure_s * passing_hz) * density
        };
        self.layers.iter().map(layer).sum()
    }

    /// Aliases that the sensor measures at (fx, fy) and the loop applies to the mirror, nm²·m².
    fn aliased(&self, fx: f64, fy: f64, velocity: [f64; 2], control: &(f64, LoopLag, f64)) -> f64 {
        let d = self.lenslet_m;
        let slopes = |fx: f64, fy: f64| sinc(d * fx) * sinc(d * fy);
        let (own, square) = (slopes(fx, fy), fx * fx + fy * fy);
        let shifts = (-ALIASES..=ALIASES).flat_map(|i| (-ALIASES..=ALIASES).map(move |j| (i, j)));
        let alias = |(i, j): (i32, i32)| {
            let (gx, gy) = (fx + f64::from(i) / d, fy + f64::from(j) / d);
            let share = (fx * gx + fy * gy) / square * slopes(gx, gy) / own;
            let [_, followed] = responses(control, gx * velocity[0] + gy * velocity[1]);
            share * share * followed * self.turbulence.psd_nm2_m2(gx.hypot(gy))
        };
        shifts.filter(|&shift| shift != (0, 0)).map(alias).sum()
    }
}

/// |rejection|² and |response|² of the integrator at a temporal frequency.
fn responses(&(gain, lag, frame_s): &(f64, LoopLag, f64), frequency_hz: f64) -> [f64; 2] {
    let turn = |frames: f64| num_complex::Complex64::from_polar(1.0, -TAU * frequency_hz * frame_s * frames);
    let whole = turn(lag.frames as f64);
    let delayed =
        if lag.newer == 0.0 { whole } else { whole * (1.0 - lag.newer) + turn(lag.frames as f64 - 1.0) * lag.newer };
    // E = (1 − z⁻¹)/(1 − z⁻¹ + g·z^(−lag)), which is 0 and not 0/0 at frequency 0.
    let integrator = 1.0 - turn(1.0);
    let rejection = integrator / (integrator + gain * delayed);
    [rejection.norm_sqr(), (1.0 - rejection).norm_sqr()]
}

fn sinc(x: f64) -> f64 {
    if x == 0.0 { 1.0 } else { (PI * x).sin() / (PI * x) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;

    #[test]
    fn fractional_lag_rejection_is_between_those_of_whole_frames() {
        let frame_s = 1e-3;
        for frequency_hz in [2.0, 10.0, 30.0, 60.0] {
            let of = |lag: f64| responses(&(0.3, LoopLag::new(lag), frame_s), frequency_hz)[0];
            let lags = [1.0, 1.2, 1.6, 1.9, 2.0, 2.5, 3.0];
            // Below the loop's bandwidth the rejected share grows with the lag: |E|² ∝ ω²/(g² +
            // ω²(1 + g − 2gL)).
            assert!(lags.windows(2).all(|pair| of(pair[0]) < of(pair[1])), "{frequency_hz} Hz: {:?}", lags.map(of));
            // By hand, for a mixture of one frame and two.
            let z = num_complex::Complex64::from_polar(1.0, -TAU * frequency_hz * frame_s);
            let known = ((1.0 - z) / (1.0 - z + 0.3 * (0.4 * z + 0.6 * z * z))).norm_sqr();
            assert!((of(1.6) / known - 1.0).abs() < 1e-12, "{frequency_hz} Hz: {} {known}", of(1.6));
        }
    }

    #[test]
    fn mean_and_change_during_an_exposure_add_up_to_the_whole() {
        let scene = Scene::preset("keck-onsky").unwrap();
        let [none, usual] = ["1e-9", "0.010"].map(|exposure_s| {
            AoResidual::from_scene(&scene.with(&[("image.exposure_s", exposure_s)]).unwrap()).unwrap()
        });
        for (fx, fy) in [(0.1, 0.2), (0.7, -0.3), (1.5, 0.4), (-3.0, 2.0)] {
            let whole = none.density(fx, fy);
            let sum = usual.density(fx, fy) + usual.change_density(fx, fy);
            // In 1 ns nothing moves; sums of seven layers round to 1e-15.
            assert!((sum / whole - 1.0).abs() < 1e-9 && none.change_density(fx, fy) < 1e-9 * whole, "{fx} {fy}");
        }
        // The ground layer, half of the turbulence, moves by a whole period of 15 cycles/m in 10
        // ms, which leaves nothing in the mean.
        assert!(usual.change_density(15.0, 0.0) > usual.density(15.0, 0.0));
    }
}
