//! A night: what is tracked, what is an alarm, and what is exported.

use super::*;
use cophase::io::FitsReader;
use ndarray::Array3;
use std::time::SystemTime;

/// A frame every 10 s from files of one image each; the time of a file is that of its last change.
fn put_at(desk: &Desk, made: &str, number: usize) {
    let path = desk.path(&format!("frames/{number:03}.fits"));
    std::fs::copy(desk.path(made), &path).unwrap();
    let time = SystemTime::UNIX_EPOCH + Duration::from_secs(1_795_579_200 + 10 * number as u64);
    std::fs::File::options().write(true).open(&path).unwrap().set_modified(time).unwrap();
}

/// Ten frames, and ten more after all segments have moved by half of their errors: the pattern is
/// that of the seed, 60 nm RMS and then 90.
pub fn desk_of_a_night() -> Desk {
    desk_of_a_night_with(|_, _| {})
}

/// The same, where `edit` changes the image of each frame.
pub fn desk_of_a_night_with(edit: impl Fn(usize, &mut Array3<f64>)) -> Desk {
    let desk = Desk::with_images(&["image.count=10"]);
    std::fs::create_dir(desk.path("frames")).unwrap();
    let set = ["--set", "image.count=10", "--set", "aberrations.segment_piston_rms_nm=90"];
    desk.succeeds(&[&["image", "scene.toml", "-o", "moved.fits"], &set[..]].concat());
    for (part, images) in ["images.fits", "moved.fits"].into_iter().enumerate() {
        for number in 0..10 {
            // The scene of the second file says what it was made with, which is not what is
            // estimated.
            desk.edit_images(images, "one.fits", |images| {
                *images = images.slice(ndarray::s![number..number + 1, .., ..]).to_owned();
                edit(10 * part + number, images);
            });
            put_at(&desk, "one.fits", 10 * part + number);
        }
    }
    desk
}

#[test]
fn a_mirror_that_moves_is_an_alarm_and_one_that_rests_is_none() {
    let desk = desk_of_a_night();
    let done = once(&desk);
    let connection = rusqlite::Connection::open(desk.path("night.db")).unwrap();
    let query = "SELECT kind, frame, size_nm, size_error_nm, since_s, sentence FROM events ORDER BY id";
    let mut query = connection.prepare(query).unwrap();
    let found: Vec<(String, i64, f64, f64, f64, String)> = query
        .query_map([], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?, row.get(4)?, row.get(5)?)))
        .unwrap()
        .map(Result::unwrap)
        .collect();
    assert!(!found.is_empty(), "{}", done.err);
    // Of twenty files without a card of their time.
    assert_eq!(done.err.matches("no card has the time of the observation").count(), 1, "{}", done.err);
    for (kind, frame, size_nm, error_nm, since_s, sentence) in &found {
        assert!(kind == "segment" || kind == "wavefront", "{sentence}");
        // Not before frame 11, the first after the step; a step of 15 to 60 nm is ten error bars,
        // so that two frames prove it.
        assert!((11..=12).contains(frame), "{sentence}");
        assert!(size_nm.abs() > 3.0 * error_nm && *error_nm > 0.0, "{sentence}");
        assert!((1_795_579_300.0..=1_795_579_310.0).contains(since_s), "{sentence}");
        assert!(done.err.contains(sentence), "{sentence}");
    }
    // The tracked state has the step: it is nearer to the mean of the second ten than a single
    // frame is expected to be.
    let file = |column: &str, id: usize| -> Vec<f64> {
        let query = format!("SELECT {column} FROM frames WHERE id = {id}");
        let bytes: Vec<u8> = connection.query_row(&query, [], |row| row.get(0)).unwrap();
        bytes.chunks_exact(8).map(|chunk| f64::from_le_bytes(chunk.try_into().unwrap())).collect()
    };
    let (tracked, sigma) = (file("tracked_nm", 20), file("sigma_nm", 20));
    let singles: Vec<Vec<f64>> = (11..=20).map(|id| file("coefficients_nm", id)).collect();
    let squares = (0..tracked.len()).map(|mode| {
        let mean = singles.iter().map(|single| single[mode]).sum::<f64>() / 10.0;
        ((tracked[mode] - mean) / sigma[mode].max(1e-3)).powi(2)
    });
    let distance = (squares.sum::<f64>() / tracked.len() as f64).sqrt();
    assert!(distance < 1.0, "{distance} error bars of a single frame");
}

