//! One map with its axes and its colour bar.

use super::axis::{Axis, Scale, figure, usable};
use super::canvas::{Canvas, Pen, Rect};
use super::colour::{AXIS, INK, NOTHING, Rgb, Shade, WHITE};
use super::font::{self, HALF_CAPITAL, Ink};
use super::frame::{ABOVE, BELOW, Frame, LEFT, TICK_EM, panel_title};
use ndarray::ArrayView2;

/// Width of the colour bar with its numbers and the gap before it.
const BAR_ROOM: f64 = 100.0;
const BAR_GAP: f64 = 14.0;
const BAR_W: f64 = 18.0;

/// What the axes of a map count.
#[derive(Debug, Clone, Copy)]
pub(super) enum Extent {
    /// Metres from the centre of a map this wide.
    Metres(f64),
    /// Pixels from 0.
    Pixels,
}

/// A map to draw in a cell of the page. Row 0 is at the bottom: the telescope's y axis points up.
pub(super) struct MapPanel<'a> {
    pub name: String,
    /// Written at the right of the name, e.g. the RMS.
    pub figure: String,
    pub values: ArrayView2<'a, f64>,
    pub shade: Shade,
    pub extent: Extent,
    pub unit: &'a str,
    /// Words on the map: place (x, y), m from its centre, and text.
    pub labels: &'a [((f64, f64), String)],
}

/// Height of a row of map cells `width` wide, such that a square map fills it.
pub(super) fn row_height(width: f64) -> f64 {
    (width - LEFT - BAR_ROOM) + ABOVE + BELOW
}

/// Draws `panels` side by side in cells `cell_w` wide, centred on a page `page_w` wide.
pub(super) fn draw_row(canvas: &mut Canvas, panels: &[MapPanel], page_w: f64, cell_w: f64, y: f64) {
    let x = (page_w - cell_w * panels.len() as f64) / 2.0;
    for (i, panel) in panels.iter().enumerate() {
        panel.draw(canvas, Rect { x: x + i as f64 * cell_w, y, w: cell_w, h: row_height(cell_w) });
    }
}

