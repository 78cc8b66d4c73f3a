//! A page that is drawn once and becomes PNG or SVG.
//!
//! The drawing code works in logical pixels (`f64`, y down). The backends draw at [`SCALE`] device units per logical
//! pixel: a PNG is averaged down afterwards (so every edge is smooth), an SVG keeps them in its `viewBox`.

use super::colour::Rgb;
use super::font::{self, Anchor, Ink};
use crate::{Error, Result};
use image::ImageEncoder;
use plotters::backend::{BitMapBackend, DrawingBackend, SVGBackend};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{FontTransform, RGBAColor, RGBColor, ShapeStyle, TextStyle};
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

/// Device units per logical pixel. 2 halves the steps of a slanted line and of the glyphs' integer advances; 3 costs
/// twice the memory and shows no difference.
const SCALE: usize = 2;

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

/// How a line is drawn: colour, width in logical pixels, and the lengths of dash and gap (none: solid).
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
    let RGBColor(r, g, b) = RGBColor(colour.0, colour.1, colour.2);
    RGBAColor(r, g, b, alpha)
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
        // The bitmap rasteriser mitres sharp corners into spikes: draw the pieces, and round the joints.
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

    fn write(&mut self, (x, y): (f64, f64), text: &str, ink: Ink, upwards: bool) {
        let text = font::printable(text);
        if self.vector {
            return self.write_run((x, y), &text, ink, upwards);
        }
        let runs = font::runs(&text);
        if let [(only, 1.0, _)] = runs.as_slice() {
            return self.write_run((x, y), only, ink, upwards);
        }
        let mut along = -font::width(&text, ink.em) * ink.anchor.fraction();
        for (run, size, rise) in runs {
            let (ahead, up) = (along, rise * ink.em);
            let at = if upwards { (x - up, y - ahead) } else { (x + ahead, y - up) };
            let small = Ink { em: ink.em * size, anchor: Anchor::Start, ..ink };
            self.write_run(at, run, small, upwards);
            along += font::width(run, small.em);
        }
    }

    fn write_run(&mut self, (x, y): (f64, f64), text: &str, ink: Ink, upwards: bool) {
        let em = ink.em * SCALE as f64;
        // plotters' two backends take different sizes for one em, and each has its own idea of the top of a line;
        // both distances from top to baseline are known, so the baseline is where we want it.
        let (size, ascent) = if self.vector {
            (em * font::SVG_SIZE_PER_EM, em * font::SVG_TOP_TO_BASELINE)
        } else {
            let size = 2.0 * (em * font::LINE_PER_EM / 2.0).round();
            (size, size / 2.0)
        };
        let ascent = ascent.round() as i32;
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
        let style = font::description(size).transform(turn).color(&rgba(ink.colour, 1.0));
        let done = self.surface.text(text, &style.pos(Pos::new(h_pos, VPos::Top)), at);
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

/// Draws a page of `size` logical pixels with `paint` and writes it to `path`, whole or not at all.
///
/// # Errors
/// [`Error::File`] for an extension that is neither `png` nor `svg`, or a file that cannot be written.
pub(super) fn draw(path: &Path, size: (u32, u32), paint: impl FnOnce(&mut Canvas)) -> Result<()> {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    font::register()?;
    let bytes = match extension.as_str() {
        "png" => to_png(size, paint)?,
        "svg" => to_svg(size, paint)?,
        _ => {
            let given = if extension.is_empty() { "no extension".into() } else { format!("extension `{extension}`") };
            return Err(Error::file(path, format!("a picture with {given} is unknown: name it .png or .svg")));
        }
    };
    write_atomically(path, &bytes).map_err(|e| Error::file(path, format!("the picture cannot be written: {e}")))
}

fn paint_on(surface: &mut dyn Surface, vector: bool, paint: impl FnOnce(&mut Canvas)) -> Result<String> {
    let mut canvas = Canvas { surface, vector, images: String::new(), fault: None };
    paint(&mut canvas);
    match canvas.fault {
        None => Ok(canvas.images),
        Some(reason) => Err(Error::Internal(format!("a picture could not be drawn ({reason})"))),
    }
}

fn to_png((w, h): (u32, u32), paint: impl FnOnce(&mut Canvas)) -> Result<Vec<u8>> {
    let (wide, high) = (w as usize * SCALE, h as usize * SCALE);
    let mut fine = vec![255u8; 3 * wide * high];
    paint_on(&mut BitMapBackend::with_buffer(&mut fine, (wide as u32, high as u32)), false, paint)?;
    let mut rgb = Vec::with_capacity(fine.len() / (SCALE * SCALE));
    let samples = (SCALE * SCALE) as u32;
    for y in 0..h as usize {
        for x in 0..w as usize {
            for channel in 0..3 {
                let cell = (0..SCALE).flat_map(|v| (0..SCALE).map(move |u| (v, u)));
                let sum: u32 =
                    cell.map(|(v, u)| u32::from(fine[3 * ((y * SCALE + v) * wide + x * SCALE + u) + channel])).sum();
                rgb.push(((sum + samples / 2) / samples) as u8);
            }
        }
    }
    png(&rgb, (w, h))
}

fn png(rgb: &[u8], (w, h): (u32, u32)) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    image::codecs::png::PngEncoder::new(&mut bytes)
        .write_image(rgb, w, h, image::ColorType::Rgb8)
        .map_err(|e| Error::Internal(format!("a picture could not be encoded ({e})")))?;
    Ok(bytes)
}

