//! What a scene is read for.

/// What a scene is read for, which says how much of it must hold together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Purpose {
    /// It describes all that there is.
    Whole,
    /// It goes with arrays that stand for its pupil and, maybe, for its modes.
    Arrays,
}
