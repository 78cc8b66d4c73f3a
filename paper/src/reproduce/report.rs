//! What a target hands back.

use std::path::PathBuf;

/// What came out.
#[derive(Debug, Clone)]
pub struct Report {
    /// Tables and their headings, for a terminal.
    pub text: String,
    /// Files written, in order.
    pub files: Vec<PathBuf>,
}
