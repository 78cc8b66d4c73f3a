//! Repair of headers that are not standard FITS. Every card is checked here; cards in standard form
//! are not changed.
//!
//! Real files have mandatory cards outside their columns (`SIMPLE  = T /Tape`), NUL padding,
//! lower-case keywords, a degree sign in a comment. cfitsio rejects some of these and misreads
//! others, so it reads only the standard form.

use super::card::{self, BLOCK, Bytes, CARD};
use super::characters;

/// The repairs: for each kind a short phrase, the count, and the offset of the first.
#[derive(Debug, Default)]
pub(super) struct Repairs(Vec<(String, usize, u64)>);

impl Repairs {
    pub fn add(&mut self, what: String, at: u64) {
        match self.0.iter_mut().find(|(known, ..)| *known == what) {
            Some((_, count, _)) => *count += 1,
            None => self.0.push((what, 1, at)),
        }
    }

    pub fn append(&mut self, other: Repairs) {
        for (what, count, at) in other.0 {
            match self.0.iter_mut().find(|(known, ..)| *known == what) {
                Some((_, known, _)) => *known += count,
                None => self.0.push((what, count, at)),
            }
        }
    }

    /// The repairs as one sentence; `None` without any.
    pub fn sentence(&self) -> Option<String> {
        let phrase = |(what, count, at): &(String, usize, u64)| {
            let times = if *count == 1 { String::new() } else { format!("{count} times, first ") };
            format!("{what} ({times}at byte {at})")
        };
        let phrases: Vec<_> = self.0.iter().map(phrase).collect();
        (!phrases.is_empty())
            .then(|| format!("the file is not standard FITS and was repaired in memory: {}", phrases.join("; ")))
    }
}

/// Whether an HDU can start with this card.
pub(super) fn starts_hdu(original: &Bytes, primary: bool) -> bool {
    let word: &[u8] = if primary { b"SIMPLE" } else { b"XTENSION" };
    let after = original[word.len()..].iter().find(|byte| !matches!(byte, b' ' | 0 | b'\t'));
    original[..word.len()].eq_ignore_ascii_case(word) && after == Some(&b'=')
}

/// `original` in printable ASCII, with the keyword in capitals and `= ` in columns 9 and 10.
pub(super) fn card(original: &Bytes, at: u64, repairs: &mut Repairs) -> Bytes {
    let mut card = in_ascii(original, at, repairs);
    for byte in card.iter_mut().filter(|byte| !matches!(**byte, 32..=126)) {
        repairs.add("control bytes in a header replaced by blanks".into(), at);
        *byte = b' ';
    }
    let equals = card[..9].iter().position(|&byte| byte == b'=').unwrap_or(8);
    let name = card[..equals].trim_ascii().to_ascii_uppercase();
    let commentary = matches!(name.as_slice(), b"" | b"COMMENT" | b"HISTORY" | b"CONTINUE" | b"HIERARCH");
    if commentary || !card::is_keyword(&name) {
        return card;
    }
    if equals == 8 && name != card::keyword(&card) {
        repairs.add("keyword written in capitals".into(), at);
        card[..8].copy_from_slice(&card::padded(&name)[..8]);
    }
    let assigns = card[equals] == b'=';
    if assigns && (equals != 8 || card[9] != b' ') {
        repairs.add("`= ` moved to columns 9 and 10".into(), at);
        let mut line = card::padded(&name)[..8].to_vec();
        line.extend_from_slice(b"= ");
        line.extend_from_slice(card[equals + 1..].trim_ascii_start());
        return card::padded(&line);
    }
    card
}

/// `original` with characters outside ASCII written in ASCII; the keyword keeps its columns.
fn in_ascii(original: &Bytes, at: u64, repairs: &mut Repairs) -> Bytes {
    if original.is_ascii() {
        return *original;
    }
    let mut line: Vec<u8> = original[..8].iter().map(|&byte| if byte.is_ascii() { byte } else { b'?' }).collect();
    let (text, is_complete) = characters::ascii(&original[8..]);
    line.extend_from_slice(&text);
    let quotes = |bytes: &[u8]| bytes.iter().filter(|byte| **byte == b'\'').count();
    // An equivalent of several letters may push the end of a text out of the card: its characters
    // are then replaced one by one.
    let fits = quotes(&line) == quotes(&line[..line.len().min(CARD)]);
    if fits && is_complete && original[..8].is_ascii() {
        repairs.add("characters outside ASCII written in ASCII".into(), at);
    } else {
        repairs.add("characters outside ASCII replaced by `?`".into(), at);
    }
    if fits { card::padded(&line) } else { original.map(|byte| if byte.is_ascii() { byte } else { b'?' }) }
}

/// Whether a repaired card is END.
pub(super) fn is_end(card: &Bytes) -> bool {
    card.trim_ascii_end() == b"END"
}

/// Records padding after END that is not blank; [`standard_header`] writes blanks.
pub(super) fn check_fill(fill: &[u8], at: u64, repairs: &mut Repairs) {
    if let Some(i) = fill.iter().position(|&byte| byte != b' ') {
        repairs.add("padding of a header that is not blank".into(), at + i as u64);
    }
}

/// The whole header in standard form: the mandatory cards first, in order and in fixed format, then
/// the others.
///
/// `mandatory` has the keyword and the value of each mandatory card; comments are kept.
pub(super) fn standard_header(
    cards: Vec<Bytes>,
    mandatory: &[(String, String)],
    at: u64,
    repairs: &mut Repairs,
) -> Vec<u8> {
    let mut header: Vec<u8> = Vec::with_capacity((cards.len() + 1) * CARD);
    for (i, (key, value)) in mandatory.iter().enumerate() {
        let offset = at + (i * CARD) as u64;
        let found = cards.iter().find(|card| card::keyword(card) == key.as_bytes());
        let comment = found.and_then(card::value_and_comment).map_or("", |(_, comment)| comment);
        let existing = cards.get(i).filter(|card| card::keyword(card) == key.as_bytes() && has_value(card, value));
        header.extend(existing.copied().unwrap_or_else(|| {
            repairs.add("mandatory card not in standard form or order".into(), offset);
            card::fixed(key, value, comment)
        }));
    }
    let is_mandatory = |card: &Bytes| mandatory.iter().any(|(key, _)| card::keyword(card) == key.as_bytes());
    let others: Vec<_> = cards.iter().filter(|card| !is_mandatory(card)).collect();
    if others.len() + mandatory.len() < cards.len() {
        repairs.add("repeated mandatory cards removed".into(), at);
    }
    header.extend(others.into_iter().flatten());
    header.extend(card::padded(b"END"));
    header.resize((header.len() as u64).next_multiple_of(BLOCK) as usize, b' ');
    header
}

/// Whether a mandatory card already has `value` in fixed format.
fn has_value(card: &Bytes, value: &str) -> bool {
    let same = card::value_and_comment(card).is_some_and(|(existing, _)| existing == value);
    same && (card::is_fixed(card) || (value.starts_with('\'') && card[10] == b'\''))
}
