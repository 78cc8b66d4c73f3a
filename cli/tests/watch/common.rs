//! Frames for a watch, a watch that runs, and the wait for what it does.

use crate::desk::{Desk, Done};
use cophase_watch::rusqlite;
use ndarray::Array3;
use std::path::Path;
use std::process::Child;
use std::time::{Duration, Instant};

/// Nothing here takes longer, on a machine that does other work, too; a test that waits as long has
/// failed.
pub const PATIENCE: Duration = Duration::from_secs(120);

/// A desk with the folder `frames`, and `count` files of one frame each in the folder `made`, which
/// differ by their noise.
pub fn desk_with_frames(count: usize) -> Desk {
    let desk = Desk::with_images(&[&format!("image.count={count}")]);
    std::fs::create_dir(desk.path("frames")).unwrap();
    std::fs::create_dir(desk.path("made")).unwrap();
    for number in 0..count {
        desk.edit_images("images.fits", &format!("made/{number:03}.fits"), |images| {
            *images = images.slice(ndarray::s![number..number + 1, .., ..]).to_owned();
        });
    }
    desk
}

/// Puts a file of `made` into `frames`.
pub fn put(desk: &Desk, number: usize) {
    std::fs::copy(made(desk, number), desk.path(&format!("frames/{number:03}.fits"))).unwrap();
}

pub fn made(desk: &Desk, number: usize) -> std::path::PathBuf {
    desk.path(&format!("made/{number:03}.fits"))
}

pub const WATCH: [&str; 10] = [
    "watch",
    "frames",
    "--scene",
    "scene.toml",
    "--state",
    "night.db",
    "--settle-seconds",
    "0.3",
    "--poll-seconds",
    "0.2",
];

/// Takes what is there; what it printed.
pub fn once(desk: &Desk) -> Done {
    desk.succeeds(&[&WATCH[..], &["--once"]].concat())
}

/// A frame in the store.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    pub name: String,
    pub image: i64,
    pub status: String,
    pub reason: String,
    pub chi2: Option<f64>,
    pub coefficients: Option<Vec<u8>>,
}

/// All frames of the store, by their name.
pub fn rows(state: &Path) -> Vec<Row> {
    let connection = rusqlite::Connection::open(state).unwrap();
    let check: String = connection.query_row("PRAGMA integrity_check", [], |row| row.get(0)).unwrap();
    assert_eq!(check, "ok");
    let query = "SELECT name, image, status, reason, chi2, coefficients_nm FROM frames ORDER BY name, image";
    let mut query = connection.prepare(query).unwrap();
    let rows = query.query_map([], |row| {
        let name: String = row.get(0)?;
        Ok(Row {
            name: name.rsplit('/').next().unwrap_or_default().to_owned(),
            image: row.get(1)?,
            status: row.get(2)?,
            reason: row.get::<_, Option<String>>(3)?.unwrap_or_default(),
            chi2: row.get(4)?,
            coefficients: row.get(5)?,
        })
    });
    rows.unwrap().map(Result::unwrap).collect()
}

/// Kinds and sentences of the events of the store.
pub fn events(state: &Path) -> Vec<(String, String)> {
    let connection = rusqlite::Connection::open(state).unwrap();
    let mut query = connection.prepare("SELECT kind, sentence FROM events ORDER BY id").unwrap();
    let rows = query.query_map([], |row| Ok((row.get(0)?, row.get(1)?))).unwrap();
    rows.map(Result::unwrap).collect()
}

/// A watch that runs until it is dropped.
pub struct Running {
    pub child: Child,
}

impl Running {
    pub fn start(desk: &Desk, options: &[&str]) -> Self {
        // An option that is given takes the place of the usual one.
        let mut words = WATCH.to_vec();
        for pair in options.chunks(2) {
            match words.iter().position(|word| word == &pair[0]) {
                Some(place) => words[place + 1] = pair[1],
                None => words.extend(pair),
            }
        }
        Self::start_as(desk, &[&words[..], &["--no-page"]].concat())
    }

    pub fn start_as(desk: &Desk, words: &[&str]) -> Self {
        let mut command = desk.command(words);
        let log = std::fs::File::options().create(true).append(true).open(desk.path("stderr.txt")).unwrap();
        let out = std::fs::File::create(desk.path("stdout.txt")).unwrap();
        Self { child: command.stdout(out).stderr(log).spawn().unwrap() }
    }

    /// Stops it as Ctrl-C does; its exit status.
    pub fn stop(&mut self) -> Option<i32> {
        // SAFETY: a plain system call on a child that has not been waited for.
        unsafe {
            libc::kill(self.child.id() as libc::pid_t, libc::SIGINT);
        }
        self.child.wait().unwrap().code()
    }

    pub fn kill(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Waits until `is_so`.
pub fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    let began = Instant::now();
    while !is_so() {
        assert!(began.elapsed() < PATIENCE, "{what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Waits until the store has `count` frames.
pub fn wait_for_rows(desk: &Desk, count: usize) {
    let state = desk.path("night.db");
    wait_until(&format!("{count} frames"), || {
        let Ok(connection) = rusqlite::Connection::open(&state) else { return false };
        // The tables are not there at first.
        let found = connection.query_row("SELECT count(*) FROM frames", [], |row| row.get::<_, i64>(0));
        found.is_ok_and(|found| found >= count as i64)
    });
}

/// A file of a frame of another size.
pub fn write_frame(path: &Path, side: usize, electrons: f64) {
    let mut file = cophase::io::FitsWriter::create(path).unwrap();
    let frame = Array3::from_elem((1, side, side), electrons);
    file.image("IMAGES", &frame, cophase::io::Pixel::F64, "electron").unwrap();
    file.finish().unwrap();
}
