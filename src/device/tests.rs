//! Tests of the device module. Those that need OpenCL are skipped where there is none; with
//! `COPHASE_REQUIRE_OPENCL=1` they fail instead.
//!
//! `scripts/check-kernels` checks the kernels for data races and out-of-bounds accesses.

use super::table::TABLE;
use super::*;

/// The devices to test on; empty where there are none and OpenCL is not required.
pub(crate) fn test_devices() -> Vec<DeviceInfo> {
    let present = devices().expect("OpenCL lists its devices");
    if present.is_empty() {
        assert!(
            std::env::var("COPHASE_REQUIRE_OPENCL").as_deref() != Ok("1"),
            "COPHASE_REQUIRE_OPENCL=1, and no OpenCL device was found"
        );
        println!("skipped: no OpenCL device was found");
    }
    present
}

#[test]
fn every_kernel_compiles_at_every_precision_and_width() {
    for info in test_devices() {
        let device = Device::open(&info, false).unwrap();
        for precision in [Precision::F32, Precision::F64] {
            if !info.supports(precision) {
                println!("{info} has no {precision}");
                continue;
            }
            for vector in [1, 4, 8, 16] {
                // A GPU build does not use the FFT.
                let fft = FftPlan::new(240, 60).filter(|_| vector > 1);
                for entry in TABLE.iter().filter(|f| f.file != "fft.cl" || fft.is_some()).flat_map(|f| f.entries) {
                    let kernel = device.kernel(entry.name, Build { precision, vector, fft }).unwrap();
                    assert!(!kernel.arguments().is_empty(), "{} keeps the names of its arguments", entry.name);
                }
            }
        }
    }
}

/// Tests the arithmetic of the rates only: the speed of the machine is not tested.
#[test]
fn a_measured_peak_is_a_number() {
    for info in test_devices() {
        let device = Device::open(&info, false).unwrap();
        let peak = Peak::measure(&device, Precision::F32).unwrap();
        println!("{info}: {peak:?}");
        assert!([peak.gflops, peak.gflops_unit, peak.gbytes_s].iter().all(|rate| rate.is_finite() && *rate > 0.0));
        // 2 operations at 1e9 of them a second take 2e-3 us; of two floors the higher one holds.
        let peak = Peak { gflops: 1.0, gflops_unit: 1.0, gbytes_s: 10.0 };
        assert_eq!(peak.floor_us(2.0, 10.0), 2e-3);
        assert_eq!(peak.floor_us(2.0, 40.0), 4e-3);
    }
}

#[test]
fn every_cl_file_is_in_the_table() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/kernels");
    let mut found: Vec<String> = std::fs::read_dir(folder)
        .unwrap()
        .map(|file| file.unwrap().file_name().into_string().unwrap())
        .filter(|name| name.ends_with(".cl") && name != "common.cl")
        .collect();
    let mut listed: Vec<String> = TABLE.iter().map(|family| family.file.to_string()).collect();
    found.sort();
    listed.sort();
    assert_eq!(found, listed);
}

#[test]
fn every_kernel_of_a_file_is_in_its_row() {
    for family in TABLE {
        let declared = family.source.matches("__kernel void ").count();
        assert_eq!(declared, family.entries.len(), "{} declares {declared} kernels", family.file);
        for entry in family.entries {
            assert!(family.source.contains(&format!("__kernel void {}(", entry.name)), "{}", entry.name);
        }
    }
}

#[test]
fn buffers_are_written_and_read_back() {
    for info in test_devices() {
        let device = Device::open(&info, false).unwrap();
        let mut buffer = device.buffer::<f32>(5).unwrap();
        buffer.write(2, &[1.5, -2.5]).unwrap();
        let mut back = [9.0f32; 5];
        buffer.read(0, &mut back).unwrap();
        assert_eq!(back, [0.0, 0.0, 1.5, -2.5, 0.0]);
        assert!(buffer.write(4, &[0.0, 0.0]).is_err());
        assert!(buffer.read(1, &mut back).is_err());
    }
}

#[test]
fn a_buffer_beyond_the_device_is_refused_with_its_size() {
    for info in test_devices() {
        let device = Device::open(&info, false).unwrap();
        let numbers = info.max_buffer_bytes as usize / 4 + 1;
        let message = device.buffer::<f32>(numbers).err().unwrap().to_string();
        assert!(message.contains(&(4 * numbers).to_string()), "{message}");
    }
}

#[test]
fn an_unknown_name_is_an_error() {
    for info in test_devices() {
        let device = Device::open(&info, false).unwrap();
        let build = Build::for_device(&info, Precision::F32);
        assert!(device.kernel("no_such_kernel", build).is_err());
        let mut kernel = device.kernel("photometry_solve", build).unwrap();
        assert!(kernel.int("no_such_argument", 1).is_err());
        assert!(kernel.int("partials", usize::MAX).is_err());
    }
}

