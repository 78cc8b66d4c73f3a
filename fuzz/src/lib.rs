//! What the fuzz targets and `tests/fuzz` share.

pub mod frames;
pub mod probes;
