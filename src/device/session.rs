//! An open device: its context and queue, its compiled programs, its buffers and kernels.

use std::collections::HashMap;
use std::ffi::CString;
use std::marker::PhantomData;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use ocl::core::{
    self, ArgVal, CommandQueueProperties, ContextProperties, Event, KernelArgInfo, KernelArgInfoResult, KernelInfo,
    KernelInfoResult, MemFlags, ProfilingInfo, ProfilingInfoResult, ProgramBuildInfo,
};

use super::discover::{failed, resolve};
use super::fault::Fault;
use super::held::Held;
use super::table::{Build, Entry, find, program_text};
use super::{DeviceInfo, Precision};
use crate::{Error, Result};

/// Lines of a failed build's log that an error carries: what follows from the first error is often hundreds.
const LOG_LINES: usize = 12;

/// A number that a kernel can hold.
pub trait Element: ocl::OclPrm + Default {}
impl Element for f32 {}
impl Element for f64 {}
impl Element for i32 {}

/// Time that a device spent in one kernel since the timings were last taken.
#[derive(Debug, Clone, PartialEq)]
pub struct StageTime {
    /// The kernel.
    pub kernel: &'static str,
    /// How often it was launched.
    pub launches: usize,
    /// Time between start and end on the device, all launches together.
    pub device_time: Duration,
    /// The shortest launch: what other programs on the machine disturbed least.
    pub fastest: Duration,
}

/// An open OpenCL device with one in-order queue. Cloning is cheap and shares everything.
#[derive(Clone)]
pub struct Device {
    inner: Arc<Inner>,
}

struct Inner {
    info: DeviceInfo,
    id: core::DeviceId,
    context: Held<core::Context>,
    queue: Held<core::CommandQueue>,
    fault: Fault,
    /// Bytes in buffers.
    allocated: AtomicU64,
    programs: Mutex<HashMap<Build, Arc<Held<core::Program>>>>,
    /// Launches to be timed; `None` where timing is off.
    events: Option<Mutex<Vec<(&'static str, Event)>>>,
}

impl Device {
    /// Opens the device that `info` describes. With `timed`, every launch leaves an event for [`Device::take_timings`].
    ///
    /// # Errors
    /// [`Error::Device`] where the device is gone or refuses a context.
    pub fn open(info: &DeviceInfo, timed: bool) -> Result<Self> {
        let (platform, id) = resolve(info)?;
        let properties = ContextProperties::new().platform(platform);
        let context = core::create_context(Some(&properties), &[id], None, None).map_err(failed)?;
        let profiling = timed.then_some(CommandQueueProperties::PROFILING_ENABLE);
        let queue = core::create_command_queue(&context, id, profiling).map_err(failed)?;
        Ok(Self {
            inner: Arc::new(Inner {
                info: info.clone(),
                id,
                context: context.into(),
                queue: queue.into(),
                fault: Fault::from_environment(),
                allocated: AtomicU64::new(0),
                programs: Mutex::default(),
                events: timed.then(Mutex::default),
            }),
        })
    }

    /// What it is.
    pub fn info(&self) -> &DeviceInfo {
        &self.inner.info
    }

    /// Makes it fail on demand.
    #[cfg(all(test, debug_assertions))]
    pub(crate) fn fault(&self) -> &Fault {
        &self.inner.fault
    }

    /// Bytes that buffers hold now.
    pub fn allocated_bytes(&self) -> u64 {
        self.inner.allocated.load(Ordering::Relaxed)
    }

    /// Waits until everything that was asked for is done.
    ///
    /// # Errors
    /// [`Error::Device`] where the device failed.
    pub fn finish(&self) -> Result<()> {
        self.inner.fault.strike()?;
        core::finish(&self.inner.queue).map_err(failed)
    }

    /// A buffer of `len` numbers (at least one), all zero.
    ///
    /// # Errors
    /// [`Error::Device`] where the device has no room for it: the sentence says how much was asked for.
    pub fn buffer<T: Element>(&self, len: usize) -> Result<Buffer<T>> {
        let len = len.max(1);
        let bytes = (len * size_of::<T>()) as u64;
        let limit = self.info().max_buffer_bytes;
        if bytes > limit {
            return Err(Error::Device(format!(
                "a buffer of {bytes} bytes does not fit {}, which gives at most {limit} to one: load fewer images",
                self.info().address()
            )));
        }
        self.inner.fault.strike()?;
        // SAFETY: no host pointer is involved; the buffer is filled below before anyone can read it.
        let mem = unsafe { core::create_buffer(&*self.inner.context, MemFlags::READ_WRITE, len, None::<&[T]>) }
            .map_err(failed)?;
        let mem = Held::from(mem);
        core::enqueue_fill_buffer::<T, _, _, _>(
            &self.inner.queue,
            &*mem,
            T::default(),
            0,
            len,
            None::<&Event>,
            None::<&mut Event>,
            None,
        )
        .map_err(failed)?;
        self.inner.allocated.fetch_add(bytes, Ordering::Relaxed);
        Ok(Buffer { device: self.clone(), mem, len, marker: PhantomData })
    }

