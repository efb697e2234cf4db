//! Why a signed model is refused or cannot be made.

use std::io;
use std::path::{Path, PathBuf};

/// Groups of [`BundleError`]s that a caller handles alike.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ErrorKind {
    /// A file cannot be read or written.
    File,
    /// The input is malformed or too large.
    Form,
    /// The model has no signature.
    Unsigned,
    /// The model is signed by a key that is not trusted.
    UntrustedKey,
    /// The signature is by a trusted key but does not match the model.
    Forged,
}

/// Why a signed model is refused or cannot be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BundleError {
    /// A file cannot be read or written.
    #[error("cannot {what} {}: {reason}; check the path and the permissions", path.display())]
    File {
        /// `read` or `write`.
        what: &'static str,
        path: PathBuf,
        reason: io::Error,
    },
    /// The stream that carries the model ended early or failed.
    #[error("cannot read the bundle: {reason}; send it again")]
    Stream { reason: io::Error },
    /// A key file exists already and is never overwritten.
    #[error(
        "{} exists already, and key files are never overwritten; choose another name or move the old file away",
        path.display()
    )]
    KeyExists { path: PathBuf },
    /// The signature file is missing.
    #[error(
        "the model is not signed: {} is missing; sign it with `push-model sign --key KEY MODEL`",
        path.display()
    )]
    Unsigned {
        /// Where the signature was expected.
        path: PathBuf,
    },
    /// The file of trusted keys is missing or contains no key.
    #[error(
        "no key is trusted: {} contains none; add the public key that `push-model keygen` printed, one per line",
        path.display()
    )]
    NoTrustedKeys { path: PathBuf },
    /// A line of the file of trusted keys cannot be parsed.
    #[error(
        "{}, line {line}: `{text}` is not a minisign public key (56 characters starting with RW): {reason}",
        path.display()
    )]
    TrustedKey {
        path: PathBuf,
        /// Counted from 1.
        line: usize,
        text: String,
        reason: String,
    },
    /// The signature cannot be parsed.
    #[error(
        "the signature is not in minisign's format: {reason}; sign the model again with `push-model sign`"
    )]
    SignatureForm { reason: String },
    /// No trusted key signed the model.
    #[error(
        "the model is signed by a key that is not trusted (trusted: {trusted}); sign it with a trusted key, or add the signer's public key to the robot's trusted keys"
    )]
    UntrustedKey {
        /// The comments of the trusted keys.
        trusted: String,
    },
    /// The signature names a trusted key, but the signed bytes differ.
    #[error(
        "the signature does not match: the model or the signature's comment was changed after it was signed with the key {key}; fetch the bundle again from where it was signed"
    )]
    Forged {
        /// The comment of the key.
        key: String,
    },
    /// The signed comment does not name this model and its digest.
    #[error(
        "the signed comment `{comment}` is not `model=NAME blake3=DIGEST` of this model; sign it with `push-model sign`"
    )]
    Comment { comment: String },
    /// The name is not safe to use as a model's name.
    #[error(
        "`{name}` cannot be a model's name; use 1 to 64 letters, digits, `.`, `_` and `-`, and do not start with `.`"
    )]
    Name { name: String },
    /// The model or the signature is larger than allowed.
    #[error("the {what} has {bytes} bytes; at most {most} are allowed")]
    TooLarge {
        /// `model` or `signature`.
        what: &'static str,
        bytes: u64,
        most: u64,
    },
    /// The stream does not start with a bundle's header.
    #[error(
        "this is not a bundle: it starts with `{found}`; give NAME.onnx with NAME.onnx.minisig beside it, or `-` to read what `push-model` sends"
    )]
    NoBundle {
        /// The first characters of the stream.
        found: String,
    },
    /// The secret key cannot be used.
    #[error(
        "cannot use the secret key {}: {reason}; check the password, or make a key with `push-model keygen`",
        path.display()
    )]
    SecretKey { path: PathBuf, reason: String },
    /// The key cannot sign.
    #[error("cannot sign: {reason}; make a key with `push-model keygen`")]
    Sign { reason: String },
}

impl BundleError {
    pub(crate) fn unreadable(path: &Path, reason: io::Error) -> Self {
        Self::File { what: "read", path: path.to_owned(), reason }
    }

    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::File { .. } | Self::Stream { .. } | Self::KeyExists { .. } => ErrorKind::File,
            Self::Unsigned { .. } => ErrorKind::Unsigned,
            Self::UntrustedKey { .. } | Self::NoTrustedKeys { .. } => ErrorKind::UntrustedKey,
            Self::Forged { .. } | Self::Comment { .. } => ErrorKind::Forged,
            _ => ErrorKind::Form,
        }
    }
}
