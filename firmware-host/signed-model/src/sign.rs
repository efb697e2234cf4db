//! Key generation and signing, for the workstation only.

use std::fs::OpenOptions;
use std::io::{self, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use minisign::{KeyPair, PError, SecretKey, SecretKeyBox};

use crate::BundleError;
use crate::name::is_model_name;
use crate::verify::signed_comment;

/// Generates a key pair and writes the secret key to `secret` (mode 0600) and the public key to `SECRET.pub`. Returns the line
/// to add to the robot's trusted keys. With `None` as the password the key file is not encrypted, and everyone who can read it can sign.
///
/// # Errors
/// When one of the files exists already or cannot be written.
pub fn generate_keys(
    secret: &Path,
    password: Option<String>,
    comment: &str,
) -> Result<String, BundleError> {
    let public = public_path(secret);
    if let Some(path) = [secret, &public].into_iter().find(|path| path.exists()) {
        return Err(BundleError::KeyExists { path: path.to_owned() });
    }
    let pair = match password {
        None => KeyPair::generate_unencrypted_keypair(),
        some => KeyPair::generate_encrypted_keypair(some),
    };
    let KeyPair { pk, sk } = pair.map_err(|error| cannot_sign(&error))?;
    let secret_box =
        sk.to_box(Some("embodied-depth secret key")).map_err(|error| cannot_sign(&error))?;
    write_new(secret, 0o600, &secret_box.to_string())?;
    write_new(&public, 0o644, &pk.to_box().map_err(|error| cannot_sign(&error))?.to_string())?;
    Ok(format!("{} {comment}", pk.to_base64()).trim_end().to_owned())
}

fn cannot_sign(error: &PError) -> BundleError {
    BundleError::Sign { reason: error.to_string() }
}

fn public_path(secret: &Path) -> PathBuf {
    let mut path = secret.as_os_str().to_owned();
    path.push(".pub");
    path.into()
}

fn write_new(path: &Path, mode: u32, text: &str) -> Result<(), BundleError> {
    try_write_new(path, mode, text).map_err(|reason| BundleError::File {
        what: "write",
        path: path.to_owned(),
        reason,
    })
}

fn try_write_new(path: &Path, mode: u32, text: &str) -> io::Result<()> {
    let mut file = OpenOptions::new().write(true).create_new(true).mode(mode).open(path)?;
    file.write_all(text.as_bytes())?;
    file.sync_all()
}

/// Reads a secret key as [`generate_keys`] or `minisign -G` writes it. One exception: the crate rejects the checksum that
/// `minisign -G -W` 0.11 writes for keys with a password. `password` is called only when the key is encrypted.
///
/// # Errors
/// When the file cannot be read or is not a secret key, or the password is wrong.
pub fn read_secret_key(
    path: &Path,
    password: impl FnOnce() -> io::Result<String>,
) -> Result<SecretKey, BundleError> {
    let bytes = std::fs::read(path).map_err(|reason| BundleError::unreadable(path, reason))?;
    let text = String::from_utf8(bytes).map_err(|_| unusable(path, "it is not text"))?;
    if let Ok(key) = parse_box(&text, path)?.into_unencrypted_secret_key() {
        return Ok(key);
    }
    let password = password().map_err(|reason| BundleError::unreadable(path, reason))?;
    parse_box(&text, path)?
        .into_secret_key(Some(password))
        .map_err(|error| unusable(path, &error.to_string()))
}

fn parse_box(text: &str, path: &Path) -> Result<SecretKeyBox, BundleError> {
    SecretKeyBox::from_string(text).map_err(|error| unusable(path, &error.to_string()))
}

fn unusable(path: &Path, reason: &str) -> BundleError {
    BundleError::SecretKey { path: path.to_owned(), reason: reason.to_owned() }
}

/// Signs a model and returns the contents of `NAME.onnx.minisig`.
///
/// # Errors
/// When `name` cannot be a model's name, or the key cannot sign.
pub fn sign(model: &[u8], name: &str, key: &SecretKey) -> Result<String, BundleError> {
    if !is_model_name(name) {
        return Err(BundleError::Name { name: name.to_owned() });
    }
    let comment = signed_comment(name, model);
    let untrusted = "signature of an embodied-depth model";
    minisign::sign(None, key, model, Some(&comment), Some(untrusted))
        .map(|signature| signature.to_string())
        .map_err(|error| cannot_sign(&error))
}
