//! Every way to fail. A message is one sentence that names what was wrong, the value, and what is accepted; the numeric
//! status of each kind lives here and only here (the C boundary reads it from here).

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
        }
    }
}
