//! Objects behind opaque handles, and the fence that every call runs inside.
//!
//! A handle begins with a mark of its type, which is read before anything else is: a handle that
//! was destroyed, or one of another type, is refused.

use super::failure::keep;
use super::status::{COPHASE_OK, cophase_status};
use crate::{Error, Result, fault, machine};
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{RwLock, TryLockError};

/// Runs the body of a call. A failure or a panic becomes its status, and its sentence is kept for
/// this thread.
pub(super) fn fence(body: impl FnOnce() -> Result<()>) -> cophase_status {
    if machine::lacks_its_threads() {
        return keep(&Error::Busy(
            "this process was forked from one in which cophase had started its threads, which a child does not have: start the process without \
             fork (multiprocessing: the start method 'spawn' or 'forkserver'), or fork before the first estimate"
                .into(),
        ));
    }
    // Unwind safety: an object that a panic left half changed is poisoned, and no later call reads
    // it.
    match catch_unwind(AssertUnwindSafe(body)) {
        Ok(Ok(())) => COPHASE_OK,
        Ok(Err(error)) => keep(&error),
        Err(panic) => keep(&Error::Panic(panic_message(&*panic).into())),
    }
}

/// Message of a panic.
fn panic_message(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("a panic without a message")
}

/// Type of an object whose only field is a handle.
pub(super) trait Object {
    /// Its place in [`NOUNS`], which no other type has.
    const KIND: u64;
}

/// What the objects are, for messages.
const NOUNS: [&str; 6] = ["an estimator", "an estimate", "a model", "a session", "a sequence", "a simulator"];

/// The object at `pointer`, the argument `name` of a call, as far as its memory still shows it:
/// that may belong to another object by now.
///
/// # Errors
/// [`Error::Argument`] for NULL, a handle that was destroyed, and one of another type.
pub(super) unsafe fn find<'a, O: Object>(pointer: *const O, name: &str) -> Result<&'a O> {
    if pointer.is_null() {
        return Err(Error::Argument(format!("{name} is NULL: a handle that its create call made is accepted")));
    }
    if !pointer.is_aligned() {
        return Err(given_back());
    }
    // Volatile: the compiler may assume that the mark of a live object does not change. No
    // reference before: an object of another type may be smaller.
    match unsafe { pointer.cast::<u64>().read_volatile() }.wrapping_sub(FIRST_MARK) {
        kind if kind == O::KIND => Ok(unsafe { &*pointer }),
        kind => Err(NOUNS.get(kind as usize).map_or_else(given_back, |noun| {
            let wanted = NOUNS[O::KIND as usize];
            Error::Argument(format!("{name} is a handle of {noun}: one of {wanted} is accepted"))
        })),
    }
}

/// An object behind an opaque pointer. Many threads may read it, or one may change it; any other
/// call fails at once with [`Error::Busy`] and does not wait. After a panic inside a call it can
/// only be dropped.
///
/// `repr(C)` puts the mark first: an allocator overwrites the beginning of freed memory first.
#[repr(C)]
pub(super) struct Handle<T, A = ()> {
    mark: u64,
    poisoned: AtomicBool,
    value: RwLock<T>,
    /// What any thread may use at any time.
    pub(super) aside: A,
}

impl<T: Send + Sync, A> Handle<T, A> {
    /// A call that reads an object.
    pub(super) fn read(handle: Result<&Self>, body: impl FnOnce(&T) -> Result<()>) -> cophase_status {
        Self::enter(handle, |value| body(&*value.try_read().map_err(refused)?))
    }

    /// Reads the object inside a call on another one.
    pub(super) fn look<R>(&self, body: impl FnOnce(&T) -> R) -> Result<R> {
        self.check_not_poisoned()?;
        Ok(body(&*self.value.try_read().map_err(refused)?))
    }
}

impl<T: Send, A> Handle<T, A> {
    /// The handle in an object of the type `O`.
    pub(super) fn new<O: Object>(value: T, aside: A) -> Self {
        Self { mark: FIRST_MARK + O::KIND, poisoned: AtomicBool::new(false), value: RwLock::new(value), aside }
    }

    /// A call that changes an object, or reads one that only one thread at a time may read.
    pub(super) fn change(handle: Result<&Self>, body: impl FnOnce(&mut T) -> Result<()>) -> cophase_status {
        Self::enter(handle, |value| body(&mut *value.try_write().map_err(refused)?))
    }

    /// As [`Handle::look`], for an object that only one thread at a time may read.
    pub(super) fn read_exclusively<R>(&self, body: impl FnOnce(&T) -> R) -> Result<R> {
        self.check_not_poisoned()?;
        Ok(body(&*self.value.try_write().map_err(refused)?))
    }

    /// Refuses an object in which a call has panicked.
    fn check_not_poisoned(&self) -> Result<()> {
        if self.poisoned.load(Ordering::Acquire) { Err(after_a_panic()) } else { Ok(()) }
    }

    fn enter(handle: Result<&Self>, body: impl FnOnce(&RwLock<T>) -> Result<()>) -> cophase_status {
        fence(|| {
            let handle = handle?;
            handle.check_not_poisoned()?;
            // Only a panic poisons: a call may also return COPHASE_PANIC because another object is
            // poisoned.
            let _poison = PoisonIfPanicking(&handle.poisoned);
            fault::fail_call()?;
            body(&handle.value)
        })
    }
}

