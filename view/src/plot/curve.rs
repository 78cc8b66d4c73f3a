//! Series with error bars: residual against defocus amplitude, error against samples.

use super::axis::{Axis, usable};
use super::canvas::{Canvas, Pen, Rect};
use super::colour::{GRID, INK, MUTED, Rgb, SERIES, WHITE};
use super::font::{self, Ink};
use super::frame::{Frame, LABEL_EM, MARGIN, heading, heading_height};
use super::page;
use cophase::{Error, Result};
use std::path::Path;

/// How the points of a series are joined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Stroke {
    /// Not at all.
    None,
    /// By a line.
    #[default]
    Solid,
    /// By a dashed line.
    Dashed,
    /// By a dotted line.
    Dotted,
}

/// What stands on each point of a series.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Marker {
    /// Nothing.
    None,
    /// A disc.
    #[default]
    Disc,
    /// A ring.
    Ring,
    /// A square.
    Square,
    /// A diamond.
    Diamond,
    /// A triangle.
    Triangle,
}

/// How a series is drawn; its colour follows from its place in the list, unless one is named.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SeriesStyle {
    /// The line.
    pub stroke: Stroke,
    /// The points.
    pub marker: Marker,
    /// Number of the colour in the palette, counted round: series with one number share a colour.
    pub colour: Option<usize>,
}

/// One series: `x`, `y` and, where given, `y_err` (1σ) of one length. Points that are not finite,
/// or not positive on a logarithmic axis, are left out, and the line is broken there.
#[derive(Debug, Clone, Default)]
pub struct Series {
    /// The entry in the legend; empty for none.
    pub label: String,
    /// Abscissae.
    pub x: Vec<f64>,
    /// Ordinates.
    pub y: Vec<f64>,
    /// 1σ of the ordinates.
    pub y_err: Option<Vec<f64>>,
    /// How it is drawn.
    pub style: SeriesStyle,
}

/// A plot of series with a legend.
#[derive(Debug, Clone, Default)]
pub struct CurvePicture {
    /// One line.
    pub title: String,
    /// What x is, with its unit.
    pub x_label: String,
    /// What y is, with its unit.
    pub y_label: String,
    /// Logarithmic x.
    pub x_log: bool,
    /// Logarithmic y.
    pub y_log: bool,
    /// The series.
    pub series: Vec<Series>,
    /// Marked abscissae and what they are.
    pub vertical_lines: Vec<(f64, String)>,
    /// Marked ordinates and what they are.
    pub horizontal_lines: Vec<(f64, String)>,
}

const PAGE: (u32, u32) = (1400, 950);
const NOTE_EM: f64 = 17.0;
const SAMPLE_W: f64 = 44.0;
const ENTRY_H: f64 = 28.0;
/// More entries than this would cover the plot: the rest is counted in the last line.
const MOST_ENTRIES: usize = 16;

impl CurvePicture {
    /// Draws the picture into `path`, a `.png` or an `.svg`, whole or not at all.
    ///
    /// # Errors
    /// [`Error::Shape`] for a series whose lists differ in length, [`Error::File`] for another
    /// extension or a file that cannot be written.
    pub fn draw(&self, path: impl AsRef<Path>) -> Result<()> {
        self.series.iter().try_for_each(Series::check)?;
        let lines: Vec<Line> = self.series.iter().enumerate().map(|(i, series)| self.line(i, series)).collect();
        let frame = self.frame(&lines);
        page::draw(path.as_ref(), PAGE, |canvas| {
            heading(canvas, frame.plot.x, f64::from(PAGE.0), &self.title, &[]);
            frame.x_grid(canvas);
            frame.y_grid(canvas);
            self.marks(canvas, &frame);
            let names = self.names(&frame);
            let mut taken: Vec<(f64, f64)> = names.iter().flat_map(Name::places).collect();
            for line in &lines {
                taken.extend(line.draw(canvas, &frame));
            }
            frame.outline(canvas);
            frame.x_axis(canvas, &self.x_label);
            frame.y_axis(canvas, &self.y_label);
            let legend = Legend::new(&lines, frame.plot, &taken);
            names.iter().for_each(|name| name.draw(canvas, legend.as_ref()));
            if let Some(legend) = &legend {
                legend.draw(canvas);
            }
        })
    }

