//! Signed models: an ONNX file `NAME.onnx` and, beside it, its detached signature `NAME.onnx.minisig` in the format of
//! [minisign](https://jedisct1.github.io/minisign/).
//!
//! The signature covers the model's bytes. Its trusted comment, which is signed as well, contains the model's name and BLAKE3
//! digest. A signature therefore cannot be moved to another model, and a model cannot be renamed without signing it again.
//!
//! A robot trusts the public keys in one file ([`TrustedKeys`]). No part of a model is parsed before its signature has been
//! verified. Key generation and signing are behind the feature `sign`, which the workstation's tools enable and the robot's
//! program does not: its binary contains no code that can sign.
#![forbid(unsafe_code)]

mod error;
mod keys;
mod name;
#[cfg(feature = "sign")]
mod sign;
mod stream;
mod verify;

pub use error::{BundleError, ErrorKind};
pub use keys::{TRUSTED_KEYS_FILE, TrustedKey, TrustedKeys};
#[cfg(feature = "sign")]
pub use minisign::SecretKey;
#[cfg(feature = "sign")]
pub use sign::{generate_keys, read_secret_key, sign};
pub use stream::{Bundle, MAX_MODEL_BYTES, MAX_SIGNATURE_BYTES};
pub use verify::{Signed, verify};
