//! The picture of the numbering, read back as a reader sees it.

use cophase_view::plot::{Lattice, NumberingPicture};
use ndarray::{Array2, array};
use std::path::{Path, PathBuf};

/// The pictures stay here after the tests, to be looked at.
fn folder() -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("plot");
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

/// Two segments, the left half and the right half of 4 by 4 samples of 1 m.
fn halves() -> NumberingPicture {
    NumberingPicture {
        title: "Two halves".into(),
        notes: vec!["Number 0 is on the left.".into()],
        amplitude: Array2::ones((4, 4)),
        owner: Array2::from_shape_fn((4, 4), |(_, x)| i32::from(x >= 2)),
        width_m: 4.0,
        segments: "2 segments, 0 to 1".into(),
        numbers_m: vec![(-1.0, 0.0), (1.0, 0.0)],
        numbers: vec!["0".into(), "1".into()],
        actuators: None,
        subapertures: None,
    }
}

/// Colour at a place (x, y) of the plot, m from the centre of a plot 4 m wide.
fn colour_at(picture: &image::RgbImage, x_m: f64, y_m: f64) -> [u8; 3] {
    // The plot is 1000 pixels wide from pixel 108 on, and 80 pixels above the lower edge.
    let bottom = f64::from(picture.height()) - 80.0;
    picture.get_pixel((108.0 + (x_m + 2.0) * 250.0) as u32, (bottom - (y_m + 2.0) * 250.0) as u32).0
}

#[test]
fn the_pupil_is_drawn_with_y_up_and_borders_between_segments() {
    let mut picture = halves();
    // No light at the largest y and the smallest x.
    picture.amplitude[[3, 0]] = 0.0;
    let path = folder().join("numbering.png");
    picture.draw(&path).unwrap();
    let drawn = image::open(&path).unwrap().to_rgb8();
    assert_eq!(drawn.width(), 1152);
    let [lit, dark] = [[0xec, 0xed, 0xef], [0x50, 0x55, 0x5b]];
    assert_eq!(colour_at(&drawn, -1.5, 1.5), dark, "the dark sample is at the upper left");
    for (x_m, y_m) in [(1.5, 1.5), (1.5, -1.5), (-1.5, -1.5)] {
        assert_eq!(colour_at(&drawn, x_m, y_m), lit, "({x_m}, {y_m})");
    }
    let border = (-3..=3).any(|pixel| colour_at(&drawn, f64::from(pixel) * 0.004, -1.5) == [0x8c, 0x92, 0x99]);
    assert!(border, "a line between the segments");
}

#[test]
fn actuators_and_subapertures_are_drawn_and_in_the_legend() {
    let mut picture = halves();
    let lattice = |name: &str, centres_m: Vec<(f64, f64)>| Some(Lattice { name: name.into(), centres_m, pitch_m: 1.0 });
    picture.actuators = lattice("2 actuators", vec![(-1.5, -1.5), (1.5, -1.5)]);
    picture.subapertures = lattice("1 subaperture in use", vec![(1.0, 1.0)]);
    let path = folder().join("numbering.svg");
    picture.draw(&path).unwrap();
    let text = std::fs::read_to_string(&path).unwrap();
    for words in ["2 segments, 0 to 1", "2 actuators", "1 subaperture in use", "x [m]", "y [m]", "Two halves"] {
        assert!(text.contains(words), "{words}");
    }
    // One more of each in the legend; a square has four sides.
    assert_eq!(text.matches("<circle").count(), 3);
    assert_eq!(text.to_lowercase().matches("fill=\"#0072b2\"").count(), 8);
}

#[test]
fn no_number_stops_a_picture_and_other_maps_are_refused() {
    let mut odd = halves();
    odd.amplitude[[0, 0]] = f64::NAN;
    odd.numbers_m = vec![(f64::NAN, f64::INFINITY), (0.0, 0.0), (0.0, 0.0)];
    odd.actuators = Some(Lattice { name: "odd".into(), centres_m: vec![(f64::NAN, 0.0)], pitch_m: f64::NAN });
    let path = folder().join("numbering-odd.svg");
    odd.draw(&path).unwrap();
    assert!(!std::fs::read_to_string(&path).unwrap().contains("NaN"));

    let sentence = |picture: NumberingPicture| picture.draw("a.png").unwrap_err().to_string();
    let refused = sentence(NumberingPicture { amplitude: array![[1.0]], ..halves() });
    assert!(refused.contains("(1, 1)") && refused.contains("4 by 4"), "{refused}");
    let refused = sentence(NumberingPicture { width_m: f64::NAN, ..halves() });
    assert!(["pupil map", "NaN m", "positive width"].iter().all(|fact| refused.contains(fact)), "{refused}");
}
