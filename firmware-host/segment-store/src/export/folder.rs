//! An export that is a folder appears as a whole or not at all.

use std::path::Path;

use crate::error::BufferError;

/// Fills the new folder `to` by way of one beside it.
pub(super) fn new_folder<T>(
    to: &Path,
    fill: impl FnOnce(&Path) -> Result<T, BufferError>,
) -> Result<T, BufferError> {
    if to.exists() {
        return Err(BufferError::Exists { path: to.to_owned() });
    }
    let partial = to.with_file_name(format!(
        "{}.partial",
        to.file_name().unwrap_or_default().to_string_lossy()
    ));
    // Left over from an export that was interrupted; nobody else uses this name.
    let _ = std::fs::remove_dir_all(&partial);
    let named = std::fs::create_dir_all(&partial)
        .map_err(BufferError::write(&partial))
        .and_then(|()| fill(&partial))
        .and_then(|value| {
            std::fs::rename(&partial, to).map_err(BufferError::write(to)).map(|()| value)
        });
    if named.is_err() {
        let _ = std::fs::remove_dir_all(&partial);
    }
    named
}
