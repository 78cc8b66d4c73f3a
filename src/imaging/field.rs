//! Field stage: from coefficients to the field in the pupil, and the adjoint.
//!
//! At the illuminated samples p, with the smooth phase ψ (diversity and smooth modes) and the
//! segments' phasors,
//!
//! `E_p = P_p·a_p`,  `P_p = exp(2πi·ψ_p)`,  `a_p = Σ_s w_ps·q_s`,  `q_s = exp(2πi·c_s/λ)`.
//!
//! Summing phasors rather than phases keeps pistons exact at any size on a band-limited pupil,
//! where a sample belongs to several segments. The adjoint, from Ē (so that dJ = 2 Re Σ Ē*·dE),
//! with `g = Ē·P*`:
//!
//! `dJ/dψ_p = 4π·Im(g_p·a_p*)`,  `dJ/dc_s = (4π/λ)·Im(q_s*·Σ_p w_ps·g_p)`,
//! `dJ/dy_j = Σ_p B_jp·dJ/dψ_p`.
//!
//! The grid is processed in blocks of neighbouring samples of a row: phase, phasor, aperture and
//! field of a block stay in vector registers, and the weights of its segments are read in order.

use super::optics::{Mode, Optics};
use super::phasor::{Polynomial, phasor};
use super::segment_blocks::{BLOCK, Lanes, SegmentBlocks, tilted};
use super::smooth::{SmoothModes, SmoothScratch};
use ndarray::ArrayView1;

/// The stage, in the precision of the chain.
pub(super) struct Field<T> {
    samples: usize,
    /// Flat indices of the illuminated samples on the grid of whole blocks.
    illuminated: Vec<usize>,
    /// Diversity on the grid of whole blocks, turns.
    diversity_turns: Vec<Lanes<T>>,
    smooth: SmoothModes<T>,
    segment_blocks: SegmentBlocks<T>,
    turns_per_nm: f64,
    /// Turns at this wavelength per turn at the wavelength of the model.
    turns_of_free: T,
    modes: Vec<Mode>,
}

/// A change of the field.
#[derive(Debug, Clone, Copy)]
pub(super) enum Change {
    /// The coefficient of a mode.
    Mode(Mode),
    /// The logarithm of a segment's amplitude.
    Amplitude(usize),
    /// The amount of a figure of one segment.
    Figure(SegmentFigure),
    /// The logarithm of the amplitude, as a row of the smooth basis has it.
    Light(usize),
}

/// A figure of a segment, nm: a x² + b y² + c x y + d of `[a, b, c, d]`, where x and y are its tip
/// and its tilt of 1 nm. A segment may have one where its optics have tips and tilts.
#[derive(Debug, Clone, Copy)]
pub struct SegmentFigure {
    /// The segment.
    pub segment: usize,
    /// `[a, b, c, d]`.
    pub terms: [f64; 4],
}

impl Change {
    /// The segment that it is of; `None` for a change of the whole pupil.
    pub(super) fn segment(self) -> Option<usize> {
        match self {
            Self::Mode(Mode::Smooth(_)) | Self::Light(_) => None,
            Self::Mode(Mode::Piston(segment) | Mode::Tip(segment) | Mode::Tilt(segment))
            | Self::Amplitude(segment)
            | Self::Figure(SegmentFigure { segment, .. }) => Some(segment),
        }
    }
}

/// Results of the forward step that the adjoint needs, for each block.
#[derive(Clone, Copy)]
struct BlockState<T> {
    phasor: [Lanes<T>; 2],
    aperture: [Lanes<T>; 2],
}

/// Memory of this stage for one image.
pub(super) struct FieldState<T> {
    /// Smooth phase without the diversity, turns.
    turns: Vec<T>,
    /// dJ/dψ without its factor; 0 in blocks without a segment.
    turns_bar: Vec<T>,
    blocks: Vec<BlockState<T>>,
    /// Piston, tip and tilt of each segment, turns.
    pose: Vec<[T; 3]>,
    /// Amplitude of each segment relative to that of its weights.
    amplitude: Vec<T>,
    /// Amplitude times exp(2πi·piston), re and im.
    piston: Vec<[T; 2]>,
    smooth: Vec<T>,
    /// Sums over the samples of the derivatives by `pose`, in lanes (`Σ w·g` for segments that do
    /// not tilt), and by `smooth`.
    pose_bar: Vec<[Lanes<T>; 3]>,
    smooth_bar: Vec<f64>,
    smooth_scratch: SmoothScratch<T>,
}

