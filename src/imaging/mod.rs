//! (under construction)

#[cfg(feature = "opencl")]
pub mod gpu;
