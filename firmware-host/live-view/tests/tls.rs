//! The server with TLS, and a client of another library.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that cannot set up its scene has failed"
)]

use std::fs::Permissions;
use std::net::SocketAddr;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use futures_util::StreamExt;
use live_view::access::{Access, Tokens, Transport};
use live_view::robot::Robot;
use live_view::server;
use live_view::tls::{self, TlsListener};
use rcgen::{CertifiedKey, generate_simple_self_signed};
use rustls::pki_types::{CertificateDer, ServerName};
use rustls::{ClientConfig, RootCertStore};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio_rustls::TlsConnector;
use tokio_tungstenite::client_async;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;

const TOKEN: &str = "aaaaaaaaaaaaaaaa1";
const PATIENCE: Duration = Duration::from_secs(30);

/// A certificate for `localhost` in files.
struct Files {
    dir: tempfile::TempDir,
    certificate: CertificateDer<'static>,
}

impl Files {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let CertifiedKey { cert, signing_key } =
            generate_simple_self_signed(["localhost".to_owned()]).unwrap();
        std::fs::write(dir.path().join("cert.pem"), cert.pem()).unwrap();
        write_key(&dir.path().join("key.pem"), &signing_key.serialize_pem());
        Self { dir, certificate: cert.der().clone() }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    /// The TLS of a client that trusts this certificate only.
    fn connector(&self) -> TlsConnector {
        let mut roots = RootCertStore::empty();
        roots.add(self.certificate.clone()).unwrap();
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let config = ClientConfig::builder_with_provider(provider)
            .with_safe_default_protocol_versions()
            .unwrap()
            .with_root_certificates(roots)
            .with_no_client_auth();
        TlsConnector::from(Arc::new(config))
    }
}

fn write_key(path: &Path, pem: &str) {
    std::fs::write(path, pem).unwrap();
    std::fs::set_permissions(path, Permissions::from_mode(0o600)).unwrap();
}

async fn serve(files: &Files) -> SocketAddr {
    let config = tls::config(&files.path("cert.pem"), &files.path("key.pem")).unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let tokens = Tokens::parse(&format!("anna steer {TOKEN}\n")).unwrap();
    let access =
        Access::new("0.0.0.0".parse().unwrap(), Transport::Tls, Some(tokens), Vec::new()).unwrap();
    let robot = Robot::connect(&files.path("no-robot.sock"));
    tokio::spawn(server::serve(TlsListener::new(listener, config).unwrap(), robot, access));
    address
}

/// The first message that a client with this token gets.
async fn first_message(files: &Files, address: SocketAddr, token: &str) -> Option<String> {
    let stream = TcpStream::connect(address).await.unwrap();
    let name = ServerName::try_from("localhost").unwrap();
    let stream = files.connector().connect(name, stream).await.unwrap();
    let url = format!("wss://localhost:{}/?token={token}", address.port());
    let mut request = url.into_client_request().unwrap();
    let protocol = "foxglove.sdk.v1".parse().unwrap();
    request.headers_mut().insert("sec-websocket-protocol", protocol);
    let (mut socket, _) = client_async(request, stream).await.ok()?;
    Some(socket.next().await?.ok()?.to_text().unwrap().to_owned())
}

#[tokio::test]
async fn a_client_that_trusts_the_certificate_and_has_a_token_is_served() {
    let files = Files::new();
    let address = serve(&files).await;
    let served = first_message(&files, address, TOKEN);
    let first = tokio::time::timeout(PATIENCE, served).await.unwrap().unwrap();
    assert!(first.contains("\"serverInfo\"") && first.contains("steer"), "{first}");
    assert!(first_message(&files, address, "wrong").await.is_none());
}

#[tokio::test]
async fn a_client_of_another_certificate_and_one_without_tls_get_nothing() {
    let files = Files::new();
    let address = serve(&files).await;
    let stream = TcpStream::connect(address).await.unwrap();
    let name = ServerName::try_from("localhost").unwrap();
    assert!(Files::new().connector().connect(name, stream).await.is_err());
    let mut plain = TcpStream::connect(address).await.unwrap();
    plain.write_all(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n").await.unwrap();
    let mut answer = Vec::new();
    let _ = tokio::time::timeout(PATIENCE, plain.read_to_end(&mut answer)).await.unwrap();
    assert!(!answer.starts_with(b"HTTP"), "{answer:?}");
}

#[tokio::test]
async fn clients_that_never_finish_their_handshake_do_not_keep_others_waiting() {
    let files = Files::new();
    let address = serve(&files).await;
    let mut silent = Vec::new();
    for _ in 0..20 {
        silent.push(TcpStream::connect(address).await.unwrap());
    }
    let served = first_message(&files, address, TOKEN);
    assert!(tokio::time::timeout(PATIENCE, served).await.unwrap().is_some());
}

#[test]
fn a_key_that_others_can_read_and_files_that_do_not_fit_are_refused_with_their_name() {
    let files = Files::new();
    let other = Files::new();
    let certificate = files.path("cert.pem");
    let key = files.path("key.pem");
    assert!(refusal(&files.path("none.pem"), &key).contains("none.pem"));
    assert!(refusal(&key, &key).contains("no certificate"));
    assert!(refusal(&certificate, &other.path("key.pem")).contains("cert.pem"));
    write_key(&files.path("empty.pem"), "");
    assert!(refusal(&certificate, &files.path("empty.pem")).contains("empty.pem"));
    std::fs::set_permissions(&key, Permissions::from_mode(0o640)).unwrap();
    assert!(refusal(&certificate, &key).contains("chmod 600"));
}

fn refusal(certificate: &Path, key: &Path) -> String {
    tls::config(certificate, key).map(drop).unwrap_err().to_string()
}
