//! Coefficients to the field in the pupil, and back.
//!
//! At the lit samples p, with the smooth phase ψ (diversity and smooth modes) and the segments' phasors,
//!
//! `E_p = P_p·a_p`,  `P_p = exp(2πi·ψ_p)`,  `a_p = Σ_s w_ps·q_s`,  `q_s = exp(2πi·c_s/λ)`.
//!
//! Summing phasors rather than phases keeps pistons exact at any size on a band-limited pupil, where a sample belongs
//! to several segments. Backwards, from Ē (so that dJ = 2 Re Σ Ē*·dE), with `g = Ē·P*`:
//!
//! `dJ/dψ_p = 4π·Im(g_p·a_p*)`,  `dJ/dc_s = (4π/λ)·Im(q_s*·Σ_p w_ps·g_p)`,  `dJ/dy_j = Σ_p B_jp·dJ/dψ_p`.

use super::optics::{Mode, Optics};
use super::phasor::{Polynomial, phasor};
use super::smooth::{SmoothModes, SmoothScratch};
use ndarray::ArrayView1;

/// A stretch of neighbouring lit samples in which one segment shows, filled up to whole vectors with weights of 0.
struct Run {
    segment: usize,
    first_lit: usize,
    first_weight: usize,
    /// Samples, without the filling.
    length: usize,
}

/// Neighbouring lit samples of one row of the grid.
struct Strip {
    first_lit: usize,
    /// Where the first one's real part lies in a row-planar grid; its imaginary part is `samples` further.
    place: usize,
    length: usize,
}

/// Samples that runs are worked on at once: a vector of the widest registers in f32, two in f64. The edge of a segment
/// is rarely further from the other.
const STRIDE: usize = 16;

/// The stage, in the chain's precision.
pub(super) struct Field<T> {
    samples: usize,
    lit: usize,
    strips: Vec<Strip>,
    diversity_turns: Vec<T>,
    smooth: SmoothModes<T>,
    runs: Vec<Run>,
    /// Weights in the order of the runs and their fillings, scaled so that |U|² is the PSF.
    weight: Vec<T>,
    slopes: Option<(Vec<T>, Vec<T>)>,
    segments: usize,
    turns_per_nm: f64,
    modes: Vec<Mode>,
}

/// One image's memory for this stage.
pub(super) struct FieldState<T> {
    /// Smooth phase, turns; then dJ/dψ.
    pub(super) turns: Vec<T>,
    phasor: [Vec<T>; 2],
    pub(super) aperture: [Vec<T>; 2],
    /// `Ē·P*`.
    back: [Vec<T>; 2],
    /// Piston, tip and tilt of each segment, turns.
    pose: Vec<[T; 3]>,
    smooth: Vec<T>,
    /// Sums over the samples of the derivatives by `pose` and by `smooth`.
    pose_bar: Vec<[f64; 3]>,
    smooth_bar: Vec<f64>,
    smooth_scratch: SmoothScratch<T>,
}

impl<T: Polynomial> Field<T> {
    pub(super) fn new(optics: &Optics) -> Self {
        let parts = optics.parts();
        let weights = &parts.weights;
        let amplitude = optics.intensity_scale().sqrt();
        let (runs, order) = runs(&weights.offsets, &weights.segment, weights.segments);
        let samples = parts.sampling.samples;
        let turns_per_nm = 1.0 / parts.wavelength_nm;
        let gather = |values: &[f64], scale: f64| {
            order.iter().map(|e| e.map_or(T::zero(), |e| T::of(values[e] * scale))).collect::<Vec<T>>()
        };
        Self {
            samples,
            lit: weights.lit.len(),
            strips: strips(&weights.lit, samples),
            diversity_turns: optics.diversity_turns().into_iter().map(T::of).collect(),
            smooth: SmoothModes::new(optics),
            weight: gather(&weights.weight, amplitude),
            slopes: match (&parts.slopes, optics.tilts_segments()) {
                (Some((x, y)), true) => Some((gather(x, 1.0), gather(y, 1.0))),
                _ => None,
            },
            runs,
            segments: weights.segments,
            turns_per_nm,
            modes: parts.modes.clone(),
        }
    }

