//! Server of the page: connections with limits of size, time and number.

use super::api::Api;
use super::connections::{Connections, Stream};
use super::guard::Guard;
use super::routes::{Shared, router};
use crate::clock;
use crate::live::Live;
use crate::store::Reader;
use axum::Router;
use cophase::modal::ModalFitter;
use cophase::{Error, Result};
use hyper::Request;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use std::net::{SocketAddr, TcpListener};
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;
use tokio::sync::{oneshot, watch};

/// Time for the headers of a request, and between two requests of one connection.
const HEADER_TIME: Duration = Duration::from_secs(10);
/// Time of a connection: a page that is open longer connects again by itself.
const CONNECTION_TIME: Duration = Duration::from_secs(3600);
/// Largest size of the headers of a request: a browser's are below 2 KiB.
const HEADER_BYTES: usize = 16 * 1024;

/// Where the page listens, and to whom.
#[derive(Debug, Clone)]
pub struct PageSettings {
    pub address: SocketAddr,
    /// Names of this machine that are accepted besides addresses.
    pub hosts: Vec<String>,
    pub token: Option<String>,
}

/// The page; it ends when it is dropped.
pub struct Page {
    address: SocketAddr,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Page {
    /// Starts the page of the store in the file `state`.
    ///
    /// # Errors
    /// [`Error::Value`] where the address is in use or not of this machine; those of opening the
    /// store.
    pub fn start(settings: PageSettings, state: &Path, live: &Live, fitter: Arc<ModalFitter>) -> Result<Self> {
        let asked = settings.address;
        let failed = |error: std::io::Error| {
            Error::Value(format!(
                "the page cannot listen on {asked} ({error}): name another port with --port (0: any that is free)"
            ))
        };
        let listener = TcpListener::bind(asked).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        let reader = Reader::open(state)?;
        let about = reader.about()?;
        let (changed, version) = watch::channel(0);
        live.listen(move |newest| {
            // Without an open page there is no receiver.
            let _ = changed.send(newest);
        });
        let api = Api { reader, about, live: live.clone(), fitter, started_s: clock::now_s() };
        let guard = Guard { address, hosts: settings.hosts, token: settings.token };
        let router = router(Shared { api: Arc::new(Mutex::new(api)), version }, guard);
        let runtime =
            tokio::runtime::Builder::new_current_thread().enable_io().enable_time().build().map_err(failed)?;
        let (stop, stopped) = oneshot::channel();
        let thread = std::thread::Builder::new().name("page".into());
        let thread = thread.spawn(move || {
            runtime.block_on(async {
                tokio::select! {
                    () = serve(listener, router) => {}
                    _ = stopped => {}
                }
            });
        });
        Ok(Self { address, stop: Some(stop), thread: Some(thread.map_err(failed)?) })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        if let Some(stop) = self.stop.take() {
            // It has ended already where it does not listen.
            let _ = stop.send(());
        }
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

async fn serve(listener: TcpListener, router: Router) {
    let Ok(listener) = tokio::net::TcpListener::from_std(listener) else { return };
    let connections = Arc::new(Connections::default());
    loop {
        let Ok((stream, peer)) = listener.accept().await else {
            // Usually too many open files: wait until some are closed.
            tokio::time::sleep(Duration::from_millis(100)).await;
            continue;
        };
        // Without a place it is closed unanswered.
        let Some(place) = Connections::take(&connections, peer.ip().to_canonical()) else { continue };
        let router = TowerToHyperService::new(router.clone());
        tokio::spawn(async move {
            let of_request = place.connection.clone();
            let service = service_fn(move |mut request: Request<Incoming>| {
                request.extensions_mut().insert(of_request.clone());
                router.call(request)
            });
            let stream = Stream::new(stream, place.connection.clone());
            let connection = http1::Builder::new()
                .timer(TokioTimer::new())
                .header_read_timeout(HEADER_TIME)
                .max_buf_size(HEADER_BYTES)
                .serve_connection(TokioIo::new(stream), service);
            tokio::select! {
                // A connection that the browser ends early is no error here.
                _ = tokio::time::timeout(CONNECTION_TIME, connection) => {}
                () = place.connection.ended() => {}
            }
        });
    }
}
