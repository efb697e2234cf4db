//! The table of stops in `docs/faults.md`, made from the table that the safety plane uses.

use std::fmt::Write as _;
use std::path::Path;

use runtime::recording::fault_reason;
use runtime::safety::{Restart, STOPS};

const COMMAND: &str = "UPDATE_EXPECT=1 cargo test -p firmware-host stops_reference";
const BEGIN: &str = "<!-- begin of the generated table -->\n";
const END: &str = "<!-- end of the generated table -->\n";

fn table() -> String {
    let mut out = String::new();
    let _ = writeln!(out, "This table is generated from the source code by `{COMMAND}`.\n");
    let _ = writeln!(out, "| reason in `health` | condition | what ends the stop | tests |");
    let _ = writeln!(out, "|---|---|---|---|");
    for stop in &STOPS {
        let end = match stop.restart {
            Restart::Person => "**a person**".to_owned(),
            Restart::Evidence(evidence) => format!("{evidence}; slow for 1 s"),
        };
        let why = fault_reason(stop.why);
        let _ = writeln!(out, "| {why} | {} | {end} | {} |", stop.condition, stop.tests);
    }
    out
}

#[test]
fn the_table_of_stops_in_the_documentation_is_the_one_that_the_safety_plane_uses() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/faults.md");
    let text = std::fs::read_to_string(&path).unwrap();
    let (before, rest) = text.split_once(BEGIN).unwrap();
    let (committed, after) = rest.split_once(END).unwrap();
    let generated = table();
    if std::env::var_os("UPDATE_EXPECT").is_some() {
        std::fs::write(&path, [before, BEGIN, &generated, END, after].concat()).unwrap();
        return;
    }
    assert!(committed == generated, "docs/faults.md is not up to date; remake it with {COMMAND}");
}
