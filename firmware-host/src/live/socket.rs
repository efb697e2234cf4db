//! The Unix socket: accepts clients, and gives each a thread that reads and a thread that writes.

use std::fs::Permissions;
use std::io::{ErrorKind, Read, Write};
use std::net::Shutdown;
use std::os::unix::fs::{FileTypeExt, PermissionsExt};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use live_link::{Frame, Line, LineReader};

use super::channels::Topic;
use super::hub::{Client, Hub, Outgoing};
use super::order_handler::OrderHandler;
use super::rate::pause;

/// A client that takes nothing for this long is cut off.
const WRITE_TIMEOUT: Duration = Duration::from_secs(2);
/// Pause after an error of the system, such as too many open files.
const PAUSE: Duration = Duration::from_millis(200);
/// Bytes that a reader takes at once.
const PIECE: usize = 4096;

/// The socket and its threads.
pub struct Server {
    path: PathBuf,
    ends: Arc<AtomicBool>,
    streams: Streams,
    thread: Option<JoinHandle<()>>,
}

/// The streams of the connected clients, to end them. A closed one is replaced by the next client.
type Streams = Arc<Mutex<Vec<std::sync::Weak<UnixStream>>>>;

impl Server {
    /// Opens the socket, readable and writable for its owner only, and accepts clients.
    ///
    /// # Errors
    /// A path that cannot be used, or that another program serves.
    pub fn start(path: &Path, hub: Arc<Hub>, handler: Arc<OrderHandler>) -> Result<Self> {
        let listener = listen(path)?;
        let ends = Arc::new(AtomicBool::new(false));
        let streams = Streams::default();
        let accepting = Accepting {
            listener,
            hub,
            handler,
            ends: Arc::clone(&ends),
            streams: Arc::clone(&streams),
        };
        let thread = thread_named("live-accept").spawn(move || accepting.run())?;
        Ok(Self { path: path.to_owned(), ends, streams, thread: Some(thread) })
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Release);
        // Wakes the thread that waits for a client.
        let woken = UnixStream::connect(&self.path).is_ok();
        if let Some(thread) = self.thread.take().filter(|_| woken) {
            let _ = thread.join();
        }
        let streams = self.streams.lock().unwrap_or_else(PoisonError::into_inner);
        for stream in streams.iter().filter_map(std::sync::Weak::upgrade) {
            let _ = stream.shutdown(Shutdown::Both);
        }
        let _ = std::fs::remove_file(&self.path);
    }
}

/// Opens the socket under a name that only this process knows, so that it never has other rights than its owner's.
fn listen(path: &Path) -> Result<UnixListener> {
    match std::fs::symlink_metadata(path) {
        Ok(found) if !found.file_type().is_socket() => {
            bail!("{}: there is a file that is not a socket; name another path", cannot_serve(path))
        }
        Ok(_) if UnixStream::connect(path).is_ok() => {
            bail!("{}: another robot serves it; name another path", cannot_serve(path))
        }
        _ => {}
    }
    if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        std::fs::create_dir_all(folder).with_context(|| cannot_serve(path))?;
    }
    let mut private = path.as_os_str().to_owned();
    private.push(format!(".{}", std::process::id()));
    let private = PathBuf::from(private);
    let _ = std::fs::remove_file(&private);
    let listener = UnixListener::bind(&private).with_context(|| cannot_serve(path))?;
    let opened = std::fs::set_permissions(&private, Permissions::from_mode(0o600))
        .and_then(|()| std::fs::rename(&private, path));
    if opened.is_err() {
        let _ = std::fs::remove_file(&private);
    }
    opened.with_context(|| cannot_serve(path))?;
    Ok(listener)
}

fn cannot_serve(path: &Path) -> String {
    format!("cannot serve the live view at {}", path.display())
}

/// What the thread that accepts owns.
struct Accepting {
    listener: UnixListener,
    hub: Arc<Hub>,
    handler: Arc<OrderHandler>,
    ends: Arc<AtomicBool>,
    streams: Streams,
}

impl Accepting {
    fn run(self) {
        for stream in self.listener.incoming() {
            if self.ends.load(Ordering::Acquire) {
                return;
            }
            let welcomed = stream.map_err(anyhow::Error::from).and_then(|it| self.welcome(it));
            if let Err(error) = welcomed {
                tracing::debug!("a client of the live view was not accepted: {error:#}");
                pause(PAUSE);
            }
        }
    }

    fn welcome(&self, stream: UnixStream) -> Result<()> {
        stream.set_write_timeout(Some(WRITE_TIMEOUT))?;
        let Some((client, outgoing)) = self.hub.join() else { bail!("there are too many clients") };
        let reader = stream.try_clone()?;
        let stream = Arc::new(stream);
        {
            let mut streams = self.streams.lock().unwrap_or_else(PoisonError::into_inner);
            streams.retain(|stream| stream.strong_count() > 0);
            streams.push(Arc::downgrade(&stream));
        }
        let client_reader =
            ClientReader { client, hub: Arc::clone(&self.hub), handler: Arc::clone(&self.handler) };
        thread_named("live-write").spawn(move || write(&stream, &outgoing))?;
        thread_named("live-read").spawn(move || client_reader.read(reader))?;
        Ok(())
    }
}

fn thread_named(name: &str) -> std::thread::Builder {
    std::thread::Builder::new().name(name.to_owned())
}

/// A client's reading side.
struct ClientReader {
    client: Arc<Client>,
    hub: Arc<Hub>,
    handler: Arc<OrderHandler>,
}

impl ClientReader {
    fn read(self, mut stream: UnixStream) {
        let mut lines = LineReader::default();
        let mut piece = [0; PIECE];
        loop {
            let count = match stream.read(&mut piece) {
                Ok(0) => break,
                Ok(count) => count,
                Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                Err(_) => break,
            };
            let read = lines.push(piece.get(..count).unwrap_or_default());
            if !read.into_iter().all(|line| self.line(line)) {
                break;
            }
        }
        let dropped = self.client.dropped();
        if dropped > 0 {
            tracing::debug!("a client of the live view was too slow for {dropped} messages");
        }
        let _ = stream.shutdown(Shutdown::Both);
    }

    /// Whether the client is still there.
    fn line(&self, line: Result<Line, live_link::LineError>) -> bool {
        let answer = match line {
            Ok(Line::Subscribe(channels)) => {
                self.hub.subscribe(&self.client, &channels);
                return true;
            }
            Ok(Line::Order(order)) => self.handler.take(&order),
            Err(error) => self.handler.refuse(&error),
        };
        let Ok(frame) = Frame::Answer(answer).to_bytes() else { return false };
        self.client.deliver(frame)
    }
}

impl Drop for ClientReader {
    fn drop(&mut self) {
        self.hub.leave(&self.client);
    }
}

/// Writes the channels and then what is queued, until the client leaves or takes nothing any more.
fn write(stream: &UnixStream, outgoing: &Outgoing) {
    let mut stream = stream;
    let channels = Frame::Channels(Topic::ALL.map(Topic::channel).to_vec()).to_bytes();
    if channels.is_ok_and(|bytes| stream.write_all(&bytes).is_ok()) {
        while let Some(frame) = outgoing.next() {
            if stream.write_all(&frame).is_err() {
                break;
            }
        }
    }
    // The reader's `read` then returns too.
    let _ = stream.shutdown(Shutdown::Both);
}
