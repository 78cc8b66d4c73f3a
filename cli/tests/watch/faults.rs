//! Faults between two frames: nothing is lost, nothing is counted twice, and no watch crashes.

use super::*;
use rand::{RngExt, SeedableRng};
use std::os::unix::process::CommandExt;

/// Kills in the suite; `COPHASE_KILLS` in the environment asks for more.
const KILLS: usize = 12;

#[test]
fn killed_watch_loses_and_repeats_no_frame() {
    let kills = std::env::var("COPHASE_KILLS").ok().and_then(|text| text.parse().ok()).unwrap_or(KILLS);
    let desk = desk_with_frames(40);
    // The moments are random in the time of a watch, which is not known; the seed makes them the
    // same fractions of a second.
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
    let mut next = 0;
    for kill in 0..kills {
        let until = 40 * (kill + 1) / kills;
        (next..until).for_each(|number| put(&desk, number));
        next = until;
        let mut watch = Running::start(&desk, &[]);
        std::thread::sleep(Duration::from_millis(rng.random_range(0..700)));
        watch.kill();
    }
    once(&desk);
    let found = rows(&desk.path("night.db"));
    let names: Vec<String> = (0..40).map(|number| format!("{number:03}.fits")).collect();
    assert_eq!(found.iter().map(|row| row.name.clone()).collect::<Vec<_>>(), names);
    // What one watch without faults finds is the same to the last bit.
    std::fs::rename(desk.path("night.db"), desk.path("killed.db")).unwrap();
    once(&desk);
    assert_eq!(rows(&desk.path("night.db")), found);
    assert_eq!(trackers(&desk.path("night.db")), trackers(&desk.path("killed.db")));
}

/// The log of a killed watch belongs to its store, which says so where it is copied without it.
#[test]
fn store_of_a_killed_watch_names_its_log() {
    let desk = desk_with_frames(2);
    put(&desk, 0);
    let mut watch = Running::start(&desk, &[]);
    wait_for_rows(&desk, 1);
    watch.kill();
    for name in ["alone.db", "whole.db"] {
        std::fs::copy(desk.path("night.db"), desk.path(name)).unwrap();
    }
    std::fs::copy(desk.path("night.db-wal"), desk.path("whole.db-wal")).unwrap();
    let export = |state: &str| desk.succeeds(&["watch", "--state", state, "--export", "night.csv"]);
    let alone = export("alone.db");
    assert!(alone.err.contains("alone.db") && alone.err.contains("night.db-wal"), "{}", alone.err);
    assert_eq!(export("whole.db").err, "");
    // A watch that ends leaves a store that needs no other file: SQLite may keep an empty log
    // behind one that was killed.
    put(&desk, 1);
    once(&desk);
    assert_eq!(std::fs::metadata(desk.path("night.db-wal")).map_or(0, |log| log.len()), 0);
    std::fs::copy(desk.path("night.db"), desk.path("ended.db")).unwrap();
    assert_eq!(export("ended.db").err, "");
}

/// State of the tracker.
fn trackers(state: &Path) -> Vec<Vec<u8>> {
    let connection = rusqlite::Connection::open(state).unwrap();
    let mut query = connection.prepare("SELECT state FROM tracker").unwrap();
    query.query_map([], |row| row.get(0)).unwrap().map(Result::unwrap).collect()
}

#[test]
fn second_watch_on_one_file_is_refused_until_the_first_ends() {
    let desk = desk_with_frames(1);
    put(&desk, 0);
    let mut watch = Running::start(&desk, &[]);
    wait_for_rows(&desk, 1);
    let arguments = [&WATCH[..], &["--once"]].concat();
    let process = format!("process {}", watch.child.id());
    desk.run(&arguments).failed(&arguments, &["night.db", "in use", &process, "--state"]);
    watch.kill();
    once(&desk);
    assert_eq!(rows(&desk.path("night.db")).len(), 1);
}

#[test]
fn full_disk_is_reported_and_frames_are_taken_later() {
    let desk = desk_with_frames(4);
    put(&desk, 0);
    once(&desk);
    let before = rows(&desk.path("night.db"));
    (1..4).for_each(|number| put(&desk, number));
    // The store and its log cannot grow.
    let size = std::fs::metadata(desk.path("night.db")).unwrap().len();
    let arguments = [&WATCH[..], &["--once"]].concat();
    let limited = |bytes: u64| {
        let mut command = desk.command(&arguments);
        // SAFETY: a plain system call between fork and exec.
        unsafe {
            command.pre_exec(move || {
                let limit = libc::rlimit { rlim_cur: bytes, rlim_max: bytes };
                (libc::setrlimit(libc::RLIMIT_FSIZE, &limit) == 0)
                    .then_some(())
                    .ok_or_else(std::io::Error::last_os_error)
            });
        }
        crate::Done::from(command.output().unwrap())
    };
    let done = limited(4096);
    assert_eq!(done.status, 1, "{}", done.err);
    assert!(done.err.contains("night.db") && !done.err.contains("panicked"), "{}", done.err);
    assert_eq!(rows(&desk.path("night.db")), before, "{size}");
    once(&desk);
    assert_eq!(rows(&desk.path("night.db")).len(), 4);
}

