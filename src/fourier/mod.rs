//! Fourier transform from the pupil to the focal plane, and its adjoint.
//!
//! With `step` turns per (pupil sample × pixel), n samples and m pixels a side, the forward
//! transform is
//!
//! `U[v][u] = Σ_yx E[y][x] · exp(−2πi·step·((x − (n−1)/2)(u − m/2) + (y − (n−1)/2)(v − m/2)))`
//!
//! and its adjoint has the opposite sign in the exponent. `definition` computes that sum term by
//! term: the reference implementation, against which the two fast ones, `matrix` and `fft`, are
//! tested.
//!
//! **Layout.** Complex arrays are *row-planar*: each row is its real parts followed by its
//! imaginary parts (`[row][re, im][col]`). One real matrix product then serves both parts, along
//! either axis, without a transposition.

#[cfg(test)]
mod definition;
mod disc;
mod fft;
mod hartley;
mod matrix;
mod pixel_response;
mod product;
mod real;
mod sampling;
mod square;
mod transform;
mod workspace;

pub(crate) use disc::disc;
pub use hartley::HartleyTransform;
pub use pixel_response::PixelResponse;
pub use product::Factors;
pub(crate) use product::panel_len;
pub use real::Real;
pub use sampling::{Sampling, fast_side};
pub(crate) use square::{transform_square, transpose};
pub use transform::Transform;
pub use workspace::Workspace;

#[cfg(test)]
mod tests;
