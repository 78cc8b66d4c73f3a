//! The picture: error against time, the points that nothing beats, and the bound.

use super::point::Point;
use cophase_view::plot::{CurvePicture, Marker, Series, SeriesStyle, Stroke};

/// Markers of the devices, in turn.
const MARKERS: [Marker; 5] = [Marker::Disc, Marker::Square, Marker::Diamond, Marker::Triangle, Marker::Ring];

/// The points than which no other is both faster and better, from the fastest on.
pub fn pareto(points: &[Point]) -> Vec<&Point> {
    let mut sorted: Vec<&Point> = points.iter().filter(|point| point.error_nm().is_finite()).collect();
    sorted.sort_by(|a, b| {
        let by_time = a.estimate.median_s.total_cmp(&b.estimate.median_s);
        by_time.then(a.error_nm().total_cmp(&b.error_nm()))
    });
    let mut best = f64::INFINITY;
    sorted.retain(|point| {
        let better = point.error_nm() < best;
        best = best.min(point.error_nm());
        better
    });
    sorted
}

/// Error against µs per image, both logarithmic: a series for each device, precision, batch and
/// optimizer, with the quartiles of its times; the front as a line; the bound of the model with
/// most samples.
pub fn picture(points: &[Point]) -> CurvePicture {
    let mut names: Vec<String> = Vec::new();
    for point in points {
        let name = name(point);
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let mut devices: Vec<&str> = points.iter().map(|point| point.device.as_str()).collect();
    devices.dedup();
    devices.sort();
    devices.dedup();
    let mut series = vec![front(points)];
    for (colour, label) in names.iter().enumerate() {
        let chosen: Vec<&Point> = points.iter().filter(|point| &name(point) == label).collect();
        let device = devices.iter().position(|device| *device == chosen[0].device).unwrap_or(0);
        let style = SeriesStyle { stroke: Stroke::None, marker: MARKERS[device % MARKERS.len()], colour: Some(colour) };
        series.push(quartiles(&chosen, colour));
        series.push(one(label.clone(), &chosen, style));
    }
    // Unseen: room for the legend beside the points.
    let least = points.iter().map(|point| 1e6 * point.estimate.lower_s).fold(f64::INFINITY, f64::min);
    let most = points.iter().map(Point::error_nm).fold(0.0, f64::max);
    let unseen = SeriesStyle { stroke: Stroke::None, marker: Marker::None, colour: None };
    series.push(Series { x: vec![0.3 * least], y: vec![most], style: unseen, ..Default::default() });
    let bound = points.iter().max_by_key(|point| (point.samples, point.pixels));
    CurvePicture {
        title: "Error against time, image by image and in batches".into(),
        x_label: "time of an estimate (µs per image)".into(),
        y_label: "error of segments and NCPA together (nm RMS)".into(),
        x_log: true,
        y_log: true,
        series,
        horizontal_lines: bound
            .map(|point| (point.bound_nm[0].hypot(point.bound_nm[1]), "Cramér-Rao bound".into()))
            .into_iter()
            .collect(),
        ..Default::default()
    }
}

/// What a point's series is called.
fn name(point: &Point) -> String {
    let batch = if point.batch == 1 { "one image".into() } else { format!("batches of {}", point.batch) };
    let optimizer = if point.optimizer == "gauss-newton" { String::new() } else { format!(", {}", point.optimizer) };
    format!("{} {}, {batch}{optimizer}", point.device, point.precision)
}

fn front(points: &[Point]) -> Series {
    let style = SeriesStyle { stroke: Stroke::Dashed, marker: Marker::None, colour: Some(6) };
    one("Pareto front".into(), &pareto(points), style)
}

fn one(label: String, points: &[&Point], style: SeriesStyle) -> Series {
    let x = points.iter().map(|point| 1e6 * point.estimate.median_s).collect();
    let y = points.iter().map(|point| point.error_nm()).collect();
    Series { label, x, y, style, ..Default::default() }
}

/// From the lower to the upper quartile of each point's times: lines with nothing between one and
/// the next.
fn quartiles(points: &[&Point], colour: usize) -> Series {
    let ends = |point: &Point| [1e6 * point.estimate.lower_s, 1e6 * point.estimate.upper_s, f64::NAN];
    let style = SeriesStyle { stroke: Stroke::Solid, marker: Marker::None, colour: Some(colour) };
    Series {
        x: points.iter().flat_map(|point| ends(point)).collect(),
        y: points.iter().flat_map(|point| [point.error_nm(); 3]).collect(),
        style,
        ..Default::default()
    }
}
