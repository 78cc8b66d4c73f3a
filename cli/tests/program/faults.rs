//! Faults of the machine and of ours: a status and a sentence, and every file whole or as it was.
//! Most are made on demand, which only builds with debug assertions can (`COPHASE_FAULT`, see
//! `src/fault.rs`).

use crate::{Desk, Done};
use std::os::unix::process::ExitStatusExt;
use std::process::Command;

const ESTIMATE: [&str; 5] = ["estimate", "images.fits", "-o", "est.fits", "--json"];

fn with_fault(desk: &Desk, fault: &str, arguments: &[&str]) -> Command {
    let mut command = desk.command(arguments);
    command.env("COPHASE_FAULT", fault).env_remove("RUST_BACKTRACE");
    command
}

/// The address of an OpenCL device here, if there is one.
fn opencl() -> Option<String> {
    let first = cophase::device::devices().unwrap_or_default().into_iter().find(|info| info.f64);
    let required = std::env::var("COPHASE_REQUIRE_OPENCL").as_deref() == Ok("1");
    assert!(first.is_some() || !required, "COPHASE_REQUIRE_OPENCL=1, and no OpenCL device was found");
    if first.is_none() {
        println!("skipped: no OpenCL device was found");
    }
    first.map(|info| info.address())
}

#[test]
fn missing_driver_is_accepted_by_auto_and_refused_by_opencl() {
    let desk = Desk::with_images(&[]);
    std::fs::create_dir(desk.path("no-drivers")).unwrap();
    let without = |arguments: &[&str]| {
        let mut command = desk.command(arguments);
        // A loader that reads files finds none; one that is told libraries by name finds none of
        // those either.
        command.env("OCL_ICD_VENDORS", desk.path("no-drivers")).env("OCL_ICD_FILENAMES", "");
        Done::from(command.output().unwrap())
    };
    let done = without(&[&ESTIMATE[..], &["--device", "auto"]].concat());
    assert_eq!(done.status, 0, "{}", done.err);
    assert!(done.out.contains("\"device\": \"cpu\""), "{}", done.out);
    std::fs::remove_file(desk.path("est.fits")).unwrap();
    for device in ["opencl", "opencl:0:0"] {
        let arguments = [&ESTIMATE[..], &["--device", device]].concat();
        without(&arguments).failed(&arguments, &["OpenCL", "CPU chain"]);
    }
    let done = without(&["devices"]);
    assert!(done.status == 0 && done.out.contains("no OpenCL device was found"), "{}", done.out);
    assert!(!desk.files().contains(&"est.fits".to_string()));
}

/// The process dies at three moments of a write. Before the rename what was there is there, with a
/// temporary file beside it that nothing reads; after it the new file is whole.
#[test]
fn killed_writer_leaves_a_complete_file_or_the_old_one() {
    let desk = Desk::with_images(&[]);
    desk.succeeds(&ESTIMATE);
    let whole = std::fs::read(desk.path("est.fits")).unwrap().len();
    for (before, old) in [("absent", None), ("there", Some("what was there"))] {
        for stage in ["1", "2", "3"] {
            let _ = std::fs::remove_file(desk.path("est.fits"));
            if let Some(old) = old {
                std::fs::write(desk.path("est.fits"), old).unwrap();
            }
            let ended = with_fault(&desk, &format!("kill:{stage}"), &ESTIMATE).output().unwrap().status;
            assert_eq!(ended.signal(), Some(libc::SIGKILL), "{before}, stage {stage}");
            match (stage, old) {
                // The times in its cards differ, and nothing else: cards do not move the data.
                ("3", _) => assert_eq!(std::fs::read(desk.path("est.fits")).unwrap().len(), whole),
                (_, Some(old)) => assert_eq!(std::fs::read_to_string(desk.path("est.fits")).unwrap(), old),
                (_, None) => assert!(!desk.path("est.fits").exists(), "stage {stage}"),
            }
            let left = desk.files().into_iter().filter(|name| name.ends_with(".tmp")).collect::<Vec<_>>();
            assert_eq!(left.len(), usize::from(stage != "3"), "{left:?}");
            left.iter().for_each(|name| std::fs::remove_file(desk.path(name)).unwrap());
        }
    }
    // What a killed process leaves beside the target hinders no other.
    with_fault(&desk, "kill:1", &ESTIMATE).output().unwrap();
    desk.succeeds(&ESTIMATE);
    desk.json(&["compare", "est.fits", "--json"]);
}

