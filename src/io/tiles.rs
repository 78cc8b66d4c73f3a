//! Tile-compressed images (`fpack`, `.fits.fz`), FITS standard 4.0, section 10: the image is cut
//! into tiles, each of them a compressed stream in a row of a binary table.
//!
//! RICE_1, GZIP_1, GZIP_2 and NOCOMPRESS are decoded here and not by cfitsio. It divides by the
//! sizes in the header, even by zero, and its decoders (3.49, which `fitsio-sys` builds) trust the
//! streams, so that no check of header and descriptors makes them safe:
//!
//! - `fits_rdecomp` compares its position with the end of the stream after a block of pixels only,
//!   and counts the zeros of a code up to the next 1: a stream that ends in zeros is read beyond
//!   the memory of the process (SIGSEGV; seed `bad-tiles-rice-open`, a good file with one tile
//!   overwritten).
//! - `imcomp_decompress_tile` takes the type of the pixels from the size to which a gzip stream
//!   unpacks: floats in an image of doubles are read through a null pointer (SIGSEGV; seed
//!   `bad-tiles-gzip-width`). Its memory grows to the end of the stream, of any size: 1 MB for an
//!   image of 48 pixels took 1 GB.
//!
//! Such streams are recognised by decoding them only. The result is a plain image: its header and
//! big-endian pixels.

mod codecs;
mod table;
#[cfg(test)]
mod tests;

use super::card::{self, CARD};
use super::layout::Hdu;
use super::repair::{self, Repairs};
use crate::machine;
use codecs::{gunzip, integers, rice, unshuffled};
use table::{TileTable, integer, size};

/// Most bytes that a compressed byte unpacks to: 1032 for gzip; 205 for RICE_1, whose blocks of 32
/// pixels of 4 bytes take 5 bits at least.
const MAX_RATIO: u64 = 1032;

/// Length of the standard's table of random numbers (appendix I).
const RANDOM: usize = 10_000;

/// Quantised pixel that is exactly 0 with SUBTRACTIVE_DITHER_2.
const ZERO_PIXEL: i64 = -2_147_483_646;

/// A plain image.
pub(super) struct Image {
    pub bitpix: i64,
    /// NAXIS1 (fastest) first.
    pub axes: Vec<u64>,
    /// The header in standard form.
    pub header: Vec<u8>,
    /// Big-endian pixels, x fastest.
    pub data: Vec<u8>,
}

/// Bytes of the image in the compressed `hdu` by its header; `None` where that does not say it,
/// which [`unpack`] refuses.
pub(super) fn declared_bytes(hdu: &Hdu) -> Option<u64> {
    let number = |key: &str| hdu.value(key).and_then(card::integer).and_then(|number| u64::try_from(number.abs()).ok());
    let axes = number("ZNAXIS").filter(|&axes| axes <= 999)?;
    let bytes = number("ZBITPIX")? / 8;
    (1..=axes).try_fold(bytes, |bytes, n| Some(bytes.saturating_mul(number(&format!("ZNAXIS{n}"))?)))
}

/// The image in the compressed `hdu` with the data `data`.
///
/// # Errors
/// Why it cannot be unpacked: another compression, a header that contradicts itself or the data, a
/// damaged tile.
pub(super) fn unpack(hdu: &Hdu, data: &[u8]) -> Result<Image, String> {
    let table = TileTable::new(hdu, data)?;
    let geometry = Geometry::new(hdu, &table)?;
    let decoder = Decoder::new(hdu, &table, geometry.bitpix)?;
    let pixel_bytes = geometry.bitpix.unsigned_abs() as usize / 8;
    let bytes = geometry.pixels * pixel_bytes;
    let what = format_args!("the tile-compressed image {}", hdu.described());
    // The image, here and as cfitsio reads it; of a tile the unpacked bytes, these unshuffled, and
    // the integers, of 8 bytes each at most.
    let tile_bytes = 24 * geometry.tile.iter().product::<usize>();
    machine::check_memory(what, (2 * bytes + tile_bytes) as u64, "give a smaller image")
        .map_err(|error| error.to_string())?;
    let mut image = vec![0; bytes];
    for tile in 0..geometry.tiles {
        let (start, size) = geometry.tile(tile);
        let pixels = decoder
            .tile(tile, size.iter().product())
            .ok_or_else(|| format!("tile {} of {} is damaged", tile + 1, geometry.tiles))?;
        for (row, line) in pixels.chunks_exact(size[0] * pixel_bytes).enumerate() {
            let at = geometry.offset(&start, &size, row) * pixel_bytes;
            image[at..at + line.len()].copy_from_slice(line);
        }
    }
    Ok(Image { bitpix: geometry.bitpix, header: image_header(hdu, &geometry), axes: geometry.axes, data: image })
}

