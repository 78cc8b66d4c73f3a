//! The segments in each block of the pupil grid: their weights, their contribution to the aperture,
//! and the adjoint.

use super::optics::Optics;
use super::phasor::{Polynomial, phasor};
use std::ops::Range;

/// Samples per block: one vector of the widest registers in f32, two in f64. The rows of the grid
/// are padded to whole blocks.
pub(super) const BLOCK: usize = 16;

/// One number per sample of a block.
pub(super) type Lanes<T> = [T; BLOCK];

/// The segments in the blocks of the grid. An entry is one segment in one block.
pub(super) struct SegmentBlocks<T> {
    /// First entry of each block, and the number of entries.
    first: Vec<usize>,
    segment: Vec<usize>,
    /// Weights, scaled so that |U|² is the PSF; 0 outside the segment.
    pub(super) weight: Vec<Lanes<T>>,
    /// Phase, nm, of a tip and of a tilt of 1 nm of the segment; `None` where no segment tilts.
    pub(super) slopes: Option<Vec<[Lanes<T>; 2]>>,
    /// The entries of each segment: block and entry.
    pub(super) by_segment: Vec<Vec<(usize, usize)>>,
}

impl<T: Polynomial> SegmentBlocks<T> {
    /// The entries in `blocks` blocks; `illuminated` are the flat indices of the illuminated
    /// samples.
    pub(super) fn new(optics: &Optics, illuminated: &[usize], blocks: usize) -> Self {
        let parts = optics.parts();
        let weights = &parts.weights;
        let slopes = parts.slopes.as_ref().filter(|_| optics.tilts_segments());
        let amplitude = optics.intensity_scale().sqrt();
        let mut entries = Vec::with_capacity(weights.weight.len());
        for (&place, bounds) in illuminated.iter().zip(weights.offsets.windows(2)) {
            for entry in bounds[0] as usize..bounds[1] as usize {
                entries.push((place / BLOCK, weights.segment[entry] as usize, place % BLOCK, entry));
            }
        }
        entries.sort_unstable();
        let mut result = Self {
            first: Vec::with_capacity(blocks + 1),
            segment: Vec::new(),
            weight: Vec::new(),
            slopes: slopes.map(|_| Vec::new()),
            by_segment: vec![Vec::new(); weights.segments],
        };
        let mut own = entries.chunk_by(|one, next| (one.0, one.1) == (next.0, next.1)).peekable();
        for block in 0..blocks {
            result.first.push(result.segment.len());
            while let Some(entries) = own.next_if(|entries| entries[0].0 == block) {
                let gather = |values: &[f64], scale: f64| {
                    let mut lanes = [T::zero(); BLOCK];
                    entries.iter().for_each(|&(_, _, lane, entry)| lanes[lane] = T::narrow(values[entry] * scale));
                    lanes
                };
                let segment = entries[0].1;
                result.by_segment[segment].push((block, result.segment.len()));
                result.segment.push(segment);
                result.weight.push(gather(&weights.weight, amplitude));
                if let (Some(to), Some((x, y))) = (&mut result.slopes, slopes) {
                    to.push([gather(x, 1.0), gather(y, 1.0)]);
                }
            }
        }
        result.first.push(result.segment.len());
        result
    }

    /// The entries of a block.
    #[inline(always)]
    pub(super) fn in_block(&self, block: usize) -> Range<usize> {
        self.first[block]..self.first[block + 1]
    }

    /// a = Σ w·q of a block.
    #[inline(always)]
    pub(super) fn aperture(&self, entries: Range<usize>, pose: &[[T; 3]], piston: &[[T; 2]]) -> [Lanes<T>; 2] {
        let (mut re, mut im) = ([T::zero(); BLOCK], [T::zero(); BLOCK]);
        let own = self.segment[entries.clone()].iter().zip(&self.weight[entries.clone()]);
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
        for ((&segment, weight), slopes) in own.zip(&slopes[entries]) {
            let [q_re, q_im] = tilted(pose[segment], slopes);
            for i in 0..BLOCK {
                re[i] = weight[i].mul_add(q_re[i], re[i]);
                im[i] = weight[i].mul_add(q_im[i], im[i]);
            }
        }
        [re, im]
    }

    /// Adds the contributions of a block, g = Ē·P*, to the sums of its segments: `Σ w·g` if
    /// segments do not tilt, and `Σ w·Im(q*·g)·(1, x, y)` if they do. A lane sums one sample in
    /// sixteen of a segment, some tens or hundreds: in f32 its rounding is that of a few products.
    #[inline(always)]
    pub(super) fn collect(
        &self,
        entries: Range<usize>,
        [g_re, g_im]: [&Lanes<T>; 2],
        pose: &[[T; 3]],
        sums: &mut [[Lanes<T>; 3]],
    ) {
        let own = self.segment[entries.clone()].iter().zip(&self.weight[entries.clone()]);
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
        for ((&segment, weight), slopes) in own.zip(&slopes[entries]) {
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
pub(super) fn tilted<T: Polynomial>([c, t, u]: [T; 3], [x, y]: &[Lanes<T>; 2]) -> [Lanes<T>; 2] {
    let (mut re, mut im) = ([T::zero(); BLOCK], [T::zero(); BLOCK]);
    for i in 0..BLOCK {
        (re[i], im[i]) = phasor(t.mul_add(x[i], u.mul_add(y[i], c)));
    }
    [re, im]
}
