//! Where sessions run.

use super::handle::{Handle, fence, give_back};
use super::pointer::{place, put_text, text};
use super::status::cophase_status;
use crate::device::{Choice, DeviceInfo, devices};
use std::ffi::c_char;

/// Where a session's model runs: the CPU chain, or an OpenCL device. Immutable: any thread may use it.
#[allow(non_camel_case_types)] // a name of the header
pub struct cophase_device(Handle<Opened>);

/// A choice that has been looked up.
struct Opened {
    choice: Choice,
    name: String,
}

/// The line of the CPU chain in lists.
const CPU: &str = "cpu\tCPU chain";

/// The line of an OpenCL device: its address, which begins its description too, once.
fn line(info: &DeviceInfo) -> String {
    let (address, description) = (info.address(), info.to_string());
    format!("{address}\t{}", description.trim_start_matches(&address).trim_start())
}

/// The devices of this machine, one line each: the name that cophase_device_open takes, a tab, and what it is. The CPU
/// chain is always there, and the first.
///
/// Writes at most `capacity` bytes to `text`, the terminating zero included, as snprintf does; `text` may be NULL where
/// `capacity` is 0. `*length` receives the length of the whole text in bytes without the zero.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_device_list(text: *mut c_char, capacity: usize, length: *mut usize) -> cophase_status {
    fence(|| {
        // A machine whose OpenCL is broken still has its CPU.
        let present = devices().unwrap_or_default();
        let lines = present.iter().map(line);
        let lines: Vec<String> = std::iter::once(CPU.to_string()).chain(lines).collect();
        unsafe { put_text(text, capacity, length, &lines.join("\n")) }
    })
}

/// Opens a device: "cpu", "opencl" (a GPU before anything else), "opencl:P:D", or "auto" (a GPU where there is one and it
/// can run the model, else the CPU chain).
///
/// COPHASE_BAD_VALUE for a name that cannot be one, COPHASE_DEVICE where no such device is here.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_device_open(name: *const c_char, device: *mut *mut cophase_device) -> cophase_status {
    fence(|| {
        let out = place(device, "device")?;
        let choice: Choice = unsafe { text(name, "name") }?.parse()?;
        let name = choice.resolve()?.as_ref().map_or(CPU.into(), line);
        let made = Box::new(cophase_device(Handle::new(Opened { choice, name })));
        unsafe { out.write(Box::into_raw(made)) };
        Ok(())
    })
}

/// Closes a device; NULL is fine. Sessions that were made on it go on.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_device_close(device: *mut cophase_device) {
    unsafe { give_back(device, |device| &device.0) }
}

/// What a device is: its line of cophase_device_list. `text`, `capacity` and `length` are as there.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_device_name(
    device: *const cophase_device,
    text: *mut c_char,
    capacity: usize,
    length: *mut usize,
) -> cophase_status {
    let device = unsafe { device.as_ref() }.map(|device| &device.0);
    Handle::read(device, "device", |opened| unsafe { put_text(text, capacity, length, &opened.name) })
}

/// What the device means for a session; NULL is the CPU chain.
pub(super) unsafe fn choice(device: *const cophase_device) -> crate::Result<Choice> {
    let Some(device) = (unsafe { device.as_ref() }) else { return Ok(Choice::Cpu) };
    device.0.look(|opened| opened.choice)
}
