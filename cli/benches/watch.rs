//! Latency and rate, on the size of Keck (240 x 240 pixels) and on the small scene. They print;
//! nothing is asserted on time, which is the machine's: `cargo bench -p cophase-cli --bench watch`.

#![allow(dead_code, unused_imports, reason = "the helpers of the tests, without the tests")]

#[path = "../tests/watch/common.rs"]
mod common;
#[path = "../../tests/common/desk.rs"]
mod desk;
#[path = "../tests/watch/page.rs"]
mod page;
#[path = "../tests/watch/stream.rs"]
mod stream;

use common::*;
use cophase_watch::rusqlite;
use desk::{Desk, Done, SMALL};
use ndarray::Array3;
use page::Site;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};
use stream::{Writer, desk_with_stream, start};

fn number(name: &str, usual: usize) -> usize {
    std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(usual)
}

fn print_quantiles(what: &str, mut seconds: Vec<f64>) {
    seconds.sort_by(f64::total_cmp);
    let at = |q: f64| seconds[((seconds.len() - 1) as f64 * q).round() as usize] * 1e3;
    let count = seconds.len();
    println!("{what}: {count} frames, median {:.1} ms, p99 {:.1} ms, most {:.1} ms", at(0.5), at(0.99), at(1.0));
}

fn latencies(state: &Path) -> Vec<f64> {
    let connection = rusqlite::Connection::open(state).unwrap();
    let mut query = connection.prepare("SELECT latency_s FROM frames WHERE status = 'done'").unwrap();
    query.query_map([], |row| row.get(0)).unwrap().map(Result::unwrap).collect()
}

/// From the rename of a complete file to the event of the page that announces its estimate.
fn latency_of_files_of_240_pixels() {
    let count = number("COPHASE_FRAMES", 100);
    let desk = Desk::with_scene();
    std::fs::create_dir(desk.path("frames")).unwrap();
    desk.succeeds(&["image", "keck-artificial", "-o", "keck.fits"]);
    let words = WATCH.map(|word| if word == "scene.toml" { "keck-artificial" } else { word });
    let mut site = Site::start_as(&desk, &words, &[]);
    let mut stream = site.connect();
    write!(stream, "GET /api/changes HTTP/1.1\r\nHost: {}\r\n\r\n", site.host()).unwrap();
    let mut lines = BufReader::new(stream).lines().map(Result::unwrap).filter(|line| line.starts_with("data: "));
    lines.next().unwrap();
    let mut seconds = Vec::new();
    for number in 0..count {
        desk.edit_images("keck.fits", "made.fits", |images| images[[0, 0, 0]] += number as f64 + 1.0);
        std::fs::rename(desk.path("made.fits"), desk.path(&format!("frames/{number}.fits"))).unwrap();
        let began = Instant::now();
        lines.next().unwrap();
        seconds.push(began.elapsed().as_secs_f64());
    }
    print_quantiles("file to page, keck-artificial", seconds);
    assert_eq!(site.running.stop(), Some(0));
    print_quantiles("file to store, keck-artificial", latencies(&desk.path("night.db")));
}

/// From the write of a frame to its estimate, and the memory of the watch, at 100 frames a second.
fn rate_of_a_stream() {
    let (count, pause_us) = (number("COPHASE_FRAMES", 3000), number("COPHASE_PAUSE_US", 10_000));
    let desk = desk_with_stream();
    let Some(mut writer) = Writer::start(&desk, 64, 100, 1) else { return };
    let mut watch = start(&desk, &["--false-alarms-per-night", "0.1"]);
    let resident = |watch: &Running| {
        let status = std::fs::read_to_string(format!("/proc/{}/status", watch.child.id())).unwrap();
        let line = status.lines().find(|line| line.starts_with("VmRSS")).unwrap().to_owned();
        line.split_whitespace().nth(1).unwrap().parse::<u64>().unwrap() / 1024
    };
    writer.write(200, pause_us);
    wait_for_rows(&desk, 200);
    let before = resident(&watch);
    writer.write(count, pause_us);
    wait_until("all frames", || stream::counters(&desk).last() == Some(&(200 + count)));
    let after = resident(&watch);
    watch.stop();
    print_quantiles("shared memory to store, 64 x 64", latencies(&desk.path("night.db")));
    println!("{} of {} frames, {before} MiB before, {after} MiB after", stream::counters(&desk).len(), 200 + count);
    assert_eq!(stream::counters(&desk).len(), 200 + count);
}

/// The program that is measured.
const PROGRAM: &str = env!("CARGO_BIN_EXE_cophase");

fn main() {
    latency_of_files_of_240_pixels();
    rate_of_a_stream();
}
