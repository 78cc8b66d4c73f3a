//! Peak arithmetic rate and memory bandwidth of a device, measured: they bound the time of every
//! computation from below.

#[cfg(not(feature = "opencl"))]
use super::absent::Device;
#[cfg(feature = "opencl")]
use super::info::DeviceKind;
#[cfg(feature = "opencl")]
use super::kernel::Kernel;
use super::precision::Precision;
#[cfg(feature = "opencl")]
use super::reals::Reals;
#[cfg(feature = "opencl")]
use super::session::Device;
#[cfg(feature = "opencl")]
use super::table::Build;
use crate::Result;
#[cfg(feature = "opencl")]
use std::time::Instant;

/// Measured peak rates of one device in one precision.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Peak {
    /// Multiply-adds of all compute units, 10⁹ operations per second (two per multiply-add).
    pub gflops: f64,
    /// The same for one work-item on a CPU (a core), or one work-group on a GPU.
    pub gflops_unit: f64,
    /// Reading from memory beyond the caches, all compute units, 10⁹ bytes per second.
    pub gbytes_s: f64,
}

impl Peak {
    /// Lower bound of the time for `flops` operations and `bytes` bytes, µs: the longer of the two,
    /// as if they overlapped.
    pub fn floor_us(&self, flops: f64, bytes: f64) -> f64 {
        (flops / self.gflops).max(bytes / self.gbytes_s) * 1e-3
    }
}

#[cfg(not(feature = "opencl"))]
impl Peak {
    /// Never called: there is no device in this build.
    ///
    /// # Errors
    /// Never: there is no [`Device`].
    pub fn measure(device: &Device, _: Precision) -> Result<Self> {
        match *device {}
    }
}

/// `PEAK_CHAINS` of peak.cl.
#[cfg(feature = "opencl")]
const CHAINS: usize = 16;
/// Shortest launch that is accepted, s: long compared with the cost of a launch.
#[cfg(feature = "opencl")]
const LEAST_S: f64 = 2e-3;
/// Number of launches; the fastest counts, since others may be disturbed by other programs.
#[cfg(feature = "opencl")]
const REPEATS: usize = 8;

#[cfg(feature = "opencl")]
impl Peak {
    /// Measures the rates, in about 50 ms (longer where the kernels are compiled first).
    ///
    /// # Errors
    /// [`Error::Device`](crate::Error::Device) where the device lacks the precision or fails.
    pub fn measure(device: &Device, precision: Precision) -> Result<Self> {
        let build = Build::for_device(device.info(), precision);
        let units = device.info().compute_units.max(1) as usize;
        // Several work-items per core of a CPU, so that the cores finish together; enough of them
        // to fill a GPU.
        let (unit, all) = if build.is_scalar() { (64, units * 2048) } else { (1, units * 4) };
        Ok(Self {
            gflops: gflops(device, build, all)?,
            gflops_unit: gflops(device, build, unit)?,
            gbytes_s: gbytes_s(device, build, all)?,
        })
    }
}

#[cfg(feature = "opencl")]
fn gflops(device: &Device, build: Build, items: usize) -> Result<f64> {
    let out = Reals::zeros(device, build.precision, items)?;
    let mut kernel = device.kernel("peak_flops", build)?;
    out.bind(&mut kernel, "out")?;
    kernel.real("scale", 0.999)?.real("offset", 0.001)?;
    let mut count = 1 << 10;
    loop {
        kernel.int("count", count)?;
        let seconds = fastest(device, &mut kernel, items)?;
        if seconds >= LEAST_S || count >= 1 << 26 {
            return Ok((items * count * CHAINS * build.vector * 2) as f64 * 1e-9 / seconds);
        }
        count *= 4;
    }
}

#[cfg(feature = "opencl")]
fn gbytes_s(device: &Device, build: Build, items: usize) -> Result<f64> {
    // Four times the size of the last-level cache, and never a large part of the memory.
    let most = if device.info().kind == DeviceKind::Gpu { 1 << 29 } else { 1 << 27 };
    let bytes = most.min(device.info().max_buffer_bytes as usize / 4);
    let share = bytes / build.precision.bytes() / build.vector / items / 4 * 4;
    let numbers = Reals::zeros(device, build.precision, share * items * build.vector)?;
    let out = Reals::zeros(device, build.precision, items)?;
    let mut kernel = device.kernel("peak_read", build)?;
    numbers.bind(&mut kernel, "numbers")?;
    out.bind(&mut kernel, "out")?;
    kernel.int("share", share)?;
    let seconds = fastest(device, &mut kernel, items)?;
    Ok((share * items * build.vector * build.precision.bytes()) as f64 * 1e-9 / seconds)
}

/// Time of the fastest of a few launches, s, after one launch that compiles and warms up.
#[cfg(feature = "opencl")]
fn fastest(device: &Device, kernel: &mut Kernel, items: usize) -> Result<f64> {
    let mut fastest = f64::INFINITY;
    for repeat in 0..=REPEATS {
        let start = Instant::now();
        kernel.launch([items, 1, 1])?;
        device.finish()?;
        if repeat > 0 {
            fastest = fastest.min(start.elapsed().as_secs_f64());
        }
    }
    Ok(fastest)
}
