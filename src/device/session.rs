//! An open device: compiles programs, makes buffers and kernels, and collects timings.

use super::buffer::{Buffer, Element};
use super::context::Context;
use super::discover::{failed, number, resolve};
use super::fault::Fault;
use super::info::DeviceInfo;
use super::kernel::Kernel;
use super::object::OpenClObject;
use super::table::{Build, find, program_text};
use crate::{Error, Result};
use ocl::core::{
    self, CommandQueueProperties, ContextProperties, Event, ProfilingInfo, ProfilingInfoResult, ProgramBuildInfo,
};
use std::ffi::CString;
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Lines of the log of a failed build that an error message quotes, out of often hundreds.
const LOG_LINES: usize = 12;

/// Time spent in one kernel since the last call of [`Device::take_timings`].
#[derive(Debug, Clone, PartialEq)]
pub struct StageTime {
    /// Name of the kernel.
    pub kernel: &'static str,
    /// Number of launches.
    pub launches: usize,
    /// Time between start and end on the device, summed over the launches.
    pub device_time: Duration,
    /// The shortest launch: the one least disturbed by other programs.
    pub fastest: Duration,
}

/// An open OpenCL device with one in-order queue. Clones share the context.
#[derive(Clone)]
pub struct Device {
    context: Arc<Context>,
}

impl Device {
    /// Opens the device that `info` describes. With `timed`, every launch is recorded for
    /// [`Device::take_timings`].
    ///
    /// # Errors
    /// [`Error::Device`] where the device is no longer available or a context cannot be created.
    pub fn open(info: &DeviceInfo, timed: bool) -> Result<Self> {
        let (platform, id) = resolve(info)?;
        let properties = ContextProperties::new().platform(platform);
        let context = core::create_context(Some(&properties), &[id], None, None).map_err(failed)?;
        let profiling = timed.then_some(CommandQueueProperties::PROFILING_ENABLE);
        let queue = core::create_command_queue(&context, id, profiling).map_err(failed)?;
        Ok(Self {
            context: Arc::new(Context {
                info: info.clone(),
                id,
                handle: context.into(),
                queue: queue.into(),
                fault: Fault::from_environment(),
                allocated: AtomicU64::new(0),
                programs: Mutex::default(),
                events: timed.then(Mutex::default),
            }),
        })
    }

    /// Description of the device.
    pub fn info(&self) -> &DeviceInfo {
        &self.context.info
    }

    /// The failures injected into this device.
    #[cfg(all(test, debug_assertions))]
    pub(crate) fn fault(&self) -> &Fault {
        &self.context.fault
    }

    /// Bytes allocated in buffers.
    #[cfg(test)]
    pub(crate) fn allocated_bytes(&self) -> u64 {
        self.context.allocated.load(std::sync::atomic::Ordering::Relaxed)
    }

    /// Waits until all enqueued commands are complete.
    ///
    /// # Errors
    /// [`Error::Device`] where the device failed.
    pub fn finish(&self) -> Result<()> {
        self.context.finish()
    }

    /// Bytes to a multiple of which a part of a buffer begins.
    ///
    /// # Errors
    /// [`Error::Device`] where the device does not say.
    pub(crate) fn part_alignment_bytes(&self) -> Result<usize> {
        let bits = number(self.context.id, ocl::ffi::CL_DEVICE_MEM_BASE_ADDR_ALIGN)?;
        Ok((bits / 8).max(1) as usize)
    }

    /// A buffer of `len` numbers (at least one), all zero.
    ///
    /// # Errors
    /// [`Error::Device`], with the size, where the device cannot allocate it.
    pub(crate) fn buffer<T: Element>(&self, len: usize) -> Result<Buffer<T>> {
        Buffer::new(&self.context, len)
    }

    /// A buffer that holds `values`.
    ///
    /// # Errors
    /// As for [`Device::buffer`].
    pub(crate) fn upload<T: Element>(&self, values: &[T]) -> Result<Buffer<T>> {
        let mut buffer = self.buffer(values.len())?;
        buffer.write(0, values)?;
        Ok(buffer)
    }

