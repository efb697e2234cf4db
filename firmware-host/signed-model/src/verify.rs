//! Whether a model is what a trusted person signed.

use minisign_verify::{Error, Signature};

use crate::{BundleError, TrustedKeys, is_name};

/// What a valid signature says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Signed {
    /// What the signer calls the model.
    pub name: String,
    /// BLAKE3 digest of the model's bytes, in hex.
    pub digest: String,
    /// Comment of the trusted key that signed it.
    pub by: String,
}

/// The comment that is signed with a model.
pub(crate) fn comment_of(name: &str, model: &[u8]) -> String {
    format!("model={name} blake3={}", blake3::hash(model).to_hex())
}

/// Checks that one of `keys` signed these bytes, under the name and digest of the signed comment. Nothing of the model is parsed.
///
/// # Errors
/// Why the model must not be touched; see [`BundleError`].
pub fn verify(model: &[u8], signature: &str, keys: &TrustedKeys) -> Result<Signed, BundleError> {
    let signature = Signature::decode(signature)
        .map_err(|error| BundleError::SignatureForm { reason: error.to_string() })?;
    for key in keys.keys() {
        match key.key.verify(model, &signature, false) {
            Ok(()) => return said(signature.trusted_comment(), model, &key.comment),
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

/// What a comment that was signed says of this model.
fn said(comment: &str, model: &[u8], by: &str) -> Result<Signed, BundleError> {
    let name = comment
        .strip_prefix("model=")
        .and_then(|rest| rest.split_once(' '))
        .map_or("", |(name, _)| name);
    if !is_name(name) || comment != comment_of(name, model) {
        return Err(BundleError::Comment { comment: comment.to_owned() });
    }
    Ok(Signed {
        name: name.to_owned(),
        digest: blake3::hash(model).to_hex().to_string(),
        by: by.to_owned(),
    })
}
