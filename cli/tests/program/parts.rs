//! Estimates in parts: `estimate --part I/N` and `merge` make the file of one run, and parts that
//! do not belong together are refused.

use crate::{Desk, Done};
use cophase::io::{ELECTRON, FitsReader, FitsWriter, Pixel, read_channels};
use ndarray::{Axis, s};
use std::path::Path;

/// The bytes of a FITS file without the cards on the time of the run, and without the checksums,
/// which depend on it.
pub fn timeless(path: &Path) -> Vec<u8> {
    let mut bytes = std::fs::read(path).unwrap();
    for card in bytes.chunks_mut(80) {
        if [&b"DATE    "[..], b"ELAPSED ", b"CHECKSUM", b"DATASUM "].iter().any(|key| card.starts_with(key)) {
            card.fill(b' ');
        }
    }
    bytes
}

/// Whether two files are the same but for the time; says in which block they differ first.
#[track_caller]
pub fn are_the_same(one: &Path, other: &Path) {
    let (one, other) = (timeless(one), timeless(other));
    assert_eq!(one.len(), other.len());
    let first = one.iter().zip(&other).position(|(a, b)| a != b);
    assert_eq!(first, None, "they differ first at this byte");
}

/// A desk with `images.fits`: twelve images, of which one has cosmic rays, one no star, and one the
/// double flux.
pub fn sequence() -> Desk {
    let desk = Desk::with_images(&["image.count=12"]);
    desk.edit_images("images.fits", "spoilt.fits", |images_e| {
        let brightest = images_e.iter().copied().fold(0.0, f64::max);
        for (y, x) in [(30, 31), (33, 40), (25, 28)] {
            images_e[[3, y, x]] += 20.0 * brightest;
        }
        images_e.slice_mut(s![7, .., ..]).fill(5.0);
        images_e.slice_mut(s![10, .., ..]).mapv_inplace(|electrons| 2.0 * electrons);
    });
    std::fs::rename(desk.path("spoilt.fits"), desk.path("images.fits")).unwrap();
    desk
}

/// Makes the parts of an estimate, and merges them in reverse; returns what merge said on its fits.
fn merged(desk: &Desk, images: &[&str], of: usize) -> String {
    let parts: Vec<String> = (1..=of).map(|number| format!("part{number}of{of}.fits")).collect();
    for (number, part) in parts.iter().enumerate() {
        let share = format!("{}/{of}", number + 1);
        desk.succeeds(&[&["estimate"], images, &["-o", part, "--part", &share]].concat());
    }
    let reversed: Vec<&str> = parts.iter().rev().map(String::as_str).collect();
    let done = desk.succeeds(&[&["merge"], &reversed[..], &["-o", "merged.fits", "--verbose"]].concat());
    done.out.lines().next().unwrap().to_string()
}

#[test]
fn parts_make_the_file_of_one_run() {
    let desk = sequence();
    desk.succeeds(&["estimate", "images.fits", "-o", "whole.fits"]);
    // More parts than a sequence has images: some are empty.
    for of in [1, 3, 16] {
        let said = merged(&desk, &["images.fits"], of);
        are_the_same(&desk.path("whole.fits"), &desk.path("merged.fits"));
        // Merge makes none of the twelve first fits; what it restarts is the outlier.
        let made: usize = said.split(' ').next().unwrap().parse().unwrap();
        assert!(made <= 6, "{said}");
    }
}

#[test]
#[ignore = "merge: 5 s"]
fn few_images_channels_and_larger_models_have_parts_too() {
    // Three images: not a sequence, so that a part restarts its own fits.
    let desk = Desk::with_images(&["image.count=3", "aberrations.segment_piston_rms_nm=300"]);
    desk.succeeds(&["estimate", "images.fits", "-o", "whole.fits"]);
    assert!(merged(&desk, &["images.fits"], 2).starts_with("0 fits"));
    are_the_same(&desk.path("whole.fits"), &desk.path("merged.fits"));
    // Segments are tilted, which the scene does not say: the merged estimate extends the model and
    // fits all images again.
    let tilted = ["image", "scene.toml", "-o", "tilted.fits", "--set", "image.count=2", "--set"];
    desk.succeeds(&[&tilted[..], &["aberrations.segment_tip_tilt_rms_nm=40"]].concat());
    desk.succeeds(&["estimate", "tilted.fits", "-o", "whole.fits"]);
    assert!(merged(&desk, &["tilted.fits"], 2).starts_with("0 fits"), "those by the scene's model are in the parts");
    are_the_same(&desk.path("whole.fits"), &desk.path("merged.fits"));
    // Two channels.
    let pair = std::fs::read_to_string(desk.path("scene.toml")).unwrap().replacen(
        "[aberrations]",
        "[[image.channel]]\nname = \"plus\"\n\n[[image.channel]]\nname = \"minus\"\n\
         diversity_focus_waves_rms = -1.0\n\n[aberrations]",
        1,
    );
    std::fs::write(desk.path("pair.toml"), pair).unwrap();
    desk.succeeds(&["image", "pair.toml", "-o", "pair.fits", "--set", "image.count=2"]);
    desk.succeeds(&["estimate", "pair.fits", "-o", "whole.fits"]);
    merged(&desk, &["pair.fits"], 2);
    are_the_same(&desk.path("whole.fits"), &desk.path("merged.fits"));
}