impl<T: Polynomial> FieldState<T> {
    /// Amplitude of each segment relative to that of its weights.
    pub(super) fn amplitudes(&mut self) -> &mut [T] {
        &mut self.amplitude
    }
}

impl<T: Polynomial> Field<T> {
    pub(super) fn new(optics: &Optics) -> Self {
        let parts = optics.parts();
        let samples = parts.sampling.samples;
        let stride = samples.next_multiple_of(BLOCK);
        let place = |&flat: &u32| flat as usize / samples * stride + flat as usize % samples;
        let illuminated: Vec<usize> = parts.weights.illuminated.iter().map(place).collect();
        let mut diversity_turns = vec![[T::zero(); BLOCK]; samples * stride / BLOCK];
        for (&place, turns) in illuminated.iter().zip(optics.diversity_turns()) {
            diversity_turns[place / BLOCK][place % BLOCK] = T::narrow(turns);
        }
        Self {
            samples,
            diversity_turns,
            smooth: SmoothModes::new(optics),
            segment_blocks: SegmentBlocks::new(optics, &illuminated, samples * stride / BLOCK),
            illuminated,
            turns_per_nm: 1.0 / parts.wavelength_nm,
            turns_of_free: T::narrow(1.0 / optics.colour().ratio),
            modes: parts.modes.clone(),
        }
    }

    pub(super) fn state(&self) -> FieldState<T> {
        let (blocks, segments) = (self.diversity_turns.len(), self.segment_blocks.by_segment.len());
        let zeros = [[T::zero(); BLOCK]; 2];
        FieldState {
            turns: vec![T::zero(); blocks * BLOCK],
            turns_bar: vec![T::zero(); blocks * BLOCK],
            blocks: vec![BlockState { phasor: zeros, aperture: zeros }; blocks],
            pose: vec![[T::zero(); 3]; segments],
            amplitude: vec![T::one(); segments],
            piston: vec![[T::zero(); 2]; segments],
            smooth: vec![T::zero(); self.smooth.len()],
            pose_bar: vec![[[T::zero(); BLOCK]; 3]; segments],
            smooth_bar: vec![0.0; self.smooth.len()],
            smooth_scratch: self.smooth.scratch(),
        }
    }

    /// Writes the coefficients (nm) into the state, as poses of the segments and amounts of the
    /// smooth modes.
    #[inline(always)]
    fn set(&self, coefficients_nm: ArrayView1<f64>, state: &mut FieldState<T>) {
        state.pose.fill([T::zero(); 3]);
        state.smooth.fill(T::zero());
        for (&mode, &nm) in self.modes.iter().zip(coefficients_nm) {
            match mode {
                Mode::Smooth(row) => state.smooth[row] += T::narrow(nm),
                Mode::Piston(s) => add(&mut state.pose[s][0], nm * self.turns_per_nm),
                Mode::Tip(s) => add(&mut state.pose[s][1], nm * self.turns_per_nm),
                Mode::Tilt(s) => add(&mut state.pose[s][2], nm * self.turns_per_nm),
            }
        }
        for ((piston, &[turns, ..]), &amplitude) in state.piston.iter_mut().zip(&state.pose).zip(&state.amplitude) {
            let (re, im) = phasor(turns);
            *piston = [amplitude * re, amplitude * im];
        }
    }

    /// Coefficients (nm) to the field on the row-planar pupil grid. `grid` must be zero outside the
    /// illuminated samples.
    #[inline(always)]
    pub(super) fn forward(&self, coefficients_nm: ArrayView1<f64>, state: &mut FieldState<T>, grid: &mut [T]) {
        self.set(coefficients_nm, state);
        self.smooth.phase(&state.smooth, &mut state.turns, &mut state.smooth_scratch);
        self.field(state, grid);
    }

