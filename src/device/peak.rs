//! What a device could do at best, measured: the floor under every other time.

#[cfg(feature = "opencl")]
use super::{Build, DeviceKind, Kernel, Reals};
use super::{Device, Precision};
use crate::Result;
#[cfg(feature = "opencl")]
use std::time::Instant;

/// Measured rates of one device in one precision.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Peak {
    /// Multiply-adds of all compute units, 10⁹ operations a second (two to a multiply-add).
    pub gflops: f64,
    /// The same of one work-item on a processor (a core), of one work-group on a GPU.
    pub gflops_unit: f64,
    /// Reading from memory beyond the caches, all compute units, 10⁹ bytes a second.
    pub gbytes_s: f64,
}

impl Peak {
    /// Least time of work with so many operations and bytes, µs: the longer of the two, as if one hid the other.
    pub fn floor_us(&self, flops: f64, bytes: f64) -> f64 {
        (flops / self.gflops).max(bytes / self.gbytes_s) * 1e-3
    }
}

#[cfg(not(feature = "opencl"))]
impl Peak {
    /// No device can be asked in this build.
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
/// A launch takes at least this long, s: long beside what it costs to launch it.
#[cfg(feature = "opencl")]
const LEAST_S: f64 = 2e-3;
/// Launches of which the fastest counts: others may be disturbed by what else runs.
#[cfg(feature = "opencl")]
const REPEATS: usize = 8;

#[cfg(feature = "opencl")]
impl Peak {
    /// Measures in some 50 ms (longer where the kernels are compiled first).
    ///
    /// # Errors
    /// [`Error::Device`](crate::Error::Device) where the device lacks the precision or fails.
    pub fn measure(device: &Device, precision: Precision) -> Result<Self> {
        let build = Build::for_device(device.info(), precision);
        let units = device.info().compute_units.max(1) as usize;
        // A processor is dealt several work-items to a core, so that no core waits long for the last; a GPU is filled.
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
    // Four times what the last cache of a processor or GPU holds, and never a large part of the memory.
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

/// Seconds of the fastest of a few launches, after one that compiles and warms up.
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
