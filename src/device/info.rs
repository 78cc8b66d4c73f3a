//! Description of an OpenCL device, and what to install where there is none.

use super::precision::Precision;

/// Type of an OpenCL device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DeviceKind {
    /// A CPU, through an implementation such as PoCL.
    Cpu,
    /// A GPU.
    Gpu,
    /// Any other type.
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

/// Description of one OpenCL device.
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
    /// Vendor.
    pub vendor: String,
    /// Type of the device.
    pub kind: DeviceKind,
    /// Whether double precision is available.
    pub f64: bool,
    /// Compute units (cores, multiprocessors).
    pub compute_units: u32,
    /// Global memory, bytes.
    pub memory_bytes: u64,
    /// Largest buffer, bytes.
    pub max_buffer_bytes: u64,
    /// Single-precision numbers in one native vector register; 1 on a scalar device.
    pub vector_f32: u32,
    /// OpenCL version.
    pub version: String,
    /// Driver version.
    pub driver: String,
}

impl DeviceInfo {
    /// Address of the device on the command line: `opencl:P:D`.
    pub fn address(&self) -> String {
        format!("opencl:{}:{}", self.platform, self.device)
    }

    /// Whether the device computes in `precision`.
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

/// What to install where `present` is empty, or why the drivers that are installed give no device,
/// in one sentence; `None` where there is a device.
pub fn advice(present: &[DeviceInfo]) -> Option<String> {
    /// What needs no device.
    #[cfg(feature = "opencl")]
    const WITHOUT: &str = "the CPU chain needs nothing";
    if !present.is_empty() {
        return None;
    }
    #[cfg(not(feature = "opencl"))]
    return Some(
        "this cophase was built without OpenCL: build it with the feature `opencl`, or use the CPU chain".into(),
    );
    #[cfg(feature = "opencl")]
    Some(match super::drivers::why_no_device() {
        Some(reasons) => {
            format!("no OpenCL device was found, although a driver is installed: {reasons}; {WITHOUT}")
        }
        None => format!(
            "no OpenCL device was found: install the driver of your GPU with its OpenCL part, or PoCL for the processor \
             (Debian and Ubuntu: apt install pocl-opencl-icd; conda: pocl); {WITHOUT}"
        ),
    })
}
