//! Reading of many frames.

use super::classify::FrameClass;
use super::frame::{ChannelRule, RawFrame, file_name};
use super::log::LogRow;
use super::pupil_turns;
use crate::Error;
use std::path::PathBuf;

/// The frames in `files`, each with the class that a list gives it, and a row of the log for each
/// file that cannot be read. `turn_card` is the card with the angle of the pupil, with a sign or
/// without.
pub fn read_frames(
    files: &[(PathBuf, Option<FrameClass>)],
    rules: &[ChannelRule],
    turn_card: Option<&str>,
) -> (Vec<RawFrame>, Vec<LogRow>) {
    let turn_card = turn_card.map(|card| pupil_turns::card_and_sense(card).0);
    let (mut frames, mut rejected) = (Vec::new(), Vec::new());
    for (path, class) in files {
        match RawFrame::read(path, *class, rules, turn_card) {
            Ok(read) => frames.extend(read),
            Err(Error::File { reason, .. }) => rejected.push(LogRow::unreadable(file_name(path), reason)),
            Err(other) => rejected.push(LogRow::unreadable(file_name(path), other.to_string())),
        }
    }
    (frames, rejected)
}
