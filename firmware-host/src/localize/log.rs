//! A recorded drive: wheel odometry and scans, in the order of the log's lines.

use std::io::Read;
use std::path::{Path, PathBuf};

use hal::{Pose2, Range, ScanGeometry};

use super::{carmen, urg};

/// Logs with more text than this are refused: an hour of the densest scanner has a tenth of it.
const MAX_BYTES: u64 = 4 << 30;

/// No distance, angle or time of a drive is as large; sums of smaller numbers stay finite.
const TOO_LARGE: f64 = 1e12;

/// One line of the log that has odometry or a scan.
#[derive(Debug, Clone, PartialEq)]
pub struct Line {
    /// As it stands in the log, seconds.
    pub time_s: f64,
    /// Pose by the wheels alone, beginning at the identity.
    pub wheel: Pose2,
    /// One range per beam, if the line is a scan.
    pub ranges: Option<Vec<Range>>,
}

/// Where a log's wheel odometry comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Odometry {
    /// The increments between the odometry of neighbouring lines.
    Lines,
    /// The log is corrected: the increments between neighbouring ODOM lines, restarted at each ODOM line with time 0.
    BetweenAnswers,
    /// The poses of the scans' lines: the log has no ODOM lines.
    Scans,
    /// The log is corrected and has no other odometry: the robot is taken to stand until a scan says otherwise.
    Absent,
}

impl std::fmt::Display for Odometry {
    fn fmt(&self, to: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        to.write_str(match self {
            Self::Lines => "increments between the log's odometry lines",
            Self::BetweenAnswers => {
                "increments between ODOM lines, restarted at each ODOM line with time 0 (the log is corrected: its other poses are \
                 another program's answer and are not used)"
            }
            Self::Scans => "the poses of the scans' lines (the log has no ODOM lines)",
            Self::Absent => {
                "none (the log is corrected and has no ODOM lines of its own; its poses are another program's answer)"
            }
        })
    }
}

/// The wheels that a log's odometry was computed with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LogWheels {
    pub radius_m: f64,
    pub track_m: f64,
}

/// A whole log.
#[derive(Debug, Clone, PartialEq)]
pub struct Log {
    pub geometry: ScanGeometry,
    /// Time that the scanner takes for the beams of a scan; 0 if the log does not say. Localization does not use it, because the
    /// times of the scans are not known well enough; `calibrate` evens them out first.
    pub sweep_ns: u64,
    pub t_base_laser: Pose2,
    /// `None` if the log does not say.
    pub wheels: Option<LogWheels>,
    pub odometry: Odometry,
    pub lines: Vec<Line>,
    /// Scans with another number of beams than the first one. Their lines have no ranges.
    pub other_shape: usize,
}

/// Why a log cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LogError {
    /// The file cannot be opened or read.
    #[error("cannot read {path}: {source}")]
    Unreadable { path: PathBuf, source: std::io::Error },
    /// The compressed data end too early.
    #[error("{path} is truncated: its compressed data end too early; copy the file again")]
    Truncated { path: PathBuf },
    /// The compressed data are damaged.
    #[error(
        "{path} is damaged: its compressed data cannot be read ({reason}); copy the file again"
    )]
    Damaged { path: PathBuf, reason: String },
    /// The log is longer than any drive.
    #[error("{path} has more than {} GiB of text; cut it", MAX_BYTES >> 30)]
    TooLong { path: PathBuf },
    /// A line does not have the form of its kind.
    #[error("{path} line {line}: {reason}")]
    Line { path: PathBuf, line: usize, reason: String },
    /// There is nothing to localize with.
    #[error(
        "{path} has no scans: no line begins with FLASER or ROBOTLASER1, and it does not have the URG .dat form"
    )]
    NoScans { path: PathBuf },
}

/// Why a line of a log was refused: its number, from 1, and the reason.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BadLine {
    pub line: usize,
    pub reason: String,
}

impl Log {
    /// Reads a CARMEN log or a URG .dat file, compressed by gzip or not.
    ///
    /// # Errors
    /// A file that cannot be read, is truncated, has a line of a wrong form, or has no scans.
    pub fn read(path: &Path) -> Result<Self, LogError> {
        let text = text(path)?;
        let log = Self::parse(&text).map_err(|BadLine { line, reason }| LogError::Line {
            path: path.to_path_buf(),
            line,
            reason,
        })?;
        log.ok_or_else(|| LogError::NoScans { path: path.to_path_buf() })
    }

    /// Reads the text of a log. `None` if it has no scans.
    ///
    /// # Errors
    /// The first line of a wrong form.
    pub fn parse(text: &[u8]) -> Result<Option<Self>, BadLine> {
        if urg::is_urg(text) { urg::parse(text) } else { carmen::parse(text) }
    }
}

