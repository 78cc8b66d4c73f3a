//! Watcher: a frame in, its estimate in the store, the page and the log.

use crate::clock;
use crate::corrections;
use crate::folder::Stamp;
use crate::frame_file::{self, FrameFile, FrameReader};
use crate::live::Live;
use crate::log::Log;
use crate::model::{Model, rms_nm};
use crate::store::{Content, Entry, Event, FileRecord, Frame, Store};
use crate::stream::RawFrame;
use crate::tracking::{Step, Tracking};
use cophase::modes::Group;
use cophase::pipeline::{FrameEstimate, Images};
use cophase::{Error, Result};
use cophase_view::interrupt::Interrupt;
use cophase_view::terminal::Terminal;
use ndarray::Array3;
use serde_json::json;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

/// What became of a file.
#[derive(Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All its frames are in the store.
    Stored,
    /// It changed while it was read, or is gone: it is looked at again when it is seen again.
    Changed,
}

/// The watcher.
pub struct Watcher<'a> {
    pub model: Model,
    pub store: Store,
    pub tracking: Tracking,
    pub reader: FrameReader,
    /// Where corrections are written.
    pub corrections: Option<PathBuf>,
    pub log: Log,
    pub live: Live,
    pub terminal: &'a Terminal,
    pub interrupt: &'a Interrupt,
    /// Whether it was said that a file has no card of its time.
    pub has_said_undated: bool,
}

/// A frame that is to be estimated.
struct Pending<'a> {
    content: Content,
    image: usize,
    name: String,
    observed_s: f64,
    /// When it was complete, s since 1970.
    complete_s: f64,
    images: &'a [Images],
}

