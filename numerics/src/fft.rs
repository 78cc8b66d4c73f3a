//! Plans of Fourier transforms.

pub use rustfft::{Fft, FftDirection};
use rustfft::{FftNum, FftPlanner};
use std::sync::Arc;

mod sealed {
    pub trait Sealed {}
    impl Sealed for f32 {}
    impl Sealed for f64 {}
}

/// Type of numbers whose transforms are compiled here: `f32` or `f64`.
pub trait FftReal: FftNum + sealed::Sealed {
    /// Transform of `length` numbers, not normalised.
    fn plan(length: usize, direction: FftDirection) -> Arc<dyn Fft<Self>>;

    /// Transforms of two lengths, which share what they have in common.
    fn plan_pair(lengths: [usize; 2], direction: FftDirection) -> [Arc<dyn Fft<Self>>; 2];
}

/// Both directions of the transform of `length` numbers: forward, inverse.
pub fn plan_both<T: FftReal>(length: usize) -> (Arc<dyn Fft<T>>, Arc<dyn Fft<T>>) {
    (T::plan(length, FftDirection::Forward), T::plan(length, FftDirection::Inverse))
}

// Never inlined: a planner in another crate would bring all its algorithms there.
macro_rules! plans {
    ($real:ty) => {
        impl FftReal for $real {
            #[inline(never)]
            fn plan(length: usize, direction: FftDirection) -> Arc<dyn Fft<Self>> {
                FftPlanner::new().plan_fft(length, direction)
            }

            #[inline(never)]
            fn plan_pair(lengths: [usize; 2], direction: FftDirection) -> [Arc<dyn Fft<Self>>; 2] {
                let mut planner = FftPlanner::new();
                lengths.map(|length| planner.plan_fft(length, direction))
            }
        }
    };
}

plans!(f32);
plans!(f64);
