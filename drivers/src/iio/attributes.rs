//! The attributes of a device: small text files in its folder in sysfs.

use std::fs::{self, OpenOptions};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};

use super::ImuError;

/// The folder of a device.
#[derive(Debug, Clone)]
pub(super) struct Attributes {
    folder: PathBuf,
}

impl Attributes {
    pub(super) fn new(folder: PathBuf) -> Self {
        Self { folder }
    }

    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    pub(super) fn has(&self, name: &str) -> bool {
        self.folder.join(name).exists()
    }

    /// The text of an attribute, without the white space around it.
    pub(super) fn read(&self, name: &str) -> Result<String, ImuError> {
        let path = self.folder.join(name);
        let text = fs::read_to_string(&path);
        text.map(|text| text.trim().to_owned())
            .map_err(|source| failed(path, "cannot be read".to_owned(), source))
    }

    /// As [`read`](Self::read); `None` if the device has no such attribute.
    pub(super) fn find(&self, name: &str) -> Result<Option<String>, ImuError> {
        if self.has(name) { self.read(name).map(Some) } else { Ok(None) }
    }

    /// The first of these attributes that the device has, with its name.
    pub(super) fn first<'a>(
        &self,
        names: &[&'a str],
    ) -> Result<Option<(&'a str, String)>, ImuError> {
        match names.iter().find(|name| self.has(name)) {
            Some(name) => Ok(Some((name, self.read(name)?))),
            None => Ok(None),
        }
    }

    /// Writes an attribute, unless it already has this value: another program may have set up what this user may only read.
    pub(super) fn set(&self, name: &str, value: &str) -> Result<(), ImuError> {
        if self.read(name)? == value {
            return Ok(());
        }
        let path = self.folder.join(name);
        // The file must be there: creating one would hide that the device is gone.
        let file = OpenOptions::new().write(true).truncate(true).open(&path);
        file.and_then(|mut file| file.write_all(value.as_bytes()))
            .map_err(|source| failed(path, format!("does not accept `{value}`"), source))
    }

    /// The names of the files in a folder below, sorted.
    pub(super) fn names(&self, folder: &str) -> Result<Vec<String>, ImuError> {
        names(&self.folder.join(folder))
    }
}

/// The names of the files in a folder, sorted.
pub(super) fn names(folder: &Path) -> Result<Vec<String>, ImuError> {
    let names = fs::read_dir(folder).and_then(|entries| {
        let name = |entry: io::Result<fs::DirEntry>| entry.map(|entry| entry.file_name());
        entries.map(name).collect::<io::Result<Vec<_>>>()
    });
    let names =
        names.map_err(|source| failed(folder.to_owned(), "cannot be listed".to_owned(), source))?;
    let mut names: Vec<_> =
        names.into_iter().map(|name| name.to_string_lossy().into_owned()).collect();
    names.sort();
    Ok(names)
}

/// The error of a file operation.
pub(super) fn failed(path: PathBuf, what: String, source: io::Error) -> ImuError {
    match source.kind() {
        ErrorKind::PermissionDenied => ImuError::Denied { path },
        ErrorKind::ResourceBusy => ImuError::Busy { path },
        _ => ImuError::Attribute { path, what, source },
    }
}
