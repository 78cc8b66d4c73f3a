//! A pupil with the number of each segment, and the actuators and subapertures over it.

use super::axis::{Axis, Scale, usable};
use super::canvas::{Canvas, Pen, Rect};
use super::colour::{INK, Rgb, SERIES, WHITE};
use super::font::{self, HALF_CAPITAL, Ink};
use super::frame::{ABOVE, BELOW, Frame, LABEL_EM, LEFT, MARGIN, SUBTITLE_EM, heading, heading_height};
use super::page;
use cophase::{Error, Result};
use ndarray::Array2;
use std::path::Path;

/// Places on a square lattice: actuators, or subapertures.
#[derive(Debug, Clone)]
pub struct Lattice {
    /// What they are and how many, for the legend.
    pub name: String,
    /// Centres (x, y), m.
    pub centres_m: Vec<(f64, f64)>,
    /// Distance between neighbours, m.
    pub pitch_m: f64,
}

/// Which segment has which number, and where. Maps are `[row = y, col = x]`, row 0 at the bottom,
/// as those of an estimate.
#[derive(Debug, Clone)]
pub struct NumberingPicture {
    /// One line.
    pub title: String,
    /// Sentences below the title; long ones are broken.
    pub notes: Vec<String>,
    /// Illuminated fraction of each sample: 1 is light, 0 dark.
    pub amplitude: Array2<f64>,
    /// Segment of each sample, −1 where there is none.
    pub owner: Array2<i32>,
    /// Width of both maps, m.
    pub width_m: f64,
    /// What the segments are and how many, for the legend.
    pub segments: String,
    /// Where the number of each segment stands, (x, y), m.
    pub numbers_m: Vec<(f64, f64)>,
    /// What is written there: the number of each segment.
    pub numbers: Vec<String>,
    /// The actuators, where there is a mirror.
    pub actuators: Option<Lattice>,
    /// The subapertures in use, where there is a wavefront sensor.
    pub subapertures: Option<Lattice>,
}

const LIT: Rgb = Rgb(0xec, 0xed, 0xef);
const DARK: Rgb = Rgb(0x50, 0x55, 0x5b);
const BORDER: Rgb = Rgb(0x8c, 0x92, 0x99);
const ACTUATOR: Rgb = SERIES[1];
const SUBAPERTURE: Rgb = SERIES[0];

/// Width of a segment: four digits in it are still legible.
const SEGMENT_W: f64 = 56.0;
const LEAST_SIDE: f64 = 1000.0;
const MOST_SIDE: f64 = 2100.0;
const SMALLEST_EM: f64 = 8.0;
const LARGEST_EM: f64 = 28.0;
const LEGEND_H: f64 = 36.0;
const GAP: f64 = 16.0;

impl NumberingPicture {
    /// Draws the picture into `path`, a `.png` or an `.svg`, whole or not at all.
    ///
    /// # Errors
    /// [`Error::Shape`] for maps that are not square or differ in shape, [`Error::Value`] for an
    /// impossible width, [`Error::File`] for another extension or a file that cannot be written.
    pub fn draw(&self, path: impl AsRef<Path>) -> Result<()> {
        let (rows, columns) = self.owner.dim();
        if rows == 0 || rows != columns || self.amplitude.dim() != (rows, columns) {
            let amplitude = self.amplitude.dim();
            return Err(Error::Shape(format!(
                "the amplitude is {amplitude:?} and the map of segments {rows} by {columns}: two squares of one size are needed"
            )));
        }
        super::check_width(self.width_m, "pupil")?;
        let layout = Layout::new(self);
        page::draw(path.as_ref(), layout.page(), |canvas| self.draw_on(canvas, &layout))
    }

