//! Corrections of a watch: written, applied with the simulator, recognised once.

use super::*;
use cophase::io::FitsReader;
use rand::{RngExt, SeedableRng};
use std::time::SystemTime;

/// Frames before and after the correction is applied.
const HALF: usize = 6;

/// A desk whose scene has a mirror; the first half of the frames is in `frames`.
fn desk() -> Desk {
    let desk = Desk::with_scene();
    let scene = format!("{}\n[mirror]\nactuators_across = 9\npitch_m = 0.6\n", crate::SMALL);
    std::fs::write(desk.path("scene.toml"), scene).unwrap();
    std::fs::create_dir(desk.path("frames")).unwrap();
    make(&desk, "before.fits", &[]);
    put(&desk, "before.fits", 0..HALF);
    desk
}

fn make(desk: &Desk, name: &str, more: &[&str]) {
    let count = format!("image.count={}", 2 * HALF);
    desk.succeeds(&[&["image", "scene.toml", "-o", name, "--set", &count][..], more].concat());
}

/// Puts frames of `made` into the folder, each a file of 10 s later.
fn put(desk: &Desk, made: &str, numbers: std::ops::Range<usize>) {
    for number in numbers {
        desk.edit_images(made, "one.fits", |images| {
            *images = images.slice(ndarray::s![number..number + 1, .., ..]).to_owned();
        });
        let path = desk.path(&format!("frames/{number:03}.fits"));
        std::fs::rename(desk.path("one.fits"), &path).unwrap();
        let time = SystemTime::UNIX_EPOCH + Duration::from_secs(1_795_579_200 + 10 * number as u64);
        std::fs::File::options().write(true).open(&path).unwrap().set_modified(time).unwrap();
    }
}

const CORRECTING: [&str; 2] = ["--corrections", "c.fits"];

fn correct(desk: &Desk) -> crate::Done {
    desk.succeeds(&[&WATCH[..], &["--once"], &CORRECTING].concat())
}

/// Number, frame that showed it, and part of each correction of the store.
fn corrections(desk: &Desk) -> Vec<(i64, Option<i64>, Option<String>)> {
    let connection = rusqlite::Connection::open(desk.path("night.db")).unwrap();
    let mut query = connection.prepare("SELECT id, applied_frame, applied_part FROM corrections ORDER BY id").unwrap();
    let rows = query.query_map([], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?))).unwrap();
    rows.map(Result::unwrap).collect()
}

/// RMS of phasing and NCPA of the frame `id`.
fn rms_nm(desk: &Desk, id: i64) -> [f64; 2] {
    let connection = rusqlite::Connection::open(desk.path("night.db")).unwrap();
    let query = "SELECT phasing_rms_nm, ncpa_rms_nm FROM frames WHERE id = ?1";
    connection.query_row(query, [id], |row| Ok([row.get(0)?, row.get(1)?])).unwrap()
}

fn said(desk: &Desk, words: &str) -> usize {
    events(&desk.path("night.db")).iter().filter(|(_, sentence)| sentence.contains(words)).count()
}

