//! `firmware-host buffer list`.

use std::path::Path;
use std::process::ExitCode;

use anyhow::Result;
use comfy_table::{CellAlignment, Table, presets::ASCII_MARKDOWN};
use segment_store::{Catalogue, Entry, Pulled, State};
use serde_json::{Value, json};

use super::{exit_code, find, segments, tell_unread};
use crate::report::fit;

/// Lists the segments. The exit code is 1 if something cannot be read.
pub(super) fn run(path: &Path, as_json: bool) -> Result<ExitCode> {
    if as_json {
        let (_, catalogue) = find(path)?;
        let entries: Vec<Value> = catalogue.entries.iter().map(value).collect();
        println!("{}", serde_json::to_string_pretty(&entries)?);
        return Ok(exit_code(tell_unread(&catalogue)));
    }
    let (_, catalogue) = segments(path)?;
    println!("{}", fit::table(&table(&catalogue), fit::columns()));
    let segments = &catalogue.entries;
    let bytes: u64 = segments.iter().map(|entry| entry.bytes).sum();
    let pulled = segments.iter().filter(|entry| entry.pulled_digest().is_some()).count();
    let segment = if segments.len() == 1 { "segment" } else { "segments" };
    println!("{} {segment}, {}, {pulled} of them pulled", segments.len(), megabytes(bytes));
    Ok(exit_code(tell_unread(&catalogue)))
}

fn table(catalogue: &Catalogue) -> Table {
    let mut table = Table::new();
    table.load_preset(ASCII_MARKDOWN);
    table.set_header(["segment", "size", "from", "to", "ticks", "events", "state", "marks"]);
    for entry in catalogue.runs().into_values().flatten() {
        table.add_row(cells(entry));
    }
    for column in 1..=5 {
        if let Some(column) = table.column_mut(column) {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    table
}

fn cells(entry: &Entry) -> [String; 8] {
    [
        entry.name.to_string(),
        megabytes(entry.bytes),
        seconds(entry.times.map(|times| times.first_ns)),
        seconds(entry.times.map(|times| times.last_ns)),
        count(entry.ticks),
        count(entry.events),
        entry.state.word().to_owned(),
        marks(entry).join(" "),
    ]
}

fn seconds(ns: Option<u64>) -> String {
    ns.map_or_else(|| "-".to_owned(), |ns| format!("{:.1} s", ns as f64 * 1e-9))
}

fn count(number: Option<u64>) -> String {
    number.map_or_else(|| "-".to_owned(), |number| number.to_string())
}

fn marks(entry: &Entry) -> Vec<&'static str> {
    let pulled = match entry.pulled {
        Pulled::Yes(_) => Some("pulled"),
        Pulled::Stale => Some("changed since pulled"),
        Pulled::No => None,
    };
    entry.keep.then_some("keep").into_iter().chain(pulled).collect()
}

fn value(entry: &Entry) -> Value {
    json!({
        "name": entry.name.as_str(), "bytes": entry.bytes, "modified_ns": entry.modified_ns,
        "first_ns": entry.times.map(|times| times.first_ns), "last_ns": entry.times.map(|times| times.last_ns),
        "ticks": entry.ticks, "events": entry.events,
        "state": match entry.state { State::Closed => "closed", State::Unindexed => "unindexed", State::Cut => "cut", State::Open => "open" },
        "keep": entry.keep, "pulled": entry.pulled_digest(),
    })
}

fn megabytes(bytes: u64) -> String {
    format!("{:.1} MB", bytes as f64 * 1e-6)
}