    fn draw_on(&self, canvas: &mut Canvas, layout: &Layout) {
        let (frame, plot) = (&layout.frame, layout.frame.plot);
        heading(canvas, plot.x, f64::from(layout.page().0), &self.title, &layout.notes);
        self.legend(canvas, plot);
        let pixels = plot.w as usize;
        canvas.raster(plot, (pixels, pixels), |i, j| self.colour(frame, i, j));
        if let Some(subapertures) = &self.subapertures {
            outlines(canvas, frame, subapertures);
        }
        for (number, &at) in self.numbers.iter().zip(&self.numbers_m) {
            canvas.fill(layout.plate(number, at), WHITE, 0.75);
        }
        if let Some(actuators) = &self.actuators {
            dots(canvas, frame, actuators);
        }
        for (&(x, y), number) in self.numbers_m.iter().zip(&self.numbers) {
            canvas.text_centred(frame.at(x, y), number, Ink::new(layout.number_em, INK).middle());
        }
        frame.outline(canvas);
        frame.x_axis(canvas, "x [m]");
        frame.y_axis(canvas, "y [m]");
        arrows(canvas, plot);
    }

    /// Half the width of the plot, m: the maps, and what lies beyond them.
    fn half_width_m(&self) -> f64 {
        let lattices = [&self.actuators, &self.subapertures].into_iter().flatten();
        let reach = |lattice: &Lattice| {
            let largest = lattice.centres_m.iter().map(|(x, y)| x.abs().max(y.abs())).fold(0.0, f64::max);
            largest + lattice.pitch_m / 2.0
        };
        lattices.map(reach).filter_map(usable).fold(self.width_m / 2.0, f64::max)
    }

    /// Colour of pixel (i, j) of the plot, rows from the top: the amplitude in grey, and a line
    /// where the segment is another than in the pixel above or on the left.
    fn colour(&self, frame: &Frame, i: usize, j: usize) -> Rgb {
        let Some(sample) = self.sample(frame, i, j) else { return DARK };
        let here = self.owner[sample];
        let is_other = |i: usize, j: usize| {
            self.sample(frame, i, j).is_some_and(|sample| self.owner[sample] >= 0 && self.owner[sample] != here)
        };
        if here >= 0 && ((i > 0 && is_other(i - 1, j)) || (j > 0 && is_other(i, j - 1))) {
            return BORDER;
        }
        let part = usable(self.amplitude[sample]).unwrap_or(0.0).clamp(0.0, 1.0);
        let mix = |dark: u8, lit: u8| (f64::from(dark) + (f64::from(lit) - f64::from(dark)) * part).round() as u8;
        Rgb(mix(DARK.0, LIT.0), mix(DARK.1, LIT.1), mix(DARK.2, LIT.2))
    }

    /// Sample `(row, column)` of the maps below pixel (i, j) of the plot, rows from the top.
    fn sample(&self, frame: &Frame, i: usize, j: usize) -> Option<(usize, usize)> {
        let pixel_m = (frame.x.high() - frame.x.low()) / frame.plot.w;
        let n = self.owner.nrows();
        let index = |c_m: f64| {
            let index = ((c_m / self.width_m + 0.5) * n as f64).floor();
            (index >= 0.0 && index < n as f64).then_some(index as usize)
        };
        let (x_m, y_m) = (frame.x.low() + (j as f64 + 0.5) * pixel_m, frame.y.high() - (i as f64 + 0.5) * pixel_m);
        Some((index(y_m)?, index(x_m)?))
    }

    /// What is drawn and how many, in a line above `plot`.
    fn legend(&self, canvas: &mut Canvas, plot: Rect) {
        const SYMBOL_W: f64 = 30.0;
        let y = plot.y - ABOVE - LEGEND_H / 2.0;
        let (mut x, mut symbols) = (plot.x, Vec::new());
        let lattice = |lattice: &Option<Lattice>| lattice.as_ref().map(|lattice| lattice.name.clone());
        let names = [Some(self.segments.clone()), lattice(&self.actuators), lattice(&self.subapertures)];
        for (kind, name) in names.into_iter().enumerate().filter_map(|(kind, name)| Some((kind, name?))) {
            canvas.text_centred((x + SYMBOL_W, y), &name, Ink::new(LABEL_EM, INK));
            symbols.push((kind, x + 11.0));
            x += SYMBOL_W + font::width(&name, LABEL_EM) + 34.0;
        }
        for (kind, x) in symbols {
            let square = |half: f64| Rect { x: x - half, y: y - half, w: 2.0 * half, h: 2.0 * half };
            match kind {
                0 => {
                    canvas.fill(square(11.0), LIT, 1.0);
                    canvas.frame(square(11.0), Pen::solid(BORDER, 1.0));
                    canvas.text_centred((x, y), "0", Ink::new(LABEL_EM, INK).middle());
                }
                1 => canvas.disc((x, y), 4.0, ACTUATOR),
                _ => canvas.frame(square(9.0), Pen::solid(SUBAPERTURE, 1.0)),
            }
        }
    }
}

