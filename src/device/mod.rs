//! OpenCL without optics: what is on this machine, a context on it, compiled kernels, buffers, timing.
//!
//! Nothing here fails because OpenCL is absent: `build.rs` links a stand-in for libOpenCL that opens the real library at
//! run time, and a machine without one (or a build without the feature `opencl`) simply has no devices. [`advice`] says
//! in one sentence what to install. The names of the crate `ocl` stay inside this room.

use std::str::FromStr;

use crate::{Error, Result};

#[cfg(not(feature = "opencl"))]
mod absent;
#[cfg(feature = "opencl")]
mod discover;
#[cfg(feature = "opencl")]
mod fault;
#[cfg(feature = "opencl")]
mod held;
mod peak;
#[cfg(feature = "opencl")]
mod reals;
#[cfg(feature = "opencl")]
mod session;
#[cfg(feature = "opencl")]
mod table;
#[cfg(all(test, feature = "opencl"))]
pub(crate) mod tests;

pub use peak::Peak;

#[cfg(not(feature = "opencl"))]
pub use absent::{Device, devices};
#[cfg(feature = "opencl")]
pub use discover::devices;
#[cfg(feature = "opencl")]
pub(crate) use reals::Reals;
#[cfg(feature = "opencl")]
pub use session::{Buffer, Device, Element, Kernel, StageTime};
#[cfg(feature = "opencl")]
pub use table::{Build, Entry, Family, FftPlan, TABLE};

/// The arithmetic of a chain.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Precision {
    /// IEEE single.
    F32,
    /// IEEE double.
    #[default]
    F64,
}

impl Precision {
    /// Bytes of one number.
    pub fn bytes(self) -> usize {
        match self {
            Precision::F32 => 4,
            Precision::F64 => 8,
        }
    }
}

impl FromStr for Precision {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        match text {
            "f32" => Ok(Precision::F32),
            "f64" => Ok(Precision::F64),
            other => Err(Error::Value(format!("precision `{other}` is unknown: f32 or f64 is accepted"))),
        }
    }
}

impl std::fmt::Display for Precision {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Precision::F32 => "f32",
            Precision::F64 => "f64",
        })
    }
}

/// What a device says it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DeviceKind {
    /// The processor, through an implementation such as PoCL.
    Cpu,
    /// A graphics processor.
    Gpu,
    /// Anything else.
    Accelerator,
}

impl std::fmt::Display for DeviceKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            DeviceKind::Cpu => "CPU",
            DeviceKind::Gpu => "GPU",
            DeviceKind::Accelerator => "accelerator",
        })
    }
}

/// One OpenCL device, as `opencl:P:D` names it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DeviceInfo {
    /// Index of the platform, P.
    pub platform: usize,
    /// Index of the device on its platform, D.
    pub device: usize,
    /// Name of the platform.
    pub platform_name: String,
    /// Name of the device.
    pub name: String,
    /// Who makes it.
    pub vendor: String,
    /// CPU, GPU or something else.
    pub kind: DeviceKind,
    /// Whether it computes in double precision.
    pub f64: bool,
    /// Parallel compute units (cores, multiprocessors).
    pub compute_units: u32,
    /// Global memory, bytes.
    pub memory_bytes: u64,
    /// Most bytes that one buffer may have.
    pub max_buffer_bytes: u64,
    /// Single-precision numbers in one native vector register; 1 on a scalar device.
    pub vector_f32: u32,
    /// Version of OpenCL.
    pub version: String,
    /// Version of the driver.
    pub driver: String,
}

impl DeviceInfo {
    /// How `--device` names it: `opencl:P:D`.
    pub fn address(&self) -> String {
        format!("opencl:{}:{}", self.platform, self.device)
    }

    /// Whether it computes in `precision`.
    pub fn supports(&self, precision: Precision) -> bool {
        precision == Precision::F32 || self.f64
    }
}

impl std::fmt::Display for DeviceInfo {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{}  {} {} ({}), {} compute units, {:.1} GiB, {}, {}, driver {}",
            self.address(),
            self.kind,
            self.name,
            self.platform_name,
            self.compute_units,
            self.memory_bytes as f64 / (1u64 << 30) as f64,
            if self.f64 { "f32 and f64" } else { "f32 only" },
            self.version,
            self.driver
        )
    }
}

/// What a user asks for with `--device`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Choice {
    /// A graphics processor where there is one, else the CPU chain.
    #[default]
    Auto,
    /// The CPU chain, without OpenCL.
    Cpu,
    /// The best OpenCL device: a GPU before anything else, then the one with most compute units.
    OpenCl,
    /// Device `D` of platform `P`.
    OpenClAt(usize, usize),
}

