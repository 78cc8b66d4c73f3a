//! A panic, which is a fault of ours, said in one line as every other failure: a script that runs
//! the program overnight reads a status and a sentence.

use std::sync::{Arc, Mutex, PoisonError};

/// What the first panic said, and where.
#[derive(Clone, Default)]
pub struct Panics(Arc<Mutex<Option<String>>>);

/// Keeps what panics say in place of printing it; `RUST_BACKTRACE` in the environment leaves the
/// printing as it is.
pub fn catch_panics() -> Panics {
    let panics = Panics::default();
    if std::env::var_os("RUST_BACKTRACE").is_some_and(|wanted| wanted != "0") {
        return panics;
    }
    let kept = panics.clone();
    std::panic::set_hook(Box::new(move |panic| {
        let payload = panic.payload();
        let words = payload.downcast_ref::<String>().map(String::as_str);
        let words = words.or_else(|| payload.downcast_ref::<&str>().copied()).unwrap_or("a panic without words");
        let place = panic.location().map(|place| format!(" ({}:{})", place.file(), place.line())).unwrap_or_default();
        // A thread that waits for one that panicked may panic for that alone: the first is the
        // reason.
        let mut first = kept.0.lock().unwrap_or_else(PoisonError::into_inner);
        first.get_or_insert_with(|| words.lines().collect::<Vec<_>>().join("; ") + &place);
    }));
    panics
}

impl Panics {
    /// What the first one said.
    pub fn sentence(&self) -> String {
        let first = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        first.clone().unwrap_or_else(|| "a panic, as printed above".into())
    }
}
