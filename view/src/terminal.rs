//! What a person sees: results on stdout, messages and progress on stderr.

use cophase::pipeline::{Progress, Stage};
use cophase::{Error, Result};
use indicatif::{HumanDuration, ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};
use std::io::{ErrorKind, IsTerminal, Write};
use std::sync::mpsc;
use std::thread::JoinHandle;
use std::time::Duration;

/// Exit status under --strict of an estimate with a warning, and of a check with a fault.
pub const DOUBTFUL_STATUS: u8 = 3;

/// Nothing shorter than this deserves a progress bar.
const PATIENCE: Duration = Duration::from_secs(1);

const BAR: &str = "{msg} {wide_bar} {pos}/{len}  {rate}  {left}";
const CLOCK: &str = "{spinner} {msg}  {elapsed}";

/// Where a verb speaks.
pub struct Terminal {
    quiet: bool,
}

impl Terminal {
    pub fn new(quiet: bool) -> Self {
        Self { quiet }
    }

    /// Writes what was asked for to stdout. A reader that has seen enough (`| head`) is no failure.
    pub fn print(&self, text: &str) -> Result<()> {
        let mut out = std::io::stdout().lock();
        match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
            Err(error) if error.kind() != ErrorKind::BrokenPipe => {
                Err(Error::file("stdout", format_args!("cannot be written: {error}")))
            }
            _ => Ok(()),
        }
    }

    /// Writes a result for people to stdout, unless --quiet.
    pub fn show(&self, text: &str) -> Result<()> {
        if self.quiet { Ok(()) } else { self.print(text) }
    }

    /// Prints `value` as one JSON object (or list) on stdout; what is not finite becomes null.
    pub fn json(&self, value: &impl serde::Serialize) -> Result<()> {
        let text = serde_json::to_string_pretty(value).map_err(|error| Error::Internal(error.to_string()))?;
        self.print(&(text + "\n"))
    }

    /// Something that a person should know, on stderr, unless --quiet.
    pub fn warn(&self, sentence: &str) {
        if !self.quiet {
            complain(&format!("warning: {sentence}"));
        }
    }

    /// Shows the progress of a call, whose [`Control`](cophase::pipeline::Control) calls
    /// [`Wait::observer`].
    pub fn follow(&self) -> Wait {
        self.wait(Stage::Preparing.label(), 1)
    }

    /// Shows that `what` takes its time: a bar with rate and time left where `steps` is more than
    /// one, else a clock.
    pub fn wait(&self, what: &str, steps: usize) -> Wait {
        let bar = ProgressBar::with_draw_target(Some(steps as u64), ProgressDrawTarget::hidden());
        bar.set_style(if steps > 1 { style(BAR) } else { style(CLOCK) });
        bar.set_message(what.to_string());
        let seen = !self.quiet && std::io::stderr().is_terminal();
        Wait { ticker: seen.then(|| Ticker::start(bar.clone())), bar }
    }
}

fn style(template: &str) -> ProgressStyle {
    // Templates are constants that indicatif accepts; its own style is the answer if one day it
    // does not.
    let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    // Writing into memory does not fail.
    style
        .with_key("rate", |state: &ProgressState, text: &mut dyn std::fmt::Write| {
            let _ = write!(text, "{:.1}/s", state.per_sec());
        })
        .with_key("left", |state: &ProgressState, text: &mut dyn std::fmt::Write| {
            // Unknown before the first step.
            if state.pos() > 0 {
                let _ = write!(text, "{:#} left", HumanDuration(state.eta()));
            }
        })
}

/// `1 image`, `2 images`.
pub fn counted(count: usize, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
}

/// One line on stderr; a failure to write there cannot be reported.
pub fn complain(message: &str) {
    let line: String = message.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    let _ = writeln!(std::io::stderr(), "cophase: {}", line.trim_end());
}

/// Progress of something; gone from the terminal when dropped.
pub struct Wait {
    bar: ProgressBar,
    ticker: Option<Ticker>,
}

impl Wait {
    /// `done` of `all` steps are done; how many there are was not known before.
    pub fn done_of(&self, done: usize, all: usize) {
        self.bar.set_length(all as u64);
        self.bar.set_position(done as u64);
    }

    /// Shows each stage of a call: a bar where it has steps, else a clock.
    pub fn observer(&self) -> impl FnMut(Progress) + Send + 'static {
        let bar = self.bar.clone();
        let mut shown = Stage::Idle;
        move |progress| {
            if progress.stage != shown {
                shown = progress.stage;
                bar.set_style(if progress.total > 1 { style(BAR) } else { style(CLOCK) });
                bar.set_length(progress.total.max(1));
                bar.set_message(progress.stage.label());
            }
            bar.set_position(progress.done);
        }
    }
}

impl Drop for Wait {
    fn drop(&mut self) {
        if let Some(ticker) = self.ticker.take() {
            ticker.stop();
        }
        self.bar.finish_and_clear();
    }
}

/// Makes a bar visible once it has waited long enough, whether or not the work reports back.
struct Ticker {
    stop: mpsc::Sender<()>,
    thread: JoinHandle<()>,
}

impl Ticker {
    fn start(bar: ProgressBar) -> Self {
        let (stop, stopped) = mpsc::channel();
        let thread = std::thread::spawn(move || {
            if stopped.recv_timeout(PATIENCE) == Err(mpsc::RecvTimeoutError::Timeout) {
                bar.set_draw_target(ProgressDrawTarget::stderr());
                bar.enable_steady_tick(Duration::from_millis(100));
            }
        });
        Self { stop, thread }
    }

    fn stop(self) {
        drop(self.stop);
        // A bar that failed to appear is not worth a word.
        let _ = self.thread.join();
    }
}
