//! Objects behind opaque handles, and the fence that every call runs inside.

use super::failure::keep;
use super::status::{COPHASE_OK, cophase_status};
use crate::{Error, Result, fault};
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{RwLock, TryLockError};

/// Runs the body of a call. A failure or a panic becomes its status, and its sentence is kept for this thread.
pub(super) fn fence(body: impl FnOnce() -> Result<()>) -> cophase_status {
    // Unwind safety: an object that a panic left half changed is poisoned, and no later call reads it.
    match catch_unwind(AssertUnwindSafe(body)) {
        Ok(Ok(())) => COPHASE_OK,
        Ok(Err(error)) => keep(&error),
        Err(panic) => keep(&Error::Panic(words(&*panic).into())),
    }
}

/// Message of a panic.
fn words(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("a panic without a message")
}

/// An object behind an opaque pointer. Many threads may read it, or one may change it; any other call fails at once with
/// [`Error::Busy`] and does not wait. After a panic inside a call it can only be dropped.
///
/// `repr(C)` puts the mark first: an allocator overwrites the beginning of freed memory first.
#[repr(C)]
pub(super) struct Handle<T> {
    mark: u64,
    poisoned: AtomicBool,
    value: RwLock<T>,
}

impl<T: Send + Sync> Handle<T> {
    /// A call that reads what the argument `name` points to; `None` is NULL.
    pub(super) fn read(handle: Option<&Self>, name: &str, body: impl FnOnce(&T) -> Result<()>) -> cophase_status {
        Self::enter(handle, name, |value| body(&*value.try_read().map_err(refused)?))
    }

    /// Reads the object inside a call on another one.
    pub(super) fn look<R>(&self, body: impl FnOnce(&T) -> R) -> Result<R> {
        self.whole()?;
        Ok(body(&*self.value.try_read().map_err(refused)?))
    }
}

impl<T: Send> Handle<T> {
    pub(super) fn new(value: T) -> Self {
        Self { mark: ALIVE, poisoned: AtomicBool::new(false), value: RwLock::new(value) }
    }

    /// A call that changes what the argument `name` points to, or reads an object that only one thread at a time may read.
    pub(super) fn change(handle: Option<&Self>, name: &str, body: impl FnOnce(&mut T) -> Result<()>) -> cophase_status {
        Self::enter(handle, name, |value| body(&mut *value.try_write().map_err(refused)?))
    }

    /// As [`Handle::look`], for an object that only one thread at a time may read.
    pub(super) fn look_alone<R>(&self, body: impl FnOnce(&T) -> R) -> Result<R> {
        self.whole()?;
        Ok(body(&*self.value.try_write().map_err(refused)?))
    }

    /// Whether it has not been destroyed, as far as its memory still shows it: that may belong to another object by now.
    pub(super) fn is_alive(&self) -> bool {
        // Volatile: the compiler may assume that the mark of a live object does not change.
        unsafe { (&raw const self.mark).read_volatile() == ALIVE }
    }

    /// Refuses an object that was destroyed, or in which a call has panicked.
    fn whole(&self) -> Result<()> {
        if !self.is_alive() {
            return Err(given_back());
        }
        if self.poisoned.load(Ordering::Acquire) { Err(after_a_panic()) } else { Ok(()) }
    }

    fn enter(handle: Option<&Self>, name: &str, body: impl FnOnce(&RwLock<T>) -> Result<()>) -> cophase_status {
        fence(|| {
            let handle = handle.ok_or_else(|| null(name))?;
            handle.whole()?;
            // Only a panic poisons: a call may also return COPHASE_PANIC because another object is poisoned.
            let _poison = PoisonIfPanicking(&handle.poisoned);
            fault::fail_call()?;
            body(&handle.value)
        })
    }
}

/// Mark of a live handle; neither an address nor a small number.
const ALIVE: u64 = 0x636f_7068_a5e1_11fe;

impl<T> Drop for Handle<T> {
    fn drop(&mut self) {
        unsafe { (&raw mut self.mark).write_volatile(0) };
    }
}

/// Frees the object that `pointer` points to, whose handle `handle` finds. NULL does nothing, nor, as far as the memory
/// still shows it, does an object that was freed before.
pub(super) unsafe fn give_back<O, T: Send>(pointer: *mut O, handle: impl FnOnce(&O) -> &Handle<T>) {
    fence(|| {
        if unsafe { pointer.as_ref() }.is_some_and(|object| handle(object).is_alive()) {
            drop(unsafe { Box::from_raw(pointer) });
        }
        Ok(())
    });
}