/// Where things stand on the page.
struct Layout {
    frame: Frame,
    /// The notes, in lines.
    notes: Vec<String>,
    number_em: f64,
}

impl Layout {
    fn new(picture: &NumberingPicture) -> Self {
        let half_m = picture.half_width_m();
        // A lone segment is about the plot.
        let pitch_m = nearest_m(&picture.numbers_m).unwrap_or(half_m);
        let side = (SEGMENT_W * 2.0 * half_m / pitch_m).clamp(LEAST_SIDE, MOST_SIDE).round();
        let notes: Vec<String> = picture.notes.iter().flat_map(|note| font::lines(note, SUBTITLE_EM, side)).collect();
        let top = (heading_height(notes.len()) + LEGEND_H + ABOVE).round();
        let axis = Axis::exact(-half_m, half_m, Scale::Linear);
        let plot = Rect { x: MARGIN / 2.0 + LEFT, y: top, w: side, h: side };
        let digits = picture.numbers.iter().map(String::len).max().unwrap_or(1);
        let pitch = pitch_m / (2.0 * half_m) * side;
        let fitting = (0.6 * pitch / font::width(&"8".repeat(digits), 1.0)).min(0.5 * pitch);
        let number_em = fitting.clamp(SMALLEST_EM, LARGEST_EM);
        Self { frame: Frame { plot, x: axis.clone(), y: axis }, notes, number_em }
    }

    /// Size of the page.
    fn page(&self) -> (u32, u32) {
        let plot = self.frame.plot;
        ((plot.right() + MARGIN) as u32, (plot.bottom() + BELOW + GAP) as u32)
    }

    /// The light rectangle behind a number at (x, y), m.
    fn plate(&self, number: &str, (x, y): (f64, f64)) -> Rect {
        let margin = 0.15 * self.number_em;
        let (x, y) = self.frame.at(x, y);
        let w = font::width(number, self.number_em) + 2.0 * margin;
        let h = 2.0 * (HALF_CAPITAL * self.number_em + margin);
        Rect { x: x - w / 2.0, y: y - h / 2.0, w, h }
    }
}

/// Distance between the two nearest of `points`, m; `None` of fewer than two.
fn nearest_m(points: &[(f64, f64)]) -> Option<f64> {
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut nearest = f64::INFINITY;
    for (i, a) in sorted.iter().enumerate() {
        for b in &sorted[i + 1..] {
            if b.0 - a.0 >= nearest {
                break;
            }
            nearest = nearest.min((b.0 - a.0).hypot(b.1 - a.1));
        }
    }
    usable(nearest)
}

/// Squares round the centres.
fn outlines(canvas: &mut Canvas, frame: &Frame, lattice: &Lattice) {
    let half_m = lattice.pitch_m / 2.0;
    for &(x, y) in &lattice.centres_m {
        let ((left, top), (right, bottom)) = (frame.at(x - half_m, y + half_m), frame.at(x + half_m, y - half_m));
        canvas.frame(Rect { x: left, y: top, w: right - left, h: bottom - top }, Pen::solid(SUBAPERTURE, 1.0));
    }
}

/// Dots at the centres, smaller than their distance.
fn dots(canvas: &mut Canvas, frame: &Frame, lattice: &Lattice) {
    let pitch = lattice.pitch_m / (frame.x.high() - frame.x.low()) * frame.plot.w;
    let radius = (pitch / 8.0).clamp(1.0, 4.0);
    lattice.centres_m.iter().for_each(|&(x, y)| canvas.disc(frame.at(x, y), radius, ACTUATOR));
}