fn text(path: &Path) -> Result<Vec<u8>, LogError> {
    let bytes = std::fs::read(path)
        .map_err(|source| LogError::Unreadable { path: path.to_path_buf(), source })?;
    if !bytes.starts_with(&[0x1f, 0x8b]) {
        return Ok(bytes);
    }
    let mut text = Vec::new();
    let mut decoder = flate2::read::MultiGzDecoder::new(bytes.as_slice()).take(MAX_BYTES);
    match decoder.read_to_end(&mut text) {
        Ok(length) if length as u64 >= MAX_BYTES => {
            Err(LogError::TooLong { path: path.to_path_buf() })
        }
        Ok(_) => Ok(text),
        Err(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => {
            Err(LogError::Truncated { path: path.to_path_buf() })
        }
        Err(error) => {
            Err(LogError::Damaged { path: path.to_path_buf(), reason: error.to_string() })
        }
    }
}

/// The words of one line, with the line's number for errors.
pub(super) struct Words<'a> {
    line: usize,
    words: std::str::SplitAsciiWhitespace<'a>,
}

impl<'a> Words<'a> {
    /// Words of every line; bytes that are not UTF-8 end a line early.
    pub(super) fn lines(text: &'a [u8]) -> impl Iterator<Item = Self> {
        text.split(|byte| *byte == b'\n').enumerate().map(|(index, bytes)| {
            let valid = bytes.utf8_chunks().next().map_or("", |chunk| chunk.valid());
            Self { line: index + 1, words: valid.split_ascii_whitespace() }
        })
    }

    pub(super) fn next_word(&mut self) -> Option<&'a str> {
        self.words.next()
    }

    pub(super) fn refuse(&self, reason: impl Into<String>) -> BadLine {
        BadLine { line: self.line, reason: reason.into() }
    }

    /// The next word as a finite number; `what` names it in errors.
    pub(super) fn number(&mut self, what: &str) -> Result<f64, BadLine> {
        let word = self.next_word().ok_or_else(|| self.refuse(format!("{what} is missing")))?;
        // Not true for NaN either.
        let value = word.parse().ok().filter(|value: &f64| value.abs() < TOO_LARGE);
        value.ok_or_else(|| {
            self.refuse(format!("{what} is `{word}`, which is not a finite number below 1e12"))
        })
    }

    /// The next word as a count up to `most`.
    pub(super) fn count(&mut self, what: &str, most: usize) -> Result<usize, BadLine> {
        let word = self.next_word().ok_or_else(|| self.refuse(format!("{what} is missing")))?;
        let value = word.parse().ok().filter(|value| *value <= most);
        value.ok_or_else(|| {
            self.refuse(format!("{what} is `{word}`, which is not a whole number up to {most}"))
        })
    }

    pub(super) fn pose(&mut self, what: &str) -> Result<Pose2, BadLine> {
        let x_m = self.number(what)?;
        let y_m = self.number(what)?;
        let yaw_rad = self.number(what)?;
        Ok(Pose2::new(x_m, y_m, yaw_rad))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write as _;

    const LOG: &str = "ODOM 0 0 0 0 0 0 1 h 1\nFLASER 2 1.5 2 0 0 0 0 0 0 1.25 h 1\n";

    fn compressed(text: &str) -> Vec<u8> {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        encoder.write_all(text.as_bytes()).unwrap();
        encoder.finish().unwrap()
    }

    fn read(bytes: &[u8]) -> Result<Log, String> {
        let file = tempfile::Builder::new().prefix("drive").tempfile().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        Log::read(file.path()).map_err(|error| error.to_string())
    }

    #[test]
    fn a_compressed_log_is_the_same_log() {
        assert_eq!(read(&compressed(LOG)), read(LOG.as_bytes()));
        assert_eq!(read(LOG.as_bytes()).unwrap().lines.len(), 2);
    }

    #[test]
    fn a_log_that_is_cut_off_anywhere_in_its_compressed_form_is_refused() {
        let bytes = compressed(&LOG.repeat(50));
        for length in 3..bytes.len() {
            let error = read(&bytes[..length]).unwrap_err();
            assert!(error.contains("drive") && error.contains("truncated"), "{length}: {error}");
        }
    }

    #[test]
    fn damaged_data_are_refused_by_name() {
        let mut bytes = compressed(&LOG.repeat(50));
        let last = bytes.len() - 6;
        bytes[last] ^= 1;
        let error = read(&bytes).unwrap_err();
        assert!(error.contains("drive") && error.contains("damaged"), "{error}");
    }

    #[test]
    fn a_log_without_scans_says_what_a_scan_looks_like() {
        let error = read(b"ODOM 0 0 0 0 0 0 1 h 1\n").unwrap_err();
        assert!(error.contains("has no scans") && error.contains("FLASER"), "{error}");
    }

    #[test]
    fn a_wrong_value_is_refused_by_file_line_and_value() {
        let error = read(b"# log\nODOM 0 inf 0 0 0 0 1 h 1\n").unwrap_err();
        assert!(error.contains("drive") && error.contains("line 2") && error.contains("`inf`"));
    }

    #[test]
    fn a_file_that_is_absent_is_named() {
        let error = Log::read(Path::new("/nowhere/a.log")).unwrap_err().to_string();
        assert!(error.starts_with("cannot read /nowhere/a.log"), "{error}");
    }
}
