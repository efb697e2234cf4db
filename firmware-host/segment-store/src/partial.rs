//! Output that appears under its name only when it is complete, and that replaces nothing.
//!
//! Until then it is beside it under a name of its own, `run.mcap.4711-0.partial` with the number of the process: two exports into
//! the same output do not disturb each other, and a file of the user is neither overwritten nor deleted.

use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use rustix::fs::{CWD, RenameFlags, renameat_with};
use rustix::io::Errno;

use crate::error::StoreError;

/// At most this many names are tried.
const MAX_NAMES: u32 = 1000;

/// Refuses an output that exists, also as a link to nothing.
pub(crate) fn refuse_existing(to: &Path) -> Result<(), StoreError> {
    if to.symlink_metadata().is_ok() {
        return Err(StoreError::Exists { path: to.to_owned() });
    }
    Ok(())
}

/// Creates the temporary output for `to`. `create` must fail when the name exists.
pub(crate) fn create_beside<T>(
    to: &Path,
    create: impl Fn(&Path) -> io::Result<T>,
) -> io::Result<(PathBuf, T)> {
    let mut number = 0;
    loop {
        let mut name = to.file_name().unwrap_or_default().to_owned();
        name.push(format!(".{}-{number}.partial", std::process::id()));
        let partial = to.with_file_name(name);
        match create(&partial) {
            Err(error) if error.kind() == ErrorKind::AlreadyExists && number < MAX_NAMES => {
                number += 1;
            }
            created => return Ok((partial, created?)),
        }
    }
}

/// Gives the complete output its name, unless another process has created it in the meantime.
pub(crate) fn give_name(partial: &Path, to: &Path) -> Result<(), StoreError> {
    let renamed = match renameat_with(CWD, partial, CWD, to, RenameFlags::NOREPLACE) {
        // A network file system without this flag. A directory that is not empty is not replaced by this either.
        Err(Errno::INVAL | Errno::NOSYS) if partial.is_dir() => std::fs::rename(partial, to),
        renamed => renamed.map_err(io::Error::from),
    };
    renamed.map_err(|error| match error.kind() {
        ErrorKind::AlreadyExists | ErrorKind::DirectoryNotEmpty => {
            StoreError::Exists { path: to.to_owned() }
        }
        _ => StoreError::output(to)(error),
    })
}
