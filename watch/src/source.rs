//! Source of frames: a folder or a stream.

use crate::folder::{Folder, News};
use crate::store::Event;
use crate::stream::{Stream, StreamNews};
use crate::watcher::{Outcome, Watcher};
use cophase::Result;
use std::time::Duration;

/// Where frames come from.
pub enum Source {
    Folder(Box<Folder>),
    Stream(Box<Stream>),
}

impl Source {
    /// Waits up to `wait` for frames, and gives them to the watcher; the outcome of each. One that
    /// the store does not take is given again.
    pub fn take(&mut self, wait: Duration, watcher: &mut Watcher) -> Vec<Result<()>> {
        match self {
            Self::Folder(folder) => take_files(folder, wait, watcher),
            Self::Stream(stream) => take_frames(stream, wait, watcher),
        }
    }

    /// Whether everything that was there is taken.
    pub fn is_idle(&self) -> bool {
        match self {
            Self::Folder(folder) => folder.is_idle(),
            Self::Stream(stream) => stream.is_idle(),
        }
    }
}

fn take_files(folder: &mut Folder, wait: Duration, watcher: &mut Watcher) -> Vec<Result<()>> {
    let mut outcomes = Vec::new();
    for news in folder.wait(wait) {
        if watcher.interrupt.is_raised() {
            break;
        }
        let (path, outcome) = match news {
            News::File(path, stamp) => {
                let outcome = watcher.take_file(&path, stamp);
                (path, outcome)
            }
            News::Incomplete(path, stamp, reason) => {
                let outcome = watcher.refuse_file(&path, stamp, &reason);
                (path, outcome)
            }
            News::Sentence(sentence) => {
                watcher.event(&Event::now("source", sentence));
                continue;
            }
        };
        match outcome {
            Ok(Outcome::Stored) => {}
            Ok(Outcome::Changed) => folder.look_again(&path),
            Err(_) => folder.forget(&path),
        }
        outcomes.push(outcome.map(|_| ()));
    }
    outcomes
}

fn take_frames(stream: &mut Stream, wait: Duration, watcher: &mut Watcher) -> Vec<Result<()>> {
    let mut outcomes = Vec::new();
    while !watcher.interrupt.is_raised() {
        // What is there is taken without a wait, but for the first.
        let wait = if outcomes.is_empty() { wait } else { Duration::ZERO };
        match stream.next(wait) {
            None => break,
            Some(StreamNews::Sentence(sentence)) => watcher.event(&Event::now("source", sentence)),
            Some(StreamNews::Frame(frame)) => {
                let outcome = watcher.take_stream_frame(stream.name(), &frame);
                let is_stored = outcome.is_ok();
                outcomes.push(outcome);
                if !is_stored {
                    stream.give_back(frame);
                    break;
                }
            }
        }
    }
    outcomes
}
