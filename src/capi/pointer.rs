//! What callers point to: outputs and text.

use crate::{Error, Result};
use std::ffi::{CStr, c_char};

/// `pointer`, if something may be written there; `name` is the argument's.
pub(super) fn place<T>(pointer: *mut T, name: &str) -> Result<*mut T> {
    if pointer.is_null() {
        return Err(Error::Argument(format!("{name} is NULL: a place for the result is needed")));
    }
    if !pointer.is_aligned() {
        let bytes = align_of::<T>();
        return Err(Error::Argument(format!("{name} is {pointer:p}: an address that {bytes} divides is accepted")));
    }
    Ok(pointer)
}

/// Writes a result. The caller's promise: room for a `T` where `pointer` is not NULL.
pub(super) unsafe fn put<T>(pointer: *mut T, name: &str, value: T) -> Result<()> {
    let place = place(pointer, name)?;
    unsafe { place.write(value) };
    Ok(())
}

/// Writes all `values`, of which there are as many as `count` says. The caller's promise: room for them.
pub(super) unsafe fn put_all(pointer: *mut f32, count: usize, values: &[f32]) -> Result<()> {
    let place = place(pointer, "values")?;
    if count != values.len() {
        return Err(Error::Shape(format!("count is {count}: {} values are accepted", values.len())));
    }
    // A caller may not write to what the library holds, so they cannot overlap.
    unsafe { std::ptr::copy_nonoverlapping(values.as_ptr(), place, values.len()) };
    Ok(())
}

/// Text that ends with a zero. The caller's promise: it does, and stays as it is during the call.
pub(super) unsafe fn text<'a>(pointer: *const c_char, name: &str) -> Result<&'a str> {
    if pointer.is_null() {
        return Err(Error::Argument(format!("{name} is NULL: text in UTF-8 is accepted")));
    }
    let text = unsafe { CStr::from_ptr(pointer) };
    text.to_str().map_err(|error| {
        let byte = error.valid_up_to();
        Error::Argument(format!("{name} is not UTF-8 from byte {byte} on: text in UTF-8 is accepted"))
    })
}
