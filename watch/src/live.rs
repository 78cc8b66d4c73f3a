//! What the page shows of the newest frame, beside what the store holds.

use cophase::modal::FittedImage;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Shared by the watcher, which writes it, and the page.
#[derive(Clone, Default)]
pub struct Live(Arc<Mutex<State>>);

type Listener = Box<dyn Fn(u64) + Send>;

#[derive(Default)]
struct State {
    /// Increases with every change.
    version: u64,
    image: Option<(i64, Arc<FittedImage>)>,
    problem: Option<String>,
    listener: Option<Listener>,
}

impl Live {
    fn state(&self) -> MutexGuard<'_, State> {
        // A thread that panicked has left whole values.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Calls `listener` with the new version after every change, from the watcher's thread.
    pub fn listen(&self, listener: impl Fn(u64) + Send + 'static) {
        self.state().listener = Some(Box::new(listener));
    }

    /// Something in the store is new; `image` is that of frame `id`.
    pub fn changed(&self, image: Option<(i64, FittedImage)>) {
        let mut state = self.state();
        state.version += 1;
        if let Some((id, image)) = image {
            state.image = Some((id, Arc::new(image)));
        }
        if let Some(listener) = &state.listener {
            listener(state.version);
        }
    }

    /// What hinders the watch now, such as a full disk; `None` where nothing does.
    pub fn set_problem(&self, problem: Option<String>) {
        let is_new = {
            let mut state = self.state();
            std::mem::replace(&mut state.problem, problem.clone()) != problem
        };
        if is_new {
            self.changed(None);
        }
    }

    pub fn problem(&self) -> Option<String> {
        self.state().problem.clone()
    }

    /// The newest image and the frame that it is of.
    pub fn image(&self) -> Option<(i64, Arc<FittedImage>)> {
        self.state().image.clone()
    }
}