#[test]
fn panicking_thread_is_a_status_and_a_message() {
    let desk = Desk::with_images(&["image.count=3"]);
    std::fs::write(desk.path("est.fits"), "what was there").unwrap();
    let before = desk.files();
    let done = Done::from(with_fault(&desk, "worker", &ESTIMATE).output().unwrap());
    assert_eq!((done.status, done.out.as_str()), (1, ""), "{}", done.err);
    assert_eq!(done.err.lines().count(), 1, "{}", done.err);
    for word in ["internal error", "thread of the pool", "src/fault.rs"] {
        assert!(done.err.contains(word), "{}", done.err);
    }
    assert_eq!(desk.files(), before);
    assert_eq!(std::fs::read_to_string(desk.path("est.fits")).unwrap(), "what was there");
    // Who wants to see where it came from still does.
    let traced = with_fault(&desk, "worker", &ESTIMATE).env("RUST_BACKTRACE", "1").output().unwrap();
    assert!(String::from_utf8_lossy(&traced.stderr).contains("stack backtrace"));
}

#[test]
fn a_device_that_was_named_and_fails_is_a_status() {
    let Some(device) = opencl() else { return };
    let desk = Desk::with_images(&["image.count=3"]);
    let arguments = [&ESTIMATE[..], &["--device", &device]].concat();
    let before = desk.files();
    // While the chain is made, while images are brought, and between evaluations.
    for fault in ["device:1", "device:40", "device:90", "lost:1", "lost:60", "lost:120"] {
        let done = Done::from(with_fault(&desk, fault, &arguments).output().unwrap());
        done.failed(&arguments, &["OpenCL failed", "COPHASE_FAULT, command"]);
        assert_eq!(desk.files(), before, "{fault}");
    }
    // `auto` takes a GPU alone, and says where it does not end on it.
    let gpu = cophase::device::devices().unwrap().iter().any(|info| info.kind == cophase::device::DeviceKind::Gpu);
    for fault in ["device:1", "lost:60", "lost:120"] {
        let arguments = [&ESTIMATE[..], &["--device", "auto"]].concat();
        let done = Done::from(with_fault(&desk, fault, &arguments).output().unwrap());
        assert!(done.status == 0 && done.out.contains("\"device\": \"cpu\""), "{fault}: {}", done.err);
        let said = done.err.contains("the CPU has taken its place");
        assert_eq!(said, gpu && fault.starts_with("lost"), "{fault}: {}", done.err);
    }
}

/// PoCL shows its cores as two devices of one kind. Where another driver has devices, too, they are
/// others.
#[test]
fn several_devices_make_the_bits_of_one_or_a_status() {
    let Some(first) = opencl() else { return };
    let desk = Desk::with_images(&["image.count=9"]);
    let estimate = |device: &str, fault: &str, more: &[&str]| {
        let arguments = [&ESTIMATE[..], &["--device", device], more].concat();
        Done::from(with_fault(&desk, fault, &arguments).env("POCL_DEVICES", "pthread pthread").output().unwrap())
    };
    let coefficients = |done: Done| {
        assert_eq!(done.status, 0, "{}", done.err);
        let json: serde_json::Value = serde_json::from_str(&done.out).unwrap();
        let mut file = cophase::io::FitsReader::open(desk.path("est.fits")).unwrap();
        let nm = file.map(Some("COEFFICIENTS")).unwrap();
        (json["device"].as_str().unwrap().to_owned(), nm.mapv(f64::to_bits))
    };
    let (one, alone) = coefficients(estimate(&first, "", &[]));
    let (all, shared) = coefficients(estimate("all", "", &[]));
    println!("{one} and {all}");
    let devices = cophase::device::devices().unwrap();
    if devices.iter().all(|info| info.platform_name.contains("Portable Computing Language")) {
        assert_eq!(all.matches("opencl:").count(), 2, "{all}");
        assert_eq!(alone, shared);
    }
    let before = desk.files();
    // While the chains are made, and in the midst of the fits.
    for (fault, words) in [("lost:1", "no device can run"), ("lost:120", "all devices have failed")] {
        let done = estimate("all", fault, &[]);
        assert!(done.status == 1 && done.err.contains(words), "{fault}: {}", done.err);
    }
    let done = estimate("all", "", &["--method", "full-phase"]);
    assert!(done.status == 1 && done.err.contains("runs on one device"), "{}", done.err);
    assert_eq!(desk.files(), before);
}