/// The header of the plain image.
fn image_header(hdu: &Hdu, geometry: &Geometry) -> Vec<u8> {
    let mut mandatory: Vec<(String, String)> = vec![
        ("XTENSION".into(), "'IMAGE   '".into()),
        ("BITPIX".into(), geometry.bitpix.to_string()),
        ("NAXIS".into(), geometry.axes.len().to_string()),
    ];
    mandatory.extend(geometry.axes.iter().enumerate().map(|(i, size)| (format!("NAXIS{}", i + 1), size.to_string())));
    mandatory.extend([("PCOUNT".into(), "0".into()), ("GCOUNT".into(), "1".into())]);
    let cards = hdu.header.as_chunks::<CARD>().0.iter().copied();
    // The sums of the table are not those of the image.
    let is_kept = |card: &card::Bytes| !matches!(card::keyword(card), b"DATASUM" | b"CHECKSUM");
    let mut cards: Vec<card::Bytes> = cards.take_while(|card| !repair::is_end(card)).filter(is_kept).collect();
    if let (true, None, Some(blank)) = (geometry.bitpix > 0, hdu.value("BLANK"), hdu.value("ZBLANK")) {
        cards.push(card::fixed("BLANK", blank, ""));
    }
    repair::standard_header(cards, &mandatory, hdu.header_at, &mut Repairs::default())
}

/// Axes of the image and of its tiles.
struct Geometry {
    bitpix: i64,
    axes: Vec<u64>,
    /// Pixels of a tile along each axis; those at the far edges are smaller.
    tile: Vec<usize>,
    pixels: usize,
    tiles: usize,
}

impl Geometry {
    fn new(hdu: &Hdu, table: &TileTable) -> Result<Self, String> {
        let bitpix = integer(hdu, "ZBITPIX")?.unwrap_or(0);
        if !matches!(bitpix, 8 | 16 | 32 | 64 | -32 | -64) {
            return Err(format!("the card ZBITPIX is {bitpix}, where 8, 16, 32, 64, -32 or -64 is needed"));
        }
        let axes = (1..=size(hdu, "ZNAXIS", None)?.min(999)).map(|n| size(hdu, &format!("ZNAXIS{n}"), None));
        let axes = axes.collect::<Result<Vec<_>, _>>()?;
        // Rows of the image are the standard's tiles where none are named.
        let tile = axes.iter().enumerate().map(|(i, &axis)| {
            let default = if i == 0 { axis as i64 } else { 1 };
            size(hdu, &format!("ZTILE{}", i + 1), Some(default)).map(|tile| tile.min(axis))
        });
        let tile = tile.collect::<Result<Vec<_>, _>>()?;
        let pixels = axes.iter().try_fold(1_usize, |n, &axis| n.checked_mul(axis));
        let bytes = pixels.and_then(|pixels| pixels.checked_mul(bitpix.unsigned_abs() as usize / 8));
        let bound = (table.data.len() as u64).saturating_mul(MAX_RATIO);
        let pixels = pixels.filter(|_| bytes.is_some_and(|bytes| bytes as u64 <= bound)).ok_or_else(|| {
            format!("an image of {axes:?} pixels does not fit the {} compressed bytes", table.data.len())
        })?;
        let tiles = axes.iter().zip(&tile).map(|(axis, tile)| axis.div_ceil(*tile)).product();
        if tiles > table.rows {
            return Err(format!("the table has {} rows, where the image has {tiles} tiles", table.rows));
        }
        Ok(Self { bitpix, axes: axes.iter().map(|&axis| axis as u64).collect(), tile, pixels, tiles })
    }