    fn drawable(&self, x: f64, y: f64) -> bool {
        let fits = |v: f64, log: bool| usable(v).is_some() && (!log || v > 0.0);
        fits(x, self.x_log) && fits(y, self.y_log)
    }

    fn line<'a>(&self, index: usize, series: &'a Series) -> Line<'a> {
        let error = |i: usize| series.y_err.as_ref().and_then(|e| usable(e[i])).map_or(0.0, f64::abs);
        let points = (0..series.x.len())
            .map(|i| self.drawable(series.x[i], series.y[i]).then(|| (series.x[i], series.y[i], error(i))))
            .collect();
        let colour = SERIES[series.style.colour.unwrap_or(index) % SERIES.len()];
        Line { label: &series.label, style: series.style, colour, points }
    }

    fn frame(&self, lines: &[Line]) -> Frame {
        let points = || lines.iter().flat_map(|line| line.points.iter().flatten());
        let marked_x = self.vertical_lines.iter().map(|(x, _)| *x);
        let marked_y = self.horizontal_lines.iter().map(|(y, _)| *y);
        // An error bar that reaches zero on a logarithmic axis is cut at the axis, not followed to
        // −∞.
        let y = points().flat_map(|&(_, y, e)| [y, y + e, if self.y_log && y - e <= y / 10.0 { y } else { y - e }]);
        let x = Axis::around(points().map(|&(x, ..)| x).chain(marked_x), self.x_log);
        // Numbers of images, of modes, of iterations.
        let x = if points().all(|(x, ..)| x.fract() == 0.0) { x.of_integers() } else { x };
        let y = Axis::around(y.chain(marked_y), self.y_log);
        let (top, left) = (heading_height(0), 130.0);
        let (w, h) = (f64::from(PAGE.0) - left - MARGIN, f64::from(PAGE.1) - top - 84.0);
        Frame { plot: Rect { x: left, y: top, w, h }, x, y }
    }

    /// The marked lines.
    fn marks(&self, canvas: &mut Canvas, frame: &Frame) {
        let pen = Pen { colour: MUTED, width: 1.5, dash: Some((9.0, 6.0)) };
        let plot = frame.plot;
        for (value, _) in self.vertical_lines.iter().filter(|(x, _)| self.drawable(*x, 1.0)) {
            let x = frame.x_at(*value);
            canvas.line((x, plot.y), (x, plot.bottom()), pen);
        }
        for (value, _) in self.horizontal_lines.iter().filter(|(y, _)| self.drawable(1.0, *y)) {
            let y = frame.y_at(*value);
            canvas.line((plot.x, y), (plot.right(), y), pen);
        }
    }

    /// The names of the marked lines.
    fn names(&self, frame: &Frame) -> Vec<Name> {
        let plot = frame.plot;
        let mut names: Vec<Name> = Vec::new();
        for (value, name) in self.vertical_lines.iter().filter(|(x, _)| self.drawable(*x, 1.0)) {
            let x = frame.x_at(*value);
            let text = font::fitted(name, NOTE_EM, plot.h - 20.0);
            // On the left of its line, unless that is outside or covered by another name.
            let near = |x: f64| names.iter().any(|name| (name.at.0 - x).abs() < NOTE_EM * 1.2);
            let side = if x - NOTE_EM * 1.3 < plot.x || near(x - 10.0) { NOTE_EM * 1.1 } else { -7.0 };
            names.push(Name { at: (x + side, plot.y + 10.0), is_upwards: true, text });
        }
        let mut named: Vec<f64> = Vec::new();
        for (value, name) in self.horizontal_lines.iter().filter(|(y, _)| self.drawable(1.0, *y)) {
            let y = frame.y_at(*value);
            let text = font::fitted(name, NOTE_EM, plot.w / 2.0);
            let baseline = if y - NOTE_EM * 1.4 < plot.y { y + NOTE_EM * 1.1 } else { y - 7.0 };
            // At the right, or at the left where the right is taken by a close line's name.
            let right = named.iter().all(|other| (other - baseline).abs() > NOTE_EM * 1.2);
            let start = if right { plot.right() - 10.0 - font::width(&text, NOTE_EM) } else { plot.x + 10.0 };
            named.push(baseline);
            names.push(Name { at: (start, baseline), is_upwards: false, text });
        }
        names
    }
}