/// Mark of a live handle of the first type; neither an address nor a small number.
const FIRST_MARK: u64 = 0x636f_7068_a5e1_1100;

impl<T, A> Drop for Handle<T, A> {
    fn drop(&mut self) {
        unsafe { (&raw mut self.mark).write_volatile(0) };
    }
}

/// Frees the object that `pointer` points to. NULL does nothing, nor does what [`find`] refuses.
pub(super) unsafe fn give_back<O: Object>(pointer: *mut O) {
    fence(|| {
        if unsafe { find(pointer, "") }.is_ok() {
            drop(unsafe { Box::from_raw(pointer) });
        }
        Ok(())
    });
}

/// Error of a call on a handle that was destroyed.
fn given_back() -> Error {
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
    use super::super::model::cophase_model;
    use super::super::status::*;
    use super::*;

    fn last() -> String {
        let mut text = [0u8; 256];
        let length = unsafe { cophase_last_error(text.as_mut_ptr().cast(), text.len()) };
        String::from_utf8_lossy(&text[..length.min(255)]).into_owned()
    }

    /// The handle of a number, in the place of an object.
    fn number(value: u32) -> Handle<u32> {
        Handle::new::<cophase_model>(value, ())
    }

    #[test]
    fn handles_of_another_type_are_refused() {
        let model = number(1);
        let at = &raw const model;
        let found = unsafe { find(at.cast::<super::super::session::cophase_session>(), "session") };
        let refused = found.err().unwrap().to_string();
        for fact in ["session is a handle of a model", "one of a session is accepted"] {
            assert!(refused.contains(fact), "{refused}");
        }
        // Freeing it as another object does nothing.
        unsafe { give_back(at.cast_mut().cast::<super::super::simulator::cophase_simulator>()) };
        assert_eq!(Handle::read(Ok(&model), |_| Ok(())), COPHASE_OK);
        // Neither an object nor aligned.
        let numbers = [7_u64; 2];
        for pointer in [numbers.as_ptr().cast::<cophase_model>(), unsafe { numbers.as_ptr().byte_add(1) }.cast()] {
            assert!(unsafe { find(pointer, "model") }.err().unwrap().to_string().contains("is none"));
        }
    }

    #[test]
    fn a_panic_is_caught_and_poisons_its_object_only() {
        let never = |_: &u32| -> Result<()> { unreachable!("a poisoned object was handed out") };
        for reading in [true, false] {
            let (hit, other) = (number(1), number(2));
            let panicked = if reading {
                Handle::read(Ok(&hit), |value| panic!("number {value}"))
            } else {
                Handle::change(Ok(&hit), |value| panic!("number {value}"))
            };
            assert_eq!(panicked, COPHASE_PANIC);
            assert!(last().contains("internal error") && last().ends_with("number 1"), "{}", last());
            assert_eq!(Handle::read(Ok(&hit), never), COPHASE_PANIC);
            assert!(last().ends_with("can only be destroyed"), "{}", last());
            assert_eq!(Handle::change(Ok(&hit), |value| never(value)), COPHASE_PANIC);
            // A call that is given both fails, and leaves the other as it was.
            assert_eq!(Handle::change(Ok(&other), |_| hit.look(|_| ())), COPHASE_PANIC);
            assert_eq!(Handle::read(Ok(&other), |_| Ok(())), COPHASE_OK);
        }
        assert_eq!(fence(|| std::panic::panic_any(7)), COPHASE_PANIC);
    }

    #[test]
    fn failures_pass_and_leave_the_object_usable() {
        let handle = number(1);
        let failed = Handle::change(Ok(&handle), |_| Err(Error::Shape("3 are not 4".into())));
        assert_eq!((failed, last()), (COPHASE_BAD_SHAPE, "3 are not 4".into()));
        assert_eq!(Handle::read(Ok(&handle), |_| Ok(())), COPHASE_OK);
        let none = unsafe { find(std::ptr::null::<cophase_model>(), "model") };
        assert!(none.is_err_and(|error| error.to_string().starts_with("model is NULL")));
    }

    #[test]
    fn readers_share_a_handle_and_writers_exclude() {
        let handle = number(1);
        let nested = |outer_changes: bool, inner_changes: bool| {
            let mut inner = COPHASE_OK;
            let mut enter = || {
                inner = std::thread::scope(|scope| {
                    let call = || match inner_changes {
                        true => Handle::change(Ok(&handle), |_| Ok(())),
                        false => Handle::read(Ok(&handle), |_| Ok(())),
                    };
                    scope.spawn(call).join().unwrap()
                });
                Ok(())
            };
            let outer = match outer_changes {
                true => Handle::change(Ok(&handle), |_| enter()),
                false => Handle::read(Ok(&handle), |_| enter()),
            };
            (outer, inner)
        };
        assert_eq!(nested(false, false), (COPHASE_OK, COPHASE_OK));
        assert_eq!(nested(false, true), (COPHASE_OK, COPHASE_BUSY));
        assert_eq!(nested(true, false), (COPHASE_OK, COPHASE_BUSY));
        assert_eq!(nested(true, true), (COPHASE_OK, COPHASE_BUSY));
    }
}
