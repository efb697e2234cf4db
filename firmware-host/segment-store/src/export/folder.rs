//! Atomic creation of a directory.

use std::path::Path;

use crate::error::StoreError;
use crate::partial::{create_beside, give_name, refuse_existing};

/// Creates the directory `to`: `fill` writes into a temporary directory beside it, which is renamed when `fill` succeeds.
pub(super) fn new_folder<T>(
    to: &Path,
    fill: impl FnOnce(&Path) -> Result<T, StoreError>,
) -> Result<T, StoreError> {
    refuse_existing(to)?;
    if let Some(parent) = to.parent() {
        std::fs::create_dir_all(parent).map_err(StoreError::output(parent))?;
    }
    let (partial, ()) = create_beside(to, |partial| std::fs::create_dir(partial))
        .map_err(StoreError::output(to))?;
    let filled = fill(&partial).and_then(|value| {
        give_name(&partial, to)?;
        Ok(value)
    });
    if filled.is_err() {
        // The error that is returned is the first one; failing to remove the temporary directory adds nothing.
        let _ = std::fs::remove_dir_all(&partial);
    }
    filled
}
