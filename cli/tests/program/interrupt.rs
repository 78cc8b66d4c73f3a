//! Ctrl-C: the program stops soon, says so in one line and leaves no file.

use crate::{Desk, Done, SMALL};
use cophase::io::{FitsReader, FitsWriter, Pixel};
use ndarray::{Axis, concatenate};
use std::fs::File;
use std::io::Write;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

/// Time from the scene to the signal in which the program reads the scene, or builds the model and
/// begins to retrieve.
const MOMENT: Duration = Duration::from_millis(300);
/// Longest time from the signal to the end: on two cores under five times their load it takes 0.5
/// to 2 s. The work itself would take minutes.
const PROMPT: Duration = Duration::from_secs(10);

impl Desk {
    /// Starts an estimate of `images` whose scene comes through a pipe, and gives the open pipe:
    /// the program catches signals before it reads the scene.
    fn waiting_for_its_scene(&self, images: &str, options: &[&str]) -> (Child, File) {
        self.waiting(images, options, "")
    }

    /// As [`Desk::waiting_for_its_scene`], with `threads` as the number of threads in the
    /// environment, where it is not empty.
    fn waiting(&self, images: &str, options: &[&str], threads: &str) -> (Child, File) {
        let pipe = self.path("pipe.toml");
        let name = std::ffi::CString::new(pipe.to_str().unwrap()).unwrap();
        // SAFETY: a plain system call on a NUL-terminated name.
        assert_eq!(unsafe { libc::mkfifo(name.as_ptr(), 0o600) }, 0);
        let fixed = ["estimate", images, "-o", "est.fits", "--scene", "pipe.toml"];
        let mut command = self.command(&[&fixed, options].concat());
        if !threads.is_empty() {
            command.env("RAYON_NUM_THREADS", threads);
        }
        let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        // Opens once the program has it open for reading.
        let scene = std::fs::OpenOptions::new().write(true).open(&pipe).unwrap();
        std::fs::remove_file(pipe).unwrap();
        (child, scene)
    }
}

/// Presses Ctrl-C.
fn interrupt(child: &Child) {
    // SAFETY: a plain system call; the child is not yet waited for, so the number is its own.
    assert_eq!(unsafe { libc::kill(child.id() as i32, libc::SIGINT) }, 0);
}

/// That the program ends by the signal, with one line; gives the line.
fn was_stopped(child: Child) -> String {
    let done = Done::from(child.wait_with_output().unwrap());
    assert_eq!((done.status, done.out.as_str()), (130, ""), "{}", done.err);
    assert_eq!(done.err.lines().count(), 1, "{}", done.err);
    assert!(done.err.starts_with("cophase: stopped: "), "{}", done.err);
    done.err
}

/// The program waits for its scene from a pipe: by then it catches signals, and nothing depends on
/// how fast it is.
#[test]
fn ctrl_c_stops_and_leaves_nothing() {
    let desk = Desk::with_images(&[]);
    let before = desk.files();
    let (child, mut scene) = desk.waiting_for_its_scene("images.fits", &[]);
    interrupt(&child);
    // The handler's thread takes its turn well within this, and the model takes another 10 ms.
    std::thread::sleep(MOMENT);
    scene.write_all(SMALL.as_bytes()).unwrap();
    drop(scene);
    was_stopped(child);
    assert_eq!(desk.files(), before);
}

/// A read that looks at no flag: the scene is never written. Of a hundred thousand threads that are
/// asked for a few are started.
#[test]
fn sigterm_ends_work_that_reaches_no_safe_place() {
    let desk = Desk::with_images(&[]);
    let before = desk.files();
    let (child, scene) = desk.waiting("images.fits", &[], "100000");
    let threads = std::fs::read_dir(format!("/proc/{}/task", child.id())).map_or(0, Iterator::count);
    // Those that are accepted, and those that wait for signals.
    assert!(threads <= cophase::machine::most_threads() + 8, "{threads} threads");
    // SAFETY: a plain system call; the child is not yet waited for, so the number is its own.
    assert_eq!(unsafe { libc::kill(child.id() as i32, libc::SIGTERM) }, 0);
    let err = was_stopped(child);
    assert!(err.contains("1.5 s") && err.contains("not complete"), "{err}");
    drop(scene);
    assert_eq!(desk.files(), before);
}

#[test]
fn ctrl_c_stops_the_retrieval_of_wavefronts() {
    let desk = Desk::with_scene();
    let sky = include_str!("../../../tests/c_api/sky.toml");
    std::fs::write(desk.path("sky.toml"), sky).unwrap();
    desk.succeeds(&["simulate", "sky.toml", "-o", "sky.fits"]);
    // The four images over and over: the work of a long sequence.
    let four = FitsReader::open(desk.path("sky.fits")).unwrap().cube("IMAGES").unwrap();
    let many = concatenate(Axis(0), &[four.view(); 100]).unwrap();
    let mut file = FitsWriter::create(desk.path("many.fits")).unwrap();
    file.image("IMAGES", &many, Pixel::F32, "electron").unwrap();
    file.finish().unwrap();
    let before = desk.files();
    let (child, mut scene) = desk.waiting_for_its_scene("many.fits", &["--method", "full-phase", "--device", "cpu"]);
    scene.write_all(sky.as_bytes()).unwrap();
    drop(scene);
    std::thread::sleep(MOMENT);
    let pressed = Instant::now();
    interrupt(&child);
    // Work that were over by then would give the status 0.
    let err = was_stopped(child);
    println!("{:.2} s after the signal: {err}", pressed.elapsed().as_secs_f64());
    assert!(pressed.elapsed() < PROMPT, "{:?}", pressed.elapsed());
    assert_eq!(desk.files(), before);
}
