//! What every panel shares: the sizes of type, axes with ticks and labels, the heading of a page.

use super::axis::{Axis, Tick};
use super::canvas::{Canvas, Pen, Rect};
use super::colour::{AXIS, GRID, INK, MUTED};
use super::font::{self, Ink};

pub(super) const TITLE_EM: f64 = 34.0;
pub(super) const SUBTITLE_EM: f64 = 20.0;
pub(super) const PANEL_EM: f64 = 22.0;
const FIGURE_EM: f64 = 19.0;
pub(super) const LABEL_EM: f64 = 19.0;
pub(super) const TICK_EM: f64 = 17.0;

/// Width of the pages that hold several panels, logical pixels: nine inches at 200 dots.
pub(super) const PAGE_W: f64 = 1800.0;
pub(super) const MARGIN: f64 = 44.0;

/// Room a panel needs beside its plot: for the y axis, below for the x axis, above for its name.
pub(super) const LEFT: f64 = 86.0;
pub(super) const BELOW: f64 = 64.0;
pub(super) const ABOVE: f64 = 38.0;

const TICK_LENGTH: f64 = 6.0;
const LINE: Pen = Pen { colour: AXIS, width: 1.5, dash: None };
const GRID_LINE: Pen = Pen { colour: GRID, width: 1.5, dash: None };

/// Height of the title and `lines` of subtitle.
pub(super) fn heading_height(lines: usize) -> f64 {
    MARGIN + TITLE_EM + 8.0 + lines as f64 * SUBTITLE_EM * 1.4 + 18.0
}

/// Draws the title and the subtitle at the top of a page `page_w` wide, from `x`, where its plots
/// begin.
pub(super) fn heading(canvas: &mut Canvas, x: f64, page_w: f64, title: &str, subtitle: &[String]) {
    let room = page_w - MARGIN - x;
    let mut y = MARGIN + 0.8 * TITLE_EM;
    canvas.text((x, y), &font::fitted(title, TITLE_EM, room), Ink::new(TITLE_EM, INK));
    y += 8.0;
    for line in subtitle {
        y += SUBTITLE_EM * 1.4;
        canvas.text((x, y), &font::fitted(line, SUBTITLE_EM, room), Ink::new(SUBTITLE_EM, MUTED));
    }
}

/// The name of a panel above `plot`, and a figure at the right of the same line; the name gives
/// way.
pub(super) fn panel_title(canvas: &mut Canvas, plot: Rect, name: &str, figure: &str) {
    let y = plot.y - 13.0;
    let figure = font::fitted(figure, FIGURE_EM, plot.w);
    let taken = if figure.is_empty() { 0.0 } else { font::width(&figure, FIGURE_EM) + 14.0 };
    canvas.text((plot.x, y), &font::fitted(name, PANEL_EM, plot.w - taken), Ink::new(PANEL_EM, INK));
    canvas.text((plot.right(), y), &figure, Ink::new(FIGURE_EM, MUTED).end());
}

/// A plot: its rectangle and its two axes.
#[derive(Debug, Clone)]
pub(super) struct Frame {
    pub plot: Rect,
    pub x: Axis,
    pub y: Axis,
}

impl Frame {
    /// Where (`x`, `y`) lies on the page; held inside the plot.
    pub fn at(&self, x: f64, y: f64) -> (f64, f64) {
        (self.x_at(x), self.y_at(y))
    }

    pub fn x_at(&self, x: f64) -> f64 {
        self.plot.x + self.plot.w * self.x.fraction(x)
    }

    pub fn y_at(&self, y: f64) -> f64 {
        self.plot.bottom() - self.plot.h * self.y.fraction(y)
    }

    /// Horizontal grid lines at the ticks, to be drawn below the data.
    pub fn y_grid(&self, canvas: &mut Canvas) {
        for tick in self.y.ticks(self.y_count()) {
            let y = self.y_at(tick.value);
            canvas.line((self.plot.x, y), (self.plot.right(), y), GRID_LINE);
        }
    }