    /// A buffer that holds `values`.
    ///
    /// # Errors
    /// As for [`Device::buffer`].
    pub fn upload<T: Element>(&self, values: &[T]) -> Result<Buffer<T>> {
        let mut buffer = self.buffer(values.len())?;
        buffer.write(0, values)?;
        Ok(buffer)
    }

    /// The kernel `name` of the table, compiled as `build` says; a second call finds the program compiled.
    ///
    /// # Errors
    /// [`Error::Device`] where the device lacks the precision or its compiler refuses the source: the sentence carries
    /// the end of the compiler's log.
    pub fn kernel(&self, name: &'static str, build: Build) -> Result<Kernel> {
        if !self.info().supports(build.precision) {
            return Err(Error::Device(format!(
                "{} ({}) computes in f32 only: precision {} is not available on it",
                self.info().address(),
                self.info().name,
                build.precision
            )));
        }
        let entry = find(name).ok_or_else(|| Error::Internal(format!("no kernel is called {name}")))?;
        let program = self.program(build)?;
        Kernel::new(self.clone(), &program, entry, build)
    }

    fn program(&self, build: Build) -> Result<Arc<Held<core::Program>>> {
        let mut programs = self.inner.programs.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(program) = programs.get(&build) {
            return Ok(program.clone());
        }
        let no_nul = |e| Error::Internal(format!("a kernel file holds a NUL: {e}"));
        let source = CString::new(program_text()).map_err(no_nul)?;
        let options = CString::new(build.options()).map_err(no_nul)?;
        let program = core::create_program_with_source(&*self.inner.context, &[source]).map_err(failed)?;
        let program = Arc::new(Held::from(program));
        if let Err(error) = core::build_program(&program, Some(&[self.inner.id]), &options, None, None) {
            // `ocl` fetches the log itself for a failed build, and else says what happened.
            let log = core::get_program_build_info(&program, self.inner.id, ProgramBuildInfo::BuildLog)
                .map(|log| log.to_string())
                .unwrap_or_default();
            let log = if log.trim().is_empty() { error.to_string() } else { log };
            return Err(Error::Device(format!(
                "the compiler of {} refuses the kernels ({}): {}",
                self.info().address(),
                build.options(),
                excerpt(&log)
            )));
        }
        programs.insert(build, program.clone());
        Ok(program)
    }

    /// Where the time went since the last call, longest first; empty where the device was opened without timing.
    ///
    /// # Errors
    /// [`Error::Device`] where the device failed.
    pub fn take_timings(&self) -> Result<Vec<StageTime>> {
        let Some(events) = &self.inner.events else { return Ok(Vec::new()) };
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
        _ => Err(Error::Internal("an OpenCL event answers another question than was asked".into())),
    };
    Ok(Duration::from_nanos(at(ProfilingInfo::End)?.saturating_sub(at(ProfilingInfo::Start)?)))
}

/// What a build log says first of errors, on one line; its end where it names none.
pub(super) fn excerpt(log: &str) -> String {
    let lines: Vec<&str> = log.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    let error = lines.iter().position(|line| line.to_ascii_lowercase().contains("error"));
    let first = error.unwrap_or(lines.len().saturating_sub(LOG_LINES));
    lines[first..].iter().take(LOG_LINES).copied().collect::<Vec<_>>().join(" | ")
}

/// Numbers on a device.
pub struct Buffer<T: Element> {
    device: Device,
    mem: Held<core::Mem>,
    len: usize,
    marker: PhantomData<T>,
}

impl<T: Element> Buffer<T> {
    /// How many numbers.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Never: an empty request makes a buffer of one.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    fn check(&self, offset: usize, count: usize) -> Result<()> {
        if offset + count > self.len {
            return Err(Error::Internal(format!(
                "{count} numbers at {offset} overrun a device buffer of {}",
                self.len
            )));
        }
        Ok(())
    }

    /// Copies `values` to the device from number `offset` on, and waits for the copy.
    ///
    /// # Errors
    /// [`Error::Device`] where the device failed, [`Error::Internal`] where the values do not fit.
    pub fn write(&mut self, offset: usize, values: &[T]) -> Result<()> {
        self.check(offset, values.len())?;
        if values.is_empty() {
            return Ok(());
        }
        self.device.inner.fault.strike()?;
        let queue = &*self.device.inner.queue;
        // SAFETY: the range was checked, and a blocking write is done with `values` when it returns.
        unsafe {
            core::enqueue_write_buffer(queue, &*self.mem, true, offset, values, None::<&Event>, None::<&mut Event>)
        }
        .map_err(failed)
    }

