//! Structs that grow: options that a caller fills, reports that it receives. Fields are only ever appended, and the
//! caller says how large the struct is that it was compiled with.

use super::pointer::place;
use crate::{Error, Result};

/// Options whose first field is `struct_size`.
///
/// # Safety
/// `repr(C)`, `struct_size: usize` first, and any bytes are a value: integers, floats and raw pointers only.
pub(super) unsafe trait Options: Copy {
    /// What each field is where the caller does not say; `struct_size` is that of this library.
    fn defaults() -> Self;
}

/// A struct's size is a multiple of its alignment, which is that of a `size_t` and a `double`.
const STEP: usize = 8;
/// No struct of ours will be larger: what is, was never initialised.
const LARGEST: usize = 1 << 16;

fn check_size(size: usize, name: &str) -> Result<()> {
    if !(STEP..=LARGEST).contains(&size) || !size.is_multiple_of(STEP) {
        return Err(Error::Argument(format!("{name} is {size}: the sizeof of its struct is accepted")));
    }
    Ok(())
}

/// Writes the defaults into a caller's struct of `size` bytes: no more than it has, and zeros where it has more than this
/// library knows. The caller's promise: that many bytes at `options`.
pub(super) unsafe fn init<T: Options>(options: *mut T, name: &str, size: usize) -> Result<()> {
    let place = place(options, name)?.cast::<u8>();
    check_size(size, "struct_size")?;
    let defaults = T::defaults();
    let known = size.min(size_of::<T>());
    unsafe {
        std::ptr::copy_nonoverlapping((&raw const defaults).cast::<u8>(), place, known);
        std::ptr::write_bytes(place.add(known), 0, size - known);
        place.cast::<usize>().write(size);
    }
    Ok(())
}

/// A caller's options; the defaults for NULL, and for fields that its struct does not have. The caller's promise:
/// `struct_size` bytes there.
pub(super) unsafe fn read<T: Options>(options: *const T, name: &str) -> Result<T> {
    let mut read = T::defaults();
    if options.is_null() {
        return Ok(read);
    }
    let place = place(options.cast_mut(), name)?.cast::<u8>();
    let size = unsafe { place.cast::<usize>().read() };
    if check_size(size, name).is_err() {
        return Err(Error::Argument(format!(
            "{name}->struct_size is {size}: what its _init call fills in is accepted"
        )));
    }
    let known = size.min(size_of::<T>());
    for byte in known..size {
        // A field of a later version that is not zero asks for something that this one would silently not do.
        if unsafe { *place.add(byte) } != 0 {
            return Err(Error::Argument(format!(
                "{name}->struct_size is {size} and byte {byte} is not 0: this library, cophase {}, knows {known} bytes",
                env!("CARGO_PKG_VERSION")
            )));
        }
    }
    unsafe { std::ptr::copy_nonoverlapping(place, (&raw mut read).cast::<u8>(), known) };
    Ok(read)
}

/// Reports of the caller's, each `size` bytes: how this library's reports go into them.
pub(super) struct Reports<T> {
    first: *mut T,
    size: usize,
}

impl<T: Copy> Reports<T> {
    /// `first` may be NULL where no report is wanted. The caller's promise: room for all that will be written.
    pub(super) fn at(first: *mut T, size: usize) -> Result<Self> {
        if !first.is_null() {
            place(first, "the report")?;
            check_size(size, "report_size")?;
        }
        Ok(Self { first, size })
    }

    /// Writes report `index`: no more than the caller's struct holds, and zeros where it holds more.
    pub(super) unsafe fn put(&self, index: usize, report: &T) {
        if self.first.is_null() {
            return;
        }
        let known = self.size.min(size_of::<T>());
        unsafe {
            let place = self.first.cast::<u8>().add(index * self.size);
            std::ptr::copy_nonoverlapping((&raw const *report).cast::<u8>(), place, known);
            std::ptr::write_bytes(place.add(known), 0, self.size - known);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[repr(C)]
    #[derive(Clone, Copy, Debug, PartialEq)]
    struct Example {
        struct_size: usize,
        first: f64,
        second: i32,
        third: i32,
    }

    unsafe impl Options for Example {
        fn defaults() -> Self {
            Self { struct_size: size_of::<Self>(), first: 1.5, second: 2, third: 3 }
        }
    }

    /// A caller's memory of four words, the first `size / 8` of which are its struct.
    fn initialised(size: usize) -> [u64; 4] {
        let mut memory = [0xa5a5_a5a5_a5a5_a5a5u64; 4];
        unsafe { init(memory.as_mut_ptr().cast::<Example>(), "example", size) }.unwrap();
        memory
    }

    #[test]
    fn older_and_newer_callers_are_served_and_nothing_beyond_their_struct_is_touched() {
        let guard = 0xa5a5_a5a5_a5a5_a5a5u64;
        let older = initialised(16);
        assert_eq!(older, [16, 1.5f64.to_bits(), guard, guard]);
        let read_back = |memory: &[u64; 4]| unsafe { read(memory.as_ptr().cast::<Example>(), "example") };
        let read_older = read_back(&older).unwrap();
        assert_eq!((read_older.first, read_older.second, read_older.third), (1.5, 2, 3));
        let mut newer = initialised(32);
        assert_eq!(newer[3], 0);
        assert_eq!(read_back(&newer).unwrap().third, 3);
        newer[3] = 1 << 40;
        let refused = read_back(&newer).unwrap_err().to_string();
        assert!(refused.contains("struct_size is 32 and byte 29 is not 0"), "{refused}");
        let from_null = unsafe { read::<Example>(std::ptr::null(), "example") }.unwrap();
        assert_eq!(from_null, Example::defaults());
    }

    #[test]
    fn sizes_that_no_struct_has_are_refused() {
        for size in [0, 1, 7, 12, LARGEST + 8, usize::MAX] {
            let mut memory = [0u64; 4];
            let error = unsafe { init(memory.as_mut_ptr().cast::<Example>(), "example", size) }.unwrap_err();
            assert!(matches!(error, Error::Argument(_)), "{error}");
            memory[0] = size as u64;
            let error = unsafe { read(memory.as_ptr().cast::<Example>(), "example") }.unwrap_err().to_string();
            assert!(error.starts_with(&format!("example->struct_size is {size}:")), "{error}");
        }
    }

    #[test]
    fn reports_keep_to_their_stride() {
        let mut memory = [u64::MAX; 7];
        let report = Example { struct_size: 9, first: 0.5, second: -1, third: 7 };
        let short = Reports::at(memory.as_mut_ptr().cast::<Example>(), 16).unwrap();
        unsafe { short.put(1, &report) };
        assert_eq!(memory, [u64::MAX, u64::MAX, 9, 0.5f64.to_bits(), u64::MAX, u64::MAX, u64::MAX]);
        let long = Reports::at(memory.as_mut_ptr().cast::<Example>(), 32).unwrap();
        unsafe { long.put(0, &report) };
        assert_eq!((memory[1], memory[3], memory[4]), (0.5f64.to_bits(), 0, u64::MAX));
        unsafe { Reports::<Example>::at(std::ptr::null_mut(), 0).unwrap().put(3, &report) };
    }
}
