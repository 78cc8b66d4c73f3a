//! The service: takes what the source gives until it is stopped.

use crate::folder::Folder;
use crate::frame_file::FrameReader;
use crate::live::Live;
use crate::log::Log;
use crate::model::Model;
use crate::page::{Page, PageSettings};
use crate::source::Source;
use crate::store::{Event, Reader, Store};
use crate::stream::Stream;
use crate::tracking::{Tracking, TrackingSettings};
use crate::watcher::Watcher;
use cophase::pipeline::Policy;
use cophase::scene::Scene;
use cophase::{Error, Result};
use cophase_view::interrupt::Interrupt;
use cophase_view::terminal::{Terminal, counted};
use std::path::PathBuf;
use std::time::Duration;

/// Time between two looks at Ctrl-C.
const BREATH: Duration = Duration::from_millis(100);

/// Where frames come from.
#[derive(Debug, Clone)]
pub enum Place {
    Folder(PathBuf),
    /// A stream of ImageStreamIO, by its name.
    Stream(String),
}

/// What a watch is to do.
pub struct Settings {
    pub place: Place,
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
    /// Where corrections are written; `None` for none.
    pub corrections: Option<PathBuf>,
    /// Where the page is; `None` for no page.
    pub page: Option<PageSettings>,
}

/// Watches until Ctrl-C, or with [`Settings::once`] until everything that is there is taken.
///
/// # Errors
/// Those of building the model and of opening the store; with [`Settings::once`] also
/// [`Error::File`] where the store cannot be written.
pub fn run(settings: Settings, terminal: &Terminal, interrupt: &Interrupt) -> Result<()> {
    let place = settings.place.checked()?;
    let model = {
        if let (Place::Stream(name), [_, ..]) = (&place, settings.scene.channels()) {
            return Err(Error::Scene(format!(
                "{}: the stream '{name}' has the frames of one channel, and the scene has {}: a folder with files that have the images of all \
                 channels is needed",
                settings.scene.name(),
                settings.scene.channels().len()
            )));
        }
        let _wait = terminal.wait("Building the model", 1);
        Model::new(settings.scene, settings.policy, interrupt)?
    };
    let store = Store::open(&settings.state, model.about(place.to_string()))?;
    if let Some(sentence) = store.incomplete() {
        terminal.warn(&format!("{}: {sentence}", settings.state.display()));
    }
    let tracking = Tracking::new(model.estimator.fitter(), &settings.tracking, store.tracker()?.as_deref())?;
    if let Some(warning) = tracking.warning() {
        terminal.warn(&warning);
    }
    let mut source = match &place {
        Place::Folder(folder) => {
            Source::Folder(Box::new(Folder::new(folder, &store.files()?, settings.poll, settings.settle)))
        }
        Place::Stream(name) => Source::Stream(Box::new(Stream::start(name)?)),
    };
    let log = Log::open(settings.log.as_deref())?;
    let (reader, live) = (settings.reader, Live::default());
    let page = settings
        .page
        .map(|page| Page::start(page, &settings.state, &live, model.estimator.fitter().clone()))
        .transpose()?;
    let corrections = settings.corrections;
    let mut watcher = Watcher {
        model,
        store,
        tracking,
        reader,
        corrections,
        log,
        live,
        terminal,
        interrupt,
        has_said_undated: false,
    };
    watcher.log.line("watch", serde_json::json!({ "source": place.to_string(), "process": std::process::id() }));
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

impl Place {
    /// # Errors
    /// [`Error::File`] for a folder that is none, [`Error::Value`] for a name that no stream has.
    fn checked(self) -> Result<Self> {
        match self {
            Self::Folder(folder) if !folder.is_dir() => {
                Err(Error::file(&folder, "is no folder: the folder in which frames appear is needed"))
            }
            Self::Folder(folder) => {
                std::path::absolute(&folder).map(Self::Folder).map_err(|error| Error::file(&folder, error))
            }
            Self::Stream(name) if name.is_empty() || name.contains('/') || name.len() > 79 => Err(Error::Value(
                format!("the stream '{name}' cannot be: a name of 1 to 79 characters without / is accepted"),
            )),
            stream => Ok(stream),
        }
    }
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Folder(folder) => write!(f, "{}", folder.display()),
            Self::Stream(name) => write!(f, "stream {name}"),
        }
    }
}

fn watch(source: &mut Source, watcher: &mut Watcher, once: bool, interrupt: &Interrupt) -> Result<()> {
    loop {
        for taken in source.take(BREATH, watcher) {
            match taken {
                Ok(()) => watcher.live.set_problem(None),
                Err(Error::Interrupted(_)) => return Ok(()),
                Err(error) if once => return Err(error),
                // A full disk, as a rule: the source gives the frame again.
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
