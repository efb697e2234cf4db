//! The directory of a store, opened once. Every file is opened relative to it, one path component at a time, and no component
//! may be a symbolic link. A process that can write into the store therefore cannot make us read files outside of it.

use std::ffi::OsStr;
use std::fs::File;
use std::io::{self, Write};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

use rustix::fs::{AtFlags, Dir, FileType, Mode, OFlags, open, openat, renameat, statat, unlinkat};
use rustix::io::Errno;

use crate::error::StoreError;
use crate::name::Name;

/// At most this many bytes of a marker are read.
const MAX_SMALL_FILE: usize = 256;

/// The opened directory of a store.
#[derive(Debug)]
pub struct Root {
    dir: OwnedFd,
    path: PathBuf,
}

/// A directory entry. A symbolic link is listed as a link, not as its target.
pub(crate) struct Listed {
    pub name: String,
    pub kind: FileType,
    pub bytes: u64,
    pub modified_ns: u64,
}

impl Root {
    /// Opens the directory at `path`, which may itself be a symbolic link.
    ///
    /// # Errors
    /// When it does not exist or is not a directory.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        let dir = open(path, OFlags::DIRECTORY | OFlags::RDONLY | OFlags::CLOEXEC, Mode::empty())
            .map_err(|errno| StoreError::read(path)(errno.into()))?;
        Ok(Self { dir, path: path.to_owned() })
    }

    /// The path that the store was opened with.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Opens a segment for reading.
    ///
    /// # Errors
    /// When it does not exist, is not a regular file, or a part of its path is a symbolic link.
    pub fn open_file(&self, name: &Name) -> io::Result<File> {
        let folder = self.folder(name.run())?;
        open_regular(folder.as_fd(), name.file())
    }

    /// Opens a directory of the store; the empty path is the store itself.
    pub(crate) fn folder(&self, relative: &str) -> io::Result<OwnedFd> {
        let mut folder = self.dir.try_clone()?;
        for part in relative.split('/').filter(|part| !part.is_empty()) {
            let flags = OFlags::DIRECTORY | OFlags::NOFOLLOW | OFlags::RDONLY | OFlags::CLOEXEC;
            folder = openat(&folder, part, flags, Mode::empty())?;
        }
        Ok(folder)
    }
}

/// Lists a directory without hidden files and without names that are not UTF-8, which the recorder never writes.
pub(crate) fn list(folder: BorrowedFd<'_>) -> io::Result<Vec<Listed>> {
    let mut found = Vec::new();
    for entry in Dir::read_from(folder)? {
        let entry = entry?;
        let Ok(name) = entry.file_name().to_str() else { continue };
        if name.starts_with('.') {
            continue;
        }
        let stat = match statat(folder, name, AtFlags::SYMLINK_NOFOLLOW) {
            Ok(stat) => stat,
            // The directory may be listed but not entered: none of its files can be read.
            Err(error @ Errno::ACCESS) => return Err(error.into()),
            // The file may have been deleted since the directory was read.
            Err(_) => continue,
        };
        found.push(Listed {
            name: name.to_owned(),
            kind: FileType::from_raw_mode(stat.st_mode),
            bytes: u64::try_from(stat.st_size).unwrap_or(0),
            modified_ns: modified_ns(stat.st_mtime, stat.st_mtime_nsec),
        });
    }
    Ok(found)
}

pub(crate) fn open_regular(folder: BorrowedFd<'_>, file: &str) -> io::Result<File> {
    // Without NONBLOCK, opening a named pipe would block until a process opens it for writing.
    let flags = OFlags::RDONLY | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let file =
        File::from(openat(folder, OsStr::from_bytes(file.as_bytes()), flags, Mode::empty())?);
    if !file.metadata()?.is_file() {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "it is not a regular file"));
    }
    Ok(file)
}

/// Reads the beginning of a small text file; `None` when it cannot be read or is not UTF-8.
pub(crate) fn read_small(folder: BorrowedFd<'_>, file: &str) -> Option<String> {
    let file = open_regular(folder, file).ok()?;
    let mut bytes = Vec::new();
    io::Read::read_to_end(&mut io::Read::take(file, MAX_SMALL_FILE as u64), &mut bytes).ok()?;
    String::from_utf8(bytes).ok()
}

/// Writes a small file atomically: after a power cut it has either its old or its new contents.
pub(crate) fn write_small(folder: BorrowedFd<'_>, file: &str, text: &str) -> io::Result<()> {
    let partial = format!(".{file}.partial");
    let flags = OFlags::WRONLY | OFlags::CREATE | OFlags::EXCL | OFlags::NOFOLLOW | OFlags::CLOEXEC;
    // Removes what a crash left over. EXCL then ensures that the file is new.
    let _ = unlinkat(folder, partial.as_str(), AtFlags::empty());
    // Readable by all: a marker shows no picture, and the recorder must read one that another account wrote.
    let written = openat(folder, partial.as_str(), flags, Mode::from_raw_mode(0o644))
        .map_err(io::Error::from)
        .and_then(|fd| {
            let mut to = File::from(fd);
            to.write_all(text.as_bytes())?;
            to.sync_all()
        });
    let renamed = written.and_then(|()| Ok(renameat(folder, partial.as_str(), folder, file)?));
    if renamed.is_err() {
        let _ = unlinkat(folder, partial.as_str(), AtFlags::empty());
    }
    renamed
}

/// The time of the last modification since 1970, or 0 if it is unknown.
pub(crate) fn file_modified_ns(metadata: &std::fs::Metadata) -> u64 {
    let since = metadata.modified().ok().and_then(|time| time.duration_since(UNIX_EPOCH).ok());
    since.and_then(|since| u64::try_from(since.as_nanos()).ok()).unwrap_or(0)
}

#[allow(clippy::cast_sign_loss, reason = "times before 1970 count as 0")]
fn modified_ns(seconds: i64, nanoseconds: impl TryInto<u64>) -> u64 {
    (seconds.max(0) as u64)
        .saturating_mul(1_000_000_000)
        .saturating_add(nanoseconds.try_into().unwrap_or(0))
}