    /// Copies numbers from the device, from number `offset` on, once everything asked for before is done.
    ///
    /// # Errors
    /// As for [`Buffer::write`].
    pub fn read(&self, offset: usize, values: &mut [T]) -> Result<()> {
        self.check(offset, values.len())?;
        if values.is_empty() {
            return Ok(());
        }
        self.device.inner.fault.strike()?;
        let queue = &*self.device.inner.queue;
        // SAFETY: the range was checked, and a blocking read is done with `values` when it returns.
        unsafe {
            core::enqueue_read_buffer(queue, &*self.mem, true, offset, values, None::<&Event>, None::<&mut Event>)
        }
        .map_err(failed)
    }
}

impl<T: Element> Drop for Buffer<T> {
    fn drop(&mut self) {
        self.device.inner.allocated.fetch_sub((self.len * size_of::<T>()) as u64, Ordering::Relaxed);
    }
}

/// One kernel with its arguments. It remembers them: bind once what does not change.
pub struct Kernel {
    device: Device,
    kernel: Held<core::Kernel>,
    name: &'static str,
    local: [usize; 3],
    arguments: Vec<String>,
    precision: Precision,
}

impl Kernel {
    fn new(device: Device, program: &core::Program, entry: &'static Entry, build: Build) -> Result<Self> {
        let kernel = Held::from(core::create_kernel(program, entry.name).map_err(failed)?);
        let KernelInfoResult::NumArgs(count) = core::get_kernel_info(&kernel, KernelInfo::NumArgs).map_err(failed)?
        else {
            return Err(Error::Internal(format!("OpenCL does not count the arguments of {}", entry.name)));
        };
        let name_of = |index| match core::get_kernel_arg_info(&kernel, index, KernelArgInfo::Name, None) {
            Ok(KernelArgInfoResult::Name(name)) => Ok(name),
            Ok(_) => Err(Error::Internal(format!("OpenCL does not name argument {index} of {}", entry.name))),
            Err(error) => Err(failed(error)),
        };
        let arguments = (0..count).map(name_of).collect::<Result<_>>()?;
        let local = if build.is_scalar() { entry.gpu_local } else { [1, 1, 1] };
        Ok(Self { device, kernel, name: entry.name, local, arguments, precision: build.precision })
    }

    /// The names of the arguments, in order.
    pub fn arguments(&self) -> &[String] {
        &self.arguments
    }

    fn set(&mut self, argument: &str, value: ArgVal<'_>) -> Result<&mut Self> {
        let index = self
            .arguments
            .iter()
            .position(|name| name == argument)
            .ok_or_else(|| Error::Internal(format!("kernel {} has no argument {argument}", self.name)))?;
        core::set_kernel_arg(&self.kernel, index as u32, value).map_err(failed)?;
        Ok(self)
    }

    /// Binds a buffer to the argument of that name.
    ///
    /// # Errors
    /// [`Error::Internal`] where there is no such argument.
    pub fn buffer<T: Element>(&mut self, argument: &str, buffer: &Buffer<T>) -> Result<&mut Self> {
        self.set(argument, ArgVal::mem(&buffer.mem))
    }

    /// Binds a whole number (an `int` of the kernel).
    ///
    /// # Errors
    /// As for [`Kernel::buffer`]; [`Error::Internal`] where it exceeds an `int`.
    pub fn int(&mut self, argument: &str, value: usize) -> Result<&mut Self> {
        let value = i32::try_from(value)
            .map_err(|_| Error::Internal(format!("{value} does not fit the int {argument} of {}", self.name)))?;
        self.set(argument, ArgVal::scalar(&value))
    }

    /// Binds a number of the build's precision (a `real` of the kernel).
    ///
    /// # Errors
    /// As for [`Kernel::buffer`].
    pub fn real(&mut self, argument: &str, value: f64) -> Result<&mut Self> {
        match self.precision {
            Precision::F32 => self.set(argument, ArgVal::scalar(&(value as f32))),
            Precision::F64 => self.set(argument, ArgVal::scalar(&value)),
        }
    }

    /// Launches at least `global` work-items: each extent is rounded up to whole work-groups, and kernels let the
    /// surplus items go.
    ///
    /// # Errors
    /// [`Error::Device`] where the device refuses.
    pub fn launch(&mut self, global: [usize; 3]) -> Result<()> {
        if global.contains(&0) {
            return Ok(());
        }
        let global = [0, 1, 2].map(|i| global[i].next_multiple_of(self.local[i]));
        let inner = &self.device.inner;
        inner.fault.strike()?;
        let mut event = inner.events.as_ref().map(|_| Event::null());
        // SAFETY: every argument is bound by name to what it is declared as, and each kernel's own checks keep it within
        // its buffers.
        unsafe {
            core::enqueue_kernel(
                &inner.queue,
                &self.kernel,
                3,
                None,
                &global,
                Some(self.local),
                None::<&Event>,
                event.as_mut(),
            )
        }
        .map_err(failed)?;
        if let (Some(events), Some(event)) = (&inner.events, event) {
            events.lock().unwrap_or_else(PoisonError::into_inner).push((self.name, event));
        }
        Ok(())
    }
}
