//! A safe handle of cfitsio. The `unsafe` code of this module is here, and in `write` where columns
//! and images are passed to cfitsio.
//!
//! The vendored library is built re-entrant and a handle is used by one thread at a time, so
//! threads share only cfitsio's own locked tables. Files are opened with its "disk file" entry
//! points only, which do not interpret brackets, filters, URLs or pipes in a name.
//!
//! The `anynul` argument of cfitsio's readers is always passed: the manual calls it optional, but
//! `fffi2r8` and similar functions write through it unconditionally.

use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::os::unix::ffi::OsStrExt;
use std::path::Path;
use std::ptr;

use fitsio::sys;

use super::characters;

/// Result of a call, with cfitsio's message on failure.
pub(super) type CfitsioResult<T> = Result<T, String>;

/// The memory of a file. cfitsio keeps pointers to both fields, so it is in a `Box`.
struct Memory {
    start: *mut c_void,
    bytes: usize,
}

impl Drop for Memory {
    fn drop(&mut self) {
        // SAFETY: `start` is null or came from malloc/realloc, and cfitsio's handle is closed
        // before its memory drops.
        unsafe { libc::free(self.start) }
    }
}

/// An open file, closed when dropped. The bytes of a file being written are taken with
/// [`FitsHandle::into_bytes`].
pub(super) struct FitsHandle {
    file: *mut sys::fitsfile,
    memory: Option<Box<Memory>>,
}

// SAFETY: a handle is used by one thread at a time (no method takes `&self` concurrently: it is not
// `Sync`), and the library is built with --enable-reentrant.
unsafe impl Send for FitsHandle {}

/// Name of files in memory, without characters that cfitsio would interpret as a filter.
const MEMORY_NAME: &CStr = c"memory";

/// Increment of the memory of a file being written: large, so that it is rarely copied.
const GROWTH_BYTES: usize = 4 << 20;

impl FitsHandle {
    /// Opens a file in standard form, read only.
    pub fn open(path: &Path) -> CfitsioResult<Self> {
        let name = CString::new(path.as_os_str().as_bytes()).map_err(|_| "the name contains a NUL".to_string())?;
        let mut handle = Self { file: ptr::null_mut(), memory: None };
        // SAFETY: `name` is NUL-terminated and outlives the call; `file` receives the handle.
        check(|status| unsafe { sys::ffdkopn(&mut handle.file, name.as_ptr(), sys::READONLY as c_int, status) })?;
        Ok(handle)
    }

    /// Opens a file in memory in standard form, read only.
    pub fn from_bytes(bytes: &[u8]) -> CfitsioResult<Self> {
        // SAFETY: the block is at least one byte and written below before anything reads it.
        let start = unsafe { libc::malloc(bytes.len().max(1)) };
        if start.is_null() {
            return Err(format!("{} bytes of memory are not available", bytes.len()));
        }
        let mut memory = Box::new(Memory { start, bytes: bytes.len() });
        // SAFETY: both ranges are `bytes.len()` long and distinct.
        unsafe { ptr::copy_nonoverlapping(bytes.as_ptr(), start.cast(), bytes.len()) };
        let mut file = ptr::null_mut();
        // SAFETY: the addresses in the box stay valid until the handle is closed in `drop`.
        let opened = check(|status| unsafe {
            let (start, size) = (&raw mut memory.start, &raw mut memory.bytes);
            sys::ffomem(&mut file, MEMORY_NAME.as_ptr(), sys::READONLY as c_int, start, size, 0, None, status)
        });
        let handle = Self { file, memory: Some(memory) };
        opened.map(|()| handle)
    }

    /// Starts an empty file in memory.
    pub fn create() -> CfitsioResult<Self> {
        Self::create_in(2880)
    }

    /// Starts an empty file in `first` bytes of memory, which are 0; more is not, where the file
    /// outgrows them.
    pub(super) fn create_in(first: usize) -> CfitsioResult<Self> {
        // SAFETY: calloc returns zeroed memory or null.
        let start = unsafe { libc::calloc(first, 1) };
        if start.is_null() {
            return Err(format!("{first} bytes of memory are not available"));
        }
        let mut memory = Box::new(Memory { start, bytes: first });
        let mut file = ptr::null_mut();
        // SAFETY: as in `from_bytes`; `realloc` matches the allocator of `start`.
        let created = check(|status| unsafe {
            let (start, size) = (&raw mut memory.start, &raw mut memory.bytes);
            sys::ffimem(&mut file, start, size, GROWTH_BYTES, Some(libc::realloc), status)
        });
        let handle = Self { file, memory: Some(memory) };
        created.map(|()| handle)
    }

    /// Calls one cfitsio function with the file and a status.
    ///
    /// The closure may only pass pointers that are valid during the call and point to enough
    /// memory.
    pub fn call(&mut self, function: impl FnOnce(*mut sys::fitsfile, *mut c_int) -> c_int) -> CfitsioResult<()> {
        let file = self.file;
        check(|status| function(file, status))
    }

