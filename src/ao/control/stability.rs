//! Stability of the loop from its poles, computed before the first frame.

use super::inpaint::Inpainting;
use super::linalg::{eigenvalues, roots};
use super::reconstructor::Reconstructor;
use crate::Result;
use crate::scene::{ControlScene, Loop, LoopLag};
use ndarray::Array2;
use num_complex::Complex64;
use std::f64::consts::{PI, TAU};

/// Growth per frame below which a mode counts as neutral, and size below which an eigenvalue counts as zero. At this
/// rate an e-folding takes 10⁹ frames, eleven days at 1 kHz. The rounding of the eigenvalues, ε = 2e-16 times the sizes
/// of the inverse and of the interaction matrix (a condition number of up to about 1e4), is three digits below.
const NEUTRAL: f64 = 1e-9;

/// Poles of the closed loop without turbulence, noise and clipping, for a sensor and a mirror that the interaction
/// matrix describes exactly.
///
/// The commands then follow `c[k+L] = a c[k+L−1] − g K c[k]`, with K = RMD for `loop = "closed"`, RD for
/// `"full-turbulence-slopes"` (the mirror's own slopes are subtracted unfilled), and 0 for `"pseudo-open-loop"`, whose
/// slopes do not depend on the mirror; a is the fraction of a command that is kept. Each eigenvalue μ of K contributes
/// the roots of λᴸ − a λᴸ⁻¹ + g μ = 0; with a fraction of a frame, for which the mirror has the mixture (1 − f)·c[k] + f·c[k+1], those of
/// λᴸ − a λᴸ⁻¹ + g μ (1 − f + f λ) = 0.
///
/// K is evaluated within the controlled modes, the range of R. Uncontrolled modes have μ = 0 by construction: their
/// commands stay constant (or leak to 0). They are counted, and are neither stable nor unstable.
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
    /// Number of controlled modes that the fill hides from the loop (μ = 0: all of their slopes are masked, and the
    /// inpainted ones are 0). They neither grow nor are corrected; noise makes them a random walk.
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

    /// Stability of a loop whose reconstructor R is the regularised least-squares inverse of D: the eigenvalues of RD are real and from 0
    /// to 1. The `controlled` ones are those from 1/2 on; both ends of their range are listed, and the poles of the others lie between
    /// them and those of a command that is kept.
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

    /// Stability from the poles; `modes` are the numbers of controlled, uncontrolled and hidden ones.
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

/// Largest gain g for which the roots of λᴸ − kept·λᴸ⁻¹ + g μ (0 < kept ≤ 1) stay within the unit circle.
///
/// A root crosses the circle at λ = e^{iθ} if g μ = −e^{i(L−1)θ}(e^{iθ} − kept). The phase of the right side increases
/// monotonically with θ in (0, 2π), so each of the at most L+1 crossings is found by bisection, and the moduli give its
/// gain. With kept = 1 a root starts on the circle, at λ = 1, and leaves it as 1 − gμ: outwards unless μ's real part is
/// positive. A fraction of a frame makes the phase of the right side, over 1 − f + f·e^{iθ}, turn back: [`mixed_crossing`].
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
        // At θ = 0 the phase of e^{iθ} − 1 is none; from there on it is π/2. 60 halvings take the angle to the last
        // bit.
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

/// Points on the unit circle, for each frame of the lag, between which sign changes are looked for. The function has at most 2L of them;
/// two between neighbouring points, about half a degree apart, enclose a range of gains in which a mode hardly grows.
const POINTS_PER_FRAME: usize = 720;

/// Least gain g > 0 for which a root of λᴸ − kept·λᴸ⁻¹ + g μ (1 − f + f·λ) is on the unit circle: a sign change along it of the imaginary part of
/// P·Q*, P = −λᴸ⁻¹(λ − kept) and Q = μ(1 − f + f·λ), where g = P/Q is real.
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
    // Between the points θ = 0, where real μ have a crossing; with kept = 1 it is that of no gain, and is left out.
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
mod tests {
    use super::super::ControlLaw;
    use super::super::testing::{Bench, scene};
    use super::*;

    fn largest(poles: &[Complex64]) -> f64 {
        poles.iter().map(|pole| pole.norm()).fold(0.0, f64::max)
    }

    fn whole(frames: usize) -> LoopLag {
        LoopLag { frames, newer: 0.0 }
    }

    #[test]
    fn gain_limits_with_a_fraction_of_a_frame() {
        // Jury's conditions of λ² + (g f − 1)λ + g(1 − f): g(1 − f) < 1 and g(2f − 1) < 2.
        for newer in [0.1, 0.4, 0.5, 0.6, 0.75, 0.9, 0.99] {
            let known =
                f64::min(1.0 / (1.0 - newer), if newer > 0.5 { 2.0 / (2.0 * newer - 1.0) } else { f64::INFINITY });
            let found = stable_gain(Complex64::from(1.0), 1.0, LoopLag { frames: 2, newer });
            assert!((found / known - 1.0).abs() < 1e-9, "{newer}: {found} against {known}");
        }
        assert_eq!(LoopLag::new(2.0), whole(2));
        let lag = LoopLag::new(1.6);
        assert!(lag.frames == 2 && (lag.newer - 0.4).abs() < 1e-15);
    }

