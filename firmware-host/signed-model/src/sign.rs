//! Making keys and signatures: on the workstation, never on the robot.

use std::fs::{File, OpenOptions};
use std::io::Write;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use minisign::{KeyPair, SecretKey, SecretKeyBox};

use crate::verify::comment_of;
use crate::{BundleError, is_name};

/// Makes a key pair: the secret key into `secret` (readable by its owner alone), the public key into `SECRET.pub`. Returns the
/// line for the robot's trusted keys. `None` as password: the key is not protected by one, and whoever reads the file signs.
///
/// # Errors
/// A file that is there already or cannot be written.
pub fn generate_keys(
    secret: &Path,
    password: Option<String>,
    comment: &str,
) -> Result<String, BundleError> {
    let sign = |error: minisign::PError| BundleError::Sign { reason: error.to_string() };
    let public = public_path(secret);
    if let Some(path) = [secret, &public].into_iter().find(|path| path.exists()) {
        return Err(BundleError::KeyExists { path: path.to_owned() });
    }
    let pair = match password {
        None => KeyPair::generate_unencrypted_keypair(),
        some => KeyPair::generate_encrypted_keypair(some),
    };
    let KeyPair { pk, sk } = pair.map_err(sign)?;
    write_new(
        secret,
        0o600,
        &sk.to_box(Some("embodied-depth secret key")).map_err(sign)?.to_string(),
    )?;
    write_new(&public, 0o644, &pk.to_box().map_err(sign)?.to_string())?;
    Ok(format!("{} {comment}", pk.to_base64()).trim_end().to_owned())
}

/// Where the public key to a secret key lies.
fn public_path(secret: &Path) -> PathBuf {
    let mut path = secret.as_os_str().to_owned();
    path.push(".pub");
    path.into()
}

fn write_new(path: &Path, mode: u32, text: &str) -> Result<(), BundleError> {
    let open = || -> std::io::Result<File> {
        OpenOptions::new().write(true).create_new(true).mode(mode).open(path)
    };
    let written =
        open().and_then(|mut file| file.write_all(text.as_bytes()).and_then(|()| file.sync_all()));
    written.map_err(|reason| BundleError::File { what: "write", path: path.to_owned(), reason })
}

/// Reads a secret key as [`generate_keys`] or `minisign -G` writes it (with a password: the checksum that `minisign -G -W` 0.11 writes
/// is not what the crate expects). `password` is asked for only where the key has one.
///
/// # Errors
/// A file that cannot be read or is no secret key, or a wrong password.
pub fn read_secret_key(
    path: &Path,
    password: impl FnOnce() -> std::io::Result<String>,
) -> Result<SecretKey, BundleError> {
    let file = |reason| BundleError::File { what: "read", path: path.to_owned(), reason };
    let refused = |error: minisign::PError| BundleError::SecretKey {
        path: path.to_owned(),
        reason: error.to_string(),
    };
    let text = std::fs::read(path).map_err(file)?;
    let text = String::from_utf8(text).map_err(|_| BundleError::SecretKey {
        path: path.to_owned(),
        reason: "it is not text".to_owned(),
    })?;
    let boxed = || SecretKeyBox::from_string(&text).map_err(refused);
    if let Ok(key) = boxed()?.into_unencrypted_secret_key() {
        return Ok(key);
    }
    let password = password().map_err(file)?;
    boxed()?.into_secret_key(Some(password)).map_err(refused)
}

/// The text of `NAME.onnx.minisig` for a model.
///
/// # Errors
/// A name that cannot be a model's, or a key that cannot sign.
pub fn sign(model: &[u8], name: &str, key: &SecretKey) -> Result<String, BundleError> {
    if !is_name(name) {
        return Err(BundleError::Name { name: name.to_owned() });
    }
    let comment = comment_of(name, model);
    let untrusted = "signature of an embodied-depth model";
    minisign::sign(None, key, model, Some(&comment), Some(untrusted))
        .map(|signature| signature.to_string())
        .map_err(|error| BundleError::Sign { reason: error.to_string() })
}
