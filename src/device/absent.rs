//! Replacement for OpenCL in a build without the feature `opencl`.

use super::info::{DeviceInfo, advice};
use crate::{Error, Result};

/// The OpenCL devices of this machine: always none in a build without OpenCL.
///
/// # Errors
/// Never.
pub fn devices() -> Result<Vec<DeviceInfo>> {
    Ok(Vec::new())
}

/// An open device. No value of this type exists in a build without OpenCL.
#[derive(Debug, Clone)]
pub enum Device {}

impl Device {
    /// Always fails.
    ///
    /// # Errors
    /// [`Error::Device`] always.
    pub fn open(_: &DeviceInfo, _: bool) -> Result<Self> {
        Err(Error::Device(advice(&[]).unwrap_or_default()))
    }

    /// Description of the device.
    pub fn info(&self) -> &DeviceInfo {
        match *self {}
    }
}
