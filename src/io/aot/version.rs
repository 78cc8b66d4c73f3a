//! Version of a file of AOT, by which it is recognised.

use crate::Result;
use crate::io::read::FitsReader;
use crate::io::value::Card;

/// Card of the primary HDU with the version of the format.
pub(super) const VERSION: &str = "AOT-VERS";
/// Version that is written.
pub(super) const WRITTEN_VERSION: &str = "2.0.0";
/// Versions that are read.
const READ_VERSIONS: [&str; 2] = [WRITTEN_VERSION, "1.0.0"];
/// Card of an image with its times, a row of `AOT_TIME`.
pub const TIME_REFERENCE: &str = "TIME_UID";

/// Whether the open file is one of AOT, and is not read by the HDU in brackets behind its name.
pub fn is_aot(file: &FitsReader) -> bool {
    file.is_whole() && !file.written_at(0, VERSION).0.is_empty()
}

/// Refuses a version that is not known.
pub(super) fn check_version(file: &mut FitsReader) -> Result<()> {
    let version = match file.card_at(0, VERSION)? {
        Some(Card::Text(text)) => text.trim().to_owned(),
        other => other.map_or_else(String::new, |card| card.to_string()),
    };
    if READ_VERSIONS.contains(&version.as_str()) {
        return Ok(());
    }
    let accepted = READ_VERSIONS.join(" and ");
    Err(file.refuse(format!("has the version {version} of AOT (card {VERSION}), where {accepted} are accepted")))
}