/// Error of a call on a handle that was destroyed.
pub(super) fn given_back() -> Error {
    Error::Argument("the handle was destroyed, or is none: one that its create call made is accepted".into())
}

/// Raises the flag when it is dropped during a panic.
struct PoisonIfPanicking<'a>(&'a AtomicBool);

impl Drop for PoisonIfPanicking<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.store(true, Ordering::Release);
        }
    }
}

/// Error of a call on NULL.
pub(super) fn null(name: &str) -> Error {
    Error::Argument(format!("{name} is NULL: a handle that its create call made is accepted"))
}

fn after_a_panic() -> Error {
    Error::Panic("an earlier call panicked, and this object can only be destroyed".into())
}

fn refused<G>(error: TryLockError<G>) -> Error {
    match error {
        TryLockError::WouldBlock => {
            Error::Busy("the object is in use by another thread: one thread at a time is accepted".into())
        }
        TryLockError::Poisoned(_) => after_a_panic(),
    }
}

#[cfg(test)]
mod tests {
    use super::super::cophase_last_error;
    use super::super::status::*;
    use super::*;

    fn last() -> String {
        let mut text = [0u8; 256];
        let length = unsafe { cophase_last_error(text.as_mut_ptr().cast(), text.len()) };
        String::from_utf8_lossy(&text[..length.min(255)]).into_owned()
    }

    #[test]
    fn a_panic_is_caught_and_poisons_its_object_only() {
        let never = |_: &u32| -> Result<()> { unreachable!("a poisoned object was handed out") };
        for reading in [true, false] {
            let (hit, other) = (Handle::new(1), Handle::new(2));
            let panicked = if reading {
                Handle::read(Some(&hit), "hit", |value| panic!("number {value}"))
            } else {
                Handle::change(Some(&hit), "hit", |value| panic!("number {value}"))
            };
            assert_eq!(panicked, COPHASE_PANIC);
            assert!(last().contains("internal error") && last().ends_with("number 1"), "{}", last());
            assert_eq!(Handle::read(Some(&hit), "hit", never), COPHASE_PANIC);
            assert!(last().ends_with("can only be destroyed"), "{}", last());
            assert_eq!(Handle::change(Some(&hit), "hit", |value| never(value)), COPHASE_PANIC);
            // A call that is given both fails, and leaves the other as it was.
            assert_eq!(Handle::change(Some(&other), "other", |_| hit.look(|_| ())), COPHASE_PANIC);
            assert_eq!(Handle::read(Some(&other), "other", |_| Ok(())), COPHASE_OK);
        }
        assert_eq!(fence(|| std::panic::panic_any(7)), COPHASE_PANIC);
    }

    #[test]
    fn failures_pass_and_leave_the_object_usable() {
        let handle = Handle::new(1);
        let failed = Handle::change(Some(&handle), "handle", |_| Err(Error::Shape("3 are not 4".into())));
        assert_eq!((failed, last()), (COPHASE_BAD_SHAPE, "3 are not 4".into()));
        assert_eq!(Handle::read(Some(&handle), "handle", |_| Ok(())), COPHASE_OK);
        assert_eq!(Handle::<u32>::read(None, "handle", |_| Ok(())), COPHASE_BAD_ARGUMENT);
        assert!(last().starts_with("handle is NULL"));
    }

    #[test]
    fn readers_share_a_handle_and_writers_exclude() {
        let handle = Handle::new(1);
        let nested = |outer_changes: bool, inner_changes: bool| {
            let mut inner = COPHASE_OK;
            let mut enter = || {
                inner = std::thread::scope(|scope| {
                    let call = || match inner_changes {
                        true => Handle::change(Some(&handle), "handle", |_| Ok(())),
                        false => Handle::read(Some(&handle), "handle", |_| Ok(())),
                    };
                    scope.spawn(call).join().unwrap()
                });
                Ok(())
            };
            let outer = match outer_changes {
                true => Handle::change(Some(&handle), "handle", |_| enter()),
                false => Handle::read(Some(&handle), "handle", |_| enter()),
            };
            (outer, inner)
        };
        assert_eq!(nested(false, false), (COPHASE_OK, COPHASE_OK));
        assert_eq!(nested(false, true), (COPHASE_OK, COPHASE_BUSY));
        assert_eq!(nested(true, false), (COPHASE_OK, COPHASE_BUSY));
        assert_eq!(nested(true, true), (COPHASE_OK, COPHASE_BUSY));
    }
}
