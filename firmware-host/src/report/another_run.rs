//! Refuses output folders in which the results of another run would be replaced.

use std::path::Path;

use anyhow::{Result, bail};

use super::summary::SUMMARY_FILE;
use crate::replay::segments;

/// Refuses a folder that contains a recorded run or the summary of a run.
///
/// # Errors
/// When it does.
pub fn refuse_run(out: &Path) -> Result<()> {
    if out.is_dir() && segments(out).is_ok_and(|segments| !segments.is_empty()) {
        bail!(
            "{} contains a recorded run, whose results would be overwritten; choose another --out",
            out.display()
        );
    }
    refuse_file(out, SUMMARY_FILE)
}

/// Refuses a folder that contains this file, which every run of a command writes.
///
/// # Errors
/// When it does.
pub fn refuse_file(out: &Path, name: &str) -> Result<()> {
    if out.join(name).exists() {
        bail!(
            "{} contains {name} of another run; choose another --out, or move the old run away",
            out.display()
        );
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_with_a_summary_or_a_recording_is_refused_and_any_other_is_not() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("out");
        refuse_run(&out).unwrap();
        std::fs::create_dir(&out).unwrap();
        std::fs::write(out.join("notes.txt"), "mine").unwrap();
        refuse_run(&out).unwrap();
        for (file, words) in [
            (SUMMARY_FILE, "contains summary.json of another run; choose another --out"),
            ("recording_0000.mcap", "contains a recorded run"),
        ] {
            std::fs::write(out.join(file), "").unwrap();
            let error = refuse_run(&out).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        }
    }
}
