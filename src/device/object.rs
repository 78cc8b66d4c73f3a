//! OpenCL objects that are let go without a panic.

use ocl::core;
use std::mem::ManuallyDrop;
use std::ops::Deref;

/// An object of `ocl`. Its own drop panics where the release fails, as it may where the device is lost; and an object that is
/// dropped while another's panic passes by would end the process. A release that fails leaves nothing to be done.
pub(super) struct Held<T: Release>(ManuallyDrop<T>);

/// How the loader is told that an object is no longer needed.
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

impl<T: Release> From<T> for Held<T> {
    fn from(object: T) -> Self {
        Self(ManuallyDrop::new(object))
    }
}

impl<T: Release> Deref for Held<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.0
    }
}

impl<T: Release> Drop for Held<T> {
    fn drop(&mut self) {
        // SAFETY: `ManuallyDrop` never drops it, so this is the one release that its creation is owed.
        unsafe { self.0.release() }
    }
}