/// The disk of a watch that runs becomes full, and has room again.
#[test]
fn a_watch_outlives_a_full_disk() {
    let desk = desk_with_frames(4);
    put(&desk, 0);
    let mut watch = Running::start(&desk, &[]);
    wait_for_rows(&desk, 1);
    let limit = |bytes: libc::rlim_t| {
        let limit = libc::rlimit { rlim_cur: bytes, rlim_max: libc::RLIM_INFINITY };
        // SAFETY: a plain system call on a child that has not been waited for.
        let done =
            unsafe { libc::prlimit(watch.child.id() as libc::pid_t, libc::RLIMIT_FSIZE, &limit, std::ptr::null_mut()) };
        assert_eq!(done, 0, "{}", std::io::Error::last_os_error());
    };
    limit(4096);
    (1..4).for_each(|number| put(&desk, number));
    wait_until("the sentence on a full disk", || {
        std::fs::read_to_string(desk.path("stderr.txt")).unwrap().contains("the frame is tried again")
    });
    assert_eq!(rows(&desk.path("night.db")).len(), 1);
    limit(libc::RLIM_INFINITY);
    wait_for_rows(&desk, 4);
    assert_eq!(watch.stop(), Some(0));
    let found = rows(&desk.path("night.db"));
    assert_eq!(
        found.iter().map(|row| row.name.as_str()).collect::<Vec<_>>(),
        ["000.fits", "001.fits", "002.fits", "003.fits"]
    );
    // One sentence for all tries.
    let said = std::fs::read_to_string(desk.path("stderr.txt")).unwrap();
    assert_eq!(said.matches("the frame is tried again").count(), 1, "{said}");
}

#[test]
fn a_folder_that_is_removed_is_waited_for() {
    let desk = desk_with_frames(2);
    put(&desk, 0);
    let mut watch = Running::start(&desk, &[]);
    wait_for_rows(&desk, 1);
    std::fs::remove_dir_all(desk.path("frames")).unwrap();
    let said = |what: &str| {
        let state = desk.path("night.db");
        wait_until(what, || events(&state).iter().any(|(kind, sentence)| kind == "source" && sentence.contains(what)));
    };
    said("waiting until it is back");
    std::fs::create_dir(desk.path("frames")).unwrap();
    said("is back");
    put(&desk, 1);
    wait_for_rows(&desk, 2);
    assert_eq!(watch.stop(), Some(0));
}

#[test]
fn files_of_other_programs_and_of_other_scenes_are_no_store() {
    let desk = desk_with_frames(1);
    let arguments = [&WATCH[..], &["--once"]].concat();
    std::fs::write(desk.path("night.db"), "a file of somebody else, which must stay as it is".repeat(100)).unwrap();
    let before = std::fs::read(desk.path("night.db")).unwrap();
    desk.run(&arguments).failed(&arguments, &["night.db", "not a database"]);
    assert_eq!(std::fs::read(desk.path("night.db")).unwrap(), before);
    std::fs::remove_file(desk.path("night.db")).unwrap();
    rusqlite::Connection::open(desk.path("night.db")).unwrap().execute_batch("CREATE TABLE letters (text)").unwrap();
    desk.run(&arguments).failed(&arguments, &["night.db", "another program"]);
    std::fs::remove_file(desk.path("night.db")).unwrap();
    put(&desk, 0);
    once(&desk);
    // The state is no file of the command, and no other file is the state.
    for (option, value) in [("--log", "night.db"), ("--state", "scene.toml")] {
        let mixed = [
            &arguments
                .iter()
                .map(|word| if option == "--state" && *word == "night.db" { value } else { word })
                .collect::<Vec<_>>()[..],
            if option == "--log" { &["--log", "night.db"] } else { &[] },
        ]
        .concat();
        desk.run(&mixed).failed(&mixed, &[value, "cannot be its output", option]);
    }
    let other = [&arguments[..], &["--set", "image.read_noise_e=3"]].concat();
    desk.run(&other).failed(&other, &["night.db", "another model", "read_noise_e"]);
    rusqlite::Connection::open(desk.path("night.db")).unwrap().execute_batch("PRAGMA user_version = 7").unwrap();
    desk.run(&arguments).failed(&arguments, &["night.db", "has version 7"]);
}

#[test]
fn a_clock_that_is_set_back_hinders_no_frame() {
    let desk = desk_with_frames(4);
    for (number, date) in ["2026-11-25T04:00:00", "2026-11-25T04:00:10", "2026-11-25T03:59:00", "1970-01-01T00:00:00"]
        .into_iter()
        .enumerate()
    {
        let name = format!("frames/{number:03}.fits");
        let images = cophase::io::FitsReader::open(made(&desk, number)).unwrap().cube("IMAGES").unwrap();
        let mut file = cophase::io::FitsWriter::create(desk.path(&name)).unwrap();
        file.image("IMAGES", &images, cophase::io::Pixel::F64, "electron").unwrap();
        file.card("IMAGES", "DATE-OBS", date, "").unwrap();
        file.finish().unwrap();
    }
    once(&desk);
    let connection = rusqlite::Connection::open(desk.path("night.db")).unwrap();
    let mut query = connection.prepare("SELECT observed_s FROM frames WHERE status = 'done' ORDER BY name").unwrap();
    let times: Vec<f64> = query.query_map([], |row| row.get(0)).unwrap().map(Result::unwrap).collect();
    assert_eq!(times, [1_795_579_200.0, 1_795_579_210.0, 1_795_579_140.0, 0.0]);
}
