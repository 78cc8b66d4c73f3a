//! Noticing a loop that runs away.

/// Time over which the residual is averaged, s: long beside a gust, short beside the seconds that a weak instability
/// takes.
const SMOOTH_S: f64 = 0.05;
/// Time that a loop has to close before its best level counts, s.
const CLOSING_S: f64 = 0.2;
/// A residual below this fraction of the sensor's wavelength is no divergence: above it spots fall apart.
const WAVES: f64 = 0.75;
/// A loop whose poles say that it is unstable has diverged when its residual is this many times the best it has reached.
const TIMES_BEST: f64 = 3.0;

/// A loop that ran away.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Divergence {
    /// Time at which it was noticed, s.
    pub time_s: f64,
    /// Residual then, averaged over 50 ms, nm RMS.
    pub residual_rms_nm: f64,
    /// The best it had been, nm RMS.
    pub best_rms_nm: f64,
}

/// Looks at every frame.
#[derive(Debug, Clone)]
pub(super) struct Watch {
    keep: f64,
    closing: f64,
    enough_nm: f64,
    stable: bool,
    open_nm: f64,
    mean_square: f64,
    best: f64,
    frames: f64,
    frame_s: f64,
}

impl Watch {
    /// Over frames of `frame_s`, with a sensor that works at `wavelength_nm`; `stable` is what the poles say. Any loop has
    /// diverged when it leaves more than there was in the frame before it closed; a loop that merely works badly (too
    /// few good slopes, too strong a wind) has not.
    pub(super) fn new(frame_s: f64, wavelength_nm: f64, stable: bool) -> Self {
        let keep = (-frame_s / SMOOTH_S).exp();
        let enough_nm = WAVES * wavelength_nm;
        let closing = CLOSING_S / frame_s;
        Self {
            keep,
            closing,
            enough_nm,
            stable,
            open_nm: 0.0,
            mean_square: 0.0,
            best: f64::INFINITY,
            frames: 0.0,
            frame_s,
        }
    }

    /// Whether the loop has diverged with this frame.
    pub(super) fn see(&mut self, residual_rms_nm: f64) -> Option<Divergence> {
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
        let runaway = now > self.open_nm || (!self.stable && now > TIMES_BEST * self.best);
        let diverged = !now.is_finite() || (now > self.enough_nm && runaway);
        let time_s = (self.frames - 1.0) * self.frame_s;
        diverged.then_some(Divergence { time_s, residual_rms_nm: now, best_rms_nm: self.best })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn growth_is_noticed_and_a_steady_loop_is_left_alone() {
        let mut steady = Watch::new(1e-3, 640.0, true);
        assert!(steady.see(1500.0).is_none());
        // Bad seeing: large, fluctuating by a factor of two, and no divergence.
        assert!((0..20_000).all(|k| steady.see(600.0 * (1.5 + 0.5 * f64::from(k).sin())).is_none()));
        let grow = |stable| {
            let mut growing = Watch::new(1e-3, 640.0, stable);
            growing.see(1500.0);
            let noticed = (0..20_000).find_map(|k| growing.see(150.0 * (f64::from(k) * 1e-3 / 2.0).exp()));
            noticed.map(|divergence| divergence.time_s).unwrap()
        };
        // Known to be unstable: from the best, 150·e^(0.2) or so when the first frame is forgotten, to three times that,
        // by 2·ln 3 = 2.2 s more. Otherwise when it passes 1500 nm, at 2·ln 10 = 4.6 s. Smoothing adds 0.05 s.
        assert!((2.2..3.2).contains(&grow(false)), "{}", grow(false));
        assert!((4.6..4.7).contains(&grow(true)), "{}", grow(true));
        assert!(Watch::new(1e-3, 640.0, true).see(f64::NAN).is_some());
    }

    #[test]
    fn a_loop_that_never_closes_has_not_diverged() {
        let mut open = Watch::new(1e-3, 640.0, false);
        assert!((0..5000).all(|_| open.see(2000.0).is_none()));
    }
}
