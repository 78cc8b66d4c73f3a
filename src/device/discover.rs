//! Discovery of the OpenCL devices of this machine.

use std::sync::{Mutex, MutexGuard, PoisonError};

use ocl::core::{self, ClDeviceIdPtr, PlatformInfo};
use ocl::ffi;

use super::info::{DeviceInfo, DeviceKind};
use super::probe;
use crate::{Error, Result};

/// Status of an ICD loader, and of our replacement for it (`loader.c`), where no platform is
/// installed.
const PLATFORM_NOT_FOUND: i32 = -1001;

/// Locked while the platforms are listed and described. The first call makes PoCL initialise its
/// devices; with PoCL 3.1 a second thread that calls during this initialisation crashes.
static DISCOVERY: Mutex<()> = Mutex::new(());

fn lock_discovery() -> MutexGuard<'static, ()> {
    DISCOVERY.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Every OpenCL device of this machine, platform by platform; empty where OpenCL is absent.
///
/// # Errors
/// [`Error::Device`] where OpenCL is present but its calls fail, or where a driver aborts or hangs
/// when it is loaded.
pub fn devices() -> Result<Vec<DeviceInfo>> {
    let _lock = lock_discovery();
    let mut found = Vec::new();
    for (platform_index, platform) in platforms()?.into_iter().enumerate() {
        let platform_name = core::get_platform_info(platform, PlatformInfo::Name).map_err(failed)?.to_string();
        // A platform without an available device returns an error: it counts as a platform of zero
        // devices.
        let ids = core::get_device_ids(platform, Some(core::DeviceType::ALL), None).unwrap_or_default();
        for (device_index, id) in ids.into_iter().enumerate() {
            found.push(describe(id, platform_index, device_index, &platform_name)?);
        }
    }
    Ok(found)
}

/// The platform and the device described by `info`, looked up by index.
pub(super) fn resolve(info: &DeviceInfo) -> Result<(core::PlatformId, core::DeviceId)> {
    let _lock = lock_discovery();
    let gone = || {
        Error::Device(format!(
            "the device {} ({}) is no longer available: run `cophase devices` for those that are",
            info.address(),
            info.name
        ))
    };
    let platform = *platforms()?.get(info.platform).ok_or_else(gone)?;
    let ids = core::get_device_ids(platform, Some(core::DeviceType::ALL), None).map_err(failed)?;
    Ok((platform, *ids.get(info.device).ok_or_else(gone)?))
}

/// All platforms. `ocl` waits ten seconds and then fails or panics where there is none, so the
/// count is queried first.
fn platforms() -> Result<Vec<core::PlatformId>> {
    if let Some(refusal) = probe::refusal() {
        return Err(Error::Device(refusal.into()));
    }
    let mut count = 0;
    // SAFETY: with 0 entries and a null pointer the call only writes the count.
    let status = unsafe { ffi::clGetPlatformIDs(0, std::ptr::null_mut(), &mut count) };
    match (status, count) {
        (PLATFORM_NOT_FOUND, _) | (0, 0) => Ok(Vec::new()),
        (0, _) => core::get_platform_ids().map_err(failed),
        (status, _) => {
            Err(Error::Device(format!("OpenCL cannot list its platforms: clGetPlatformIDs returned {status}")))
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
        // Before OpenCL 1.2 a device without double precision may reject this query.
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

/// A property of a device, 4 or 8 bytes in native byte order.
pub(super) fn number(id: core::DeviceId, what: u32) -> Result<u64> {
    let bytes = raw(id, what)?;
    match bytes.len() {
        4 => Ok(u64::from(u32::from_ne_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))),
        8 => Ok(u64::from_ne_bytes([bytes[0], bytes[1], bytes[2], bytes[3], bytes[4], bytes[5], bytes[6], bytes[7]])),
        n => Err(Error::Device(format!(
            "OpenCL returned {n} bytes for device property {what:#x}, where 4 or 8 are needed"
        ))),
    }
}

fn raw<D: ClDeviceIdPtr>(id: D, what: u32) -> Result<Vec<u8>> {
    core::get_device_info_raw(id, what).map_err(failed)
}

/// An error of `ocl` as [`Error::Device`], in one line. Of an OpenCL call these are the function
/// and the status, which `ocl` writes between banners; of anything else it is the first line with
/// words.
pub(super) fn failed(error: impl std::fmt::Display) -> Error {
    let text = error.to_string();
    let after = |label: &str| text.lines().find_map(|line| line.trim().strip_prefix(label)).map(str::trim);
    let sentence = match (after("Error executing function:"), after("Status error code:")) {
        (Some(function), Some(status)) => format!("{status} of {function}"),
        _ => {
            let worded = |line: &&str| line.chars().any(char::is_alphanumeric);
            text.lines().map(str::trim).find(worded).unwrap_or("no reason given").to_string()
        }
    };
    Error::Device(format!("OpenCL failed: {sentence}"))
}
