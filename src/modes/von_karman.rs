//! Statistics of the turbulent wavefront: von Kármán, and Kolmogorov for an infinite outer scale.

use crate::{Error, Result};
use std::f64::consts::PI;

/// Wavelength at which Fried's parameter is given, nm.
pub const R0_WAVELENGTH_NM: f64 = 500.0;

const GAMMA_1_6: f64 = 5.566_316_001_780_235;
const GAMMA_5_6: f64 = 1.128_787_029_908_126;
const GAMMA_11_6: f64 = 5.0 / 6.0 * GAMMA_5_6;
const GAMMA_6_5: f64 = 0.918_168_742_399_760_6;

/// Von Kármán turbulence. All results are in nm² of OPD and therefore independent of the
/// wavelength.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VonKarman {
    r0_m: f64,
    outer_scale_m: f64,
}

impl VonKarman {
    /// Turbulence of Fried parameter `r0_m` at 500 nm and outer scale `outer_scale_m`, which may be
    /// infinite.
    ///
    /// # Errors
    /// [`Error::Value`] where either is not positive, or `r0_m` is not finite.
    pub fn new(r0_m: f64, outer_scale_m: f64) -> Result<Self> {
        if !(r0_m.is_finite() && r0_m > 0.0) {
            return Err(Error::Value(format!("a Fried parameter of {r0_m} m is impossible: it must be positive")));
        }
        if outer_scale_m.is_nan() || outer_scale_m <= 0.0 {
            let text = format!("an outer scale of {outer_scale_m} m is impossible: it is positive, or infinite");
            return Err(Error::Value(text));
        }
        Ok(Self { r0_m, outer_scale_m })
    }

    /// Fried's parameter at 500 nm, m.
    pub fn r0_m(&self) -> f64 {
        self.r0_m
    }

    /// Outer scale, m.
    pub fn outer_scale_m(&self) -> f64 {
        self.outer_scale_m
    }

    /// Variance of the wavefront over all of space, nm²; infinite without an outer scale.
    ///
    /// 0.0863 (L0/r0)^(5/3) rad², here by its exact constants.
    pub fn variance_nm2(&self) -> f64 {
        // The structure function 2·B(0)·g(x) with g → Γ(1/6)/Γ(11/6)·(x/2)^(5/3) must meet
        // Kolmogorov's at small r.
        let at_outer_scale = kolmogorov(self.outer_scale_m / (PI * self.r0_m));
        nm2(at_outer_scale * GAMMA_11_6 / (2.0 * GAMMA_1_6))
    }

    /// Covariance of the wavefront at two points `r_m` apart, nm²: B(r) =
    /// B(0)·2^(1/6)/Γ(5/6)·x^(5/6)·K_{5/6}(x), x = 2πr/L0 (e.g. Conan 2008, J. Opt. Soc. Am. A 25,
    /// 526). Infinite without an outer scale.
    pub fn covariance_nm2(&self, r_m: f64) -> f64 {
        if self.outer_scale_m.is_infinite() {
            return f64::INFINITY;
        }
        self.variance_nm2() * correlation(2.0 * PI * r_m.abs() / self.outer_scale_m)
    }

    /// Structure function at the separation `r_m`, nm²: 2·(B(0) − B(r)), without the cancellation
    /// at small r; Kolmogorov's 6.88 (r/r0)^(5/3) rad² without an outer scale.
    pub fn structure_nm2(&self, r_m: f64) -> f64 {
        if self.outer_scale_m.is_infinite() {
            return nm2(kolmogorov(r_m.abs() / self.r0_m));
        }
        2.0 * self.variance_nm2() * decorrelation(2.0 * PI * r_m.abs() / self.outer_scale_m)
    }

    /// Power spectral density at the spatial frequency `f_per_m`, nm²·m²: 0.0229 r0^(−5/3) (f² +
    /// 1/L0²)^(−11/6) rad²·m².
    pub fn psd_nm2_m2(&self, f_per_m: f64) -> f64 {
        let constant = GAMMA_11_6.powi(2) / (4.0 * PI.powf(11.0 / 3.0)) * kolmogorov(1.0);
        let f2 = f_per_m.powi(2) + self.outer_scale_m.powi(-2);
        nm2(constant * self.r0_m.powf(-5.0 / 3.0) * f2.powf(-11.0 / 6.0))
    }
}

/// nm² of OPD for rad² at the wavelength of r0.
fn nm2(rad2: f64) -> f64 {
    rad2 * (R0_WAVELENGTH_NM / (2.0 * PI)).powi(2)
}

/// Kolmogorov's structure function, rad²: 2·(24/5·Γ(6/5))^(5/6) = 6.8839 times (r/r0)^(5/3).
fn kolmogorov(r_over_r0: f64) -> f64 {
    2.0 * (24.0 / 5.0 * GAMMA_6_5).powf(5.0 / 6.0) * r_over_r0.powf(5.0 / 3.0)
}

/// Argument below which the series of ten terms is used, which is exact within rounding there (its
/// terms decrease as (x/2)^2k/k!²); above, the integral, which has no cancellation.
const SERIES_TO: f64 = 1.0;

/// B(r)/B(0) at x = 2πr/L0.
fn correlation(x: f64) -> f64 {
    if x < SERIES_TO { 1.0 - decorrelation_series(x) } else { correlation_integral(x) }
}

/// 1 − B(r)/B(0), to full relative precision at small x.
fn decorrelation(x: f64) -> f64 {
    if x < SERIES_TO { decorrelation_series(x) } else { 1.0 - correlation_integral(x) }
}