/// The name of a marked line.
struct Name {
    /// Its upper end where it is written upwards, else its start.
    at: (f64, f64),
    is_upwards: bool,
    text: String,
}

impl Name {
    /// The points that it covers.
    fn places(&self) -> Vec<(f64, f64)> {
        let length = font::width(&self.text, NOTE_EM);
        let (x, y) = self.at;
        let place = |part: f64| {
            if self.is_upwards { (x, y + length * part) } else { (x + length * part, y - 6.0) }
        };
        (0..=10).map(|i| place(f64::from(i) / 10.0)).collect()
    }

    /// Draws it, below a legend that would cover it where it is written upwards.
    fn draw(&self, canvas: &mut Canvas, legend: Option<&Legend>) {
        let ink = Ink::new(NOTE_EM, MUTED);
        if !self.is_upwards {
            return canvas.text(self.at, &self.text, ink);
        }
        let covering = legend.filter(|legend| self.places().iter().any(|&at| legend.room.contains(at)));
        let top = covering.map_or(self.at.1, |legend| legend.room.bottom() + 10.0);
        canvas.text_upwards((self.at.0, top), &self.text, ink.end());
    }
}

impl Series {
    fn check(&self) -> Result<()> {
        let (x, y) = (self.x.len(), self.y.len());
        let errors = self.y_err.as_ref().map_or(y, Vec::len);
        if x == y && y == errors {
            return Ok(());
        }
        Err(Error::Shape(format!(
            "the series `{}` has {x} x, {y} y and {errors} y_err: each list needs one entry a point",
            self.label
        )))
    }
}

/// A series made ready: points (x, y, 1σ) that can be drawn, `None` where the line breaks.
struct Line<'a> {
    label: &'a str,
    style: SeriesStyle,
    colour: Rgb,
    points: Vec<Option<(f64, f64, f64)>>,
}

impl Line<'_> {
    fn pen(&self) -> Option<Pen> {
        let pen = Pen::solid(self.colour, 3.0);
        match self.style.stroke {
            Stroke::None => None,
            Stroke::Solid => Some(pen),
            Stroke::Dashed => Some(Pen { dash: Some((14.0, 8.0)), ..pen }),
            Stroke::Dotted => Some(Pen { dash: Some((3.0, 6.0)), ..pen }),
        }
    }

    /// Draws the series; returns the places it covers.
    fn draw(&self, canvas: &mut Canvas, frame: &Frame) -> Vec<(f64, f64)> {
        let mut covered = Vec::new();
        for &(x, y, error) in self.points.iter().flatten().filter(|p| p.2 > 0.0) {
            let (x, low, high) = (frame.x_at(x), frame.y_at(y - error), frame.y_at(y + error));
            let pen = Pen::solid(self.colour, 2.0);
            canvas.line((x, low), (x, high), pen);
            canvas.line((x - 6.0, high), (x + 6.0, high), pen);
            if low < frame.plot.bottom() {
                canvas.line((x - 6.0, low), (x + 6.0, low), pen);
            }
            covered.extend([(x, low), (x, high)]);
        }
        for piece in self.points.split(Option::is_none) {
            let piece: Vec<(f64, f64)> = piece.iter().flatten().map(|&(x, y, _)| frame.at(x, y)).collect();
            if let Some(pen) = self.pen().filter(|_| piece.len() > 1) {
                canvas.path(&piece, pen);
                covered.extend(piece.windows(2).flat_map(along));
            }
            piece.iter().for_each(|&at| marker(canvas, self.style.marker, at, self.colour));
            covered.extend(piece);
        }
        covered
    }
}

