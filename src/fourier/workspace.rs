//! Scratch memory of a transform.

use super::real::Real;
use num_complex::Complex;

/// Scratch memory of one thread for one [`super::Transform`].
pub struct Workspace<T: Real> {
    pub(crate) real: Vec<T>,
    pub(crate) complex: Vec<Complex<T>>,
}
