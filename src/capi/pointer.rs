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

/// Writes rows and columns: both or none.
pub(super) unsafe fn put_shape(rows: *mut usize, cols: *mut usize, shape: (usize, usize)) -> Result<()> {
    place(cols, "cols")?;
    unsafe {
        put(rows, "rows", shape.0)?;
        put(cols, "cols", shape.1)
    }
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

/// Writes `text` as snprintf does: at most `capacity` bytes with the zero that ends it, and its whole length to `length`.
/// The caller's promise: room for that many bytes, where `out` is not NULL.
pub(super) unsafe fn put_text(out: *mut c_char, capacity: usize, length: *mut usize, text: &str) -> Result<()> {
    if out.is_null() && capacity > 0 {
        return Err(Error::Argument(format!(
            "text is NULL: room for the capacity of {capacity} bytes is needed, or 0"
        )));
    }
    unsafe { put(length, "length", text.len()) }?;
    if capacity > 0 {
        let mut kept = text.len().min(capacity - 1);
        while !text.is_char_boundary(kept) {
            kept -= 1;
        }
        unsafe {
            std::ptr::copy_nonoverlapping(text.as_ptr(), out.cast(), kept);
            out.add(kept).write(0);
        }
    }
    Ok(())
}

/// `count` numbers of a caller's. The caller's promise: they are there, and stay as they are during the call.
pub(super) unsafe fn numbers<'a>(pointer: *const f64, count: usize, name: &str) -> Result<&'a [f64]> {
    let place = readable(pointer, name)?;
    // What is there cannot be larger; a count that is, is an error of the caller's.
    if count > isize::MAX as usize / size_of::<f64>() {
        return Err(Error::Argument(format!("{name} has {count} elements: as many as memory holds are accepted")));
    }
    Ok(unsafe { std::slice::from_raw_parts(place, count) })
}

/// Room for `count` numbers of a caller's. The caller's promise: it is there, and nobody else uses it during the call.
pub(super) unsafe fn room<'a>(pointer: *mut f64, count: usize, name: &str) -> Result<&'a mut [f64]> {
    let place = place(pointer, name)?;
    if count > isize::MAX as usize / size_of::<f64>() {
        return Err(Error::Argument(format!("{name} has {count} elements: as many as memory holds are accepted")));
    }
    Ok(unsafe { std::slice::from_raw_parts_mut(place, count) })
}

/// `pointer`, if something may be read there.
fn readable<T>(pointer: *const T, name: &str) -> Result<*const T> {
    if pointer.is_null() {
        return Err(Error::Argument(format!("{name} is NULL: the address of the first element is accepted")));
    }
    if !pointer.is_aligned() {
        let bytes = align_of::<T>();
        return Err(Error::Argument(format!("{name} is {pointer:p}: an address that {bytes} divides is accepted")));
    }
    Ok(pointer)
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