    /// Vertical grid lines at the ticks.
    pub fn x_grid(&self, canvas: &mut Canvas) {
        for tick in self.x_ticks() {
            let x = self.x_at(tick.value);
            canvas.line((x, self.plot.y), (x, self.plot.bottom()), GRID_LINE);
        }
    }

    /// The outline.
    pub fn outline(&self, canvas: &mut Canvas) {
        canvas.frame(self.plot, LINE);
    }

    /// As many ticks as leave their numbers apart, at most ten.
    fn x_ticks(&self) -> Vec<Tick> {
        let apart = |pair: &[Tick]| {
            let halves = (font::width(&pair[0].label, TICK_EM) + font::width(&pair[1].label, TICK_EM)) / 2.0;
            self.x_at(pair[1].value) - self.x_at(pair[0].value) > halves + 14.0
        };
        let most = ((self.plot.w / 50.0) as usize).clamp(3, 10);
        let fitting = (2..=most).rev().map(|count| self.x.ticks(count)).find(|ticks| ticks.windows(2).all(apart));
        fitting.unwrap_or_default()
    }

    fn y_count(&self) -> usize {
        ((self.plot.h / 46.0) as usize).max(3)
    }

    /// Ticks, numbers and label of the x axis.
    pub fn x_axis(&self, canvas: &mut Canvas, label: &str) {
        let bottom = self.plot.bottom();
        for tick in self.x_ticks() {
            let x = self.x_at(tick.value);
            x_tick(canvas, x, bottom, TICK_LENGTH);
            x_number(canvas, x, bottom, &tick.label);
        }
        for value in self.x.minor_ticks() {
            x_tick(canvas, self.x_at(value), bottom, TICK_LENGTH * 0.6);
        }
        self.x_label(canvas, label);
    }

    pub fn x_label(&self, canvas: &mut Canvas, label: &str) {
        let at = (self.plot.x + self.plot.w / 2.0, self.plot.bottom() + 51.0);
        canvas.text(at, &font::fitted(label, LABEL_EM, self.plot.w), Ink::new(LABEL_EM, INK).middle());
    }

    /// Ticks, numbers and label of the y axis.
    pub fn y_axis(&self, canvas: &mut Canvas, label: &str) {
        let x = self.plot.x;
        let mut widest: f64 = 0.0;
        for tick in self.y.ticks(self.y_count()) {
            let y = self.y_at(tick.value);
            canvas.line((x - TICK_LENGTH, y), (x, y), LINE);
            canvas.text_centred((x - TICK_LENGTH - 5.0, y), &tick.label, Ink::new(TICK_EM, INK).end());
            widest = widest.max(font::width(&tick.label, TICK_EM));
        }
        for value in self.y.minor_ticks() {
            let y = self.y_at(value);
            canvas.line((x - TICK_LENGTH * 0.6, y), (x, y), LINE);
        }
        // Numbers too long for their room push the label no further than the edge of the page.
        let left = (x - TICK_LENGTH - 5.0 - widest - 12.0).max(LABEL_EM);
        let at = (left, self.plot.y + self.plot.h / 2.0);
        canvas.text_upwards(at, &font::fitted(label, LABEL_EM, self.plot.h), Ink::new(LABEL_EM, INK).middle());
    }
}

/// A tick below the axis at `x`.
pub(super) fn x_tick(canvas: &mut Canvas, x: f64, bottom: f64, length: f64) {
    canvas.line((x, bottom), (x, bottom + length), LINE);
}

/// A number below the axis at `x`.
pub(super) fn x_number(canvas: &mut Canvas, x: f64, bottom: f64, label: &str) {
    canvas.text((x, bottom + TICK_LENGTH + 18.0), label, Ink::new(TICK_EM, INK).middle());
}
