//! Owned OpenCL objects, released without a panic.

use ocl::core;
use std::mem::ManuallyDrop;
use std::ops::Deref;

/// An owned object of `ocl`. The drop of `ocl` panics if the release fails, which may happen once
/// the device is lost; a panic during the unwinding of another one aborts the process. Here a
/// failed release is ignored: nothing can be done.
pub(super) struct OpenClObject<T: Release>(ManuallyDrop<T>);

/// Release of an OpenCL object.
pub(super) trait Release {
    /// # Safety
    /// The object is not used afterwards.
    unsafe fn release(&self);
}

macro_rules! releases {
    ($($object:ty: $function:ident;)+) => { $(impl Release for $object {
        unsafe fn release(&self) {
            // SAFETY: as the caller promises.
            let _ = unsafe { core::$function(self) };
        }
    })+ };
}
releases! {
    core::Context: release_context;
    core::CommandQueue: release_command_queue;
    core::Program: release_program;
    core::Kernel: release_kernel;
    core::Mem: release_mem_object;
}

impl<T: Release> From<T> for OpenClObject<T> {
    fn from(object: T) -> Self {
        Self(ManuallyDrop::new(object))
    }
}

impl<T: Release> Deref for OpenClObject<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.0
    }
}

impl<T: Release> Drop for OpenClObject<T> {
    fn drop(&mut self) {
        // SAFETY: `ManuallyDrop` never drops the object, so this is its only release.
        unsafe { self.0.release() }
    }
}
