//! Characters outside ASCII: text of files in the encodings that occur, and the ASCII form of
//! header cards.
//!
//! FITS allows printable ASCII only, and cfitsio reads nothing else. Headers hold other characters
//! all the same, in UTF-8 or Latin-1: `2.1686 µm`, `[Å]`, names of observers. Units must be
//! understood, so characters are decoded and written by ASCII ones of the same meaning; only those
//! without an equivalent become `?`. Texts that are written have the same form.

/// ASCII letters of U+00C0 to U+00FF, which are letters with accents but for × and ÷.
const ACCENTED: &[u8; 64] = b"AAAAAAACEEEEIIIIDNOOOOOxOUUUUYTsaaaaaaaceeeeiiiidnooooo/ouuuuyty";

/// Characters with an equivalent of their own.
const EQUIVALENTS: [(&[char], &str); 29] = [
    // The micro sign and the Greek letter.
    (&['\u{b5}', 'μ'], "u"),
    (&['λ'], "lambda"),
    (&['α'], "alpha"),
    (&['β'], "beta"),
    (&['γ'], "gamma"),
    (&['δ', 'Δ'], "delta"),
    (&['σ', 'Σ'], "sigma"),
    (&['π'], "pi"),
    (&['χ'], "chi"),
    (&['θ'], "theta"),
    (&['φ'], "phi"),
    (&['ρ'], "rho"),
    (&['τ'], "tau"),
    (&['√'], "sqrt "),
    (&['≤'], "<="),
    (&['≥'], ">="),
    (&['≈'], "~"),
    (&['·'], "*"),
    (&['…'], "..."),
    (&['°', 'º'], "deg"),
    (&['²'], "2"),
    (&['³'], "3"),
    (&['¹'], "1"),
    (&['±'], "+-"),
    // Hyphens, dashes, the minus sign and the superscript minus of `e⁻`.
    (&['\u{2010}', '\u{2011}', '\u{2012}', '–', '—', '\u{2212}', '⁻', '\u{ad}'], "-"),
    // No apostrophe, which would end the value of a card.
    (&['\u{2018}', '\u{2019}', '\u{b4}'], "`"),
    (&['\u{201c}', '\u{201d}', '\u{2033}'], "\""),
    (&['\u{a0}', '\u{2009}', '\u{202f}'], " "),
    (&['Ł'], "L"),
];

/// Text in UTF-16 with a byte order mark, UTF-8, or else Latin-1, in which every sequence of bytes
/// is a text.
pub(super) fn decoded(bytes: &[u8]) -> String {
    let utf16 = |rest: &[u8], unit: fn([u8; 2]) -> u16| {
        let units: Vec<u16> = rest.as_chunks::<2>().0.iter().map(|&pair| unit(pair)).collect();
        String::from_utf16_lossy(&units)
    };
    match bytes {
        [0xff, 0xfe, rest @ ..] => utf16(rest, u16::from_le_bytes),
        [0xfe, 0xff, rest @ ..] => utf16(rest, u16::from_be_bytes),
        _ => std::str::from_utf8(bytes)
            .map_or_else(|_| bytes.iter().map(|&byte| char::from(byte)).collect(), str::to_owned),
    }
}

/// `bytes` in ASCII; control characters are kept. Whether every character has an equivalent.
pub(super) fn ascii(bytes: &[u8]) -> (Vec<u8>, bool) {
    let text: Vec<char> = decoded(bytes).chars().collect();
    let (mut out, mut is_complete) = (Vec::with_capacity(bytes.len()), true);
    for (at, &c) in text.iter().enumerate() {
        let is_word = text.get(at + 1).is_some_and(|next| next.is_alphabetic());
        match c {
            '\0'..='\x7f' => out.push(c as u8),
            // As a unit, and as the first letter of its name.
            'Å' | '\u{212b}' if !is_word => out.extend_from_slice(b"Angstrom"),
            '\u{212b}' => out.push(b'A'),
            '\u{c0}'..='\u{ff}' => out.push(ACCENTED[c as usize - 0xc0]),
            _ => match EQUIVALENTS.iter().find(|(characters, _)| characters.contains(&c)) {
                Some((_, equivalent)) => out.extend_from_slice(equivalent.as_bytes()),
                None => {
                    is_complete = false;
                    out.push(b'?');
                }
            },
        }
    }
    (out, is_complete)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_decoded_in_the_encodings_of_files() {
        for bytes in [
            &b"2.1686 \xb5m"[..],
            "2.1686 \u{b5}m".as_bytes(),
            b"\xff\xfe2\x00.\x001\x006\x008\x006\x00 \x00\xb5\x00m\x00",
            b"\xfe\xff\x002\x00.\x001\x006\x008\x006\x00 \x00\xb5\x00m",
        ] {
            assert_eq!(decoded(bytes), "2.1686 µm", "{bytes:?}");
        }
        assert_eq!(decoded(b""), "");
    }

    #[test]
    fn characters_become_ascii_of_the_same_meaning() {
        for (text, expected) in [
            ("2.1686 µm", "2.1686 um"),
            ("2.1686 μm", "2.1686 um"),
            ("21686 Å", "21686 Angstrom"),
            ("[Å]", "[Angstrom]"),
            ("Ångström", "Angstrom"),
            ("Jörg Müller", "Jorg Muller"),
            ("4 e⁻/ADU", "4 e-/ADU"),
            ("−1.5", "-1.5"),
            ("λ of the filter", "lambda of the filter"),
            ("the reduced χ² is ≤ 1.2·10⁻", "the reduced chi2 is <= 1.2*10-"),
            ("half at −x, 3 × 3 pixels²", "half at -x, 3 x 3 pixels2"),
            ("plain", "plain"),
        ] {
            assert_eq!(ascii(text.as_bytes()), (expected.as_bytes().to_vec(), true), "{text}");
        }
        assert_eq!(ascii("星".as_bytes()), (b"?".to_vec(), false));
    }
}
