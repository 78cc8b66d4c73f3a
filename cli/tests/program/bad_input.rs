//! Bad input: one sentence, exit status 1 (2 for bad usage), nothing half-written, no panic.

use crate::{Desk, Done, SMALL};
use std::process::{Command, Stdio};

const ESTIMATE: [&str; 4] = ["estimate", "images.fits", "-o", "est.fits"];

#[test]
fn files_that_are_not_there_or_not_fits() {
    let desk = Desk::with_images(&[]);
    let there = std::fs::read(desk.path("images.fits")).unwrap();
    std::fs::write(desk.path("truncated.fits"), &there[..there.len() / 3]).unwrap();
    std::fs::write(desk.path("empty.fits"), b"").unwrap();
    std::fs::write(desk.path("text.fits"), SMALL).unwrap();
    for (name, reason) in
        [("missing.fits", "no such file"), ("truncated.fits", "bytes"), ("empty.fits", "empty"), ("text.fits", "FITS")]
    {
        desk.refuses(&["estimate", name, "--scene", "scene.toml", "-o", "est.fits"], &[name, reason]);
        desk.refuses(&["compare", name], &[name]);
    }
    desk.refuses(&[&ESTIMATE[..], &["--mask", "missing.fits"]].concat(), &["missing.fits"]);
    desk.refuses(&[&ESTIMATE[..], &["--scene", "missing.toml"]].concat(), &["missing.toml", "keck-artificial"]);
    desk.refuses(&["image", "missing.toml", "-o", "new.fits"], &["missing.toml", "keck-artificial"]);
    desk.refuses(&["scene", "keck"], &["'keck'", "keck-artificial"]);
}

#[test]
fn images_that_hold_no_star() {
    let desk = Desk::with_images(&[]);
    type Edit = fn(f64) -> f64;
    let bad: [(&str, Edit, &str); 5] = [
        ("zero.fits", |_| 0.0, "constant"),
        ("constant.fits", |_| 7.5, "7.5"),
        ("nan.fits", |_| f64::NAN, "no good pixel"),
        ("infinite.fits", |_| f64::INFINITY, "no good pixel"),
        ("negative.fits", |e| -e.abs() - 1.0, "positive"),
    ];
    for (name, edit, reason) in bad {
        desk.edit_images("images.fits", name, |images| images.mapv_inplace(edit));
        let arguments = ["estimate", name, "-o", "est.fits", "--quiet"];
        desk.refuses(&arguments, &[name, reason]);
    }
    // A star darker than its surroundings: pixels of either sign, flux below zero.
    desk.edit_images("images.fits", "dark.fits", |images| images.mapv_inplace(|e| 100.0 - e));
    desk.refuses(&["estimate", "dark.fits", "-o", "est.fits"], &["dark.fits", "flux"]);
    // Noise, whose flux is positive in half of the images.
    for seed in 1..=4 {
        let seed = format!("aberrations.seed={seed}");
        let desk = Desk::with_images(&["image.peak_snr=", "image.flux_e=1", "image.read_noise_e=20", &seed]);
        desk.refuses(&ESTIMATE, &["images.fits", "holds no star"]);
    }
}

#[test]
fn images_and_masks_of_the_wrong_size() {
    let desk = Desk::with_images(&["image.pixels=32"]);
    // A file of another program, whose size no scene explains.
    let images = cophase::io::FitsReader::open(desk.path("images.fits")).unwrap().cube("IMAGES").unwrap();
    let mut plain = cophase::io::FitsWriter::create(desk.path("plain.fits")).unwrap();
    plain.image("IMAGES", &images, cophase::io::Pixel::F32, "electron").unwrap();
    plain.finish().unwrap();
    desk.refuses(
        &["estimate", "plain.fits", "-o", "est.fits", "--scene", "scene.toml"],
        &["plain.fits", "32x32", "64x64", "image.pixels"],
    );
    let mut mask = cophase::io::FitsWriter::create(desk.path("mask.fits")).unwrap();
    mask.image("BADPIX", &ndarray::Array2::<f64>::zeros((16, 16)), cophase::io::Pixel::I32, "").unwrap();
    mask.finish().unwrap();
    desk.refuses(&[&ESTIMATE[..], &["--mask", "mask.fits"]].concat(), &["mask.fits", "16"]);
}

