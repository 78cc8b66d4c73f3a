//! From a drawing to a file: which format, its bytes, and a write that is whole or not at all.

use super::canvas::{Canvas, SCALE, paint_on};
use cophase::{Error, Result};
use image::ImageEncoder;
use plotters::backend::{BitMapBackend, DrawingBackend, SVGBackend};
use std::path::Path;

/// Draws a page of `size` logical pixels with `paint` and writes it to `path`, whole or not at all.
///
/// # Errors
/// [`Error::File`] for an extension that is neither `png` nor `svg`, or a file that cannot be written.
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
    cophase::atomic::write(path, &bytes)
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

/// An RGB raster as the bytes of a PNG.
pub(super) fn png(rgb: &[u8], (w, h): (u32, u32)) -> Result<Vec<u8>> {
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

/// RFC 4648.
pub(super) fn base64(bytes: &[u8]) -> String {
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
}
