//! Free text of a file: the card `CONFIG`. The text of a scene is there, so that a file holds no
//! extension that the standard does not know, and a program that rewrites the file keeps it.

use crate::Result;
use crate::io::read::FitsReader;

/// Card of the primary HDU: "free-form text that describes configuration parameters of the system".
pub(super) const CONFIGURATION: &str = "CONFIG";

/// `text` as the value of the card `CONFIG`. A card has no line breaks: they are written as `\n`,
/// and the backslash as `\\`.
pub fn configuration_card(text: &str) -> String {
    text.replace('\\', "\\\\").replace('\n', "\\n")
}

/// The text of the card `CONFIG`, with its line breaks; `None` where the file has none.
///
/// # Errors
/// [`Error::File`](crate::Error::File) for a card that cannot be read.
pub fn configuration(file: &mut FitsReader) -> Result<Option<String>> {
    let card = file.card_at(0, CONFIGURATION)?;
    Ok(card.as_ref().and_then(|card| card.text()).map(with_line_breaks))
}

/// The inverse of [`configuration_card`].
fn with_line_breaks(card: &str) -> String {
    let mut text = String::with_capacity(card.len());
    let mut characters = card.chars();
    while let Some(character) = characters.next() {
        match character {
            '\\' => match characters.next() {
                Some('n') => text.push('\n'),
                Some('\\') => text.push('\\'),
                other => {
                    text.push('\\');
                    text.extend(other);
                }
            },
            other => text.push(other),
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn line_breaks_and_backslashes_return() {
        for text in ["", "a\nb\n", "a = \"C:\\new\\n\"\n\\", "\\\n\\n", "no escape"] {
            assert_eq!(with_line_breaks(&configuration_card(text)), text);
        }
        // Text of another program, which escapes nothing.
        assert_eq!(with_line_breaks("C:\\data\\"), "C:\\data\\");
    }
}
