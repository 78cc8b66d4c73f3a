//! Stability of the loop from its poles, computed before the first frame.

use super::inpaint::Inpainting;
use super::linalg::{eigenvalues, roots};
use super::reconstructor::Reconstructor;
use crate::Result;
use crate::scene::{ControlScene, Loop, LoopLag};
use ndarray::Array2;
use num_complex::Complex64;
use std::f64::consts::{PI, TAU};

/// Growth per frame below which a mode counts as neutral, and size below which an eigenvalue counts
/// as zero. At this rate an e-folding takes 10⁹ frames, eleven days at 1 kHz. The rounding of the
/// eigenvalues, ε = 2e-16 times the sizes of the inverse and of the interaction matrix (a condition
/// number of up to about 1e4), is three digits below.
const NEUTRAL: f64 = 1e-9;

/// Poles of the closed loop without turbulence, noise and clipping, for a sensor and a mirror that
/// the interaction matrix describes exactly.
///
/// The commands then follow `c[k+L] = a c[k+L−1] − g K c[k]`, with K = RMD for `loop = "closed"`,
/// RD for `"full-turbulence-slopes"` (the mirror's own slopes are subtracted unfilled), and 0 for
/// `"pseudo-open-loop"`, whose slopes do not depend on the mirror; a is the fraction of a command
/// that is kept. Each eigenvalue μ of K contributes the roots of λᴸ − a λᴸ⁻¹ + g μ = 0; with a
/// fraction of a frame, for which the mirror has the mixture `(1 − f) c[k] + f c[k+1]`, those of λᴸ
/// − a λᴸ⁻¹ + g μ (1 − f + f λ) = 0.
///
/// K is evaluated within the controlled modes, the range of R. Uncontrolled modes have μ = 0 by
/// construction: their commands stay constant (or leak to 0). They are counted, and are neither
/// stable nor unstable.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Stability {
    /// Largest |λ| of the controlled modes: growth factor per frame of the fastest growing mode.
    pub growth_per_frame: f64,
    /// Time in which that mode grows e-fold, s; `None` for a stable loop.
    pub e_folding_s: Option<f64>,
    /// Whether no controlled mode grows.
    pub stable: bool,
    /// Largest gain up to which the loop is stable, all else equal; 0 if no gain is stable.
    pub largest_stable_gain: f64,
    /// Number of controlled modes.
    pub controlled: usize,
    /// Number of uncontrolled modes of the commands.
    pub uncontrolled: usize,
    /// Number of controlled modes that the fill hides from the loop (μ = 0: all of their slopes are
    /// masked, and the inpainted ones are 0). They neither grow nor are corrected; noise makes them
    /// a random walk.
    pub hidden: usize,
    /// Every λ of the controlled modes; a pole that all modes share by construction is listed once.
    pub poles: Vec<Complex64>,
}

impl Stability {
    pub(super) fn new(
        scene: &ControlScene,
        reconstructor: &Reconstructor,
        inpainting: Option<&Inpainting>,
        interaction: &Array2<f64>,
    ) -> Result<Self> {
        let kept = retained(scene, scene.gain);
        let mut hidden = 0;
        let (poles, largest_stable_gain) = match scene.r#loop {
            Loop::PseudoOpenLoop => (vec![Complex64::from(kept)], 2.0 - scene.leak),
            r#loop => {
                let loop_eigenvalues = match inpainting.filter(|_| r#loop == Loop::Closed) {
                    Some(inpainting) => {
                        let sensed = interaction.dot(reconstructor.modes());
                        eigenvalues(&inpainting.fold_into(reconstructor.inverse()).dot(&sensed))?
                    }
                    // R is the inverse of D on the controlled modes by construction.
                    None if reconstructor.is_inverse() => vec![Complex64::from(1.0)],
                    None => eigenvalues(&reconstructor.inverse().dot(interaction))?,
                };
                let mut poles = Vec::new();
                let mut largest = f64::INFINITY;
                for mu in loop_eigenvalues {
                    hidden += usize::from(mu.norm() <= NEUTRAL);
                    poles.extend(mode_poles(mu, kept, scene.gain, scene.lag())?);
                    largest = largest.min(stable_gain(mu, kept, scene.lag()));
                }
                (poles, largest)
            }
        };
        let controlled = reconstructor.controlled();
        let modes = [controlled, interaction.ncols() - controlled, hidden];
        Ok(Self::from_poles(scene, poles, largest_stable_gain, modes))
    }

    /// Stability of a loop whose reconstructor R is the regularised least-squares inverse of D: the
    /// eigenvalues of RD are real and from 0 to 1. The `controlled` ones are those from 1/2 on;
    /// both ends of their range are listed, and the poles of the others lie between them and those
    /// of a command that is kept.
    ///
    /// # Errors
    /// Internal errors of the eigenvalues only.
    pub(super) fn of_regularised(scene: &ControlScene, controlled: usize, actuators: usize) -> Result<Self> {
        let kept = retained(scene, scene.gain);
        let modes = [controlled, actuators - controlled, 0];
        if scene.r#loop == Loop::PseudoOpenLoop {
            return Ok(Self::from_poles(scene, vec![Complex64::from(kept)], 2.0 - scene.leak, modes));
        }
        let mut poles = Vec::new();
        for mu in [0.5, 1.0] {
            poles.extend(mode_poles(Complex64::from(mu), kept, scene.gain, scene.lag())?);
        }
        // The largest stable gain of a real mode is inverse to its eigenvalue.
        let largest = stable_gain(Complex64::from(1.0), kept, scene.lag());
        Ok(Self::from_poles(scene, poles, largest, modes))
    }

    /// Stability from the poles; `modes` are the numbers of controlled, uncontrolled and hidden
    /// ones.
    fn from_poles(scene: &ControlScene, poles: Vec<Complex64>, largest_stable_gain: f64, modes: [usize; 3]) -> Self {
        let [controlled, uncontrolled, hidden] = modes;
        let growth_per_frame = poles.iter().map(|pole| pole.norm()).fold(0.0, f64::max);
        let stable = growth_per_frame <= 1.0 + NEUTRAL;
        Self {
            growth_per_frame,
            e_folding_s: (!stable).then(|| 1.0 / (growth_per_frame.ln() * scene.frame_rate_hz)),
            stable,
            largest_stable_gain,
            controlled,
            uncontrolled,
            hidden,
            poles,
        }
    }
}

