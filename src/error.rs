//! Every way to fail. A message is one sentence that names what was wrong, the value, and what is accepted; the numeric
//! status of each kind lives here and only here (the C boundary reads it from here).

use std::ffi::CStr;
use std::path::{Path, PathBuf};

/// What went wrong, in one sentence.
#[derive(Debug, Clone, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A scene that cannot be parsed, or that names something impossible: the key, the value, what is accepted.
    #[error("{0}")]
    Scene(String),
    /// A file that cannot be read or written: its path and the reason.
    #[error("{}: {reason}", path.display())]
    File {
        /// The file as the caller named it.
        path: PathBuf,
        /// Why, with the byte or the header card where that is known.
        reason: String,
    },
    /// An array whose shape does not fit the model.
    #[error("{0}")]
    Shape(String),
    /// A number out of its range.
    #[error("{0}")]
    Value(String),
    /// An image that holds nothing to fit: empty, constant, not finite, without signal.
    #[error("{0}")]
    Image(String),
    /// OpenCL is absent, or a device failed.
    #[error("{0}")]
    Device(String),
    /// The user asked to stop.
    #[error("stopped: {0}")]
    Interrupted(String),
    /// A broken promise of our own.
    #[error("internal error, please report it: {0}")]
    Internal(String),
    /// An argument of a call across the C boundary that cannot be used: NULL, misaligned, not text, overlapping.
    #[error("{0}")]
    Argument(String),
    /// An object that another thread is using.
    #[error("{0}")]
    Busy(String),
    /// A panic that was caught at the C boundary, or an object that one has left unusable.
    #[error("internal error, please report it: {0}")]
    Panic(String),
}

/// `Result` with [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// A failure of `path`, for the reason `reason`.
    pub fn file(path: impl AsRef<Path>, reason: impl std::fmt::Display) -> Self {
        Error::File { path: path.as_ref().to_path_buf(), reason: reason.to_string() }
    }

    /// The permanent number of this kind of failure; 0 is success.
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

    /// The name of a status number in C, if there is such a failure.
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
    fn every_failure_has_a_number_and_a_name_of_its_own() {
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
