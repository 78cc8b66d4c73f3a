//! Structs that grow: fields are only appended, and the caller says how large the struct is that it
//! was compiled with.

use super::pointer::{place, source};
use crate::{Error, Result};

/// Options, in which zero means the default in every field but the first.
///
/// # Safety
/// `repr(C)`, `struct_size: usize` first, and any bytes are a value: integers, floats and raw
/// pointers only.
pub(super) unsafe trait Options: Copy {}

/// The size of a struct is a multiple of its alignment, which is that of a `size_t` and a `double`.
const STEP: usize = 8;
/// Larger than any struct of this interface: such a size was never set.
const LARGEST: usize = 1 << 16;

fn is_possible(size: usize) -> bool {
    (STEP..=LARGEST).contains(&size) && size.is_multiple_of(STEP)
}

/// Options of a caller; the defaults for NULL, and for fields that its struct does not have. The
/// caller's promise: `struct_size` bytes.
pub(super) unsafe fn read<T: Options>(options: *const T, name: &str) -> Result<T> {
    // SAFETY: any bytes are a value of it.
    let mut read = unsafe { std::mem::zeroed::<T>() };
    if options.is_null() {
        return Ok(read);
    }
    let place = source(options, name)?.cast::<u8>();
    let size = unsafe { place.cast::<usize>().read() };
    if !is_possible(size) {
        return Err(Error::Argument(format!("{name}->struct_size is {size}: the sizeof of the struct is accepted")));
    }
    let known = size.min(size_of::<T>());
    for byte in known..size {
        // A field of a later version that is not zero asks for something that this one would
        // silently not do.
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

/// Structs of a caller that receive results, each `size` bytes.
pub(super) struct Outputs<T> {
    first: *mut T,
    size: usize,
}

impl<T: Copy> Outputs<T> {
    /// `first` may be NULL where no result is wanted. The caller's promise: memory for all that
    /// will be written.
    pub(super) fn new(first: *mut T, size: usize, (name, size_name): (&str, &str)) -> Result<Self> {
        if !first.is_null() {
            place(first, name)?;
            if !is_possible(size) {
                return Err(Error::Argument(format!("{size_name} is {size}: the sizeof of the struct is accepted")));
            }
        }
        Ok(Self { first, size })
    }

    /// Writes result `index`: no more than the caller's struct holds, and zeros where it holds
    /// more.
    pub(super) unsafe fn put(&self, index: usize, result: &T) {
        if self.first.is_null() {
            return;
        }
        let known = self.size.min(size_of::<T>());
        unsafe {
            let place = self.first.cast::<u8>().add(index * self.size);
            std::ptr::copy_nonoverlapping((&raw const *result).cast::<u8>(), place, known);
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

    unsafe impl Options for Example {}

    fn read_back(memory: &[u64]) -> Result<Example> {
        unsafe { read(memory.as_ptr().cast::<Example>(), "example") }
    }

    #[test]
    fn older_and_newer_callers_are_served() {
        let guard = 0xa5a5_a5a5_a5a5_a5a5u64;
        // A caller whose struct ends after the first field: the bytes behind it are not its
        // struct's.
        let older = read_back(&[16, 1.5f64.to_bits(), guard, guard]).unwrap();
        assert_eq!(older, Example { struct_size: 16, first: 1.5, second: 0, third: 0 });
        let same = read_back(&[24, 1.5f64.to_bits(), 3 << 32 | 2, guard]).unwrap();
        assert_eq!((same.second, same.third), (2, 3));
        assert_eq!(read_back(&[32, 0, 0, 0]).unwrap().first, 0.0);
        let refused = read_back(&[32, 0, 0, 1 << 40]).unwrap_err().to_string();
        assert!(["struct_size is 32", "byte 29"].iter().all(|fact| refused.contains(fact)), "{refused}");
        let none = unsafe { read::<Example>(std::ptr::null(), "example") }.unwrap();
        assert_eq!(none, Example { struct_size: 0, first: 0.0, second: 0, third: 0 });
    }

    #[test]
    fn sizes_that_no_struct_has_are_refused() {
        for size in [0, 1, 7, 12, LARGEST + 8, usize::MAX] {
            let error = read_back(&[size as u64, 0, 0, 0]).unwrap_err();
            assert!(matches!(error, Error::Argument(_)), "{error}");
            assert!(error.to_string().starts_with(&format!("example->struct_size is {size}:")), "{error}");
            let mut memory = [0u64; 4];
            let output = Outputs::new(memory.as_mut_ptr().cast::<Example>(), size, ("reports", "report_size"));
            assert!(output.err().unwrap().to_string().starts_with(&format!("report_size is {size}:")));
        }
    }

    #[test]
    fn outputs_keep_to_their_stride() {
        let names = ("reports", "report_size");
        let mut memory = [u64::MAX; 7];
        let report = Example { struct_size: 9, first: 0.5, second: -1, third: 7 };
        let short = Outputs::new(memory.as_mut_ptr().cast::<Example>(), 16, names).unwrap();
        unsafe { short.put(1, &report) };
        assert_eq!(memory, [u64::MAX, u64::MAX, 9, 0.5f64.to_bits(), u64::MAX, u64::MAX, u64::MAX]);
        let long = Outputs::new(memory.as_mut_ptr().cast::<Example>(), 32, names).unwrap();
        unsafe { long.put(0, &report) };
        assert_eq!((memory[1], memory[3], memory[4]), (0.5f64.to_bits(), 0, u64::MAX));
        unsafe { Outputs::<Example>::new(std::ptr::null_mut(), 0, names).unwrap().put(3, &report) };
    }
}