/// Arrows beyond the ends of the axes of `plot`: where x and y grow.
fn arrows(canvas: &mut Canvas, plot: Rect) {
    let (pen, ink) = (Pen::solid(INK, 2.0), Ink::new(LABEL_EM, INK));
    let (right, bottom) = (plot.right(), plot.bottom());
    canvas.line((right, bottom), (right + 22.0, bottom), pen);
    canvas.polygon(&[(right + 32.0, bottom), (right + 20.0, bottom - 6.0), (right + 20.0, bottom + 6.0)], INK);
    canvas.text((right + 12.0, bottom - 12.0), "x", ink);
    let (left, top) = (plot.x, plot.y);
    canvas.line((left, top - 22.0), (left, top), pen);
    canvas.polygon(&[(left, top - 32.0), (left - 6.0, top - 20.0), (left + 6.0, top - 20.0)], INK);
    canvas.text((left + 12.0, top - 14.0), "y", ink);
}

#[cfg(test)]
mod tests {
    use super::*;
    use cophase::Scene;
    use cophase::pupil::Grid;
    use cophase::telescope::Telescope;

    /// A picture of rings of hexagons.
    fn hexagons(rings: &str, central: &str) -> NumberingPicture {
        let settings = [("pupil.rings", rings), ("pupil.central_segment", central), ("pupil.grid_m", "")];
        let scene = Scene::preset("keck-artificial").unwrap().with(&settings).unwrap();
        let telescope = Telescope::new(&scene).unwrap();
        let width_m = telescope.pupil.grid.width_m();
        let pupil = telescope.pupil_on(Grid::new(1200, width_m).unwrap()).unwrap();
        NumberingPicture {
            title: String::new(),
            notes: vec!["a note ".repeat(100)],
            numbers_m: pupil.segments.iter().map(|segment| (segment.x_m, segment.y_m)).collect(),
            numbers: (0..pupil.segments.len()).map(|number| number.to_string()).collect(),
            amplitude: pupil.amplitude,
            owner: pupil.owner,
            width_m,
            segments: String::new(),
            actuators: None,
            subapertures: None,
        }
    }

    #[test]
    fn every_number_is_legible_and_within_its_own_segment() {
        for (rings, central, segments, least_em) in
            [("3", "false", 36, 28.0), ("13", "false", 546, 18.0), ("16", "true", 817, 18.0), ("30", "true", 2791, 8.0)]
        {
            let picture = hexagons(rings, central);
            let layout = Layout::new(&picture);
            assert_eq!(picture.numbers_m.len(), segments);
            assert!(layout.number_em >= least_em, "{segments}: {}", layout.number_em);
            assert!(layout.page().0 <= 2400 && layout.notes.len() > 1);
            let plot = layout.frame.plot;
            for (number, &at) in picture.numbers_m.iter().enumerate() {
                let plate = layout.plate(&picture.numbers[number], at);
                for (x, y) in [
                    (plate.x, plate.y),
                    (plate.right(), plate.y),
                    (plate.x, plate.bottom()),
                    (plate.right(), plate.bottom()),
                ] {
                    let sample = picture.sample(&layout.frame, (y - plot.y) as usize, (x - plot.x) as usize).unwrap();
                    assert_eq!(picture.owner[sample], number as i32, "{segments} segments");
                }
            }
        }
    }

    #[test]
    fn points_beyond_the_maps_are_within_the_plot() {
        let mut picture = hexagons("1", "true");
        let far_m = picture.width_m;
        picture.actuators = Some(Lattice { name: "1 actuator".into(), centres_m: vec![(far_m, 0.0)], pitch_m: 1.0 });
        let layout = Layout::new(&picture);
        assert_eq!(layout.frame.x.high(), far_m + 0.5);
        // The pixels there have no sample.
        assert_eq!(picture.sample(&layout.frame, 500, 999), None);
        assert_eq!(picture.colour(&layout.frame, 500, 999), DARK);
    }

    #[test]
    fn the_nearest_points_are_found() {
        assert_eq!(nearest_m(&[(0.0, 0.0), (5.0, 0.0), (0.5, 9.0), (5.0, 2.0)]), Some(2.0));
        assert_eq!(nearest_m(&[(0.0, 0.0)]), None);
    }
}
