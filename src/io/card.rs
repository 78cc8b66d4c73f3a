//! One 80-byte header card: lenient parsing, and the standard's fixed format for writing.
//!
//! FITS Standard 4.0, section 4: a keyword of at most 8 characters `A-Z 0-9 - _` in columns 1 to 8,
//! `= ` in columns 9 and 10, then a value; integers and logicals of the mandatory cards are
//! right-justified to column 30.

/// Bytes in a FITS block: headers and data are padded to a multiple of it.
pub(super) const BLOCK: u64 = 2880;

/// Bytes in a card.
pub(super) const CARD: usize = 80;

/// The 80 bytes of a card; printable ASCII after the repair.
pub(super) type Bytes = [u8; CARD];

/// The keyword in columns 1 to 8, unchanged but for trailing blanks.
pub(super) fn keyword(card: &Bytes) -> &[u8] {
    card[..8].trim_ascii_end()
}

/// Whether the standard allows `name` as a keyword.
pub(super) fn is_keyword(name: &[u8]) -> bool {
    (1..=8).contains(&name.len())
        && name.iter().all(|b| b.is_ascii_uppercase() || b.is_ascii_digit() || matches!(b, b'-' | b'_'))
}

/// What a card of ESO's convention begins with, whose keyword is of several words:
/// `HIERARCH ESO TEL PARANG START = 12.3`.
pub(super) const HIERARCH: &[u8] = b"HIERARCH ";

/// Whether `name` is a keyword of several words, without [`HIERARCH`].
pub(super) fn is_hierarchical(name: &str) -> bool {
    name.contains(' ') && name.split(' ').all(|word| is_keyword(word.as_bytes()))
}

/// Value and comment of a card with a keyword of several words, where it has that of `name`.
pub(super) fn hierarchical_value<'a>(card: &'a Bytes, name: &str) -> Option<(&'a str, &'a str)> {
    let text = std::str::from_utf8(card.strip_prefix(HIERARCH)?).ok()?;
    let (own, field) = text.split_once('=')?;
    (own.trim() == name).then(|| split_field(field))
}

/// The value after `= ` and the comment after `/`, both trimmed; `None` for a card without value.
///
/// A quoted string is returned with its quotes: see [`text`].
pub(super) fn value_and_comment(card: &Bytes) -> Option<(&str, &str)> {
    if &card[8..10] != b"= " {
        return None;
    }
    std::str::from_utf8(&card[10..]).ok().map(split_field)
}

/// Value and comment of what follows the sign of equality.
fn split_field(field: &str) -> (&str, &str) {
    let mut quoted = false;
    let slash = field.bytes().position(|byte| {
        quoted ^= byte == b'\'';
        byte == b'/' && !quoted
    });
    let (value, comment) = slash.map_or((field, ""), |at| (&field[..at], &field[at + 1..]));
    (value.trim(), comment.trim())
}

/// The text of a quoted value, without quotes and trailing blanks; other values unchanged.
pub(super) fn text(value: &str) -> String {
    let inner = value.strip_prefix('\'').map(|rest| rest.strip_suffix('\'').unwrap_or(rest));
    inner.map_or_else(|| value.to_string(), |inner| inner.replace("''", "'").trim_end().to_string())
}

/// An integer in any form found in real files: `16`, `+16`, `16.0` or `'16'`.
pub(super) fn integer(value: &str) -> Option<i64> {
    let plain = text(value);
    let plain = plain.trim();
    plain.parse().ok().or_else(|| {
        let real: f64 = plain.parse().ok()?;
        // 2^53: beyond, an f64 does not represent every integer.
        (real.fract() == 0.0 && real.abs() <= 9_007_199_254_740_992.0).then_some(real as i64)
    })
}

/// A card in fixed format: a number or logical is right-justified to column 30, a quoted string
/// left-justified.
pub(super) fn fixed(keyword: &str, value: &str, comment: &str) -> Bytes {
    let value = if value.starts_with('\'') { format!("{value:<20}") } else { format!("{value:>20}") };
    let line = if comment.is_empty() {
        format!("{keyword:<8}= {value}")
    } else {
        format!("{keyword:<8}= {value} / {comment}")
    };
    padded(line.as_bytes())
}

/// `line` cut or blank-padded to a card.
pub(super) fn padded(line: &[u8]) -> Bytes {
    let mut card = [b' '; CARD];
    let length = line.len().min(CARD);
    card[..length].copy_from_slice(&line[..length]);
    card
}

/// Whether the integer or logical of `card` is in fixed format.
pub(super) fn is_fixed(card: &Bytes) -> bool {
    let field = &card[10..30];
    let value = field.trim_ascii_start();
    let number = |digits: &[u8]| !digits.is_empty() && digits.iter().all(u8::is_ascii_digit);
    &card[8..10] == b"= "
        && (value == b"T" || number(value.strip_prefix(b"-").unwrap_or(value)))
        && matches!(card[30..].trim_ascii_start().first(), None | Some(b'/'))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_and_comments_are_separated_outside_quotes_only() {
        let card = padded(b"PATH    = '/a/b''s ' / where / it is");
        assert_eq!(value_and_comment(&card), Some(("'/a/b''s '", "where / it is")));
        assert_eq!(text("'/a/b''s '"), "/a/b's");
        assert_eq!(value_and_comment(&padded(b"COMMENT no value")), None);
    }

    #[test]
    fn keywords_of_several_words_are_read() {
        let card = padded(b"HIERARCH ESO TEL PARANG START = -12.345 / [deg] Parallactic angle");
        assert_eq!(hierarchical_value(&card, "ESO TEL PARANG START"), Some(("-12.345", "[deg] Parallactic angle")));
        assert_eq!(hierarchical_value(&card, "ESO TEL PARANG"), None);
        assert!(is_hierarchical("ESO DET NDIT") && !is_hierarchical("NDIT") && !is_hierarchical("ESO  DET"));
    }

    #[test]
    fn integers_are_read_in_all_known_forms() {
        for form in ["16", "+16", "16.0", "'16'", "' 16  '", "1.6E1"] {
            assert_eq!(integer(form), Some(16), "{form}");
        }
        for form in ["", "x", "16.5", "1E300", "NaN", "99999999999999999999"] {
            assert_eq!(integer(form), None, "{form}");
        }
    }

    #[test]
    fn the_fixed_format_is_what_fixed_writes() {
        assert!(is_fixed(&fixed("NAXIS1", "150", "width")));
        assert!(is_fixed(&fixed("SIMPLE", "T", "")));
        for irregular in
            ["SIMPLE  = T /Tape", "NAXIS1  =                  150x", "BITPIX  = 16", "NAXIS   =                 16.0"]
        {
            assert!(!is_fixed(&padded(irregular.as_bytes())), "{irregular}");
        }
    }
}
