//! A store that is served by a peer over two byte streams.

use std::io::{self, ErrorKind, Read, Write};

use super::interface::{Listing, Source};
use crate::cpu_features::CpuFeatures;
use crate::digest::Digest;
use crate::error::StoreError;
use crate::name::Name;
use crate::transfer::{FileSink, LocalCopy};
use crate::wire::{MAX_REPLY, Reply, Request, VERSIONS, WireError, read_frame, write_frame};

/// No robot has more segments. Without a limit a hostile peer could send entries until the memory is full.
const MAX_ENTRIES: usize = 200_000;

/// The client of `firmware-host buffer serve`. It does not trust the peer: names are checked, offsets must be consecutive, and
/// the received bytes must have the digest that the peer sent.
pub struct Remote<R, W> {
    from: String,
    version: u16,
    input: R,
    output: W,
    body: Vec<u8>,
    buffer: Vec<u8>,
    /// The read timeout, for the error message.
    stall_s: u64,
}

impl<R: Read, W: Write> Remote<R, W> {
    /// Opens a session with a peer that is called `from` in errors. Reads of `input` should time out after `stall_s` seconds.
    ///
    /// # Errors
    /// When the peer does not speak this protocol, or no common version of it.
    pub fn greet(
        from: impl Into<String>,
        input: R,
        output: W,
        stall_s: u64,
    ) -> Result<Self, StoreError> {
        let mut remote = Self {
            from: from.into(),
            version: *VERSIONS.start(),
            input,
            output,
            body: Vec::new(),
            buffer: Vec::new(),
            stall_s,
        };
        remote.send(&Request::Hello { versions: (*VERSIONS.start(), *VERSIONS.end()) })?;
        let (kind, body) = match read_frame(&mut remote.input, &mut remote.body, MAX_REPLY) {
            Ok(Ok(Some(kind))) => (kind, &remote.body),
            Ok(Ok(None)) => {
                return Err(StoreError::Silent { from: remote.from, status: String::new() });
            }
            // Text that a shell prints is rarely a valid frame length.
            Ok(Err(_)) => return Err(remote.foreign()),
            Err(error) => return Err(remote.link(error)),
        };
        match Reply::decode(kind, body) {
            Ok(Reply::Welcome { version }) if VERSIONS.contains(&version) => {
                Ok(Self { version, ..remote })
            }
            Ok(Reply::Refused(refusal)) => Err(StoreError::Refused { from: remote.from, refusal }),
            _ => Err(remote.foreign()),
        }
    }

    /// The features of the peer's processor; `None` when its protocol version cannot report them.
    ///
    /// # Errors
    /// When the link fails.
    pub fn cpu_features(&mut self) -> Result<Option<CpuFeatures>, StoreError> {
        if self.version < 2 {
            return Ok(None);
        }
        self.send(&Request::CpuFeatures)?;
        let from = self.from.clone();
        match self.reply()? {
            Reply::CpuFeatures(cpu) => Ok(Some(cpu)),
            other => Err(unexpected(&from, &other)),
        }
    }

    /// The error for a peer that does not speak the protocol: quotes the first bytes and what is ready behind them.
    fn foreign(mut self) -> StoreError {
        let mut more = [0; 60];
        let read = self.input.read(&mut more).unwrap_or(0);
        self.body.extend_from_slice(more.get(..read).unwrap_or_default());
        let text = String::from_utf8_lossy(&self.body).chars().take(60).collect();
        StoreError::Protocol { from: self.from, source: WireError::Foreign(text) }
    }

    fn send(&mut self, request: &Request) -> Result<(), StoreError> {
        let written = write_frame(&mut self.output, &mut self.buffer, |body| request.encode(body));
        written.and_then(|()| self.output.flush()).map_err(|error| self.link(error))
    }

    /// Reads the next reply; a refusal becomes an error.
    fn reply(&mut self) -> Result<Reply<'_>, StoreError> {
        let kind = match read_frame(&mut self.input, &mut self.body, MAX_REPLY) {
            Ok(Ok(Some(kind))) => kind,
            Ok(Ok(None)) => return Err(self.link(ErrorKind::UnexpectedEof.into())),
            Ok(Err(source)) => {
                return Err(StoreError::Protocol { from: self.from.clone(), source });
            }
            Err(error) => return Err(self.link(error)),
        };
        match Reply::decode(kind, &self.body) {
            Ok(Reply::Refused(refusal)) => {
                Err(StoreError::Refused { from: self.from.clone(), refusal })
            }
            Ok(reply) => Ok(reply),
            Err(source) => Err(StoreError::Protocol { from: self.from.clone(), source }),
        }
    }

    fn link(&self, error: io::Error) -> StoreError {
        match error.kind() {
            ErrorKind::TimedOut | ErrorKind::WouldBlock => {
                StoreError::Stalled { from: self.from.clone(), seconds: self.stall_s }
            }
            ErrorKind::UnexpectedEof => StoreError::Link {
                to: self.from.clone(),
                source: io::Error::new(
                    ErrorKind::UnexpectedEof,
                    "the peer closed the connection during a transfer",
                ),
            },
            _ => StoreError::Link { to: self.from.clone(), source: error },
        }
    }
}

fn unexpected(from: &str, reply: &Reply<'_>) -> StoreError {
    StoreError::Protocol { from: from.to_owned(), source: WireError::Unexpected(reply.word()) }
}

impl<R: Read + Send, W: Write + Send> Source for Remote<R, W> {
    fn list(&mut self) -> Result<Listing, StoreError> {
        self.send(&Request::List)?;
        let from = self.from.clone();
        let mut listing = Listing::default();
        loop {
            let is_full = listing.entries.len() + listing.unread.len() >= MAX_ENTRIES;
            match self.reply()? {
                Reply::Entry(entry) if !is_full => listing.entries.push(entry),
                Reply::Unread(why) if !is_full => listing.unread.push(why),
                Reply::ListEnd => return Ok(listing),
                other => return Err(unexpected(&from, &other)),
            }
        }
    }

    fn fetch(
        &mut self,
        name: &Name,
        local: LocalCopy,
        to: &mut dyn FileSink<StoreError>,
    ) -> Result<Option<Digest>, StoreError> {
        self.send(&Request::Fetch { name: name.clone(), local })?;
        let sender = self.from.clone();
        // After `Start`: the offset of the next byte and the length of the file.
        let mut progress: Option<(u64, u64)> = None;
        // A sender that compares reports it at most once per MiB of the local copy.
        let mut comparing_left = local.bytes / (1 << 20) + 2;
        loop {
            match (self.reply()?, progress) {
                (Reply::Comparing, None) if comparing_left > 0 => {
                    comparing_left -= 1;
                    to.comparing()?;
                }
                (Reply::Start { from, length }, None)
                    if (from == 0 || from == local.bytes) && from <= length =>
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

    fn mark_pulled(&mut self, name: &Name, digest: &Digest) -> Result<(), StoreError> {
        self.send(&Request::Mark { name: name.clone(), digest: *digest })?;
        let from = self.from.clone();
        match self.reply()? {
            Reply::Marked => Ok(()),
            other => Err(unexpected(&from, &other)),
        }
    }
}
