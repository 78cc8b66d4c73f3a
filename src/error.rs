//! Errors of the library. A message is one sentence that names what was wrong, the value, and what
//! is accepted. The status number of each kind is defined here only; the C interface uses it.

use std::ffi::CStr;
use std::path::{Path, PathBuf};

/// Error with its message, one sentence.
#[derive(Debug, Clone, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A scene that cannot be parsed or has an impossible value: the key, the value, what is
    /// accepted.
    #[error("{0}")]
    Scene(String),
    /// A file that cannot be read or written: its path and the reason.
    #[error("{}: {reason}", path.display())]
    File {
        /// Path as the caller gave it.
        path: PathBuf,
        /// Reason, with the byte or the header card if known.
        reason: String,
    },
    /// An array whose shape does not match the model.
    #[error("{0}")]
    Shape(String),
    /// A number out of its range.
    #[error("{0}")]
    Value(String),
    /// An image that cannot be fitted: empty, constant, not finite, without signal.
    #[error("{0}")]
    Image(String),
    /// OpenCL is not installed, or a device failed.
    #[error("{0}")]
    Device(String),
    /// The user cancelled the call.
    #[error("stopped: {0}")]
    Interrupted(String),
    /// A defect of this library.
    #[error("internal error, please report it: {0}")]
    Internal(String),
    /// An argument of a call across the C boundary that cannot be used: NULL, misaligned, not text,
    /// overlapping.
    #[error("{0}")]
    Argument(String),
    /// An object that is in use by another thread.
    #[error("{0}")]
    Busy(String),
    /// A panic that was caught at the C boundary, or an object that a panic has made unusable.
    #[error("internal error, please report it: {0}")]
    Panic(String),
}

/// `Result` with [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// Error of the file `path`.
    pub fn file(path: impl AsRef<Path>, reason: impl std::fmt::Display) -> Self {
        Error::File { path: path.as_ref().to_path_buf(), reason: reason.to_string() }
    }

    /// This error, of the images of the channel `name`.
    pub(crate) fn of_channel(self, name: &str) -> Self {
        let about = |sentence: String| format!("channel {name}: {sentence}");
        match self {
            Error::Image(sentence) => Error::Image(about(sentence)),
            Error::Shape(sentence) => Error::Shape(about(sentence)),
            Error::Value(sentence) => Error::Value(about(sentence)),
            Error::Argument(sentence) => Error::Argument(about(sentence)),
            other => other,
        }
    }

    /// Status number of this kind of error; it does not change between versions. 0 is success.
    pub fn status(&self) -> i32 {
        match self {
            Error::Scene(_) => 1,
            Error::File { .. } => 2,
            Error::Shape(_) => 3,
            Error::Value(_) => 4,
            Error::Image(_) => 5,
            Error::Device(_) => 6,
            Error::Interrupted(_) => 7,
            Error::Internal(_) => 8,
            Error::Argument(_) => 9,
            Error::Busy(_) => 10,
            Error::Panic(_) => 11,
        }
    }

    /// Name of a status number in C; `None` for a number without an error.
    pub fn status_name(status: i32) -> Option<&'static CStr> {
        Some(match status {
            1 => c"BAD_SCENE",
            2 => c"BAD_FILE",
            3 => c"BAD_SHAPE",
            4 => c"BAD_VALUE",
            5 => c"BAD_IMAGE",
            6 => c"DEVICE",
            7 => c"INTERRUPTED",
            8 => c"INTERNAL",
            9 => c"BAD_ARGUMENT",
            10 => c"BUSY",
            11 => c"PANIC",
            _ => return None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_error_has_a_distinct_number_and_name() {
        let text = String::new;
        let all = [
            Error::Scene(text()),
            Error::file("", ""),
            Error::Shape(text()),
            Error::Value(text()),
            Error::Image(text()),
            Error::Device(text()),
            Error::Interrupted(text()),
            Error::Internal(text()),
            Error::Argument(text()),
            Error::Busy(text()),
            Error::Panic(text()),
        ];
        let names: std::collections::HashSet<_> =
            all.iter().map(|error| Error::status_name(error.status()).expect("a name")).collect();
        assert_eq!(names.len(), all.len());
        assert!(Error::status_name(0).is_none() && Error::status_name(12).is_none());
    }
}
