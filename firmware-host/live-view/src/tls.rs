//! TLS for the page and the WebSocket.

use std::io;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use axum::serve::Listener;
use rustls::ServerConfig;
use rustls::crypto::ring;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Semaphore, mpsc};
use tokio_rustls::TlsAcceptor;
use tokio_rustls::server::TlsStream;

use crate::access::{Refused, refuse_if_others_can_read};

/// A client that has not finished its handshake after this time is cut off.
const HANDSHAKE_WITHIN: Duration = Duration::from_secs(10);
/// Handshakes at a time; more clients wait. Each costs some milliseconds of a processor.
const MOST_HANDSHAKES: usize = 32;
/// Pause after an error of the system, such as too many open files.
const PAUSE: Duration = Duration::from_millis(200);

type Accepted = (TlsStream<TcpStream>, SocketAddr);

/// Reads a certificate chain and its key, both as PEM.
///
/// # Errors
/// A file that cannot be read or is not PEM, a key that others can read, and a key of another certificate.
pub fn config(certificate: &Path, key: &Path) -> Result<Arc<ServerConfig>, Refused> {
    refuse_if_others_can_read(key)?;
    let chain = CertificateDer::pem_file_iter(certificate)
        .and_then(Iterator::collect::<Result<Vec<_>, _>>)
        .map_err(|error| Refused::of_file(certificate, &error))?;
    if chain.is_empty() {
        return Err(Refused::of_file(certificate, &"the file holds no certificate in PEM"));
    }
    let secret =
        PrivateKeyDer::from_pem_file(key).map_err(|error| Refused::of_file(key, &error))?;
    // The provider is named, because another crate of the workspace may have chosen one for the process.
    let config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .and_then(|builder| builder.with_no_client_auth().with_single_cert(chain, secret))
        .map_err(|error| Refused::of_file(certificate, &error))?;
    Ok(Arc::new(config))
}

/// Accepts clients whose TLS handshake has succeeded. A client that is slow with it does not keep others waiting.
pub struct TlsListener {
    address: SocketAddr,
    connections: mpsc::Receiver<Accepted>,
}

impl TlsListener {
    /// Accepts at this listener. Must be called in a tokio runtime.
    ///
    /// # Errors
    /// When the system does not know the listener's address.
    pub fn new(listener: TcpListener, config: Arc<ServerConfig>) -> io::Result<Self> {
        let address = listener.local_addr()?;
        let (sender, connections) = mpsc::channel(MOST_HANDSHAKES);
        tokio::spawn(accept(listener, TlsAcceptor::from(config), sender));
        Ok(Self { address, connections })
    }
}

impl Listener for TlsListener {
    type Io = TlsStream<TcpStream>;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> Accepted {
        match self.connections.recv().await {
            Some(connection) => connection,
            // The task that accepts ends only after this listener.
            None => std::future::pending().await,
        }
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        Ok(self.address)
    }
}

async fn accept(listener: TcpListener, acceptor: TlsAcceptor, sender: mpsc::Sender<Accepted>) {
    let free = Arc::new(Semaphore::new(MOST_HANDSHAKES));
    while !sender.is_closed() {
        let Ok(permit) = Arc::clone(&free).acquire_owned().await else { return };
        let (stream, address) = match listener.accept().await {
            Ok(accepted) => accepted,
            Err(error) => {
                tracing::debug!("a client was not accepted: {error}");
                tokio::time::sleep(PAUSE).await;
                continue;
            }
        };
        let handshake = acceptor.accept(stream);
        let sender = sender.clone();
        tokio::spawn(async move {
            match tokio::time::timeout(HANDSHAKE_WITHIN, handshake).await {
                Ok(Ok(stream)) => drop(sender.send((stream, address)).await),
                Ok(Err(error)) => tracing::debug!("{address}: no TLS: {error}"),
                Err(_) => tracing::debug!("{address}: its TLS handshake took too long"),
            }
            drop(permit);
        });
    }
}