#[test]
fn a_night_in_two_watches_is_tracked_as_in_one() {
    let desk = desk_of_a_night();
    std::fs::create_dir(desk.path("later")).unwrap();
    for number in 7..20 {
        let name = format!("{number:03}.fits");
        std::fs::rename(desk.path(&format!("frames/{name}")), desk.path(&format!("later/{name}"))).unwrap();
    }
    once(&desk);
    for number in 7..20 {
        let name = format!("{number:03}.fits");
        std::fs::rename(desk.path(&format!("later/{name}")), desk.path(&format!("frames/{name}"))).unwrap();
    }
    once(&desk);
    let two = (rows(&desk.path("night.db")), events(&desk.path("night.db")), tracked(&desk));
    std::fs::remove_file(desk.path("night.db")).unwrap();
    once(&desk);
    assert_eq!((rows(&desk.path("night.db")), events(&desk.path("night.db")), tracked(&desk)), two);
}

/// State of the tracker, and the tracked coefficients of every frame.
fn tracked(desk: &Desk) -> Vec<Vec<u8>> {
    let connection = rusqlite::Connection::open(desk.path("night.db")).unwrap();
    let query =
        "SELECT tracked_nm FROM (SELECT tracked_nm FROM frames ORDER BY id) UNION ALL SELECT state FROM tracker";
    let mut query = connection.prepare(query).unwrap();
    query.query_map([], |row| row.get(0)).unwrap().map(Result::unwrap).collect()
}

#[test]
fn a_night_is_exported_as_a_table_and_as_fits() {
    let desk = desk_with_frames(2);
    (0..2).for_each(|number| put(&desk, number));
    std::fs::write(desk.path("frames/zz, \"odd\".fits"), "no FITS file\n").unwrap();
    once(&desk);
    // While a watch has the store.
    let mut watch = Running::start(&desk, &[]);
    let export = |output: &str| desk.succeeds(&["watch", "--export", output, "--state", "night.db"]);
    assert!(export("night.csv").out.contains("night.csv: 3 frames"));
    export("night.fits");
    export("night.html");
    watch.stop();
    let report = std::fs::read_to_string(desk.path("night.html")).unwrap();
    // The odd name, escaped, with the reason; nothing that a browser would ask for.
    assert!(report.contains("zz, &quot;odd&quot;.fits") && report.contains("<h2>Alarms</h2>"), "{report}");
    assert!(!report.contains("<script") && !report.contains("http") && !report.contains("<img"), "{report}");
    assert_eq!((report.matches("<polygon").count(), report.matches("class=\"dot\"").count()), (7, 12));
    let table = std::fs::read_to_string(desk.path("night.csv")).unwrap();
    let lines: Vec<&str> = table.split_terminator("\r\n").collect();
    assert_eq!(lines.len(), 4);
    let columns: Vec<&str> = lines[0].split(',').collect();
    let place = |name: &str| columns.iter().position(|column| *column == name).unwrap();
    let cells: Vec<&str> = lines[1].split(',').collect();
    assert_eq!((cells.len(), cells[place("status")]), (columns.len(), "done"));
    let from_table: f64 = cells[place("noll-4_nm")].parse().unwrap();
    assert!(lines[3].contains("zz, \"\"odd\"\".fits\"") && lines[3].contains("refused"), "{}", lines[3]);
    let mut file = FitsReader::open(desk.path("night.fits")).unwrap();
    assert_eq!(file.text_column("FRAMES", "STATUS").unwrap(), ["done", "done", "refused"]);
    let modes = file.text_column("MODES", "NAME").unwrap();
    let mode = modes.iter().position(|name| name == "noll-4").unwrap();
    let coefficients = file.map(Some("COEFFICIENTS")).unwrap();
    assert_eq!(coefficients.dim(), (3, modes.len()));
    // Text of the table gives the number back.
    assert_eq!(coefficients[[0, mode]], from_table);
    assert!(coefficients[[2, mode]].is_nan());
    for hdu in ["SIGMA", "TRACKED", "TRACKED_SIGMA"] {
        assert_eq!(file.map(Some(hdu)).unwrap().dim(), (3, modes.len()));
    }
    assert!(file.has("EVENTS") && file.has("SCENE"));
    let bad = ["watch", "--export", "night.txt", "--state", "night.db"];
    desk.run(&bad).failed(&bad, &["night.txt", ".csv", ".html"]);
    // A report that was there stays where there is nothing to write.
    let none = ["watch", "--export", "night.html", "--state", "other.db"];
    desk.run(&none).failed(&none, &["other.db", "does not exist"]);
    assert_eq!(std::fs::read_to_string(desk.path("night.html")).unwrap(), report);
    let missing = ["watch", "--export", "new.csv", "--state", "other.db"];
    desk.run(&missing).failed(&missing, &["other.db", "does not exist"]);
}
