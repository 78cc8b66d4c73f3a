//! A file in standard form, in memory: the repaired headers and the data of all HDUs,
//! tile-compressed images unpacked.

use super::card::{self, BLOCK, CARD};
use super::layout::{Hdu, HduKind, Layout};
use super::packed;
use super::tiles::{self, Image};
use std::io::{Read, Seek, SeekFrom};

/// Changes the header of a tile-compressed image that is not unpacked to that of a plain table:
/// cfitsio prepares to unpack every one that it passes, and divides by the tile sizes in the
/// header, even by zero.
fn hide_compression(header: &mut [u8]) {
    for card in header.as_chunks_mut::<CARD>().0.iter_mut().filter(|card| card::keyword(card) == b"ZIMAGE") {
        *card = card::padded(b"COMMENT a tile-compressed image");
    }
}

/// The complete file in standard form, for cfitsio to read from memory. HDUs of `layout` that are
/// unpacked become images; the others keep the reason.
///
/// # Errors
/// A message with the offset of the byte that could not be read.
pub(super) fn standard_file(layout: &mut Layout, source: &mut (impl Read + Seek)) -> Result<Vec<u8>, String> {
    let mut file = Vec::new();
    for hdu in &mut layout.hdus {
        let header_at = file.len();
        file.extend_from_slice(&hdu.header);
        let data_at = file.len();
        let data = source
            .seek(SeekFrom::Start(hdu.data_at))
            .and_then(|_| source.by_ref().take(hdu.data_bytes).read_to_end(&mut file));
        match data {
            Ok(read) if read as u64 == hdu.data_bytes => {}
            Ok(read) => {
                return Err(format!(
                    "the file was shortened while it was read: it ends at byte {}",
                    hdu.data_at + read as u64
                ));
            }
            Err(error) => return Err(format!("the data at byte {} cannot be read: {error}", hdu.data_at)),
        }
        if hdu.kind == HduKind::Compressed && !unpack(hdu, &mut file, header_at, data_at) {
            hide_compression(&mut file[header_at..data_at]);
        }
        file.resize((file.len() as u64).next_multiple_of(BLOCK) as usize, 0);
    }
    Ok(file)
}

/// Puts the plain image in the place of a tile-compressed one, whose header and data are at the end
/// of `file`; gives whether it could be unpacked.
fn unpack(hdu: &mut Hdu, file: &mut Vec<u8>, header_at: usize, data_at: usize) -> bool {
    let check = tiles::declared_bytes(hdu).map_or(Ok(()), |bytes| {
        let what = format!("the image {}", hdu.described());
        packed::check_unpacked(&what, (header_at as u64).saturating_add(bytes), "funpack")
    });
    match check.and_then(|()| tiles::unpack(hdu, &file[data_at..])) {
        Ok(Image { bitpix, axes, header, data }) => {
            file.truncate(header_at);
            file.extend_from_slice(&header);
            file.extend_from_slice(&data);
            (hdu.kind, hdu.bitpix, hdu.axes, hdu.header) = (HduKind::Image, bitpix, axes, header);
            true
        }
        Err(reason) => {
            hdu.refusal = format!("the tile-compressed image {} is not unpacked: {reason}", hdu.described());
            false
        }
    }
}
