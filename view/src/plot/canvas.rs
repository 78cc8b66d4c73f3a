//! A page that is drawn once and becomes PNG or SVG.
//!
//! The drawing code works in logical pixels (`f64`, y down). The backends draw at [`SCALE`] device
//! units per logical pixel: a PNG is averaged down afterwards (so every edge is smooth), an SVG
//! keeps them in its `viewBox`.

use super::colour::Rgb;
use super::encode::{base64, png};
use super::font::{self, Anchor, Ink};
use cophase::{Error, Result};
use plotters::backend::DrawingBackend;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{Color, FontDesc, FontFamily, FontStyle, FontTransform, RGBAColor, ShapeStyle, TextStyle};
use std::fmt::Write as _;

/// Device units per logical pixel. 2 halves the steps of a slanted line and of the glyphs' integer
/// advances; 3 costs twice the memory and shows no difference.
pub(super) const SCALE: usize = 2;

/// A rectangle in logical pixels, y down.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Rect {
    pub x: f64,
    pub y: f64,
    pub w: f64,
    pub h: f64,
}

impl Rect {
    pub fn right(&self) -> f64 {
        self.x + self.w
    }

    pub fn bottom(&self) -> f64 {
        self.y + self.h
    }

    pub fn contains(&self, (x, y): (f64, f64)) -> bool {
        x >= self.x && x <= self.right() && y >= self.y && y <= self.bottom()
    }
}

/// How a line is drawn: colour, width in logical pixels, and the lengths of dash and gap (none:
/// solid).
#[derive(Debug, Clone, Copy)]
pub(super) struct Pen {
    pub colour: Rgb,
    pub width: f64,
    pub dash: Option<(f64, f64)>,
}

impl Pen {
    pub fn solid(colour: Rgb, width: f64) -> Self {
        Self { colour, width, dash: None }
    }
}

type Point = (i32, i32);
type Outcome = std::result::Result<(), String>;

/// What we ask of a plotters backend, object-safe so that the drawing code is compiled once.
trait Surface {
    fn rect(&mut self, from: Point, to: Point, colour: RGBAColor) -> Outcome;
    fn segment(&mut self, from: Point, to: Point, colour: RGBAColor, width: u32) -> Outcome;
    fn polyline(&mut self, points: &[Point], colour: RGBAColor, width: u32) -> Outcome;
    fn polygon(&mut self, points: &[Point], colour: RGBAColor) -> Outcome;
    fn disc(&mut self, centre: Point, radius: u32, colour: RGBAColor) -> Outcome;
    fn pixel(&mut self, at: Point, colour: RGBAColor) -> Outcome;
    fn text(&mut self, text: &str, style: &TextStyle, at: Point) -> Outcome;
    fn blit(&mut self, at: Point, size: (u32, u32), rgb: &[u8]) -> Outcome;
}

impl<B: DrawingBackend> Surface for B {
    fn rect(&mut self, from: Point, to: Point, colour: RGBAColor) -> Outcome {
        self.draw_rect(from, to, &shape(colour, 1), true).map_err(|e| e.to_string())
    }

    fn segment(&mut self, from: Point, to: Point, colour: RGBAColor, width: u32) -> Outcome {
        self.draw_line(from, to, &shape(colour, width)).map_err(|e| e.to_string())
    }

    fn polyline(&mut self, points: &[Point], colour: RGBAColor, width: u32) -> Outcome {
        self.draw_path(points.iter().copied(), &shape(colour, width)).map_err(|e| e.to_string())
    }

    fn polygon(&mut self, points: &[Point], colour: RGBAColor) -> Outcome {
        self.fill_polygon(points.iter().copied(), &shape(colour, 1)).map_err(|e| e.to_string())
    }

    fn disc(&mut self, centre: Point, radius: u32, colour: RGBAColor) -> Outcome {
        self.draw_circle(centre, radius, &shape(colour, 1), true).map_err(|e| e.to_string())
    }

    fn pixel(&mut self, at: Point, colour: RGBAColor) -> Outcome {
        self.draw_pixel(at, colour.to_backend_color()).map_err(|e| e.to_string())
    }

    fn text(&mut self, text: &str, style: &TextStyle, at: Point) -> Outcome {
        self.draw_text(text, style, at).map_err(|e| e.to_string())
    }

    fn blit(&mut self, at: Point, size: (u32, u32), rgb: &[u8]) -> Outcome {
        self.blit_bitmap(at, size, rgb).map_err(|e| e.to_string())
    }
}

fn shape(colour: RGBAColor, width: u32) -> ShapeStyle {
    ShapeStyle { color: colour, filled: true, stroke_width: width }
}

fn rgba(colour: Rgb, alpha: f64) -> RGBAColor {
    RGBAColor(colour.0, colour.1, colour.2, alpha)
}

/// Nearest device unit.
fn device(v: f64) -> i32 {
    (v * SCALE as f64).round() as i32
}