impl MapPanel<'_> {
    /// Draws the panel in `cell`.
    pub fn draw(&self, canvas: &mut Canvas, cell: Rect) {
        let frame = self.frame(cell);
        let plot = frame.plot;
        let (rows, cols) = self.values.dim();
        if rows == 0 || cols == 0 {
            canvas.fill(plot, NOTHING, 1.0);
        } else {
            canvas.raster(plot, (rows, cols), |i, j| self.shade.colour(self.values[[rows - 1 - i, j]]));
        }
        for (place, label) in self.labels {
            let (x, y) = frame.at(place.0, place.1);
            let (half_w, half_h) = (font::width(label, TICK_EM) / 2.0 + 2.0, HALF_CAPITAL * TICK_EM + 2.0);
            // Legible on dark colours, too.
            let plate = Rect { x: x - half_w, y: y - half_h, w: 2.0 * half_w, h: 2.0 * half_h };
            canvas.fill(plate, WHITE, 0.6);
            canvas.text_centred((x, y), label, Ink::new(TICK_EM, INK).middle());
        }
        frame.outline(canvas);
        let (x_label, y_label) = match self.extent {
            Extent::Metres(_) => ("x (m)", "y (m)"),
            Extent::Pixels => ("x (pixel)", "y (pixel)"),
        };
        frame.x_axis(canvas, x_label);
        frame.y_axis(canvas, y_label);
        panel_title(canvas, plot, &self.name, &self.figure);
        self.colour_bar(canvas, plot);
    }

    /// The largest rectangle of the map's aspect in the cell, at its centre, and the coordinates of
    /// its edges.
    fn frame(&self, cell: Rect) -> Frame {
        let (rows, cols) = self.values.dim();
        let (rows, cols) = (rows.max(1) as f64, cols.max(1) as f64);
        let room = Rect { x: cell.x + LEFT, y: cell.y + ABOVE, w: cell.w - LEFT - BAR_ROOM, h: cell.h - ABOVE - BELOW };
        let pixel = (room.w / cols).min(room.h / rows);
        // A very long map is stretched rather than drawn as a line.
        let (w, h) = ((pixel * cols).max(24.0), (pixel * rows).max(24.0));
        let plot = Rect { x: (room.x + (room.w - w) / 2.0).round(), y: (room.y + (room.h - h) / 2.0).round(), w, h };
        let axis = |low, high| Axis::exact(low, high, Scale::Linear);
        let (x, y) = match self.extent {
            Extent::Metres(width) => {
                let height = width * rows / cols;
                (axis(-width / 2.0, width / 2.0), axis(-height / 2.0, height / 2.0))
            }
            Extent::Pixels => (axis(-0.5, cols - 0.5).of_integers(), axis(-0.5, rows - 0.5).of_integers()),
        };
        Frame { plot, x, y }
    }

    fn colour_bar(&self, canvas: &mut Canvas, plot: Rect) {
        // Arrows at the ends, where values lie beyond the scale, stay within the height of the map.
        const ARROW: f64 = 14.0;
        let (below, above) = self.shade.clipped();
        let top = plot.y + if above { ARROW } else { 0.0 };
        let bottom = plot.bottom() - if below { ARROW } else { 0.0 };
        let bar = Rect { x: plot.right() + BAR_GAP, y: top, w: BAR_W, h: (bottom - top).max(1.0) };
        const STEPS: usize = 256;
        canvas.raster(bar, (STEPS, 1), |i, _| self.shade.at(1.0 - i as f64 / (STEPS - 1) as f64));
        canvas.frame(bar, Pen::solid(AXIS, 1.0));
        if above {
            arrow(canvas, bar, bar.y, bar.y - ARROW + 2.0, self.shade.at(1.0));
        }
        if below {
            arrow(canvas, bar, bar.bottom(), bar.bottom() + ARROW - 2.0, self.shade.at(0.0));
        }
        let frame = Frame { plot: bar, x: Axis::exact(0.0, 1.0, Scale::Linear), y: self.shade.axis().clone() };
        for tick in self.shade.axis().ticks(((bar.h / 50.0) as usize).max(3)) {
            let y = frame.y_at(tick.value);
            canvas.line((bar.right(), y), (bar.right() + 5.0, y), Pen::solid(AXIS, 1.5));
            canvas.text_centred((bar.right() + 9.0, y), &tick.label, Ink::new(TICK_EM, INK));
        }
        canvas.text((bar.x, plot.y - 13.0), self.unit, Ink::new(TICK_EM, INK));
    }
}

fn arrow(canvas: &mut Canvas, bar: Rect, base: f64, tip: f64, colour: Rgb) {
    let corners = [(bar.x, base), (bar.x + bar.w / 2.0, tip), (bar.right(), base)];
    canvas.polygon(&corners, colour);
    canvas.path(&corners, Pen::solid(AXIS, 1.0));
}

/// RMS of the finite values about their mean: piston, which an image cannot see, does not count.
pub(super) fn rms(values: ArrayView2<f64>) -> f64 {
    let finite = || values.iter().copied().filter_map(usable);
    let count = finite().count() as f64;
    let mean = finite().map(|v| v / count).sum::<f64>();
    root_mean_square(finite().map(|v| v - mean))
}

/// √⟨v²⟩ of the finite values; NaN of none.
pub(super) fn root_mean_square(values: impl Iterator<Item = f64>) -> f64 {
    let (count, sum) = values.filter_map(usable).fold((0.0, 0.0), |(n, sum), v| (n + 1.0, sum + v * v));
    (sum / count).sqrt()
}

/// "52.3 nm RMS", or that there is nothing.
pub(super) fn rms_text(rms: f64, unit: &str) -> String {
    if usable(rms).is_some() { format!("{} {unit} RMS", figure(rms)) } else { "no finite value".into() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn rms_is_about_the_mean_of_the_finite_values() {
        assert_eq!(rms(array![[101.0, 99.0], [f64::NAN, f64::INFINITY]].view()), 1.0);
        assert!(rms(array![[f64::NAN]].view()).is_nan());
        assert_eq!(rms_text(f64::NAN, "nm"), "no finite value");
        assert_eq!(rms_text(52.34, "nm"), "52.3 nm RMS");
    }
}
