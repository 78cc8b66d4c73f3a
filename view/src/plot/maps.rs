//! A grid of captioned maps.

use super::canvas::Rect;
use super::colour::Shade;
use super::frame::{LEFT, MARGIN, PAGE_W, heading, heading_height};
use super::page;
use super::panel::{Extent, MapPanel, row_height};
use cophase::{Error, Result};
use ndarray::Array2;
use std::path::Path;

/// How the values of a map become colours.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MapScale {
    /// Blue to red, symmetric about a white zero: wavefronts, differences.
    Diverging,
    /// The same, on one scale for all maps of the picture that ask for it.
    SharedDiverging,
    /// From zero up: amplitudes, error maps.
    Sequential,
    /// asinh: images of stars.
    Stretched,
}

/// One map of a grid, `[row = y, col = x]`, row 0 at the bottom; NaN where there is nothing.
#[derive(Debug, Clone)]
pub struct CaptionedMap {
    /// Written above the map.
    pub caption: String,
    /// The values.
    pub values: Array2<f64>,
    /// Their unit, written above the colour bar.
    pub unit: String,
    /// Width of the map in metres; its axes count pixels where there is none.
    pub width_m: Option<f64>,
    /// How the values become colours.
    pub scale: MapScale,
    /// Words on the map: place (x, y), m from its centre, and text.
    pub labels: Vec<((f64, f64), String)>,
}

/// A grid of captioned maps, `columns` a row.
#[derive(Debug, Clone)]
pub struct MapsPicture {
    /// One line.
    pub title: String,
    /// Maps in a row, 1 to 8.
    pub columns: usize,
    /// The maps, row by row.
    pub maps: Vec<CaptionedMap>,
}

const GAP: f64 = 20.0;
/// Beyond eight columns a map is narrower than its colour bar.
const MOST_COLUMNS: usize = 8;
/// Taller pages need gigabytes to draw, and viewers refuse them.
const MOST_HEIGHT: f64 = 20_000.0;
/// A lone map is no larger than this.
const WIDEST_CELL: f64 = 900.0;

impl MapsPicture {
    /// Draws the picture into `path`, a `.png` or an `.svg`, whole or not at all.
    ///
    /// # Errors
    /// [`Error::Value`] for a number of columns out of range, an impossible width or too many maps
    /// for one page, [`Error::File`] for another extension or a file that cannot be written.
    pub fn draw(&self, path: impl AsRef<Path>) -> Result<()> {
        if !(1..=MOST_COLUMNS).contains(&self.columns) {
            let given = self.columns;
            return Err(Error::Value(format!("{given} columns of maps do not fit a page: 1 to {MOST_COLUMNS} do")));
        }
        for map in &self.maps {
            super::check_width(map.width_m.unwrap_or(1.0), &map.caption)?;
        }
        let sharing = self.maps.iter().filter(|map| map.scale == MapScale::SharedDiverging);
        let shared = Shade::diverging(&sharing.map(|map| map.values.view()).collect::<Vec<_>>(), 0.0);
        let panels: Vec<MapPanel> = self.maps.iter().map(|map| map.panel(&shared)).collect();
        let cell_w = ((PAGE_W - MARGIN) / self.columns as f64).min(WIDEST_CELL);
        let page_w = cell_w * self.columns as f64 + MARGIN;
        let heading_h = heading_height(0);
        let row_h = row_height(cell_w) + GAP;
        let height = heading_h + row_h * panels.len().div_ceil(self.columns) as f64 + GAP;
        if height > MOST_HEIGHT {
            let (maps, columns) = (panels.len(), self.columns);
            return Err(Error::Value(format!(
                "{maps} maps in {columns} columns need a page {height:.0} pixels high: at most {MOST_HEIGHT:.0} are drawn"
            )));
        }
        page::draw(path.as_ref(), (page_w.ceil() as u32, height.ceil() as u32), |canvas| {
            heading(canvas, MARGIN / 2.0 + LEFT, page_w, &self.title, &[]);
            for (i, panel) in panels.iter().enumerate() {
                let cell = Rect {
                    x: MARGIN / 2.0 + (i % self.columns) as f64 * cell_w,
                    y: heading_h + (i / self.columns) as f64 * row_h,
                    w: cell_w,
                    h: row_h - GAP,
                };
                panel.draw(canvas, cell);
            }
        })
    }
}

impl CaptionedMap {
    fn panel(&self, shared: &Shade) -> MapPanel<'_> {
        let values = self.values.view();
        let shade = match self.scale {
            MapScale::Diverging => Shade::diverging(&[values], 0.0),
            MapScale::SharedDiverging => shared.clone(),
            MapScale::Sequential => Shade::sequential(&[values]),
            MapScale::Stretched => Shade::stretched(&[values], values),
        };
        let extent = self.width_m.map_or(Extent::Pixels, Extent::Metres);
        let (name, figure, unit) = (self.caption.clone(), String::new(), self.unit.as_str());
        MapPanel { name, figure, values, shade, extent, unit, labels: &self.labels }
    }
}
