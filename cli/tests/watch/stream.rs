//! Streams of ImageStreamIO. The writer is the upstream library, compiled from
//! `tests/imagestreamio`.

use super::*;
use cophase::io::FitsReader;
use std::io::{BufRead, BufReader, Write};
use std::process::{ChildStdin, ChildStdout, Command};
use std::sync::OnceLock;

/// The compiled writer; `None`, with a line that says so, where there is no C compiler. CI has one.
fn writer() -> Option<&'static Path> {
    static WRITER: OnceLock<Option<tempfile::TempDir>> = OnceLock::new();
    let folder = WRITER.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let sources = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/imagestreamio");
        let mut compiler = Command::new(std::env::var_os("CC").unwrap_or_else(|| "cc".into()));
        // The header has inline functions without a definition elsewhere.
        compiler.args(["-O1", "-w", "-Dinline=static inline", "-o"]).arg(folder.path().join("writer"));
        compiler.args(["writer.c", "ImageStreamIO.c", "-lm", "-lpthread"]).current_dir(sources);
        match compiler.output() {
            Ok(output) => {
                assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
                Some(folder)
            }
            Err(error) => {
                println!("skipped: no C compiler ({error})");
                None
            }
        }
    });
    static PATH: OnceLock<Option<std::path::PathBuf>> = OnceLock::new();
    PATH.get_or_init(|| folder.as_ref().map(|folder| folder.path().join("writer"))).as_deref()
}

/// A running writer of the stream `cam`.
pub struct Writer {
    child: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
}

impl Writer {
    pub fn start(desk: &Desk, side: usize, slots: usize, kind: u8) -> Option<Self> {
        let program = writer()?;
        std::fs::create_dir_all(desk.path("shm")).unwrap();
        let frames = frames(desk, side);
        std::fs::write(desk.path("frames.f32"), frames).unwrap();
        let mut child = Command::new(program)
            .args(["cam", &side.to_string(), &side.to_string(), &slots.to_string(), &kind.to_string(), "frames.f32"])
            .current_dir(desk.path("."))
            .env("MILK_SHM_DIR", desk.path("shm"))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let (input, output) = (child.stdin.take().unwrap(), BufReader::new(child.stdout.take().unwrap()));
        let mut writer = Self { child, input, output };
        assert_eq!(writer.line(), "ready");
        Some(writer)
    }

    fn line(&mut self) -> String {
        let mut line = String::new();
        self.output.read_line(&mut line).unwrap();
        line.trim().to_owned()
    }

    /// Writes `count` frames, with a pause after each; the counter then.
    pub fn write(&mut self, count: usize, pause_us: usize) -> usize {
        writeln!(self.input, "{count} {pause_us}").unwrap();
        self.line().parse().unwrap()
    }

    fn destroy(mut self) {
        writeln!(self.input, "destroy").unwrap();
        self.child.wait().unwrap();
    }
}

/// The frames of `images.fits` in the middle of images of this side, as the writer takes them.
fn frames(desk: &Desk, side: usize) -> Vec<u8> {
    let images = FitsReader::open(desk.path("images.fits")).unwrap().cube("IMAGES").unwrap();
    let cut = images.slice(ndarray::s![.., ..side.min(64), ..side.min(64)]);
    let mut all = ndarray::Array3::<f32>::zeros((cut.dim().0, side, side));
    all.slice_mut(ndarray::s![.., ..side.min(64), ..side.min(64)]).assign(&cut.mapv(|electrons| electrons as f32));
    all.iter().flat_map(|electrons| electrons.to_ne_bytes()).collect()
}

const STREAM: [&str; 8] = ["watch", "--stream", "cam", "--scene", "scene.toml", "--state", "night.db", "--no-page"];

pub fn start(desk: &Desk, options: &[&str]) -> Running {
    let mut command = desk.command(&[&STREAM[..], options].concat());
    let log = std::fs::File::options().create(true).append(true).open(desk.path("stderr.txt")).unwrap();
    command.env("MILK_SHM_DIR", desk.path("shm"));
    Running { child: command.stdout(Stdio::null()).stderr(log).spawn().unwrap() }
}

