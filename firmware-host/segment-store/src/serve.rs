//! The robot's side: answers one workstation over two byte streams. Reads, and writes nothing but the mark `.pulled`.

use std::collections::BTreeMap;
use std::io::{self, Read, Write};

use crate::catalogue::Catalogue;
use crate::computer::Computer;
use crate::digest::Digest;
use crate::marks;
use crate::name::Name;
use crate::root::Root;
use crate::send::{Have, Receive, SendError, Sent, send};
use crate::wire::{
    MAX_REQUEST, Refusal, RefusalKind, Reply, Request, common_version, read_frame, version_refusal,
    write_frame,
};

/// Files that were sent and may be marked without being read again.
const REMEMBERED: usize = 1024;

/// Answers until the other side ends or breaks the rules. Nothing that it sends can read outside of `root`. `computer` is the one
/// that this runs on.
///
/// # Errors
/// When a stream fails.
pub fn serve(
    root: &Root,
    computer: Computer,
    input: &mut dyn Read,
    output: &mut dyn Write,
) -> io::Result<()> {
    let mut session = Session {
        root,
        computer,
        output,
        buffer: Vec::new(),
        sent: BTreeMap::new(),
        welcome: false,
    };
    let mut body = Vec::new();
    loop {
        let request = match read_frame(input, &mut body, MAX_REQUEST)? {
            Ok(None) => return Ok(()),
            Ok(Some(kind)) => Request::decode(kind, &body),
            Err(error) => Err(error),
        };
        let goes_on = match request {
            Ok(request) => session.answer(request)?,
            Err(error) => {
                session.refuse(RefusalKind::Malformed, error.to_string()).map(|()| false)?
            }
        };
        session.output.flush()?;
        if !goes_on {
            return Ok(());
        }
    }
}

struct Session<'a> {
    root: &'a Root,
    computer: Computer,
    output: &'a mut dyn Write,
    buffer: Vec<u8>,
    sent: BTreeMap<Name, Sent>,
    welcome: bool,
}

impl Session<'_> {
    fn reply(&mut self, reply: &Reply<'_>) -> io::Result<()> {
        write_frame(self.output, &mut self.buffer, |body| reply.encode(body))
    }

    fn refuse(&mut self, kind: RefusalKind, text: String) -> io::Result<()> {
        self.reply(&Reply::Refused(Refusal { kind, text }))
    }

    /// Whether the conversation goes on.
    fn answer(&mut self, request: Request) -> io::Result<bool> {
        match request {
            Request::Hello { versions } => {
                let version = common_version(versions);
                self.welcome = version.is_some();
                match version {
                    Some(version) => self.reply(&Reply::Welcome { version })?,
                    None => self.reply(&Reply::Refused(version_refusal(versions)))?,
                }
                return Ok(self.welcome);
            }
            _ if !self.welcome => {
                self.refuse(RefusalKind::Malformed, "a request before the greeting".to_owned())?;
                return Ok(false);
            }
            Request::List => self.list()?,
            Request::Fetch { name, have } => self.fetch(&name, have)?,
            Request::Mark { name, digest } => self.mark(&name, digest)?,
            Request::Computer => self.reply(&Reply::Computer(self.computer))?,
        }
        Ok(true)
    }

    fn list(&mut self) -> io::Result<()> {
        match Catalogue::read(self.root) {
            Ok(catalogue) => {
                for entry in catalogue.entries {
                    self.reply(&Reply::Entry(entry))?;
                }
                self.reply(&Reply::ListEnd)
            }
            Err(error) => self.refuse(RefusalKind::NotThere, error.to_string()),
        }
    }

    fn fetch(&mut self, name: &Name, have: Have) -> io::Result<()> {
        let mut file = match self.root.open_file(name) {
            Ok(file) => file,
            Err(error) => {
                return self
                    .refuse(RefusalKind::NotThere, format!("{name} cannot be opened: {error}"));
            }
        };
        match send(&mut file, have, self) {
            Ok(sent) => {
                if self.sent.len() >= REMEMBERED {
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
                format!("{name} is not marked as pulled: it is not what was sent; pull again"),
            ),
            Err(MarkError::Disk(error)) => self
                .refuse(RefusalKind::Disk, format!("{name} cannot be marked as pulled: {error}")),
        }
    }
}

pub(crate) enum MarkError {
    /// The file is another one now.
    Changed,
    /// It cannot be read, or the mark not be written.
    Disk(io::Error),
}

/// Sets the mark of a segment whose contents have this digest; reads them unless they were just sent. No word of a
/// workstation makes the robot delete what it does not have.
pub(crate) fn mark(
    root: &Root,
    name: &Name,
    digest: Digest,
    sent: Option<&Sent>,
) -> Result<(), MarkError> {
    let mut file = root.open_file(name).map_err(MarkError::Disk)?;
    let metadata = file.metadata().map_err(MarkError::Disk)?;
    let (bytes, modified_ns) = (metadata.len(), crate::root::file_modified_ns(&metadata));
    let same = |sent: &&Sent| (sent.bytes, sent.modified_ns) == (bytes, modified_ns);
    let actual = match sent.filter(same) {
        Some(sent) => sent.digest,
        None => {
            let mut hasher = crate::digest::Hasher::default();
            hasher.update_from(&mut file, u64::MAX).map_err(MarkError::Disk)?;
            hasher.digest()
        }
    };
    if actual != digest {
        return Err(MarkError::Changed);
    }
    marks::set_pulled(root, name, &digest, bytes, modified_ns).map_err(MarkError::Disk)
}

impl Receive<io::Error> for Session<'_> {
    fn start(&mut self, from: u64, length: u64) -> io::Result<()> {
        self.reply(&Reply::Start { from, length })
    }

    fn data(&mut self, at: u64, bytes: &[u8]) -> io::Result<()> {
        self.reply(&Reply::Data { at, bytes })
    }

    fn working(&mut self) -> io::Result<()> {
        self.reply(&Reply::Working)?;
        self.output.flush()
    }
}
