//! The page of a night watch: HTTP/1.1 on this machine, everything embedded, no request to any
//! other place.
//!
//! It reads the store by a connection of its own in a thread of its own: no request can hold the
//! watcher up.

mod api;
mod connections;
mod guard;
mod routes;
mod server;

pub use guard::is_token;
pub use server::{Page, PageSettings};