pub fn desk_with_stream() -> Desk {
    let desk = Desk::with_images(&["image.count=5"]);
    std::fs::create_dir(desk.path("shm")).unwrap();
    desk
}

/// Counters of the frames in the store, in the order in which they came.
pub fn counters(desk: &Desk) -> Vec<usize> {
    let connection = rusqlite::Connection::open(desk.path("night.db")).unwrap();
    let mut query = connection.prepare("SELECT name FROM frames ORDER BY id").unwrap();
    let names = query.query_map([], |row| row.get::<_, String>(0)).unwrap();
    names.map(|name| name.unwrap().strip_prefix("cam frame ").unwrap().parse().unwrap()).collect()
}

/// One after the other: the next is written once the last is in the store, so that none can be
/// overwritten unread.
#[test]
fn frames_of_a_stream_are_those_that_were_written() {
    let desk = desk_with_stream();
    let Some(mut writer) = Writer::start(&desk, 64, 1, 0) else { return };
    let mut watch = start(&desk, &[]);
    for count in 1..=5 {
        assert_eq!(writer.write(1, 0), count);
        wait_for_rows(&desk, count);
    }
    assert_eq!(watch.stop(), Some(0));
    assert_eq!(counters(&desk), [1, 2, 3, 4, 5]);
    // The frame that is still there is known to the next watch.
    let mut watch = start(&desk, &[]);
    writer.write(1, 0);
    wait_for_rows(&desk, 6);
    watch.stop();
    assert_eq!(counters(&desk), [1, 2, 3, 4, 5, 6]);
    // From files the same frames give the same fits, but for the bits that float lacks.
    let connection = rusqlite::Connection::open(desk.path("night.db")).unwrap();
    let mut query = connection.prepare("SELECT phasing_rms_nm, status FROM frames ORDER BY id").unwrap();
    let found: Vec<(f64, String)> =
        query.query_map([], |row| Ok((row.get(0)?, row.get(1)?))).unwrap().map(Result::unwrap).collect();
    std::fs::create_dir(desk.path("frames")).unwrap();
    std::fs::copy(desk.path("images.fits"), desk.path("frames/images.fits")).unwrap();
    let words = WATCH.map(|word| if word == "night.db" { "files.db" } else { word });
    desk.succeeds(&[&words[..], &["--once"]].concat());
    let connection = rusqlite::Connection::open(desk.path("files.db")).unwrap();
    let mut query = connection.prepare("SELECT phasing_rms_nm FROM frames ORDER BY id").unwrap();
    let files: Vec<f64> = query.query_map([], |row| row.get(0)).unwrap().map(Result::unwrap).collect();
    assert_eq!(files.len(), 5);
    for (from_file, (from_stream, status)) in files.iter().zip(&found) {
        // Float keeps 6e-8 of an electron count: far below a ten-thousandth of a nm; the fit's own
        // tolerance is 0.01 nm.
        assert!((from_file - from_stream).abs() < 0.01 && status == "done", "{files:?} {found:?}");
    }
}

#[test]
fn a_circular_buffer_bridges_the_time_without_a_watch() {
    for kind in [1, 2] {
        let desk = desk_with_stream();
        let Some(mut writer) = Writer::start(&desk, 64, 20, kind) else { return };
        writer.write(12, 0);
        let mut watch = start(&desk, &[]);
        wait_for_rows(&desk, 12);
        // Faster than they are estimated, and fewer than the buffer has.
        writer.write(15, 0);
        wait_for_rows(&desk, 27);
        watch.stop();
        assert_eq!(counters(&desk), (1..=27).collect::<Vec<_>>(), "kind {kind}");
        assert!(rows(&desk.path("night.db")).iter().all(|row| row.status == "done"), "kind {kind}");
    }
}

