//! Purpose for which a scene is read.

/// Purpose for which a scene is read; it determines which keys must be complete.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Purpose {
    /// The scene is complete by itself.
    Whole,
    /// Arrays of the caller replace the scene's pupil and optionally its modes.
    Arrays,
}
