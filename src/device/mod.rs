//! OpenCL without optics: the devices of this machine, contexts, compiled kernels, buffers, timing.
//!
//! The absence of OpenCL is not an error: `build.rs` links a replacement for libOpenCL that opens
//! the real library at run time. A machine without OpenCL, or a build without the feature `opencl`,
//! has zero devices, and [`advice`] says what to install. The drivers are loaded into this process
//! only after a child process has listed their devices (`probe`). The names of the crate `ocl` are
//! used in this module only.

#[cfg(not(feature = "opencl"))]
mod absent;
#[cfg(feature = "opencl")]
mod buffer;
mod choice;
#[cfg(feature = "opencl")]
mod context;
#[cfg(feature = "opencl")]
mod discover;
#[cfg(feature = "opencl")]
mod drivers;
#[cfg(feature = "opencl")]
mod fault;
mod info;
#[cfg(feature = "opencl")]
mod kernel;
#[cfg(feature = "opencl")]
mod object;
mod peak;
mod precision;
#[cfg(feature = "opencl")]
mod probe;
#[cfg(feature = "opencl")]
mod reals;
#[cfg(feature = "opencl")]
mod session;
#[cfg(feature = "opencl")]
mod table;
#[cfg(all(test, feature = "opencl"))]
pub(crate) mod tests;

pub use choice::{Choice, all_devices};
pub use info::{DeviceInfo, DeviceKind, advice};
pub use peak::Peak;
pub use precision::Precision;

#[cfg(not(feature = "opencl"))]
pub use absent::{Device, devices};
#[cfg(feature = "opencl")]
pub(crate) use buffer::Buffer;
#[cfg(feature = "opencl")]
pub use discover::devices;
#[cfg(feature = "opencl")]
pub(crate) use kernel::Kernel;
#[cfg(feature = "opencl")]
pub(crate) use reals::Reals;
#[cfg(feature = "opencl")]
pub use session::{Device, StageTime};
#[cfg(feature = "opencl")]
pub(crate) use table::{Build, FftPlan};
