//! The public keys that a robot trusts.

use std::path::{Path, PathBuf};

use minisign_verify::PublicKey;

use crate::BundleError;

/// Default path of a robot's trusted keys.
pub const TRUSTED_KEYS_FILE: &str = "/etc/embodied-depth/trusted_keys";

#[derive(Debug, Clone)]
pub struct TrustedKey {
    /// The text behind the key in its line, or the key itself where there is none.
    pub comment: String,
    pub(crate) key: PublicKey,
}

/// A model is accepted only when one of these keys signed it.
#[derive(Debug, Clone)]
pub struct TrustedKeys {
    path: PathBuf,
    keys: Vec<TrustedKey>,
}

impl TrustedKeys {
    /// Reads a file with one public key per line, optionally followed by a space and a comment. Empty lines and lines that
    /// start with `#` or `untrusted comment:` (as in minisign's own key files) are skipped.
    ///
    /// # Errors
    /// When the file cannot be read, a line is not a key, or there is no key at all.
    pub fn read(path: &Path) -> Result<Self, BundleError> {
        let text = std::fs::read_to_string(path).map_err(|reason| match reason.kind() {
            std::io::ErrorKind::NotFound => BundleError::NoTrustedKeys { path: path.to_owned() },
            _ => BundleError::unreadable(path, reason),
        })?;
        Self::parse(&text, path)
    }

    /// Like [`read`](Self::read), from text that was read from `path`.
    ///
    /// # Errors
    /// When a line is not a key, or there is no key at all.
    pub fn parse(text: &str, path: &Path) -> Result<Self, BundleError> {
        let mut keys = Vec::new();
        for (index, line) in text.lines().enumerate() {
            let line = line.trim();
            if !is_skipped(line) {
                keys.push(parse_line(line, index + 1, path)?);
            }
        }
        if keys.is_empty() {
            return Err(BundleError::NoTrustedKeys { path: path.to_owned() });
        }
        Ok(Self { path: path.to_owned(), keys })
    }

    /// The keys in the order of the file.
    #[must_use]
    pub fn keys(&self) -> &[TrustedKey] {
        &self.keys
    }

    /// The file that the keys were read from.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }
}

fn is_skipped(line: &str) -> bool {
    line.is_empty() || line.starts_with('#') || line.starts_with("untrusted comment:")
}

fn parse_line(text: &str, line: usize, path: &Path) -> Result<TrustedKey, BundleError> {
    let (key, comment) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
    let comment = if comment.trim().is_empty() { key } else { comment.trim() };
    match PublicKey::from_base64(key) {
        Ok(key) => Ok(TrustedKey { comment: comment.to_owned(), key }),
        Err(error) => Err(BundleError::TrustedKey {
            path: path.to_owned(),
            line,
            text: text.to_owned(),
            reason: error.to_string(),
        }),
    }
}