/// Places along a segment, for the legend to avoid.
fn along(pair: &[(f64, f64)]) -> impl Iterator<Item = (f64, f64)> + use<> {
    let ((x0, y0), (x1, y1)) = (pair[0], pair[1]);
    let steps = ((x1 - x0).hypot(y1 - y0) / 12.0).ceil().max(1.0);
    (0..=steps as usize).map(move |i| {
        let part = i as f64 / steps;
        (x0 + (x1 - x0) * part, y0 + (y1 - y0) * part)
    })
}

fn marker(canvas: &mut Canvas, marker: Marker, (x, y): (f64, f64), colour: Rgb) {
    match marker {
        Marker::None => {}
        Marker::Disc => canvas.disc((x, y), 6.0, colour),
        Marker::Ring => {
            canvas.disc((x, y), 6.5, colour);
            canvas.disc((x, y), 4.0, WHITE);
        }
        Marker::Square => canvas.fill(Rect { x: x - 5.5, y: y - 5.5, w: 11.0, h: 11.0 }, colour, 1.0),
        Marker::Diamond => canvas.polygon(&[(x, y - 8.0), (x + 8.0, y), (x, y + 8.0), (x - 8.0, y)], colour),
        Marker::Triangle => canvas.polygon(&[(x, y - 7.5), (x + 7.5, y + 5.5), (x - 7.5, y + 5.5)], colour),
    }
}

/// The legend, in the corner that covers the fewest of the places that are taken.
struct Legend<'a> {
    room: Rect,
    labels: Vec<String>,
    lines: Vec<&'a Line<'a>>,
}

impl<'a> Legend<'a> {
    /// `None` without a line that has a label.
    fn new(lines: &'a [Line<'a>], plot: Rect, taken: &[(f64, f64)]) -> Option<Self> {
        let mut named: Vec<&Line> = lines.iter().filter(|line| !line.label.is_empty()).collect();
        if named.is_empty() {
            return None;
        }
        let all = named.len();
        named.truncate(if all > MOST_ENTRIES { MOST_ENTRIES - 1 } else { all });
        let mut labels: Vec<String> =
            named.iter().map(|line| font::fitted(line.label, LABEL_EM, plot.w * 0.6)).collect();
        if named.len() < all {
            labels.push(format!("and {} more", all - named.len()));
        }
        let widest = labels.iter().map(|label| font::width(label, LABEL_EM)).fold(0.0, f64::max);
        let (w, h) = (widest + SAMPLE_W + 44.0, labels.len() as f64 * ENTRY_H + 16.0);
        let (left, right) = (plot.x + 16.0, plot.right() - 16.0 - w);
        let (top, bottom) = (plot.y + 16.0, plot.bottom() - 16.0 - h);
        let corners = [(right, top), (left, top), (right, bottom), (left, bottom)];
        let covers = |(x, y): (f64, f64)| {
            let room = Rect { x: x - 8.0, y: y - 8.0, w: w + 16.0, h: h + 16.0 };
            taken.iter().filter(|&&at| room.contains(at)).count()
        };
        let (x, y) = corners.into_iter().min_by_key(|&corner| covers(corner))?;
        Some(Self { room: Rect { x, y, w, h }, labels, lines: named })
    }

    fn draw(&self, canvas: &mut Canvas) {
        let Rect { x, y, .. } = self.room;
        canvas.fill(self.room, WHITE, 0.9);
        canvas.frame(self.room, Pen::solid(GRID, 1.5));
        for (i, label) in self.labels.iter().enumerate() {
            let middle = y + 8.0 + (i as f64 + 0.5) * ENTRY_H;
            if let Some(line) = self.lines.get(i) {
                let (from, to) = ((x + 14.0, middle), (x + 14.0 + SAMPLE_W, middle));
                if let Some(pen) = line.pen() {
                    canvas.line(from, to, pen);
                }
                marker(canvas, line.style.marker, ((from.0 + to.0) / 2.0, middle), line.colour);
            }
            canvas.text_centred((x + 14.0 + SAMPLE_W + 14.0, middle), label, Ink::new(LABEL_EM, INK));
        }
    }
}
