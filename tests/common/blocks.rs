//! Code blocks of the pages, for the tests of a package in a folder below the root.

#![allow(dead_code, reason = "not every package tries blocks in every language")]

use std::fmt;
use std::path::Path;

const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");

/// A fenced block.
#[derive(Debug)]
pub struct Block {
    /// Path of the page below `docs/`, or from the root with its folder.
    pub page: String,
    /// Line of the fence.
    pub line: usize,
    /// Word behind the fence.
    pub language: String,
    pub text: String,
    /// Reason in the page for which it is not run.
    pub reason: Option<String>,
}

impl fmt::Display for Block {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}:{}", self.page, self.line)
    }
}

/// Pages outside `docs/`.
const OTHERS: [&str; 3] = ["README.md", "bindings/README.md", "benches/peers/README.md"];

/// Paths of the pages from the root.
fn pages() -> Vec<String> {
    let mut pages: Vec<String> = OTHERS.map(String::from).to_vec();
    for entry in std::fs::read_dir(Path::new(ROOT).join("docs")).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        if name.ends_with(".md") {
            pages.push(format!("docs/{name}"));
        }
    }
    pages.sort();
    pages
}

/// The blocks of all pages, but for directives of the site (`{toctree}`).
pub fn all() -> Vec<Block> {
    pages().iter().flat_map(|page| of_page(page)).filter(|block| !block.language.starts_with('{')).collect()
}

/// Command lines of `program` within the sentences and tables of all pages, between backticks, but
/// for those with placeholders (`[--row NAME]`, `TARGET`, `N`).
pub fn inline_commands(program: &str) -> Vec<Block> {
    let of_text = |page: String| -> Vec<Block> {
        let text = std::fs::read_to_string(Path::new(ROOT).join(&page)).unwrap();
        // A fence is three backticks, so that what follows is between backticks and begins with its
        // language.
        let spans = text.split('`').skip(1).step_by(2).map(|span| span.replace('\n', " "));
        let commands = spans.filter(|span| span.strip_prefix(program).is_some_and(|rest| rest.starts_with(' ')));
        let is_placeholder = |word: &str| word.starts_with('[') || matches!(word, "TARGET" | "N" | "I/N");
        let whole = commands.filter(|span| !span.split_whitespace().any(is_placeholder));
        let block = |text| Block { page: page.clone(), line: 0, language: "sh".into(), text, reason: None };
        whole.map(block).collect()
    };
    pages().into_iter().flat_map(of_text).collect()
}

/// The blocks in a language that are run, page by page, in their order.
pub fn run_in(language: &str) -> Vec<(String, Vec<Block>)> {
    let mut pages: Vec<(String, Vec<Block>)> = Vec::new();
    for block in all().into_iter().filter(|block| block.language == language && block.reason.is_none()) {
        match pages.last_mut().filter(|(page, _)| *page == block.page) {
            Some((_, blocks)) => blocks.push(block),
            None => pages.push((block.page.clone(), vec![block])),
        }
    }
    pages
}

fn of_page(page: &str) -> Vec<Block> {
    let text = std::fs::read_to_string(Path::new(ROOT).join(page)).unwrap();
    let name = Path::new(page).strip_prefix("docs").unwrap_or(Path::new(page)).display().to_string();
    let mut blocks = Vec::new();
    let mut open: Option<Block> = None;
    let mut before = "";
    for (index, line) in text.lines().enumerate() {
        let fence = line.trim_start().strip_prefix("```");
        match (&mut open, fence) {
            (None, Some(language)) => {
                let reason = before.strip_prefix("<!-- not run: ").and_then(|rest| rest.strip_suffix(" -->"));
                open = Some(Block {
                    page: name.clone(),
                    line: index + 1,
                    language: language.trim().into(),
                    text: String::new(),
                    reason: reason.map(String::from),
                });
            }
            (Some(_), Some(_)) => blocks.extend(open.take()),
            (Some(block), None) => {
                block.text.push_str(line);
                block.text.push('\n');
            }
            (None, None) => {}
        }
        if !line.trim().is_empty() {
            before = line.trim();
        }
    }
    assert!(open.is_none(), "{page}: a block without an end");
    blocks
}
