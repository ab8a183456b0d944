//! A relay before rerun's server that cuts a client which takes nothing for five seconds.
//!
//! A frozen browser tab is never dropped by the server itself: it holds the stream up until its queues are
//! full, and then the program with them.

use std::io;
use std::net::{Ipv4Addr, TcpListener};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::timeout;

/// Longest time that a client may take nothing.
pub(super) const PATIENCE: Duration = Duration::from_secs(5);
/// Most connections at a time.
const CONNECTIONS: usize = 32;

/// Relays every connection on `listener` to `port` on loopback, for ever.
pub(super) async fn serve(listener: TcpListener, port: u16) -> io::Result<()> {
    let listener = tokio::net::TcpListener::from_std(listener)?;
    let places = std::sync::Arc::new(tokio::sync::Semaphore::new(CONNECTIONS));
    loop {
        let client = match listener.accept().await {
            Ok((client, _)) => client,
            // A client that has gone again, or no file descriptor left: neither ends the relay.
            Err(error) => {
                tracing::warn!(%error, "live view: a client could not be accepted");
                tokio::time::sleep(Duration::from_millis(100)).await;
                continue;
            }
        };
        let Ok(place) = places.clone().try_acquire_owned() else {
            tracing::warn!("live view: more than {CONNECTIONS} connections; one was refused");
            continue;
        };
        tokio::spawn(async move {
            let _place = place;
            match relay(client, port, PATIENCE).await {
                Err(error) if error.kind() == io::ErrorKind::TimedOut => {
                    tracing::warn!("live view: a client took nothing for {PATIENCE:?} and was cut off");
                }
                // Clients come and go.
                _ => {}
            }
        });
    }
}

/// Relays one connection until either side ends it.
async fn relay(client: TcpStream, port: u16, patience: Duration) -> io::Result<()> {
    let server = TcpStream::connect((Ipv4Addr::LOCALHOST, port)).await?;
    client.set_nodelay(true)?;
    server.set_nodelay(true)?;
    let (client_read, client_write) = client.into_split();
    let (server_read, server_write) = server.into_split();
    // Either direction's end ends both: dropping the halves closes the connections.
    tokio::select! {
        r = copy(server_read, client_write, patience) => r,
        r = copy(client_read, server_write, patience) => r,
    }
}

/// Copies until `from` ends. Reading may take as long as it likes; every piece must be taken within `patience`.
async fn copy(mut from: impl AsyncRead + Unpin, mut to: impl AsyncWrite + Unpin, patience: Duration) -> io::Result<()> {
    let mut buffer = vec![0; 1 << 16];
    loop {
        let read = from.read(&mut buffer).await?;
        if read == 0 {
            return to.shutdown().await;
        }
        let mut rest = &buffer[..read];
        while !rest.is_empty() {
            let written = timeout(patience, to.write(rest)).await.map_err(|_| io::ErrorKind::TimedOut)??;
            if written == 0 {
                return Err(io::ErrorKind::WriteZero.into());
            }
            rest = &rest[written..];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A server that sends without end to whoever connects.
    async fn fountain() -> u16 {
        let listener = tokio::net::TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await.unwrap();
        let port = listener.local_addr().unwrap().port();
        tokio::spawn(async move {
            while let Ok((mut client, _)) = listener.accept().await {
                tokio::spawn(async move { while client.write_all(&[7; 4096]).await.is_ok() {} });
            }
        });
        port
    }

    async fn connected() -> (TcpStream, TcpStream) {
        let listener = tokio::net::TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await.unwrap();
        let client = TcpStream::connect(listener.local_addr().unwrap()).await.unwrap();
        (client, listener.accept().await.unwrap().0)
    }

    #[tokio::test]
    async fn a_client_that_takes_nothing_is_cut_off() {
        let port = fountain().await;
        let (client, accepted) = connected().await;
        let error = relay(accepted, port, Duration::from_millis(100)).await.unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::TimedOut);
        drop(client);
    }

    #[tokio::test]
    async fn a_client_that_reads_is_served_for_longer_than_the_patience() {
        let port = fountain().await;
        let (mut client, accepted) = connected().await;
        let patience = Duration::from_millis(100);
        let relay = tokio::spawn(relay(accepted, port, patience));
        let mut taken = 0;
        let mut buffer = vec![0; 1 << 16];
        let end = tokio::time::Instant::now() + 4 * patience;
        while tokio::time::Instant::now() < end {
            taken += client.read(&mut buffer).await.unwrap();
        }
        assert!(taken > 1 << 20 && !relay.is_finished());
    }
}
