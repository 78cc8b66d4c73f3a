//! The segments that show in each block of the pupil grid: their weights, their part of the aperture, and back.

use super::optics::Optics;
use super::phasor::{Polynomial, phasor};
use std::ops::Range;

/// Samples of a block: a vector of the widest registers in f32, two in f64. The rows of the grid are filled up to whole
/// blocks.
pub(super) const BLOCK: usize = 16;

/// A number for each sample of a block.
pub(super) type Lanes<T> = [T; BLOCK];

/// The segments that show in the blocks of the grid. A share is one segment in one block.
pub(super) struct Shares<T> {
    /// Where the shares of each block begin; one more at the end.
    first: Vec<usize>,
    segment: Vec<usize>,
    /// Scaled so that |U|² is the PSF; 0 where the segment does not show.
    pub(super) weight: Vec<Lanes<T>>,
    /// What a segment's tip and its tilt of 1 nm add to the phase, nm, where segments tilt.
    pub(super) slopes: Option<Vec<[Lanes<T>; 2]>>,
    /// The shares of each segment, with their blocks.
    pub(super) of_segment: Vec<Vec<(usize, usize)>>,
}

impl<T: Polynomial> Shares<T> {
    /// The shares in `blocks` blocks, in which `lit` are the flat places of the lit samples.
    pub(super) fn new(optics: &Optics, lit: &[usize], blocks: usize) -> Self {
        let parts = optics.parts();
        let weights = &parts.weights;
        let slopes = parts.slopes.as_ref().filter(|_| optics.tilts_segments());
        let amplitude = optics.intensity_scale().sqrt();
        let mut entries = Vec::with_capacity(weights.weight.len());
        for (&place, bounds) in lit.iter().zip(weights.offsets.windows(2)) {
            for entry in bounds[0] as usize..bounds[1] as usize {
                entries.push((place / BLOCK, weights.segment[entry] as usize, place % BLOCK, entry));
            }
        }
        entries.sort_unstable();
        let mut shares = Self {
            first: Vec::with_capacity(blocks + 1),
            segment: Vec::new(),
            weight: Vec::new(),
            slopes: slopes.map(|_| Vec::new()),
            of_segment: vec![Vec::new(); weights.segments],
        };
        let mut own = entries.chunk_by(|one, next| (one.0, one.1) == (next.0, next.1)).peekable();
        for block in 0..blocks {
            shares.first.push(shares.segment.len());
            while let Some(entries) = own.next_if(|entries| entries[0].0 == block) {
                let gather = |values: &[f64], scale: f64| {
                    let mut lanes = [T::zero(); BLOCK];
                    entries.iter().for_each(|&(_, _, lane, entry)| lanes[lane] = T::of(values[entry] * scale));
                    lanes
                };
                let segment = entries[0].1;
                shares.of_segment[segment].push((block, shares.segment.len()));
                shares.segment.push(segment);
                shares.weight.push(gather(&weights.weight, amplitude));
                if let (Some(to), Some((x, y))) = (&mut shares.slopes, slopes) {
                    to.push([gather(x, 1.0), gather(y, 1.0)]);
                }
            }
        }
        shares.first.push(shares.segment.len());
        shares
    }

    #[inline(always)]
    pub(super) fn of(&self, block: usize) -> Range<usize> {
        self.first[block]..self.first[block + 1]
    }

    /// a = Σ w·q of a block.
    #[inline(always)]
    pub(super) fn aperture(&self, shares: Range<usize>, pose: &[[T; 3]], piston: &[[T; 2]]) -> [Lanes<T>; 2] {
        let (mut re, mut im) = ([T::zero(); BLOCK], [T::zero(); BLOCK]);
        let own = self.segment[shares.clone()].iter().zip(&self.weight[shares.clone()]);
        let Some(slopes) = &self.slopes else {
            for (&segment, weight) in own {
                let [q_re, q_im] = piston[segment];
                for i in 0..BLOCK {
                    re[i] = weight[i].mul_add(q_re, re[i]);
                    im[i] = weight[i].mul_add(q_im, im[i]);
                }
            }
            return [re, im];
        };
        for ((&segment, weight), slopes) in own.zip(&slopes[shares]) {
            let [q_re, q_im] = tilted(pose[segment], slopes);
            for i in 0..BLOCK {
                re[i] = weight[i].mul_add(q_re[i], re[i]);
                im[i] = weight[i].mul_add(q_im[i], im[i]);
            }
        }
        [re, im]
    }

    /// Adds what g = Ē·P* of a block says of each segment: `Σ w·g` where segments do not tilt, and
    /// `Σ w·Im(q*·g)·(1, x, y)` where they do. A lane sums one sample in sixteen of a segment, some tens or hundreds: in
    /// f32 its rounding is that of a few products.
    #[inline(always)]
    pub(super) fn collect(
        &self,
        shares: Range<usize>,
        [g_re, g_im]: [&Lanes<T>; 2],
        pose: &[[T; 3]],
        sums: &mut [[Lanes<T>; 3]],
    ) {
        let own = self.segment[shares.clone()].iter().zip(&self.weight[shares.clone()]);
        let Some(slopes) = &self.slopes else {
            for (&segment, weight) in own {
                let [re, im, _] = &mut sums[segment];
                for i in 0..BLOCK {
                    re[i] = weight[i].mul_add(g_re[i], re[i]);
                    im[i] = weight[i].mul_add(g_im[i], im[i]);
                }
            }
            return;
        };
        for ((&segment, weight), slopes) in own.zip(&slopes[shares]) {
            let [q_re, q_im] = tilted(pose[segment], slopes);
            let ([x, y], [piston, tip, tilt]) = (slopes, &mut sums[segment]);
            for i in 0..BLOCK {
                let part = weight[i] * (q_re[i] * g_im[i] - q_im[i] * g_re[i]);
                piston[i] += part;
                tip[i] = part.mul_add(x[i], tip[i]);
                tilt[i] = part.mul_add(y[i], tilt[i]);
            }
        }
    }
}

/// exp(2πi·(c + t·x + u·y)).
#[inline(always)]
fn tilted<T: Polynomial>([c, t, u]: [T; 3], [x, y]: &[Lanes<T>; 2]) -> [Lanes<T>; 2] {
    let (mut re, mut im) = ([T::zero(); BLOCK], [T::zero(); BLOCK]);
    for i in 0..BLOCK {
        (re[i], im[i]) = phasor(t.mul_add(x[i], u.mul_add(y[i], c)));
    }
    [re, im]
}