    pub(super) fn state(&self) -> FieldState<T> {
        // The filling of the last run reaches beyond the last lit sample.
        let zeros = || vec![T::zero(); self.lit + STRIDE];
        FieldState {
            turns: zeros(),
            phasor: [zeros(), zeros()],
            aperture: [zeros(), zeros()],
            back: [zeros(), zeros()],
            pose: vec![[T::zero(); 3]; self.segments],
            smooth: vec![T::zero(); self.smooth.len()],
            pose_bar: vec![[0.0; 3]; self.segments],
            smooth_bar: vec![0.0; self.smooth.len()],
            smooth_scratch: self.smooth.scratch(),
        }
    }

    /// Writes the coefficients (nm) into the state, sorted by what they move.
    #[inline(always)]
    fn set(&self, coefficients_nm: ArrayView1<f64>, state: &mut FieldState<T>) {
        state.pose.fill([T::zero(); 3]);
        state.smooth.fill(T::zero());
        for (&mode, &nm) in self.modes.iter().zip(coefficients_nm) {
            match mode {
                Mode::Smooth(row) => state.smooth[row] += T::of(nm),
                Mode::Piston(s) => add(&mut state.pose[s][0], nm * self.turns_per_nm),
                Mode::Tip(s) => add(&mut state.pose[s][1], nm * self.turns_per_nm),
                Mode::Tilt(s) => add(&mut state.pose[s][2], nm * self.turns_per_nm),
            }
        }
    }

    /// Coefficients (nm) to the field on the row-planar pupil grid. `grid` must be zero outside the lit samples.
    #[inline(always)]
    pub(super) fn forward(&self, coefficients_nm: ArrayView1<f64>, state: &mut FieldState<T>, grid: &mut [T]) {
        state.turns[..self.lit].copy_from_slice(&self.diversity_turns);
        self.forward_from(coefficients_nm, state, grid);
    }

    /// The same with a phase of its own at each lit sample, turns, beside what the coefficients make.
    #[inline(always)]
    pub(super) fn forward_free(
        &self,
        coefficients_nm: ArrayView1<f64>,
        free_turns: &[T],
        state: &mut FieldState<T>,
        grid: &mut [T],
    ) {
        let parts = self.diversity_turns.iter().zip(free_turns);
        state.turns[..self.lit].iter_mut().zip(parts).for_each(|(turns, (&own, &free))| *turns = own + free);
        self.forward_from(coefficients_nm, state, grid);
    }

    /// The same from the phase in the state to which the coefficients add theirs.
    #[inline(always)]
    fn forward_from(&self, coefficients_nm: ArrayView1<f64>, state: &mut FieldState<T>, grid: &mut [T]) {
        self.set(coefficients_nm, state);
        self.smooth.add(&state.smooth, &mut state.turns[..self.lit], &mut state.smooth_scratch);
        let [re, im] = &mut state.phasor;
        for ((re, im), &turns) in re.iter_mut().zip(im.iter_mut()).zip(&state.turns) {
            (*re, *im) = phasor(turns);
        }
        self.apertures(state);
        let ([p_re, p_im], [a_re, a_im]) = (&state.phasor, &state.aperture);
        for &Strip { first_lit, place, length } in &self.strips {
            let [p_re, p_im, a_re, a_im] = [p_re, p_im, a_re, a_im].map(|plane| &plane[first_lit..][..length]);
            let (re, im) = grid[place..].split_at_mut(self.samples);
            let (re, im) = (&mut re[..length], &mut im[..length]);
            for i in 0..length {
                re[i] = p_re[i] * a_re[i] - p_im[i] * a_im[i];
                im[i] = p_re[i] * a_im[i] + p_im[i] * a_re[i];
            }
        }
    }

    #[inline(always)]
    fn apertures(&self, state: &mut FieldState<T>) {
        let [re, im] = &mut state.aperture;
        re.fill(T::zero());
        im.fill(T::zero());
        for run in &self.runs {
            let filled = run.filled();
            let weight = &self.weight[run.first_weight..][..filled];
            let re = &mut re[run.first_lit..][..filled];
            let im = &mut im[run.first_lit..][..filled];
            let [c, t, u] = state.pose[run.segment];
            match &self.slopes {
                None => {
                    let (q_re, q_im) = phasor(c);
                    for i in 0..filled {
                        re[i] = weight[i].mul_add(q_re, re[i]);
                        im[i] = weight[i].mul_add(q_im, im[i]);
                    }
                }
                Some((x, y)) => {
                    let (x, y) = (&x[run.first_weight..][..filled], &y[run.first_weight..][..filled]);
                    for i in 0..filled {
                        let (q_re, q_im) = phasor(t.mul_add(x[i], u.mul_add(y[i], c)));
                        re[i] = weight[i].mul_add(q_re, re[i]);
                        im[i] = weight[i].mul_add(q_im, im[i]);
                    }
                }
            }
        }
    }