#[test]
fn scenes_that_cannot_be() {
    let desk = Desk::with_scene();
    let scenes = [
        ("[pupil]", "[pupil]\nsegment_gap_m = 2.0", "segment_gap_m = 2"),
        ("[pupil]", "[pupil]\ncentral_obscuration_m = 50.0", "hides the whole pupil"),
        ("rings = 1", "rings = 0\ncentral_segment = false", "pupil.rings = 0"),
        ("rings = 1", "rings = 1\ngrid_m = 1.0", "pupil.grid_m = 1"),
        ("samples = 64", "samples = 63", "even integer"),
        ("wavelength_nm = 2000", "wavelenght_nm = 2000", "did you mean 'wavelength_nm'?"),
        ("wavelength_nm = 2000", "wavelength_nm = -1", "wavelength_nm = -1"),
        ("[modes]", "[mode]", "did you mean 'modes'?"),
        ("ncpa = \"zernike\"", "ncpa = zernike", "not TOML"),
        ("[pupil]", "[estimate]\nmethod = \"full-face\"\n[pupil]", "full-face"),
    ];
    for (from, to, word) in scenes {
        std::fs::write(desk.path("odd.toml"), SMALL.replacen(from, to, 1)).unwrap();
        desk.refuses(&["image", "odd.toml", "-o", "new.fits"], &["odd.toml line ", word]);
    }
    // What no key shows by itself is found when the telescope is built, and so are the files that
    // it needs.
    let shadow = ["image", "scene.toml", "-o", "new.fits", "--set", "pupil.central_obscuration_m=3.0"];
    desk.refuses(&shadow, &["segment 0", "obscuration (3 m)"]);
    let settings = ["--set", "pupil.file=missing-pupil.fits", "--set", "pupil.aperture=", "--set", "pupil.rings="];
    let arguments: Vec<&str> = ["image", "scene.toml", "-o", "new.fits"].into_iter().chain(settings).collect();
    desk.refuses(&[&arguments[..], &["--set", "pupil.grid_m=5"]].concat(), &["missing-pupil.fits"]);
    desk.refuses(&["image", "scene.toml", "-o", "new.fits", "--set", "image.pixel=32"], &["did you mean 'pixels'?"]);
    // A signal-to-noise ratio without noise is that of no flux.
    for verb in ["image", "simulate"] {
        let dark = [
            verb,
            "keck-onsky",
            "-o",
            "new.fits",
            "--set",
            "image.photon_noise=false",
            "--set",
            "image.read_noise_e=0",
        ];
        desk.refuses(&dark, &["image.peak_snr = 500 gives no flux", "image.flux_e"]);
    }
}

#[test]
fn a_sequence_larger_than_any_memory() {
    let desk = Desk::with_scene();
    // 1.3 PB: beyond the address space that an allocator hands out on trust.
    let settings = ["--set", "image.count=1000000", "--set", "image.pixels=8192"];
    let arguments: Vec<&str> = ["image", "scene.toml", "-o", "new.fits"].into_iter().chain(settings).collect();
    desk.refuses(&arguments, &["GiB", "image.count"]);
}

#[test]
fn images_without_a_scene_and_estimates_without_a_truth() {
    let desk = Desk::with_images(&[]);
    let mut bare = cophase::io::FitsWriter::create(desk.path("bare.fits")).unwrap();
    bare.image("IMAGES", &ndarray::Array2::<f64>::ones((64, 64)), cophase::io::Pixel::F32, "").unwrap();
    bare.finish().unwrap();
    desk.refuses(&["estimate", "bare.fits", "-o", "est.fits"], &["bare.fits", "--scene"]);
    desk.succeeds(&ESTIMATE);
    // The truth came along; images alone have none.
    desk.succeeds(&["compare", "est.fits"]);
    let images = cophase::io::read_images(desk.path("images.fits"), None).unwrap();
    let mut alone = cophase::io::FitsWriter::create(desk.path("alone.fits")).unwrap();
    alone.image("IMAGES", &images.data, cophase::io::Pixel::F32, "electron").unwrap();
    alone.finish().unwrap();
    desk.succeeds(&["estimate", "alone.fits", "--scene", "scene.toml", "-o", "blind.fits"]);
    desk.refuses(&["compare", "blind.fits"], &["blind.fits", "--truth"]);
    desk.refuses(&["compare", "est.fits", "--truth", "bare.fits"], &["bare.fits", "TRUTH_PHASING"]);
    desk.refuses(&["compare", "images.fits"], &["images.fits", "PHASING"]);
    // An estimate has a table IMAGES, and is not an image for it.
    for verb in ["estimate", "check"] {
        let output = if verb == "estimate" { &["-o", "again.fits"][..] } else { &[] };
        let words = ["est.fits", "result of an estimate", "no images"];
        desk.refuses(&[&[verb, "est.fits"], output].concat(), &words);
    }
}