    /// The kernel `name` of the table, compiled for `build`. Compiled programs are cached.
    ///
    /// # Errors
    /// [`Error::Device`] where the device lacks the precision or the compilation fails, with an
    /// excerpt of the compiler's log.
    pub(crate) fn kernel(&self, name: &'static str, build: Build) -> Result<Kernel> {
        if !self.info().supports(build.precision) {
            return Err(Error::Device(format!(
                "{} ({}) computes in f32 only: precision {} is not available on it",
                self.info().address(),
                self.info().name,
                build.precision
            )));
        }
        let entry = find(name).ok_or_else(|| Error::Internal(format!("there is no kernel {name}")))?;
        let program = self.program(build)?;
        Kernel::new(self.context.clone(), &program, entry, build)
    }

    fn program(&self, build: Build) -> Result<Arc<OpenClObject<core::Program>>> {
        let mut programs = self.context.programs.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(program) = programs.get(&build) {
            return Ok(program.clone());
        }
        let no_nul = |e| Error::Internal(format!("a kernel file contains a NUL: {e}"));
        let source = CString::new(program_text()).map_err(no_nul)?;
        let options = CString::new(build.options()).map_err(no_nul)?;
        let program = core::create_program_with_source(&*self.context.handle, &[source]).map_err(failed)?;
        let program = Arc::new(OpenClObject::from(program));
        if let Err(error) = core::build_program(&program, Some(&[self.context.id]), &options, None, None) {
            // For a failed build, `ocl` puts the log into its error message.
            let log = core::get_program_build_info(&program, self.context.id, ProgramBuildInfo::BuildLog)
                .map(|log| log.to_string())
                .unwrap_or_default();
            let log = if log.trim().is_empty() { error.to_string() } else { log };
            return Err(Error::Device(format!(
                "the OpenCL compiler of {} cannot compile the kernels ({}): {}",
                self.info().address(),
                build.options(),
                excerpt(&log)
            )));
        }
        programs.insert(build, program.clone());
        Ok(program)
    }

    /// Time per kernel since the last call, longest first; empty where the device was opened
    /// without timing.
    ///
    /// # Errors
    /// [`Error::Device`] where the device failed.
    pub fn take_timings(&self) -> Result<Vec<StageTime>> {
        let Some(events) = &self.context.events else { return Ok(Vec::new()) };
        self.finish()?;
        let events = std::mem::take(&mut *events.lock().unwrap_or_else(PoisonError::into_inner));
        let mut stages: Vec<StageTime> = Vec::new();
        for (kernel, event) in &events {
            let spent = device_time(event)?;
            match stages.iter_mut().find(|stage| stage.kernel == *kernel) {
                Some(stage) => {
                    stage.launches += 1;
                    stage.device_time += spent;
                    stage.fastest = stage.fastest.min(spent);
                }
                None => stages.push(StageTime { kernel, launches: 1, device_time: spent, fastest: spent }),
            }
        }
        stages.sort_by_key(|stage| std::cmp::Reverse(stage.device_time));
        Ok(stages)
    }
}

impl std::fmt::Debug for Device {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Device({})", self.info())
    }
}

fn device_time(event: &Event) -> Result<Duration> {
    let at = |what| match core::get_event_profiling_info(event, what).map_err(failed)? {
        ProfilingInfoResult::Start(ns) | ProfilingInfoResult::End(ns) => Ok(ns),
        _ => Err(Error::Internal("an OpenCL event returned an unexpected kind of value".into())),
    };
    Ok(Duration::from_nanos(at(ProfilingInfo::End)?.saturating_sub(at(ProfilingInfo::Start)?)))
}

/// Excerpt of a build log on one line: from the first error on, or its end where it contains no
/// error.
pub(super) fn excerpt(log: &str) -> String {
    let lines: Vec<&str> = log.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    let error = lines.iter().position(|line| line.to_ascii_lowercase().contains("error"));
    let first = error.unwrap_or(lines.len().saturating_sub(LOG_LINES));
    lines[first..].iter().take(LOG_LINES).copied().collect::<Vec<_>>().join(" | ")
}
