//! What stands in for OpenCL in a build without it.

use super::{DeviceInfo, advice};
use crate::{Error, Result};

/// The OpenCL devices of this machine: none, for this build has no OpenCL in it.
///
/// # Errors
/// Never.
pub fn devices() -> Result<Vec<DeviceInfo>> {
    Ok(Vec::new())
}

/// An open device: this build has none, so that no value of this type exists.
#[derive(Debug, Clone)]
pub enum Device {}

impl Device {
    /// Refuses.
    ///
    /// # Errors
    /// [`Error::Device`] always.
    pub fn open(_: &DeviceInfo, _: bool) -> Result<Self> {
        Err(Error::Device(advice(&[]).unwrap_or_default().to_string()))
    }

    /// What it is.
    pub fn info(&self) -> &DeviceInfo {
        match *self {}
    }
}
