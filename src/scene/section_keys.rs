//! Keys of a section.

use super::table::Key;

/// Section in the table of all keys.
pub(super) struct SectionKeys {
    pub(super) name: &'static str,
    pub(super) about: &'static str,
    pub(super) keys: Vec<Key>,
}
