//! Pointers of a caller: checked, then read or written. The caller's promise in each: the memory is
//! there, and no other thread uses it during the call.

use crate::{Error, Result};
use std::ffi::{CStr, c_char};

/// `pointer`, if a `T` may be written there; `name` is the argument's.
pub(super) fn place<T>(pointer: *mut T, name: &str) -> Result<*mut T> {
    if pointer.is_null() {
        return Err(Error::Argument(format!("{name} is NULL: the address of memory for it is accepted")));
    }
    aligned(pointer, name)
}

/// `pointer`, if a `T` may be read there.
pub(super) fn source<T>(pointer: *const T, name: &str) -> Result<*const T> {
    if pointer.is_null() {
        return Err(Error::Argument(format!("{name} is NULL: the address of an input is accepted")));
    }
    aligned(pointer.cast_mut(), name).map(<*mut T>::cast_const)
}

fn aligned<T>(pointer: *mut T, name: &str) -> Result<*mut T> {
    if !pointer.is_aligned() {
        let bytes = align_of::<T>();
        return Err(Error::Argument(format!("{name} is {pointer:p}: an address that {bytes} divides is accepted")));
    }
    Ok(pointer)
}

/// Writes one result.
pub(super) unsafe fn put<T>(pointer: *mut T, name: &str, value: T) -> Result<()> {
    let place = place(pointer, name)?;
    unsafe { place.write(value) };
    Ok(())
}

/// Writes one result, unless `pointer` is NULL.
pub(super) unsafe fn put_if_wanted<T>(pointer: *mut T, name: &str, value: T) -> Result<()> {
    if pointer.is_null() { Ok(()) } else { unsafe { put(pointer, name, value) } }
}

/// Writes an array of the given shape in C order to `count` doubles.
pub(super) unsafe fn put_array(
    out: *mut f64,
    count: usize,
    shape: &[usize],
    values: impl IntoIterator<Item = f64>,
) -> Result<()> {
    let wanted = shape.iter().product::<usize>();
    if count != wanted {
        let shape = shape.iter().map(usize::to_string).collect::<Vec<_>>().join(" x ");
        return Err(Error::Shape(format!("count is {count}: {wanted} is accepted ({shape})")));
    }
    let out = unsafe { numbers_mut(out, count, "out") }?;
    out.iter_mut().zip(values).for_each(|(out, value)| *out = value);
    Ok(())
}

/// Writes `text` as snprintf does: at most `capacity` bytes with the terminating zero, and its
/// whole length to `length`.
pub(super) unsafe fn put_text(out: *mut c_char, capacity: usize, length: *mut usize, text: &str) -> Result<()> {
    if out.is_null() && capacity > 0 {
        return Err(Error::Argument(format!("text is NULL: memory for the capacity of {capacity} bytes is accepted")));
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

/// `count` numbers to read.
pub(super) unsafe fn numbers<'a>(pointer: *const f64, count: usize, name: &str) -> Result<&'a [f64]> {
    let source = source(pointer, name)?;
    check_count(count, name)?;
    Ok(unsafe { std::slice::from_raw_parts(source, count) })
}

/// `count` numbers to write.
pub(super) unsafe fn numbers_mut<'a>(pointer: *mut f64, count: usize, name: &str) -> Result<&'a mut [f64]> {
    let place = place(pointer, name)?;
    check_count(count, name)?;
    Ok(unsafe { std::slice::from_raw_parts_mut(place, count) })
}

/// No array is larger than the address space: such a count is an error of the caller's.
fn check_count(count: usize, name: &str) -> Result<()> {
    if count > isize::MAX as usize / size_of::<f64>() {
        return Err(Error::Argument(format!("{name} has {count} elements: as many as memory holds are accepted")));
    }
    Ok(())
}

/// Text that ends with a zero.
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
