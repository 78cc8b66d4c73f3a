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
use ndarray::ArrayView1;

/// A stretch of neighbouring lit samples in which one segment shows.
struct Run {
    segment: usize,
    first_lit: usize,
    first_weight: usize,
    length: usize,
}

/// The stage, in the chain's precision.
pub(super) struct Field<T> {
    samples: usize,
    lit: usize,
    /// Where a lit sample's real part lies in a row-planar grid; its imaginary part is `samples` further.
    place: Vec<u32>,
    diversity_turns: Vec<T>,
    /// Smooth modes in turns per nm, `[mode][lit]`.
    basis: Vec<T>,
    runs: Vec<Run>,
    /// Weights in the order of the runs, scaled so that |U|² is the PSF.
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
}

/// Lit samples that are worked on at once: 69 modes of them stay in a 256 kB cache.
const BLOCK: usize = 256;
/// Independent partial sums of a reduction, so that it runs in vector registers.
const LANES: usize = 32;

impl<T: Polynomial> Field<T> {
    pub(super) fn new(optics: &Optics) -> Self {
        let parts = optics.parts();
        let weights = &parts.weights;
        let amplitude = optics.intensity_scale().sqrt();
        let (runs, order) = runs(&weights.offsets, &weights.segment, weights.segments);
        let samples = parts.sampling.samples;
        let turns_per_nm = 1.0 / parts.wavelength_nm;
        let gather = |values: &[f64]| order.iter().map(|&e| T::of(values[e])).collect::<Vec<T>>();
        Self {
            samples,
            lit: weights.lit.len(),
            place: weights
                .lit
                .iter()
                .map(|&p| 2 * (p / samples as u32) * samples as u32 + p % samples as u32)
                .collect(),
            diversity_turns: optics.diversity_turns().into_iter().map(T::of).collect(),
            basis: parts.basis.iter().map(|&b| T::of(b * turns_per_nm)).collect(),
            weight: order.iter().map(|&e| T::of(weights.weight[e] * amplitude)).collect(),
            slopes: match (&parts.slopes, optics.tilts_segments()) {
                (Some((x, y)), true) => Some((gather(x), gather(y))),
                _ => None,
            },
            runs,
            segments: weights.segments,
            turns_per_nm,
            modes: parts.modes.clone(),
        }
    }

