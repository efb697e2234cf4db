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
    /// The path of an output directory names a file.
    #[error("{} is a file, not a folder; choose another folder", path.display())]
    NotAFolder { path: PathBuf },
    /// The path of a file names a directory, a device, a socket or a pipe.
    #[error("{} is not a regular file and is not replaced; choose another file", path.display())]
    NotAFile { path: PathBuf },
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
/// [`ReportError::Unwritable`] or [`ReportError::NotAFolder`].
pub fn prepare_dir(dir: &Path) -> Result<(), ReportError> {
    prepared(dir, fs::create_dir_all(dir))
}

/// Like [`prepare_dir`], for the run of a robot: only this account may open the directory, because recording and map show
/// the inside of a home.
///
/// # Errors
/// As [`prepare_dir`].
pub fn prepare_private_dir(dir: &Path) -> Result<(), ReportError> {
    prepared(dir, private::create_folder(dir))
}

fn prepared(dir: &Path, created: io::Result<()>) -> Result<(), ReportError> {
    if dir.exists() && !dir.is_dir() {
        return Err(ReportError::NotAFolder { path: dir.to_path_buf() });
    }
    created.and_then(|()| probe(dir)).map_err(unwritable(dir))
}

/// Checks that a file can be written at `path`, so that long work whose result cannot be kept is not begun.
///
/// # Errors
/// As [`write_atomically`].
pub fn check_file(path: &Path) -> Result<(), ReportError> {
    probe(folder_of(&target(path)?)).map_err(unwritable(path))
}

fn unwritable(path: &Path) -> impl FnOnce(io::Error) -> ReportError {
    let path = path.to_path_buf();
    |source| ReportError::Unwritable { path, source }
}

fn folder_of(file: &Path) -> &Path {
    file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

fn probe(dir: &Path) -> io::Result<()> {
    let probe = dir.join(".probe.partial");
    let written = File::create(&probe)
        .and_then(|mut file| file.write_all(&[0; 4096]).and_then(|()| file.sync_all()));
    let removed = fs::remove_file(&probe);
    written.and(removed)
}

/// The file that is written at `path`: where a symbolic link leads, else `path` itself.
///
/// # Errors
/// [`ReportError::NotAFile`] if something that is no regular file is there: replacing a device would destroy it.
pub fn target(path: &Path) -> Result<PathBuf, ReportError> {
    let Ok(link) = fs::read_link(path) else { return regular(path, path.to_path_buf()) };
    // A link to a file that is still missing has no canonical path.
    let target = fs::canonicalize(path).unwrap_or_else(|_| folder_of(path).join(link));
    regular(path, target)
}

fn regular(path: &Path, target: PathBuf) -> Result<PathBuf, ReportError> {
    match fs::metadata(&target) {
        Ok(there) if !there.is_file() => Err(ReportError::NotAFile { path: path.to_path_buf() }),
        // Why it cannot be read is found again when it is written.
        _ => Ok(target),
    }
}

/// Writes `bytes` to a temporary file and renames it to `path`, so that readers never see a partial
/// file, even after a crash or on a full disk. A symbolic link stays; the file that it leads to is replaced.
///
/// # Errors
/// [`ReportError::Unwritable`], and the temporary file is removed then; [`ReportError::NotAFile`].
pub fn write_atomically(path: &Path, bytes: &[u8]) -> Result<(), ReportError> {
    let target = target(path)?;
    let mut name = target.file_name().unwrap_or_default().to_os_string();
    name.push(".partial");
    let partial = target.with_file_name(name);
    let written = File::create(&partial)
        .and_then(|mut file| file.write_all(bytes).and_then(|()| file.sync_all()))
        .and_then(|()| fs::rename(&partial, &target));
    written.map_err(|source| {
        // Best effort: the first error is the one to report.
        let _ = fs::remove_file(&partial);
        unwritable(path)(source)
    })
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::{FileTypeExt, PermissionsExt, symlink};

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
            error.ends_with(
                "summary.json is not a regular file and is not replaced; choose another file"
            ),
            "{error}"
        );
        assert_eq!(names(dir.path()), ["summary.json"]);
    }

    #[test]
    fn a_link_stays_and_the_file_that_it_leads_to_is_replaced() {
        let dir = tempfile::tempdir().unwrap();
        let etc = dir.path().join("etc");
        fs::create_dir(&etc).unwrap();
        let link = dir.path().join("robot.toml");
        symlink("etc/robot.toml", &link).unwrap();
        // The file is missing at first.
        for content in ["old", "new"] {
            write_atomically(&link, content.as_bytes()).unwrap();
            assert_eq!(fs::read_to_string(etc.join("robot.toml")).unwrap(), content);
            assert!(link.is_symlink());
        }
        assert_eq!(names(&etc), ["robot.toml"]);
    }

    #[test]
    fn what_is_no_regular_file_is_refused_also_behind_a_link_and_is_not_replaced() {
        let dir = tempfile::tempdir().unwrap();
        // A socket stands for a device, which a defect here would destroy.
        let socket = dir.path().join("socket");
        let _listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        let link = dir.path().join("task.json");
        symlink(&socket, &link).unwrap();
        for path in [&socket, &link] {
            for result in [write_atomically(path, b"{}"), check_file(path)] {
                let error = result.unwrap_err().to_string();
                let words = " is not a regular file and is not replaced; choose another file";
                assert!(error.ends_with(words), "{error}");
            }
        }
        assert!(fs::metadata(&socket).unwrap().file_type().is_socket() && link.is_symlink());
    }

    #[test]
    fn a_file_is_checked_before_it_is_written_and_nothing_is_left() {
        let dir = tempfile::tempdir().unwrap();
        check_file(&dir.path().join("calibration.toml")).unwrap();
        assert!(names(dir.path()).is_empty());
        let nowhere = dir.path().join("nowhere/calibration.toml");
        let error = check_file(&nowhere).unwrap_err().to_string();
        assert!(error.starts_with(&format!("cannot write {}: ", nowhere.display())), "{error}");
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
        assert!(error.ends_with("out is a file, not a folder; choose another folder"), "{error}");
        assert_eq!(fs::read(&out).unwrap(), b"");
    }

    #[test]
    fn a_read_only_directory_is_refused_at_the_start() {
        // procfs refuses new files even to root.
        assert!(prepare_dir(Path::new("/proc/self")).is_err());
    }
}
