//! Noticing a loop that runs away.

use super::control::Stability;

/// Time over which the residual is averaged, s: long beside a gust, short beside the seconds that a weak instability
/// takes.
const SMOOTH_S: f64 = 0.05;
/// Time that a loop has to close before its best level counts, s.
const CLOSING_S: f64 = 0.2;
/// A residual below this fraction of the sensor's wavelength is no divergence: above it spots fall apart.
const WAVES: f64 = 0.75;
/// Any loop has diverged when it leaves this many times what there was before it closed; 1 and a bit would be a gust.
///
/// One whose poles say that it is unstable has diverged once they had the time to grow e-fold and spots fall apart: a quad
/// cell saturates, and a loop that is lost may well stay below the level of the open one.
const TIMES_OPEN: f64 = 1.5;

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
    /// Logarithm of the growth in a frame that the poles predict; 0 for a stable loop.
    growth: f64,
    open_nm: f64,
    mean_square: f64,
    best: f64,
    frames: f64,
    frame_s: f64,
}

impl Watch {
    /// Over frames of `frame_s`, with a sensor that works at `wavelength_nm`; `poles` are those of the loop. A loop that
    /// merely works badly (too few good slopes, too strong a wind) has not diverged.
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

    fn watch(growth_per_frame: f64) -> Watch {
        let stable = growth_per_frame <= 1.0;
        Watch::new(1e-3, 640.0, &Stability { growth_per_frame, stable, ..Stability::default() })
    }

    #[test]
    fn growth_is_noticed_and_a_steady_loop_is_left_alone() {
        let mut steady = watch(0.7);
        assert!(steady.see(1500.0).is_none());
        // Bad seeing: large, fluctuating by a factor of two, and no divergence.
        assert!((0..20_000).all(|k| steady.see(600.0 * (1.5 + 0.5 * f64::from(k).sin())).is_none()));
        let grow = |growth_per_frame| {
            let mut growing = watch(growth_per_frame);
            growing.see(1500.0);
            let noticed = (0..20_000).find_map(|k| growing.see(150.0 * (f64::from(k) * 1e-3 / 2.0).exp()));
            noticed.map(|divergence| divergence.time_s).unwrap()
        };
        // Known to grow e-fold in 2 s: when it passes 480 nm, at 2·ln 3.2 = 2.33 s. Otherwise when it passes 2250 nm, at
        // 2·ln 15 = 5.42 s. Smoothing adds 0.05 s.
        let (known, unknown) = (grow(0.0005f64.exp()), grow(0.7));
        assert!((2.3..2.45).contains(&known), "{known}");
        assert!((5.4..5.5).contains(&unknown), "{unknown}");
        assert!(watch(0.7).see(f64::NAN).is_some());
    }

    #[test]
    fn a_loop_that_never_closes_has_not_diverged_unless_its_poles_say_so() {
        let mut open = watch(0.7);
        assert!((0..5000).all(|_| open.see(2000.0).is_none()));
        let mut lost = watch(1.01);
        assert!((0..5000).any(|_| lost.see(2000.0).is_some()));
    }
}
