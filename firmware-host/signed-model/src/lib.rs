//! A model and who vouches for it: an ONNX file `NAME.onnx` and beside it the detached signature `NAME.onnx.minisig`, in the
//! format of [minisign](https://jedisct1.github.io/minisign/).
//!
//! The signature covers the model's bytes. Its trusted comment, which is signed too, names the model and repeats its BLAKE3
//! digest: a signature cannot be put beside another model, and a model cannot be given another name.
//!
//! A robot trusts the public keys of one file ([`TrustedKeys`]). Nothing of a model is parsed before its signature was checked.
#![forbid(unsafe_code)]

mod error;
mod keys;
mod sign;
mod stream;
mod verify;

pub use error::{BundleError, ErrorKind};
pub use keys::{TRUSTED_KEYS_FILE, TrustedKey, TrustedKeys};
pub use sign::{generate_keys, read_secret_key, sign};
pub use stream::{Bundle, MAX_MODEL_BYTES, MAX_SIGNATURE_BYTES};
pub use verify::{Signed, verify};

/// What signs; never on a robot.
pub use minisign::SecretKey;

/// Longest name of a model.
const LONGEST_NAME: usize = 64;

/// What a model may be called: it becomes part of file names and of signed text.
pub(crate) fn is_name(name: &str) -> bool {
    let allowed = |byte: u8| byte.is_ascii_alphanumeric() || b"._-".contains(&byte);
    !name.is_empty()
        && name.len() <= LONGEST_NAME
        && !name.starts_with('.')
        && name.bytes().all(allowed)
}
