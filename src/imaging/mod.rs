//! (under construction)

pub mod gpu;