    /// Moves to HDU `index`, counted from 0.
    pub fn move_to(&mut self, index: usize) -> CfitsioResult<()> {
        let number =
            c_int::try_from(index + 1).map_err(|_| format!("HDU {index} exceeds the largest HDU number of cfitsio"))?;
        // SAFETY: a null type pointer is allowed.
        self.call(|file, status| unsafe { sys::ffmahd(file, number, ptr::null_mut(), status) })
    }

    /// Sum of the data of the current HDU, as its card `DATASUM` has it.
    pub fn data_sum(&mut self) -> CfitsioResult<u64> {
        let (mut data, mut hdu) = (0, 0);
        // SAFETY: two live locals.
        self.call(|file, status| unsafe { sys::ffgcks(file, &mut data, &mut hdu, status) })?;
        Ok(data)
    }

    /// Reads the whole image of the current HDU as f64, x fastest; `BLANK` becomes NaN.
    pub fn image(&mut self, axes: usize, pixels: usize, integers: bool) -> CfitsioResult<Vec<f64>> {
        let mut data = allocate(pixels, 0.0)?;
        let mut first = vec![1_i64; axes];
        let (mut nan, mut any) = (f64::NAN, 0);
        // With a null value cfitsio also changes infinities and denormals of floating-point images:
        // there it is omitted.
        let null = if integers { (&raw mut nan).cast() } else { ptr::null_mut() };
        // SAFETY: `data` holds `pixels` values, `first` one per axis.
        self.call(|file, status| unsafe {
            let (first, data) = (first.as_mut_ptr(), data.as_mut_ptr().cast());
            sys::ffgpxvll(file, sys::TDOUBLE as c_int, first, pixels as i64, null, data, &mut any, status)
        })?;
        Ok(data)
    }

    /// Type code, repeat count and width in bytes of a column, counted from 1.
    pub fn column_type(&mut self, column: c_int) -> CfitsioResult<(c_int, i64, i64)> {
        let (mut code, mut repeat, mut width) = (0, 0, 0);
        // SAFETY: three live locals.
        self.call(|file, status| unsafe { sys::ffgtclll(file, column, &mut code, &mut repeat, &mut width, status) })?;
        Ok((code, repeat, width))
    }

    /// A numeric column of `rows` scalars; undefined integers become NaN.
    pub fn column_f64(&mut self, column: c_int, rows: usize, integers: bool) -> CfitsioResult<Vec<f64>> {
        let mut data = allocate(rows, 0.0)?;
        // 0 disables the check: floating-point columns keep NaN and infinities.
        let null = if integers { f64::NAN } else { 0.0 };
        let mut any = 0;
        // SAFETY: `data` holds `rows` values.
        self.call(|file, status| unsafe {
            sys::ffgcvd(file, column, 1, 1, rows as i64, null, data.as_mut_ptr(), &mut any, status)
        })?;
        Ok(data)
    }

    /// An integer column of `rows` scalars.
    pub fn column_i64(&mut self, column: c_int, rows: usize) -> CfitsioResult<Vec<i64>> {
        let mut data = allocate(rows, 0_i64)?;
        let mut any = 0;
        // SAFETY: `data` holds `rows` values.
        self.call(|file, status| unsafe {
            sys::ffgcvjj(file, column, 1, 1, rows as i64, 0, data.as_mut_ptr(), &mut any, status)
        })?;
        Ok(data)
    }

    /// A text column of `rows` strings of at most `width` bytes, without trailing blanks.
    pub fn column_text(&mut self, column: c_int, rows: usize, width: usize) -> CfitsioResult<Vec<String>> {
        let stride = width + 1;
        let total = rows.checked_mul(stride).ok_or("the text column is larger than memory")?;
        let mut bytes = allocate(total, 0_u8)?;
        let mut starts: Vec<*mut c_char> = bytes.chunks_exact_mut(stride).map(|row| row.as_mut_ptr().cast()).collect();
        let (mut null, mut any) = ([0 as c_char], 0);
        // SAFETY: one pointer per row, each to `width` bytes and a NUL.
        self.call(|file, status| unsafe {
            let (null, starts) = (null.as_mut_ptr(), starts.as_mut_ptr());
            sys::ffgcvs(file, column, 1, 1, rows as i64, null, starts, &mut any, status)
        })?;
        let text = |row: &[u8]| {
            let end = row.iter().position(|&byte| byte == 0).unwrap_or(width);
            characters::decoded(row[..end].trim_ascii_end())
        };
        Ok(bytes.chunks_exact(stride).map(text).collect())
    }