fn to_svg((w, h): (u32, u32), paint: impl FnOnce(&mut Canvas)) -> Result<Vec<u8>> {
    let (wide, high) = (w * SCALE as u32, h * SCALE as u32);
    let mut drawn = String::new();
    let images = {
        let mut backend = SVGBackend::with_string(&mut drawn, (wide, high));
        let images = paint_on(&mut backend, true, paint)?;
        backend.present().map_err(|e| Error::Internal(format!("a picture could not be closed ({e})")))?;
        images
    };
    // The backend's own first line declares device units as the page size: ours keeps the viewBox, sets the page to
    // logical pixels, and lays white and the rasters under the rest.
    let body = drawn.split_once('\n').map_or("", |(_, body)| body);
    Ok(format!(
        "<svg width=\"{w}\" height=\"{h}\" viewBox=\"0 0 {wide} {high}\" xmlns=\"http://www.w3.org/2000/svg\" \
         xmlns:xlink=\"http://www.w3.org/1999/xlink\">\n<rect width=\"{wide}\" height=\"{high}\" fill=\"#FFFFFF\"/>\n\
         {images}{body}"
    )
    .into_bytes())
}

fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let word = (0..3).fold(0u32, |word, i| word << 8 | u32::from(*chunk.get(i).unwrap_or(&0)));
        for i in 0..4 {
            let digit = DIGITS[(word >> (18 - 6 * i) & 63) as usize] as char;
            text.push(if i <= chunk.len() { digit } else { '=' });
        }
    }
    text
}

fn write_atomically(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut builder = tempfile::Builder::new();
    builder.prefix(".cophase-").suffix(".tmp");
    // tempfile defaults to 0600; a picture gets what the umask allows, like any other file.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let mut file = builder.tempfile_in(folder)?;
    file.write_all(bytes)?;
    file.persist(path).map_err(|e| e.error)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_matches_the_vectors_of_rfc_4648() {
        let vectors =
            [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foob", "Zm9vYg=="), ("fooba", "Zm9vYmE=")];
        for (plain, coded) in vectors {
            assert_eq!(base64(plain.as_bytes()), coded);
        }
    }

    #[test]
    fn dashes_keep_their_rhythm_round_a_corner() {
        let pieces = dashes(&[(0.0, 0.0), (4.0, 0.0), (4.0, 4.0)], (3.0, 2.0));
        assert_eq!(pieces, [vec![(0.0, 0.0), (3.0, 0.0)], vec![(4.0, 1.0), (4.0, 4.0)]]);
    }
}