#[test]
fn a_sequence_of_groups_in_parts_has_the_bits_of_one_run() {
    // Four pairs of little defocus: four groups, the second of which cannot be used.
    let desk = Desk::with_scene();
    let pair = std::fs::read_to_string(desk.path("scene.toml")).unwrap().replacen(
        "[aberrations]",
        "[[image.channel]]\nname = \"plus\"\ndiversity_focus_waves_rms = 0.3\n\n[[image.channel]]\nname = \"minus\"\n\
         diversity_focus_waves_rms = -0.3\n\n[estimate]\ngroup = \"channels\"\n\n[aberrations]",
        1,
    );
    std::fs::write(desk.path("scene.toml"), pair).unwrap();
    desk.succeeds(&["image", "scene.toml", "-o", "made.fits", "--set", "image.count=4"]);
    for (mut images, name) in read_channels(desk.path("made.fits"), None).unwrap().into_iter().zip(["a.fits", "b.fits"])
    {
        if name == "b.fits" {
            images.data.index_axis_mut(Axis(0), 1).fill(7.0);
        }
        let mut file = FitsWriter::create(desk.path(name)).unwrap();
        file.image("IMAGES", &images.data, Pixel::F32, ELECTRON).unwrap();
        file.finish().unwrap();
    }
    let images = ["--channel", "plus=a.fits", "--channel", "minus=b.fits", "--scene", "scene.toml"];
    desk.succeeds(&[&["estimate", "-o", "whole.fits"], &images[..]].concat());
    assert!(merged(&desk, &images, 3).starts_with("0 fits"), "every group is in the parts");
    are_the_same(&desk.path("whole.fits"), &desk.path("merged.fits"));
    // Images of one group are one fit.
    let all = ["estimate", "made.fits", "--part", "1/2", "-o", "part.fits", "--set", "estimate.group=\"all\""];
    desk.refuses(&all, &["fitted together", "--part"]);
}

/// What a script of a job array prints as task `task` of three, as Slurm starts it.
fn slurm_task(desk: &Desk, script: &str, arguments: &[&str], task: &str) -> Done {
    let program = Path::new(env!("CARGO_BIN_EXE_cophase")).parent().unwrap();
    let path = format!("{}:{}", program.display(), std::env::var("PATH").unwrap());
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/slurm").join(script);
    let mut command = std::process::Command::new("bash");
    command.arg(script).args(arguments).current_dir(desk.path("")).env("PATH", path);
    command.env("SLURM_ARRAY_TASK_ID", task).env("SLURM_ARRAY_TASK_COUNT", "3").env("SLURM_CPUS_PER_TASK", "1");
    Done::from(command.output().unwrap())
}

#[test]
fn the_job_array_over_nights_estimates_each_file() {
    let desk = Desk::with_images(&[]);
    std::fs::create_dir(desk.path("nights")).unwrap();
    for night in ["a.fits", "b.fits"] {
        std::fs::copy(desk.path("images.fits"), desk.path("nights").join(night)).unwrap();
    }
    let task = |number: &str| slurm_task(&desk, "nights.sh", &["nights", "scene.toml", "est"], number);
    let done = task("1");
    assert_eq!(done.status, 0, "{}", done.err);
    assert!(desk.path("est/b.fits").exists() && !desk.path("est/a.fits").exists());
    let beyond = task("2");
    assert!(
        beyond.status == 1 && beyond.err.contains("task 2") && beyond.err.contains("nights has 2"),
        "{}",
        beyond.err
    );
}

/// The scripts of the job array, as Slurm starts them.
#[test]
fn the_job_array_of_slurm_makes_the_file_of_one_run() {
    let desk = sequence();
    desk.succeeds(&["estimate", "images.fits", "--scene", "scene.toml", "-o", "whole.fits"]);
    let run = |script: &str, arguments: &[&str], task: &str| slurm_task(&desk, script, arguments, task);
    let estimate = |task: &str| run("estimate.sh", &["images.fits", "scene.toml", "est"], task);
    assert_eq!(["3", "1"].map(|task| estimate(task).status), [0, 0]);
    let early = run("merge.sh", &["est"], "1");
    assert!(early.status == 1 && early.err.contains("part 2 of 3 is missing"), "{}", early.err);
    // A task that is started again has its part.
    let written = std::fs::metadata(desk.path("est.part1.fits")).unwrap().modified().unwrap();
    assert_eq!(["1", "2"].map(|task| estimate(task).status), [0, 0]);
    assert_eq!(std::fs::metadata(desk.path("est.part1.fits")).unwrap().modified().unwrap(), written);
    let done = run("merge.sh", &["est"], "1");
    assert_eq!(done.status, 0, "{}", done.err);
    are_the_same(&desk.path("whole.fits"), &desk.path("est.fits"));
    assert_eq!(desk.files(), ["est.fits", "images.fits", "scene.toml", "whole.fits"]);
}

