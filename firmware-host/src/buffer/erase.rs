//! `firmware-host buffer erase`: removes a run from this computer, and prints what it was as a receipt.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, bail, ensure};
use segment_store::{Catalogue, Digest, Hasher, State};

use super::cannot_read;
use crate::output;

/// A line of the receipt.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Line {
    path: PathBuf,
    bytes: u64,
    digest: Digest,
}

/// Prints the receipt, and erases the run if `yes`. Otherwise the exit code is 1.
pub(super) fn run(dir: &Path, yes: bool) -> Result<ExitCode> {
    erase_with(dir, yes, output::finish)
}

/// `print_all` writes what was printed to where it belongs.
fn erase_with(dir: &Path, yes: bool, print_all: fn() -> io::Result<()>) -> Result<ExitCode> {
    ensure!(
        dir.is_dir(),
        "{} is not a directory; give the --out directory of one run",
        dir.display()
    );
    // Neither `.` nor a link can be removed as a directory.
    let dir = &dir.canonicalize().with_context(|| cannot_read(dir))?;
    let lines = receipt(dir)?;
    for Line { path, bytes, digest } in &lines {
        println!("{digest} {bytes:>12} {}", path.display());
    }
    let bytes: u64 = lines.iter().map(|line| line.bytes).sum();
    let files = lines.len();
    if !yes {
        println!("{files} files, {bytes} bytes; nothing was erased: `--yes` erases them");
        return Ok(ExitCode::FAILURE);
    }
    // Before anything is erased: a receipt that cannot be printed would be lost.
    print_all().context(
        "nothing was erased: cannot write the receipt to standard output; free space there",
    )?;
    erase(dir, &lines)?;
    let date = jiff::Timestamp::now().strftime("%Y-%m-%dT%H:%M:%SZ");
    println!("erased {}: {files} files, {bytes} bytes, {date}", dir.display());
    Ok(ExitCode::SUCCESS)
}

/// Every file of a run, with its digest (BLAKE3). Refuses what is not the folder of exactly one finished run.
fn receipt(dir: &Path) -> Result<Vec<Line>> {
    let (_, Catalogue { entries: segments, .. }) = super::segments(dir)?;
    if let Some(other) = segments.iter().find(|segment| !segment.name.run().is_empty()) {
        let run = dir.join(other.name.run());
        bail!("{} holds runs, such as {}; give one of them", dir.display(), run.display());
    }
    if let Some(open) = segments.iter().find(|segment| segment.state == State::Open) {
        bail!(
            "{} is still being written; stop the robot first",
            dir.join(open.name.file()).display()
        );
    }
    let mut lines = Vec::new();
    for entry in fs::read_dir(dir).with_context(|| cannot_read(dir))? {
        lines.push(line(entry.with_context(|| cannot_read(dir))?.path())?);
    }
    lines.sort_by(|a, b| a.path.cmp(&b.path));
    Ok(lines)
}

fn line(path: PathBuf) -> Result<Line> {
    let kind = fs::symlink_metadata(&path).with_context(|| cannot_read(&path))?;
    // A run makes neither folders nor links, so this is not the run's.
    ensure!(kind.is_file(), "{} is not a file of a run; move it elsewhere first", path.display());
    let mut hasher = Hasher::default();
    File::open(&path)
        .and_then(|mut file| hasher.update_from(&mut file, u64::MAX))
        .with_context(|| cannot_read(&path))?;
    Ok(Line { bytes: hasher.bytes(), digest: hasher.digest(), path })
}

fn erase(dir: &Path, lines: &[Line]) -> Result<()> {
    for Line { path, .. } in lines {
        fs::remove_file(path).with_context(|| format!("cannot erase {}", path.display()))?;
    }
    fs::remove_dir(dir).with_context(|| format!("cannot erase {}", dir.display()))
}

#[cfg(test)]
mod tests {
    use runtime::recording::Views;

    use super::*;
    use crate::record::tests::{run_header, some_tick};
    use crate::record::{Recorder, RecorderOptions};

    /// A folder of runs with one finished run of two segments and a report.
    fn runs() -> tempfile::TempDir {
        let runs = tempfile::tempdir().unwrap();
        let run = runs.path().join("monday");
        let options = RecorderOptions { segment_ns: 1, ..RecorderOptions::simulation(&run) };
        let mut recorder = Recorder::start(options, run_header()).unwrap();
        for tick in 0..2 {
            recorder.record(some_tick(tick), Views::default()).unwrap();
        }
        recorder.finish().unwrap();
        fs::write(run.join("map.png"), "a plan of the home").unwrap();
        runs
    }

    #[test]
    fn a_run_is_erased_with_all_its_files_and_the_receipt_names_each() {
        let runs = runs();
        let run = runs.path().join("monday");
        let lines = receipt(&run).unwrap();
        let names: Vec<_> = lines.iter().map(|line| line.path.file_name().unwrap()).collect();
        assert_eq!(names, ["map.png", "recording_0000.mcap", "recording_0001.mcap"]);
        assert_eq!(lines[0].bytes, 18);
        assert_eq!(lines[0].digest, Digest::of(b"a plan of the home"));
        super::run(&run, true).unwrap();
        assert!(!run.exists() && runs.path().exists());
    }

    #[test]
    fn nothing_is_erased_if_the_receipt_cannot_be_printed() {
        let runs = runs();
        let run = runs.path().join("monday");
        let error = format!(
            "{:#}",
            erase_with(&run, true, || Err(io::ErrorKind::StorageFull.into())).unwrap_err()
        );
        assert!(error.starts_with("nothing was erased: cannot write the receipt"), "{error}");
        assert_eq!(fs::read_dir(&run).unwrap().count(), 3);
    }

    #[test]
    fn a_run_is_erased_through_a_link_to_it() {
        let runs = runs();
        let run = runs.path().join("monday");
        let link = runs.path().join("latest");
        std::os::unix::fs::symlink(&run, &link).unwrap();
        super::run(&link, true).unwrap();
        assert!(!run.exists());
    }

    #[test]
    fn nothing_is_erased_without_yes() {
        let runs = runs();
        let run = runs.path().join("monday");
        super::run(&run, false).unwrap();
        assert_eq!(fs::read_dir(&run).unwrap().count(), 3);
    }

    #[test]
    fn a_folder_of_runs_is_refused_and_one_of_its_runs_is_named() {
        let runs = runs();
        let error = super::run(runs.path(), true).unwrap_err().to_string();
        assert!(error.contains("holds runs") && error.contains("monday"), "{error}");
        assert!(runs.path().join("monday/recording_0001.mcap").exists());
    }

    #[test]
    fn a_run_with_something_else_in_its_folder_stays_whole() {
        let runs = runs();
        let run = runs.path().join("monday");
        fs::create_dir(run.join("photos")).unwrap();
        let error = super::run(&run, true).unwrap_err().to_string();
        assert!(error.contains("photos") && error.contains("move it elsewhere"), "{error}");
        assert_eq!(fs::read_dir(&run).unwrap().count(), 4);
    }

    #[test]
    fn a_run_that_is_being_recorded_is_not_erased() {
        let runs = runs();
        let run = runs.path().join("monday");
        let last = run.join("recording_0001.mcap");
        let bytes = fs::read(&last).unwrap();
        fs::write(&last, &bytes[..bytes.len() / 2]).unwrap();
        let recorder = File::open(&last).unwrap();
        recorder.lock().unwrap();
        let error = super::run(&run, true).unwrap_err().to_string();
        assert!(error.contains("still being written"), "{error}");
        assert!(last.exists());
    }
}
