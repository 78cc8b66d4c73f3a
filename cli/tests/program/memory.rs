//! Memory: work that the machine cannot hold is refused with the key and both figures, and what
//! runs out is said.

use crate::{Desk, Done};
use std::process::Command;

/// Runs the program with an address space of `kib` KiB, as `ulimit -v` sets it, and 16 threads.
fn limited(desk: &Desk, kib: u64, arguments: &[&str]) -> Done {
    let mut shell = Command::new("sh");
    let script = format!("ulimit -v {kib} && exec \"$@\"");
    shell.args(["-c", &script, "sh", env!("CARGO_BIN_EXE_cophase")]).args(arguments);
    Done::from(shell.env("RAYON_NUM_THREADS", "16").current_dir(desk.path("")).output().unwrap())
}

#[test]
fn a_scene_beyond_the_memory_is_refused_with_its_key() {
    let desk = Desk::with_scene();
    let before = desk.files();
    let arguments = ["image", "scene.toml", "-o", "new.fits", "--set", "aberrations.truth_samples=16384"];
    let done = limited(&desk, 4_000_000, &arguments);
    done.failed(&arguments, &["aberrations.truth_samples = 16384", "30.0 GiB", "ulimit -v", "leaves 3."]);
    assert_eq!(desk.files(), before);
}

#[test]
fn an_ao_system_beyond_the_memory_is_refused_before_it_is_built() {
    let desk = Desk::with_scene();
    let grid = ["wavefront_sensor.lenslets_across=256", "wavefront_sensor.samples_per_lenslet=64"];
    let mirror = [
        "wavefront_sensor.lenslets_across=100",
        "wavefront_sensor.samples_per_lenslet=2",
        "mirror.actuators_across=101",
        "mirror.pitch_m=0.1095",
    ];
    for (settings, facts) in [(&grid[..], ["16384x16384 samples", "65.5 GiB"]), (&mirror[..], ["slopes", "would take"])]
    {
        let mut arguments = vec!["simulate", "keck-onsky", "-o", "new.fits"];
        arguments.extend(settings.iter().flat_map(|setting| ["--set", setting]));
        limited(&desk, 4_000_000, &arguments)
            .failed(&arguments, &[&facts[..], &["ulimit -v", "wavefront_sensor."]].concat());
    }
}

#[test]
fn karhunen_loeve_modes_beyond_the_memory_are_refused() {
    let desk = Desk::with_images(&[]);
    let set = ["modes.ncpa=kl", "mirror.pitch_m=0.05", "mirror.actuators_across=100"];
    let mut arguments = vec!["estimate", "images.fits", "-o", "est.fits"];
    arguments.extend(set.iter().flat_map(|setting| ["--set", setting]));
    let words = ["the Karhunen-Loève modes of", "actuators at", "mirror.pitch_m"];
    limited(&desk, 4_000_000, &arguments).failed(&arguments, &words);
}

/// At each limit the result is an estimate or one sentence, and never a signal. The loader itself
/// needs some 200 MB of addresses in a build with debugging information.
#[test]
fn estimate_out_of_memory_is_reported() {
    let desk = Desk::with_images(&["pupil.samples=128", "image.pixels=256"]);
    let arguments = ["estimate", "images.fits", "-o", "est.fits", "--device", "cpu", "--quiet"];
    let mut refused = 0;
    for mib in [256, 288, 320, 400, 600, 1000] {
        let done = limited(&desk, mib << 10, &arguments);
        if done.status != 0 {
            done.failed(&arguments, &["memory"]);
            refused += 1;
        }
        assert!(!desk.files().iter().any(|name| name.ends_with(".tmp")), "{mib} MiB");
    }
    assert!((1..6).contains(&refused), "{refused} of 6 were refused");
}

#[test]
fn a_scene_is_a_file_or_a_pipe_of_a_sane_size() {
    let desk = Desk::with_scene();
    for device in ["/dev/zero", "/dev/null", "."] {
        desk.refuses(&["image", device, "-o", "new.fits"], &[device, "regular file or a pipe"]);
    }
    std::fs::write(desk.path("long.toml"), " ".repeat((1 << 20) + 1)).unwrap();
    desk.refuses(&["image", "long.toml", "-o", "new.fits"], &["long.toml", "1048576"]);
    let arguments = ["image", "-", "-o", "new.fits"];
    let mut endless = Command::new("sh");
    endless.args(["-c", "cat /dev/zero | \"$@\"", "sh", env!("CARGO_BIN_EXE_cophase")]).args(arguments);
    Done::from(endless.current_dir(desk.path("")).output().unwrap()).failed(&arguments, &["1048576"]);
}