#[test]
fn merge_makes_the_outputs_of_the_command_from_any_folder() {
    let desk = Desk::with_images(&["image.count=2"]);
    std::fs::create_dir(desk.path("night one")).unwrap();
    std::fs::rename(desk.path("images.fits"), desk.path("night one/images.fits")).unwrap();
    for number in ["1", "2"] {
        let (share, part) = (format!("{number}/2"), format!("../part{number}.fits"));
        let arguments = ["--quiet", "estimate", "images.fits", "-o", &part, "--part", &share, "--opd", "opd.fits"];
        let done = desk.command(&arguments).current_dir(desk.path("night one")).output().unwrap();
        assert!(done.status.success() && done.stdout.is_empty());
    }
    let json = desk.json(&["merge", "part1.fits", "part2.fits", "-o", "est.fits", "--json"]);
    assert_eq!(json["images"].as_u64(), Some(2), "{json}");
    let files = ["est.fits", "night one/opd.fits"];
    assert!(files.iter().all(|name| desk.path(name).exists()) && !desk.path("night one/est.fits").exists());
}

#[test]
fn parts_that_do_not_belong_together_are_refused() {
    let desk = Desk::with_images(&["image.count=4"]);
    let part = |share: &str, name: &str, more: &[&str]| {
        desk.succeeds(&[&["estimate", "images.fits", "-o", name, "--part", share], more].concat());
    };
    part("1/2", "one.fits", &[]);
    part("2/2", "two.fits", &[]);
    part("2/3", "third.fits", &[]);
    part("2/2", "other.fits", &["--set", "image.read_noise_e=21"]);
    let merge = |parts: &[&'static str]| [&["merge"], parts, &["-o", "est.fits"]].concat();
    desk.refuses(&merge(&["one.fits"]), &["part 2 of 2 is missing"]);
    desk.refuses(&merge(&["one.fits", "two.fits", "one.fits"]), &["part 1/2", "2 times"]);
    desk.refuses(&merge(&["one.fits", "third.fits"]), &["part 1/2", "part 2/3", "different numbers of parts"]);
    desk.refuses(&merge(&["one.fits", "other.fits"]), &["different estimates", "another scene"]);
    desk.refuses(&merge(&["one.fits", "images.fits"]), &["images.fits", "no part of an estimate"]);
    desk.refuses(&merge(&["one.fits", "absent.fits"]), &["absent.fits"]);
    desk.refuses(&["merge", "one.fits", "two.fits", "-o", "one.fits"], &["one.fits", "a part"]);
    // A part whose fits are cut.
    let mut damaged = FitsWriter::create(desk.path("damaged.fits")).unwrap();
    let mut whole = FitsReader::open(desk.path("two.fits")).unwrap();
    for key in ["PART", "PARTS", "NIMAGES", "IDENTITY"] {
        damaged.card("PRIMARY", key, whole.card(Some("PRIMARY"), key).unwrap().unwrap(), "").unwrap();
    }
    damaged.text("COMMAND", "").unwrap();
    damaged.image("FITS", &ndarray::arr2(&[[1.0]]), Pixel::F64, "").unwrap();
    damaged.finish().unwrap();
    desk.refuses(&merge(&["one.fits", "damaged.fits"]), &["damaged.fits"]);
    // The images have changed since, by one count of one pixel.
    desk.edit_images("images.fits", "changed.fits", |images_e| images_e[[0, 0, 0]] += 1.0);
    std::fs::rename(desk.path("changed.fits"), desk.path("images.fits")).unwrap();
    desk.refuses(&merge(&["one.fits", "two.fits"]), &["have changed since"]);
    std::fs::remove_file(desk.path("images.fits")).unwrap();
    desk.refuses(&merge(&["one.fits", "two.fits"]), &["images.fits"]);
}

#[test]
fn estimates_without_parts_are_refused() {
    let desk = Desk::with_images(&["image.count=2"]);
    let estimate = ["estimate", "images.fits", "-o", "part.fits", "--part"];
    for share in ["0/2", "3/2", "2", "half", "1/0"] {
        let done = desk.run(&[&estimate[..], &[share]].concat());
        assert_eq!(done.status, 2, "{}", done.err);
        assert!(done.err.contains("part"), "{}", done.err);
    }
    desk.refuses(&[&estimate[..], &["1/2", "--method", "full-phase"]].concat(), &["full-phase", "parts"]);
    desk.refuses(&[&estimate[..], &["1/2", "--budget-nm", "5"]].concat(), &["estimate.budget_nm", "cophase plan"]);
    desk.refuses(&["estimate", "-", "-o", "part.fits", "--part", "1/2"], &["standard input"]);
    desk.refuses(&[&estimate[..], &["rank"]].concat(), &["--part rank", "mpirun", "I/N"]);
}
