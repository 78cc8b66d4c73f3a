//! The floating-point types of the chains.

use super::product::Product;
use cophase_numerics::fft::FftReal;

/// Floating-point type of a chain: `f32` or `f64`.
pub trait Real:
    Product + num_traits::Float + num_traits::FloatConst + num_traits::NumAssign + FftReal + Default
{
    /// `value`, rounded to this precision.
    fn narrow(value: f64) -> Self;
    /// This value in double precision.
    fn widen(self) -> f64;
}

impl Real for f32 {
    fn narrow(value: f64) -> Self {
        value as f32
    }
    fn widen(self) -> f64 {
        f64::from(self)
    }
}

impl Real for f64 {
    fn narrow(value: f64) -> Self {
        value
    }
    fn widen(self) -> f64 {
        self
    }
}
