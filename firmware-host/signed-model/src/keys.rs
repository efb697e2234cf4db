//! Whom the robot trusts.

use std::path::{Path, PathBuf};

use minisign_verify::PublicKey;

use crate::BundleError;

/// Where a robot keeps its trusted keys unless told otherwise.
pub const TRUSTED_KEYS_FILE: &str = "/etc/embodied-depth/trusted_keys";

/// A public key and what the operator calls it.
#[derive(Debug, Clone)]
pub struct TrustedKey {
    /// What stands behind the key in its line; the key itself where nothing does.
    pub comment: String,
    pub(crate) key: PublicKey,
}

/// The public keys whose signatures count.
#[derive(Debug, Clone)]
pub struct TrustedKeys {
    path: PathBuf,
    keys: Vec<TrustedKey>,
}

impl TrustedKeys {
    /// Reads a file with one public key a line, each perhaps followed by a space and a comment. Empty lines and lines that
    /// begin with `#` or with `untrusted comment:` (as minisign's own key files do) are skipped.
    ///
    /// # Errors
    /// A file that cannot be read, a line that is no key, or no key at all.
    pub fn read(path: &Path) -> Result<Self, BundleError> {
        let text = std::fs::read_to_string(path).map_err(|reason| match reason.kind() {
            std::io::ErrorKind::NotFound => BundleError::NoTrustedKeys { path: path.to_owned() },
            _ => BundleError::File { what: "read", path: path.to_owned(), reason },
        })?;
        Self::parse(&text, path)
    }

    /// As [`read`](Self::read), from the text of `path`.
    ///
    /// # Errors
    /// A line that is no key, or no key at all.
    pub fn parse(text: &str, path: &Path) -> Result<Self, BundleError> {
        let lines = text.lines().enumerate().map(|(index, line)| (index + 1, line.trim()));
        let skipped = |line: &str| {
            line.is_empty() || line.starts_with('#') || line.starts_with("untrusted comment:")
        };
        let key = |(line, text): (usize, &str)| {
            let (key, comment) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
            let comment = if comment.trim().is_empty() { key } else { comment.trim() };
            match PublicKey::from_base64(key) {
                Ok(key) => Ok(TrustedKey { comment: comment.to_owned(), key }),
                Err(error) => {
                    let (path, text, reason) =
                        (path.to_owned(), text.to_owned(), error.to_string());
                    Err(BundleError::TrustedKey { path, line, text, reason })
                }
            }
        };
        let keys =
            lines.filter(|(_, text)| !skipped(text)).map(key).collect::<Result<Vec<_>, _>>()?;
        if keys.is_empty() {
            return Err(BundleError::NoTrustedKeys { path: path.to_owned() });
        }
        Ok(Self { path: path.to_owned(), keys })
    }

    /// Every key, in the file's order.
    #[must_use]
    pub fn keys(&self) -> &[TrustedKey] {
        &self.keys
    }

    /// The file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }
}
