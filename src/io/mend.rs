//! Mending the headers of sloppy files: every card goes through here, and standard ones come out as they went in.
//!
//! Real frames carry mandatory cards out of their columns (`SIMPLE  = T /Tape`), NUL padding, lower-case keywords, the
//! degree sign in a comment. cfitsio refuses some of these and misreads others, so it is only ever shown the standard
//! form.

use std::io::{Read, Seek, SeekFrom};

use super::card::{self, Bytes, CARD};
use super::layout::{BLOCK, Kind, Layout};

/// What was mended: a short phrase, how often, and the first byte concerned.
#[derive(Debug, Default)]
pub(super) struct Notes(Vec<(String, usize, u64)>);

impl Notes {
    pub fn add(&mut self, what: String, at: u64) {
        match self.0.iter_mut().find(|(known, ..)| *known == what) {
            Some((_, count, _)) => *count += 1,
            None => self.0.push((what, 1, at)),
        }
    }

    pub fn append(&mut self, other: Notes) {
        for (what, count, at) in other.0 {
            match self.0.iter_mut().find(|(known, ..)| *known == what) {
                Some((_, known, _)) => *known += count,
                None => self.0.push((what, count, at)),
            }
        }
    }

    /// One sentence; `None` where nothing was mended.
    pub fn sentence(&self) -> Option<String> {
        let phrase = |(what, count, at): &(String, usize, u64)| {
            let times = if *count == 1 { String::new() } else { format!("{count} times, first ") };
            format!("{what} ({times}at byte {at})")
        };
        let phrases: Vec<_> = self.0.iter().map(phrase).collect();
        (!phrases.is_empty())
            .then(|| format!("the file is not standard FITS and was mended in memory: {}", phrases.join("; ")))
    }
}

/// Whether an HDU can start with this card.
pub(super) fn starts_hdu(original: &Bytes, primary: bool) -> bool {
    let word: &[u8] = if primary { b"SIMPLE" } else { b"XTENSION" };
    let after = original[word.len()..].iter().find(|byte| !matches!(byte, b' ' | 0 | b'\t'));
    original[..word.len()].eq_ignore_ascii_case(word) && after == Some(&b'=')
}

/// `original` in printable ASCII, its keyword in capitals and its `= ` in columns 9 and 10.
pub(super) fn card(original: &Bytes, at: u64, notes: &mut Notes) -> Bytes {
    let mut card = *original;
    for byte in &mut card {
        match *byte {
            32..=126 => continue,
            128.. => notes.add("bytes outside ASCII replaced by `?`".into(), at),
            _ => notes.add("control bytes in a header replaced by blanks".into(), at),
        }
        *byte = if *byte >= 128 { b'?' } else { b' ' };
    }
    let equals = card[..9].iter().position(|&byte| byte == b'=').unwrap_or(8);
    let name = card[..equals].trim_ascii().to_ascii_uppercase();
    let commentary = matches!(name.as_slice(), b"" | b"COMMENT" | b"HISTORY" | b"CONTINUE" | b"HIERARCH");
    if commentary || !card::is_keyword(&name) {
        return card;
    }
    if equals == 8 && name != card::keyword(&card) {
        notes.add("keyword written in capitals".into(), at);
        card[..8].copy_from_slice(&card::padded(&name)[..8]);
    }
    let assigns = card[equals] == b'=';
    if assigns && (equals != 8 || card[9] != b' ') {
        notes.add("`= ` moved to columns 9 and 10".into(), at);
        let mut line = card::padded(&name)[..8].to_vec();
        line.extend_from_slice(b"= ");
        line.extend_from_slice(card[equals + 1..].trim_ascii_start());
        return card::padded(&line);
    }
    card
}

/// Whether a mended card is the END of its header.
pub(super) fn is_end(card: &Bytes) -> bool {
    card.trim_ascii_end() == b"END"
}

/// Notes a fill after END that is not blank; [`standard_header`] writes blanks whatever was there.
pub(super) fn check_fill(fill: &[u8], at: u64, notes: &mut Notes) {
    if let Some(i) = fill.iter().position(|&byte| byte != b' ') {
        notes.add("padding of a header that is not blank".into(), at + i as u64);
    }
}

/// The whole header in standard form: the mandatory cards first, in order and in fixed format, then the others.
///
/// `mandatory` holds the keyword and the value of each; comments are kept.
pub(super) fn standard_header(
    cards: Vec<Bytes>,
    mandatory: &[(String, String)],
    at: u64,
    notes: &mut Notes,
) -> Vec<u8> {
    let mut header: Vec<u8> = Vec::with_capacity((cards.len() + 1) * CARD);
    for (i, (key, value)) in mandatory.iter().enumerate() {
        let offset = at + (i * CARD) as u64;
        let found = cards.iter().find(|card| card::keyword(card) == key.as_bytes());
        let comment = found.and_then(card::value_and_comment).map_or("", |(_, comment)| comment);
        let standing = cards.get(i).filter(|card| card::keyword(card) == key.as_bytes() && keeps(card, value));
        header.extend(standing.copied().unwrap_or_else(|| {
            notes.add("mandatory card not in the standard's form or place".into(), offset);
            card::fixed(key, value, comment)
        }));
    }
    let is_mandatory = |card: &Bytes| mandatory.iter().any(|(key, _)| card::keyword(card) == key.as_bytes());
    let others: Vec<_> = cards.iter().filter(|card| !is_mandatory(card)).collect();
    if others.len() + mandatory.len() < cards.len() {
        notes.add("repeated mandatory cards left out".into(), at);
    }
    header.extend(others.into_iter().flatten());
    header.extend(card::padded(b"END"));
    header.resize((header.len() as u64).next_multiple_of(BLOCK) as usize, b' ');
    header
}

/// Whether a mandatory card already says `value` in fixed format.
fn keeps(card: &Bytes, value: &str) -> bool {
    let same = card::value_and_comment(card).is_some_and(|(standing, _)| standing == value);
    same && (card::is_fixed(card) || (value.starts_with('\'') && card[10] == b'\''))
}

/// Makes the header of a tile-compressed image one of a plain table. No such image is read, but cfitsio prepares to unpack
/// every one that it passes, and divides by the sizes of tiles that the header names, zeros too (seen with 4.x).
fn hide_compression(header: &mut [u8]) {
    for card in header.as_chunks_mut::<CARD>().0.iter_mut().filter(|card| card::keyword(card) == b"ZIMAGE") {
        *card = card::padded(b"COMMENT a tile-compressed image");
    }
}

/// The file in standard form, whole, for cfitsio to read from memory.
///
/// # Errors
/// The byte that could not be read.
pub(super) fn standard_file(layout: &Layout, source: &mut (impl Read + Seek)) -> Result<Vec<u8>, String> {
    let mut file = Vec::new();
    for hdu in &layout.hdus {
        let header_at = file.len();
        file.extend_from_slice(&hdu.header);
        if hdu.kind == Kind::Compressed {
            hide_compression(&mut file[header_at..]);
        }
        let data = source
            .seek(SeekFrom::Start(hdu.data_at))
            .and_then(|_| source.by_ref().take(hdu.data_bytes).read_to_end(&mut file));
        match data {
            Ok(read) if read as u64 == hdu.data_bytes => {}
            Ok(read) => {
                return Err(format!(
                    "the file became shorter while it was read: it ends at byte {}",
                    hdu.data_at + read as u64
                ));
            }
            Err(error) => return Err(format!("the data at byte {} cannot be read: {error}", hdu.data_at)),
        }
        file.resize((file.len() as u64).next_multiple_of(BLOCK) as usize, 0);
    }
    Ok(file)
}