    /// Ē on the row-planar pupil grid to the gradient per nm of each coefficient.
    #[inline(always)]
    pub(super) fn adjoint(&self, grid_bar: &[T], state: &mut FieldState<T>, gradient: &mut [f64]) {
        let ([p_re, p_im], [a_re, a_im]) = (&state.phasor, &state.aperture);
        let [g_re, g_im] = &mut state.back;
        for &Strip { first_lit, place, length } in &self.strips {
            let lit = first_lit..first_lit + length;
            let [p_re, p_im, a_re, a_im] = [p_re, p_im, a_re, a_im].map(|plane| &plane[lit.clone()]);
            let (g_re, g_im) = (&mut g_re[lit.clone()], &mut g_im[lit.clone()]);
            let turns = &mut state.turns[lit];
            let (e_re, e_im) = grid_bar[place..].split_at(self.samples);
            let (e_re, e_im) = (&e_re[..length], &e_im[..length]);
            for i in 0..length {
                g_re[i] = e_re[i] * p_re[i] + e_im[i] * p_im[i];
                g_im[i] = e_im[i] * p_re[i] - e_re[i] * p_im[i];
                turns[i] = g_im[i] * a_re[i] - g_re[i] * a_im[i];
            }
        }
        let four_pi = 4.0 * std::f64::consts::PI;
        self.pose_gradient(state);
        self.smooth.project(&state.turns[..self.lit], &mut state.smooth_bar, &mut state.smooth_scratch);
        let (pose, smooth) = (&state.pose_bar, &state.smooth_bar);
        for (&mode, gradient) in self.modes.iter().zip(gradient.iter_mut()) {
            *gradient = four_pi
                * match mode {
                    Mode::Smooth(row) => smooth[row],
                    Mode::Piston(s) => pose[s][0] * self.turns_per_nm,
                    Mode::Tip(s) => pose[s][1] * self.turns_per_nm,
                    Mode::Tilt(s) => pose[s][2] * self.turns_per_nm,
                };
        }
    }

    /// Σ_p w·Im(q*·g)·(1, x, y) of each segment.
    #[inline(always)]
    fn pose_gradient(&self, state: &mut FieldState<T>) {
        let [g_re, g_im] = &state.back;
        let sums = &mut state.pose_bar;
        sums.fill([0.0; 3]);
        for run in &self.runs {
            let filled = run.filled();
            let weight = &self.weight[run.first_weight..][..filled];
            let (re, im) = (&g_re[run.first_lit..][..filled], &g_im[run.first_lit..][..filled]);
            let [c, t, u] = state.pose[run.segment];
            let sum = &mut sums[run.segment];
            match &self.slopes {
                None => {
                    let (q_re, q_im) = phasor(c);
                    let mut lanes = [[T::zero(); STRIDE]; 2];
                    for first in (0..filled).step_by(STRIDE) {
                        let [weight, re, im] = [weight, re, im].map(|values| &values[first..][..STRIDE]);
                        for i in 0..STRIDE {
                            lanes[0][i] = weight[i].mul_add(re[i], lanes[0][i]);
                            lanes[1][i] = weight[i].mul_add(im[i], lanes[1][i]);
                        }
                    }
                    let [re, im] = lanes.map(|lanes| lanes.iter().map(|lane| lane.wide()).sum::<f64>());
                    sum[0] += im * q_re.wide() - re * q_im.wide();
                }
                Some((x, y)) => {
                    let (x, y) = (&x[run.first_weight..][..filled], &y[run.first_weight..][..filled]);
                    for i in 0..run.length {
                        let (q_re, q_im) = phasor(t.mul_add(x[i], u.mul_add(y[i], c)));
                        let part = weight[i] * (q_re * im[i] - q_im * re[i]);
                        sum[0] += part.wide();
                        sum[1] += (part * x[i]).wide();
                        sum[2] += (part * y[i]).wide();
                    }
                }
            }
        }
    }

