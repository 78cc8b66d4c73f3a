//! Source of frames: a stream of ImageStreamIO, the shared memory of milk and cacao.
//!
//! A thread reads frames as they are written, so that none is overwritten while another is
//! estimated; a circular buffer of the stream bridges longer pauses. Frames that were overwritten
//! unread are counted and reported.

mod layout;
mod reader;
mod semaphore;

pub use reader::RawFrame;

use cophase::{Error, Result};
use reader::{StreamReader, path_of};
use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Frames that wait for their estimate: at 100 a second, two thirds of one.
const WAITING: usize = 64;
/// Between two looks. A semaphore with a time limit would hang where the clock is set back
/// meanwhile, because its limit is a time of day.
const LOOK: Duration = Duration::from_micros(500);
/// Between two looks at the file, which is another one after the stream was made anew.
const LOOK_AT_FILE: Duration = Duration::from_millis(100);
/// Between two tries after the store has failed.
const RETRY: Duration = Duration::from_secs(1);
/// Shortest time between two sentences on lost frames.
const LOST_EVERY: Duration = Duration::from_secs(10);

/// What a stream has to tell.
#[derive(Debug)]
pub enum StreamNews {
    Frame(Box<RawFrame>),
    /// A sentence for the list of events.
    Sentence(String),
}

/// A stream.
pub struct Stream {
    name: String,
    news: Receiver<StreamNews>,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    /// Frames that the store did not take, and when they are tried again.
    again: VecDeque<Box<RawFrame>>,
    retry_at: Instant,
}

#[derive(Default)]
struct Shared {
    must_end: AtomicBool,
    /// Whether the last look found nothing new.
    is_dry: AtomicBool,
    waiting: AtomicUsize,
}

impl Stream {
    /// Starts to read the stream `name`, which need not be there yet.
    ///
    /// # Errors
    /// [`Error::Internal`] where no thread can be started.
    pub fn start(name: &str) -> Result<Self> {
        let (sender, news) = sync_channel(WAITING);
        let shared = Arc::new(Shared::default());
        let worker = Worker {
            path: path_of(name),
            name: name.into(),
            sender,
            shared: shared.clone(),
            said: None,
            lost: 0,
            lost_said: None,
        };
        let thread = std::thread::Builder::new().name("stream".into()).spawn(move || worker.run());
        let thread = thread.map_err(|error| Error::Internal(format!("no thread for the stream: {error}")))?;
        Ok(Self {
            name: name.into(),
            news,
            shared,
            thread: Some(thread),
            again: VecDeque::new(),
            retry_at: Instant::now(),
        })
    }

    /// Its name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The next frame or sentence, within `wait`.
    pub fn next(&mut self, wait: Duration) -> Option<StreamNews> {
        if !self.again.is_empty() {
            let now = Instant::now();
            if now < self.retry_at {
                std::thread::sleep(wait.min(self.retry_at - now));
                return None;
            }
            return self.again.pop_front().map(StreamNews::Frame);
        }
        let news = match self.news.recv_timeout(wait) {
            Ok(news) => news,
            Err(RecvTimeoutError::Timeout) => return None,
            Err(RecvTimeoutError::Disconnected) => {
                std::thread::sleep(wait);
                return None;
            }
        };
        self.shared.waiting.fetch_sub(1, Ordering::SeqCst);
        Some(news)
    }

    /// Takes a frame back that the store did not take.
    pub fn give_back(&mut self, frame: Box<RawFrame>) {
        self.again.push_front(frame);
        self.retry_at = Instant::now() + RETRY;
    }

    /// Whether everything that was there is handed over.
    pub fn is_idle(&self) -> bool {
        self.shared.is_dry.load(Ordering::SeqCst)
            && self.shared.waiting.load(Ordering::SeqCst) == 0
            && self.again.is_empty()
    }
}

impl Drop for Stream {
    fn drop(&mut self) {
        self.shared.must_end.store(true, Ordering::SeqCst);
        // The thread may wait for room: it is made.
        while self.thread.as_ref().is_some_and(|thread| !thread.is_finished()) {
            let _ = self.news.recv_timeout(LOOK);
        }
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// The thread that reads.
struct Worker {
    name: String,
    path: PathBuf,
    sender: SyncSender<StreamNews>,
    shared: Arc<Shared>,
    /// The last sentence on a stream that is not there, which is said once.
    said: Option<String>,
    lost: u64,
    lost_said: Option<Instant>,
}

impl Worker {
    fn run(mut self) {
        let mut was_open = false;
        while !self.must_end() {
            match StreamReader::open(&self.path) {
                Ok(reader) => {
                    self.said = None;
                    if was_open {
                        let (columns, rows) = (reader.header.columns, reader.header.rows);
                        self.say(format!("the stream {} was made anew, of {columns}x{rows} pixels", self.name));
                    }
                    was_open = true;
                    self.read(reader);
                }
                Err(error) => {
                    let sentence = format!("the stream {} cannot be read: {error}; waiting until it can", self.name);
                    if self.said.as_ref() != Some(&sentence) {
                        self.say(sentence.clone());
                        self.said = Some(sentence);
                    }
                    self.shared.is_dry.store(true, Ordering::SeqCst);
                    std::thread::sleep(LOOK_AT_FILE);
                }
            }
        }
    }

    /// Reads until the stream is another one.
    fn read(&mut self, mut reader: StreamReader) {
        let mut next_look = Instant::now() + LOOK_AT_FILE;
        while !self.must_end() {
            match reader.next() {
                Ok(Some(frame)) => {
                    self.shared.is_dry.store(false, Ordering::SeqCst);
                    self.lost += frame.lost;
                    self.send(StreamNews::Frame(Box::new(frame)));
                }
                Ok(None) => {
                    self.shared.is_dry.store(true, Ordering::SeqCst);
                    std::thread::sleep(LOOK);
                }
                // Damaged or cut short: opened again, which says why it cannot be read.
                Err(_) => return,
            }
            self.tell_lost();
            if Instant::now() >= next_look {
                if !reader.is_current(&self.path) {
                    return;
                }
                next_look = Instant::now() + LOOK_AT_FILE;
            }
        }
    }

    fn tell_lost(&mut self) {
        if self.lost > 0 && self.lost_said.is_none_or(|said| said.elapsed() >= LOST_EVERY) {
            let (name, lost) = (&self.name, self.lost);
            let sentence = format!("{lost} frames of the stream {name} were overwritten before they were read");
            (self.lost, self.lost_said) = (0, Some(Instant::now()));
            self.say(sentence);
        }
    }

    fn say(&self, sentence: String) {
        self.send(StreamNews::Sentence(sentence));
    }

    fn send(&self, news: StreamNews) {
        self.shared.waiting.fetch_add(1, Ordering::SeqCst);
        if self.sender.send(news).is_err() {
            self.shared.must_end.store(true, Ordering::SeqCst);
        }
    }

    fn must_end(&self) -> bool {
        self.shared.must_end.load(Ordering::SeqCst)
    }
}