    /// First pixel and size of a tile along each axis.
    fn tile(&self, index: usize) -> (Vec<usize>, Vec<usize>) {
        let mut rest = index;
        let axes = self.axes.iter().zip(&self.tile).map(|(&axis, &tile)| {
            let along = (axis as usize).div_ceil(tile);
            let start = rest % along * tile;
            rest /= along;
            (start, tile.min(axis as usize - start))
        });
        axes.unzip()
    }

    /// Index in the image of the first pixel of a line of a tile, which starts at `start` and has
    /// this `size`.
    fn offset(&self, start: &[usize], size: &[usize], line: usize) -> usize {
        let (mut rest, mut stride, mut offset) = (line, self.axes[0] as usize, start[0]);
        for axis in 1..start.len() {
            offset += (start[axis] + rest % size[axis]) * stride;
            rest /= size[axis];
            stride *= self.axes[axis] as usize;
        }
        offset
    }
}

/// Compression of the tiles.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Algorithm {
    /// Bytes of a pixel, and pixels of a block.
    Rice {
        width: usize,
        block: usize,
    },
    Gzip,
    /// Gzip of the first bytes of all pixels, then of the second ones, and so on.
    GzipShuffled,
    None,
}

/// Quantisation of real pixels, which are `scale · integer + zero`.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Quantisation {
    /// A random number is subtracted from each integer before.
    Dithered {
        seed: usize,
        /// Whether one integer stands for 0, as SUBTRACTIVE_DITHER_2 has it.
        has_zero: bool,
    },
    Plain,
}

/// Decoder of the tiles.
struct Decoder<'a> {
    table: &'a TileTable<'a>,
    bitpix: i64,
    algorithm: Algorithm,
    quantisation: Quantisation,
    random: Vec<f32>,
    /// Cards ZSCALE, ZZERO and ZBLANK; columns of these names take precedence.
    scale: Option<f64>,
    zero: Option<f64>,
    blank: Option<f64>,
}

impl<'a> Decoder<'a> {
    fn new(hdu: &Hdu, table: &'a TileTable<'a>, bitpix: i64) -> Result<Self, String> {
        let text = |key: &str| hdu.value(key).map(card::text).unwrap_or_default().trim().to_uppercase();
        let option = |name: &str, default: i64| {
            let of_name = (1..=99).find(|n| text(&format!("ZNAME{n}")) == name);
            of_name.map_or(Ok(default as usize), |n| size(hdu, &format!("ZVAL{n}"), Some(default)))
        };
        let algorithm = match text("ZCMPTYPE").as_str() {
            "RICE_1" | "RICE_ONE" => Algorithm::Rice { width: option("BYTEPIX", 4)?, block: option("BLOCKSIZE", 32)? },
            "GZIP_1" => Algorithm::Gzip,
            "GZIP_2" => Algorithm::GzipShuffled,
            "NOCOMPRESS" => Algorithm::None,
            other => {
                return Err(format!(
                    "its compression is `{other}`, where RICE_1, GZIP_1 and GZIP_2 are accepted; unpack the file with funpack first"
                ));
            }
        };
        if hdu.value("ZMASKCMP").is_some() {
            return Err("its undefined pixels are in a compressed mask: unpack the file with funpack first".into());
        }
        let seed = size(hdu, "ZDITHER0", Some(1))?;
        let quantisation = match text("ZQUANTIZ").as_str() {
            "SUBTRACTIVE_DITHER_1" => Quantisation::Dithered { seed, has_zero: false },
            "SUBTRACTIVE_DITHER_2" => Quantisation::Dithered { seed, has_zero: true },
            "" | "NO_DITHER" | "NONE" => Quantisation::Plain,
            other => return Err(format!("the card ZQUANTIZ is {other}, which is no method of the standard")),
        };
        let number = |key: &str| hdu.value(key).and_then(|value| value.replace(['d', 'D'], "E").parse().ok());
        let [scale, zero, blank] = ["ZSCALE", "ZZERO", "ZBLANK"].map(number);
        let random = if quantisation == Quantisation::Plain { Vec::new() } else { random_numbers() };
        Ok(Self { table, bitpix, algorithm, quantisation, random, scale, zero, blank })
    }

