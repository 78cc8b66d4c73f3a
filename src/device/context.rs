//! An OpenCL context with one in-order queue: what a device, its buffers and its kernels share.

use super::discover::failed;
use super::fault::Fault;
use super::info::DeviceInfo;
use super::object::OpenClObject;
use super::table::Build;
use crate::Result;
use ocl::core::{self, Event};
use std::collections::HashMap;
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex};

/// Context and queue of one device.
pub(super) struct Context {
    pub info: DeviceInfo,
    pub id: core::DeviceId,
    pub handle: OpenClObject<core::Context>,
    pub queue: OpenClObject<core::CommandQueue>,
    pub fault: Fault,
    /// Bytes in buffers.
    pub allocated: AtomicU64,
    /// Compiled programs.
    pub programs: Mutex<HashMap<Build, Arc<OpenClObject<core::Program>>>>,
    /// Launches to be timed; `None` where timing is off.
    pub events: Option<Mutex<Vec<(&'static str, Event)>>>,
}

impl Context {
    /// Waits until all enqueued commands are complete.
    pub fn finish(&self) -> Result<()> {
        self.fault.count_command()?;
        core::finish(&self.queue).map_err(failed)
    }
}
