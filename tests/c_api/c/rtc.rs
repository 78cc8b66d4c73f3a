//! The example of a real-time controller does its work: every frame is estimated or counted as
//! dropped, whatever the rate.

use super::{command, compile, here, root, succeeded};
use cophase::scene::Scene;
use cophase::source;
use std::path::{Path, PathBuf};

/// Written as the program writes them, so that the example's reader of FITS is tried on what users
/// have.
fn images(directory: &Path) -> PathBuf {
    let images = directory.join("images.fits");
    let settings = [("image.count", "5"), ("image.peak_snr", "300"), ("aberrations.segment_piston_rms_nm", "50")];
    let scene = Scene::from_file(here().join("tiny.toml")).unwrap().with(&settings).unwrap();
    source::write(&images, &scene, scene.text(), &source::simulate(&scene).unwrap()).unwrap();
    images
}

/// The pixels of the only image in a FITS file that the program wrote, as native floats.
fn native_floats(images: &Path) -> Vec<u8> {
    let cube = cophase::io::read_images(images, None).unwrap().data;
    cube.iter().flat_map(|&value| (value as f32).to_ne_bytes()).collect()
}

/// What the controller prints about frames and latency.
struct Printed {
    text: String,
    frames: [usize; 5],
}

fn run(program: &Path, arguments: &[&str], frames: &str) -> Printed {
    let scene = here().join("tiny.toml");
    let output = succeeded(command(program).args(arguments).arg(scene).arg(frames));
    let text = String::from_utf8(output.stdout).unwrap();
    let line = text.lines().find(|line| line.contains(" frames: ")).expect("the line of counts").to_string();
    let numbers: Vec<usize> = line.split([' ', ':']).filter_map(|word| word.parse().ok()).collect();
    Printed { frames: numbers.try_into().unwrap(), text }
}

impl Printed {
    /// "N of N images: phasing P +- p nm, NCPA …", the last: P.
    fn phasing_nm(&self) -> f64 {
        let line = self.text.lines().rev().find(|line| line.contains("phasing")).expect("the line of the estimate");
        line.split_whitespace().skip_while(|word| *word != "phasing").nth(1).unwrap().parse().unwrap()
    }
}

#[test]
fn every_frame_is_estimated_or_counted() {
    let directory = tempfile::tempdir().unwrap();
    let program = compile("-std=c11", &root().join("bindings/c/rtc.c"), directory.path());
    let images = images(directory.path());
    let fits = images.to_str().unwrap();
    // Far more than can be estimated: the camera goes on, and what finds no room is dropped.
    let flooded = run(&program, &["-r", "1e9", "-n", "2000"], fits);
    let [count, estimated, dropped, late, skipped] = flooded.frames;
    assert_eq!((count, estimated + dropped, late), (2000, 2000, 0), "{}", flooded.text);
    assert!(skipped < estimated, "{}", flooded.text);
    assert!(estimated >= 1 && dropped >= 1, "{}", flooded.text);
    // 50 nm were asked for; seven pistons drawn at random have 44 of them.
    assert!((35.0..55.0).contains(&flooded.phasing_nm()), "{}", flooded.text);
    for word in ["p50", "p99", "max"] {
        assert!(flooded.text.contains(word), "{}", flooded.text);
    }
    // Time is up before the first evaluation of any frame.
    let [count, estimated, dropped, late, _] = run(&program, &["-r", "1e9", "-n", "50", "-t", "1e-6"], fits).frames;
    assert_eq!((count, estimated + dropped, late), (50, 50, estimated));
}

/// Where Linux keeps POSIX shared memory.
#[cfg(target_os = "linux")]
#[test]
fn shared_memory_is_read_too() {
    let directory = tempfile::tempdir().unwrap();
    let program = compile("-std=c11", &root().join("bindings/c/rtc.c"), directory.path());
    let memory = tempfile::Builder::new().prefix("cophase-rtc-").tempfile_in("/dev/shm").unwrap();
    let images = images(directory.path());
    std::fs::write(memory.path(), native_floats(&images)).unwrap();
    let name = format!("shm:/{}", memory.path().file_name().unwrap().to_str().unwrap());
    // As many frames as may wait: none is dropped, so that both runs estimate the same ones.
    let [shared, file] = [name.as_str(), images.to_str().unwrap()].map(|frames| {
        let printed = run(&program, &["-r", "1e9", "-n", "4"], frames);
        assert_eq!(printed.frames, [4, 4, 0, 0, 0], "{}", printed.text);
        printed.phasing_nm()
    });
    assert_eq!(shared, file);
}
