//! Files that a scene names: regular ones of a stated size, and of a scene in somebody else's image
//! file those beside it.

use crate::{Desk, SMALL};
use cophase::io::{FitsReader, FitsWriter, Pixel};
use std::path::Path;

const FILTER: &str = "1980 0.5\n2000 1\n2020 0.5\n";

/// Writes `images.fits` of the desk as `name`, with a scene that has `filter` as its filter.
fn embed(desk: &Desk, name: &str, filter: &str) {
    let named = SMALL.replace("read_noise_e = 20", &format!("read_noise_e = 20\nfilter_file = \"{filter}\""));
    let images = FitsReader::open(desk.path("images.fits")).unwrap().cube("IMAGES").unwrap();
    let mut file = FitsWriter::create(desk.path(name)).unwrap();
    file.image("IMAGES", &images, Pixel::F32, "electron").unwrap();
    file.text("SCENE", &named).unwrap();
    file.finish().unwrap();
}

#[test]
fn devices_and_pipes_are_no_files_of_a_scene() {
    let desk = Desk::with_images(&[]);
    let fifo = std::ffi::CString::new(desk.path("pipe.txt").to_str().unwrap()).unwrap();
    // SAFETY: a plain system call on a NUL-terminated name.
    assert_eq!(unsafe { libc::mkfifo(fifo.as_ptr(), 0o600) }, 0);
    let estimate = ["estimate", "images.fits", "--scene", "scene.toml", "-o", "est.fits"];
    for name in ["/dev/zero", "pipe.txt", "."] {
        for key in ["image.filter_file", "commands.segment_file"] {
            let set = format!("{key}={name}");
            desk.refuses(&[&estimate[..], &["--set", &set]].concat(), &["regular file", key]);
        }
    }
    desk.succeeds(&estimate);
    desk.refuses(&["compare", "est.fits", "--truth-pistons", "/dev/zero"], &["/dev/zero", "regular file"]);
}

#[test]
fn scene_in_an_image_names_files_beside_it_only() {
    let desk = Desk::with_images(&[]);
    std::fs::create_dir(desk.path("night")).unwrap();
    for place in ["filter.txt", "night/filter.txt"] {
        std::fs::write(desk.path(place), FILTER).unwrap();
    }
    let absolute = desk.path("filter.txt").display().to_string();
    let estimate = ["estimate", "night/other.fits", "-o", "est.fits"];
    embed(&desk, "night/other.fits", "filter.txt");
    desk.succeeds(&estimate);
    for foreign in ["../filter.txt", "../night/../filter.txt", absolute.as_str(), "/dev/zero"] {
        embed(&desk, "night/other.fits", foreign);
        let foreign = foreign.rsplit('/').next().unwrap();
        desk.refuses(&estimate, &["night/other.fits", foreign, "image.filter_file", "--foreign-files"]);
        desk.succeeds(&[&estimate[..], &["--set", "image.filter_file=filter.txt"]].concat());
    }
    embed(&desk, "night/other.fits", "../filter.txt");
    desk.succeeds(&[&estimate[..], &["--foreign-files"]].concat());
    desk.succeeds(&[&estimate[..], &["--scene", "scene.toml", "--trust", "scene"]].concat());
    assert!(Path::new(&desk.path("est.fits")).exists());
}

#[test]
fn lists_of_a_scene_are_bounded() {
    let desk = Desk::with_scene();
    let angles = vec!["1.0"; 5000].join(",");
    let set = format!("pupil.spider_angles_deg=[{angles}]");
    desk.refuses(&["image", "scene.toml", "-o", "new.fits", "--set", &set], &["pupil.spider_angles_deg", "4096"]);
}