/// From K_ν = π/(2 sin νπ)·(I_{−ν} − I_ν): the leading 1 is cancelled analytically. Abramowitz &
/// Stegun 9.6.2, 9.6.10.
fn decorrelation_series(x: f64) -> f64 {
    let nu = 5.0 / 6.0;
    let q = (x / 2.0).powi(2);
    // Σ_k q^k Γ(1 ± ν)/(k! Γ(k+1 ± ν)), k = 0 being 1.
    let (mut minus, mut plus, mut minus_sum, mut plus_sum) = (1.0, 1.0, 0.0, 1.0);
    for k in 1..=10 {
        let k = f64::from(k);
        minus *= q / (k * (k - nu));
        plus *= q / (k * (k + nu));
        minus_sum += minus;
        plus_sum += plus;
    }
    GAMMA_1_6 / GAMMA_11_6 * q.powf(nu) * plus_sum - minus_sum
}

/// 2^(1/6)/Γ(5/6)·x^(5/6)·K_{5/6}(x) for x ≥ 1.
fn correlation_integral(x: f64) -> f64 {
    2f64.powf(1.0 / 6.0) / GAMMA_5_6 * x.powf(5.0 / 6.0) * bessel_k(5.0 / 6.0, x)
}

/// K_ν(x) = ∫₀^∞ exp(−x cosh t) cosh νt dt (Abramowitz & Stegun 9.6.24) by the trapezoidal rule.
///
/// The integrand is even and analytic for |Im t| < π/2, so the error is about exp(−π²/step): 1e-21
/// at 0.2. At the last point it has decreased by e^(−40).
fn bessel_k(nu: f64, x: f64) -> f64 {
    let step = 0.2;
    let points = ((1.0 + 40.0 / x).acosh() / step).ceil() as usize + 1;
    let term = |i: usize| {
        let t = step * i as f64;
        (-x * t.cosh()).exp() * (nu * t).cosh()
    };
    step * (0.5 * term(0) + (1..=points).map(term).sum::<f64>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bessel_function_has_its_tabulated_values() {
        // scipy.special.kv(5/6, x), itself good to about 1e-15.
        let table = [
            (0.1, 6.678692076793386),
            (1.0, 0.5405300878883135),
            (2.0, 0.13140855226365453),
            (10.0, 1.8379047958792385e-05),
        ];
        for (x, expected) in table {
            assert!((bessel_k(5.0 / 6.0, x) / expected - 1.0).abs() < 1e-13, "K({x})");
        }
    }

    #[test]
    fn the_series_and_the_integral_agree_where_they_meet() {
        for x in [0.2, 0.5, 1.0, 1.5] {
            // 1 − integral loses what the correlation is close to 1: 1e-15 absolute, plus the
            // series' rounding.
            let difference = decorrelation_series(x) - (1.0 - correlation_integral(x));
            assert!(difference.abs() < 5e-15, "x = {x}: {difference:.1e}");
        }
    }

    #[test]
    fn small_separations_follow_kolmogorov() {
        let turbulence = VonKarman::new(0.16, 50.0).unwrap();
        let kolmogorov = VonKarman::new(0.16, f64::INFINITY).unwrap();
        for r_m in [1e-4, 1e-3] {
            // The next term is of order Γ(1/6)·x^(1/3): the ratio differs from 1 by about
            // 1.5·(2πr/L0)^(1/3).
            let expected = 6.88 * (r_m / 0.16f64).powf(5.0 / 3.0) * (500.0 / (2.0 * PI)).powi(2);
            assert!((kolmogorov.structure_nm2(r_m) / expected - 1.0).abs() < 1e-3);
            let departure = 1.0 - turbulence.structure_nm2(r_m) / kolmogorov.structure_nm2(r_m);
            let scale = (2.0 * PI * r_m / 50.0).powf(1.0 / 3.0);
            assert!((0.5 * scale..2.0 * scale).contains(&departure), "r = {r_m}: {departure}");
        }
        // With an outer scale of a light year it is Kolmogorov within rounding.
        let distant = VonKarman::new(0.16, 1e16).unwrap();
        assert!((distant.structure_nm2(1.0) / kolmogorov.structure_nm2(1.0) - 1.0).abs() < 2e-5);
    }

    #[test]
    fn spectrum_integral_is_the_variance_and_transform_covariance() {
        let turbulence = VonKarman::new(0.16, 50.0).unwrap();
        // ∫ 2πf W(f) df with f = e^u/L0: smooth and decaying on both sides, so the trapezoidal rule
        // converges fast. The cut at u = 25 leaves (e^−25)^(5/3).
        let step = 0.05;
        let integral: f64 = (-600..=500)
            .map(|i| {
                let f = (step * f64::from(i)).exp() / 50.0;
                2.0 * PI * f * turbulence.psd_nm2_m2(f) * f * step
            })
            .sum();
        assert!((integral / turbulence.variance_nm2() - 1.0).abs() < 1e-10);
        assert!((turbulence.covariance_nm2(0.0) / turbulence.variance_nm2() - 1.0).abs() < 1e-15);
        let halved = turbulence.variance_nm2() - turbulence.structure_nm2(3.0) / 2.0;
        assert!((turbulence.covariance_nm2(3.0) / halved - 1.0).abs() < 1e-14);
        // 0.0863 (L0/r0)^(5/3) rad², as the literature rounds it.
        let textbook = nm2(0.0863 * (50.0f64 / 0.16).powf(5.0 / 3.0));
        assert!((turbulence.variance_nm2() / textbook - 1.0).abs() < 5e-3);
    }

    #[test]
    fn impossible_turbulence_is_refused() {
        for (r0, outer) in [(0.0, 50.0), (f64::NAN, 50.0), (f64::INFINITY, 50.0), (0.16, 0.0), (0.16, f64::NAN)] {
            assert!(VonKarman::new(r0, outer).is_err());
        }
    }
}
