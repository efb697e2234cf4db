//! The robot's side of a pull: answers one workstation over two byte streams. It writes only `.pulled` markers.

use std::collections::BTreeMap;
use std::io::{self, Read, Write};

use crate::catalogue::Catalogue;
use crate::cpu_features::CpuFeatures;
use crate::digest::{Digest, Hasher};
use crate::marks;
use crate::name::Name;
use crate::root::{Root, file_modified_ns};
use crate::send::{SendError, Sent, send};
use crate::transfer::{FileSink, LocalCopy};
use crate::wire::{
    MAX_REQUEST, Refusal, RefusalKind, Reply, Request, common_version, read_frame, version_refusal,
    write_frame,
};

/// For this many sent files the digest is remembered, so that marking them does not read them again.
const MAX_REMEMBERED: usize = 1024;

/// Answers requests until the peer closes the stream or violates the protocol. No request can read files outside of `root`.
/// `cpu` describes the processor that this runs on. `log` is called before a segment is sent.
///
/// # Errors
/// When a stream fails.
pub fn serve(
    root: &Root,
    cpu: CpuFeatures,
    log: &mut dyn FnMut(&Name),
    input: &mut dyn Read,
    output: &mut dyn Write,
) -> io::Result<()> {
    let mut session = Session {
        root,
        cpu,
        log,
        output,
        buffer: Vec::new(),
        sent: BTreeMap::new(),
        version: None,
    };
    let mut body = Vec::new();
    loop {
        let request = match read_frame(input, &mut body, MAX_REQUEST)? {
            Ok(None) => return Ok(()),
            Ok(Some(kind)) => Request::decode(kind, &body),
            Err(error) => Err(error),
        };
        let continues = match request {
            Ok(request) => session.answer(request)?,
            Err(error) => {
                session.refuse(RefusalKind::Malformed, error.to_string()).map(|()| false)?
            }
        };
        session.output.flush()?;
        if !continues {
            return Ok(());
        }
    }
}

struct Session<'a> {
    root: &'a Root,
    cpu: CpuFeatures,
    log: &'a mut dyn FnMut(&Name),
    output: &'a mut dyn Write,
    buffer: Vec<u8>,
    sent: BTreeMap<Name, Sent>,
    /// The protocol version, once the workstation has sent its greeting and if there is a common one.
    version: Option<u16>,
}

impl Session<'_> {
    fn reply(&mut self, reply: &Reply<'_>) -> io::Result<()> {
        write_frame(self.output, &mut self.buffer, |body| reply.encode(body))
    }

    fn refuse(&mut self, kind: RefusalKind, text: String) -> io::Result<()> {
        self.reply(&Reply::Refused(Refusal { kind, text }))
    }

    /// Answers one request and returns whether the session continues.
    fn answer(&mut self, request: Request) -> io::Result<bool> {
        match request {
            Request::Hello { versions } => {
                let version = common_version(versions);
                self.version = version;
                match version {
                    Some(version) => self.reply(&Reply::Welcome { version })?,
                    None => self.reply(&Reply::Refused(version_refusal(versions)))?,
                }
                return Ok(version.is_some());
            }
            _ if self.version.is_none() => {
                self.refuse(RefusalKind::Malformed, "a request before the greeting".to_owned())?;
                return Ok(false);
            }
            Request::List => self.list()?,
            Request::Fetch { name, local } => self.fetch(&name, local)?,
            Request::Mark { name, digest } => self.mark(&name, digest)?,
            Request::CpuFeatures => self.reply(&Reply::CpuFeatures(self.cpu))?,
        }
        Ok(true)
    }

    fn list(&mut self) -> io::Result<()> {
        match Catalogue::read(self.root) {
            Ok(catalogue) => {
                for entry in catalogue.entries {
                    self.reply(&Reply::Entry(entry))?;
                }
                // A workstation with an earlier version does not know this reply.
                if self.version >= Some(3) {
                    for unread in catalogue.unread {
                        self.reply(&Reply::Unread(unread.to_string()))?;
                    }
                }
                self.reply(&Reply::ListEnd)
            }
            Err(error) => self.refuse(RefusalKind::NotThere, error.to_string()),
        }
    }

    fn fetch(&mut self, name: &Name, local: LocalCopy) -> io::Result<()> {
        let mut file = match self.root.open_file(name) {
            Ok(file) => file,
            Err(error) => {
                return self
                    .refuse(RefusalKind::NotThere, format!("{name} cannot be opened: {error}"));
            }
        };
        (self.log)(name);
        match send(&mut file, local, self) {
            Ok(sent) => {
                if self.sent.len() >= MAX_REMEMBERED {
                    self.sent.pop_first();
                }
                self.sent.insert(name.clone(), sent);
                self.reply(&Reply::End { digest: sent.digest })
            }
            Err(SendError::Sink(error)) => Err(error),
            Err(SendError::Read(error)) => {
                self.refuse(RefusalKind::Disk, format!("{name} cannot be read: {error}"))
            }
            Err(SendError::Changed) => self.refuse(
                RefusalKind::Changed,
                format!("{name} was written while it was sent; pull again"),
            ),
        }
    }

    fn mark(&mut self, name: &Name, digest: Digest) -> io::Result<()> {
        match mark(self.root, name, digest, self.sent.get(name)) {
            Ok(()) => self.reply(&Reply::Marked),
            Err(MarkError::Changed) => self.refuse(
                RefusalKind::Changed,
                format!(
                    "{name} is not marked as pulled: its contents are not what was sent; pull again"
                ),
            ),
            Err(MarkError::Disk(error)) => self
                .refuse(RefusalKind::Disk, format!("{name} cannot be marked as pulled: {error}")),
        }
    }
}

pub(crate) enum MarkError {
    /// The contents of the file differ from what was pulled.
    Changed,
    /// The file cannot be read, or the marker cannot be written.
    Disk(io::Error),
}

/// Writes the `.pulled` marker of a segment if its contents have this digest. The contents are read again unless they were just
/// sent: the robot may delete marked segments, so a wrong claim of a workstation must not produce a marker.
pub(crate) fn mark(
    root: &Root,
    name: &Name,
    digest: Digest,
    sent: Option<&Sent>,
) -> Result<(), MarkError> {
    let mut file = root.open_file(name).map_err(MarkError::Disk)?;
    let metadata = file.metadata().map_err(MarkError::Disk)?;
    let bytes = metadata.len();
    let modified_ns = file_modified_ns(&metadata);
    let actual = match sent.filter(|sent| (sent.bytes, sent.modified_ns) == (bytes, modified_ns)) {
        Some(sent) => sent.digest,
        None => {
            let mut hasher = Hasher::default();
            hasher.update_from(&mut file, u64::MAX).map_err(MarkError::Disk)?;
            hasher.digest()
        }
    };
    if actual != digest {
        return Err(MarkError::Changed);
    }
    marks::set_pulled(root, name, &digest, bytes, modified_ns).map_err(MarkError::Disk)
}

impl FileSink<io::Error> for Session<'_> {
    fn start(&mut self, from: u64, length: u64) -> io::Result<()> {
        self.reply(&Reply::Start { from, length })
    }

    fn data(&mut self, at: u64, bytes: &[u8]) -> io::Result<()> {
        self.reply(&Reply::Data { at, bytes })
    }

    fn comparing(&mut self) -> io::Result<()> {
        self.reply(&Reply::Comparing)?;
        self.output.flush()
    }
}