/// Stroke width in device units, at least one.
fn stroke(width: f64) -> u32 {
    device(width).max(1) as u32
}

/// The page. A backend's failure is kept and reported once, at the end.
pub(super) struct Canvas<'a> {
    surface: &'a mut dyn Surface,
    vector: bool,
    /// `<image>` elements of an SVG, drawn below everything else.
    images: String,
    fault: Option<String>,
}

impl Canvas<'_> {
    fn note(&mut self, outcome: Outcome) {
        if let Err(reason) = outcome {
            self.fault.get_or_insert(reason);
        }
    }

    /// A filled rectangle.
    pub fn fill(&mut self, r: Rect, colour: Rgb, alpha: f64) {
        let (from, to) = ((device(r.x), device(r.y)), (device(r.right()), device(r.bottom())));
        let done = self.surface.rect(from, to, rgba(colour, alpha));
        self.note(done);
    }

    /// The outline of a rectangle, centred on its edges.
    pub fn frame(&mut self, r: Rect, pen: Pen) {
        let half = pen.width / 2.0;
        for y in [r.y, r.bottom()] {
            self.line((r.x - half, y), (r.right() + half, y), pen);
        }
        for x in [r.x, r.right()] {
            self.line((x, r.y), (x, r.bottom()), pen);
        }
    }

    /// A straight line; one along an axis is a crisp rectangle.
    pub fn line(&mut self, from: (f64, f64), to: (f64, f64), pen: Pen) {
        if pen.dash.is_some() || (from.0 != to.0 && from.1 != to.1) {
            return self.path(&[from, to], pen);
        }
        let half = pen.width / 2.0;
        let (x0, x1) = (from.0.min(to.0), from.0.max(to.0));
        let (y0, y1) = (from.1.min(to.1), from.1.max(to.1));
        let r = if x0 == x1 {
            Rect { x: x0 - half, y: y0, w: pen.width, h: y1 - y0 }
        } else {
            Rect { x: x0, y: y0 - half, w: x1 - x0, h: pen.width }
        };
        self.fill(r, pen.colour, 1.0);
    }

    /// A line through `points`.
    pub fn path(&mut self, points: &[(f64, f64)], pen: Pen) {
        match pen.dash {
            None => self.stroke_path(points, pen),
            Some(dash) => dashes(points, dash).iter().for_each(|piece| self.stroke_path(piece, pen)),
        }
    }

    fn stroke_path(&mut self, points: &[(f64, f64)], pen: Pen) {
        let mut points: Vec<Point> = points.iter().map(|&(x, y)| (device(x), device(y))).collect();
        points.dedup();
        let (colour, width) = (rgba(pen.colour, 1.0), stroke(pen.width));
        if self.vector {
            let done = self.surface.polyline(&points, colour, width);
            return self.note(done);
        }
        // The bitmap rasteriser mitres sharp corners into spikes: draw the pieces, and round the
        // joints.
        for pair in points.windows(2) {
            let done = self.surface.segment(pair[0], pair[1], colour, width);
            self.note(done);
        }
        if width > 2 && points.len() > 2 {
            for &joint in &points[1..points.len() - 1] {
                let done = self.surface.disc(joint, width / 2, colour);
                self.note(done);
            }
        }
    }

    /// A filled polygon.
    pub fn polygon(&mut self, points: &[(f64, f64)], colour: Rgb) {
        let points: Vec<Point> = points.iter().map(|&(x, y)| (device(x), device(y))).collect();
        let done = self.surface.polygon(&points, rgba(colour, 1.0));
        self.note(done);
    }

    /// A filled circle.
    pub fn disc(&mut self, (x, y): (f64, f64), radius: f64, colour: Rgb) {
        let done = self.surface.disc((device(x), device(y)), stroke(radius), rgba(colour, 1.0));
        self.note(done);
    }

    /// Text whose baseline starts, is centred, or ends at (`x`, `y`).
    pub fn text(&mut self, at: (f64, f64), text: &str, ink: Ink) {
        self.write(at, text, ink, false);
    }

    /// Text whose capitals are centred on `y`.
    pub fn text_centred(&mut self, (x, y): (f64, f64), text: &str, ink: Ink) {
        self.write((x, y + font::HALF_CAPITAL * ink.em), text, ink, false);
    }

    /// Text that reads upwards, its baseline at `x`.
    pub fn text_upwards(&mut self, at: (f64, f64), text: &str, ink: Ink) {
        self.write(at, text, ink, true);
    }

    fn write(&mut self, at: (f64, f64), text: &str, ink: Ink, upwards: bool) {
        let text = font::printable(text);
        if self.vector {
            self.write_element(at, &text, ink, upwards);
        } else {
            self.write_pixels(at, &text, ink, upwards);
        }
    }

    fn write_pixels(&mut self, (x, y): (f64, f64), text: &str, ink: Ink, upwards: bool) {
        let before = font::width(text, ink.em) * ink.anchor.fraction();
        let (x, y) = if upwards { (device(x), device(y + before)) } else { (device(x - before), device(y)) };
        font::rasterise(text, ink.em * SCALE as f64, |u, v, coverage| {
            let at = if upwards { (x + v, y - 1 - u) } else { (x + u, y + v) };
            // A light face loses weight when it is averaged down: its edges count a little more
            // than they cover.
            let done = self.surface.pixel(at, rgba(ink.colour, coverage.clamp(0.0, 1.0).powf(0.7)));
            self.note(done);
        });
    }

    fn write_element(&mut self, (x, y): (f64, f64), text: &str, ink: Ink, upwards: bool) {
        let em = ink.em * font::SVG_EM * SCALE as f64;
        // The backend's middle and bottom depend on the viewer's face; its top does not.
        let ascent = (em * font::SVG_TOP_TO_BASELINE).round() as i32;
        let (turn, at) = if upwards {
            (FontTransform::Rotate270, (device(x) - ascent, device(y)))
        } else {
            (FontTransform::None, (device(x), device(y) - ascent))
        };
        let h_pos = match ink.anchor {
            Anchor::Start => HPos::Left,
            Anchor::Middle => HPos::Center,
            Anchor::End => HPos::Right,
        };
        let face = FontDesc::new(FontFamily::Name(font::FAMILY), em * font::SVG_SIZE_PER_EM, FontStyle::Normal);
        let style = face.transform(turn).color(&rgba(ink.colour, 1.0)).pos(Pos::new(h_pos, VPos::Top));
        let done = self.surface.text(text, &style, at);
        self.note(done);
    }

    /// A raster over `r`, whose cell (i, j), rows from the top, is painted `colour(i, j)`.
    pub fn raster(&mut self, r: Rect, (rows, cols): (usize, usize), colour: impl Fn(usize, usize) -> Rgb) {
        let (x, y) = (device(r.x), device(r.y));
        let (w, h) = ((device(r.right()) - x).max(1) as usize, (device(r.bottom()) - y).max(1) as usize);
        let mut pixels = Vec::with_capacity(3 * w * h);
        for v in 0..h {
            for u in 0..w {
                let Rgb(red, green, blue) = colour(v * rows / h, u * cols / w);
                pixels.extend([red, green, blue]);
            }
        }
        let done = if self.vector {
            self.embed((x, y), (w as u32, h as u32), &pixels)
        } else {
            self.surface.blit((x, y), (w as u32, h as u32), &pixels)
        };
        self.note(done);
    }

    fn embed(&mut self, (x, y): Point, (w, h): (u32, u32), rgb: &[u8]) -> Outcome {
        let data = base64(&png(rgb, (w, h)).map_err(|e| e.to_string())?);
        writeln!(
            self.images,
            r#"<image x="{x}" y="{y}" width="{w}" height="{h}" style="image-rendering:pixelated" xlink:href="data:image/png;base64,{data}"/>"#
        )
        .map_err(|e| e.to_string())
    }
}

