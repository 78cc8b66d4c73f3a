//! Dense linear algebra by `faer` on `ndarray` matrices, and FFT plans by `rustfft`.
//!
//! Both are generic libraries, whose code the compiler generates in the crate that names a type of
//! numbers, and again in each crate that does so: a quarter of the code of `cophase`, once more for
//! its unit tests and for each of its test programs. The functions here are for `f64` (an FFT:
//! `f32` and `f64`) and not generic, so that this code is generated once, in this crate.

pub mod cholesky;
mod conversion;
pub mod decompositions;
pub mod failure;
pub mod fft;
pub mod product;
pub mod systems;
