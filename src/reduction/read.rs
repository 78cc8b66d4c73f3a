//! Reading of many frames.

use super::classify::FrameClass;
use super::frame::{ChannelRule, Frame, file_name};
use super::log::LogRow;
use crate::Error;
use std::path::PathBuf;

/// The frames in `files`, each with the class that a list gives it, and a row of the log for each file that cannot be read.
pub fn read_frames(files: &[(PathBuf, Option<FrameClass>)], rules: &[ChannelRule]) -> (Vec<Frame>, Vec<LogRow>) {
    let (mut frames, mut rejected) = (Vec::new(), Vec::new());
    for (path, class) in files {
        match Frame::read(path, *class, rules) {
            Ok(read) => frames.extend(read),
            Err(Error::File { reason, .. }) => rejected.push(LogRow::unreadable(file_name(path), reason)),
            Err(other) => rejected.push(LogRow::unreadable(file_name(path), other.to_string())),
        }
    }
    (frames, rejected)
}