#[test]
fn a_correction_is_written_and_recognised_when_it_is_applied() {
    let desk = desk();
    let done = correct(&desk);
    assert!(done.out.contains("correction 1 was written to c.fits: "), "{}", done.out);
    let written = corrections(&desk);
    assert!(!written.is_empty() && written.iter().all(|(_, frame, _)| frame.is_none()));
    let mut file = FitsReader::open(desk.path("c.fits")).unwrap();
    let add_nm = file.f64_column("SEGMENTS", "ADD_NM").unwrap();
    assert!(add_nm.iter().filter(|nm| **nm != 0.0).count() >= 5, "{add_nm:?}");
    assert_eq!(file.text_column("SEGMENTS", "HELD").unwrap().len(), 7);
    assert!(file.f64_column("NCPA", "CORRECTED_NM").unwrap().iter().any(|nm| *nm != 0.0));
    let newest = written.len();
    let sentences = file.text_column("WARNINGS", "SENTENCE").unwrap();
    assert!(sentences[0].contains(&format!("correction {newest} of this watch")), "{sentences:?}");

    // The correction is not applied: frames of the same aberrations show nothing, and no other is
    // written.
    let bytes = std::fs::read(desk.path("c.fits")).unwrap();
    put(&desk, "before.fits", HALF..HALF + 2);
    correct(&desk);
    assert_eq!(said(&desk, "applied"), 0);
    if corrections(&desk).len() == newest {
        assert_eq!(std::fs::read(desk.path("c.fits")).unwrap(), bytes);
    }

    // Applied: recognised in the first frame, and no alarm.
    make(&desk, "after.fits", &["--corrections", "c.fits"]);
    put(&desk, "after.fits", HALF + 2..2 * HALF);
    let done = correct(&desk);
    let found = corrections(&desk);
    let applied: Vec<_> = found.iter().filter(|(_, frame, _)| frame.is_some()).collect();
    assert_eq!(applied.len(), 1, "{found:?}");
    assert_eq!((applied[0].1, applied[0].2.as_deref()), (Some(HALF as i64 + 3), Some("whole")));
    assert_eq!(said(&desk, "was applied: "), 1, "{}", done.err);
    let kinds: Vec<String> = events(&desk.path("night.db")).into_iter().map(|(kind, _)| kind).collect();
    assert!(kinds.iter().all(|kind| kind == "correction"), "{kinds:?}");
    // The mirror makes most of the NCPA of nine modes, the segments all of their pistons: a tenth
    // and a third are left, noise included.
    let [before, after] = [1, 2 * HALF as i64].map(|id| rms_nm(&desk, id));
    assert!(after[0] < 0.15 * before[0] && after[1] < 0.33 * before[1], "{before:?} {after:?}");

    desk.succeeds(&["watch", "--export", "night.fits", "--state", "night.db"]);
    let mut night = FitsReader::open(desk.path("night.fits")).unwrap();
    let numbers: Vec<i64> = found.iter().map(|(number, ..)| *number).collect();
    assert_eq!(night.i64_column("CORRECTIONS", "NUMBER").unwrap(), numbers);
    assert_eq!(night.map(Some("CORRECTION_CHANGES")).unwrap().nrows(), numbers.len());
}

#[test]
fn a_watch_that_is_killed_recognises_a_correction_once() {
    let desk = desk();
    correct(&desk);
    make(&desk, "after.fits", &CORRECTING);
    put(&desk, "after.fits", HALF..2 * HALF);
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(4);
    for _ in 0..5 {
        let mut watch = Running::start(&desk, &CORRECTING);
        std::thread::sleep(Duration::from_millis(rng.random_range(100..700)));
        watch.kill();
    }
    correct(&desk);
    assert_eq!(rows(&desk.path("night.db")).len(), 2 * HALF);
    let found = corrections(&desk);
    let applied: Vec<_> = found.iter().filter_map(|(_, frame, _)| *frame).collect();
    assert_eq!((applied, said(&desk, "was applied: ")), (vec![HALF as i64 + 1], 1), "{found:?}");
    // Without a fault the same corrections come of the same frames.
    std::fs::remove_file(desk.path("night.db")).unwrap();
    correct(&desk);
    assert_eq!(corrections(&desk), found);
}

#[test]
fn files_of_corrections_that_cannot_be_are_refused() {
    let desk = desk();
    let refused = |file: &str, words: &[&str]| {
        let arguments = [&WATCH[..], &["--once", "--corrections", file]].concat();
        desk.run(&arguments).failed(&arguments, words);
    };
    refused("frames/c.fits", &["frames/c.fits", "folder of the frames"]);
    refused("night.db", &["night.db", "--corrections"]);
    refused("scene.toml", &["scene.toml", "--corrections"]);
    refused("none/c.fits", &["none/c.fits"]);
}
