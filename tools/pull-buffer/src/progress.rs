//! Output for operators (progress bars or lines) and for programs (JSON).

use std::io::{IsTerminal, Write};

use indicatif::{HumanBytes, MultiProgress, ProgressBar, ProgressStyle};
use segment_store::pull::Progress;
use segment_store::source::Spec;
use segment_store::{Digest, Name};
use serde_json::json;

use crate::robot::Outcome;

/// Shows progress bars on a terminal, otherwise one line per file, and prints JSON to standard output.
pub struct Display {
    bars: Option<MultiProgress>,
    json: bool,
}

impl Display {
    pub fn new(json: bool) -> Self {
        Self { bars: std::io::stderr().is_terminal().then(MultiProgress::new), json }
    }

    /// Creates the bar of one source.
    pub fn bar(&self, name: &str) -> Bar {
        let bar = self.bars.as_ref().map(|bars| {
            let template =
                "{prefix:.bold} {bar:24} {bytes}/{total_bytes}, {bytes_per_sec}, {eta} left  {msg}";
            let style = ProgressStyle::with_template(template)
                .unwrap_or_else(|_| ProgressStyle::default_bar());
            bars.add(ProgressBar::no_length().with_style(style).with_prefix(name.to_owned()))
        });
        Bar { bar, name: name.to_owned(), json: self.json }
    }

    /// Shows the result of one pull. With --follow, pulls without new files are not shown.
    pub fn outcome(&self, spec: &Spec, outcome: &Outcome, follow: bool) {
        let Outcome { report, exported, error } = outcome;
        if follow && report.files == 0 && error.is_none() {
            return;
        }
        if self.json {
            let line = json!({
                "event": "pulled", "source": spec.name, "place": spec.location.to_string(), "files": report.files,
                "bytes": report.bytes, "there": report.there, "open": report.open, "cut": report.cut,
                "unmarked": report.unmarked, "unread": report.unread, "exported": exported,
                "error": error.as_ref().map(ToString::to_string),
            });
            print_line(&line);
        }
        let mut words = vec![format!(
            "{} new ({}), {} already here",
            report.files,
            HumanBytes(report.bytes),
            report.there
        )];
        let counts = [
            (report.open, "still being written"),
            (report.cut, "cut off: repair them with firmware-host buffer recover"),
            (report.unmarked, "not marked as pulled on the robot"),
            (report.unread.len() as u64, "not readable"),
            (*exported, "exported"),
        ];
        words.extend(
            counts
                .iter()
                .filter(|(count, _)| *count > 0)
                .map(|(count, what)| format!("{count} {what}")),
        );
        if report.files + report.there + report.open == 0 && report.unread.is_empty() {
            words = vec![format!("no recordings in {} yet", spec.location)];
        }
        match error {
            Some(error) => self.say(&format!("{}: error: {error}", spec.name)),
            None => self.say(&format!("{}: {}", spec.name, words.join(", "))),
        }
    }

    fn say(&self, line: &str) {
        match &self.bars {
            Some(bars) => drop(bars.println(line)),
            // A closed standard error does not end a pull.
            None => drop(writeln!(std::io::stderr(), "{line}")),
        }
    }
}

/// Shows the progress of one source.
pub struct Bar {
    bar: Option<ProgressBar>,
    name: String,
    json: bool,
}

impl Bar {
    /// Shows a line of text.
    pub fn say(&self, text: &str) {
        match &self.bar {
            Some(bar) => bar.println(format!("{}: {text}", self.name)),
            None => drop(writeln!(std::io::stderr(), "{}: {text}", self.name)),
        }
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

impl Progress for Bar {
    fn planned(&mut self, _files: u64, bytes: u64, done: u64) {
        if let Some(bar) = &self.bar {
            bar.set_length(bytes);
            bar.set_position(done);
            bar.reset_eta();
        }
    }

    fn file_started(&mut self, name: &Name, _bytes: u64, have: u64) {
        if let Some(bar) = &self.bar {
            bar.inc(have);
            bar.set_message(name.to_string());
        }
    }

    fn received(&mut self, bytes: u64) {
        if let Some(bar) = &self.bar {
            bar.inc(bytes);
        }
    }

    fn file_completed(&mut self, name: &Name, digest: &Digest) {
        if self.json {
            print_line(
                &json!({"event": "file", "source": self.name, "file": name.as_str(), "digest": digest}),
            );
        } else if self.bar.is_none() {
            self.say(name.as_str());
        }
    }

    fn warning(&mut self, text: &str) {
        self.say(&format!("warning: {text}"));
    }
}

fn print_line(value: &serde_json::Value) {
    // A closed standard output does not end a pull.
    let _ = writeln!(std::io::stdout(), "{value}");
}
