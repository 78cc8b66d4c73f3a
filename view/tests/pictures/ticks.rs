//! Ticks of the axes of curves, read back from the picture.

use cophase_view::plot::{CurvePicture, Series, SeriesStyle};
use std::path::{Path, PathBuf};

/// The pictures stay here after the tests, to be looked at.
fn folder() -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("plot");
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

/// The numbers in the texts of the picture of residuals of 0.25 and 0.31 nm against `x`.
fn numbers(name: &str, x: &[f64]) -> Vec<f64> {
    let y = (0..x.len()).map(|point| 0.25 + 0.06 * (point % 2) as f64).collect();
    let series = Series { label: "phasing".into(), x: x.to_vec(), y, y_err: None, style: SeriesStyle::default() };
    let picture = CurvePicture {
        title: "Residual".into(),
        x_label: "iteration".into(),
        y_label: "residual (nm)".into(),
        series: vec![series],
        ..Default::default()
    };
    let path = folder().join(format!("ticks-{name}.svg"));
    picture.draw(&path).unwrap();
    let svg = std::fs::read_to_string(&path).unwrap();
    let texts = svg.split('>').filter_map(|piece| piece.split_once("</text").map(|(text, _)| text.trim().to_string()));
    texts.filter_map(|text| text.replace('−', "-").parse().ok()).collect()
}

#[test]
fn curves_over_integers_have_ticks_at_integers() {
    for (name, x) in
        [("two", &[1.0, 2.0][..]), ("four", &[1.0, 2.0, 3.0, 4.0]), ("images", &[1.0, 10.0, 25.0, 40.0, 75.0])]
    {
        // Residuals are below 1 and iterations are not.
        let ticks: Vec<f64> = numbers(name, x).into_iter().filter(|number| number.abs() >= 0.9).collect();
        assert!(ticks.len() >= 2 && ticks.iter().all(|tick| tick.fract() == 0.0), "{name}: {ticks:?}");
    }
    // Other numbers have ticks between.
    let ticks = numbers("fractions", &[1.0, 1.3, 2.0]);
    assert!(ticks.iter().any(|tick| *tick > 0.9 && tick.fract() != 0.0), "{ticks:?}");
}