/// Cuts a line into dashes `dash.0` long, `dash.1` apart.
fn dashes(points: &[(f64, f64)], dash: (f64, f64)) -> Vec<Vec<(f64, f64)>> {
    let (mut pieces, mut piece) = (Vec::new(), points.first().copied().into_iter().collect::<Vec<_>>());
    let (mut drawing, mut left) = (true, dash.0);
    for pair in points.windows(2) {
        let ((x0, y0), (x1, y1)) = (pair[0], pair[1]);
        let length = (x1 - x0).hypot(y1 - y0);
        let mut along = 0.0;
        while length - along > left {
            along += left;
            let here = (x0 + (x1 - x0) * along / length, y0 + (y1 - y0) * along / length);
            if drawing {
                piece.push(here);
                pieces.push(std::mem::take(&mut piece));
            } else {
                piece = vec![here];
            }
            drawing = !drawing;
            left = if drawing { dash.0 } else { dash.1 };
        }
        left -= length - along;
        if drawing {
            piece.push((x1, y1));
        }
    }
    if piece.len() > 1 {
        pieces.push(piece);
    }
    pieces
}

/// Runs `paint` on a backend; returns the `<image>` elements that an SVG is to lay under the rest.
pub(super) fn paint_on<B: DrawingBackend>(
    surface: &mut B,
    vector: bool,
    paint: impl FnOnce(&mut Canvas),
) -> Result<String> {
    let mut canvas = Canvas { surface, vector, images: String::new(), fault: None };
    paint(&mut canvas);
    match canvas.fault {
        None => Ok(canvas.images),
        Some(reason) => Err(Error::Internal(format!("a picture could not be drawn ({reason})"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dashes_keep_their_rhythm_round_a_corner() {
        let pieces = dashes(&[(0.0, 0.0), (4.0, 0.0), (4.0, 4.0)], (3.0, 2.0));
        assert_eq!(pieces, [vec![(0.0, 0.0), (3.0, 0.0)], vec![(4.0, 1.0), (4.0, 4.0)]]);
    }
}
