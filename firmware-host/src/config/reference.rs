//! Writes `robot.default.toml` and `docs/configuration.md` from the declarations of the keys.

use std::fmt::Write as _;
use std::path::Path;

use hal::settings::{Key, Kind, Section};

use super::{Config, check};

/// The command that writes both files.
const COMMAND: &str = "UPDATE_EXPECT=1 cargo test -p firmware-host config::reference";
const COLUMNS: usize = 100;
const PAPER: &str = "\"Paper\" is Embodied Depth Prediction (Liu et al.).";

/// One `[section]` of the file.
struct Chapter {
    path: String,
    section: &'static Section,
}

/// The sections in the order of the file. A section comes before those inside of it.
fn chapters(section: &'static Section, path: &str, into: &mut Vec<Chapter>) {
    if section.keys.iter().any(|key| !matches!(key.kind, Kind::Table(_))) {
        into.push(Chapter { path: path.to_owned(), section });
    }
    for key in section.keys {
        if let Kind::Table(inner) = key.kind {
            chapters(inner, &check::join(path, key.name), into);
        }
    }
}

fn all_chapters() -> Vec<Chapter> {
    let mut all = Vec::new();
    chapters(&Config::SECTION, "", &mut all);
    all
}

impl Chapter {
    /// The keys that are not sections.
    fn keys(&self) -> impl Iterator<Item = &'static Key> {
        self.section.keys.iter().filter(|key| !matches!(key.kind, Kind::Table(_)))
    }

    /// The default of a key as it is written in the file; `None` for a key that is absent by default.
    fn default_of(&self, key: &Key, defaults: &toml::Table) -> Option<String> {
        let mut table = defaults;
        for part in self.path.split('.') {
            table = table.get(part)?.as_table()?;
        }
        Some(table.get(key.name)?.to_string())
    }
}

/// The defaults with the digits with which they are written: an `f32` of 0.98 is 0.98 and not 0.9800000190734863.
fn defaults() -> toml::Table {
    toml::from_str(&Config::default().to_toml().unwrap()).unwrap()
}

fn sentence(lines: &[&str]) -> String {
    let words: Vec<&str> = lines.iter().flat_map(|line| line.split_whitespace()).collect();
    words.join(" ")
}

fn comment(text: &str, into: &mut String) {
    let mut line = "#".to_owned();
    for word in text.split_whitespace() {
        if line.len() + 1 + word.len() > COLUMNS {
            let _ = writeln!(into, "{line}");
            line = "#".to_owned();
        }
        line.push(' ');
        line += word;
    }
    let _ = writeln!(into, "{line}");
}

fn default_file() -> String {
    let mut out = String::new();
    comment(
        "Every key of the configuration with its default. A file given with --config sets only what differs.",
        &mut out,
    );
    comment(PAPER, &mut out);
    comment(&format!("Generated from the source code by: {COMMAND}"), &mut out);
    let defaults = defaults();
    for chapter in all_chapters() {
        out.push('\n');
        comment(&sentence(chapter.section.about), &mut out);
        let _ = writeln!(out, "[{}]", chapter.path);
        for key in chapter.keys() {
            out.push('\n');
            let mut about = sentence(key.about);
            let _ = write!(about, " Allowed: {}.", check::allowed(key));
            if !key.source.is_empty() {
                let _ = write!(about, " Source: {}.", key.source);
            }
            comment(&about, &mut out);
            match chapter.default_of(key, &defaults) {
                Some(value) => {
                    let _ = writeln!(out, "{} = {value}", key.name);
                }
                None => {
                    let _ = writeln!(out, "# {} is not set by default.", key.name);
                }
            }
        }
    }
    out
}

fn markdown() -> String {
    let mut out = String::new();
    let _ = writeln!(out, "# Configuration\n");
    let _ = writeln!(
        out,
        "Every key of the file that `--config` names. All keys are optional. `firmware-host check` prints them as a TOML\n\
         file with comments, and `firmware-host check --config FILE` checks a file and prints every effective value.\n\n\
         The key `calibration = \"calibration.toml\"` at the top of the file includes what `firmware-host calibrate` has measured: the values\n\
         of that file replace those of this one (docs/calibration.md).\n"
    );
    let _ = writeln!(out, "{PAPER} This file is generated from the source code by\n`{COMMAND}`.");
    let defaults = defaults();
    for chapter in all_chapters() {
        let _ = writeln!(out, "\n## `[{}]`\n", chapter.path);
        let _ = writeln!(out, "{}\n", sentence(chapter.section.about));
        let _ = writeln!(out, "| Key | Default | Allowed | Meaning | Source of the default |");
        let _ = writeln!(out, "|---|---|---|---|---|");
        for key in chapter.keys() {
            let default = chapter
                .default_of(key, &defaults)
                .map_or_else(|| "not set".to_owned(), |value| format!("`{value}`"));
            let _ = writeln!(
                out,
                "| `{}` | {default} | {} | {} | {} |",
                key.name,
                check::allowed(key),
                sentence(key.about),
                key.source
            );
        }
    }
    out
}

fn expect_committed(path: &str, generated: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(path);
    if std::env::var_os("UPDATE_EXPECT").is_some() {
        std::fs::write(&path, generated).unwrap();
        return;
    }
    let committed = std::fs::read_to_string(&path).unwrap_or_default();
    let difference = committed
        .lines()
        .zip(generated.lines())
        .find(|(committed, generated)| committed != generated);
    assert!(
        committed == generated,
        "{} is not what the declarations generate; remake it with\n    {COMMAND}\nfirst difference (committed, generated): \
         {difference:?}",
        path.display()
    );
}

#[test]
fn the_default_file_is_the_generated_one() {
    expect_committed("robot.default.toml", &default_file());
}

#[test]
fn the_reference_in_docs_is_the_generated_one() {
    expect_committed("../docs/configuration.md", &markdown());
}

#[test]
fn every_key_and_every_section_is_explained() {
    for chapter in all_chapters() {
        assert!(!chapter.section.about.is_empty(), "[{}] has no description", chapter.path);
        for key in chapter.keys() {
            assert!(!key.about.is_empty(), "{}.{} has no description", chapter.path, key.name);
        }
    }
}
