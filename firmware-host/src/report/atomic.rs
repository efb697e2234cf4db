//! Atomic writing of report files.

use std::{
    fs::{self, File},
    io::{self, Write as _},
    path::{Path, PathBuf},
};

use segment_store::private;

/// An error while writing a report.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReportError {
    /// The directory or the file cannot be written. No partial file was left behind.
    #[error("cannot write {}: {source}; choose another output directory or free space there", path.display())]
    Unwritable { path: PathBuf, source: io::Error },
    /// The number of pixels or cells does not match the size.
    #[error("{what}: {actual} values for {width}x{height}, expected {}", width * height)]
    Shape {
        /// What has the wrong size.
        what: &'static str,
        width: usize,
        height: usize,
        actual: usize,
    },
    /// The image cannot be encoded.
    #[error("cannot encode {}: {message}", path.display())]
    Encoding { path: PathBuf, message: String },
}

/// Creates `dir` if it is missing and checks that files can be written there, so that a run with a
/// bad output directory fails at the start and not at the end.
///
/// # Errors
/// [`ReportError::Unwritable`].
pub fn prepare_dir(dir: &Path) -> Result<(), ReportError> {
    fs::create_dir_all(dir)
        .and_then(|()| probe(dir))
        .map_err(|source| ReportError::Unwritable { path: dir.to_path_buf(), source })
}

/// Like [`prepare_dir`], for the run of a robot: only this account may open the directory, because recording and map show
/// the inside of a home.
///
/// # Errors
/// As [`prepare_dir`].
pub fn prepare_private_dir(dir: &Path) -> Result<(), ReportError> {
    private::create_folder(dir)
        .and_then(|()| probe(dir))
        .map_err(|source| ReportError::Unwritable { path: dir.to_path_buf(), source })
}

fn probe(dir: &Path) -> io::Result<()> {
    let probe = dir.join(".probe.partial");
    let written = File::create(&probe)
        .and_then(|mut file| file.write_all(&[0; 4096]).and_then(|()| file.sync_all()));
    let removed = fs::remove_file(&probe);
    written.and(removed)
}

/// Writes `bytes` to a temporary file and renames it to `path`, so that readers never see a partial
/// file, even after a crash or on a full disk.
///
/// # Errors
/// [`ReportError::Unwritable`]; the temporary file is removed then.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> Result<(), ReportError> {
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(".partial");
    let partial = path.with_file_name(name);
    let written = File::create(&partial)
        .and_then(|mut file| file.write_all(bytes).and_then(|()| file.sync_all()))
        .and_then(|()| fs::rename(&partial, path));
    written.map_err(|source| {
        // Best effort: the first error is the one to report.
        let _ = fs::remove_file(&partial);
        ReportError::Unwritable { path: path.to_path_buf(), source }
    })
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    fn names(dir: &Path) -> Vec<String> {
        fs::read_dir(dir)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect()
    }

    #[test]
    fn a_file_is_replaced_and_no_temporary_file_stays() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("summary.json");
        write_atomically(&path, b"old").unwrap();
        write_atomically(&path, b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(names(dir.path()), ["summary.json"]);
    }

    #[test]
    fn a_directory_at_the_path_of_the_file_is_an_error_and_leaves_no_partial_file() {
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
    fn the_directory_of_a_robots_run_is_for_its_account_only() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("runs/monday");
        prepare_private_dir(&out).unwrap();
        assert_eq!(fs::metadata(&out).unwrap().permissions().mode() & 0o777, 0o700);
        assert!(names(&out).is_empty());
    }

    #[test]
    fn a_file_at_the_path_of_the_directory_is_refused_at_the_start() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("out");
        fs::write(&out, b"").unwrap();
        let error = prepare_dir(&out).unwrap_err().to_string();
        assert!(error.starts_with("cannot write ") && error.contains("out"), "{error}");
    }

    #[test]
    fn a_read_only_directory_is_refused_at_the_start() {
        // procfs refuses new files even to root.
        assert!(prepare_dir(Path::new("/proc/self")).is_err());
    }
}
