//! Purpose for which a scene is read.

/// Purpose for which a scene is read; it determines which keys must be complete.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Purpose {
    /// The scene is complete by itself.
    Whole,
    /// The scene is the one in an image file. The files that it names may be on another machine:
    /// one that nothing reads may be missing.
    Embedded,
    /// Arrays of the caller replace the scene's pupil and optionally its modes.
    Arrays,
}