#[test]
fn frames_that_are_overwritten_unread_are_counted() {
    let desk = desk_with_stream();
    let Some(mut writer) = Writer::start(&desk, 64, 1, 0) else { return };
    let mut watch = start(&desk, &[]);
    writer.write(1, 0);
    wait_for_rows(&desk, 1);
    writer.write(500, 0);
    let state = desk.path("night.db");
    wait_until("a sentence on lost frames", || {
        events(&state).iter().any(|(kind, sentence)| kind == "source" && sentence.contains("were overwritten"))
    });
    wait_until("the newest frame", || counters(&desk).last() == Some(&501));
    watch.stop();
    let lost: Vec<usize> = events(&state)
        .iter()
        .filter(|(_, sentence)| sentence.contains("were overwritten"))
        .map(|(_, sentence)| sentence.split(' ').next().unwrap().parse().unwrap())
        .collect();
    // The rest is in a sentence that is due later; none is counted twice.
    let (there, lost) = (counters(&desk), lost.iter().sum::<usize>());
    assert!(lost > 0 && there.len() + lost <= 501, "{} frames, {lost} lost", there.len());
    assert!(there.windows(2).all(|pair| pair[0] < pair[1]), "{there:?}");
}

#[test]
fn a_stream_that_is_made_anew_is_followed_with_another_size_too() {
    let desk = desk_with_stream();
    // The watch waits for a stream that is not there yet.
    let mut watch = start(&desk, &[]);
    let state = desk.path("night.db");
    wait_until("the sentence", || {
        state.exists()
            && has_events(&state)
            && events(&state).iter().any(|(_, sentence)| sentence.contains("waiting until it can"))
    });
    let Some(mut writer) = Writer::start(&desk, 64, 1, 0) else { return };
    writer.write(1, 0);
    wait_for_rows(&desk, 1);
    writer.destroy();
    let mut writer = Writer::start(&desk, 48, 1, 0).unwrap();
    writer.write(1, 0);
    wait_for_rows(&desk, 2);
    // Without the former one being removed first, as a writer does that was killed.
    writer.child.kill().unwrap();
    writer.child.wait().unwrap();
    let mut writer = Writer::start(&desk, 64, 1, 0).unwrap();
    writer.write(1, 0);
    wait_for_rows(&desk, 3);
    // A file that is cut short under the reader, and one that is none.
    std::fs::File::options().write(true).open(desk.path("shm/cam.im.shm")).unwrap().set_len(100).unwrap();
    wait_until("the sentence on a file that is cut short", || {
        events(&state).iter().any(|(_, sentence)| sentence.contains("has no metadata"))
    });
    writer.child.kill().unwrap();
    writer.child.wait().unwrap();
    let mut writer = Writer::start(&desk, 64, 1, 0).unwrap();
    writer.write(1, 0);
    wait_for_rows(&desk, 4);
    assert_eq!(watch.stop(), Some(0));
    let found: Vec<(String, String)> = {
        let connection = rusqlite::Connection::open(&state).unwrap();
        let mut query = connection.prepare("SELECT status, coalesce(reason, '') FROM frames ORDER BY id").unwrap();
        query.query_map([], |row| Ok((row.get(0)?, row.get(1)?))).unwrap().map(Result::unwrap).collect()
    };
    assert_eq!(
        found.iter().map(|(status, _)| status.as_str()).collect::<Vec<_>>(),
        ["done", "refused", "done", "done"]
    );
    assert!(["48x48", "64x64"].iter().all(|fact| found[1].1.contains(fact)), "{found:?}");
    assert!(events(&state).iter().any(|(_, sentence)| sentence.contains("made anew") && sentence.contains("48x48")));
}

fn has_events(state: &Path) -> bool {
    let connection = rusqlite::Connection::open(state).unwrap();
    connection.query_row("SELECT count(*) FROM events", [], |row| row.get::<_, i64>(0)).is_ok()
}
