//! Outputs that would destroy something are refused before the work; compressed outputs; images
//! from standard input.

use crate::{Desk, Done};
use cophase::io::FitsReader;
use std::os::unix::fs::PermissionsExt;
use std::process::Stdio;

#[test]
fn two_outputs_of_one_name_are_refused_with_both_flags() {
    let desk = Desk::with_images(&[]);
    std::os::unix::fs::symlink(desk.path("link.png"), desk.path("twin.png")).unwrap();
    for (flags, words) in [
        (["-o", "est.fits", "--commands", "est.fits"], ["-o", "--commands"]),
        (["-o", "est.fits", "--commands", "./est.fits"], ["-o", "--commands"]),
        (["-o", "est.png", "--plot", "est.png"], ["-o", "--plot"]),
        (["--commands", "a.png", "--plot", "./a.png"], ["--commands", "--plot"]),
    ] {
        let also: &[&str] = if flags.contains(&"-o") { &[] } else { &["-o", "est.fits"] };
        let arguments = [&["estimate", "images.fits", "--method", "full-phase"], also, &flags].concat();
        desk.refuses(&arguments, &words);
    }
}

#[test]
fn an_output_that_is_an_input_is_refused() {
    let desk = Desk::with_images(&[]);
    let estimate = ["estimate", "images.fits", "-o", "est.fits"];
    desk.refuses(&[&estimate[..], &["--plot", "./images.fits"]].concat(), &[".png or .svg"]);
    desk.refuses(&["estimate", "images.fits", "-o", "images.fits"], &["images.fits", "-o", "the images"]);
    desk.refuses(
        &["estimate", "images.fits", "--scene", "scene.toml", "-o", "scene.toml"],
        &["scene.toml", "read by this command", "--scene"],
    );
    desk.refuses(&["plan", "scene.toml", "--budget-nm", "5", "-o", "scene.toml"], &["read by this command"]);
    desk.refuses(&["estimate", "images.fits[IMAGES]", "-o", "images.fits"], &["images.fits", "read by this command"]);
    desk.succeeds(&["estimate", "images.fits[IMAGES]", "-o", "est.fits"]);
    desk.succeeds(&["estimate", "images.fits[1]", "-o", "est.fits"]);
    desk.refuses(&["estimate", "images.fits[TRUTH]", "-o", "other.fits"], &["images.fits[TRUTH]", "no image"]);
    // A file that the scene names is read, too.
    desk.refuses(
        &[
            "image",
            "scene.toml",
            "-o",
            "images.fits",
            "--set",
            "image.diversity_file=images.fits",
            "--set",
            "image.diversity_focus_waves_rms=",
        ],
        &["images.fits", "read by this command", "image.diversity_file"],
    );
}

#[test]
fn a_name_ending_in_gz_is_a_gzip_file() {
    let desk = Desk::with_scene();
    desk.succeeds(&["image", "scene.toml", "-o", "images.fits.gz"]);
    desk.succeeds(&["estimate", "images.fits.gz", "-o", "est.fits.GZ"]);
    for name in ["images.fits.gz", "est.fits.GZ"] {
        assert_eq!(std::fs::read(desk.path(name)).unwrap()[..2], [0x1f, 0x8b], "{name}");
    }
    desk.json(&["compare", "est.fits.GZ", "--truth", "images.fits.gz", "--json"]);
    desk.refuses(&["image", "scene.toml", "-o", "images.fits.fz"], &["images.fits.fz", ".fits.gz"]);
}

#[test]
fn a_read_only_file_is_not_replaced() {
    let desk = Desk::with_images(&[]);
    for name in ["est.fits", "est.png", "plan.toml"] {
        std::fs::write(desk.path(name), "precious").unwrap();
        std::fs::set_permissions(desk.path(name), std::fs::Permissions::from_mode(0o444)).unwrap();
    }
    desk.refuses(&["estimate", "images.fits", "-o", "est.fits"], &["est.fits", "read-only", "0444"]);
    desk.refuses(&["estimate", "images.fits", "-o", "new.fits", "--plot", "est.png"], &["est.png", "read-only"]);
    desk.refuses(&["plan", "scene.toml", "--budget-nm", "5", "-o", "plan.toml"], &["plan.toml", "read-only"]);
    for name in ["est.fits", "est.png", "plan.toml"] {
        assert_eq!(std::fs::read_to_string(desk.path(name)).unwrap(), "precious");
    }
}