#[test]
fn outputs_that_cannot_be_written_are_refused_before_the_work() {
    let desk = Desk::with_images(&[]);
    std::fs::create_dir(desk.path("folder")).unwrap();
    for (output, reason) in [
        ("nowhere/est.fits", "nowhere does not exist"),
        // Not even root may write there.
        ("/sys/est.fits", "/sys cannot be written"),
        ("folder", "directory"),
        ("/dev/full", "device"),
        ("images.fits", "read by this command"),
        ("./folder/../images.fits", "read by this command"),
    ] {
        desk.refuses(&["estimate", "images.fits", "-o", output], &[output, reason]);
        if output != "images.fits" && !output.starts_with("./") {
            desk.refuses(&["image", "scene.toml", "-o", output], &[output, reason]);
        }
    }
    desk.refuses(&["image", "scene.toml", "-o", "scene.toml"], &["read by this command"]);
    desk.refuses(&[&ESTIMATE[..], &["--plot", "est.pdf"]].concat(), &["est.pdf", ".png or .svg"]);
    desk.refuses(&[&ESTIMATE[..], &["--plot", "nowhere/est.png"]].concat(), &["nowhere/est.png", "does not exist"]);
    desk.refuses(&["demo", "-o", "scene.toml"], &["scene.toml"]);
}

/// A full disk, played by a limit on the size of files: a shell sets it and becomes the program.
#[test]
fn a_full_disk_leaves_what_was_there() {
    let desk = Desk::with_images(&[]);
    std::fs::write(desk.path("est.fits"), "what was there").unwrap();
    let before = desk.files();
    for arguments in [&["image", "scene.toml", "-o", "new.fits"][..], &ESTIMATE] {
        let mut shell = Command::new("sh");
        // 8 blocks of 512 or 1024 bytes, as the shell counts: less than either file, more than a
        // line.
        shell.args(["-c", "ulimit -f 8 && exec \"$@\"", "sh", env!("CARGO_BIN_EXE_cophase")]).args(arguments);
        let done = Done::from(shell.current_dir(desk.path("")).output().unwrap());
        done.failed(arguments, &["cannot be written", "no partial file is left"]);
        assert_eq!(desk.files(), before);
    }
    assert_eq!(std::fs::read_to_string(desk.path("est.fits")).unwrap(), "what was there");
}

#[test]
fn unwritable_stdout_is_reported() {
    let desk = Desk::with_scene();
    let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let output = desk.command(&["scene", "--reference"]).stdout(full).stderr(Stdio::piped()).output().unwrap();
    Done::from(output).failed(&["scene", "--reference"], &["stdout", "cannot be written"]);
}

#[test]
fn bad_usage_is_status_2() {
    let desk = Desk::with_images(&[]);
    let before = desk.files();
    for (arguments, word) in [
        (&[][..], "Usage"),
        (&["estimat"], "estimate"),
        (&["estimate", "images.fits"], "--output"),
        (&["estimate", "images.fits", "-o", "e.fits", "--device", "gpu"], "opencl:P:D"),
        (&["estimate", "images.fits", "-o", "e.fits", "--precision", "f16"], "f32"),
        (&["estimate", "images.fits", "-o", "e.fits", "--optimizer", "sgd"], "gauss-newton"),
        (&["estimate", "images.fits", "-o", "e.fits", "--method", "full-face"], "modal"),
        (&["image", "scene.toml", "-o", "e.fits", "--set", "image.pixels"], "section.key=value"),
        (&["image", "scene.toml", "-o", "e.fits", "--seed", "-1"], "-1"),
        (&["image", "scene.toml", "-o", "e.fits", "--seed", "9223372036854775808"], "9223372036854775807"),
        (&["scene", "keck-onsky", "--reference"], "--reference"),
    ] {
        let done = desk.run(arguments);
        assert_eq!((done.status, done.out.as_str()), (2, ""), "{arguments:?}: {}", done.err);
        assert!(done.err.contains(word) && !done.err.contains("panicked"), "{arguments:?}: {}", done.err);
        assert_eq!(desk.files(), before, "{arguments:?}");
    }
}