    #[test]
    fn gain_limits_of_the_integrator() {
        // λ = 1 − g: 2. λ² − λ + g: |λ|² = g once complex: 1. Any lag: 2 sin(π/(2(2L − 1))), from the phase by hand.
        for lag in 1..8 {
            let known = 2.0 * (PI / (2.0 * (2.0 * lag as f64 - 1.0))).sin();
            let found = stable_gain(Complex64::from(1.0), 1.0, whole(lag));
            assert!((found - known).abs() < 1e-12, "lag {lag}: {found} against {known}");
        }
        // λ = 0.9 − gμ: real μ of either sign.
        assert!((stable_gain(Complex64::from(0.5), 0.9, whole(1)) - 3.8).abs() < 1e-10);
        assert!((stable_gain(Complex64::from(-0.5), 0.9, whole(1)) - 0.2).abs() < 1e-10);
        assert_eq!(stable_gain(Complex64::from(-0.5), 1.0, whole(1)), 0.0);
        assert_eq!(stable_gain(Complex64::default(), 1.0, whole(3)), f64::INFINITY);
    }

    #[test]
    fn the_roots_reach_the_unit_circle_at_the_largest_stable_gain() {
        for (lag, kept) in [
            (1.0, 1.0),
            (1.0, 0.97),
            (2.0, 1.0),
            (3.0, 0.9),
            (7.0, 0.99),
            (1.6, 1.0),
            (1.3, 0.95),
            (2.5, 1.0),
            (4.9, 0.98),
        ] {
            let lag = LoopLag::new(lag);
            for mu in [(1.0, 0.0), (0.3, 0.8), (0.3, -0.8), (2.0, 0.1), (0.01, 1.0), (0.5, 0.5)] {
                let mu = Complex64::new(mu.0, mu.1);
                let limit = stable_gain(mu, kept, lag);
                let at = |factor: f64| largest(&mode_poles(mu, kept, limit * factor, lag).unwrap());
                // Simple roots: their errors are a few ε of the angle's.
                assert!((at(1.0) - 1.0).abs() < 1e-9, "{lag:?}, kept {kept}, {mu}: {}", at(1.0));
                assert!(at(1.001) > 1.0);
                for step in 1..50 {
                    assert!(at(f64::from(step) / 50.0) < 1.0, "{lag:?}, kept {kept}, {mu}, step {step}");
                }
            }
        }
    }