    /// The same with a free phase at each illuminated sample added, turns at the wavelength of the
    /// model.
    #[inline(always)]
    pub(super) fn forward_free(
        &self,
        coefficients_nm: ArrayView1<f64>,
        free_turns: &[T],
        state: &mut FieldState<T>,
        grid: &mut [T],
    ) {
        self.set(coefficients_nm, state);
        self.smooth.phase(&state.smooth, &mut state.turns, &mut state.smooth_scratch);
        self.illuminated.iter().zip(free_turns).for_each(|(&place, &free)| {
            state.turns[place] = self.turns_of_free.mul_add(free, state.turns[place]);
        });
        self.field(state, grid);
    }

    /// The field of the phase and the poses in the state.
    #[inline(always)]
    fn field(&self, state: &mut FieldState<T>, grid: &mut [T]) {
        let turns = state.turns.as_chunks::<BLOCK>().0;
        let across = self.samples.div_ceil(BLOCK);
        let rows = grid.chunks_exact_mut(2 * self.samples).enumerate();
        for (y, row) in rows {
            let (re, im) = row.split_at_mut(self.samples);
            for (x, block) in (y * across..(y + 1) * across).enumerate() {
                let entries = self.segment_blocks.in_block(block);
                if entries.is_empty() {
                    continue;
                }
                let [p_re, p_im] = phasors(&turns[block], &self.diversity_turns[block]);
                let [a_re, a_im] = self.segment_blocks.aperture(entries, &state.pose, &state.piston);
                let (mut e_re, mut e_im) = ([T::zero(); BLOCK], [T::zero(); BLOCK]);
                for i in 0..BLOCK {
                    e_re[i] = p_re[i].mul_add(a_re[i], -(p_im[i] * a_im[i]));
                    e_im[i] = p_re[i].mul_add(a_im[i], p_im[i] * a_re[i]);
                }
                state.blocks[block] = BlockState { phasor: [p_re, p_im], aperture: [a_re, a_im] };
                put(&mut re[x * BLOCK..], &e_re);
                put(&mut im[x * BLOCK..], &e_im);
            }
        }
    }

    /// Adds to `gradient` the derivative per nm of each coefficient, from Ē on the row-planar pupil
    /// grid.
    #[inline(always)]
    pub(super) fn adjoint(&self, grid_bar: &[T], state: &mut FieldState<T>, gradient: &mut [f64]) {
        state.pose_bar.fill([[T::zero(); BLOCK]; 3]);
        let turns_bar = state.turns_bar.as_chunks_mut::<BLOCK>().0;
        let across = self.samples.div_ceil(BLOCK);
        for (y, row) in grid_bar.chunks_exact(2 * self.samples).enumerate() {
            let (re, im) = row.split_at(self.samples);
            for (x, block) in (y * across..(y + 1) * across).enumerate() {
                let entries = self.segment_blocks.in_block(block);
                if entries.is_empty() {
                    continue;
                }
                let (e_re, e_im) = (take(&re[x * BLOCK..]), take(&im[x * BLOCK..]));
                let BlockState { phasor: [p_re, p_im], aperture: [a_re, a_im] } = &state.blocks[block];
                let (mut g_re, mut g_im) = ([T::zero(); BLOCK], [T::zero(); BLOCK]);
                let turns_bar = &mut turns_bar[block];
                for i in 0..BLOCK {
                    g_re[i] = e_re[i].mul_add(p_re[i], e_im[i] * p_im[i]);
                    g_im[i] = e_im[i].mul_add(p_re[i], -(e_re[i] * p_im[i]));
                    turns_bar[i] = g_im[i].mul_add(a_re[i], -(g_re[i] * a_im[i]));
                }
                self.segment_blocks.collect(entries, [&g_re, &g_im], &state.pose, &mut state.pose_bar);
            }
        }
        self.smooth.project(&state.turns_bar, &mut state.smooth_bar, &mut state.smooth_scratch);
        self.gradient(state, gradient);
    }

