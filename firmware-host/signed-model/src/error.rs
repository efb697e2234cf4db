//! Why a bundle is not taken, or cannot be made.

use std::io;
use std::path::PathBuf;

/// What kind of thing went wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ErrorKind {
    /// A file cannot be read or written.
    File,
    /// Something has not the form that it must have.
    Form,
    /// There is no signature.
    Unsigned,
    /// The signature is by a key that is not trusted.
    UntrustedKey,
    /// The signature does not fit the model.
    Forged,
}

/// Why a bundle is not taken, or cannot be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BundleError {
    /// A file cannot be read or written.
    #[error("cannot {what} {}: {reason}; check the path and its rights", path.display())]
    File {
        /// `read` or `write`.
        what: &'static str,
        /// The file.
        path: PathBuf,
        /// What the system says.
        reason: io::Error,
    },
    /// The bundle breaks off or cannot be read.
    #[error("the bundle cannot be read: {reason}; send it again")]
    Stream {
        /// What the system says.
        reason: io::Error,
    },
    /// A key file exists already.
    #[error("{} exists already; a key is never overwritten: give another name or move the old one away", path.display())]
    KeyExists {
        /// The file.
        path: PathBuf,
    },
    /// The model has no signature.
    #[error("the model is not signed: {} is missing; sign it with `push-model sign --key KEY MODEL`", path.display())]
    Unsigned {
        /// Where the signature should be.
        path: PathBuf,
    },
    /// The robot trusts nobody.
    #[error(
        "no key is trusted: {} holds none; put the public key of `push-model keygen` into it, one a line",
        path.display()
    )]
    NoTrustedKeys {
        /// The file of trusted keys.
        path: PathBuf,
    },
    /// A line of the trusted keys is no key.
    #[error("{}, line {line}: `{text}` is no minisign public key (56 characters that begin with RW): {reason}", path.display())]
    TrustedKey {
        /// The file.
        path: PathBuf,
        /// Counted from 1.
        line: usize,
        /// What stands there.
        text: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The signature file is none.
    #[error(
        "the signature is not in minisign's format: {reason}; sign the model again with `push-model sign`"
    )]
    SignatureForm {
        /// What is wrong with it.
        reason: String,
    },
    /// Signed by a key that is not trusted.
    #[error(
        "the model is signed by a key that is not trusted (trusted: {trusted}); sign it with a trusted key, or add the signer's public key to the robot's trusted keys"
    )]
    UntrustedKey {
        /// Who is trusted.
        trusted: String,
    },
    /// The signature is by a trusted key, but of other bytes.
    #[error(
        "the signature does not fit: the model or the signature's comment was changed after it was signed with the key {key}; get the bundle again from where it was signed"
    )]
    Forged {
        /// Comment of the key.
        key: String,
    },
    /// The signed comment speaks of another model or says nothing.
    #[error(
        "the signed comment `{comment}` is not `model=NAME blake3=DIGEST` of this model; sign it with `push-model sign`"
    )]
    Comment {
        /// What it says.
        comment: String,
    },
    /// A name that cannot be a model's.
    #[error(
        "`{name}` cannot name a model; use 1 to 64 letters, digits, `.`, `_` and `-`, not beginning with `.`"
    )]
    Name {
        /// The name.
        name: String,
    },
    /// Larger than a model may be.
    #[error("the {what} has {bytes} bytes, at most {most} are allowed")]
    TooLarge {
        /// `model` or `signature`.
        what: &'static str,
        /// Size.
        bytes: u64,
        /// Limit.
        most: u64,
    },
    /// What was sent is no bundle.
    #[error(
        "this is no bundle but begins with `{found}`; give NAME.onnx with NAME.onnx.minisig beside it, or `-` for what `push-model` sends"
    )]
    NoBundle {
        /// The first characters.
        found: String,
    },
    /// The secret key cannot be used.
    #[error("the secret key {} cannot be used: {reason}; check the password, or make a key with `push-model keygen`", path.display())]
    SecretKey {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// Signing failed.
    #[error("cannot sign: {reason}; make a key with `push-model keygen`")]
    Sign {
        /// What is wrong.
        reason: String,
    },
}

impl BundleError {
    /// What kind of thing went wrong.
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