    #[test]
    fn inpainting_residual_slopes_diverges_and_open_loop_slopes_do_not() {
        // On segments of 0.9 m with 20 modes dropped, and on the paper's pupil of 10.49 m with 2: RMD has eigenvalues
        // near −0.001, so the loop diverges within seconds, as in the paper and in an independent simulation (2.1 s).
        for (bench, filtered) in [(Bench::keck(), 20), (&Bench::with_segment_side(0.862), 2)] {
            let stability = |r#loop: &str| {
                let keys = format!("filtered_modes = {filtered}\nfill = \"inpaint\"\nloop = {:?}", r#loop);
                ControlLaw::new(&scene(&keys), &bench.plant()).unwrap().stability().clone()
            };
            let residual = stability("closed");
            println!("{:.6} per frame, e-folding {:?} s", residual.growth_per_frame, residual.e_folding_s);
            assert!(!residual.stable && residual.largest_stable_gain == 0.0);
            assert!((1.0..4.0).contains(&residual.e_folding_s.unwrap()), "{:?}", residual.e_folding_s);
            assert_eq!(residual.poles.len(), residual.controlled);
            assert_eq!(residual.controlled + filtered, bench.interaction.ncols());
            assert_eq!(residual.uncontrolled, filtered);
            for r#loop in ["pseudo-open-loop", "full-turbulence-slopes"] {
                let stability = stability(r#loop);
                assert!(stability.stable && stability.e_folding_s.is_none());
                assert!((stability.growth_per_frame - 0.7).abs() < 1e-15, "{}", r#loop);
                assert!((stability.largest_stable_gain - 2.0).abs() < 1e-12, "{}", r#loop);
            }
        }
    }

    #[test]
    fn modes_that_the_fill_hides_are_neither_stable_nor_unstable() {
        // With two modes dropped the mirror of Bench::keck has modes whose slopes are all masked. The loop neither
        // corrects nor excites them; only noise does.
        let law = ControlLaw::new(&scene("filtered_modes = 2\nfill = \"inpaint\""), &Bench::keck().plant()).unwrap();
        let stability = law.stability();
        println!("{} hidden", stability.hidden);
        assert!(stability.hidden > 0 && stability.stable);
        assert!((stability.growth_per_frame - 1.0).abs() < 1e-12);
        let unfilled = ControlLaw::new(&scene("filtered_modes = 2"), &Bench::keck().plant()).unwrap();
        assert_eq!(unfilled.stability().hidden, 0);
    }

    #[test]
    fn the_poles_are_the_eigenvalues_of_the_whole_step() {
        // Direct calculation: eigenvalues of the step between two frames, (1 − l) − g R M D, over all actuators.
        let bench = Bench::keck();
        for keys in ["fill = \"inpaint\"", "leak = 0.01\nfill = \"mask-interaction-matrix\"", "basis = \"kl\""] {
            let scene = scene(&format!("filtered_modes = 10\n{keys}"));
            let law = ControlLaw::new(&scene, &bench.plant()).unwrap();
            let command = law.command_matrix();
            let command = law.inpainting().map_or(command.clone(), |inpainting| inpainting.fold_into(&command));
            let size = bench.interaction.ncols();
            let whole = Array2::<f64>::eye(size) * (1.0 - scene.leak) - command.dot(&bench.interaction) * scene.gain;
            let mut slow = eigenvalues(&whole).unwrap();
            let mut fast = law.stability().poles.clone();
            if let [only] = fast[..] {
                fast = vec![only; law.stability().controlled];
            }
            fast.extend(vec![Complex64::from(1.0 - scene.leak); law.stability().uncontrolled]);
            assert_eq!(fast.len(), size);
            // Each eigenvalue has a partner among the poles. Their rounding is about 1e-13, amplified for eigenvalues
            // that are not well separated.
            for pole in &slow {
                let near = fast.iter().map(|other| (other - pole).norm()).fold(f64::INFINITY, f64::min);
                assert!(near < 1e-8, "{keys}: {pole} is missing by {near:.1e}");
            }
            // The sums agree, so the multiplicities do too.
            let difference: Complex64 = slow.drain(..).sum::<Complex64>() - fast.iter().sum::<Complex64>();
            assert!(difference.norm() < 1e-8, "{keys}: {difference}");
        }
    }

    #[test]
    fn stable_at_the_usual_gain_and_unstable_past_its_limit() {
        let bench = Bench::small();
        for (lag, limit) in [(1, 2.0), (2, 1.0), (3, 2.0 * (PI / 10.0).sin())] {
            let at = |gain: f64| {
                let mut scene = scene(&format!("filtered_modes = 2\nlag_frames = {lag}"));
                scene.gain = gain;
                ControlLaw::new(&scene, &bench.plant()).unwrap().stability().clone()
            };
            let usual = at(0.3);
            assert!(usual.stable && (usual.largest_stable_gain - limit).abs() < 1e-12, "{usual:?}");
            assert!(at(0.999 * limit).stable && !at(1.001 * limit).stable);
        }
    }

    #[test]
    fn the_loop_grows_as_predicted() {
        // The full loop in commands, from a random start within the controlled modes, against the largest pole.
        let bench = Bench::keck();
        for keys in [
            "fill = \"inpaint\"\nlag_frames = 2",
            "gain = 1.2\nlag_frames = 2",
            "gain = 1.8\nlag_frames = 1.6",
            "fill = \"inpaint\"\ngain = 1.99",
        ] {
            let scene = scene(&format!("filtered_modes = 20\n{keys}"));
            let law = ControlLaw::new(&scene, &bench.plant()).unwrap();
            let growth = law.stability().growth_per_frame;
            assert!(growth > 1.0, "{keys}: {growth}");
            let command = law.command_matrix();
            let command = law.inpainting().map_or(command.clone(), |inpainting| inpainting.fold_into(&command));
            let feedback = command.dot(&bench.interaction) * scene.gain;
            let controlled = law.reconstructor().unwrap().controlled();
            let start = law
                .reconstructor()
                .unwrap()
                .modes()
                .dot(&ndarray::Array1::from_shape_fn(controlled, |i| (i as f64).sin()));
            let mut queue = std::collections::VecDeque::from(vec![start; scene.lag().frames]);
            // The norm oscillates if the largest poles are a complex pair; the rate is measured over many e-foldings.
            let frames = ((12.0 / growth.ln()).ceil() as usize).max(1000);
            let mut logs = [0.0; 2];
            let mut scale = 0.0;
            for frame in 0..2 * frames {
                let LoopLag { frames: lag, newer } = scene.lag();
                let present = &queue[0] * (1.0 - newer) + &queue[1 % lag] * newer;
                let next = &queue[lag - 1] - &feedback.dot(&present);
                queue.pop_front();
                queue.push_back(next);
                let norm = queue.iter().map(|c| c.dot(c)).sum::<f64>().sqrt();
                queue.iter_mut().for_each(|c| *c /= norm);
                scale += norm.ln();
                if frame + 1 == frames {
                    logs[0] = scale;
                }
            }
            logs[1] = scale;
            let rate = (logs[1] - logs[0]) / frames as f64;
            println!("{keys:?}: {frames} frames, {:.3e} per frame, {rate:.3e} measured", growth.ln());
            // The other modes are smaller by e¹² when the measurement starts, and the oscillation changes the norm by
            // less than a factor of two over at least a dozen e-foldings.
            assert!((rate / growth.ln() - 1.0).abs() < 0.05, "{keys}: {rate} against {}", growth.ln());
        }
    }
}
