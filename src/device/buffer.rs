//! Arrays of numbers in the memory of a device.

use super::context::Context;
use super::discover::failed;
use super::object::OpenClObject;
use crate::{Error, Result};
use ocl::core::{self, BufferRegion, Event, MemFlags};
use std::marker::PhantomData;
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// Element type of a buffer.
pub(crate) trait Element: ocl::OclPrm + Default {}
impl Element for f32 {}
impl Element for f64 {}
impl Element for i32 {}

/// Array of numbers in the memory of a device.
pub(crate) struct Buffer<T: Element> {
    context: Arc<Context>,
    mem: OpenClObject<core::Mem>,
    len: usize,
    /// Bytes that this buffer was allocated for; 0 for a part of another.
    own_bytes: u64,
    marker: PhantomData<T>,
}

impl<T: Element> Buffer<T> {
    /// A buffer of `len` numbers (at least one) in `context`, all zero.
    pub(super) fn new(context: &Arc<Context>, len: usize) -> Result<Self> {
        let len = len.max(1);
        let bytes = (len * size_of::<T>()) as u64;
        let limit = context.info.max_buffer_bytes;
        if bytes > limit {
            return Err(Error::Device(format!(
                "a buffer of {bytes} bytes exceeds the limit of {limit} bytes of {}: load fewer images",
                context.info.address()
            )));
        }
        context.fault.count_command()?;
        // SAFETY: there is no host pointer, and the buffer is filled below before it can be read.
        let mem = unsafe { core::create_buffer(&*context.handle, MemFlags::READ_WRITE, len, None::<&[T]>) }
            .map_err(failed)?;
        let mem = OpenClObject::from(mem);
        core::enqueue_fill_buffer::<T, _, _, _>(
            &context.queue,
            &*mem,
            T::default(),
            0,
            len,
            None::<&Event>,
            None::<&mut Event>,
            None,
        )
        .map_err(failed)?;
        context.allocated.fetch_add(bytes, Ordering::Relaxed);
        Ok(Buffer { context: context.clone(), mem, len, own_bytes: bytes, marker: PhantomData })
    }

    /// `count` elements (at least one) from `from` on as a buffer, which shares their memory and
    /// keeps it. Precondition: they begin at a multiple of
    /// [`Device::part_alignment_bytes`](super::session::Device::part_alignment_bytes).
    ///
    /// # Errors
    /// As for [`Buffer::write`].
    pub fn part(&self, from: usize, count: usize) -> Result<Self> {
        self.check(from, count)?;
        self.context.fault.count_command()?;
        let mem = core::create_sub_buffer(&self.mem, MemFlags::READ_WRITE, &BufferRegion::<T>::new(from, count))
            .map_err(failed)?;
        Ok(Buffer { context: self.context.clone(), mem: mem.into(), len: count, own_bytes: 0, marker: PhantomData })
    }

    /// The OpenCL object, for a kernel's argument.
    pub(super) fn mem(&self) -> &core::Mem {
        &self.mem
    }

    fn check(&self, offset: usize, count: usize) -> Result<()> {
        if offset + count > self.len {
            return Err(Error::Internal(format!("{count} numbers at {offset} exceed a device buffer of {}", self.len)));
        }
        Ok(())
    }

    /// Checks a copy of `count` elements from `offset` on, and counts its command; `false` where
    /// there is nothing to copy.
    fn begin_copy(&self, offset: usize, count: usize) -> Result<bool> {
        self.check(offset, count)?;
        if count > 0 {
            self.context.fault.count_command()?;
        }
        Ok(count > 0)
    }

    /// Copies `values` to the elements from `offset` on, and waits for the copy.
    ///
    /// # Errors
    /// [`Error::Device`] where the device failed, [`Error::Internal`] where the values do not fit.
    pub fn write(&mut self, offset: usize, values: &[T]) -> Result<()> {
        if !self.begin_copy(offset, values.len())? {
            return Ok(());
        }
        let queue = &*self.context.queue;
        // SAFETY: the range was checked, and a blocking write has read `values` when it returns.
        unsafe {
            core::enqueue_write_buffer(queue, &*self.mem, true, offset, values, None::<&Event>, None::<&mut Event>)
        }
        .map_err(failed)
    }

    /// Copies the elements from `offset` on into `values`, after all commands enqueued before.
    ///
    /// # Errors
    /// As for [`Buffer::write`].
    pub fn read(&self, offset: usize, values: &mut [T]) -> Result<()> {
        if !self.begin_copy(offset, values.len())? {
            return Ok(());
        }
        let queue = &*self.context.queue;
        // SAFETY: the range was checked, and a blocking read has filled `values` when it returns.
        unsafe {
            core::enqueue_read_buffer(queue, &*self.mem, true, offset, values, None::<&Event>, None::<&mut Event>)
        }
        .map_err(failed)
    }
}

impl<T: Element> Drop for Buffer<T> {
    fn drop(&mut self) {
        self.context.allocated.fetch_sub(self.own_bytes, Ordering::Relaxed);
    }
}
