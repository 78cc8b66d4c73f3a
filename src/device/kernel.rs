//! A compiled kernel with its arguments.

use super::buffer::{Buffer, Element};
use super::context::Context;
use super::discover::failed;
use super::object::OpenClObject;
use super::precision::Precision;
use super::table::{Build, Entry};
use crate::{Error, Result};
use ocl::core::{self, ArgVal, Event, KernelArgInfo, KernelArgInfoResult, KernelInfo, KernelInfoResult};
use std::sync::{Arc, PoisonError};

/// One kernel with its arguments. Arguments stay bound from launch to launch.
pub(crate) struct Kernel {
    context: Arc<Context>,
    kernel: OpenClObject<core::Kernel>,
    name: &'static str,
    local: [usize; 3],
    arguments: Vec<String>,
    precision: Precision,
}

impl Kernel {
    pub(super) fn new(
        context: Arc<Context>,
        program: &core::Program,
        entry: &'static Entry,
        build: Build,
    ) -> Result<Self> {
        let kernel = OpenClObject::from(core::create_kernel(program, entry.name).map_err(failed)?);
        let KernelInfoResult::NumArgs(count) = core::get_kernel_info(&kernel, KernelInfo::NumArgs).map_err(failed)?
        else {
            return Err(Error::Internal(format!("OpenCL does not report the number of arguments of {}", entry.name)));
        };
        let argument_name = |index| match core::get_kernel_arg_info(&kernel, index, KernelArgInfo::Name, None) {
            Ok(KernelArgInfoResult::Name(name)) => Ok(name),
            Ok(_) => {
                Err(Error::Internal(format!("OpenCL does not report the name of argument {index} of {}", entry.name)))
            }
            Err(error) => Err(failed(error)),
        };
        let arguments = (0..count).map(argument_name).collect::<Result<_>>()?;
        let local = if build.is_scalar() { entry.gpu_local } else { [1, 1, 1] };
        Ok(Self { context, kernel, name: entry.name, local, arguments, precision: build.precision })
    }

    /// The names of the arguments, in order.
    #[cfg(test)]
    pub(super) fn arguments(&self) -> &[String] {
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
        self.set(argument, ArgVal::mem(buffer.mem()))
    }

    /// Binds an integer (an `int` of the kernel).
    ///
    /// # Errors
    /// As for [`Kernel::buffer`]; [`Error::Internal`] where the value exceeds an `int`.
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

    /// Launches at least `global` work-items: each extent is rounded up to whole work-groups, and
    /// the surplus items return without effect.
    ///
    /// # Errors
    /// [`Error::Device`] where the launch fails.
    pub fn launch(&mut self, global: [usize; 3]) -> Result<()> {
        if global.contains(&0) {
            return Ok(());
        }
        let global = [0, 1, 2].map(|i| global[i].next_multiple_of(self.local[i]));
        let context = &self.context;
        context.fault.count_command()?;
        let mut event = context.events.as_ref().map(|_| Event::null());
        // SAFETY: every argument is bound by name with its declared type, and each kernel checks
        // its indices.
        unsafe {
            core::enqueue_kernel(
                &context.queue,
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
        if let (Some(events), Some(event)) = (&context.events, event) {
            events.lock().unwrap_or_else(PoisonError::into_inner).push((self.name, event));
        }
        Ok(())
    }
}
