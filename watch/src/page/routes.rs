//! Addresses of the page.

use super::api::{Api, MOST_ROWS, TREND};
use super::guard::{Guard, guard};
use axum::Router;
use axum::extract::{Path, State};
use axum::http::{StatusCode, Uri, header};
use axum::middleware::from_fn_with_state;
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use cophase::{Error, Result};
use futures_util::stream::{self, Stream};
use serde_json::{Value, json};
use std::convert::Infallible;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::watch::Receiver;

/// What the handlers share.
#[derive(Clone)]
pub struct Shared {
    /// The connection to the store is one request's at a time.
    pub api: Arc<Mutex<Api>>,
    /// Version of what is shown.
    pub version: Receiver<u64>,
}

/// All addresses, behind the guard.
pub fn router(shared: Shared, rules: Guard) -> Router {
    let file = |kind: &'static str, text: &'static str| {
        get(move || async move { ([(header::CONTENT_TYPE, kind)], text).into_response() })
    };
    Router::new()
        .route("/", file("text/html; charset=utf-8", include_str!("page.html")))
        .route("/page.css", file("text/css; charset=utf-8", include_str!("page.css")))
        .route("/charts.js", file("text/javascript; charset=utf-8", include_str!("charts.js")))
        .route("/page.js", file("text/javascript; charset=utf-8", include_str!("page.js")))
        .route("/icon.svg", file("image/svg+xml", include_str!("icon.svg")))
        .route("/api/status", get(|State(s): State<Shared>| async move { s.answer(Api::status) }))
        .route("/api/mirror", get(|State(s): State<Shared>| async move { s.answer(Api::mirror) }))
        .route("/api/ncpa", get(|State(s): State<Shared>| async move { s.answer(Api::ncpa) }))
        .route("/api/image", get(|State(s): State<Shared>| async move { s.answer(|api| Ok(api.image())) }))
        .route("/api/trend", get(|State(s): State<Shared>, uri: Uri| async move { s.limited(&uri, TREND, Api::trend) }))
        .route("/api/events", get(|State(s): State<Shared>, uri: Uri| async move { s.limited(&uri, 100, Api::events) }))
        .route(
            "/api/corrections",
            get(|State(s): State<Shared>, uri: Uri| async move { s.limited(&uri, 50, Api::corrections) }),
        )
        .route(
            "/api/refused",
            get(|State(s): State<Shared>, uri: Uri| async move { s.limited(&uri, 50, Api::refused) }),
        )
        .route(
            "/api/frames",
            get(|State(s): State<Shared>, uri: Uri| async move {
                match number(&uri, "after", 0, i64::MAX) {
                    Ok(after) => s.limited(&uri, 100, move |api, limit| api.frames(after, limit)),
                    Err(error) => refused(&error),
                }
            }),
        )
        .route(
            "/api/frames/{id}",
            get(|State(s): State<Shared>, Path(id): Path<String>| async move {
                match id.parse::<i64>().ok().filter(|id| *id > 0) {
                    Some(id) => s.answer(move |api| api.frame(id)),
                    None => refused(&Error::Value("the number of a frame is accepted, from 1".into())),
                }
            }),
        )
        .route(
            "/api/segments/{segment}",
            get(|State(s): State<Shared>, Path(id): Path<String>, uri: Uri| async move {
                match id.parse::<usize>() {
                    Ok(segment) => s.limited(&uri, TREND, move |api, limit| api.segment(segment, limit)),
                    Err(_) => refused(&Error::Value("the number of a segment is accepted, from 0".into())),
                }
            }),
        )
        .route("/api/changes", get(|State(s): State<Shared>| async move { changes(s.version) }))
        .fallback(|| async { (StatusCode::NOT_FOUND, "there is nothing at this address\n") })
        .with_state(shared)
        .layer(from_fn_with_state(Arc::new(rules), guard))
}

impl Shared {
    fn answer(&self, make: impl FnOnce(&Api) -> Result<Value>) -> Response {
        // A handler that panicked has changed nothing.
        let api = self.api.lock().unwrap_or_else(PoisonError::into_inner);
        match make(&api) {
            Ok(value) => json_of(StatusCode::OK, &value),
            Err(error) => refused(&error),
        }
    }

    fn limited(&self, uri: &Uri, usual: i64, make: impl FnOnce(&Api, usize) -> Result<Value>) -> Response {
        match number(uri, "limit", usual, MOST_ROWS as i64) {
            Ok(limit) => self.answer(|api| make(api, limit as usize)),
            Err(error) => refused(&error),
        }
    }
}

fn json_of(status: StatusCode, value: &Value) -> Response {
    (status, [(header::CONTENT_TYPE, "application/json")], value.to_string()).into_response()
}

fn refused(error: &Error) -> Response {
    let status =
        if matches!(error, Error::Value(_)) { StatusCode::BAD_REQUEST } else { StatusCode::SERVICE_UNAVAILABLE };
    json_of(status, &json!({ "error": error.to_string() }))
}

/// The number `key` of a query, from 0 to `most`.
fn number(uri: &Uri, key: &str, usual: i64, most: i64) -> Result<i64> {
    let query = uri.query().unwrap_or_default();
    let given = query.split('&').find_map(|pair| pair.split_once('=').filter(|(name, _)| *name == key));
    let Some((_, text)) = given else { return Ok(usual) };
    let parsed = text.parse::<i64>().ok().filter(|number| (0..=most).contains(number));
    parsed.ok_or_else(|| Error::Value(format!("{key} is not a number from 0 to {most}")))
}

/// Server-sent events: the version of what is shown, now and after every change. A page that is
/// slow gets the newest alone.
fn changes(version: Receiver<u64>) -> Sse<impl Stream<Item = std::result::Result<Event, Infallible>>> {
    let stream = stream::unfold((version, true), |(mut version, is_first)| async move {
        if !is_first {
            version.changed().await.ok()?;
        }
        let newest = *version.borrow_and_update();
        Some((Ok(Event::default().event("changed").data(newest.to_string())), (version, false)))
    });
    Sse::new(stream).keep_alive(KeepAlive::new().interval(Duration::from_secs(15)))
}