#[test]
fn a_picture_of_the_numbering_destroys_nothing() {
    let desk = Desk::with_scene();
    let scene = ["scene", "scene.toml", "--plot"];
    std::fs::create_dir(desk.path("folder.png")).unwrap();
    std::fs::copy(desk.path("scene.toml"), desk.path("scene.png")).unwrap();
    for (name, words) in [
        ("absent/pupil.png", &["absent/pupil.png", "does not exist"]),
        ("folder.png", &["folder.png", "is a directory"]),
        ("pupil.pdf", &["pupil.pdf", ".png or .svg"]),
        ("-", &["standard output", "./-"]),
    ] {
        desk.refuses(&[&scene[..], &[name]].concat(), words);
    }
    desk.refuses(&["scene", "scene.png", "--plot", "./scene.png"], &["read by this command", "--plot"]);
    desk.refuses(&["scene", "--set", "pupil.rings=2"], &["--set"]);
    assert_eq!(desk.run(&["scene", "--plot", "pupil.png"]).status, 2);
}

#[test]
fn outputs_are_files_and_not_standard_output() {
    let desk = Desk::with_images(&[]);
    for arguments in [
        &["estimate", "images.fits", "-o", "-"][..],
        &["image", "scene.toml", "-o", "-"],
        &["simulate", "scene.toml", "-o", "-"],
        &["plan", "scene.toml", "--budget-nm", "5", "-o", "-"],
        &["demo", "-o", "-"],
    ] {
        desk.refuses(arguments, &["standard output", "./-"]);
    }
}

#[test]
fn images_and_scenes_are_read_from_standard_input() {
    let desk = Desk::with_images(&[]);
    let piped = |input: &str, arguments: &[&str]| {
        let input = std::fs::File::open(desk.path(input)).unwrap();
        // Through a pipe, which cannot be rewound.
        let mut cat = std::process::Command::new("cat").stdin(input).stdout(Stdio::piped()).spawn().unwrap();
        let output = desk.command(arguments).stdin(cat.stdout.take().unwrap()).output().unwrap();
        cat.wait().unwrap();
        Done::from(output)
    };
    let done = piped("images.fits", &["estimate", "-", "-o", "est.fits", "--plot", "est.svg"]);
    assert_eq!(done.status, 0, "{}", done.err);
    desk.json(&["compare", "est.fits", "--truth", "images.fits", "--json"]);
    assert_eq!(piped("scene.toml", &["image", "-", "-o", "again.fits"]).status, 0);
    assert_eq!(piped("scene.toml", &["image", "/dev/stdin", "-o", "again.fits"]).status, 0);
    let files = desk.files();
    std::fs::write(desk.path("empty"), "").unwrap();
    piped("empty", &["estimate", "-", "-o", "new.fits"]).failed(&["estimate", "-"], &["standard input", "empty"]);
    piped("scene.toml", &["estimate", "-", "-o", "new.fits"]).failed(&["estimate", "-"], &["standard-input", "FITS"]);
    std::fs::remove_file(desk.path("empty")).unwrap();
    assert_eq!(desk.files(), files);
}

/// A piston is sent to a segment by its place, which does not depend on an observatory's numbering.
#[test]
fn estimate_has_the_position_of_each_segment() {
    let desk = Desk::with_images(&[]);
    desk.succeeds(&["estimate", "images.fits", "-o", "est.fits"]);
    let mut file = FitsReader::open(desk.path("est.fits")).unwrap();
    assert_eq!(file.i64_column("SEGMENTS", "SEGMENT").unwrap(), [0, 1, 2, 3, 4, 5, 6]);
    assert_eq!(file.i64_column("SEGMENTS", "RING").unwrap(), [0, 1, 1, 1, 1, 1, 1]);
    let [x_m, y_m] = ["X_M", "Y_M"].map(|axis| file.f64_column("SEGMENTS", axis).unwrap());
    let pitch_m = 3f64.sqrt() * 0.9 + 0.003;
    assert_eq!((x_m[0], y_m[0]), (0.0, 0.0));
    // Counter-clockwise from +x: the first of the ring at 30 degrees, the second on +y.
    assert!((x_m[1] - pitch_m * 0.75f64.sqrt()).abs() < 1e-9 && (y_m[1] - pitch_m / 2.0).abs() < 1e-9);
    assert!(x_m[2].abs() < 1e-9 && (y_m[2] - pitch_m).abs() < 1e-9);
    let pistons_nm = file.f64_column("SEGMENTS", "PISTON_NM").unwrap();
    assert_eq!(pistons_nm[..], file.f64_column("MODES", "ESTIMATE_NM").unwrap()[..7]);
}
