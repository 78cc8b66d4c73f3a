//! HTML pages in one file: text, tables, the mirror, maps and curves, with nothing from elsewhere.
//! They follow the light or dark setting of the reader, and fit a phone.

mod curve;
mod escape;
mod map;
mod mirror;

pub use curve::{Curve, curve};
pub use map::{Colours, map};
pub use mirror::{SegmentValue, mirror};

use escape::escape;

/// A page of sections, which are HTML, with its origin at the end: the command that made it, and
/// the version of the program.
pub fn page(title: &str, sections: &[String]) -> String {
    let title = escape(title);
    let command = command();
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta name=\"viewport\" content=\"width=device-width, \
         initial-scale=1\">\n<meta name=\"color-scheme\" content=\"light dark\">\n<title>{title}</title>\n<style>\n{}</style>\n</head>\n<body>\n\
         <h1>{title}</h1>\n{}\n<footer><p>cophase {}</p><pre>{}</pre></footer>\n</body>\n</html>\n",
        include_str!("page.css"),
        sections.join("\n"),
        env!("CARGO_PKG_VERSION"),
        escape(&command)
    )
}

/// The command of this process, without a token, which a report must not tell.
fn command() -> String {
    let mut words: Vec<String> = Vec::new();
    let mut is_secret = false;
    for word in std::env::args_os() {
        let word = word.to_string_lossy();
        words.push(if is_secret {
            "...".into()
        } else {
            shell_word(word.split_once("--token=").map_or(&word, |_| "--token=..."))
        });
        is_secret = word == "--token";
    }
    words.join(" ")
}

/// A word of a command as a shell takes it.
fn shell_word(word: &str) -> String {
    let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-_./=:,+@%".contains(&byte);
    if !word.is_empty() && word.bytes().all(is_plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', "'\\''"))
    }
}

/// A section with a heading; `contents` is HTML.
pub fn section(heading: &str, contents: &str) -> String {
    format!("<section>\n<h2>{}</h2>\n{contents}\n</section>", escape(heading))
}

/// Names and values side by side.
pub fn figures(pairs: &[(&str, String)]) -> String {
    let figure =
        |(name, value): &(&str, String)| format!("<div><dt>{}</dt><dd>{}</dd></div>", escape(name), escape(value));
    format!("<dl class=\"figures\">{}</dl>", pairs.iter().map(figure).collect::<String>())
}

/// Sentences as a list; `none` where there are none. `class` is that of the list.
pub fn list(class: &str, sentences: &[String], none: &str) -> String {
    if sentences.is_empty() {
        return format!("<p class=\"none\">{}</p>", escape(none));
    }
    let items: String = sentences.iter().map(|sentence| format!("<li>{}</li>", escape(sentence))).collect();
    format!("<ul class=\"{class}\">{items}</ul>")
}

/// A table of text; `none` where it has no rows. Columns after the first `text` are numbers; of
/// those before, the last may be long.
pub fn table(headers: &[&str], text: usize, rows: &[Vec<String>], none: &str) -> String {
    if rows.is_empty() {
        return format!("<p class=\"none\">{}</p>", escape(none));
    }
    let cells = |tag: &str, cells: &[String]| -> String {
        let cell = |(place, cell): (usize, &String)| {
            let class = match (place + 1).cmp(&text) {
                std::cmp::Ordering::Less => " class=\"short\"",
                std::cmp::Ordering::Equal => "",
                std::cmp::Ordering::Greater => " class=\"number\"",
            };
            format!("<{tag}{class}>{}</{tag}>", escape(cell))
        };
        cells.iter().enumerate().map(cell).collect()
    };
    let headers: Vec<String> = headers.iter().map(|header| (*header).to_owned()).collect();
    let rows: String = rows.iter().map(|row| format!("<tr>{}</tr>\n", cells("td", row))).collect();
    format!(
        "<div class=\"scroll\"><table><thead><tr>{}</tr></thead><tbody>\n{rows}</tbody></table></div>",
        cells("th", &headers)
    )
}

/// Text as it is, such as a scene, behind a line that opens it.
pub fn folded(summary: &str, text: &str) -> String {
    format!("<details><summary>{}</summary><pre>{}</pre></details>", escape(summary), escape(text))
}

/// Figures side by side, each HTML.
pub fn row(figures: &[String]) -> String {
    format!("<div class=\"row\">{}</div>", figures.concat())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_escaped() {
        assert_eq!(escape("<b a=\"1\">'&'\u{1b}"), "&lt;b a=&quot;1&quot;&gt;&#39;&amp;&#39;\u{fffd}");
        assert_eq!(shell_word("a b'c"), "'a b'\\''c'");
        let page = page("<script>", &[section("a < b", &list("", &["<i>".into()], ""))]);
        assert!(!page.contains("<script") && !page.contains("<i>") && page.contains("<title>&lt;script&gt;</title>"));
    }
}
