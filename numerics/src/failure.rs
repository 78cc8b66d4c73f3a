//! Failure of a decomposition.

use std::fmt;

/// Cause of the failure of a decomposition, in the solver's words; the caller knows which matrix it
/// was.
#[derive(Debug, Clone)]
pub struct Failure {
    cause: String,
}

impl Failure {
    pub(crate) fn new(cause: impl fmt::Debug) -> Self {
        Self { cause: format!("{cause:?}") }
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(&self.cause)
    }
}

impl std::error::Error for Failure {}
