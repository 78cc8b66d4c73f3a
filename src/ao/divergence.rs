//! Detection of a diverging loop from its residual wavefront.

use super::control::Stability;

/// Time constant of the residual's running mean, s: longer than fluctuations of the seeing, shorter
/// than the seconds over which a weak instability grows.
const SMOOTH_S: f64 = 0.05;
/// Time that the loop has to converge before its residual is compared with the open loop, s.
const CLOSING_S: f64 = 0.2;
/// Residual, in wavelengths of the sensor, below which a loop does not count as diverged. Above it
/// the spots break up.
const WAVES: f64 = 0.75;
/// A stable loop counts as diverged when its residual exceeds the open-loop residual by this
/// factor; fluctuations of the seeing stay below it.
///
/// An unstable loop (from its poles) counts as diverged once it had the time to grow e-fold and the
/// residual exceeds [`WAVES`]. A quad cell saturates, so its residual may stay below the open-loop
/// one.
const TIMES_OPEN: f64 = 1.5;

/// Time and residual at which a loop diverged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Divergence {
    /// Time of the detection since the loop was closed, s.
    pub time_s: f64,
    /// Residual at that time, averaged over 50 ms, nm RMS.
    pub residual_rms_nm: f64,
    /// Smallest averaged residual before, nm RMS.
    pub best_rms_nm: f64,
}

/// Divergence detector, updated once per frame.
#[derive(Debug, Clone)]
pub(super) struct DivergenceMonitor {
    keep: f64,
    closing: f64,
    enough_nm: f64,
    /// Logarithm of the growth in a frame that the poles predict; 0 for a stable loop.
    growth: f64,
    open_nm: f64,
    mean_square: f64,
    best: f64,
    frames: f64,
    frame_s: f64,
}

impl DivergenceMonitor {
    /// Monitor of a loop with frames of `frame_s`, a sensor at `wavelength_nm`, and the given
    /// `poles`. A stable loop with a large residual (few unmasked slopes, strong wind) does not
    /// count as diverged.
    pub(super) fn new(frame_s: f64, wavelength_nm: f64, poles: &Stability) -> Self {
        let growth = if poles.stable { 0.0 } else { poles.growth_per_frame.ln() };
        let keep = (-frame_s / SMOOTH_S).exp();
        let enough_nm = WAVES * wavelength_nm;
        let closing = CLOSING_S / frame_s;
        Self {
            keep,
            closing,
            enough_nm,
            growth,
            open_nm: 0.0,
            mean_square: 0.0,
            best: f64::INFINITY,
            frames: 0.0,
            frame_s,
        }
    }

    /// Adds the residual of a frame. Returns the divergence if the loop has diverged.
    pub(super) fn update(&mut self, residual_rms_nm: f64) -> Option<Divergence> {
        let square = residual_rms_nm * residual_rms_nm;
        if self.frames == 0.0 {
            (self.open_nm, self.mean_square) = (residual_rms_nm, square);
        }
        self.mean_square = self.keep * self.mean_square + (1.0 - self.keep) * square;
        self.frames += 1.0;
        let now = self.mean_square.sqrt();
        if self.frames > self.closing {
            self.best = self.best.min(now);
        }
        let harm = self.frames > self.closing && now > TIMES_OPEN * self.open_nm;
        let grown = self.frames * self.growth > 1.0;
        let runaway = harm || grown;
        let diverged = !now.is_finite() || (now > self.enough_nm && runaway);
        let time_s = (self.frames - 1.0) * self.frame_s;
        diverged.then_some(Divergence { time_s, residual_rms_nm: now, best_rms_nm: self.best })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn monitor(growth_per_frame: f64) -> DivergenceMonitor {
        let stable = growth_per_frame <= 1.0;
        DivergenceMonitor::new(1e-3, 640.0, &Stability { growth_per_frame, stable, ..Stability::default() })
    }

    #[test]
    fn growth_is_detected_and_a_steady_loop_is_not() {
        let mut steady = monitor(0.7);
        assert!(steady.update(1500.0).is_none());
        // Bad seeing: large, fluctuating by a factor of two, and no divergence.
        assert!((0..20_000).all(|k| steady.update(600.0 * (1.5 + 0.5 * f64::from(k).sin())).is_none()));
        let grow = |growth_per_frame| {
            let mut growing = monitor(growth_per_frame);
            growing.update(1500.0);
            let detected = (0..20_000).find_map(|k| growing.update(150.0 * (f64::from(k) * 1e-3 / 2.0).exp()));
            detected.map(|divergence| divergence.time_s).unwrap()
        };
        // The residual grows e-fold in 2 s. With unstable poles it is detected at 480 nm, after
        // 2·ln 3.2 = 2.33 s; with stable poles at 2250 nm, after 2·ln 15 = 5.42 s. Smoothing adds
        // 0.05 s.
        let (known, unknown) = (grow(0.0005f64.exp()), grow(0.7));
        assert!((2.3..2.45).contains(&known), "{known}");
        assert!((5.4..5.5).contains(&unknown), "{unknown}");
        assert!(monitor(0.7).update(f64::NAN).is_some());
    }

    #[test]
    fn unconverged_loop_is_diverged_only_with_unstable_poles() {
        let mut open = monitor(0.7);
        assert!((0..5000).all(|_| open.update(2000.0).is_none()));
        let mut unstable = monitor(1.01);
        assert!((0..5000).any(|_| unstable.update(2000.0).is_some()));
    }
}
