//! Figures of merit over the pupil: what is left of a wavefront, and what an error bar makes one expect.

mod residual;

pub use residual::{MapGram, residual_nm};
