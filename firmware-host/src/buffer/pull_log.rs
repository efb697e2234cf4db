//! Who has taken which segments from this robot: a line of JSON in `pulls.jsonl` beside the runs for each segment that a workstation
//! asks for.
//!
//! The account that the workstation used is that of `sudo` if `buffer serve` was started by it, as docs/pull-buffer.md
//! recommends: an account that may only start this command can neither change nor leave out a line.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use segment_store::Name;
use serde::Serialize;

/// The file's name in the directory of runs.
const FILE: &str = "pulls.jsonl";
/// A larger file is renamed to `pulls.jsonl.1` before the next line. It holds about 30,000 lines, three weeks of a robot that
/// records all day.
const MAX_BYTES: u64 = 4 << 20;

/// Writes down which segments are sent.
pub(super) struct PullLog {
    path: PathBuf,
    who: String,
    from: String,
}

/// One line of the log.
#[derive(Serialize)]
struct Line<'a> {
    time: String,
    who: &'a str,
    #[serde(skip_serializing_if = "str::is_empty")]
    from: &'a str,
    segment: &'a str,
}

impl PullLog {
    /// The log of the directory of runs `dir`, for the account and the address that the environment tells.
    pub(super) fn of(dir: &Path) -> Self {
        // "ADDRESS PORT PORT"; sudo removes it unless its configuration keeps it.
        let client = variable("SSH_CLIENT").unwrap_or_default();
        Self {
            path: dir.join(FILE),
            who: variable("SUDO_USER")
                .or_else(|| variable("USER"))
                .unwrap_or_else(|| "unknown".to_owned()),
            from: client.split(' ').next().unwrap_or_default().to_owned(),
        }
    }

    /// Writes down that `segment` is sent now. A disk that is full does not keep the pull from freeing it: the line is then
    /// missing, and the workstation shows a warning.
    pub(super) fn sent(&self, segment: &Name) {
        if let Err(error) = self.write(segment) {
            eprintln!("warning: {} has no line for this pull: {error}", self.path.display());
        }
    }

    fn write(&self, segment: &Name) -> io::Result<()> {
        let mut file = self.open()?;
        if file.metadata()?.len() >= MAX_BYTES {
            std::fs::rename(&self.path, self.path.with_extension("jsonl.1"))?;
            file = self.open()?;
        }
        let line = Line {
            time: jiff::Timestamp::now().strftime("%Y-%m-%dT%H:%M:%SZ").to_string(),
            who: &self.who,
            from: &self.from,
            segment: segment.as_str(),
        };
        // In one write, so that the lines of two pulls at once do not mix.
        file.write_all(format!("{}\n", serde_json::to_string(&line)?).as_bytes())
    }

    fn open(&self) -> io::Result<File> {
        OpenOptions::new().append(true).create(true).mode(0o600).open(&self.path)
    }
}

fn variable(name: &str) -> Option<String> {
    std::env::var(name).ok().filter(|text| !text.is_empty())
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn each_segment_that_is_sent_has_a_line_and_the_file_never_grows_without_bound() {
        let dir = tempfile::tempdir().unwrap();
        let log = PullLog {
            path: dir.path().join(FILE),
            who: "anna".to_owned(),
            from: "192.0.2.7".to_owned(),
        };
        let name = Name::parse("monday/recording_0003.mcap").unwrap();
        log.sent(&name);
        log.sent(&name);
        let text = std::fs::read_to_string(&log.path).unwrap();
        let line: serde_json::Value = serde_json::from_str(text.lines().next().unwrap()).unwrap();
        assert_eq!(text.lines().count(), 2);
        assert_eq!((&line["who"], &line["from"]), (&"anna".into(), &"192.0.2.7".into()));
        assert_eq!(line["segment"], "monday/recording_0003.mcap");
        assert_eq!(log.path.metadata().unwrap().permissions().mode() & 0o777, 0o600);

        File::options().write(true).open(&log.path).unwrap().set_len(MAX_BYTES).unwrap();
        log.sent(&name);
        assert_eq!(std::fs::read_to_string(&log.path).unwrap().lines().count(), 1);
        assert_eq!(dir.path().join("pulls.jsonl.1").metadata().unwrap().len(), MAX_BYTES);
    }
}
