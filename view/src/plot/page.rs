//! From a drawing to a file: which format, its bytes, and a write that is whole or not at all.

use super::canvas::{Canvas, SCALE, paint_on};
use super::encode::png;
use cophase::{Error, Result};
use plotters::backend::{BitMapBackend, DrawingBackend, SVGBackend};
use std::path::Path;

/// Draws a page of `size` logical pixels with `paint` and writes it to `path`, whole or not at all.
///
/// # Errors
/// [`Error::File`] for an extension that is neither `png` nor `svg`, or a file that cannot be
/// written.
pub(super) fn draw(path: &Path, size: (u32, u32), paint: impl FnOnce(&mut Canvas)) -> Result<()> {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    let bytes = match extension.as_str() {
        "png" => to_png(size, paint)?,
        "svg" => to_svg(size, paint)?,
        _ => {
            let given = if extension.is_empty() { "no extension".into() } else { format!("extension `{extension}`") };
            return Err(Error::file(path, format!("a picture with {given} is unknown: name it .png or .svg")));
        }
    };
    cophase::io::write_atomically(path, &bytes)
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

fn to_svg((w, h): (u32, u32), paint: impl FnOnce(&mut Canvas)) -> Result<Vec<u8>> {
    let (wide, high) = (w * SCALE as u32, h * SCALE as u32);
    let mut drawn = String::new();
    let images = {
        let mut backend = SVGBackend::with_string(&mut drawn, (wide, high));
        let images = paint_on(&mut backend, true, paint)?;
        backend.present().map_err(|e| Error::Internal(format!("a picture could not be closed ({e})")))?;
        images
    };
    // The backend's own first line declares device units as the page size: ours keeps the viewBox,
    // sets the page to logical pixels, and lays white and the rasters under the rest.
    let body = drawn.split_once('\n').map_or("", |(_, body)| body);
    Ok(format!(
        "<svg width=\"{w}\" height=\"{h}\" viewBox=\"0 0 {wide} {high}\" xmlns=\"http://www.w3.org/2000/svg\" \
         xmlns:xlink=\"http://www.w3.org/1999/xlink\">\n<rect width=\"{wide}\" height=\"{high}\" fill=\"#FFFFFF\"/>\n\
         {images}{body}"
    )
    .into_bytes())
}
