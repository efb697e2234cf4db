//! A buffer behind two byte streams.

use std::io::{self, ErrorKind, Read, Write};

use super::Source;
use crate::catalogue::Entry;
use crate::computer::Computer;
use crate::digest::Digest;
use crate::error::BufferError;
use crate::name::Name;
use crate::send::{Have, Receive};
use crate::wire::{MAX_REPLY, Reply, Request, VERSIONS, WireError, read_frame, write_frame};

/// No robot has more files; a hostile one could send entries until the memory is full.
const MAX_ENTRIES: usize = 200_000;

/// Speaks with `firmware-host buffer serve`. Believes nothing: names are checked, offsets must follow each other, and what
/// arrives must have the digest that was promised.
pub struct Remote<R, W> {
    from: String,
    version: u16,
    input: R,
    output: W,
    body: Vec<u8>,
    buffer: Vec<u8>,
    /// For the error that says so.
    stall_s: u64,
}

impl<R: Read, W: Write> Remote<R, W> {
    /// Greets the other side, which is called `from` in errors. Reads should time out after `stall_s` seconds.
    ///
    /// # Errors
    /// When the other side is no robot, or speaks no version that we speak.
    pub fn greet(
        from: impl Into<String>,
        input: R,
        output: W,
        stall_s: u64,
    ) -> Result<Self, BufferError> {
        let (from, version) = (from.into(), *VERSIONS.start());
        let mut remote =
            Self { from, version, input, output, body: Vec::new(), buffer: Vec::new(), stall_s };
        remote.ask(&Request::Hello { versions: (*VERSIONS.start(), *VERSIONS.end()) })?;
        let (kind, body) = match read_frame(&mut remote.input, &mut remote.body, MAX_REPLY) {
            Ok(Ok(Some(kind))) => (kind, &remote.body),
            Ok(Ok(None)) => {
                return Err(BufferError::Silent { from: remote.from, status: String::new() });
            }
            // A shell's greeting rarely looks like a frame's length.
            Ok(Err(_)) => return Err(remote.foreign()),
            Err(error) => return Err(remote.link(error)),
        };
        match Reply::decode(kind, body) {
            Ok(Reply::Welcome { version }) if VERSIONS.contains(&version) => {
                Ok(Self { version, ..remote })
            }
            Ok(Reply::Refused(refusal)) => Err(BufferError::Refused { from: remote.from, refusal }),
            _ => Err(remote.foreign()),
        }
    }

    /// The other side's computer; `None` when it speaks a version that does not say.
    ///
    /// # Errors
    /// When the link fails.
    pub fn computer(&mut self) -> Result<Option<Computer>, BufferError> {
        if self.version < 2 {
            return Ok(None);
        }
        self.ask(&Request::Computer)?;
        let from = self.from.clone();
        match self.reply()? {
            Reply::Computer(computer) => Ok(Some(computer)),
            other => Err(unexpected(&from, &other)),
        }
    }

    /// What came first, with as much as lies ready behind it.
    fn foreign(mut self) -> BufferError {
        let mut more = [0; 60];
        let read = self.input.read(&mut more).unwrap_or(0);
        self.body.extend_from_slice(more.get(..read).unwrap_or_default());
        let text = String::from_utf8_lossy(&self.body).chars().take(60).collect();
        BufferError::Protocol { from: self.from, source: WireError::Foreign(text) }
    }

    fn ask(&mut self, request: &Request) -> Result<(), BufferError> {
        let written = write_frame(&mut self.output, &mut self.buffer, |body| request.encode(body));
        written.and_then(|()| self.output.flush()).map_err(|error| self.link(error))
    }

    /// The next reply that is no refusal.
    fn reply(&mut self) -> Result<Reply<'_>, BufferError> {
        let kind = match read_frame(&mut self.input, &mut self.body, MAX_REPLY) {
            Ok(Ok(Some(kind))) => kind,
            Ok(Ok(None)) => return Err(self.link(ErrorKind::UnexpectedEof.into())),
            Ok(Err(source)) => {
                return Err(BufferError::Protocol { from: self.from.clone(), source });
            }
            Err(error) => return Err(self.link(error)),
        };
        match Reply::decode(kind, &self.body) {
            Ok(Reply::Refused(refusal)) => {
                Err(BufferError::Refused { from: self.from.clone(), refusal })
            }
            Ok(reply) => Ok(reply),
            Err(source) => Err(BufferError::Protocol { from: self.from.clone(), source }),
        }
    }

    fn link(&self, error: io::Error) -> BufferError {
        match error.kind() {
            ErrorKind::TimedOut | ErrorKind::WouldBlock => {
                BufferError::Stalled { from: self.from.clone(), seconds: self.stall_s }
            }
            ErrorKind::UnexpectedEof => BufferError::Link {
                to: self.from.clone(),
                source: io::Error::new(
                    ErrorKind::UnexpectedEof,
                    "it ended in the middle of a conversation",
                ),
            },
            _ => BufferError::Link { to: self.from.clone(), source: error },
        }
    }
}

fn unexpected(from: &str, reply: &Reply<'_>) -> BufferError {
    BufferError::Protocol { from: from.to_owned(), source: WireError::Unexpected(reply.word()) }
}

impl<R: Read + Send, W: Write + Send> Source for Remote<R, W> {
    fn list(&mut self) -> Result<Vec<Entry>, BufferError> {
        self.ask(&Request::List)?;
        let from = self.from.clone();
        let mut entries = Vec::new();
        loop {
            match self.reply()? {
                Reply::Entry(entry) if entries.len() < MAX_ENTRIES => entries.push(entry),
                Reply::ListEnd => return Ok(entries),
                other => return Err(unexpected(&from, &other)),
            }
        }
    }

    fn fetch(
        &mut self,
        name: &Name,
        have: Have,
        to: &mut dyn Receive<BufferError>,
    ) -> Result<Option<Digest>, BufferError> {
        self.ask(&Request::Fetch { name: name.clone(), have })?;
        let sender = self.from.clone();
        // Nothing, or where the data are and where they end.
        let mut progress: Option<(u64, u64)> = None;
        // A sender that compares says so once for every piece of what we have.
        let mut signs_left = have.bytes / (1 << 20) + 2;
        loop {
            match (self.reply()?, progress) {
                (Reply::Working, None) if signs_left > 0 => {
                    signs_left -= 1;
                    to.working()?;
                }
                (Reply::Start { from, length }, None)
                    if (from == 0 || from == have.bytes) && from <= length =>
                {
                    to.start(from, length)?;
                    progress = Some((from, length));
                }
                (Reply::Data { at, bytes }, Some((expected, length)))
                    if at == expected
                        && !bytes.is_empty()
                        && bytes.len() as u64 <= length - expected =>
                {
                    to.data(at, bytes)?;
                    progress = Some((at + bytes.len() as u64, length));
                }
                (Reply::End { digest }, Some((at, length))) if at == length => {
                    return Ok(Some(digest));
                }
                (other, _) => return Err(unexpected(&sender, &other)),
            }
        }
    }

    fn mark_pulled(&mut self, name: &Name, digest: &Digest) -> Result<(), BufferError> {
        self.ask(&Request::Mark { name: name.clone(), digest: *digest })?;
        let from = self.from.clone();
        match self.reply()? {
            Reply::Marked => Ok(()),
            other => Err(unexpected(&from, &other)),
        }
    }
}
