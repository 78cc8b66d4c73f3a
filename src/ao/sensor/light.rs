//! Signal of the guide star on the sensor, with photon and read noise.

use crate::scene::SensorScene;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Binomial, Distribution, Poisson, StandardNormal};

/// Mean electrons above which photon noise is drawn from a normal distribution: its skewness is
/// then below 0.1.
const MANY: f64 = 100.0;

/// Signal and noise of the guide star.
#[derive(Clone)]
pub struct GuideStar {
    /// Electrons that a fully illuminated subaperture detects in a frame.
    pub electrons: f64,
    read_noise_e: f64,
    photon_noise: bool,
    rng: ChaCha8Rng,
}

impl GuideStar {
    /// Signal of the star of `scene` on lenslets of `pitch_m`, for frames of `frame_s`.
    pub fn new(scene: &SensorScene, pitch_m: f64, frame_s: f64, rng: ChaCha8Rng) -> Self {
        let photons_s_m2 = scene.zero_point_photons_s_m2 * 10f64.powf(-0.4 * scene.star_magnitude_r);
        let electrons = photons_s_m2 * scene.throughput * pitch_m * pitch_m * frame_s;
        Self { electrons, read_noise_e: scene.read_noise_e, photon_noise: scene.photon_noise, rng }
    }

    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.rng)
    }

    /// Draws the electrons detected for an expected `mean`, with photon noise only.
    fn photons(&mut self, mean: f64) -> f64 {
        if !self.photon_noise {
            return mean;
        }
        if mean > MANY {
            return mean + mean.sqrt() * self.normal();
        }
        Poisson::new(mean).map_or(0.0, |poisson| poisson.sample(&mut self.rng))
    }

    /// Draws the signal of one pixel for an expected `mean`, electrons.
    pub(super) fn pixel(&mut self, mean: f64) -> f64 {
        let read_variance_e2 = self.read_noise_e * self.read_noise_e;
        if self.photon_noise && mean > MANY {
            // Both noises are normal, so one draw of their sum is enough.
            return mean + (mean + read_variance_e2).sqrt() * self.normal();
        }
        let photons = self.photons(mean);
        if read_variance_e2 > 0.0 { photons + self.read_noise_e * self.normal() } else { photons }
    }

    /// Draws the differences between the halves of a quad cell over their sum, along x and y, for
    /// the `expected` ratios and mean `electrons`; 0 if the sum is within its noise.
    ///
    /// Four independent pixels give each difference the variance of the sum. The correlation
    /// between the two differences (the spot's quadrupole) is left out: it is 0 for a spot on the
    /// axis.
    pub(super) fn quad_cell(&mut self, expected: [f64; 2], electrons: f64) -> [f64; 2] {
        let read_e = 2.0 * self.read_noise_e;
        let (sum, differences) = if !self.photon_noise || electrons > MANY {
            let photons = if self.photon_noise { electrons } else { 0.0 };
            let noise_e = (photons + read_e * read_e).sqrt();
            let sum = electrons + noise_e * self.normal();
            (sum, expected.map(|ratio| ratio * electrons + noise_e * self.normal()))
        } else {
            let photons = self.photons(electrons);
            // Each detected photon falls on the upper half with the expected probability.
            let mut split = |ratio: f64| {
                let share = (0.5 * (1.0 + ratio)).clamp(0.0, 1.0);
                let upper = Binomial::new(photons as u64, share).map_or(0, |split| split.sample(&mut self.rng));
                2.0 * upper as f64 - photons
            };
            let split = expected.map(&mut split);
            (photons + read_e * self.normal(), split.map(|difference| difference + read_e * self.normal()))
        };
        // A sum below 3σ of the read noise may be noise only, and its ratio is not usable.
        if sum <= (3.0 * read_e).max(0.5) { [0.0; 2] } else { differences.map(|difference| difference / sum) }
    }
}
