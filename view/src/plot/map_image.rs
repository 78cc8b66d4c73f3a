//! A map alone as a PNG within other documents.

use super::colour::Shade;
use super::encode::{base64, png};
use cophase::Result;
use ndarray::ArrayView2;

/// Least side of a picture, pixels: samples of small maps become squares of several pixels.
const LEAST_SIDE: usize = 240;

/// Scale of colours.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MapColours<'a> {
    /// Blue to red about zero, reaching at least this value.
    Diverging(f64),
    /// From zero to the highest value.
    Sequential,
    /// For images: darkness to light, stretched, common to the image and its model.
    Light(&'a [ArrayView2<'a, f64>; 2]),
}

/// A map as a picture.
#[derive(Debug, Clone)]
pub struct MapImage {
    /// PNG in base64.
    pub png_base64: String,
    /// Values of the first and of the last colour.
    pub low: f64,
    pub high: f64,
}

/// The picture of `map`, `[row = y, col = x]` with row 0 at the bottom, each sample a square of
/// pixels.
///
/// # Errors
/// Those of encoding a PNG.
pub fn map_image(map: ArrayView2<f64>, colours: MapColours) -> Result<MapImage> {
    let shade = match colours {
        MapColours::Diverging(least) => Shade::diverging(&[map], least),
        MapColours::Sequential => Shade::sequential(&[map]),
        MapColours::Light(maps) => Shade::stretched(maps, maps[1]),
    };
    let (rows, columns) = map.dim();
    let side = LEAST_SIDE.div_ceil(rows.max(columns).max(1)).max(1);
    let mut rgb = Vec::with_capacity(3 * side * side * rows * columns);
    for y in 0..rows * side {
        for x in 0..columns * side {
            let colour = shade.colour(map[[rows - 1 - y / side, x / side]]);
            rgb.extend([colour.0, colour.1, colour.2]);
        }
    }
    let (low, high) = (shade.axis().low(), shade.axis().high());
    let bytes = png(&rgb, ((columns * side) as u32, (rows * side) as u32))?;
    Ok(MapImage { png_base64: base64(&bytes), low, high })
}
