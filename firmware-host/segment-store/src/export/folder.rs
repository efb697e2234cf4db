//! Atomic creation of a directory.

use std::path::Path;

use crate::error::StoreError;

/// Creates the directory `to`: `fill` writes into a temporary directory beside it, which is renamed when `fill` succeeds.
pub(super) fn new_folder<T>(
    to: &Path,
    fill: impl FnOnce(&Path) -> Result<T, StoreError>,
) -> Result<T, StoreError> {
    if to.exists() {
        return Err(StoreError::Exists { path: to.to_owned() });
    }
    let partial = to.with_file_name(format!(
        "{}.partial",
        to.file_name().unwrap_or_default().to_string_lossy()
    ));
    // May be left over from an export that was interrupted; nothing else uses this name.
    let _ = std::fs::remove_dir_all(&partial);
    let filled = fill_and_rename(&partial, to, fill);
    if filled.is_err() {
        let _ = std::fs::remove_dir_all(&partial);
    }
    filled
}

fn fill_and_rename<T>(
    partial: &Path,
    to: &Path,
    fill: impl FnOnce(&Path) -> Result<T, StoreError>,
) -> Result<T, StoreError> {
    std::fs::create_dir_all(partial).map_err(StoreError::write(partial))?;
    let value = fill(partial)?;
    std::fs::rename(partial, to).map_err(StoreError::write(to))?;
    Ok(value)
}