#[test]
fn a_failed_call_is_named_with_its_status_in_one_line() {
    for info in test_devices() {
        let (platform, id) = discover::resolve(&info).unwrap();
        let properties = ocl::core::ContextProperties::new().platform(platform);
        let context = ocl::core::create_context(Some(&properties), &[id], None, None).unwrap();
        // SAFETY: there is no host pointer, and a buffer of no bytes is refused.
        let buffer = unsafe { ocl::core::create_buffer::<_, f32>(&context, ocl::core::MemFlags::READ_WRITE, 0, None) };
        let message = discover::failed(buffer.expect_err("must be refused")).to_string();
        assert!(message.contains("CL_INVALID_BUFFER_SIZE") && message.contains("clCreateBuffer"), "{message}");
        assert_eq!(message.lines().count(), 1, "{message}");
    }
}

/// OpenCL has no vector of five numbers, so the vector type of the kernels does not exist.
#[test]
fn invalid_kernels_are_refused_with_the_compilers_message() {
    for info in test_devices() {
        let device = Device::open(&info, false).unwrap();
        let build = Build { precision: Precision::F32, vector: 5, fft: None };
        for _ in 0..2 {
            let message = device.kernel("smooth_phase", build).err().expect("must be refused").to_string();
            assert!(message.contains("cannot compile the kernels (") && message.contains("error"), "{message}");
            assert_eq!(message.lines().count(), 1, "{message}");
        }
        // The device remains usable.
        assert!(device.kernel("smooth_phase", Build { vector: 4, ..build }).is_ok());
    }
}

#[test]
fn the_excerpt_of_a_log_starts_at_its_first_error() {
    let warnings = (0..40).map(|i| format!("a.cl:{i}: warning: unused\n\n")).collect::<String>();
    let errors = (0..30).map(|i| format!("  a.cl:{i}: error: number {i}\n")).collect::<String>();
    let quoted = session::excerpt(&format!("{warnings}{errors}"));
    assert!(quoted.starts_with("a.cl:0: error: number 0 | a.cl:1: error"), "{quoted}");
    assert!(quoted.ends_with("number 11"), "{quoted}");
    assert!(session::excerpt(&warnings).ends_with("a.cl:39: warning: unused"));
    assert_eq!(session::excerpt(""), "");
}

/// Run by the next test in a process of its own, because the loader opens the library once per
/// process. Several threads call at once: PoCL crashes if its first two calls overlap.
#[test]
fn devices_are_counted() {
    let counts = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..4).map(|_| scope.spawn(|| devices().unwrap().len())).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect::<Vec<_>>()
    });
    assert!(counts.iter().all(|count| *count == counts[0]), "{counts:?}");
    println!("devices: {}", counts[0]);
}

#[test]
fn without_a_library_there_are_no_devices() {
    let count = |library: &str| {
        let output = std::process::Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "device::tests::devices_are_counted", "--nocapture"])
            .env("COPHASE_OPENCL_LIBRARY", library)
            .output()
            .unwrap();
        String::from_utf8_lossy(&output.stdout).to_string()
    };
    let counted = count("/nonexistent/libOpenCL.so.1");
    assert!(counted.contains("devices: 0"), "{counted}");
    // A library without any OpenCL symbol.
    let counted = count("libm.so.6");
    assert!(counted.contains("devices: 0"), "{counted}");
}

/// Run by the next test in processes of its own: one small launch on every device of PoCL.
#[test]
fn a_kernel_runs() {
    for info in test_devices().into_iter().filter(|info| info.platform_name == POCL) {
        let device = Device::open(&info, false).unwrap();
        let out = device.buffer::<f32>(1).unwrap();
        let mut kernel = device.kernel("peak_flops", Build::for_device(&info, Precision::F32)).unwrap();
        kernel.buffer("out", &out).unwrap().int("count", 1).unwrap();
        kernel.real("scale", 0.5).unwrap().real("offset", 0.25).unwrap();
        kernel.launch([1, 1, 1]).unwrap();
        device.finish().unwrap();
    }
}

const POCL: &str = "Portable Computing Language";

/// Drivers cache compiled programs from one process to the next, keyed by source, options, device
/// and driver version. This test inspects the cache of PoCL; NVIDIA and Intel do the same. A second
/// cache of our own would only become stale.
#[test]
fn a_second_process_finds_the_programs_compiled() {
    if !test_devices().iter().any(|info| info.platform_name == POCL) {
        println!("skipped: PoCL is not installed");
        return;
    }
    let cache = tempfile::tempdir().unwrap();
    let run = || {
        let output = std::process::Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "device::tests::a_kernel_runs"])
            .env("POCL_CACHE_DIR", cache.path())
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
        let mut libraries = Vec::new();
        let mut folders = vec![cache.path().to_path_buf()];
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    folders.push(path);
                } else if path.extension().is_some_and(|extension| extension == "so") {
                    let written = path.metadata().unwrap().modified().unwrap();
                    libraries.push((path, written));
                }
            }
        }
        libraries.sort();
        libraries
    };
    let first = run();
    assert!(!first.is_empty(), "PoCL left no compiled kernel in its cache");
    assert_eq!(first, run(), "the second process compiled again");
}
