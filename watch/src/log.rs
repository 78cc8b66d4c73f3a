//! Log of a night watch: lines of JSON, appended to a file.

use crate::clock;
use cophase::{Error, Result};
use cophase_view::terminal::complain;
use serde_json::Value;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

/// The log; without a file nothing is written.
#[derive(Default)]
pub struct Log {
    file: Option<(PathBuf, File)>,
    has_failed: bool,
}

impl Log {
    /// A log that is appended to the file `path`.
    ///
    /// # Errors
    /// [`Error::File`] where it cannot be opened.
    pub fn open(path: Option<&Path>) -> Result<Self> {
        let Some(path) = path else { return Ok(Self::default()) };
        let opened = File::options().create(true).append(true).open(path);
        let file = opened.map_err(|error| Error::file(path, format_args!("cannot be written: {error}")))?;
        Ok(Self { file: Some((path.to_path_buf(), file)), has_failed: false })
    }

    /// Adds a line: the time, `what`, and the keys of `rest`. A log that cannot be written does not
    /// end the watch: the first failure is a line on stderr.
    pub fn line(&mut self, what: &str, rest: Value) {
        let Some((path, file)) = &mut self.file else { return };
        let mut line = serde_json::json!({ "time": clock::to_iso(clock::now_s()), "what": what });
        if let (Value::Object(line), Value::Object(rest)) = (&mut line, rest) {
            line.extend(rest);
        }
        match writeln!(file, "{line}") {
            Ok(()) => self.has_failed = false,
            Err(error) => {
                if !std::mem::replace(&mut self.has_failed, true) {
                    complain(&format!("{}: the log cannot be written: {error}", path.display()));
                }
            }
        }
    }
}