impl Watcher<'_> {
    /// Takes the complete file `path`; one whose bytes are known already adds nothing but its name.
    ///
    /// # Errors
    /// [`Error::File`] where the store cannot be written: then nothing of the frame is there, and
    /// the file can be given again; [`Error::Interrupted`].
    pub fn take_file(&mut self, path: &Path, stamp: Stamp) -> Result<Outcome> {
        let complete_s = clock::now_s();
        let Ok(content) = frame_file::content(path) else { return Ok(Outcome::Changed) };
        let record = record(path, stamp, content);
        if self.store.has_file(content)? {
            return self.note_name(&record);
        }
        let read = self.reader.read(path, &stamp);
        if Stamp::of(path) != Some(stamp) {
            return Ok(Outcome::Changed);
        }
        match read {
            Ok(file) => {
                self.say_undated(&file, path);
                self.take_images(&file, &record, complete_s)?;
            }
            Err(error @ Error::Interrupted(_)) => return Err(error),
            Err(error) => self.refuse(&record, &error.to_string())?,
        }
        Ok(Outcome::Stored)
    }

    /// Says of the first file without a card of its time what takes its place.
    fn say_undated(&mut self, file: &FrameFile, path: &Path) {
        if file.is_dated || self.has_said_undated {
            return;
        }
        self.has_said_undated = true;
        let sentence = format!(
            "{}: no card has the time of the observation (DATE-OBS, MJD-OBS or another): that of the file's last change is used, as for every \
             file without one",
            path.display()
        );
        self.terminal.warn(&sentence);
        self.log.line("undated", json!({ "sentence": sentence }));
    }

    /// Refuses the file `path`, which is not complete.
    ///
    /// # Errors
    /// As [`Watcher::take_file`].
    pub fn refuse_file(&mut self, path: &Path, stamp: Stamp, reason: &str) -> Result<Outcome> {
        // A file that may not be read is itself by its name and time.
        let content = frame_file::content(path).unwrap_or_else(|_| {
            let name = path.as_os_str().as_encoded_bytes();
            Content::of(&[name, &stamp.mtime_ns.to_le_bytes(), &stamp.size.to_le_bytes()].concat())
        });
        if Stamp::of(path) != Some(stamp) {
            return Ok(Outcome::Changed);
        }
        let record = record(path, stamp, content);
        if self.store.has_file(content)? {
            return self.note_name(&record);
        }
        self.refuse(&record, reason)?;
        Ok(Outcome::Stored)
    }

    /// Takes a frame of the stream `name`.
    ///
    /// # Errors
    /// As [`Watcher::take_file`].
    pub fn take_stream_frame(&mut self, name: &str, frame: &RawFrame) -> Result<()> {
        let words = [frame.inode as i64, frame.created[0], frame.created[1], frame.count as i64];
        let identity: Vec<u8> = words.into_iter().flat_map(i64::to_le_bytes).collect();
        let content = Content::of(&[name.as_bytes(), &identity].concat());
        if !self.store.images_of(content)?.is_empty() {
            return Ok(());
        }
        let now_s = clock::now_s();
        let known = |seconds: f64| if seconds > 0.0 { seconds } else { now_s };
        let pixels = Array3::from_shape_vec((1, frame.rows, frame.columns), frame.pixels.clone());
        let pixels = pixels.map_err(|error| Error::Internal(format!("a frame of a stream: {error}")))?;
        let pending = Pending {
            content,
            image: 0,
            name: format!("{name} frame {}", frame.count),
            observed_s: known(frame.acquired_s),
            complete_s: known(frame.written_s),
            images: &[self.reader.with_options(Images::new(pixels))],
        };
        self.take_frame(&pending, None)
    }

    /// Something that happened, in the store, the log and on the terminal.
    pub fn event(&mut self, event: &Event) {
        self.tell(event);
        // The store that cannot be written is an event itself, and must not be one for each try.
        if self.store.add_event(event).is_ok() {
            self.live.changed(None);
        }
    }

    fn tell(&mut self, event: &Event) {
        if event.kind == "correction" {
            // Standard output that is closed is found with the next frame.
            let _ = self.terminal.show(&format!("{}\n", event.sentence));
        } else {
            self.terminal.warn(&event.sentence);
        }
        self.log.line(event.kind, json!(event));
    }

    /// Another name of a file that was taken; its frames follow it where the former name is gone.
    fn note_name(&mut self, record: &FileRecord) -> Result<Outcome> {
        let former = self.store.names_of(record.content)?;
        let former = former.into_iter().find(|path| *path != record.path && !path.exists());
        self.store.add_file(record, former.as_deref())?;
        let path = record.path.display().to_string();
        match former {
            Some(former) => self.log.line("renamed", json!({ "name": path, "former": former.display().to_string() })),
            None => self.log.line("known", json!({ "name": path })),
        }
        Ok(Outcome::Stored)
    }

    fn refuse(&mut self, file: &FileRecord, reason: &str) -> Result<()> {
        let name = file.path.display().to_string();
        let observed_s = file.mtime_ns as f64 * 1e-9;
        let mut frame = Frame::refused(file.content, 0, name, observed_s, reason.to_owned());
        frame.taken_s = clock::now_s();
        let (tracker, events, applied, correction) = (None, &[][..], None, None);
        self.commit(&Entry { frame: &frame, tracker, events, applied, correction, file: Some(file) })?;
        Ok(())
    }

    fn take_images(&mut self, file: &FrameFile, record: &FileRecord, complete_s: f64) -> Result<()> {
        let there = self.store.images_of(record.content)?;
        let count = self.model.estimator.estimates_of(&file.images);
        for image in 0..count {
            let is_last = image + 1 == count;
            if there.contains(&image) {
                // The watcher ended between the frames of a file.
                if is_last {
                    self.store.add_file(record, None)?;
                }
                continue;
            }
            self.interrupt.check("the frames that were not taken are taken by the next watch")?;
            let name = record.path.display().to_string();
            let pending = Pending {
                content: record.content,
                image,
                name,
                observed_s: file.observed_s,
                complete_s,
                images: &file.images,
            };
            self.take_frame(&pending, is_last.then_some(record))?;
        }
        Ok(())
    }

    fn take_frame(&mut self, pending: &Pending, file: Option<&FileRecord>) -> Result<()> {
        let number = pending.image;
        let estimated = catch_unwind(AssertUnwindSafe(|| self.model.estimator.estimate(pending.images, number)));
        let (frame, mut step, image) = match estimated {
            Ok(Ok(estimate)) => {
                let (frame, step) = self.frame(pending, &estimate)?;
                (frame, step, estimate.compared)
            }
            Ok(Err(error @ Error::Interrupted(_))) => return Err(error),
            Ok(Err(error)) => (refused(pending, error.to_string()), None, None),
            Err(_) => {
                // What a panic leaves of a session is not known.
                self.model.renew(self.interrupt)?;
                (refused(pending, "the estimate failed by an internal error, please report it".into()), None, None)
            }
        };
        let correction = match (&self.corrections, &mut step) {
            (Some(path), Some(step)) => corrections::write(path, &self.model, &self.store, &frame, step)?,
            _ => None,
        };
        let id = self.commit(&Entry {
            frame: &frame,
            tracker: step.as_ref().map(|step| &step.state[..]),
            events: step.as_ref().map_or(&[][..], |step| &step.events[..]),
            applied: step.as_ref().and_then(|step| step.applied.as_ref()),
            correction: correction.as_ref(),
            file,
        })?;
        // Not before the store has it: a frame that is tried again meets the tracker as it was.
        if let Some(step) = step.filter(|_| id.is_some()) {
            self.tracking.adopt(step);
        }
        self.live.changed(id.zip(image));
        Ok(())
    }

    /// The record of an estimate, and what it does to the tracker.
    fn frame(&self, pending: &Pending, estimate: &FrameEstimate) -> Result<(Frame, Option<Step>)> {
        let mut frame = refused(pending, String::new());
        frame.reason.clone_from(&estimate.refusal);
        frame.fit = Some(estimate.report.status.word().to_owned());
        (frame.chi2, frame.flux_e, frame.background_e) =
            (estimate.report.reduced_chi2, estimate.report.flux_e, estimate.report.background_e);
        frame.warnings.clone_from(&estimate.warnings);
        if estimate.modes.coefficients_nm.iter().all(|nm| nm.is_finite()) {
            let model = self.model.estimator.fitter().model();
            frame.phasing_rms_nm = rms_nm(model, &estimate.modes.coefficients_nm, Group::Segment)?;
            frame.ncpa_rms_nm = rms_nm(model, &estimate.modes.coefficients_nm, Group::Ncpa)?;
            frame.coefficients_nm = self.tracking.without_pointing(&estimate.modes.coefficients_nm);
            frame.pointing_pixels = self.tracking.pointing_pixels(estimate);
            frame.sigma_nm = estimate.modes.sigma_nm();
        }
        let mut step = None;
        if frame.reason.is_none() {
            match self.tracking.step(pending.observed_s, estimate, &self.model.labels()) {
                Ok(found) => {
                    frame.warnings.extend(found.outlier.clone());
                    frame.tracked_nm.clone_from(&found.tracked_nm);
                    frame.tracked_sigma_nm.clone_from(&found.tracked_sigma_nm);
                    step = Some(found);
                }
                Err(error) => frame.reason = Some(error.to_string()),
            }
        }
        frame.taken_s = clock::now_s();
        frame.latency_s = (frame.taken_s - pending.complete_s).max(0.0);
        Ok((frame, step))
    }

    /// Stores a frame, and says so.
    fn commit(&mut self, entry: &Entry) -> Result<Option<i64>> {
        let Some(id) = self.store.commit(entry)? else { return Ok(None) };
        let Entry { frame, events, .. } = *entry;
        let name = if frame.image > 0 { format!("{} image {}", frame.name, frame.image) } else { frame.name.clone() };
        match &frame.reason {
            Some(reason) => {
                self.terminal.warn(&format!("refused: {name}: {reason}"));
                self.log.line(
                    "refused",
                    json!({ "frame": id, "name": frame.name, "image": frame.image, "reason": reason }),
                );
            }
            None => {
                self.terminal.show(&format!(
                    "{name}: phasing {:.2} nm RMS, NCPA {:.2} nm RMS, reduced chi-square {:.3}, {:.3} s\n",
                    frame.phasing_rms_nm, frame.ncpa_rms_nm, frame.chi2, frame.latency_s
                ))?;
                self.log.line(
                    "frame",
                    json!({
                        "frame": id, "name": frame.name, "image": frame.image, "observed_s": frame.observed_s,
                        "phasing_rms_nm": frame.phasing_rms_nm, "ncpa_rms_nm": frame.ncpa_rms_nm,
                        "reduced_chi2": frame.chi2, "pointing_pixels": frame.pointing_pixels, "latency_s": frame.latency_s, "warnings": frame.warnings,
                    }),
                );
            }
        }
        for event in events {
            self.tell(event);
        }
        Ok(Some(id))
    }
}

fn record(path: &Path, stamp: Stamp, content: Content) -> FileRecord {
    let Stamp { size, mtime_ns, inode } = stamp;
    FileRecord { path: path.to_path_buf(), size, mtime_ns, inode, content }
}

fn refused(pending: &Pending, reason: String) -> Frame {
    let Pending { content, image, name, observed_s, .. } = pending;
    let mut frame = Frame::refused(*content, *image, name.clone(), *observed_s, reason);
    frame.taken_s = clock::now_s();
    frame
}