    pub(super) fn state(&self) -> FieldState<T> {
        let zeros = || vec![T::zero(); self.lit];
        FieldState {
            turns: zeros(),
            phasor: [zeros(), zeros()],
            aperture: [zeros(), zeros()],
            back: [zeros(), zeros()],
            pose: vec![[T::zero(); 3]; self.segments],
            smooth: vec![T::zero(); self.basis.len() / self.lit],
            pose_bar: vec![[0.0; 3]; self.segments],
            smooth_bar: vec![0.0; self.basis.len() / self.lit],
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
        self.set(coefficients_nm, state);
        self.smooth_turns(state);
        let [re, im] = &mut state.phasor;
        for ((re, im), &turns) in re.iter_mut().zip(im.iter_mut()).zip(&state.turns) {
            (*re, *im) = phasor(turns);
        }
        self.apertures(state);
        let ([p_re, p_im], [a_re, a_im]) = (&state.phasor, &state.aperture);
        for p in 0..self.lit {
            let place = self.place[p] as usize;
            grid[place] = p_re[p] * a_re[p] - p_im[p] * a_im[p];
            grid[place + self.samples] = p_re[p] * a_im[p] + p_im[p] * a_re[p];
        }
    }

    #[inline(always)]
    fn smooth_turns(&self, state: &mut FieldState<T>) {
        state.turns.copy_from_slice(&self.diversity_turns);
        for (block, turns) in state.turns.chunks_mut(BLOCK).enumerate() {
            for (row, &y) in state.smooth.iter().enumerate() {
                let basis = &self.basis[row * self.lit + block * BLOCK..][..turns.len()];
                for (turns, &b) in turns.iter_mut().zip(basis) {
                    *turns = b.mul_add(y, *turns);
                }
            }
        }
    }

    #[inline(always)]
    fn apertures(&self, state: &mut FieldState<T>) {
        let [re, im] = &mut state.aperture;
        re.fill(T::zero());
        im.fill(T::zero());
        for run in &self.runs {
            let weight = &self.weight[run.first_weight..][..run.length];
            let re = &mut re[run.first_lit..][..run.length];
            let im = &mut im[run.first_lit..][..run.length];
            let [c, t, u] = state.pose[run.segment];
            match &self.slopes {
                None => {
                    let (q_re, q_im) = phasor(c);
                    for i in 0..run.length {
                        re[i] = weight[i].mul_add(q_re, re[i]);
                        im[i] = weight[i].mul_add(q_im, im[i]);
                    }
                }
                Some((x, y)) => {
                    let (x, y) = (&x[run.first_weight..][..run.length], &y[run.first_weight..][..run.length]);
                    for i in 0..run.length {
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
        for p in 0..self.lit {
            let place = self.place[p] as usize;
            let (e_re, e_im) = (grid_bar[place], grid_bar[place + self.samples]);
            g_re[p] = e_re * p_re[p] + e_im * p_im[p];
            g_im[p] = e_im * p_re[p] - e_re * p_im[p];
        }
        for p in 0..self.lit {
            state.turns[p] = g_im[p] * a_re[p] - g_re[p] * a_im[p];
        }
        let four_pi = 4.0 * std::f64::consts::PI;
        self.pose_gradient(state);
        self.smooth_gradient(state);
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
            let weight = &self.weight[run.first_weight..][..run.length];
            let (re, im) = (&g_re[run.first_lit..][..run.length], &g_im[run.first_lit..][..run.length]);
            let [c, t, u] = state.pose[run.segment];
            let sum = &mut sums[run.segment];
            match &self.slopes {
                None => {
                    let (q_re, q_im) = phasor(c);
                    sum[0] += dot(weight, im) * q_re.wide() - dot(weight, re) * q_im.wide();
                }
                Some((x, y)) => {
                    let (x, y) = (&x[run.first_weight..][..run.length], &y[run.first_weight..][..run.length]);
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

    /// Σ_p B_jp·dJ/dψ_p of each smooth mode.
    #[inline(always)]
    fn smooth_gradient(&self, state: &mut FieldState<T>) {
        state.smooth_bar.fill(0.0);
        for (block, values) in state.turns.chunks(BLOCK).enumerate() {
            for (row, sum) in state.smooth_bar.iter_mut().enumerate() {
                *sum += dot(&self.basis[row * self.lit + block * BLOCK..][..values.len()], values);
            }
        }
    }

    /// dE/dc of one mode (per nm) at the state's coefficients, on the row-planar grid, which must be zero elsewhere.
    pub(super) fn derivative(&self, mode: Mode, state: &FieldState<T>, grid: &mut [T]) {
        let tau = T::of(std::f64::consts::TAU);
        let ([p_re, p_im], [a_re, a_im]) = (&state.phasor, &state.aperture);
        // i·2π·s·(re + i·im), s the derivative of the phase in turns per nm.
        let mut put = |p: usize, re: T, im: T, s: T| {
            let place = self.place[p] as usize;
            let (re, im) = (p_re[p] * re - p_im[p] * im, p_re[p] * im + p_im[p] * re);
            grid[place] -= tau * s * im;
            grid[place + self.samples] += tau * s * re;
        };
        let (Mode::Piston(segment) | Mode::Tip(segment) | Mode::Tilt(segment)) = mode else {
            let Mode::Smooth(row) = mode else { unreachable!("the other modes were taken above") };
            for p in 0..self.lit {
                put(p, a_re[p], a_im[p], self.basis[row * self.lit + p]);
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

/// Sum of products, in `LANES` partial sums that are added in a fixed order: the same bits at any vector width.
#[inline(always)]
fn dot<T: Polynomial>(a: &[T], b: &[T]) -> f64 {
    let mut lanes = [T::zero(); LANES];
    let (a_blocks, b_blocks) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest: T = a_blocks.remainder().iter().zip(b_blocks.remainder()).fold(T::zero(), |sum, (&a, &b)| sum + a * b);
    for (a, b) in a_blocks.zip(b_blocks) {
        for i in 0..LANES {
            lanes[i] = a[i].mul_add(b[i], lanes[i]);
        }
    }
    lanes.iter().map(|lane| lane.wide()).sum::<f64>() + rest.wide()
}

/// The stretches of lit samples in which each segment shows, segment by segment, and the entries in that order.
fn runs(offsets: &[u32], segment: &[u32], segments: usize) -> (Vec<Run>, Vec<usize>) {
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
                _ => runs.push(Run { segment, first_lit: p, first_weight: order.len(), length: 1 }),
            }
            order.push(entry);
        }
    }
    (runs, order)
}
