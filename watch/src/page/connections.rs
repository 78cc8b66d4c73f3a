//! Connections of the page: how many there may be, and which one ends where another wants in.
//!
//! A client may open connections and read nothing, or send no token. It must not keep the owner of
//! the page out: where all places are taken, a new connection replaces one without a token, else
//! one whose client does not read.

use std::collections::HashMap;
use std::io;
use std::net::IpAddr;
use std::pin::Pin;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::sync::Notify;
use tokio::time::{Sleep, sleep};

/// Largest number of connections: a page has two or three.
const CONNECTIONS: usize = 64;
/// Largest number of connections of one address: several pages behind one router, and never all.
const CONNECTIONS_OF_A_PEER: usize = CONNECTIONS / 2;
/// Time in which a client must read something of an answer. An answer is some 100 KiB: a line of 10
/// KiB/s takes it.
const WRITE_TIME: Duration = Duration::from_secs(10);

/// A connection, as its requests see it.
pub struct Connection {
    peer: IpAddr,
    /// Whether the guard has let one of its requests pass.
    is_admitted: AtomicBool,
    /// Whether an answer waits for the client to read.
    is_stalled: AtomicBool,
    /// Wakes the task that serves it, which then ends.
    end: Notify,
}

impl Connection {
    /// The guard has let a request of this connection pass.
    pub fn admit(&self) {
        self.is_admitted.store(true, Relaxed);
    }

    /// Returns when the connection has to make room.
    pub async fn ended(&self) {
        self.end.notified().await;
    }
}

/// All connections, by the order of their arrival.
#[derive(Default)]
pub struct Connections {
    table: Mutex<(u64, HashMap<u64, Arc<Connection>>)>,
}

/// The place of a connection, which is free again when this is dropped.
pub struct Place {
    connections: Arc<Connections>,
    number: u64,
    pub connection: Arc<Connection>,
}

impl Drop for Place {
    fn drop(&mut self) {
        self.connections.table.lock().unwrap_or_else(PoisonError::into_inner).1.remove(&self.number);
    }
}

impl Connections {
    /// A place for a connection of `peer`; another one ends for it where there is none. `None`
    /// where all others have a token and read.
    ///
    /// A machine's own address stands for all its users, and for all that `ssh` brings here: it has
    /// no limit of its own.
    pub fn take(connections: &Arc<Self>, peer: IpAddr) -> Option<Place> {
        let mut table = connections.table.lock().unwrap_or_else(PoisonError::into_inner);
        let of_peer = table.1.values().filter(|other| other.peer == peer).count();
        let is_peer_full = !peer.is_loopback() && of_peer >= CONNECTIONS_OF_A_PEER;
        if is_peer_full || table.1.len() >= CONNECTIONS {
            let others = table.1.iter().filter(|(_, other)| !is_peer_full || other.peer == peer);
            let number = replaceable(others)?;
            if let Some(ended) = table.1.remove(&number) {
                ended.end.notify_one();
            }
        }
        table.0 += 1;
        let number = table.0;
        let connection = Arc::new(Connection {
            peer,
            is_admitted: AtomicBool::new(false),
            is_stalled: AtomicBool::new(false),
            end: Notify::new(),
        });
        table.1.insert(number, connection.clone());
        drop(table);
        Some(Place { connections: connections.clone(), number, connection })
    }
}

/// The connection that is replaced first: the oldest that the guard has not let pass, then the
/// oldest whose client does not read.
fn replaceable<'a>(connections: impl Iterator<Item = (&'a u64, &'a Arc<Connection>)>) -> Option<u64> {
    let order =
        |connection: &Connection| match (connection.is_admitted.load(Relaxed), connection.is_stalled.load(Relaxed)) {
            (false, _) => Some(0),
            (true, true) => Some(1),
            (true, false) => None,
        };
    connections.filter_map(|(number, connection)| Some((order(connection)?, *number))).min().map(|(_, number)| number)
}

/// A stream whose writing ends where the client reads nothing for [`WRITE_TIME`].
pub struct Stream {
    stream: TcpStream,
    connection: Arc<Connection>,
    /// When writing ends, while it waits.
    limit: Option<Pin<Box<Sleep>>>,
}

impl Stream {
    pub fn new(stream: TcpStream, connection: Arc<Connection>) -> Self {
        Self { stream, connection, limit: None }
    }

    /// Passes on what writing says, until its time is over.
    fn limited<T>(&mut self, context: &mut Context<'_>, written: Poll<io::Result<T>>) -> Poll<io::Result<T>> {
        self.connection.is_stalled.store(written.is_pending(), Relaxed);
        if written.is_ready() {
            self.limit = None;
            return written;
        }
        let limit = self.limit.get_or_insert_with(|| Box::pin(sleep(WRITE_TIME)));
        match limit.as_mut().poll(context) {
            Poll::Ready(()) => Poll::Ready(Err(io::ErrorKind::TimedOut.into())),
            Poll::Pending => Poll::Pending,
        }
    }
}

impl AsyncRead for Stream {
    fn poll_read(mut self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(context, bytes)
    }
}

impl AsyncWrite for Stream {
    fn poll_write(mut self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.limited(context, written)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write_vectored(context, slices);
        self.limited(context, written)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        // A socket holds nothing back, so that this never waits.
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SUMMIT: IpAddr = IpAddr::V4(std::net::Ipv4Addr::new(10, 0, 0, 1));
    const LOCAL: IpAddr = IpAddr::V4(std::net::Ipv4Addr::LOCALHOST);

    fn taken(connections: &Arc<Connections>, peer: IpAddr, count: usize) -> Vec<Place> {
        (0..count).map(|_| Connections::take(connections, peer).unwrap()).collect()
    }

    fn count(connections: &Connections) -> usize {
        connections.table.lock().unwrap().1.len()
    }

    #[test]
    fn unknown_connections_end_first_then_stalled_ones() {
        let connections = Arc::new(Connections::default());
        let places = taken(&connections, LOCAL, CONNECTIONS);
        places.iter().enumerate().filter(|(index, _)| *index != 5).for_each(|(_, place)| place.connection.admit());
        places[3].connection.is_stalled.store(true, Relaxed);
        let has = |index: usize| connections.table.lock().unwrap().1.contains_key(&places[index].number);
        let newest = Connections::take(&connections, LOCAL).unwrap();
        newest.connection.admit();
        assert!(!has(5) && has(3));
        let next = Connections::take(&connections, LOCAL).unwrap();
        next.connection.admit();
        assert!(!has(3) && has(0));
        // All others are admitted and read what they are sent.
        assert!(Connections::take(&connections, LOCAL).is_none());
        assert_eq!(count(&connections), CONNECTIONS);
        drop(places);
        assert_eq!(count(&connections), 2);
    }

    #[test]
    fn an_address_has_half_of_the_connections() {
        let connections = Arc::new(Connections::default());
        let places = taken(&connections, SUMMIT, CONNECTIONS_OF_A_PEER + 3);
        assert_eq!(count(&connections), CONNECTIONS_OF_A_PEER);
        places.iter().for_each(|place| place.connection.admit());
        assert!(Connections::take(&connections, SUMMIT).is_none());
        let own = taken(&connections, LOCAL, 4);
        assert_eq!(count(&connections), CONNECTIONS_OF_A_PEER + own.len());
    }
}