    /// Adds the gradient from the sums in the state.
    #[inline(always)]
    fn gradient(&self, state: &FieldState<T>, gradient: &mut [f64]) {
        let four_pi = 4.0 * std::f64::consts::PI;
        let sum = |lanes: &Lanes<T>| lanes.iter().map(|lane| lane.widen()).sum::<f64>();
        let has_tilts = self.segment_blocks.slopes.is_some();
        for (&mode, gradient) in self.modes.iter().zip(gradient.iter_mut()) {
            *gradient += four_pi
                * match mode {
                    Mode::Smooth(row) => state.smooth_bar[row],
                    Mode::Piston(s) if has_tilts => sum(&state.pose_bar[s][0]) * self.turns_per_nm,
                    Mode::Piston(s) => {
                        let ([q_re, q_im], [re, im, _]) = (state.piston[s], &state.pose_bar[s]);
                        (sum(im) * q_re.widen() - sum(re) * q_im.widen()) * self.turns_per_nm
                    }
                    Mode::Tip(s) => sum(&state.pose_bar[s][1]) * self.turns_per_nm,
                    Mode::Tilt(s) => sum(&state.pose_bar[s][2]) * self.turns_per_nm,
                };
        }
    }

    /// Adds dJ/dψ at each illuminated sample, per turn at the wavelength of the model, from the
    /// last [`Field::adjoint`].
    #[inline(always)]
    pub(super) fn free_gradient(&self, state: &FieldState<T>, gradient: &mut [T]) {
        let factor = T::narrow(4.0 * std::f64::consts::PI) * self.turns_of_free;
        gradient.iter_mut().zip(&self.illuminated).for_each(|(out, &place)| *out += factor * state.turns_bar[place]);
    }

    /// Whether the amplitudes of the segments have an effect: not where segments tilt, whose
    /// phasors are computed per sample.
    pub(super) fn has_amplitudes(&self) -> bool {
        self.segment_blocks.slopes.is_none()
    }

    /// Adds dJ/d ln of each segment's amplitude, from the last [`Field::adjoint`]:
    /// `2·Re(q_s*·Σ w·g)`, of which the piston's derivative is the imaginary part.
    pub(super) fn amplitude_gradient(&self, state: &FieldState<T>, gradient: &mut [f64]) {
        let sum = |lanes: &Lanes<T>| lanes.iter().map(|lane| lane.widen()).sum::<f64>();
        for ((gradient, [q_re, q_im]), [re, im, _]) in gradient.iter_mut().zip(&state.piston).zip(&state.pose_bar) {
            *gradient += 2.0 * (sum(re) * q_re.widen() + sum(im) * q_im.widen());
        }
    }

    /// The derivative of the field by one change at the state's coefficients, on the row-planar
    /// grid, which must be zero elsewhere. That by a coefficient, per nm, is i·2π·s·P·(the mode's
    /// part of the aperture), s the derivative of the phase in turns per nm; that by the logarithm
    /// of an amplitude is P·(its part).
    #[inline(always)]
    pub(super) fn derivative(&self, change: Change, state: &FieldState<T>, grid: &mut [T]) {
        let (samples, across) = (self.samples, self.samples.div_ceil(BLOCK));
        let Some(segment) = change.segment() else {
            let (Change::Mode(Mode::Smooth(row)) | Change::Light(row)) = change else { return };
            let per_row = T::narrow(1.0 / self.turns_per_nm);
            for (&place, &turns) in self.illuminated.iter().zip(self.smooth.map(row)) {
                let (block, lane) = (place / BLOCK, place % BLOCK);
                let BlockState { phasor, aperture } = &state.blocks[block];
                let (phasor, part) = (phasor.map(|lanes| lanes[lane]), aperture.map(|lanes| lanes[lane]));
                let [re, im] = match change {
                    Change::Light(_) => times(phasor, part).map(|value| value * turns * per_row),
                    _ => along_phase(phasor, part, turns),
                };
                let at = 2 * samples * (block / across) + block % across * BLOCK + lane;
                grid[at] += re;
                grid[at + samples] += im;
            }
            return;
        };
        let turns_per_nm = T::narrow(self.turns_per_nm);
        // The phasor of a segment without slopes is the same at all of its samples.
        let (re, im) = phasor(state.pose[segment][0]);
        let of_piston = [[re; BLOCK], [im; BLOCK]];
        for &(block, entry) in &self.segment_blocks.by_segment[segment] {
            let slopes = self.segment_blocks.slopes.as_ref().map(|slopes| &slopes[entry]);
            // No closure: it would be compiled for the oldest CPU.
            let [q_re, q_im] = match slopes {
                None => of_piston,
                Some(slopes) => tilted(state.pose[segment], slopes),
            };
            let along = match (change, slopes) {
                (Change::Mode(Mode::Tip(_)), Some([x, _])) => *x,
                (Change::Mode(Mode::Tilt(_)), Some([_, y])) => *y,
                (Change::Mode(Mode::Piston(_)), _) => [T::one(); BLOCK],
                (Change::Figure(SegmentFigure { terms, .. }), Some([x, y])) => figure(terms, x, y),
                _ => [T::zero(); BLOCK],
            };
            let (weight, [p_re, p_im]) = (&self.segment_blocks.weight[entry], &state.blocks[block].phasor);
            let (mut d_re, mut d_im) = ([T::zero(); BLOCK], [T::zero(); BLOCK]);
            for i in 0..BLOCK {
                let part = [weight[i] * q_re[i], weight[i] * q_im[i]];
                [d_re[i], d_im[i]] = match change {
                    Change::Amplitude(_) => times([p_re[i], p_im[i]], part),
                    _ => along_phase([p_re[i], p_im[i]], part, along[i] * turns_per_nm),
                };
            }
            let row = &mut grid[2 * samples * (block / across)..][..2 * samples];
            let (re, im) = row.split_at_mut(samples);
            let first = block % across * BLOCK;
            for (line, part) in [(re, &d_re), (im, &d_im)] {
                let sum = take(&line[first..]);
                put(&mut line[first..], &std::array::from_fn(|i| sum[i] + part[i]));
            }
        }
    }
}

