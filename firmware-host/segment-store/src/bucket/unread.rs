//! Sentences about encrypted segments that are not pulled, and what to do about them.

use std::fmt;

use age::DecryptError;

use super::object_name::ObjectName;

/// An encrypted segment, and no key was given.
pub(super) fn no_identity(name: &ObjectName) -> String {
    format!(
        "{name} is encrypted; give the file with a key that decrypts it, such as --identity key.txt"
    )
}

/// Why an encrypted segment cannot be decrypted.
pub(super) fn undecrypted(name: &ObjectName, error: &DecryptError) -> String {
    match error {
        DecryptError::NoMatchingKeys => format!(
            "{name} is encrypted to other keys than the given ones; give --identity with the key of one of its recipients"
        ),
        error => damaged(name, error),
    }
}

/// An encrypted segment that is not what was encrypted.
pub(super) fn damaged(name: &ObjectName, why: impl fmt::Display) -> String {
    format!(
        "{name} is damaged or incomplete in the store ({why}); remove this object and upload the segment again, or pull it from the robot"
    )
}
