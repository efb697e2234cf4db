//! Files that are there whole or not at all.

use std::{
    fs::{self, File},
    io::{self, Write as _},
    path::{Path, PathBuf},
};

/// Why a report could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReportError {
    /// The directory or the file cannot be written; nothing was left behind.
    #[error("cannot write {}: {source}; choose another output directory or make room there", path.display())]
    Unwritable {
        /// What was to be written.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// A picture's planes or a map's cells do not fit its size.
    #[error("{what}: {actual} values for {width}x{height}, expected {}", width * height)]
    Shape {
        /// What does not fit.
        what: &'static str,
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// How many values there are.
        actual: usize,
    },
    /// The picture cannot be encoded.
    #[error("cannot encode {}: {message}", path.display())]
    Encoding {
        /// The file it was for.
        path: PathBuf,
        /// What the encoder says.
        message: String,
    },
}

/// Creates `dir` where it is missing and proves that files can be written there, so that a run fails before it starts and
/// not when it ends.
///
/// # Errors
/// [`ReportError::Unwritable`].
pub fn prepare_dir(dir: &Path) -> Result<(), ReportError> {
    let unwritable = |source| ReportError::Unwritable { path: dir.to_path_buf(), source };
    fs::create_dir_all(dir).map_err(unwritable)?;
    let probe = dir.join(".probe.partial");
    let written = File::create(&probe)
        .and_then(|mut file| file.write_all(&[0; 4096]).and_then(|()| file.sync_all()));
    let removed = fs::remove_file(&probe);
    written.and(removed).map_err(unwritable)
}

/// Writes `bytes` to `path` by way of a temporary file beside it: a reader, a crash and a full disk see the old file or
/// the new one, never a part.
///
/// # Errors
/// [`ReportError::Unwritable`]; the temporary file is gone then.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> Result<(), ReportError> {
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(".partial");
    let partial = path.with_file_name(name);
    let written = File::create(&partial)
        .and_then(|mut file| file.write_all(bytes).and_then(|()| file.sync_all()))
        .and_then(|()| fs::rename(&partial, path));
    written.map_err(|source| {
        // Best effort: the reason that the user needs is the first one.
        let _ = fs::remove_file(&partial);
        ReportError::Unwritable { path: path.to_path_buf(), source }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(dir: &Path) -> Vec<String> {
        fs::read_dir(dir)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect()
    }

    #[test]
    fn the_file_is_replaced_whole_and_nothing_else_stays() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("summary.json");
        write_atomically(&path, b"old").unwrap();
        write_atomically(&path, b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(names(dir.path()), ["summary.json"]);
    }

    #[test]
    fn a_directory_in_the_files_place_is_an_error_and_leaves_no_partial_file() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("summary.json");
        fs::create_dir(&path).unwrap();
        let error = write_atomically(&path, b"new").unwrap_err().to_string();
        assert!(
            error.contains("summary.json") && error.contains("choose another output directory"),
            "{error}"
        );
        assert_eq!(names(dir.path()), ["summary.json"]);
    }

    #[test]
    fn an_output_directory_is_made_and_left_empty() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("a/b");
        prepare_dir(&out).unwrap();
        assert!(names(&out).is_empty());
    }

    #[test]
    fn a_file_in_the_directorys_place_is_refused_at_the_start() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("out");
        fs::write(&out, b"").unwrap();
        let error = prepare_dir(&out).unwrap_err().to_string();
        assert!(error.starts_with("cannot write ") && error.contains("out"), "{error}");
    }

    #[test]
    fn a_directory_that_takes_no_files_is_refused_at_the_start() {
        // procfs refuses new files even to root.
        assert!(prepare_dir(Path::new("/proc/self")).is_err());
    }
}