    /// dJ/dψ at each lit sample, per turn, as [`Field::adjoint`] left it.
    #[inline(always)]
    pub(super) fn free_gradient(&self, state: &FieldState<T>, gradient: &mut [T]) {
        let four_pi = T::of(4.0 * std::f64::consts::PI);
        gradient.iter_mut().zip(&state.turns[..self.lit]).for_each(|(out, &slope)| *out = four_pi * slope);
    }

    /// dE/dc of one mode (per nm) at the state's coefficients, on the row-planar grid, which must be zero elsewhere.
    pub(super) fn derivative(&self, mode: Mode, state: &FieldState<T>, grid: &mut [T]) {
        let tau = T::of(std::f64::consts::TAU);
        let ([p_re, p_im], [a_re, a_im]) = (&state.phasor, &state.aperture);
        // i·2π·s·(re + i·im), s the derivative of the phase in turns per nm.
        let mut put = |p: usize, re: T, im: T, s: T| {
            // The strips are in ascending order of their samples.
            let strip = &self.strips[self.strips.partition_point(|strip| strip.first_lit <= p) - 1];
            let place = strip.place + p - strip.first_lit;
            let (re, im) = (p_re[p] * re - p_im[p] * im, p_re[p] * im + p_im[p] * re);
            grid[place] -= tau * s * im;
            grid[place + self.samples] += tau * s * re;
        };
        let (Mode::Piston(segment) | Mode::Tip(segment) | Mode::Tilt(segment)) = mode else {
            let Mode::Smooth(row) = mode else { unreachable!("the other modes were taken above") };
            for (p, &b) in self.smooth.map(row).iter().enumerate() {
                put(p, a_re[p], a_im[p], b);
            }
            return;
        };
        let first = self.runs.partition_point(|run| run.segment < segment);
        for run in self.runs[first..].iter().take_while(|run| run.segment == segment) {
            let [c, t, u] = state.pose[segment];
            for i in 0..run.length {
                let entry = run.first_weight + i;
                let (x, y) = self.slopes.as_ref().map_or((T::zero(), T::zero()), |(x, y)| (x[entry], y[entry]));
                let (q_re, q_im) = phasor(t.mul_add(x, u.mul_add(y, c)));
                let along = match mode {
                    Mode::Tip(_) => x,
                    Mode::Tilt(_) => y,
                    _ => T::one(),
                };
                let weight = self.weight[entry];
                put(run.first_lit + i, weight * q_re, weight * q_im, along * T::of(self.turns_per_nm));
            }
        }
    }
}

fn add<T: Polynomial>(to: &mut T, turns: f64) {
    *to += T::of(turns);
}

impl Run {
    /// Samples with the filling.
    fn filled(&self) -> usize {
        self.length.next_multiple_of(STRIDE)
    }
}

/// The stretches of lit samples in which each segment shows, segment by segment, and the entries in that order, with
/// none in the filling.
fn runs(offsets: &[u32], segment: &[u32], segments: usize) -> (Vec<Run>, Vec<Option<usize>>) {
    let mut entries: Vec<Vec<(usize, usize)>> = vec![Vec::new(); segments];
    for (p, bounds) in offsets.windows(2).enumerate() {
        for entry in bounds[0] as usize..bounds[1] as usize {
            entries[segment[entry] as usize].push((p, entry));
        }
    }
    let (mut runs, mut order) = (Vec::<Run>::new(), Vec::new());
    for (segment, entries) in entries.into_iter().enumerate() {
        for (p, entry) in entries {
            match runs.last_mut() {
                Some(run) if run.segment == segment && run.first_lit + run.length == p => run.length += 1,
                _ => {
                    order.resize(order.len().next_multiple_of(STRIDE), None);
                    runs.push(Run { segment, first_lit: p, first_weight: order.len(), length: 1 });
                }
            }
            order.push(Some(entry));
        }
    }
    order.resize(order.len().next_multiple_of(STRIDE), None);
    (runs, order)
}

/// The stretches of `lit` (ascending flat places) that lie side by side in a row.
fn strips(lit: &[u32], samples: usize) -> Vec<Strip> {
    let mut strips = Vec::<Strip>::new();
    for (p, &flat) in lit.iter().enumerate() {
        let (row, column) = (flat as usize / samples, flat as usize % samples);
        let place = 2 * row * samples + column;
        match strips.last_mut() {
            // The end of a row and the start of the next are a row apart in the planes.
            Some(strip) if strip.place + strip.length == place => strip.length += 1,
            _ => strips.push(Strip { first_lit: p, place, length: 1 }),
        }
    }
    strips
}