impl FromStr for Choice {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        match text {
            "auto" => return Ok(Choice::Auto),
            "cpu" => return Ok(Choice::Cpu),
            "opencl" => return Ok(Choice::OpenCl),
            _ => {}
        }
        let address = text.strip_prefix("opencl:").and_then(|rest| rest.split_once(':'));
        if let Some((platform, device)) = address
            && let (Ok(platform), Ok(device)) = (platform.parse(), device.parse())
        {
            return Ok(Choice::OpenClAt(platform, device));
        }
        Err(Error::Value(format!("device `{text}` is unknown: auto, cpu, opencl or opencl:P:D is accepted")))
    }
}

impl Choice {
    /// The OpenCL device that this choice means here; `None` is the CPU chain.
    ///
    /// # Errors
    /// [`Error::Device`] where the choice names OpenCL and there is no such device.
    pub fn resolve(self) -> Result<Option<DeviceInfo>> {
        match self {
            Choice::Cpu => Ok(None),
            // A machine whose OpenCL is broken still has its CPU.
            Choice::Auto => Ok(pick(self, devices().unwrap_or_default())),
            Choice::OpenCl | Choice::OpenClAt(..) => {
                let present = devices()?;
                let addresses: Vec<String> = present.iter().map(DeviceInfo::address).collect();
                pick(self, present).map(Some).ok_or_else(|| no_such_device(self, &addresses))
            }
        }
    }
}

fn pick(choice: Choice, mut present: Vec<DeviceInfo>) -> Option<DeviceInfo> {
    match choice {
        Choice::Cpu => return None,
        Choice::Auto => present.retain(|d| d.kind == DeviceKind::Gpu),
        Choice::OpenCl => {}
        Choice::OpenClAt(platform, device) => present.retain(|d| (d.platform, d.device) == (platform, device)),
    }
    // Of equals the first listed: the order of the ICD loader is the user's.
    present.into_iter().rev().max_by_key(|d| (d.kind == DeviceKind::Gpu, d.compute_units))
}

fn no_such_device(choice: Choice, addresses: &[String]) -> Error {
    if addresses.is_empty() {
        return Error::Device(advice(&[]).unwrap_or_default().to_string());
    }
    let wanted = match choice {
        Choice::OpenClAt(platform, device) => format!("opencl:{platform}:{device}"),
        _ => "opencl".to_string(),
    };
    Error::Device(format!("there is no device {wanted} here: {} is accepted", addresses.join(", ")))
}

/// What to do where `present` is empty, in one sentence; `None` where a device is there.
pub fn advice(present: &[DeviceInfo]) -> Option<&'static str> {
    if !present.is_empty() {
        return None;
    }
    Some(if cfg!(feature = "opencl") {
        "no OpenCL device was found: install the driver of your GPU with its OpenCL part, or PoCL for the processor \
         (Debian and Ubuntu: apt install pocl-opencl-icd; conda: pocl); the CPU chain needs nothing"
    } else {
        "this cophase was built without OpenCL: build it with the feature `opencl`, or use the CPU chain"
    })
}

#[cfg(test)]
mod choice_tests {
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
    fn choices_parse_and_bad_ones_are_named() {
        assert_eq!("auto".parse::<Choice>().unwrap(), Choice::Auto);
        assert_eq!("cpu".parse::<Choice>().unwrap(), Choice::Cpu);
        assert_eq!("opencl".parse::<Choice>().unwrap(), Choice::OpenCl);
        assert_eq!("opencl:1:2".parse::<Choice>().unwrap(), Choice::OpenClAt(1, 2));
        for bad in ["", "gpu", "opencl:", "opencl:1", "opencl:a:b", "opencl:1:-2"] {
            let message = bad.parse::<Choice>().unwrap_err().to_string();
            assert!(message.contains(&format!("`{bad}`")), "{message}");
        }
    }

    #[test]
    fn a_gpu_comes_first_and_auto_never_takes_a_cpu_device() {
        let here = vec![device(0, DeviceKind::Cpu, 64), device(1, DeviceKind::Gpu, 8), device(2, DeviceKind::Gpu, 8)];
        assert_eq!(pick(Choice::OpenCl, here.clone()).unwrap().platform, 1);
        assert_eq!(pick(Choice::Auto, here.clone()).unwrap().platform, 1);
        assert_eq!(pick(Choice::OpenClAt(2, 0), here.clone()).unwrap().platform, 2);
        assert_eq!(pick(Choice::OpenClAt(3, 0), here.clone()), None);
        assert_eq!(pick(Choice::Auto, here[..1].to_vec()), None);
        assert_eq!(pick(Choice::OpenCl, here[..1].to_vec()).unwrap().platform, 0);
    }

    #[test]
    fn an_absent_device_is_named_with_those_that_are_there() {
        let message = no_such_device(Choice::OpenClAt(7, 1), &["opencl:0:0".into()]).to_string();
        assert!(message.contains("opencl:7:1") && message.contains("opencl:0:0"), "{message}");
        assert!(no_such_device(Choice::OpenCl, &[]).to_string().contains("CPU chain"));
    }
}
