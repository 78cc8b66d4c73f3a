//! Text of a first scene: sections, keys with comments, numbers.

/// What precedes a comment on what is not in the header.
pub(super) const UNKNOWN: &str = "TO BE FILLED IN";

/// Lines of a scene: keys with their values and comments.
pub(super) struct Lines {
    pub(super) text: String,
}

impl Lines {
    /// The section `name`, after an empty line.
    pub(super) fn of_section(name: &str) -> Self {
        Self { text: format!("\n[{name}]\n") }
    }

    /// A key with its value, and a comment where there is one.
    pub(super) fn add(&mut self, key: &str, value: impl std::fmt::Display, comment: &str) {
        let line = format!("{key} = {value}");
        let line = if comment.is_empty() { line } else { format!("{line:<28} # {}", printable(comment)) };
        self.text += line.trim_end();
        self.text.push('\n');
    }

    /// A comment of its own.
    pub(super) fn note(&mut self, comment: &str) {
        self.text += &format!("# {}\n", printable(comment));
    }
}

/// `1 coadd`, `2 coadds`.
pub(super) fn counted(count: usize, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
}

/// A number in the syntax of TOML, without the digits of binary fractions.
pub(super) fn float(value: f64) -> String {
    format!("{:?}", (value * 1e6).round() / 1e6)
}

/// `text` without characters that would end a comment.
pub(super) fn printable(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
}
