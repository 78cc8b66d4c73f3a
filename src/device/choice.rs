//! The device that a user selects, and the OpenCL device it stands for on this machine.

#[cfg(not(feature = "opencl"))]
use super::absent::devices;
#[cfg(feature = "opencl")]
use super::discover::devices;
use super::info::{DeviceInfo, DeviceKind, advice};
use crate::{Error, Result};
use std::str::FromStr;

/// Value of the option `--device`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Choice {
    /// A GPU where there is one, else the CPU chain.
    #[default]
    Auto,
    /// The CPU chain, without OpenCL.
    Cpu,
    /// The OpenCL device of highest rank: GPUs first, then by the number of compute units.
    OpenCl,
    /// Device `D` of platform `P`.
    OpenClAt(usize, usize),
    /// All GPUs, or all OpenCL devices where there is no GPU, for images that are shared among
    /// them.
    All,
}

impl FromStr for Choice {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        match text {
            "auto" => return Ok(Choice::Auto),
            "cpu" => return Ok(Choice::Cpu),
            "opencl" => return Ok(Choice::OpenCl),
            "all" => return Ok(Choice::All),
            _ => {}
        }
        let address = text.strip_prefix("opencl:").and_then(|rest| rest.split_once(':'));
        if let Some((platform, device)) = address
            && let (Ok(platform), Ok(device)) = (platform.parse(), device.parse())
        {
            return Ok(Choice::OpenClAt(platform, device));
        }
        Err(Error::Value(format!("device `{text}` is unknown: auto, cpu, all, opencl or opencl:P:D is accepted")))
    }
}

impl Choice {
    /// The OpenCL device that this choice selects on this machine; `None` is the CPU chain.
    ///
    /// # Errors
    /// [`Error::Device`] where an OpenCL device is required and there is no such device;
    /// [`Error::Value`] for `all`.
    pub fn resolve(self) -> Result<Option<DeviceInfo>> {
        match self {
            Choice::Cpu => Ok(None),
            // `auto` falls back to the CPU where OpenCL fails.
            Choice::Auto => Ok(pick(self, devices().unwrap_or_default())),
            Choice::OpenCl | Choice::OpenClAt(..) => {
                let present = devices()?;
                let addresses: Vec<String> = present.iter().map(DeviceInfo::address).collect();
                pick(self, present).map(Some).ok_or_else(|| no_such_device(self, &addresses))
            }
            Choice::All => Err(Error::Value(
                "device `all` shares the images of a modal estimate; a session, a retrieval of wavefronts (full-phase) or a benchmark runs \
                 on one device: auto, cpu, opencl or opencl:P:D is accepted"
                    .into(),
            )),
        }
    }
}

/// The devices that [`Choice::All`] selects on this machine, by rank.
///
/// # Errors
/// [`Error::Device`] where there is no OpenCL device.
pub fn all_devices() -> Result<Vec<DeviceInfo>> {
    let found = all(devices()?);
    if found.is_empty() { Err(no_such_device(Choice::All, &[])) } else { Ok(found) }
}

/// The devices of the best kind that is there, in the order of [`pick`].
fn all(mut present: Vec<DeviceInfo>) -> Vec<DeviceInfo> {
    let has_gpu = present.iter().any(|d| d.kind == DeviceKind::Gpu);
    present.retain(|d| !has_gpu || d.kind == DeviceKind::Gpu);
    present.sort_by_key(|d| std::cmp::Reverse(d.compute_units));
    present
}

fn pick(choice: Choice, mut present: Vec<DeviceInfo>) -> Option<DeviceInfo> {
    match choice {
        Choice::Cpu | Choice::All => return None,
        Choice::Auto => present.retain(|d| d.kind == DeviceKind::Gpu),
        Choice::OpenCl => {}
        Choice::OpenClAt(platform, device) => present.retain(|d| (d.platform, d.device) == (platform, device)),
    }
    // Among equals, the first listed: users control the order of the ICD loader.
    present.into_iter().rev().max_by_key(|d| (d.kind == DeviceKind::Gpu, d.compute_units))
}

fn no_such_device(choice: Choice, addresses: &[String]) -> Error {
    if addresses.is_empty() {
        return Error::Device(advice(&[]).unwrap_or_default());
    }
    let wanted = match choice {
        Choice::OpenClAt(platform, device) => format!("opencl:{platform}:{device}"),
        _ => "opencl".to_string(),
    };
    Error::Device(format!("there is no device {wanted} here: {} is accepted", addresses.join(", ")))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn device(platform: usize, kind: DeviceKind, compute_units: u32) -> DeviceInfo {
        DeviceInfo {
            platform,
            device: 0,
            platform_name: "p".into(),
            name: "d".into(),
            vendor: "v".into(),
            kind,
            f64: true,
            compute_units,
            memory_bytes: 1 << 30,
            max_buffer_bytes: 1 << 28,
            vector_f32: 1,
            version: "OpenCL 1.2".into(),
            driver: "1".into(),
        }
    }

    #[test]
    fn choices_are_parsed_and_invalid_ones_rejected() {
        assert_eq!("auto".parse::<Choice>().unwrap(), Choice::Auto);
        assert_eq!("cpu".parse::<Choice>().unwrap(), Choice::Cpu);
        assert_eq!("opencl".parse::<Choice>().unwrap(), Choice::OpenCl);
        assert_eq!("all".parse::<Choice>().unwrap(), Choice::All);
        assert_eq!("opencl:1:2".parse::<Choice>().unwrap(), Choice::OpenClAt(1, 2));
        for bad in ["", "gpu", "opencl:", "opencl:1", "opencl:a:b", "opencl:1:-2"] {
            let message = bad.parse::<Choice>().unwrap_err().to_string();
            assert!(message.contains(&format!("`{bad}`")), "{message}");
        }
    }

    #[test]
    fn a_gpu_is_preferred_and_auto_never_selects_a_cpu_device() {
        let here = vec![device(0, DeviceKind::Cpu, 64), device(1, DeviceKind::Gpu, 8), device(2, DeviceKind::Gpu, 8)];
        assert_eq!(pick(Choice::OpenCl, here.clone()).unwrap().platform, 1);
        assert_eq!(pick(Choice::Auto, here.clone()).unwrap().platform, 1);
        assert_eq!(pick(Choice::OpenClAt(2, 0), here.clone()).unwrap().platform, 2);
        assert_eq!(pick(Choice::OpenClAt(3, 0), here.clone()), None);
        assert_eq!(pick(Choice::Auto, here[..1].to_vec()), None);
        assert_eq!(pick(Choice::OpenCl, here[..1].to_vec()).unwrap().platform, 0);
        // `all`: no CPU beside GPUs, and the largest first.
        let larger = DeviceInfo { compute_units: 16, ..here[2].clone() };
        assert_eq!(all([&here[..2], std::slice::from_ref(&larger)].concat()), [larger, here[1].clone()]);
        assert_eq!(all(here[..1].to_vec()), here[..1]);
    }

    #[test]
    fn the_error_for_an_absent_device_lists_those_present() {
        let message = no_such_device(Choice::OpenClAt(7, 1), &["opencl:0:0".into()]).to_string();
        assert!(message.contains("opencl:7:1") && message.contains("opencl:0:0"), "{message}");
        assert!(no_such_device(Choice::OpenCl, &[]).to_string().contains("CPU chain"));
    }
}
