//! Parsing of the sources on the command line.

use std::fmt;
use std::path::{Path, PathBuf};

use crate::error::StoreError;

/// Where a store is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Location {
    /// A local directory.
    Directory(PathBuf),
    /// A directory of another computer, reached by ssh.
    Ssh {
        /// The computer as ssh takes it: `[user@]host`.
        host: String,
        /// The path on that computer.
        path: String,
    },
    /// An object store, such as `s3://bucket/prefix`.
    ObjectStore(String),
}

/// The URL schemes of object stores.
const STORES: [&str; 4] = ["s3://", "gs://", "az://", "file:///"];

/// A source: a store and its name on this computer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Spec {
    /// The directory below the destination that the segments are written to.
    pub name: String,
    pub location: Location,
}

impl Spec {
    /// Parses `[NAME=]DIRECTORY`, `[NAME=][user@]host:path` or `[NAME=]s3://bucket/prefix`. As in rsync and scp, a colon before
    /// the first slash denotes another computer. The default name is the host, or the last component of the directory or URL.
    ///
    /// # Errors
    /// When the text has none of these forms, or no name can be derived from it.
    pub fn parse(text: &str) -> Result<Self, StoreError> {
        Self::try_parse(text).map_err(|reason| {
            StoreError::Usage(format!(
                "source {text:?}: {reason}; give [user@]host:/path, a directory, s3://bucket/prefix, or NAME=one of them"
            ))
        })
    }

    fn try_parse(text: &str) -> Result<Self, &'static str> {
        let (name, place) =
            match text.split_once('=').filter(|(name, _)| !name.contains(['/', ':', '@'])) {
                Some((name, place)) => (Some(name.to_owned()), place),
                None => (None, text),
            };
        let location = match host_and_path(place) {
            _ if is_store(place) => Location::ObjectStore(place.to_owned()),
            _ if place.contains("://") => {
                return Err("object stores are s3://, gs://, az:// or file:///");
            }
            // ssh would parse it as an option.
            Some((host, _)) if host.starts_with('-') || host.is_empty() => {
                return Err("the host name is missing or starts with -");
            }
            Some((_, "")) => return Err("the path is missing"),
            Some((host, path)) => Location::Ssh { host: host.to_owned(), path: path.to_owned() },
            None if place.is_empty() => return Err("it is empty"),
            None => Location::Directory(PathBuf::from(place)),
        };
        let name = name
            .or_else(|| location.default_name())
            .filter(|name| is_name(name))
            .ok_or("it has no usable name; write NAME=SOURCE")?;
        Ok(Self { name, location })
    }
}

/// Whether `text` is the URL of an object store.
#[must_use]
pub fn is_store(text: &str) -> bool {
    STORES.iter().any(|scheme| text.starts_with(scheme))
}

/// The parts before and after the colon that separates a host from a path.
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

impl Location {
    fn default_name(&self) -> Option<String> {
        match self {
            Self::Ssh { host, .. } => {
                let host = host.rsplit_once('@').map_or(host.as_str(), |(_, host)| host);
                Some(host.trim_matches(['[', ']']).to_owned())
            }
            Self::Directory(path) => {
                // Canonicalized, because `.` and `..` have no name of their own.
                let path =
                    std::fs::canonicalize(path).unwrap_or_else(|_| Path::new(path).to_owned());
                Some(path.file_name()?.to_str()?.to_owned())
            }
            Self::ObjectStore(url) => {
                Some(url.split_once("://")?.1.trim_end_matches('/').rsplit('/').next()?.to_owned())
            }
        }
    }
}

impl fmt::Display for Location {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Directory(path) => write!(f, "{}", path.display()),
            Self::Ssh { host, path } => write!(f, "{host}:{path}"),
            Self::ObjectStore(url) => f.write_str(url),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ssh(name: &str, host: &str, path: &str) -> Spec {
        Spec {
            name: name.to_owned(),
            location: Location::Ssh { host: host.to_owned(), path: path.to_owned() },
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
            Spec {
                name: "runs".to_owned(),
                location: Location::Directory("./odd:name/runs".into())
            }
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
                Spec { name: name.to_owned(), location: Location::ObjectStore(url.to_owned()) }
            );
        }
    }

    #[test]
    fn invalid_sources_and_hosts_that_ssh_would_parse_as_options_are_refused() {
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
