//! Compressed files: refused by their headers before they are expanded, because a file can expand
//! to a thousand times its size.

use std::fs::File;
use std::io::{Cursor, Read};

use super::card::{BLOCK, CARD};
use super::cfitsio::CfitsioResult;
use super::layout;
use super::repair::{self, Repairs};
use crate::machine;

/// Most bytes that a compressed file expands to: a thousand frames of 512 × 512 pixels of 4 bytes.
/// They are in memory twice; a file that is not compressed is read from the disk and has no such
/// bound.
pub(super) const MAX_UNPACKED: u64 = 1 << 30;

/// Refuses to expand to `bytes` bytes in all. `what` is the part of the file that its header
/// describes, `how` the command that unpacks it.
///
/// # Errors
/// Both figures, and what to do.
pub(super) fn check_unpacked(what: &str, bytes: u64, how: &str) -> CfitsioResult<()> {
    if bytes > MAX_UNPACKED {
        return Err(format!(
            "unpacks to {bytes} bytes with {what}: at most {MAX_UNPACKED} are accepted of a compressed file; unpack it with {how} first"
        ));
    }
    // As they are unpacked, and as they are read from.
    machine::check_memory(format_args!("the compressed file with {what}"), 2 * bytes, "give a smaller file")
        .map_err(|error| error.to_string())
}

/// The FITS file in a gzip stream. Each header is read before the data that it describes are
/// unpacked; what follows the last HDU is not, but for its first block.
///
/// # Errors
/// Why the stream cannot be read, that it holds no FITS file, or that its headers declare more than
/// [`MAX_UNPACKED`].
pub(super) fn unpack(file: File) -> CfitsioResult<Vec<u8>> {
    let mut stream = flate2::read::MultiGzDecoder::new(file);
    let mut bytes = Vec::new();
    loop {
        let at = bytes.len();
        read_header(&mut stream, &mut bytes)?;
        if bytes.len() == at {
            return Ok(bytes);
        }
        let Some(data_bytes) = layout::declared_bytes(&mut Cursor::new(&bytes), at as u64, bytes.len() as u64)? else {
            return Ok(bytes);
        };
        // Below 2^63: a header that declares more is refused.
        let padded = data_bytes.next_multiple_of(BLOCK);
        check_unpacked(&format!("the HDU at byte {at}"), bytes.len() as u64 + padded, "gunzip")?;
        take(&mut stream, padded, &mut bytes)?;
    }
}

/// Adds the blocks of a header up to its card END, or to the end of the stream; where no HDU can
/// start, one block.
fn read_header(stream: &mut impl Read, bytes: &mut Vec<u8>) -> CfitsioResult<()> {
    let (start, mut at) = (bytes.len(), bytes.len());
    loop {
        take(stream, BLOCK, bytes)?;
        let cards = bytes[at..].as_chunks::<CARD>().0;
        let starts = cards.first().is_some_and(|card| repair::starts_hdu(card, start == 0));
        let is_other = at == start && !starts;
        let has_end = cards.iter().any(|card| repair::is_end(&repair::card(card, 0, &mut Repairs::default())));
        // A header without an end is refused by its length.
        let is_long = (bytes.len() - start) as u64 > layout::MAX_HEADER;
        if is_other || has_end || is_long || bytes.len() - at < BLOCK as usize {
            return Ok(());
        }
        at = bytes.len();
    }
}

/// Adds at most `count` bytes of `stream`, and fewer at its end.
fn take(stream: &mut impl Read, count: u64, bytes: &mut Vec<u8>) -> CfitsioResult<()> {
    let taken = stream.by_ref().take(count).read_to_end(bytes);
    taken.map(drop).map_err(|error| format!("the gzip stream is damaged after {} unpacked bytes: {error}", bytes.len()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use flate2::Compression;
    use flate2::write::GzEncoder;
    use std::io::{Seek, Write};

    /// A gzip file of `cards` and `zeros` bytes behind them.
    fn packed(cards: &[&str], zeros: usize) -> File {
        let mut header: Vec<u8> = cards.iter().flat_map(|card| format!("{card:<80}").into_bytes()).collect();
        header.resize(header.len().next_multiple_of(BLOCK as usize), b' ');
        let mut stream = GzEncoder::new(tempfile::tempfile().unwrap(), Compression::fast());
        stream.write_all(&header).unwrap();
        stream.write_all(&vec![0; zeros]).unwrap();
        let mut file = stream.finish().unwrap();
        file.rewind().unwrap();
        file
    }

    fn image(axis: usize) -> [String; 5] {
        ["SIMPLE  = T".into(), "BITPIX  = 8".into(), "NAXIS   = 1".into(), format!("NAXIS1  = {axis}"), "END".into()]
    }

    fn unpacked(cards: &[String], zeros: usize) -> CfitsioResult<usize> {
        let cards: Vec<&str> = cards.iter().map(String::as_str).collect();
        unpack(packed(&cards, zeros)).map(|bytes| bytes.len())
    }

    #[test]
    fn headers_bound_what_is_unpacked() {
        assert_eq!(unpacked(&image(3000), 5760).unwrap(), 2880 + 5760);
        // What the header does not declare is not unpacked, but for a block.
        assert_eq!(unpacked(&image(3000), 50_000_000).unwrap(), 2880 + 5760 + 2880);
        let refused = unpacked(&image(2_000_000_000), 100).unwrap_err();
        for fact in ["2000", &MAX_UNPACKED.to_string(), "gunzip"] {
            assert!(refused.contains(fact), "{refused}");
        }
        let refused = unpack(packed(&["no FITS file"], 50_000_000)).unwrap_err();
        assert!(refused.contains("not a FITS file"), "{refused}");
        // A file that is shorter than its header says is refused by the layout, with the bytes that
        // are there.
        assert_eq!(unpacked(&image(9000), 100).unwrap(), 2980);
    }
}