/// a x² + b y² + c x y + d.
#[inline(always)]
fn figure<T: Polynomial>(terms: [f64; 4], x: &Lanes<T>, y: &Lanes<T>) -> Lanes<T> {
    let [a, b, c, d] = terms.map(T::narrow);
    let mut values = [T::zero(); BLOCK];
    for i in 0..BLOCK {
        values[i] = a * x[i] * x[i] + b * y[i] * y[i] + c * x[i] * y[i] + d;
    }
    values
}

/// i·2π·slope·phasor·part: the derivative of a part of the field by a phase.
#[inline(always)]
fn along_phase<T: Polynomial>(phasor: [T; 2], part: [T; 2], slope: T) -> [T; 2] {
    let factor = T::narrow(std::f64::consts::TAU) * slope;
    let [re, im] = times(phasor, part);
    [-(factor * im), factor * re]
}

/// Product of complex numbers.
#[inline(always)]
fn times<T: Polynomial>([a_re, a_im]: [T; 2], [b_re, b_im]: [T; 2]) -> [T; 2] {
    [a_re * b_re - a_im * b_im, a_re * b_im + a_im * b_re]
}

/// exp(2πi·(a + b)).
#[inline(always)]
fn phasors<T: Polynomial>(a: &Lanes<T>, b: &Lanes<T>) -> [Lanes<T>; 2] {
    let (mut re, mut im) = ([T::zero(); BLOCK], [T::zero(); BLOCK]);
    for i in 0..BLOCK {
        (re[i], im[i]) = phasor(a[i] + b[i]);
    }
    [re, im]
}

/// Writes a block, or the part of it that fits into the rest of a row.
#[inline(always)]
fn put<T: Copy>(row: &mut [T], lanes: &Lanes<T>) {
    match row.first_chunk_mut::<BLOCK>() {
        Some(whole) => *whole = *lanes,
        None => row.iter_mut().zip(lanes).for_each(|(to, &from)| *to = from),
    }
}

/// Reads a block, with zeros beyond the end of the row.
#[inline(always)]
fn take<T: Polynomial>(row: &[T]) -> Lanes<T> {
    row.first_chunk::<BLOCK>().copied().unwrap_or_else(|| {
        let mut lanes = [T::zero(); BLOCK];
        lanes.iter_mut().zip(row).for_each(|(to, &from)| *to = from);
        lanes
    })
}

fn add<T: Polynomial>(to: &mut T, turns: f64) {
    *to += T::narrow(turns);
}
