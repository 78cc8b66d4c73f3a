//! The service: takes what the source gives until it is stopped.

use crate::interrupt::Interrupt;
use crate::terminal::{Terminal, counted};
use crate::watch::folder::{Folder, News};
use crate::watch::frame_file::FrameReader;
use crate::watch::live::Live;
use crate::watch::log::Log;
use crate::watch::model::Model;
use crate::watch::page::{Page, PageSettings};
use crate::watch::store::{Event, Reader, Store};
use crate::watch::tracking::{Tracking, TrackingSettings};
use crate::watch::watcher::{Outcome, Watcher};
use cophase::pipeline::Policy;
use cophase::scene::Scene;
use cophase::{Error, Result};
use std::path::PathBuf;
use std::time::Duration;

/// Time between two looks at Ctrl-C.
const BREATH: Duration = Duration::from_millis(100);

/// What a watch is to do.
pub struct Settings {
    pub folder: PathBuf,
    pub scene: Scene,
    pub policy: Policy,
    pub state: PathBuf,
    pub reader: FrameReader,
    /// Between two scans of the folder.
    pub poll: Duration,
    /// How long an incomplete file must stay as it is before it is refused.
    pub settle: Duration,
    /// Whether to end once everything that is there is taken.
    pub once: bool,
    pub log: Option<PathBuf>,
    pub tracking: TrackingSettings,
    /// Where the page is; `None` for no page.
    pub page: Option<PageSettings>,
}

/// Watches until Ctrl-C, or with [`Settings::once`] until everything that is there is taken.
///
/// # Errors
/// Those of building the model and of opening the store; with [`Settings::once`] also [`Error::File`] where the store cannot be written.
pub fn run(settings: Settings, terminal: &Terminal, interrupt: &Interrupt) -> Result<()> {
    let folder = std::path::absolute(&settings.folder).map_err(|error| Error::file(&settings.folder, error))?;
    if !folder.is_dir() {
        return Err(Error::file(&settings.folder, "is no folder: the folder in which frames appear is needed"));
    }
    let model = {
        let _wait = terminal.wait("Building the model", 1);
        Model::new(settings.scene, settings.policy, interrupt)?
    };
    let store = Store::open(&settings.state, model.about(folder.display().to_string()))?;
    let tracking = Tracking::new(model.estimator.fitter().model(), &settings.tracking, store.tracker()?.as_deref())?;
    let mut source = Folder::new(&folder, &store.files()?, settings.poll, settings.settle);
    let log = Log::open(settings.log.as_deref())?;
    let (reader, live) = (settings.reader, Live::default());
    let page = settings
        .page
        .map(|page| Page::start(page, &settings.state, &live, model.estimator.fitter().clone()))
        .transpose()?;
    let mut watcher = Watcher { model, store, tracking, reader, log, live, terminal, interrupt };
    watcher
        .log
        .line("watch", serde_json::json!({ "folder": folder.display().to_string(), "process": std::process::id() }));
    if let Some(page) = &page {
        terminal.show(&format!("page: http://{}/\n", page.address()))?;
    }
    let ended = watch(&mut source, &mut watcher, settings.once, interrupt);
    drop(page);
    watcher.store.close()?;
    ended?;
    let counts = Reader::open(&settings.state)?.counts()?;
    terminal.show(&format!(
        "{}: {} with an estimate, {} refused\n",
        settings.state.display(),
        counted(counts.done as usize, "frame"),
        counts.refused
    ))
}

fn watch(source: &mut Folder, watcher: &mut Watcher, once: bool, interrupt: &Interrupt) -> Result<()> {
    loop {
        for news in source.wait(BREATH) {
            if interrupt.is_raised() {
                return Ok(());
            }
            match take(news, source, watcher) {
                Ok(()) => watcher.live.set_problem(None),
                Err(Error::Interrupted(_)) => return Ok(()),
                Err(error) if once => return Err(error),
                // A full disk, as a rule: the frame is given again at the next scan of the folder.
                Err(error) => {
                    let sentence = error.to_string();
                    if watcher.live.problem().as_ref() != Some(&sentence) {
                        watcher.event(&Event::now("disk", format!("{sentence}: the frame is tried again")));
                    }
                    watcher.live.set_problem(Some(sentence));
                }
            }
        }
        if interrupt.is_raised() || (once && source.is_idle()) {
            return Ok(());
        }
    }
}

fn take(news: News, source: &mut Folder, watcher: &mut Watcher) -> Result<()> {
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
            return Ok(());
        }
    };
    if !matches!(outcome, Ok(Outcome::Stored)) {
        source.forget(&path);
    }
    outcome.map(|_| ())
}
