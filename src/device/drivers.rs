//! OpenCL drivers that are installed here: the `.icd` files that the loader reads, and the
//! libraries that they name.

use std::ffi::{CStr, CString, OsString};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

/// Folder of the `.icd` files where no variable names another.
const VENDORS: &str = "/etc/OpenCL/vendors";

/// Variables that decide which drivers are loaded.
const VARIABLES: [&str; 4] = ["COPHASE_OPENCL_LIBRARY", "OCL_ICD_VENDORS", "OPENCL_VENDOR_PATH", "OCL_ICD_FILENAMES"];

/// One driver: its `.icd` file, and the library in its first line.
struct Driver {
    icd: PathBuf,
    library: String,
}

/// Drivers in the order of their files' names.
fn installed() -> Vec<Driver> {
    let named = ["OCL_ICD_VENDORS", "OPENCL_VENDOR_PATH"].into_iter().filter_map(std::env::var_os);
    let place = named.map(PathBuf::from).find(|path| !path.as_os_str().is_empty());
    let place = place.unwrap_or_else(|| VENDORS.into());
    let is_icd = |path: &PathBuf| path.extension().is_some_and(|extension| extension == "icd");
    let mut files: Vec<PathBuf> = match std::fs::read_dir(&place) {
        Ok(entries) => entries.flatten().map(|entry| entry.path()).filter(is_icd).collect(),
        Err(_) => vec![place],
    };
    let more: OsString = std::env::var_os("OCL_ICD_FILENAMES").unwrap_or_default();
    files.extend(std::env::split_paths(&more).filter(is_icd));
    files.sort();
    let read = |icd: PathBuf| {
        let text = std::fs::read_to_string(&icd).ok()?;
        Some(Driver { library: text.lines().next().unwrap_or_default().trim().to_string(), icd })
    };
    files.into_iter().filter_map(read).collect()
}

/// What the outcome of a probe depends on: the version of this library, the start of the machine,
/// the variables, and path, size and time of each driver's files.
pub(super) fn fingerprint() -> String {
    let mut text = format!("cophase {}\n", env!("CARGO_PKG_VERSION"));
    // A driver's part in the kernel may be another after a start; without the file, time alone
    // decides.
    let boot = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default();
    // Writing into memory does not fail.
    let _ = writeln!(text, "boot {}", boot.trim());
    for name in VARIABLES {
        let value = std::env::var_os(name).unwrap_or_default();
        let _ = writeln!(text, "{name}={}", value.to_string_lossy());
        text += &stamp(Path::new(&value));
    }
    for Driver { icd, library } in installed() {
        let _ = writeln!(text, "{}: {library}", icd.display());
        text += &stamp(&icd);
        text += &stamp(Path::new(&library));
    }
    text
}

/// Size and time of a file; nothing where there is none.
fn stamp(path: &Path) -> String {
    let Ok(metadata) = std::fs::metadata(path) else { return String::new() };
    let time = metadata.modified().ok().and_then(|time| time.duration_since(UNIX_EPOCH).ok()).unwrap_or_default();
    format!("  {} bytes, {} s, {} ns\n", metadata.len(), time.as_secs(), time.subsec_nanos())
}

/// Library that takes the place of the loader.
fn chosen_library() -> Option<String> {
    std::env::var("COPHASE_OPENCL_LIBRARY").ok().filter(|library| !library.is_empty())
}

/// The drivers for a sentence: `nvidia.icd (libnvidia-opencl.so.1), pocl.icd (libpocl.so.2)`.
pub(super) fn listed() -> String {
    let mut all: Vec<String> = installed()
        .iter()
        .map(|driver| format!("{} ({})", driver.icd.file_name().unwrap_or_default().display(), driver.library))
        .collect();
    all.extend(chosen_library());
    if all.is_empty() { "no driver".into() } else { all.join(", ") }
}

/// Whether a driver or the loader is part of this process already: a host, such as a GPU library of
/// Python's, has it.
pub(super) fn are_loaded() -> bool {
    let maps = std::fs::read_to_string("/proc/self/maps").unwrap_or_default();
    ["libOpenCL", "libcuda.so", "nvidia-opencl", "libamdocl"].iter().any(|library| maps.contains(library))
}

/// Why the drivers that are installed give no device, one reason each; `None` where none is
/// installed. The drivers must have been loaded before, as the loader does.
pub(super) fn why_no_device() -> Option<String> {
    if let Some(library) = chosen_library() {
        let error = load_error(&library).unwrap_or_else(|| "it is loaded and lists no device".into());
        return Some(format!("COPHASE_OPENCL_LIBRARY={library}: {error}"));
    }
    let installed = installed();
    if installed.is_empty() {
        return None;
    }
    let reason = |driver: &Driver| {
        let name = driver.icd.display();
        match load_error(&driver.library) {
            Some(error) => format!("{name}: {error}"),
            None => format!("{name}: {} is loaded and lists no device", driver.library),
        }
    };
    let loader = load_error("libOpenCL.so.1").and_then(|_| load_error("libOpenCL.so"));
    let loader = loader.map(|error| format!("{error} (the loader; Debian and Ubuntu: apt install ocl-icd-libopencl1)"));
    Some(loader.into_iter().chain(installed.iter().map(reason)).collect::<Vec<_>>().join("; "))
}

/// Why a library cannot be loaded.
fn load_error(library: &str) -> Option<String> {
    let name = CString::new(library).ok()?;
    // SAFETY: a NUL-terminated name; the text of dlerror is copied before another call of this
    // thread.
    unsafe {
        let handle = libc::dlopen(name.as_ptr(), libc::RTLD_LAZY | libc::RTLD_LOCAL);
        if !handle.is_null() {
            return None;
        }
        let error = libc::dlerror();
        let text = if error.is_null() { "it cannot be loaded".into() } else { CStr::from_ptr(error).to_string_lossy() };
        Some(text.into_owned())
    }
}
