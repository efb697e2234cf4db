//! What a user writes to name a buffer.

use std::fmt;
use std::path::{Path, PathBuf};

use crate::error::BufferError;

/// Where a buffer is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Place {
    /// A directory of this computer.
    Directory(PathBuf),
    /// A directory of another computer, by ssh.
    Ssh {
        /// `[user@]host`.
        host: String,
        /// As the other computer has it.
        path: String,
    },
    /// An object store: `s3://bucket/prefix` and the like.
    Store(String),
}

/// The beginnings of object stores' addresses.
const STORES: [&str; 4] = ["s3://", "gs://", "az://", "file:///"];

/// A buffer and what it is called here.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Spec {
    /// The directory below the destination.
    pub name: String,
    /// Where.
    pub place: Place,
}

impl Spec {
    /// Reads `[NAME=]DIRECTORY`, `[NAME=][user@]host:path` or `[NAME=]s3://bucket/prefix`. As rsync and scp have it, a colon before the first slash means
    /// another computer. Without a name it is the host's, or the last part
    /// of the directory or address.
    ///
    /// # Errors
    /// When it is neither, or no name can be made of it.
    pub fn parse(text: &str) -> Result<Self, BufferError> {
        let usage = |why: &str| {
            BufferError::Usage(format!(
                "source {text:?}: {why}; give [user@]host:/path, a directory, s3://bucket/prefix, or NAME=one of them"
            ))
        };
        let (name, place) =
            match text.split_once('=').filter(|(name, _)| !name.contains(['/', ':', '@'])) {
                Some((name, place)) => (Some(name.to_owned()), place),
                None => (None, text),
            };
        let place = match host_and_path(place) {
            _ if is_store(place) => Place::Store(place.to_owned()),
            _ if place.contains("://") => {
                return Err(usage("object stores are s3://, gs://, az:// or file:///"));
            }
            // ssh would take it for an option.
            Some((host, _)) if host.starts_with('-') || host.is_empty() => {
                return Err(usage("no host's name"));
            }
            Some((_, "")) => return Err(usage("the path is missing")),
            Some((host, path)) => Place::Ssh { host: host.to_owned(), path: path.to_owned() },
            None if place.is_empty() => return Err(usage("it is empty")),
            None => Place::Directory(PathBuf::from(place)),
        };
        let name = name.or_else(|| place.default_name()).filter(|name| is_name(name));
        Ok(Self { name: name.ok_or_else(|| usage("no name for it; write NAME=..."))?, place })
    }
}

/// Whether this is the address of an object store.
#[must_use]
pub fn is_store(text: &str) -> bool {
    STORES.iter().any(|scheme| text.starts_with(scheme))
}

/// The parts before and behind the colon that means "another computer".
fn host_and_path(text: &str) -> Option<(&str, &str)> {
    let bracket = text.find("]:").filter(|_| text.contains('[')).map(|at| at + 1);
    let colon = bracket.or_else(|| text.find(':'))?;
    (!text.get(..colon)?.contains('/')).then_some((text.get(..colon)?, text.get(colon + 1..)?))
}

fn is_name(name: &str) -> bool {
    !name.is_empty()
        && name.len() <= 128
        && !name.starts_with(['.', '-'])
        && !name.contains(['/', '\0'])
}

impl Place {
    fn default_name(&self) -> Option<String> {
        match self {
            Self::Ssh { host, .. } => {
                let host = host.rsplit_once('@').map_or(host.as_str(), |(_, host)| host);
                Some(host.trim_matches(['[', ']']).to_owned())
            }
            Self::Directory(path) => {
                // `.` and `..` have no last part of their own.
                let path =
                    std::fs::canonicalize(path).unwrap_or_else(|_| Path::new(path).to_owned());
                Some(path.file_name()?.to_str()?.to_owned())
            }
            Self::Store(url) => {
                Some(url.split_once("://")?.1.trim_end_matches('/').rsplit('/').next()?.to_owned())
            }
        }
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Directory(path) => write!(f, "{}", path.display()),
            Self::Ssh { host, path } => write!(f, "{host}:{path}"),
            Self::Store(url) => f.write_str(url),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ssh(name: &str, host: &str, path: &str) -> Spec {
        Spec {
            name: name.to_owned(),
            place: Place::Ssh { host: host.to_owned(), path: path.to_owned() },
        }
    }

    #[test]
    fn a_colon_before_the_first_slash_means_another_computer() {
        assert_eq!(
            Spec::parse("robot@kitchen:/var/lib/runs").unwrap(),
            ssh("kitchen", "robot@kitchen", "/var/lib/runs")
        );
        assert_eq!(
            Spec::parse("r7=robot@10.0.0.7:runs").unwrap(),
            ssh("r7", "robot@10.0.0.7", "runs")
        );
        assert_eq!(Spec::parse("[fe80::1]:/runs").unwrap(), ssh("fe80::1", "[fe80::1]", "/runs"));
        let local = Spec::parse("./odd:name/runs").unwrap();
        assert_eq!(
            local,
            Spec { name: "runs".to_owned(), place: Place::Directory("./odd:name/runs".into()) }
        );
    }

    #[test]
    fn an_address_of_an_object_store_is_called_by_its_last_part() {
        for (text, name, url) in [
            ("s3://fleet/kitchen", "kitchen", "s3://fleet/kitchen"),
            ("gs://fleet/", "fleet", "gs://fleet/"),
            ("r7=az://fleet/a/b", "r7", "az://fleet/a/b"),
            ("file:///media/a=b/runs", "runs", "file:///media/a=b/runs"),
        ] {
            assert_eq!(
                Spec::parse(text).unwrap(),
                Spec { name: name.to_owned(), place: Place::Store(url.to_owned()) }
            );
        }
    }

    #[test]
    fn what_ssh_would_take_for_an_option_and_other_nonsense_is_refused_with_words() {
        for bad in [
            "",
            "-oProxyCommand=x:/runs",
            ":/runs",
            "host:",
            "ftp://host/runs",
            "s3:///",
            "..=host:/runs",
            "/",
        ] {
            let error = Spec::parse(bad).unwrap_err().to_string();
            assert!(error.contains("give [user@]host:/path"), "{bad}: {error}");
        }
    }
}
