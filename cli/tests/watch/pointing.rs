//! A star that moves from frame to frame, which is no change of the wavefront.

use super::night::desk_of_a_night_with;
use super::*;
use ndarray::{Array2, Array3};
use std::f64::consts::PI;

/// Where the star of a frame is, pixels along x and y: within four of the axis, without order, at
/// all parts of a pixel.
fn place(frame: usize) -> [f64; 2] {
    [0.618, 0.414].map(|step| 8.0 * ((step * (frame as f64 + 1.0)).fract() - 0.5))
}

/// Moves an image by a part of its own spectrum: exact where its sampling shows all of it, as two
/// pixels in λ/D do. White noise stays white.
fn move_by(images: &mut Array3<f64>, [x, y]: [f64; 2]) {
    let side = images.len_of(ndarray::Axis(1));
    let kernel = |pixels: f64| {
        Array2::from_shape_fn((side, side), |(to, from)| {
            let off = to as f64 - from as f64 - pixels;
            if off.abs() < 1e-9 { 1.0 } else { (PI * off).sin() / (side as f64 * (PI * off / side as f64).tan()) }
        })
    };
    let moved = kernel(y).dot(&images.index_axis(ndarray::Axis(0), 0)).dot(&kernel(x).t());
    images.index_axis_mut(ndarray::Axis(0), 0).assign(&moved);
}

/// Kind, frame and segment of an event.
type Alarm = (String, i64, Option<i64>);

/// The events, and their sentences.
fn seen(desk: &Desk) -> (Vec<Alarm>, Vec<String>) {
    let connection = rusqlite::Connection::open(desk.path("night.db")).unwrap();
    let mut query = connection.prepare("SELECT kind, frame, segment, sentence FROM events ORDER BY id").unwrap();
    let rows = query.query_map([], |row| Ok(((row.get(0)?, row.get(1)?, row.get(2)?), row.get(3)?)));
    rows.unwrap().map(Result::unwrap).unzip()
}

#[test]
fn star_that_moves_leaves_the_alarms_of_a_still_one() {
    let still = desk_of_a_night_with(|_, _| {});
    once(&still);
    let moving = desk_of_a_night_with(|frame, images| move_by(images, place(frame)));
    let done = once(&moving);
    let ((alarms, sentences), (expected, _)) = (seen(&moving), seen(&still));
    assert!(!expected.is_empty());
    assert_eq!(alarms, expected, "{sentences:?}\n{}", done.err);
    // A number that only the detector understands is in none.
    assert!(sentences.iter().all(|sentence| !sentence.contains("statistic")), "{sentences:?}");
    let connection = rusqlite::Connection::open(moving.path("night.db")).unwrap();
    let mut query = connection
        .prepare("SELECT id, pointing_x_pixels, pointing_y_pixels, coefficients_nm, tracked_nm, warnings FROM frames ORDER BY id")
        .unwrap();
    let rows = query.query_map([], |row| {
        let numbers = |bytes: Vec<u8>| -> Vec<f64> {
            bytes.chunks_exact(8).map(|chunk| f64::from_le_bytes(chunk.try_into().unwrap())).collect()
        };
        let place = [row.get::<_, f64>(1)?, row.get::<_, f64>(2)?];
        Ok((row.get::<_, usize>(0)?, place, numbers(row.get(3)?), numbers(row.get(4)?)))
    });
    let modes: String =
        connection.query_row("SELECT value FROM about WHERE key = 'modes'", [], |row| row.get(0)).unwrap();
    let tilts = ["noll-2", "noll-3"].map(|name| modes.lines().position(|mode| mode == name).unwrap());
    let rows: Vec<_> = rows.unwrap().map(Result::unwrap).collect();
    assert_eq!(rows.len(), 20);
    // The star of the unmoved images is where the mean of the differences has it: the simulated one
    // is off the axis by its NCPA.
    let off = |axis: usize| rows.iter().map(|(id, at, ..)| at[axis] - place(id - 1)[axis]).sum::<f64>() / 20.0;
    let mean = [off(0), off(1)];
    for (id, at, coefficients_nm, tracked_nm) in &rows {
        for axis in [0, 1] {
            // A hundredth of a pixel is ten error bars of a frame of S/N 100.
            let error = at[axis] - place(id - 1)[axis] - mean[axis];
            assert!(error.abs() < 0.03, "frame {id}: {at:?} where {:?} is right, {mean:?}", place(id - 1));
            assert!(coefficients_nm[tilts[axis]].abs() < 1e-9 && tracked_nm[tilts[axis]].abs() < 1e-9);
        }
    }
}

#[test]
fn star_that_goes_elsewhere_is_a_pointing_alarm() {
    let desk = desk_of_a_night_with(|frame, images| {
        let [x, y] = place(frame);
        move_by(images, [0.05 * x + if frame < 14 { 0.0 } else { 3.0 }, 0.05 * y]);
    });
    let done = once(&desk);
    let (alarms, sentences) = seen(&desk);
    let moves: Vec<usize> = (0..alarms.len()).filter(|&at| alarms[at].0 == "pointing").collect();
    let [only] = moves[..] else { panic!("{sentences:?}\n{}", done.err) };
    // With the second or third frame that has it.
    assert!((16..=17).contains(&alarms[only].1), "{:?}", alarms[only]);
    for fact in ["star", "pixels", "x +3.0"] {
        assert!(sentences[only].contains(fact), "{}", sentences[only]);
    }
    assert!(alarms.iter().all(|(kind, frame, _)| kind == "pointing" || *frame <= 12), "{sentences:?}");
}

#[test]
fn modes_without_tilt_are_named_at_the_start() {
    let desk = desk_with_frames(1);
    put(&desk, 0);
    let without =
        [&WATCH[..], &["--once", "--set", "modes.ncpa=none", "--set", "modes.exact_zernikes=[4, 15]"]].concat();
    let done = desk.succeeds(&without);
    assert!(done.err.contains("tip and tilt") && done.err.contains("modes.exact_zernikes"), "{}", done.err);
    std::fs::remove_file(desk.path("night.db")).unwrap();
    assert!(!once(&desk).err.contains("tip and tilt"));
}
