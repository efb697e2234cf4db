//! Verification of a model against its signature and the trusted keys.

use minisign_verify::{Error, Signature};

use crate::name::is_model_name;
use crate::{BundleError, TrustedKeys};

/// A verified model: what its signed comment contains, and which key signed it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Signed {
    pub name: String,
    /// BLAKE3 digest of the model's bytes in hexadecimal.
    pub digest: String,
    /// The comment of the trusted key that signed the model.
    pub by: String,
}

/// The trusted comment of a model's signature, which minisign signs together with the model.
pub(crate) fn signed_comment(name: &str, model: &[u8]) -> String {
    format!("model={name} blake3={}", blake3::hash(model).to_hex())
}

/// Checks that one of `keys` signed these bytes, and that the signed comment contains a valid name and their digest. The model
/// itself is not parsed.
///
/// # Errors
/// The reason why the model must not be used.
pub fn verify(model: &[u8], signature: &str, keys: &TrustedKeys) -> Result<Signed, BundleError> {
    let signature = Signature::decode(signature)
        .map_err(|error| BundleError::SignatureForm { reason: error.to_string() })?;
    for key in keys.keys() {
        match key.key.verify(model, &signature, false) {
            Ok(()) => return check_comment(signature.trusted_comment(), model, &key.comment),
            Err(Error::UnexpectedKeyId) => {}
            Err(Error::InvalidSignature) => {
                return Err(BundleError::Forged { key: key.comment.clone() });
            }
            Err(error) => return Err(BundleError::SignatureForm { reason: error.to_string() }),
        }
    }
    let trusted: Vec<_> = keys.keys().iter().map(|key| key.comment.as_str()).collect();
    Err(BundleError::UntrustedKey { trusted: trusted.join(", ") })
}

/// Checks that a comment that was signed describes this model.
fn check_comment(comment: &str, model: &[u8], by: &str) -> Result<Signed, BundleError> {
    let name = comment
        .strip_prefix("model=")
        .and_then(|rest| rest.split_once(' '))
        .map_or("", |(name, _)| name);
    if !is_model_name(name) || comment != signed_comment(name, model) {
        return Err(BundleError::Comment { comment: comment.to_owned() });
    }
    Ok(Signed {
        name: name.to_owned(),
        digest: blake3::hash(model).to_hex().to_string(),
        by: by.to_owned(),
    })
}
