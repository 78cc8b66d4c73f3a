//! The least time that an evaluation can take here: its operations at the processor's peak, or the
//! bytes that it must read at the bandwidth of the memory that holds them, whichever is longer.

use cophase::Result;
use cophase::device::{Choice, Device, DeviceKind, Peak, Precision};
use cophase::imaging::EvaluationWork;
use pulp::{Arch, NullaryFnOnce, Simd, WithSimd};
use rayon::prelude::*;
use std::hint::black_box;
use std::time::Instant;

/// What a device can do at best: its peaks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rates {
    /// Operations per second of all its cores, a fused multiply-add counted as two.
    pub flops_per_s: f64,
    /// Bytes per second that its cores together read of a set of the asked size.
    pub bytes_per_s: f64,
}

/// The floor of one evaluation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Floor {
    /// µs per image.
    pub us: f64,
    /// Whether arithmetic is what binds, and not the memory.
    pub arithmetic: bool,
}

impl Floor {
    /// `work` at `peak`.
    pub fn of(work: EvaluationWork, peak: Rates) -> Self {
        let (arithmetic_s, memory_s) = (work.flops / peak.flops_per_s, work.bytes / peak.bytes_per_s);
        Self { us: 1e6 * arithmetic_s.max(memory_s), arithmetic: arithmetic_s >= memory_s }
    }
}

impl Rates {
    /// Measured on the processor: `threads` at work, on a set of `bytes` in all.
    pub fn of_cpu(precision: Precision, threads: usize, bytes: f64) -> Self {
        Self { flops_per_s: arithmetic(precision, threads), bytes_per_s: reading(threads, bytes) }
    }

    /// Of what `device` means here, with `batch` images at work on a set of `bytes`.
    ///
    /// # Errors
    /// Those of [`Peak::measure`].
    pub(super) fn of(device: Choice, precision: Precision, batch: usize, bytes: f64) -> Result<Self> {
        let cores = rayon::current_num_threads();
        let Some(info) = device.resolve()? else {
            // The CPU chain gives each image a thread of its own.
            return Ok(Self::of_cpu(precision, cores.min(batch), bytes));
        };
        let peak = Peak::measure(&Device::open(&info, false)?, precision)?;
        // A batch that fits the caches of a processor is not read from beyond them.
        let cached = if info.kind == DeviceKind::Cpu { reading(cores, bytes) } else { 0.0 };
        Ok(Self { flops_per_s: 1e9 * peak.gflops, bytes_per_s: cached.max(1e9 * peak.gbytes_s) })
    }
}

/// Runs of which the fastest counts: the peak is what the machine can do when it is left alone.
const RUNS: usize = 32;
/// Independent chains of multiply-adds, a vector each: more than latency times number of any
/// processor's multipliers, and few enough for its registers.
const CHAINS: usize = 12;
/// Multiply-adds of each chain in a run: about a millisecond.
const STEPS: usize = 1 << 18;
/// A set of at least this many bytes is read, over and over, in each run.
const READ_BYTES: f64 = 64e6;
/// The set is never larger: past every cache more makes no difference.
const MOST_BYTES: f64 = 512e6;

/// Multiply-adds without memory, in the widest vectors of this processor; says how many numbers
/// such a vector has.
macro_rules! chains {
    ($name:ident, $lanes:ident, $splat:ident, $mul_add:ident) => {
        struct $name;

        impl WithSimd for $name {
            type Output = usize;

            #[inline(always)]
            fn with_simd<S: Simd>(self, simd: S) -> usize {
                // x → x/2 + 1/2 goes to 1 and stays there: ordinary numbers, which no processor
                // makes faster or slower.
                let half = simd.$splat(black_box(0.5));
                let mut chains = [half; CHAINS];
                for _ in 0..STEPS {
                    for chain in &mut chains {
                        *chain = simd.$mul_add(*chain, half, half);
                    }
                }
                black_box(chains);
                S::$lanes
            }
        }
    };
}

chains!(Chains32, F32_LANES, splat_f32s, mul_add_f32s);
chains!(Chains64, F64_LANES, splat_f64s, mul_add_f64s);

/// Operations per second.
fn arithmetic(precision: Precision, threads: usize) -> f64 {
    let run = || match precision {
        Precision::F32 => Arch::new().dispatch(Chains32),
        Precision::F64 => Arch::new().dispatch(Chains64),
    };
    let operations = 2.0 * (threads * STEPS * CHAINS * run()) as f64;
    operations
        / fastest_s(|| {
            (0..threads).into_par_iter().for_each(|_| {
                black_box(run());
            })
        })
}

/// The sum of a set, in parts that run beside each other.
struct Sum<'a>(&'a [f64]);

impl NullaryFnOnce for Sum<'_> {
    type Output = f64;

    #[inline(always)]
    fn call(self) -> f64 {
        /// Eight vectors of 8: enough loads under way at a time.
        const WIDE: usize = 64;
        let mut sums = [0.0; WIDE];
        for block in self.0.chunks_exact(WIDE) {
            for (sum, value) in sums.iter_mut().zip(block) {
                *sum += value;
            }
        }
        sums.iter().sum()
    }
}

/// Bytes per second.
fn reading(threads: usize, bytes: f64) -> f64 {
    let share = (bytes.min(MOST_BYTES) / (threads * size_of::<f64>()) as f64).ceil().max(64.0) as usize;
    let sets: Vec<Vec<f64>> = (0..threads).map(|_| vec![1.0; share]).collect();
    let rounds = (READ_BYTES / (threads * share * size_of::<f64>()) as f64).ceil() as usize;
    let all = (threads * share * size_of::<f64>() * rounds) as f64;
    all / fastest_s(|| {
        sets.par_iter().for_each(|set| {
            for _ in 0..rounds {
                black_box(Arch::new().dispatch(Sum(black_box(set))));
            }
        });
    })
}

fn fastest_s(mut run: impl FnMut()) -> f64 {
    let mut once = || {
        let started = Instant::now();
        run();
        started.elapsed().as_secs_f64()
    };
    (0..RUNS).map(|_| once()).fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longer_of_two_times_is_the_floor() {
        let peak = Rates { flops_per_s: 1e9, bytes_per_s: 1e8 };
        assert_eq!(Floor::of(EvaluationWork { flops: 2e3, bytes: 1e2 }, peak), Floor { us: 2.0, arithmetic: true });
        assert_eq!(Floor::of(EvaluationWork { flops: 2e3, bytes: 1e3 }, peak), Floor { us: 10.0, arithmetic: false });
    }
}