    /// The `count` pixels of a tile, big-endian.
    fn tile(&self, tile: usize, count: usize) -> Option<Vec<u8>> {
        let pixel_bytes = self.bitpix.unsigned_abs() as usize / 8;
        let raw = |bytes: Vec<u8>| (bytes.len() == count * pixel_bytes).then_some(bytes);
        let Some(stream) = self.table.stream("COMPRESSED_DATA", tile) else {
            // A tile that could not be quantised is there without loss.
            return match self.table.stream("GZIP_COMPRESSED_DATA", tile) {
                Some(stream) => raw(gunzip(stream, count * pixel_bytes)?),
                None => raw(self.table.stream("UNCOMPRESSED_DATA", tile)?.to_vec()),
            };
        };
        let scale = self.table.number("ZSCALE", tile).or(self.scale).filter(|_| self.bitpix < 0);
        let integers = match (self.algorithm, scale) {
            (Algorithm::Rice { .. }, None) if self.bitpix < 0 => return None,
            (Algorithm::Rice { width, block }, _) => rice(stream, count, width, block)?,
            (algorithm, _) => {
                let bytes = match algorithm {
                    Algorithm::None => stream.to_vec(),
                    _ => gunzip(stream, count.checked_mul(8)?)?,
                };
                let width = bytes.len() / count;
                let bytes = if algorithm == Algorithm::GzipShuffled { unshuffled(&bytes, count) } else { bytes };
                if self.bitpix < 0 && scale.is_none() {
                    return raw(bytes);
                }
                integers(&bytes, width, count)?
            }
        };
        let Some(scale) = scale else { return self.stored(&integers) };
        let zero = self.table.number("ZZERO", tile).or(self.zero).unwrap_or(0.0);
        let blank = self.table.number("ZBLANK", tile).or(self.blank);
        let reals = self.reals(tile, &integers, [scale, zero], blank);
        Some(match self.bitpix {
            -32 => reals.flat_map(|real| (real as f32).to_be_bytes()).collect(),
            _ => reals.flat_map(f64::to_be_bytes).collect(),
        })
    }

    /// Integer pixels as the image has them; `None` where one is out of its range.
    fn stored(&self, integers: &[i64]) -> Option<Vec<u8>> {
        let mut bytes = Vec::with_capacity(integers.len() * self.bitpix.unsigned_abs() as usize / 8);
        for &integer in integers {
            match self.bitpix {
                8 => bytes.push(u8::try_from(integer).ok()?),
                16 => bytes.extend(i16::try_from(integer).ok()?.to_be_bytes()),
                32 => bytes.extend(i32::try_from(integer).ok()?.to_be_bytes()),
                _ => bytes.extend(integer.to_be_bytes()),
            }
        }
        Some(bytes)
    }

    /// Real pixels of a quantised tile.
    fn reals(
        &self,
        tile: usize,
        integers: &[i64],
        [scale, zero]: [f64; 2],
        blank: Option<f64>,
    ) -> impl Iterator<Item = f64> {
        let (mut row, has_zero) = match self.quantisation {
            Quantisation::Dithered { seed, has_zero } => ((tile + seed - 1) % RANDOM, has_zero),
            Quantisation::Plain => (0, false),
        };
        let start = |row: usize| self.random.get(row).map(|random| (random * 500.0) as usize);
        let mut next = start(row);
        integers.iter().map(move |&integer| {
            let offset = next.map_or(0.0, |next| 0.5 - f64::from(self.random[next]));
            next = next.map(|next| next + 1);
            if next == Some(RANDOM) {
                row = (row + 1) % RANDOM;
                next = start(row);
            }
            match integer {
                _ if blank == Some(integer as f64) => f64::NAN,
                ZERO_PIXEL if has_zero => 0.0,
                _ => (integer as f64 + offset) * scale + zero,
            }
        })
    }
}

/// The standard's random numbers: `x ← 16807 x mod (2³¹ − 1)` from 1, over 2³¹ − 1.
fn random_numbers() -> Vec<f32> {
    let mut seed = 1_u64;
    let next = || {
        seed = 16_807 * seed % 2_147_483_647;
        (seed as f64 / 2_147_483_647.0) as f32
    };
    std::iter::repeat_with(next).take(RANDOM).collect()
}
