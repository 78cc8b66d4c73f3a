//! Which OpenCL devices this machine has.

use std::sync::{Mutex, MutexGuard, PoisonError};

use ocl::core::{self, ClDeviceIdPtr, PlatformInfo};
use ocl::ffi;

use super::{DeviceInfo, DeviceKind};
use crate::{Error, Result};

/// The status that an ICD loader, and our own stand-in for one, gives where no platform is installed.
const PLATFORM_NOT_FOUND: i32 = -1001;

/// Held while the platforms are listed and described. The first call makes PoCL (seen with 3.1) initialise its devices, and
/// a second thread that asks meanwhile reads them half made and crashes.
static DISCOVERY: Mutex<()> = Mutex::new(());

fn alone() -> MutexGuard<'static, ()> {
    DISCOVERY.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Every OpenCL device of this machine, platform by platform; empty where OpenCL is absent.
///
/// # Errors
/// [`Error::Device`] where OpenCL is present but does not answer.
pub fn devices() -> Result<Vec<DeviceInfo>> {
    let _alone = alone();
    let mut found = Vec::new();
    for (platform_index, platform) in platforms()?.into_iter().enumerate() {
        let platform_name = core::get_platform_info(platform, PlatformInfo::Name).map_err(failed)?.to_string();
        // A platform whose every device is asleep or gone answers with an error: it has no devices for us.
        let ids = core::get_device_ids(platform, Some(core::DeviceType::ALL), None).unwrap_or_default();
        for (device_index, id) in ids.into_iter().enumerate() {
            found.push(describe(id, platform_index, device_index, &platform_name)?);
        }
    }
    Ok(found)
}

/// The platform and device behind `info`, found again by index.
pub(super) fn resolve(info: &DeviceInfo) -> Result<(core::PlatformId, core::DeviceId)> {
    let _alone = alone();
    let gone = || Error::Device(format!("the device {} ({}) is no longer there", info.address(), info.name));
    let platform = *platforms()?.get(info.platform).ok_or_else(gone)?;
    let ids = core::get_device_ids(platform, Some(core::DeviceType::ALL), None).map_err(failed)?;
    Ok((platform, *ids.get(info.device).ok_or_else(gone)?))
}

/// `ocl` waits ten seconds and then fails, or panics, where there is no platform: the count is asked for first.
fn platforms() -> Result<Vec<core::PlatformId>> {
    let mut count = 0;
    // SAFETY: the call may be given no room for platforms, and then only writes the count.
    let status = unsafe { ffi::clGetPlatformIDs(0, std::ptr::null_mut(), &mut count) };
    match (status, count) {
        (PLATFORM_NOT_FOUND, _) | (0, 0) => Ok(Vec::new()),
        (0, _) => core::get_platform_ids().map_err(failed),
        (status, _) => {
            Err(Error::Device(format!("OpenCL does not list its platforms: clGetPlatformIDs gives {status}")))
        }
    }
}

fn describe(id: core::DeviceId, platform: usize, device: usize, platform_name: &str) -> Result<DeviceInfo> {
    let kind = number(id, ffi::CL_DEVICE_TYPE)?;
    Ok(DeviceInfo {
        platform,
        device,
        platform_name: platform_name.to_string(),
        name: text(id, ffi::CL_DEVICE_NAME)?,
        vendor: text(id, ffi::CL_DEVICE_VENDOR)?,
        kind: match kind {
            k if k & ffi::CL_DEVICE_TYPE_GPU != 0 => DeviceKind::Gpu,
            k if k & ffi::CL_DEVICE_TYPE_CPU != 0 => DeviceKind::Cpu,
            _ => DeviceKind::Accelerator,
        },
        // Before OpenCL 1.2 a device without double precision may refuse the question itself.
        f64: number(id, ffi::CL_DEVICE_DOUBLE_FP_CONFIG).unwrap_or(0) != 0,
        compute_units: number(id, ffi::CL_DEVICE_MAX_COMPUTE_UNITS)? as u32,
        memory_bytes: number(id, ffi::CL_DEVICE_GLOBAL_MEM_SIZE)?,
        max_buffer_bytes: number(id, ffi::CL_DEVICE_MAX_MEM_ALLOC_SIZE)?,
        vector_f32: number(id, ffi::CL_DEVICE_NATIVE_VECTOR_WIDTH_FLOAT)? as u32,
        version: text(id, ffi::CL_DEVICE_VERSION)?,
        driver: text(id, ffi::CL_DRIVER_VERSION)?,
    })
}

fn text(id: core::DeviceId, what: u32) -> Result<String> {
    let bytes = raw(id, what)?;
    Ok(String::from_utf8_lossy(&bytes).trim_matches(['\0', ' ']).to_string())
}

/// A number of 4 or 8 bytes, in the order of this machine.
fn number(id: core::DeviceId, what: u32) -> Result<u64> {
    let bytes = raw(id, what)?;
    match bytes.len() {
        4 => Ok(u64::from(u32::from_ne_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))),
        8 => Ok(u64::from_ne_bytes([bytes[0], bytes[1], bytes[2], bytes[3], bytes[4], bytes[5], bytes[6], bytes[7]])),
        n => Err(Error::Device(format!("OpenCL answers property {what:#x} of a device with {n} bytes, not 4 or 8"))),
    }
}

fn raw<D: ClDeviceIdPtr>(id: D, what: u32) -> Result<Vec<u8>> {
    core::get_device_info_raw(id, what).map_err(failed)
}

/// The first line of what `ocl` says, as our error.
pub(super) fn failed(error: impl std::fmt::Display) -> Error {
    let text = error.to_string();
    let line = text.lines().map(str::trim).find(|l| l.chars().any(char::is_alphanumeric)).unwrap_or("no reason given");
    Error::Device(format!("OpenCL failed: {line}"))
}