/// Fraction of the last command that a law keeps.
pub(super) fn retained(scene: &ControlScene, gain: f64) -> f64 {
    match scene.r#loop {
        Loop::Closed | Loop::FullTurbulenceSlopes => 1.0 - scene.leak,
        Loop::PseudoOpenLoop => 1.0 - scene.leak - gain,
    }
}

/// Computes the roots of λᴸ − kept·λᴸ⁻¹ + gain·μ·(1 − newer + newer·λ).
fn mode_poles(mu: Complex64, kept: f64, gain: f64, lag: LoopLag) -> Result<Vec<Complex64>> {
    let LoopLag { frames, newer } = lag;
    let mut coefficients = vec![Complex64::default(); frames];
    coefficients[0] -= kept;
    coefficients[frames - 1] += mu * gain * (1.0 - newer);
    if newer != 0.0 {
        coefficients[frames - 2] += mu * gain * newer;
    }
    roots(&coefficients)
}

/// Largest gain g for which the roots of λᴸ − kept·λᴸ⁻¹ + g μ (0 < kept ≤ 1) stay within the unit
/// circle.
///
/// A root crosses the circle at λ = e^{iθ} if g μ = −e^{i(L−1)θ}(e^{iθ} − kept). The phase of the
/// right side increases monotonically with θ in (0, 2π), so each of the at most L+1 crossings is
/// found by bisection, and the moduli give its gain. With kept = 1 a root starts on the circle, at
/// λ = 1, and leaves it as 1 − gμ: outwards unless μ's real part is positive. A fraction of a frame
/// makes the phase of the right side, over 1 − f + f·e^{iθ}, turn back: [`mixed_crossing`].
fn stable_gain(mu: Complex64, kept: f64, lag: LoopLag) -> f64 {
    if mu.norm() <= NEUTRAL {
        return f64::INFINITY;
    }
    if kept == 1.0 && mu.re <= 0.0 {
        return 0.0;
    }
    if lag.newer != 0.0 {
        return mixed_crossing(mu, kept, lag);
    }
    let lag = lag.frames;
    let phase = |theta: f64| {
        let turn = theta.sin().atan2(theta.cos() - kept).rem_euclid(TAU);
        PI + (lag - 1) as f64 * theta + turn
    };
    let mut smallest = f64::INFINITY;
    for turns in 0..=lag + 1 {
        let wanted = mu.arg() + TAU * turns as f64;
        // At θ = 0 the phase of e^{iθ} − 1 is none; from there on it is π/2. 60 halvings take the
        // angle to the last bit.
        let (mut low, mut high) = (if kept < 1.0 { 0.0 } else { 1e-12 }, TAU - 1e-12);
        if wanted < phase(low) || wanted > phase(high) {
            continue;
        }
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if phase(middle) < wanted { low = middle } else { high = middle }
        }
        smallest = smallest.min((Complex64::from_polar(1.0, low) - kept).norm() / mu.norm());
    }
    smallest
}

/// Points on the unit circle, for each frame of the lag, between which sign changes are looked for.
/// The function has at most 2L of them; a pair of crossings between neighbouring points, about half
/// a degree apart, is missed: between its gains a mode grows very slowly.
const POINTS_PER_FRAME: usize = 720;

/// Least gain g > 0 for which a root of λᴸ − kept·λᴸ⁻¹ + g μ (1 − f + f·λ) is on the unit circle: a
/// sign change along it of the imaginary part of P·Q*, P = −λᴸ⁻¹(λ − kept) and Q = μ(1 − f + f·λ),
/// where g = P/Q is real.
fn mixed_crossing(mu: Complex64, kept: f64, lag: LoopLag) -> f64 {
    let (points, newer) = (POINTS_PER_FRAME * lag.frames, lag.newer);
    let parts = |theta: f64| {
        let root = Complex64::from_polar(1.0, theta);
        let p = -Complex64::from_polar(1.0, (lag.frames - 1) as f64 * theta) * (root - kept);
        (p, mu * (1.0 - newer + newer * root))
    };
    let imaginary = |theta: f64| {
        let (p, q) = parts(theta);
        (p * q.conj()).im
    };
    // Between the points θ = 0, where real μ have a crossing; with kept = 1 it is that of no gain,
    // and is left out.
    let ends = if kept < 1.0 { [-0.5 * TAU / points as f64; 2] } else { [1e-9, -1e-9] };
    let angle = |i: usize| ends[0] + (TAU + ends[1] - ends[0]) * i as f64 / points as f64;
    let mut smallest = f64::INFINITY;
    for i in 0..points {
        let (mut low, mut high) = (angle(i), angle(i + 1));
        let sign = imaginary(low) > 0.0;
        if sign == (imaginary(high) > 0.0) {
            continue;
        }
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if (imaginary(middle) > 0.0) == sign { low = middle } else { high = middle }
        }
        let (p, q) = parts(0.5 * (low + high));
        let gain = (p * q.conj()).re / q.norm_sqr();
        if gain > 0.0 {
            smallest = smallest.min(gain);
        }
    }
    smallest
}

#[cfg(test)]
mod tests;