    /// The numbers of a variable-length array: a row, from 0, of a column, from 1. More than `most`
    /// are refused.
    pub fn list_f64(&mut self, column: c_int, row: usize, most: u64) -> CfitsioResult<Vec<f64>> {
        let (row, mut count, mut offset) = (row as i64 + 1, 0, 0);
        // SAFETY: two live locals.
        self.call(|file, status| unsafe { sys::ffgdesll(file, column, row, &mut count, &mut offset, status) })?;
        let length = u64::try_from(count).ok().filter(|&count| count <= most);
        let length =
            length.ok_or_else(|| format!("a list claims {count} numbers, where the table has {most} at most"))?;
        let mut data = allocate(length as usize, 0.0)?;
        let mut any = 0;
        if !data.is_empty() {
            // SAFETY: `data` holds `count` values.
            self.call(|file, status| unsafe {
                // 0 disables the check for undefined values: NaN and infinities are kept.
                sys::ffgcvd(file, column, row, 1, count, 0.0, data.as_mut_ptr(), &mut any, status)
            })?;
        }
        Ok(data)
    }

    /// The text of a string card, across its CONTINUE cards.
    pub fn long_text(&mut self, key: &CStr) -> CfitsioResult<String> {
        let mut value: *mut c_char = ptr::null_mut();
        // SAFETY: cfitsio allocates the text and returns its address.
        self.call(|file, status| unsafe { sys::ffgkls(file, key.as_ptr(), &mut value, ptr::null_mut(), status) })?;
        if value.is_null() {
            return Ok(String::new());
        }
        // SAFETY: a NUL-terminated string of cfitsio's, freed once.
        unsafe {
            let text = CStr::from_ptr(value).to_string_lossy().trim_end().to_string();
            libc::free(value.cast());
            Ok(text)
        }
    }

    /// Closes a file written in memory and returns its bytes, with all `hdus` HDUs complete.
    pub fn into_bytes(mut self, hdus: usize) -> CfitsioResult<Vec<u8>> {
        // Leaving an HDU completes its header and fill; the end of the last one is the end of the
        // file.
        self.move_to(0)?;
        self.move_to(hdus.saturating_sub(1))?;
        let (mut header, mut data, mut end) = (0, 0, 0);
        // SAFETY: three live locals.
        self.call(|file, status| unsafe { sys::ffghadll(file, &mut header, &mut data, &mut end, status) })?;
        let file = std::mem::replace(&mut self.file, ptr::null_mut());
        // SAFETY: `file` is open and is not used again.
        check(|status| unsafe { sys::ffclos(file, status) })?;
        let memory = self.memory.as_ref().ok_or("the file is not in memory")?;
        let length = usize::try_from(end).ok().filter(|&length| length <= memory.bytes);
        let length = length.ok_or_else(|| format!("cfitsio wrote {} of {end} bytes", memory.bytes))?;
        // SAFETY: `length` bytes of the block are written.
        Ok(unsafe { std::slice::from_raw_parts(memory.start.cast::<u8>(), length) }.to_vec())
    }
}

impl Drop for FitsHandle {
    fn drop(&mut self) {
        if !self.file.is_null() {
            // A failure to close a file that was read or abandoned has no consequence: its message
            // is cleared. SAFETY: `file` is open; its memory drops after this.
            let _ = check(|status| unsafe { sys::ffclos(self.file, status) });
        }
    }
}

/// Memory for `count` values; an error instead of an abort where it is not available.
fn allocate<T: Clone>(count: usize, value: T) -> CfitsioResult<Vec<T>> {
    let mut data = Vec::new();
    data.try_reserve_exact(count).map_err(|_| format!("memory for {count} values is not available"))?;
    data.resize(count, value);
    Ok(data)
}

/// Runs `call` with a new status, and moves the messages of cfitsio's stack into the error.
fn check(call: impl FnOnce(*mut c_int) -> c_int) -> CfitsioResult<()> {
    let mut status = 0;
    call(&mut status);
    if status == 0 {
        return Ok(());
    }
    // 31 and 81 bytes with the NUL: FLEN_STATUS and FLEN_ERRMSG of fitsio.h.
    let (mut words, mut message) = ([0 as c_char; 31], [0 as c_char; 81]);
    let text = |buffer: &[c_char]| {
        // SAFETY: cfitsio fills both buffers with NUL-terminated text, and they start as zeros.
        unsafe { CStr::from_ptr(buffer.as_ptr()) }.to_string_lossy().trim().to_string()
    };
    // SAFETY: the buffers have the lengths that cfitsio documents.
    unsafe { sys::ffgerr(status, words.as_mut_ptr()) };
    let mut sentence = format!("cfitsio reports `{}` (status {status}", text(&words));
    // Bounded loop: the stack has at most 25 messages, but another thread may add to it.
    for _ in 0..50 {
        // SAFETY: as above.
        if unsafe { sys::ffgmsg(message.as_mut_ptr()) } == 0 {
            break;
        }
        sentence.push_str("; ");
        sentence.push_str(&text(&message));
    }
    sentence.push(')');
    Err(sentence)
}
