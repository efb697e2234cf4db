//! Which names a model may have.

const MAX_NAME_LEN: usize = 64;

/// Whether `name` is safe to use in file names and in the signed comment.
pub(crate) fn is_model_name(name: &str) -> bool {
    !name.is_empty()
        && name.len() <= MAX_NAME_LEN
        && !name.starts_with('.')
        && name.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"._-".contains(&byte))
}