/// Programs are compiled by the driver, and kept by it from one process to the next. Two processes
/// that begin on one empty cache do not disturb each other.
#[test]
fn two_processes_share_one_cache_of_compiled_programs() {
    let Some(device) = opencl() else { return };
    let desk = Desk::with_images(&[]);
    let cache = desk.path("cache");
    std::fs::create_dir(&cache).unwrap();
    let start = |output: &str| {
        let mut command = desk.command(&["estimate", "images.fits", "-o", output, "--json", "--device", &device]);
        command.env("POCL_CACHE_DIR", &cache).stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::piped());
        command.spawn().unwrap()
    };
    let both = [start("one.fits"), start("two.fits")];
    for child in both {
        let done = Done::from(child.wait_with_output().unwrap());
        assert_eq!(done.status, 0, "{}", done.err);
    }
    let maps = ["one.fits", "two.fits"].map(|name| cophase::io::read_map(desk.path(name), Some("PHASING")).unwrap());
    // The same bits: NaN outside the pupil is no number.
    assert!(maps[0].iter().zip(&maps[1]).all(|(one, two)| one.to_bits() == two.to_bits()));
}

/// Across the C boundary such a panic is a status too: of the call, and of every later one on the
/// same object. The fault is asked for in a process of its own (this test again, with the variable
/// set).
#[test]
fn a_thread_that_panics_is_a_status_of_the_c_call() {
    use cophase::capi::*;
    use std::ptr::{null, null_mut};
    if std::env::var_os("COPHASE_FAULT").is_none() {
        let name = "faults::a_thread_that_panics_is_a_status_of_the_c_call";
        let mut child = Command::new(std::env::current_exe().unwrap());
        let output = child.args([name, "--exact"]).env("COPHASE_FAULT", "worker").output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
        return;
    }
    let scene = std::ffi::CString::new(crate::SMALL).unwrap();
    let frames =
        vec![100.0; 2 * 64 * 64].into_iter().enumerate().map(|(i, e)| e + (i % 97) as f64).collect::<Vec<f64>>();
    let array = cophase_input {
        data: frames.as_ptr().cast(),
        element: COPHASE_F64,
        count: 2,
        rows: 64,
        cols: 64,
        count_stride: 64 * 64,
        row_stride: 64,
        col_stride: 1,
    };
    let (mut model, mut session) = (null_mut(), null_mut());
    // SAFETY: live locals, of which zeros are values; handles that the calls made, and an array
    // that is there.
    unsafe {
        let mut info = std::mem::zeroed::<cophase_model_info>();
        let mut options = std::mem::zeroed::<cophase_session_options>();
        (options.struct_size, options.capacity, options.threads) = (size_of_val(&options), 2, -1);
        assert_eq!(cophase_model_create(scene.as_ptr(), null(), null(), &mut model), COPHASE_OK);
        assert_eq!(cophase_model_get_info(model, &mut info, size_of_val(&info)), COPHASE_OK);
        assert_eq!(cophase_session_create(model, &options, &mut session), COPHASE_OK);
        let modes = info.modes;
        let mut coefficients_nm = vec![7.0; 2 * modes];
        for _ in 0..2 {
            let out = coefficients_nm.as_mut_ptr();
            let (sigma, images, groups) = (null_mut(), null_mut(), null_mut());
            let status = cophase_session_fit(session, &array, 1, null(), out, sigma, modes, images, 0, groups, 0);
            assert_eq!(status, COPHASE_PANIC);
        }
        assert!(coefficients_nm.iter().all(|&nm| nm == 7.0));
        cophase_session_destroy(session);
        // The model was only read, and makes sessions as before.
        assert_eq!(cophase_session_create(model, &options, &mut session), COPHASE_OK);
        cophase_session_destroy(session);
        cophase_model_destroy(model);
    }
}
